"""Where this toolkit runs: said before anything is loaded that would fail in its own words."""

import sys
from typing import NoReturn


def _refuse(why: str, cause: ImportError | None = None) -> NoReturn:
    # Of `python -m calib` Python loads the package first, before anything that could say this in a line.
    if sys.argv[:1] == ["-m"]:
        sys.stderr.write(f"Error: {why}\n")
        sys.exit(1)
    raise ImportError(why, name=__name__) from cause


if sys.platform == "win32":
    _refuse(
        "calib runs on Linux and macOS. On Windows, install and run it in WSL, the Windows Subsystem for Linux "
        "(docs/windows.md)."
    )
try:
    import fcntl  # noqa: F401
except ImportError as e:
    _refuse(
        "calib needs the locks of files of Linux and macOS, and this Python has no module fcntl; use another Python.", e
    )
