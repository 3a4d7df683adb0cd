"""``calib init``: from a URDF and files as they are to a job."""

import os
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.application import IN_WORDS, PATH, Telling, command
from calib.cli.options import argument, written
from calib.cli.proposing import NOTHING_SAID, Said, proposed, tell_check
from calib_start import loading

if TYPE_CHECKING:
    from calib.job.proposal import Proposal


@command("init", PATH, "calib init arm.urdf measured.csv")
def init(
    urdf: Annotated[str, typer.Argument(metavar="URDF", help="The robot, or example:...", show_default=False)],
    data: Annotated[list[Path], argument("DATA...", "Tables of measurements.")],
    output: Annotated[Path, written("FILE", "The job file to write.", "--output", "-o")] = Path("calibration.toml"),
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing; refuse what can be read in two ways.")] = False,
    xacro: Annotated[
        bool, typer.Option("--xacro", help="URDF is a xacro file: run it. This runs code of the file.")
    ] = False,
    zeros: Annotated[
        Path | None,
        written(
            "FILE",
            "Where readings have other zeros or signs, write a URDF that counts as they do, and use it.",
            "--zeros",
        ),
    ] = None,
    said: Said = NOTHING_SAID,
    telling: Telling = IN_WORDS,
) -> None:
    """Write a job from a robot and tables of measurements.

    Says which columns are joints and points, in which units and conventions, and why; asks what cannot be known.
    Exit codes: 0 good, 1 bad input or an open question, 2 wrong usage.
    """
    with loading():
        from calib.foundations.files import refuse_taken, write_new
        from calib.job.inputs import STEPS_OF_LOADING
        from calib.job.looking import loaded, looked_at
    refuse_taken(output)
    if zeros is not None:
        refuse_taken(zeros)
        if zeros.absolute() == output.absolute():
            raise typer.BadParameter(f"{zeros} is to be the job, too; name another file for the URDF.")
    with ExitStack() as files:
        robot, warnings = files.enter_context(_expanded(Path(urdf), output)) if xacro else (urdf, ())
        as_read = None if zeros is None else partial(_as_read, zeros, files)
        ask = not (yes or telling.as_json or telling.quiet)
        found = proposed(robot, data, said.answers(), ask=ask, as_read=as_read)
        if zeros is not None and found.urdf != str(zeros):
            warnings = (*warnings, f"{zeros} is not written: the readings have the zeros and signs of {robot}.")
        with telling.progress(STEPS_OF_LOADING + 1) as say:
            looked = looked_at(loaded(found, output, say), say)
        write_new(output, found.job(output.absolute().parent))
    tell_check(telling, looked, (*warnings, *found.reasons), {"job": str(output)})
    if not telling.as_json:
        following = f". The next step: calib calibrate {shlex.quote(str(output))} -o out/"
        then = following if looked.seen.numbers > looked.seen.rank else "; it needs more poses."
        telling.tell(dict, lambda: [f"{output} is written{then}"])


def _as_read(path: Path, files: ExitStack, found: "Proposal") -> str:
    """Write the URDF whose joints count as the readings do; without a job it goes."""
    from calib.foundations.files import written_first

    files.enter_context(written_first(path, found.urdf_as_read()))
    return str(path)


@contextmanager
def _expanded(source: Path, output: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Write the URDF of a xacro file beside the job, and give where, and xacro's warnings; without a job it goes.

    One that an earlier run has left is as good.
    """
    from calib.foundations.errors import OutputError
    from calib.foundations.files import read_bytes, written_first
    from calib.job.xacro import expanded
    from calib.robot.urdf import parse_urdf

    name = source.name.removesuffix(".xacro").removesuffix(".urdf")
    made, warnings = expanded(source)
    # What is wrong with it is told of a file that there is.
    parse_urdf(made, f"{source}: what xacro makes of it")
    urdf = output.parent / f"{name}.urdf"
    if urdf.exists() and urdf.samefile(source):  # some call a xacro file a URDF
        urdf = output.parent / f"{name}_expanded.urdf"
    if not os.path.lexists(urdf):
        with written_first(urdf, made):
            yield str(urdf), warnings
        return
    if read_bytes(urdf, OutputError) != made:
        raise OutputError(f"{urdf}: already exists, and is not what {source} makes; move it, or take another folder.")
    yield str(urdf), warnings
