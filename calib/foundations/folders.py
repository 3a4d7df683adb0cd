"""Folders that appear whole or not at all.

A folder cannot take another's place in one step everywhere, so it is done in two, within a hidden folder beside it,
``.<name>.XXXXXXXX.calib``: the new one is written there as ``new``; the old one steps aside to ``old``, and ``new``
becomes ``<name>``. Killed before, the old one is there; killed after, the new one; killed between, the next reader or
writer puts the old one back. A lock on the folder above, which the system frees however a process ends, keeps others
from seeing the moment between.

What a killed run left is touched only where the hidden folder is of this user and holds the list that the run began
with; of what is in it, only regular files on that list are removed. All is done by descriptors of folders, never by
paths and never through links: a folder or a link that takes the place of another changes nothing elsewhere.
"""

import contextlib
import errno
import fcntl
import json
import os
import re
import stat
import sys
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.foundations.errors import CalibError, KeptError, OutputError
from calib.foundations.files import (
    create,
    encoded,
    hidden,
    is_regular,
    lstat,
    names_in,
    names_to_disk,
    nearest_folder,
    opened_folder,
    refuse_long,
    refuse_taken,
)

# In the hidden folder: the one that is written, the one that stood there, and the list of what may be removed in both.
_NEW, _OLD, _LIST = "new", "old", "list.json"
_MARK = "files of an unfinished run of calib, which the next one removes"
_LARGEST_LIST = 100_000
# Whom else a folder of Linux lets in, and what is made in it.
_ACCESS_LISTS = ("system.posix_acl_access", "system.posix_acl_default")
# What keeps a folder where it is, by the number of the error.
_UNMOVED = {
    errno.EBUSY: "is a mount point, which cannot be replaced; choose a folder inside",
    errno.EXDEV: (
        "is part of what a container was started from (a lower layer of an overlay), where folders cannot be moved; "
        "remove it or choose another one"
    ),
}
# How long to wait for another run to read or write beside a folder, in s: it takes moments.
_PATIENCE = 30.0
_LOOK = 0.02
# What paths may raise: also for links in a circle, and zero bytes in names.
_ANY = (OSError, RuntimeError, ValueError)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a folder is to be: its path, for sentences, and the descriptor of the folder above."""

    path: Path
    above: int

    @property
    def name(self) -> str:
        return self.path.name

    def taken(self) -> bool:
        return lstat(self.name, self.above) is not None


@dataclass(frozen=True, slots=True)
class _Work:
    """A hidden folder of ours: its name, its descriptor, and the names of files that may be removed in it."""

    name: str
    handle: int
    listed: frozenset[str]


def write_folder(path: Path, files: Mapping[str, bytes | str], older: Collection[str] = ()) -> None:
    """Write a folder of files, which takes the place of ``path`` (no link: resolved) when all are on the disk.

    On any error ``path`` is untouched and nothing is left. Of a folder that already exists, regular files called as
    one of ``older`` are removed; anything else, which somebody has put there, is moved to the new one. Without
    ``older`` none may be there. Raises OutputError when the disk is full, the folder read-only, or another run keeps it
    for too long.
    """
    with _telling(path, "the results cannot be written", _ANY):
        if os.path.lexists(path) and (path.is_symlink() or not path.is_dir()):
            raise OutputError(f"{path}: is a file or a link, and the results need a folder.")
        if not older and path.is_dir() and any(path.iterdir()):
            # It may be of a run that was killed when it was whole, and nobody else comes to clean up.
            clear_left(path)
            refuse_taken(path)
        with _made(path.parent), opened_folder(path.parent) as above:
            if older:
                _refuse_led_away(path, above)
            _write(_Place(path, above), files, older)


def clear_left(path: Path, patience: float = _PATIENCE) -> None:
    """Remove what runs that were killed left beside a folder that nobody is about to write; what cannot be, stays."""
    with contextlib.suppress(OSError), opened_folder(path.parent) as above:
        place = _Place(path, above)
        with _locked(place, fcntl.LOCK_EX, patience):
            _clean(place)


def _refuse_led_away(path: Path, above: int) -> None:
    """Raise OutputError where a folder above has become a link: what may be replaced was looked at in another one."""
    if path.parent.resolve() != path.parent or not os.path.samestat(path.parent.stat(), os.fstat(above)):
        raise OutputError(f"{path}: a folder above it is a link now, or has been moved; run it again.")


@contextlib.contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Make a folder, and those above it, that are not there yet; an error in the block leaves none of them empty.

    Raises OutputError when they cannot be made.
    """
    with contextlib.ExitStack() as made:
        with _telling(path, "cannot be made"):
            made.enter_context(_made(path))
        yield


