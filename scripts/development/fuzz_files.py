"""Files of a fuzzer: several in one text, and a folder to write them to."""

import functools
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
MARK = b"%%% "

Files = dict[str, bytes]


def packed(files: Mapping[str, bytes]) -> bytes:
    """Return files as one text, each after a line ``%%% name``."""
    return b"".join(MARK + name.encode() + b"\n" + contents + b"\n" for name, contents in files.items())


def unpacked(data: bytes) -> Files:
    """Return the files of one text."""
    files = {}
    for part in (b"\n" + data.removesuffix(b"\n")).split(b"\n" + MARK)[1:]:
        name, _, contents = part.partition(b"\n")
        files[name.decode("latin-1")] = contents
    return files


@functools.cache
def scratch() -> Path:
    """Return a folder that is gone when the process ends."""
    return Path(_folder().name)


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    # In memory where the system has such a folder: on a disk, writing takes longer than reading.
    memory = Path("/dev/shm")
    return tempfile.TemporaryDirectory(prefix="calib-fuzz-", dir=memory if os.access(memory, os.W_OK) else None)


def file(name: str, data: bytes) -> Path:
    """Write a file of the scratch folder, and return where it is."""
    path = scratch() / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(data)
    return path


def shortened(path: Path, rows: int = 14) -> bytes:
    """Return the first lines of a file."""
    return b"".join(path.read_bytes().splitlines(keepends=True)[:rows])
