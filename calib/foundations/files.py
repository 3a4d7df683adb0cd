"""Files and folders that appear whole or not at all.

A folder cannot take another's place in one step everywhere, so it is done in two: the old one steps aside to
``.<name>.previous``, and the new one, complete and on the disk, becomes ``<name>``. Killed before, the old one is
there; killed after, the new one; killed between, the next reader or writer puts the old one back. A lock on the folder
above, which the system frees however a process ends, keeps others from seeing the moment between.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Collection, Iterator
from pathlib import Path

from calib.foundations.errors import CalibError, OutputError

# Far above any input this toolkit meets, and low enough that a wrong path gives a sentence, not a full memory.
LARGEST_INPUT = 2_000_000_000
# JSON takes some twenty times its size while it is read.
LARGEST_JSON = 100_000_000
# How long to wait for another run to read or write beside a folder, in s: it takes moments.
_PATIENCE = 30.0
_LOOK = 0.02


def read_bytes(path: Path, error: type[CalibError], largest: int = LARGEST_INPUT) -> bytes:
    """Return the contents of a regular file, or raise ``error`` with a sentence that says why it cannot be read.

    What is not regular (a folder, a device, a pipe) is not opened; nor waited for, if it took the file's place since.
    """
    try:
        if not path.exists():
            raise error(f"{path}: there is no such file.")
        if not path.is_file():
            raise error(f"{path}: is not a regular file.")
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as file:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                raise error(f"{path}: is not a regular file.")
            # Some files of the system say that they are empty, and others grow: what is read counts as well.
            data = b"" if found.st_size > largest else file.read(largest + 1)
            if max(len(data), found.st_size) > largest:
                raise error(f"{path}: is larger than {largest} bytes.")
            return data
    except OSError as e:
        if isinstance(e, CalibError):
            raise
        raise error(f"{path}: cannot be read ({e.strerror}).") from e
    except ValueError as e:  # such as a zero byte in the name
        if isinstance(e, CalibError):
            raise
        raise error(f"{str(path)!r}: is not the name of a file.") from e


def sha256(data: bytes) -> str:
    """Return the SHA-256 of ``data`` in hex."""
    return hashlib.sha256(data).hexdigest()


def stamp(path: Path) -> tuple[int, int, int] | None:
    """Return what changes when a file does: its number, size and time; None where there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def encoded(text: str) -> bytes:
    """Return text as UTF-8; what cannot be, the bytes of a file's name that are no text, as escapes."""
    return text.encode(errors="backslashreplace")


def write_atomically(path: Path, data: bytes | str) -> None:
    """Write a file so that a reader sees the old contents or the new ones, never a part.

    Raises OutputError when the folder is missing, read-only or full; the old file is then untouched.
    """
    data = encoded(data) if isinstance(data, str) else data
    temporary = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
        temporary = None
        _sync(path.parent)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written ({e.strerror}).") from e
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def replace_folder(path: Path, ours: Collection[str] | None = None) -> Iterator[Path]:
    """Give a new empty folder beside ``path`` that takes the place of ``path`` when the block ends well.

    When the block raises, ``path`` is untouched and nothing is left. Of the old folder, what is called as one of
    ``ours`` is removed (all, where that is None); anything else, which somebody has put there, is moved to the new one.
    Raises OutputError when the disk is full, the folder read-only, or another run keeps it for too long.
    """
    path = path.resolve()  # a link to a folder stays a link: what it points to is replaced
    made: list[Path] = []
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, and the results need a folder.")
        made = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as ending:
            with _locked(path, fcntl.LOCK_EX) as alone:
                if alone:
                    _remove_half_written(path)
                new = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".new", dir=path.parent))
                ending.callback(shutil.rmtree, new, ignore_errors=True)  # nothing is left of it in the end
                handle = os.open(new, os.O_RDONLY)
                ending.callback(os.close, handle)
                _had(handle, fcntl.LOCK_EX)  # tells others that it is being written
            yield new
            for entry in new.rglob("*"):
                _sync(entry)
            new.chmod(0o755)
            _sync(new)
            with _locked(path, fcntl.LOCK_EX):
                _exchange(path, new, ours)
                made = []
    except OSError as e:
        if isinstance(e, CalibError):
            raise
        raise OutputError(f"{path}: the results cannot be written ({e.strerror or e}).") from e
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def reading_folder(path: Path) -> Iterator[None]:
    """Keep a folder as it is while the block reads it: another run waits before it replaces it.

    What a killed run left is put right first. Whether there is such a folder, the block finds out. Raises OutputError
    when what was left cannot be put right, or another run keeps the folder for too long.
    """
    try:
        path = path.resolve()
        there = path.parent.is_dir()
    except (OSError, RuntimeError, ValueError):  # what no path leads to, the block cannot read, and says so
        there = False
    if not there:
        yield
        return
    while True:
        with _locked(path, fcntl.LOCK_SH):
            if path.exists() or not previous_folder(path).is_dir():
                yield
                return
        recover_folder(path)