@contextlib.contextmanager
def _made(path: Path) -> Iterator[None]:
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        if lost := next((folder for folder in made if folder.is_symlink()), None):
            raise OutputError(f"{path}: cannot be made, as {lost} is a link that leads nowhere.")
        path.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def real_folder(path: Path) -> Path:
    """Return the folder that is meant by a path, free of links and ``..``, whether it is there or not.

    Raises OutputError where no way leads there: links in a circle, or ``..`` behind what is no folder, which only a
    program that reads the path as a text would take for the folder above.
    """
    with _telling(path, "cannot hold the results", _ANY):
        parts = path.parts
        for before in (Path(*parts[:k]) for k, part in enumerate(parts) if part == ".." and k):
            if not before.is_dir():
                raise OutputError(f"{path}: leads through {before}, which is no folder.")
        if path.exists() and not (path.is_dir() or path.is_file()):
            raise OutputError(f"{path}: is a pipe or a device, and the results need a folder.")
        return path.resolve()


def still_meant(path: Path, meant: Path | None) -> Path:
    """Return the folder that is meant by a path, as :func:`real_folder`.

    ``meant``: to what it led when the work began. Raises OutputError where it leads elsewhere now: that folder was
    never asked for.
    """
    found = real_folder(path)
    if meant not in (None, found):
        raise OutputError(f"{path}: leads to {found} now, and led to {meant} when the work began; run it again.")
    return found


def refuse_unwritable(path: Path, *, exchanged: bool = True) -> None:
    """Raise OutputError for a folder that cannot be made or written; what only the attempt shows, the attempt tells.

    ``exchanged``: whether a new one takes its place, for which the folder above must be written as well.
    """
    with _telling(path, "cannot hold the results"):
        parent = nearest_folder(path)
        if not parent.is_dir():
            raise OutputError(f"{path}: cannot be made, as {parent} is a file.")
        refuse_long(path)
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, and the results need a folder.")
        for folder in (parent, path) if exchanged or not path.exists() else (path,):
            if folder.exists() and not os.access(folder, os.W_OK | os.X_OK):
                raise OutputError(f"{path}: cannot be written, as {folder} is read-only.")
        os.umask(mask := os.umask(0o077))  # it is told by setting it alone
        if mask & stat.S_IRWXU and os.geteuid() != 0:
            raise OutputError(
                f"{path}: cannot be written, as the umask {mask:04o} takes the permissions of what is made from its "
                "own user; set another one: umask 022."
            )


def refuse_kept(path: Path) -> None:
    """Raise OutputError for a folder, or one with files, of another user that only this one may move away."""
    with _telling(path, "cannot hold the results"):
        if not path.exists():
            return
        above, own = path.parent.stat(), path.stat()
        if _is_kept(own, above):
            raise OutputError(
                f"{path}: belongs to another user, and in {path.parent} (sticky) nobody else may replace it; "
                "choose another folder."
            )
        for entry in path.iterdir():
            if _is_kept(entry.lstat(), own):
                raise OutputError(
                    f"{path}: holds {entry.name!r} of another user, and in it (sticky) nobody else may replace that; "
                    "choose another folder."
                )


def _is_kept(one: os.stat_result, folder: os.stat_result) -> bool:
    """Return whether a folder is one, as ``/tmp`` is, in which this user may not move or remove what another has."""
    return bool(folder.st_mode & stat.S_ISVTX) and os.geteuid() not in (0, one.st_uid, folder.st_uid)


