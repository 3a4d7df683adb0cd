"""From a xacro file to a URDF, by the package xacro: in a process of its own, since it runs the file's code."""

import subprocess
import sys
from pathlib import Path

from calib.foundations.errors import RobotError
from calib.foundations.words import shown

_SECONDS = 60
_RUN = "import sys, xacro; sys.argv = ['xacro', sys.argv[1]]; xacro.main()"


def expanded(path: Path) -> bytes:
    """Return the URDF that a xacro file makes. **This runs code of the file**: give it files you trust alone.

    Raises RobotError when the package is not installed, or with what xacro says.
    """
    if not path.is_file():
        raise RobotError(f"{path}: there is no such file.")
    # No module is taken from the current folder: what is run is the file's code alone.
    command = [sys.executable, "-P", "-c", _RUN, str(path.absolute())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired as e:
        raise RobotError(f"{path}: xacro did not end within {_SECONDS} s.") from e
    if done.returncode:
        said = [line for line in done.stderr.decode(errors="replace").splitlines() if line.strip()] or ["nothing"]
        if any("No module named 'xacro'" in line for line in said):
            raise RobotError(f"{path}: needs the package xacro: pip install 'urdf-calib[xacro]'.")
        raise RobotError(f"{path}: xacro says {shown(said[-1].strip())}.")
    return done.stdout
