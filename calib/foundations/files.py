"""Files of users are read with a guard; files of ours appear whole or not at all."""

import contextlib
import errno
import hashlib
import os
import secrets
import stat
import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO
from unicodedata import normalize

from calib.foundations.errors import CalibError, OutputError
from calib.foundations.words import shown

# Far above any input this toolkit meets, and low enough that a wrong path gives a sentence, not a full memory.
LARGEST_INPUT = 2_000_000_000
# JSON takes some twenty times its size while it is read.
LARGEST_JSON = 100_000_000
# Files are read in pieces of so many bytes.
_PIECE = 1 << 24
# Never waited for, as a pipe would be; never taken for the terminal of this process; not handed on to others.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
# What libraries were seen to raise at damaged files: they have no exception of their own.
DAMAGED = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, NameError, OSError),
    *(RuntimeError, StopIteration, SyntaxError, TypeError, ValueError, struct.error, zlib.error),
)


def read_bytes(path: Path, error: type[CalibError], largest: int = LARGEST_INPUT) -> bytes:
    """Return the contents of a regular file, or raise ``error`` with a sentence that says why it cannot be read.

    Links are followed: a user may name a file as he likes. What is not regular (a folder, a device, a pipe) is not
    opened; nor waited for, if it took the file's place since.
    """
    with sentences(path, error):
        # Not by path.exists(), which takes links in a circle for nothing at all.
        try:
            found = path.stat()
        except (FileNotFoundError, NotADirectoryError) as e:
            raise error(f"{path}: there is no such file{_alike(path)}.") from e
        if not stat.S_ISREG(found.st_mode):
            raise error(f"{path}: is not a regular file.")
        return _contents(os.open(path, _READ), path, error, largest)


def _alike(path: Path) -> str:
    """Return the end of a sentence: what is there that capitals, or the way accents are written, tell from a name."""

    def key(name: str) -> str:
        return normalize("NFC", name).casefold()

    with contextlib.suppress(OSError):
        for there in sorted(path.parent.iterdir()):
            if key(there.name) == key(path.name) and there.name != path.name:
                return f"; there is {shown(there.name)}"
    return ""


def read_inside(folder: Path, name: str, error: type[CalibError], largest: int = LARGEST_INPUT) -> bytes:
    """Return the contents of the regular file ``name`` in a folder, as :func:`read_bytes`, but follow no link there.

    For what is handed on to others, whom the link's own permissions would not let read.
    """
    path = folder / name
    with sentences(path, error):
        return _contents(_inside(folder, name, error), path, error, largest)


def open_inside(folder: Path, name: str, error: type[CalibError], largest: int) -> BinaryIO:
    """Return the regular file ``name`` in a folder, opened, as :func:`read_inside` reads it: to be sent bit by bit."""
    path = folder / name
    with sentences(path, error):
        file, length = _opened(_inside(folder, name, error), path, error)
        if length > largest:
            file.close()
            raise error(f"{path}: is larger than {largest} bytes.")
        return file


def _inside(folder: Path, name: str, error: type[CalibError]) -> int:
    path = folder / name
    with opened_folder(folder) as handle:
        found = lstat(name, handle)
        if found is None:
            raise error(f"{path}: there is no such file.")
        if not stat.S_ISREG(found.st_mode):
            raise error(f"{path}: is not a regular file.")
        return os.open(name, _READ | os.O_NOFOLLOW, dir_fd=handle)


def _opened(handle: int, path: Path, error: type[CalibError]) -> tuple[BinaryIO, int]:
    """Return the regular file of a handle and how many bytes it says it has; what has taken its place is closed."""
    file = os.fdopen(handle, "rb")
    found = os.fstat(handle)
    if not stat.S_ISREG(found.st_mode):
        file.close()
        raise error(f"{path}: is not a regular file.")
    return file, found.st_size


def _contents(handle: int, path: Path, error: type[CalibError], largest: int) -> bytes:
    file, length = _opened(handle, path, error)
    with file:
        # Some files of the system say that they are empty, and others grow: what is read counts as well.
        # A read sets aside all that it may bring, so that it is never asked for more than the next piece.
        pieces = []
        if length <= largest:
            length = 0
            while length <= largest and (piece := file.read(_PIECE)):
                pieces.append(piece)
                length += len(piece)
        if length > largest:
            raise error(f"{path}: is larger than {largest} bytes.")
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def is_there(path: Path, kind: Callable[[Path], bool]) -> bool:
    """Return whether ``Path.is_dir`` or ``Path.is_file`` holds; not of a name longer than the file system takes."""
    try:
        return kind(path)
    except OSError:
        return False