@contextlib.contextmanager
def reading_folder(path: Path, patience: float = _PATIENCE) -> Iterator[None]:
    """Keep a folder as it is while the block reads it: another run waits before it replaces it.

    What a killed run left is put right first. Whether there is such a folder, the block finds out. Raises OutputError
    when what was left cannot be put right; KeptError when another run keeps the folder for longer than ``patience``, in
    seconds.
    """
    with contextlib.ExitStack() as closing:
        place = None
        # What no path leads to, the block cannot read, and says so; a folder whose names may not be listed is not kept.
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            path = path.resolve()
            place = _Place(path, closing.enter_context(opened_folder(path.parent)))
        if place is None:
            yield
            return
        while True:
            with _locked(place, fcntl.LOCK_SH, patience):
                if _settled(place):
                    yield
                    return
            _recover(place, patience)


def _settled(place: _Place) -> bool:
    """Return whether nothing is to be put right before a folder is read; what hides from this user, he cannot."""
    try:
        return place.taken() or not any(map(_stands_aside, _works(place)))
    except OSError:
        return True


def _write(place: _Place, files: Mapping[str, bytes | str], older: Collection[str]) -> None:
    with contextlib.ExitStack() as ending:
        with _locked(place, fcntl.LOCK_EX):
            _clean(place)
            work = ending.enter_context(_begun(place, {*files, *older}))
        os.mkdir(_NEW, dir_fd=work.handle)
        with opened_folder(_NEW, work.handle) as new:
            found = lstat(place.name, place.above)
            if found is not None and stat.S_ISDIR(found.st_mode):
                with opened_folder(place.name, place.above) as old:
                    _let_in_as(found, _access_lists(old), new)
            for name, contents in files.items():
                create(name, new, encoded(contents) if isinstance(contents, str) else contents)
            names_to_disk(new)
        names_to_disk(work.handle)
        with _locked(place, fcntl.LOCK_EX):
            try:
                _exchange(place, work, replaced=bool(older))
            finally:
                with contextlib.suppress(OSError):  # what stays does no harm, and the next run comes back to it
                    _end(place, work)


@contextlib.contextmanager
def _begun(place: _Place, listed: Collection[str]) -> Iterator[_Work]:
    """Make a hidden folder, which only this user can enter; in the end nothing is left of it."""
    name = hidden(place.name, "calib")
    with contextlib.ExitStack() as closing:
        try:
            os.mkdir(name, 0o700, dir_fd=place.above)
            handle = closing.enter_context(opened_folder(name, place.above))
            if names_in(handle):
                raise OutputError(f"{place.path}: another folder has taken the place of {name}; try again.")
            _had(handle, fcntl.LOCK_EX)  # tells others that it is being written
        except FileExistsError:
            raise
        except BaseException:  # Ctrl-C; or a umask leaves not even this user a folder that can be entered
            with contextlib.suppress(OSError):
                os.rmdir(name, dir_fd=place.above)
            raise
        work = _Work(name, handle, frozenset(listed))
        try:
            create(_LIST, handle, json.dumps({"calib": _MARK, "files": sorted(listed)}).encode())
            names_to_disk(place.above)
            yield work
        finally:
            with contextlib.suppress(OSError):
                _end(place, work)


def _let_in_as(old: os.stat_result, lists: Mapping[str, bytes], new: int) -> None:
    """Let those into a new folder whom the old one lets in; its group, too, where this user may give it to that."""
    mode, made = stat.S_IMODE(old.st_mode), os.fstat(new)
    if made.st_gid != old.st_gid:
        try:
            os.fchown(new, -1, old.st_gid)
        except OSError:  # another group may do no more than everybody
            mode, lists = mode & ~(stat.S_ISGID | stat.S_IRWXG) | (mode & stat.S_IRWXO) << 3, {}
    if not _set_access_lists(new, lists):
        mode = mode & ~stat.S_IRWXG | (mode & stat.S_IRWXO) << 3
    if mode != stat.S_IMODE(os.fstat(new).st_mode):
        with contextlib.suppress(OSError):  # a file system without permissions
            os.fchmod(new, mode)


