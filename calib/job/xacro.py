"""From a xacro file to a URDF, by the package xacro: in a process of its own, since it runs the file's code."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.foundations.words import first_of
from calib.robot.urdf import LARGEST_URDF

# By the clock, and of the processor. The largest robots that we know take 2 s and 100 MB.
_SECONDS, _OF_PROCESSOR, _MOST_BYTES = 60, 8, 1_000_000_000
# Of the URDF, which may be as long as any, and of what xacro says beside it.
_MOST_WRITTEN = LARGEST_URDF + 1
_LIMITS = f"""
import contextlib, resource
for kind, most in ((resource.RLIMIT_CPU, {_OF_PROCESSOR}), (resource.RLIMIT_AS, {_MOST_BYTES}),
                   (resource.RLIMIT_FSIZE, {_MOST_WRITTEN})):
    with contextlib.suppress(ValueError, OSError):  # a lower limit stands, or the system knows none
        resource.setrlimit(kind, (most, most))
"""
_RUN = f"{_LIMITS}\nimport sys, xacro; sys.argv = ['xacro', sys.argv[1]]; xacro.main()"
_LONGEST = 200  # characters of what it says
_MOST_WARNINGS = 5
_WARNING, _PROCESSING = "warning: ", "when processing file: "
_ARGUMENT = ":="  # what has it is no file to xacro
# How a process ends that has used up its time.
_USED_UP = (-signal.SIGXCPU, -signal.SIGKILL)


class Expanded(NamedTuple):
    """The URDF that a xacro file makes, and what xacro warned of, such as an include that found no file."""

    urdf: bytes
    warnings: tuple[str, ...]


def expanded(path: Path) -> Expanded:
    """Return the URDF that a xacro file makes. **This runs code of the file**: give it files you trust alone.

    Raises RobotError when the package is not installed, or with what xacro says.
    """
    read_bytes(path, RobotError, LARGEST_URDF)  # xacro would wait for what is no file
    if _ARGUMENT in str(path.absolute()):
        raise RobotError(f"{path}: a path with {_ARGUMENT!r} is an argument to xacro, and no file; call it otherwise.")
    # No module is taken from the current folder: what is run is the file's code alone.
    command = [sys.executable, "-P", "-c", _RUN, str(path.absolute())]
    # Into files, whose length has a limit.
    with tempfile.TemporaryFile() as made, tempfile.TemporaryFile() as told:
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=made, stderr=told, timeout=_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as e:
            raise RobotError(f"{path}: xacro did not end within {_SECONDS} s.") from e
        if max(made.seek(0, os.SEEK_END), told.seek(0, os.SEEK_END)) >= _MOST_WRITTEN:
            raise RobotError(f"{path}: xacro writes more than the {LARGEST_URDF} bytes that are allowed.")
        made.seek(0)
        told.seek(0)
        urdf, stderr = made.read(), told.read()
    said = [line.strip() for line in stderr.decode(errors="replace").splitlines() if line.strip()]
    if done.returncode in _USED_UP:
        raise RobotError(f"{path}: xacro took more than {_OF_PROCESSOR} s of processor time, which are allowed.")
    if done.returncode:
        raise RobotError(f"{path}: {_why(path, said or ['nothing'])}.")
    warnings = list(dict.fromkeys(line.removeprefix(_WARNING) for line in said if line.startswith(_WARNING)))
    return Expanded(
        urdf, tuple(f"{path}: xacro warns: {line[:_LONGEST]!r}." for line in first_of(warnings, _MOST_WARNINGS))
    )


def _why(path: Path, said: list[str]) -> str:
    """Return why xacro made nothing of a file, by the lines that it said."""
    # What is wrong stands first, and then where; of a traceback it stands last.
    first = next((line for line in said if not line.lower().startswith("warning")), said[0])
    if any("No module named 'xacro'" in line for line in said):
        return "needs the package xacro: pip install 'urdf-calib[xacro]'"
    if first == "error:" or any("MemoryError" in line for line in said):
        return f"xacro needs more than the {_MOST_BYTES} bytes of memory that are allowed"
    what = said[-1] if first.startswith("Traceback") else first
    # The innermost file comes first: it may be one that this one includes.
    at = next((line.removeprefix(_PROCESSING) for line in said if line.startswith(_PROCESSING)), "")
    where = f" of {at[:_LONGEST]!r}" if at not in ("", str(path.absolute())) else ""
    return f"xacro says {what.removeprefix('error: ')[:_LONGEST]!r}{where}"