def recover_folder(path: Path) -> None:
    """Put right what a killed run left: where only ``.<name>.previous`` is there, it becomes ``path`` again.

    Raises OutputError when that is not possible.
    """
    path = path.resolve()
    try:
        if not path.parent.is_dir():
            return
        with _locked(path, fcntl.LOCK_EX):
            _put_back(path)
    except OSError as e:
        if isinstance(e, CalibError):
            raise
        raise OutputError(f"{path}: what an interrupted run left cannot be put right ({e.strerror}).") from e


def previous_folder(path: Path) -> Path:
    """Return where a folder stands aside while its successor takes its place."""
    return path.with_name(f".{path.name}.previous")


def _exchange(path: Path, new: Path, ours: Collection[str] | None) -> None:
    _put_back(path)
    _remove_previous(path, ours)
    try:
        if path.exists():
            path.rename(previous_folder(path))
        new.rename(path)
    except BaseException:
        _put_back(path)
        raise
    _sync(path.parent)
    _remove_previous(path, ours)


def _remove_half_written(path: Path) -> None:
    """Remove what runs that were killed have begun to write; what a living one writes, it has locked."""
    name = re.compile(rf"\.{re.escape(path.name)}\.\w{{8}}\.new")
    for folder in path.parent.iterdir():
        if name.fullmatch(folder.name):
            with contextlib.suppress(OSError), contextlib.ExitStack() as ending:  # its own run may just remove it
                handle = os.open(folder, os.O_RDONLY)
                ending.callback(os.close, handle)
                if _had(handle, fcntl.LOCK_EX):
                    shutil.rmtree(folder, ignore_errors=True)


def _put_back(path: Path) -> None:
    """Let the old folder be ``path`` again, where no other is."""
    previous = previous_folder(path)
    if previous.is_dir() and not path.exists():
        previous.rename(path)


def _remove_previous(path: Path, ours: Collection[str] | None) -> None:
    """Remove the old folder beside its successor, but nothing that is not ours."""
    previous = previous_folder(path)
    if not previous.is_dir():
        return
    with contextlib.suppress(OSError):  # what stays does no harm, and the next run comes back to it
        for entry in list(previous.iterdir()):
            if ours is None or entry.name in ours:
                _remove(entry)
            elif not (path / entry.name).exists():
                entry.rename(path / entry.name)
        previous.rmdir()


def _remove(entry: Path) -> None:
    if entry.is_dir() and not entry.is_symlink():
        shutil.rmtree(entry)
    else:
        entry.unlink()


@contextlib.contextmanager
def _locked(path: Path, kind: int) -> Iterator[bool]:
    """Hold a lock on the folder that ``path`` is in, and give whether there is one.

    The folder itself is locked: nothing is left behind, and readers need not write. A file system that has no such
    locks does without. Raises OutputError when another run holds it for too long.
    """
    with contextlib.ExitStack() as closing:
        had: bool | None = False
        with contextlib.suppress(PermissionError):  # a folder whose names may not be listed cannot be locked either
            handle = os.open(path.parent, os.O_RDONLY)
            closing.callback(os.close, handle)
            until = time.monotonic() + _PATIENCE
            while (had := _had(handle, kind)) is None:
                if time.monotonic() > until:
                    raise OutputError(f"{path}: another run is busy with it or beside it; try again when it has ended.")
                time.sleep(_LOOK)
        yield bool(had)


def _had(handle: int, kind: int) -> bool | None:
    """Return whether a lock was got, or None where another process holds it."""
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return None
    except OSError:  # some network file systems
        return False
    return True


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
