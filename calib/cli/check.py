"""``calib check``: what is wrong with a job, or what is in files before there is one."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, PATH, Telling, command
from calib.cli.options import refuse_idle
from calib.cli.proposing import NOTHING_SAID, Said, proposed, tell_check
from calib_start import loading

_ROBOT = (".urdf", ".xacro")
# A workbook among them: it is refused as a table, in a sentence that says what makes one of it.
_TABLE = (".csv", ".tsv", ".txt", ".dat", ".asc", ".xlsx")

Every = Annotated[bool, typer.Option("--all", help="List every direction of the null space.")]


@command("check", PATH, "calib check calibration.toml")
def check(
    files: Annotated[
        list[str],
        typer.Argument(metavar="FILE...", help="A job (TOML); or a URDF, tables, or both.", show_default=False),
    ],
    said: Said = NOTHING_SAID,
    every: Every = False,
    telling: Telling = IN_WORDS,
) -> None:
    """Check a job, or tell what a URDF and tables hold.

    Nothing is solved or written. Looks at units, names, limits, duplicates and observability.
    Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    robots = [file for file in files if file.lower().endswith(_ROBOT) or file.startswith("example:")]
    # Beside a robot there are tables, whatever they are called, as calib init takes them.
    tables = [
        file
        for file in files
        if file not in robots and (file.lower().endswith(_TABLE) or (robots and not file.lower().endswith(".toml")))
    ]
    jobs = [file for file in files if file not in robots and file not in tables]
    if len(jobs) > 1 or len(robots) > 1 or (jobs and (robots or tables)):
        raise typer.BadParameter("take one job; or one URDF, tables, or a URDF and tables.")
    given = said.answers()
    idle = dict.fromkeys((f"--{'column' if name == 'columns' else name}" for name in given), True)
    if jobs:
        refuse_idle("a job says this itself.", idle)
        _check_job(Path(jobs[0]), telling, every=every)
    elif robots and tables:
        _check_files(robots[0], [Path(table) for table in tables], given, telling, every=every)
    else:
        refuse_idle("needs a job, or a URDF and tables.", {**idle, "--all": every})
        _tell_one(robots, tables, telling)


def _check_job(job: Path, telling: Telling, *, every: bool) -> None:
    with loading():
        from calib.job.inputs import STEPS_OF_LOADING, load
        from calib.job.looking import looked_at
    with telling.progress(STEPS_OF_LOADING + 1) as say:
        looked = looked_at(load(job, say), say, every=every)
    tell_check(telling, looked)


def _check_files(urdf: str, tables: list[Path], given: dict[str, object], telling: Telling, *, every: bool) -> None:
    with loading():
        from calib.job.inputs import STEPS_OF_LOADING
        from calib.job.looking import loaded, looked_at
    found = proposed(urdf, tables, given, ask=False)
    with telling.progress(STEPS_OF_LOADING + 1) as say:
        looked = looked_at(loaded(found, Path("calibration.toml"), say), say, every=every)
    tell_check(telling, looked, found.reasons, {"toml": found.job(Path.cwd())})


def _tell_one(robots: list[str], tables: list[str], telling: Telling) -> None:
    """Tell what a URDF alone, or tables alone, hold."""
    with loading():
        from calib.job.chains import tips
        from calib.job.propose import told
    said = [line for robot in robots for line in tips(robot)] + [line for table in tables for line in told(table)]
    missing = "measurements: calib check ARM.urdf TABLE.csv" if robots else "the robot: calib check ARM.urdf TABLE.csv"
    telling.tell(lambda: {"reasons": said}, lambda: [*said, f"More can be told with {missing}."])
