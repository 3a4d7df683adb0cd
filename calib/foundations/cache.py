"""What took long to make, kept between runs in the user's cache folder. Without it all is made anew, and is the same.

``CALIB_CACHE`` names another folder, or is ``off``. An entry holds the hash of itself: one that is damaged, or that
somebody else has put there, counts for nothing. That an entry cannot be kept is nobody's trouble.
"""

import contextlib
import os
import re
import stat
import sys
from pathlib import Path

from calib.foundations.errors import OutputError
from calib.foundations.files import read_bytes, sha256, write_atomically

# So many entries are kept; the oldest go first.
_MOST = 300
_LARGEST = 20_000_000
_ENDING = ".calib"
_DIGITS = 64
_ENTRY = re.compile(rf"[0-9a-f]{{{_DIGITS}}}{re.escape(_ENDING)}")


def folder() -> Path | None:
    """Return the folder that entries are kept in, None where none is to be used or there is no place for one."""
    stated = os.environ.get("CALIB_CACHE", "")
    if stated == "off":
        return None
    if stated:
        return Path(stated)
    xdg = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(xdg):  # noqa: PTH117 - the specification ignores others
        return Path(xdg) / "calib"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "calib"


def kept(key: str) -> bytes | None:
    """Return the entry of a key, a hash in hex, as it was kept; None where there is none, or no whole one."""
    where = folder()
    if where is None:
        return None
    try:
        found = read_bytes(where / f"{key}{_ENDING}", OutputError, _LARGEST)
    except OutputError:
        return None
    return found[_DIGITS:] if found[:_DIGITS] == _signed(key, found[_DIGITS:]) else None


def keep(key: str, data: bytes) -> None:
    """Keep an entry, where that is possible; of many, the oldest give way."""
    where = folder()
    if where is None or len(data) > _LARGEST - _DIGITS:
        return
    with contextlib.suppress(OutputError, OSError, ValueError):
        where.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomically(where / f"{key}{_ENDING}", _signed(key, data) + data)
        _tidy(where)


def _tidy(where: Path) -> None:
    """Remove the oldest entries. Others may do so too, and a folder that somebody has named may hold anything else."""
    found = [(path.lstat(), path) for path in where.iterdir() if _ENTRY.fullmatch(path.name)]
    entries = sorted((about.st_mtime_ns, path) for about, path in found if stat.S_ISREG(about.st_mode))
    for _, old in entries[: max(len(entries) - _MOST, 0)]:
        with contextlib.suppress(OSError):
            old.unlink()


def _signed(key: str, data: bytes) -> bytes:
    return sha256(key.encode() + data).encode()
