"""Where this toolkit runs: said before anything is loaded that would fail in its own words."""

import sys

if sys.platform == "win32":
    raise ImportError(
        "calib runs on Linux and macOS. On Windows, install and run it in WSL, the Windows Subsystem for Linux "
        "(docs/windows.md).",
        name=__name__,
    )
try:
    import fcntl  # noqa: F401
except ImportError as e:
    raise ImportError(
        "calib needs the locks of files of Linux and macOS, and this Python has no module fcntl; use another Python.",
        name=__name__,
    ) from e
