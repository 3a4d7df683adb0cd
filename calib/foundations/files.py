"""Files that appear whole or not at all."""

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from calib.foundations.errors import CalibError, OutputError

# Far above any input this toolkit meets, and low enough that a wrong path gives a sentence, not a full memory.
LARGEST_INPUT = 2_000_000_000
# JSON takes some twenty times its size while it is read.
LARGEST_JSON = 100_000_000


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
        _sync_folder(path.parent)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written ({e.strerror}).") from e
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Give a new empty folder beside ``path`` that takes the place of ``path`` when the block ends well.

    The old folder is moved aside to ``.<name>.previous`` for the moment of the exchange and then removed, so that at
    every instant one whole folder exists; :func:`recover_folder` puts it back. When the block raises, ``path`` is
    untouched.
    """
    path = path.resolve()  # a link to a folder stays a link: what it points to is replaced
    new = None
    try:
        recover_folder(path)
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, and the results need a folder.")
        path.parent.mkdir(parents=True, exist_ok=True)
        new = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".new", dir=path.parent))
        yield new
        for file in new.rglob("*"):
            if file.is_file():
                _sync_file(file)
        _sync_folder(new)
        new.chmod(0o755)
        previous = previous_folder(path)
        if path.exists():
            path.rename(previous)
        new.rename(path)
        new = None
        _sync_folder(path.parent)
        shutil.rmtree(previous, ignore_errors=True)
    except OSError as e:
        if isinstance(e, CalibError):
            raise
        raise OutputError(f"{path}: the results cannot be written ({e.strerror or e}).") from e
    finally:
        if new is not None:
            shutil.rmtree(new, ignore_errors=True)


def recover_folder(path: Path) -> None:
    """Finish what a killed run left: where only ``.<name>.previous`` is there, it becomes ``path`` again."""
    path = path.resolve()
    previous = previous_folder(path)
    if previous.is_dir():
        if path.exists():
            shutil.rmtree(previous, ignore_errors=True)
        else:
            previous.rename(path)


def previous_folder(path: Path) -> Path:
    """Return where a folder stands aside while its successor takes its place."""
    return path.with_name(f".{path.name}.previous")


def _sync_file(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_sync_folder = _sync_file