def _access_lists(folder: int) -> dict[str, bytes]:
    """Return the access control lists of a folder; where it has one, its mode does not tell what its group may do."""
    found = {}
    if sys.platform == "linux":
        for name in _ACCESS_LISTS:
            with contextlib.suppress(OSError):  # it has none, or the file system knows none
                found[name] = os.getxattr(folder, name)
    return found


def _set_access_lists(folder: int, lists: Mapping[str, bytes]) -> bool:
    """Give a new folder these access control lists and no other, as of the folder above; return whether it has them."""
    if sys.platform == "linux":
        for name in _access_lists(folder).keys() - lists.keys():
            with contextlib.suppress(OSError):
                os.removexattr(folder, name)
        with contextlib.suppress(OSError):
            for name, entries in lists.items():
                os.setxattr(folder, name, entries)
    return _access_lists(folder) == lists


def _exchange(place: _Place, work: _Work, *, replaced: bool) -> None:
    _clean(place)
    found = lstat(place.name, place.above) if replaced else None
    if found is not None:
        if not stat.S_ISDIR(found.st_mode):
            raise OutputError(f"{place.path}: is no folder any more; choose another.")
        with _said_of_moving(place.path):
            os.rename(place.name, _OLD, src_dir_fd=place.above, dst_dir_fd=work.handle)
    try:
        os.rename(_NEW, place.name, src_dir_fd=work.handle, dst_dir_fd=place.above)
    except OSError as e:
        if found is None:
            with _said_of_moving(place.path):
                raise
        if place.taken():
            kept = place.path.with_name(work.name) / _OLD
            raise OutputError(f"{place.path}: another has taken its place meanwhile; what was there is {kept}.") from e
        # Not left to the end, which finds that the old one has a successor where somebody took the new one away.
        os.rename(_OLD, place.name, src_dir_fd=work.handle, dst_dir_fd=place.above)
        raise
    try:
        names_to_disk(place.above)
    except OSError:  # the end puts the old one back
        os.rename(place.name, _NEW, src_dir_fd=place.above, dst_dir_fd=work.handle)
        raise


@contextlib.contextmanager
def _said_of_moving(path: Path) -> Iterator[None]:
    """Say why a folder cannot be moved, or none take its place, where the system's word for it does not."""
    try:
        yield
    except OSError as e:
        why = _UNMOVED.get(e.errno or 0)
        if why is None:
            raise
        raise OutputError(f"{path}: {why}.") from e


def _end(place: _Place, work: _Work) -> None:
    """Put the old folder back if it has no successor; else remove it, what was half written, and the hidden folder."""
    _put_back(place, work)
    if not _stands_aside(work):
        with contextlib.ExitStack() as closing:
            successor = None
            with contextlib.suppress(OSError):
                successor = closing.enter_context(opened_folder(place.name, place.above))
            _remove(work, _OLD, successor)
        _remove(work, _NEW)
    if names_in(work.handle) == [_LIST]:
        os.unlink(_LIST, dir_fd=work.handle)
    os.rmdir(work.name, dir_fd=place.above)


def _stands_aside(work: _Work) -> bool:
    """Return whether a run was killed between the two steps, so that the old folder has no successor yet.

    What is no folder no run has put aside: a link by which results would be led elsewhere from now on.
    """
    old = lstat(_OLD, work.handle)
    return old is not None and stat.S_ISDIR(old.st_mode) and lstat(_NEW, work.handle) is not None


def _put_back(place: _Place, work: _Work) -> None:
    """Let the old folder be there again, where it has no successor and nobody has put another since."""
    if _stands_aside(work) and not place.taken():
        os.rename(_OLD, place.name, src_dir_fd=work.handle, dst_dir_fd=place.above)