@contextlib.contextmanager
def sentences(path: object, error: type[CalibError], what: str = "cannot be read") -> Iterator[None]:
    """Let an OSError of the block be an ``error`` that says of a file ``what`` cannot be done, and why."""
    try:
        yield
    except CalibError:
        raise
    except OSError as e:
        raise error(f"{path}: {what} ({e.strerror}).") from e
    except ValueError as e:  # such as a zero byte in the name
        raise error(f"{str(path)!r}: is not the name of a file.") from e


@contextlib.contextmanager
def opened_folder(path: str | Path, inside: int | None = None) -> Iterator[int]:
    """Give a descriptor of a folder: what is done by it is done there, whatever takes the name of the folder since.

    ``inside``: descriptor of the folder that ``path`` is a name in; then no link is followed.
    """
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC | (0 if inside is None else os.O_NOFOLLOW)
    handle = os.open(path, flags, dir_fd=inside)
    try:
        yield handle
    finally:
        os.close(handle)


def lstat(name: str, folder: int) -> os.stat_result | None:
    """Return what is called ``name`` in a folder, a link as a link; None where nothing is."""
    try:
        return os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return None


def names_in(folder: int) -> list[str]:
    """Return the names in a folder, sorted."""
    return sorted(os.listdir(folder))


def is_regular(name: str, folder: int) -> bool:
    """Return whether ``name`` in a folder is a regular file, and no link to one."""
    found = lstat(name, folder)
    return found is not None and stat.S_ISREG(found.st_mode)


def create(name: str, folder: int, data: bytes) -> None:
    """Write a new file in a folder and bring it to the disk; its permissions are those that the user's umask leaves."""
    handle = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666, dir_fd=folder)
    with os.fdopen(handle, "wb") as file:
        _to_disk(file, data)


def _to_disk(file: BinaryIO, data: bytes) -> None:
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


def names_to_disk(folder: int) -> None:
    """Bring the names in a folder to the disk; some file systems (shared folders, FUSE) know no such wish."""
    try:
        os.fsync(folder)
    except OSError as e:
        if e.errno not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
            raise


def sha256(data: bytes) -> str:
    """Return the SHA-256 of ``data`` in hex."""
    return hashlib.sha256(data).hexdigest()


def refuse_taken(*paths: Path | None, with_parents: bool = False) -> None:
    """Raise OutputError when something, be it a link that leads nowhere, has the name of a file that is to be new.

    Also when there is no folder for it, before work is done for it; not where it is made ``with_parents``. None stands
    for a file that is not asked for.
    """
    for path in paths:
        # What hides from this user, or has no name that a file can have, the attempt to write it finds out.
        if path is not None and os.path.lexists(path):
            raise OutputError(f"{path}: already exists; choose another name.")
        # Links in a circle and such that lead nowhere lead to no folder either.
        if path is not None and not with_parents:
            with sentences(path, OutputError, "cannot be written"):
                if not stat.S_ISDIR(path.parent.stat().st_mode):
                    raise OutputError(f"{path}: cannot be written ({os.strerror(errno.ENOTDIR)}).")
                refuse_long(path)


def hidden(name: str, kind: str) -> str:
    """Return a new name for what is beside ``name`` while that is written: of ``kind`` part or calib."""
    return f".{name}.{secrets.token_hex(4)}.{kind}"


def nearest_folder(path: Path) -> Path:
    """Return what is there of the folders above a path, the nearest; above the root, the root."""
    whole = path.absolute()
    return next((folder for folder in whole.parents if folder.exists()), whole)


def refuse_long(path: Path) -> None:
    """Raise OutputError where a name is longer than its file system takes, or the hidden one beside it would be.

    Also of folders above it that are to be made. Only the file system knows: it is asked before work is done.
    """
    with sentences(path, OutputError, "cannot be written"):
        there = nearest_folder(path)
        *above, name = path.absolute().relative_to(there).parts or (path.name,)  # the root has no name
        for one in (*above, longest := hidden(name, "calib")):
            try:
                os.lstat(there / one)
            except FileNotFoundError:
                pass
            except OSError as e:
                if e.errno != errno.ENAMETOOLONG:
                    raise
                more = len(longest) - len(name)
                raise OutputError(
                    f"{path}: its name is too long, as while it is written a hidden one beside it has {more} "
                    "characters more; choose a shorter name."
                ) from e


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


def name_as_text(path: Path) -> str:
    """Return the name of a file as text, which JSON can hold: bytes of it that are no text as escapes."""
    return encoded(path.name).decode()


