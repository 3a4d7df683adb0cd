"""From a file to a job, or to a board, or one clear sentence."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from calib.foundations.csv_text import text_of
from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.units import MM
from calib.foundations.words import shortened, shown
from calib.job.contradictions import contradictions
from calib.job.schema import BoardSection, Job
from calib.job.sentences import dotted, validation_sentence
from calib.measurement.prints import Print

# Is told what is done next.
Progress = Callable[[str], None]

_Section = TypeVar("_Section", Job, BoardSection)
_LARGEST_JOB = 1_000_000
# The parser's time grows with the square of a dotted key's length, and a key stands on one line.
_LONGEST_LINE = 10_000
_LONGEST_TEXT = 1000


def read_job(path: Path) -> Job:
    """Read a job file. Raises JobError with the file, the key, the value and what is allowed."""
    return parse_job(read_toml(path), str(path))


def read_board(path: Path) -> Print:
    """Read what is printed on a board. Raises JobError as :func:`read_job` does."""
    section = _validated(BoardSection, read_toml(path), str(path))
    marker = 0.0 if section.marker is None else section.marker.si
    try:
        return Print(
            section.kind,
            section.squares,
            section.square.si,
            marker,
            section.dictionary,
            section.square_sigma,
            section.shape,
        )
    except JobError as e:
        raise JobError(f"{path}: {str(e).removeprefix('board: ')}") from e


def board_toml(print_: Print) -> str:
    """Return the text of a ``board.toml``."""
    lines = [
        "# What is printed. Measure the ruler: if it is off, write the side of a square as it is.",
        f"kind = {json.dumps(print_.kind)}",
        f"squares = [{print_.squares[0]}, {print_.squares[1]}]",
        f'square = "{print_.square / MM:g} mm"',
    ]
    if print_.kind == "charuco":
        lines += [f'marker = "{print_.marker / MM:g} mm"', f"dictionary = {json.dumps(print_.dictionary)}"]
    lines += [
        f"square_sigma = {print_.square_sigma:g}  # standard deviation of the print's scale, a share; 0 where measured",
        f'shape = "{print_.shape}"  # "flat", "quadratic", "free", or "auto": what photographs held out ask for',
    ]
    return "\n".join(lines) + "\n"


def read_toml(path: Path) -> dict[str, Any]:
    """Return the contents of a TOML file. Raises JobError with one sentence."""
    source = read_bytes(path, JobError, _LARGEST_JOB)
    for number, line in enumerate(source.split(b"\n"), start=1):
        if len(line) > _LONGEST_LINE:
            raise JobError(f"{path}:{number}: is longer than the {_LONGEST_LINE} bytes that are allowed.")
    text = text_of(source, str(path), JobError)
    try:
        return tomllib.loads(text)
    except RecursionError as e:
        raise JobError(f"{path}: is nested too deep.") from e
    except ValueError as e:  # beside TOMLDecodeError also that of a number with thousands of digits
        reason = str(e) if isinstance(e, tomllib.TOMLDecodeError) else "a number has too many digits"
        raise JobError(f"{path}: is not TOML: {reason}.") from e


def parse_job(contents: dict[str, Any], where: str) -> Job:
    """Return the job of a parsed TOML document. Raises JobError as :func:`read_job` does."""
    job = _validated(Job, contents, where)
    for contradiction in contradictions(job):
        raise JobError(f"{where}: {contradiction}")
    return job


def _validated(schema: type[_Section], contents: dict[str, Any], where: str) -> _Section:
    """Return what a parsed TOML document holds by a schema. Raises JobError with one sentence."""
    try:
        return schema.model_validate(_plain(contents))
    except RecursionError as e:
        raise JobError(f"{where}: is nested too deep.") from e
    except _TooLargeError as e:
        raise JobError(f"{where}: {e}.") from e
    except ValidationError as e:
        raise JobError(f"{where}: {validation_sentence(e, schema)}") from e


class _TooLargeError(Exception):
    """A value that no job has: its key, and the end of a sentence."""


def _plain(value: Any, at: tuple[str | int, ...] = ()) -> Any:
    """Return the value of a key with tuples, as a frozen job keeps them, for arrays. Raises _TooLargeError."""
    if isinstance(value, dict):
        return {_plain(name, (*at, name)): _plain(v, (*at, name)) for name, v in value.items()}
    if isinstance(value, list):
        return tuple(_plain(v, (*at, i)) for i, v in enumerate(value))
    if isinstance(value, str) and len(value) > _LONGEST_TEXT:
        raise _TooLargeError(
            f"{shortened(dotted(at))}: the text {shown(value)} is longer than {_LONGEST_TEXT} characters"
        )
    # Hexadecimal ones may have more digits than Python prints.
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        bits = value.bit_length()
        raise _TooLargeError(
            f"{shortened(dotted(at))}: a whole number of {bits} bits; TOML allows 64, one of which is the sign"
        )
    return value