def _remove(work: _Work, part: str, successor: int | None = None) -> None:
    """Remove a folder in a hidden one, but no file that is not listed: such go to its successor, or stay."""
    with contextlib.suppress(OSError), opened_folder(part, work.handle) as folder:
        for name in names_in(folder):
            with contextlib.suppress(OSError):
                if name in work.listed and is_regular(name, folder):
                    os.unlink(name, dir_fd=folder)
                elif successor is not None and lstat(name, successor) is None:
                    os.rename(name, name, src_dir_fd=folder, dst_dir_fd=successor)
        os.rmdir(part, dir_fd=work.handle)


def _works(place: _Place) -> Iterator[_Work]:
    """Give the hidden folders beside a folder that are of this user and hold a list; others are nobody's business."""
    pattern = re.compile(rf"\.{re.escape(place.name)}\.[0-9a-f]{{8}}\.calib")
    for name in names_in(place.above):
        if pattern.fullmatch(name):
            with contextlib.ExitStack() as closing:
                try:
                    handle = closing.enter_context(opened_folder(name, place.above))
                    listed = _list_in(handle)
                except OSError:  # a link, a file, somebody else's; or its own run has just removed it
                    continue
                if listed is not None:
                    yield _Work(name, handle, listed)


def _list_in(folder: int) -> frozenset[str] | None:
    """Return the list that a run of this user began with; an empty one where it was killed before it could write it."""
    if os.fstat(folder).st_uid != os.geteuid():
        return None
    there = names_in(folder)
    if not there:
        return frozenset()
    handle = os.open(_LIST, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=folder)
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(handle)
        if not (stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid() and found.st_nlink == 1):
            return None
        data = file.read(_LARGEST_LIST)
    if not data and there == [_LIST]:
        return frozenset()
    try:
        contents = json.loads(data)
        return frozenset(map(str, contents["files"])) if contents["calib"] == _MARK else None
    except (ValueError, LookupError, TypeError, RecursionError):
        return None


def _recover(place: _Place, patience: float) -> None:
    """Put right what a killed run left: where only the old folder is there, aside, it takes its place again."""
    telling = _telling(place.path, "what an interrupted run left cannot be repaired")
    with telling, _locked(place, fcntl.LOCK_EX, patience):
        for work in _works(place):
            _put_back(place, work)


def _clean(place: _Place) -> None:
    """End what runs that were killed have begun; what a living one writes, it has locked."""
    for work in _works(place):
        _put_back(place, work)
        if _had(work.handle, fcntl.LOCK_EX):
            with contextlib.suppress(OSError):
                _end(place, work)


@contextlib.contextmanager
def _locked(place: _Place, kind: int, patience: float = _PATIENCE) -> Iterator[None]:
    """Hold a lock on the folder above.

    The folder itself is locked: nothing is left behind, and readers need not write. A file system that has no such
    locks does without. Raises KeptError when another run holds it for too long.
    """
    until = time.monotonic() + patience
    while (had := _had(place.above, kind)) is None:
        if time.monotonic() > until:
            raise KeptError(f"{place.path}: another run is writing here; try again when it has ended.")
        time.sleep(_LOOK)
    try:
        yield
    finally:
        if had:
            fcntl.flock(place.above, fcntl.LOCK_UN)


def alone_with(handle: int, *, where_unknown: bool = True) -> bool:
    """Lock an open file until it is closed; return False where another process holds it.

    Where a file system knows no locks, nobody can be told from anybody, and it is ``where_unknown``.
    """
    had = _had(handle, fcntl.LOCK_EX)
    return where_unknown if had is False else had is True


def _had(handle: int, kind: int) -> bool | None:
    """Return whether a lock was got, or None where another process holds it."""
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return None
    except OSError:  # some network file systems
        return False
    return True


@contextlib.contextmanager
def _telling(path: Path, what: str, kinds: tuple[type[Exception], ...] = (OSError,)) -> Iterator[None]:
    """Say what errors of some kinds in the block mean for a path; what is a sentence already stays one."""
    try:
        yield
    except CalibError:
        raise
    except kinds as e:
        reason = e.strerror if isinstance(e, OSError) else None
        if isinstance(e, RuntimeError):
            reason = "a symbolic link leads in a circle"
        raise OutputError(f"{path}: {what} ({reason or e}).") from e