def write_new(path: Path, data: bytes | str) -> None:
    """Write a file that is not there yet, as :func:`write_atomically`; raise OutputError when something is."""
    write_together({path: data})


def write_together(files: Mapping[Path, bytes | str]) -> None:
    """Write files that are not there yet, each as :func:`write_new`; on any error none of them stays."""
    with contextlib.ExitStack() as all_of_them:
        for path, data in files.items():
            all_of_them.enter_context(written_first(path, data))


@contextlib.contextmanager
def written_first(path: Path, data: bytes | str) -> Iterator[None]:
    """Write a file that is not there yet, as :func:`write_new`; it stays only if the block ends without an error."""
    ours = write_atomically(path, data, new=True)
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError), opened_folder(path.parent) as folder:
            _take_back(path.name, folder, ours)
        raise


def write_atomically(path: Path, data: bytes | str, *, new: bool = False) -> os.stat_result:
    """Write a file so that a reader sees the old contents or the new ones, never a part; return which file it is.

    ``new``: there are no old ones, not even some that somebody wrote since that was looked at.
    Raises OutputError when the folder is missing, read-only or full, or when ``path`` is there and no regular file
    (a link, a folder, a device); what is there is then untouched.
    """
    data = encoded(data) if isinstance(data, str) else data
    with sentences(path, OutputError, "cannot be written"), opened_folder(path.parent) as folder:
        if new:
            refuse_taken(path)
        found = lstat(path.name, folder)
        if found is not None and not stat.S_ISREG(found.st_mode):
            kind = "a link" if stat.S_ISLNK(found.st_mode) else "not a regular file"
            raise OutputError(f"{path}: is {kind}, and is not replaced; choose another name.")
        ours = _appear(path, data, folder, new=new)
        try:
            names_to_disk(folder)
        except BaseException:
            if new:
                _take_back(path.name, folder, ours)
            raise
        return ours


def _take_back(name: str, folder: int, ours: os.stat_result) -> None:
    """Remove a file that was written a moment ago, unless another has its name since."""
    with contextlib.suppress(OSError):
        found = lstat(name, folder)
        if found is not None and os.path.samestat(found, ours):
            os.unlink(name, dir_fd=folder)


def _appear(path: Path, data: bytes, folder: int, *, new: bool) -> os.stat_result:
    """Write a file without a name, and give it its name when it is whole: who is killed before leaves nothing.

    A link takes the place of nothing, so that what is to replace another is for one moment called as a part, and so is
    all that is written where files without a name are not known.
    """
    part = hidden(path.name, "part")
    ours = None
    with _unnamed(data, folder) as whole:
        try:
            if new and whole is not None:
                ours = os.fstat(whole)
                if _linked(_by_number(whole), path, folder):
                    return ours
            if whole is None or not _linked(_by_number(whole), path.with_name(part), folder):
                create(part, folder, data)
            ours = os.stat(part, dir_fd=folder, follow_symlinks=False)
            if new and _linked(part, path, folder):
                os.unlink(part, dir_fd=folder)
            else:
                os.replace(part, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part, dir_fd=folder)
            if new and ours is not None:  # Ctrl-C may come when it has its name
                _take_back(path.name, folder, ours)
            raise
        return ours


@contextlib.contextmanager
def _unnamed(data: bytes, folder: int) -> Iterator[int | None]:
    """Write a file that has no name and ends with this process; give its descriptor.

    None where there are no such files: outside Linux, and on some file systems (NFS, FAT).
    """
    if sys.platform != "linux":
        yield None
        return
    try:
        handle = os.open(".", os.O_WRONLY | os.O_TMPFILE | os.O_CLOEXEC, 0o666, dir_fd=folder)
    except OSError:  # what else is wrong with the folder, writing a file with a name finds out
        yield None
        return
    with os.fdopen(handle, "wb") as file:
        _to_disk(file, data)
        yield handle


def _by_number(handle: int) -> str:
    """Return what an open file without a name can be linked by, where there is a ``/proc``."""
    return f"/proc/self/fd/{handle}"


def _linked(file: str, path: Path, folder: int) -> bool:
    """Give a file its name in a folder, which must be free, in one step; False where that is not possible."""
    # Only what stands for an unnamed file is a link that is to be followed.
    unnamed = file.startswith("/")
    try:
        os.link(file, path.name, src_dir_fd=folder, dst_dir_fd=folder, follow_symlinks=unnamed)
    except FileExistsError:
        refuse_taken(path)
        raise
    except OSError:  # no hard links on this disk, no /proc
        return False
    return True
