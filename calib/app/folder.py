"""The private folder of a page: what may be dropped into it, under which names, and all of it as one file.

``robot/`` in it is made anew at every look: the URDF, and its meshes where it says that they are. A person may put
files of his own into a folder that he has named: what was neither dropped nor made here is not replaced or removed.
"""

import contextlib
import errno
import io
import json
import os
import re
import shutil
import stat
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path, PurePosixPath
from typing import IO, Literal

from calib.foundations.errors import OutputError
from calib.foundations.files import (
    DAMAGED,
    LARGEST_JSON,
    is_regular,
    lstat,
    names_in,
    opened_folder,
    read_inside,
    sentences,
    stamp,
    write_atomically,
)
from calib.foundations.folders import alone_with
from calib.foundations.words import shown
from calib.measurement.formats.images import ENDINGS
from calib.results.result_file import RESULT_FILE

JOB, RESULTS, MADE, PHOTOGRAPHS, ROBOT = "calibration.toml", "results", "tables", "photographs", "robot"
RESULT = f"{RESULTS}/{RESULT_FILE}"
# What was dropped and said, for a page that is served again; no dropped file can have a name like this.
SESSION = ".session.json"
_MESHES = "meshes"  # as they were dropped
# The names of files that were made here, of those that were dropped.
_OURS = ".made.json"
# Locked while a page is served from the folder; the folder itself is locked where results are written.
_SERVED = ".served"
# Of folders that go with their page; one that was killed leaves it, and for a day ``--folder`` can go on with it.
_TEMPORARY, _LONG_AGO = "calib-app-", 86_400.0
# A table of a million rows has some 100 MB; photographs come in hundreds.
LARGEST_FILE = 200_000_000
_LARGEST_SUM = 1_000_000_000
_MOST_FILES = 1000
TOO_LARGE = (
    f"is too large; a file may have {LARGEST_FILE // 1_000_000} MB, and all together {_LARGEST_SUM // 1_000_000} MB."
)

# What an archive may hold, for each of its bytes, or of a MB where it has fewer: tables and meshes have 3 to 10.
# There could be a thousand, so that a MB would take as long to read as a table of a GB.
MOST_OF_ARCHIVE, _SMALL_ARCHIVE = 20, 1_000_000
# An archive is made in pieces of so many bytes.
_PIECE = 1 << 20
# How deep folders of a robot's description are, and how many files a person may drop with it that are of no use.
_DEEPEST, _MOST_OFFERED = 12, 5000
# Of longer paths no file is of use: every folder above one is looked at, and each costs as much as the path is long.
_LONGEST_PATH = 1000
# Nothing more can be written then, whatever file it is.
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO)
# Others are unpacked whole, however little is asked for.
_BOUNDED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

# Tables of text, which are read as they are; others become one first.
TEXTS = (".csv", ".tsv", ".txt", ".dat", ".asc", ".log")
Kind = Literal["robot", "table", "photograph", "settings", "mesh", "archive"]
_OTHERS: dict[Kind, tuple[str, ...]] = {
    "robot": (".urdf",),
    "table": (
        *TEXTS,
        *(".json", ".jsonl", ".ndjson", ".yaml", ".yml", ".xlsx", ".npz", ".mat"),
        *(".mod", ".prg", ".src", ".ls", ".script"),
    ),
    "settings": (".toml",),
    "mesh": (".stl", ".dae", ".obj", ".ply", ".off", ".glb"),
    "archive": (".zip",),
}
KINDS: dict[Kind, tuple[str, ...]] = {**_OTHERS, "photograph": ENDINGS}
_ODD = re.compile(r"[^\w.+ -]|^[. -]+", re.ASCII)
_LONGEST_NAME = 100
_SHORTER = _LONGEST_NAME - 5  # leaves place for a number


def kind_of(name: str) -> Kind:
    """Return what a file is by its ending. Raises OutputError for others."""
    for kind, endings in KINDS.items():
        if name.lower().endswith(endings):
            return kind
    listed = ", ".join(ending for endings in KINDS.values() for ending in endings)
    raise OutputError(f"{shown(name)}: is no robot, mesh, table, photograph or job; their names end with {listed}.")


def plain_name(name: str) -> str:
    """Return a name for a file that somebody called ``name``: no folder, and letters that no system stumbles over."""
    last = name.replace("\\", "/").rpartition("/")[2]
    plain = _ODD.sub("_", last) or "file"
    ending = Path(plain).suffix
    return plain.removesuffix(ending)[:_LONGEST_NAME] + ending[:_LONGEST_NAME]


@contextlib.contextmanager
def private_folder(path: Path | None) -> Iterator[Path]:
    """Give an empty folder that this user alone can enter; without a ``path`` it goes when the block ends.

    A folder that such a page has left is given as it is. Raises OutputError where ``path`` is there and none of these,
    belongs to another user, or another page is served from it; without one, where the system has no place for
    temporary files.
    """
    if path is None:
        with contextlib.ExitStack() as removed:
            try:
                made = removed.enter_context(tempfile.TemporaryDirectory(prefix=_TEMPORARY))
            except OSError as e:
                raise OutputError(f"no folder for files can be made ({e.strerror}); name one by --folder.") from e
            with _alone_in(Path(made)) as marker:
                with contextlib.suppress(OSError):  # a full disk; it is then left where this page is killed
                    os.write(marker, _marked(Path(made).name, Path(made).stat()))
                _remove_left()
                yield Path(made)
        return
    with sentences(path, OutputError, "cannot be made"):
        if os.path.lexists(path) and (path.is_symlink() or not path.is_dir() or not (_left(path) or _empty(path))):
            raise OutputError(f"{path}: already exists, and is neither empty nor left by this page; choose another.")
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Whoever owns a folder enters it, and root may serve a page from anybody's.
        if path.stat().st_uid != os.getuid():
            raise OutputError(f"{path}: belongs to another user, who could enter it; choose another.")
        path.chmod(0o700)
    with _alone_in(path) as marker:
        os.ftruncate(marker, 0)  # one that was temporary is kept from now on
        yield path.absolute()


def _remove_left() -> None:
    """Remove the temporary folders of pages that were killed, a day after they were last used; nothing else."""
    with contextlib.suppress(OSError), opened_folder(tempfile.gettempdir()) as above:
        for name in names_in(above):
            if name.startswith(_TEMPORARY):
                with contextlib.suppress(OSError):
                    _remove_dead(name, above)


def _remove_dead(name: str, above: int) -> None:
    """Remove a folder if it is this user's own, its marker says that it is temporary, and nobody holds the marker.

    A copy has another number than the marker says, or another name, and what ``--folder`` has named says nothing.
    """
    with opened_folder(name, above) as folder:
        found = os.fstat(folder)
        if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) != 0o700 or _is_recent(found):
            return
        marker = os.open(_SERVED, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=folder)
        with os.fdopen(marker, "rb") as file:
            ours = is_regular(_SERVED, folder) and file.read(_LONGEST_NAME) == _marked(name, found)
            if ours and alone_with(marker, where_unknown=False):
                _empty_out(folder)
                os.rmdir(name, dir_fd=above)


def _empty_out(folder: int) -> None:
    """Remove what is in an opened folder, whatever has its name now; the marker last, by which what stays is found."""
    for name in sorted(names_in(folder), key=lambda name: name == _SERVED):
        found = lstat(name, folder)
        if found is not None and stat.S_ISDIR(found.st_mode):
            shutil.rmtree(name, dir_fd=folder)
        else:
            os.unlink(name, dir_fd=folder)


def _is_recent(found: os.stat_result) -> bool:
    return time.time() - found.st_mtime < _LONG_AGO


def _marked(name: str, folder: os.stat_result) -> bytes:
    """Return what the marker of a temporary folder says: in which one it was made."""
    return f"temporary {name} {folder.st_ino}".encode(errors="replace")


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[int]:
    """Keep other pages out of a folder: of two, each would write what it knows over what the other one knows.

    Gives a descriptor of the file that is locked.
    """
    with sentences(folder, OutputError, "files cannot be kept in it"):
        handle = os.open(folder / _SERVED, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OutputError(f"{folder}: its {_SERVED} is not a regular file; choose another folder.")
        if not alone_with(handle):
            raise OutputError(f"{folder}: another page is served from it; end that one, or choose another folder.")
        yield handle
    finally:
        os.close(handle)


def _empty(folder: Path) -> bool:
    return all(path.name == _SERVED for path in folder.iterdir())


def _left(folder: Path) -> bool:
    """Return whether a page of this user has left the folder: it alone could enter, and no link leads out of it."""
    found = folder.stat()
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) != 0o700 or not (folder / SESSION).is_file():
        return False
    every = (Path(at, name) for at, folders, names in os.walk(folder) for name in (*folders, *names))
    return not any(path.is_symlink() for path in every)


def chosen(paths: Sequence[str], *, packed: bool = False) -> dict[str, str]:
    """Return which files of dropped folders, or ``packed`` in an archive, are of use, and what each is called.

    What lies in no folder is left to :func:`take`, which says what it is not. In the folder of a package, which
    ``package.xml`` marks, the robot and its meshes are of use; a picture beside a mesh is its texture. Tables of one
    name in several folders have these in their names. Paths of more than 1000 characters are left out. Raises
    OutputError where there are too many.
    """
    if len(paths) > _MOST_OFFERED:
        raise OutputError(f"{len(paths)} files are too many; allowed are {_MOST_OFFERED}.")
    plain = {path: PurePosixPath(path.replace("\\", "/")) for path in paths if len(path) <= _LONGEST_PATH}
    packages = {path.parent for path in plain.values() if path.name == "package.xml"}
    beside = {path.parent for path in plain.values() if _known(path) == "mesh"}
    found = {}
    for name, path in plain.items():
        kind = _known(path)
        hidden = any(part.startswith((".", "__MACOSX")) for part in path.parts)
        described = kind in ("robot", "mesh") or not packages.intersection(path.parents)
        texture = kind == "photograph" and path.parent in beside
        alone = len(path.parts) == 1 and not packed
        if alone or (kind not in (None, "archive") and described and not hidden and not texture):
            found[name] = path
    same = Counter(path.name for path in found.values() if _known(path) != "mesh")
    return {
        name: str(path) if _known(path) == "mesh" else "_".join(path.parts) if same[path.name] > 1 else path.name
        for name, path in found.items()
    }


def apart(names: Mapping[str, str], called: Mapping[str, str]) -> dict[str, str]:
    """Return the name that each file gets here: none takes the place of one that is called otherwise.

    Names get numbers where several become one when they are made plain. A mesh gets a folder with the number: a robot's
    path to it then ends as those of several, and none is taken. ``called``: what those that are here are called.
    """
    own: dict[str, list[str]] = {}
    for kept, name in reversed(list(called.items())):
        own.setdefault(name, []).append(kept)
    others = {kept.lower() for kept in called}
    found: dict[str, str] = {}
    numbers: Counter[str] = Counter()
    for path, name in names.items():
        if own.get(name):
            found[path] = own[name].pop()
            continue
        plain = kept = name if (kind := _known(PurePosixPath(name))) is None else name_here(name)
        number = numbers[plain.lower()]
        while kind is not None and kept.lower() in others:
            number = max(number + 1, 2)
            ending = Path(plain).suffix
            kept = (
                f"{number}/{plain}" if kind == "mesh" else f"{plain.removesuffix(ending)[:_SHORTER]}_{number}{ending}"
            )
        numbers[plain.lower()] = number
        others.add(kept.lower())
        found[path] = kept
    return found


def _known(path: PurePosixPath) -> Kind | None:
    try:
        return kind_of(path.name)
    except OutputError:
        return None


def unpacked(data: bytes, name: str, called: Mapping[str, str]) -> Iterator[tuple[str, str, bytes]]:
    """Give the files of use in a ZIP archive, one after the other: the name that each gets here, and what it is called.

    ``called``: as of :func:`apart`.

    Links in the archive are left out. Of a file that is too large, a byte more than may be is given. Raises OutputError
    where the archive cannot be read, holds nothing of use, or unpacks to more than anything that is measured.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if len(archive.infolist()) > _MOST_OFFERED:
                raise OutputError(f"{shown(name)}: holds more than {_MOST_OFFERED} files.")
            inside = {one.filename: one for one in archive.infolist() if not one.is_dir() and not _is_link(one)}
            wanted = chosen(list(inside), packed=True)
            kept = apart(wanted, called)
            if not wanted:
                raise OutputError(f"{shown(name)}: holds no robot, mesh, table, photograph or job.")
            if len(wanted) > _MOST_FILES:
                raise OutputError(f"{shown(name)}: holds more than the {_MOST_FILES} files that are allowed.")
            if any(inside[path].compress_type not in _BOUNDED for path in wanted):
                raise OutputError(
                    f"{shown(name)}: is packed by another method than the usual one (deflate); pack it anew."
                )
            # The sizes that an archive tells need not be so, but zipfile unpacks no more than they are.
            most = MOST_OF_ARCHIVE * max(len(data), _SMALL_ARCHIVE)
            if sum(inside[path].file_size for path in wanted) > most:
                raise OutputError(
                    f"{shown(name)}: unpacks to more than {most // 1_000_000} MB; unpack it, and drop what is in it."
                )
            for path, its_name in wanted.items():
                with archive.open(inside[path]) as file:
                    contents = file.read(LARGEST_FILE + 1)
                yield kept[path], its_name, contents
    except OutputError:
        raise
    except (zipfile.BadZipFile, *DAMAGED) as e:
        locked = "is locked by a password" if "password" in str(e) else "is no archive that can be read"
        raise OutputError(f"{shown(name)}: {locked}.") from e


def _is_link(one: zipfile.ZipInfo) -> bool:
    return stat.S_ISLNK(one.external_attr >> 16)


def gather(folder: Path, robot: str, uris: Sequence[str], meshes: Sequence[str]) -> tuple[str, list[str]]:
    """Put a dropped robot into its own folder, and dropped meshes where its ``uris`` say that they are.

    Returns the path of the URDF there, and the uris for which there is no mesh: that is the one whose path ends most
    alike, its file's name at least; of several that end alike, none can be told from the others. Raises OutputError
    where nothing can be written, or a person's own file is in the way.
    """
    dropped = [PurePosixPath(name).parts for name in meshes]
    lost: list[str] = []
    found: dict[str, tuple[str, PurePosixPath]] = {}
    every = tuple(dict.fromkeys(uris))
    # Each is compared with all that were dropped; more shapes are not drawn either.
    for uri in every[:_MOST_FILES]:
        rest = uri.partition("://")[2] if "://" in uri else uri
        parts = [part for part in rest.split("/") if part not in ("", ".", "..")]
        best = _likest([plain_name(part) for part in parts], dropped)
        if best is None or uri.startswith(("file:", "/")) or "\0" in uri or len(parts) > _DEEPEST:
            lost.append(uri)
        else:
            found[uri] = "/".join((ROBOT, *parts)), best
    urdf = f"{ROBOT}/{robot}"
    # One mesh may be asked for by any number of paths, and each of them gets it.
    copied = (stamp(folder / _MESHES / best) for best in dict(found.values()).values())
    if sum(one[1] for one in copied if one is not None) > _LARGEST_SUM:
        raise OutputError(
            f"{shown(robot)}: its meshes, at all paths by which it names them, have more than the "
            f"{_LARGEST_SUM // 1_000_000} MB that are allowed; drop fewer of them."
        )
    _remove_made(folder)
    refuse_other_files(folder, {urdf, *(name for name, _ in found.values())})
    with sentences(urdf, OutputError, "cannot be written"):
        (folder / ROBOT).mkdir(mode=0o700, exist_ok=True)
        (folder / urdf).write_bytes(read_inside(folder, robot, OutputError, LARGEST_FILE))
    for uri, (name, best) in found.items():
        place = folder / name
        try:
            place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not place.exists():  # as where two uris are one path
                # What has taken the place of a dropped file, as a device that has no end, is not copied.
                place.write_bytes(read_inside(folder / _MESHES, str(best), OutputError, LARGEST_FILE))
        except OSError as e:
            if e.errno in _UNWRITABLE:
                raise OutputError(f"{ROBOT}: meshes cannot be written ({e.strerror}).") from e
            lost.append(uri)
    return urdf, [*lost, *every[_MOST_FILES:]]


def refuse_other_files(folder: Path, names: Collection[str]) -> None:
    """Raise OutputError where files that are about to be made would replace others that were not made here.

    Else keep their names: such files are replaced and removed from now on.
    """
    made = _made_here(folder)
    refuse_links(folder, (folder / name for name in names))
    for name in names:
        if name not in made and os.path.lexists(folder / name):
            raise OutputError(f"{shown(name)}: was not made by this page, and is not replaced; move it away.")
    write_atomically(folder / _OURS, json.dumps(sorted(made.union(names))))


def _remove_made(folder: Path) -> None:
    """Remove what :func:`gather` has made, and the folders that are then empty. Raises OutputError for links."""
    gone = {name for name in _made_here(folder) if name.startswith(f"{ROBOT}/")}
    refuse_links(folder, (folder / name for name in gone))
    for name in gone:
        with contextlib.suppress(OSError):
            (folder / name).unlink()
    above = {inside for name in gone for inside in PurePosixPath(name).parents if inside.parts}
    for inside in sorted(above, key=lambda path: len(path.parts), reverse=True):
        with contextlib.suppress(OSError):
            (folder / inside).rmdir()


def _made_here(folder: Path) -> frozenset[str]:
    """Return the names of files that were made here; none where no list can be read."""
    try:
        names = json.loads(read_inside(folder, _OURS, OutputError, LARGEST_JSON))
        return frozenset(name for name in names if name.startswith((f"{ROBOT}/", f"{MADE}/")) and ".." not in name)
    except DAMAGED:
        return frozenset()


def _likest(parts: Sequence[str], dropped: Sequence[tuple[str, ...]]) -> PurePosixPath | None:
    def same(path: Sequence[str]) -> int:
        pairs = zip(reversed(parts), reversed(path), strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

    alike = {path: same(path) for path in dropped}
    most = max(alike.values(), default=0)
    best = [path for path, count in alike.items() if count == most]
    return PurePosixPath(*best[0]) if most and len(best) == 1 else None


def take(folder: Path, name: str, data: bytes, there: Mapping[str, int]) -> str:
    """Write a dropped file under a plain name, in the place of one of that name, and return this name.

    ``there``: sizes of those that were dropped before. Raises OutputError where it is none that can be used, the folder
    has enough, or a file of that name is there that was not dropped.
    """
    plain = name_here(name)
    place = _place(folder, plain)
    refuse_links(folder, [place])
    others = [size for known, size in there.items() if known != plain]
    if len(others) >= _MOST_FILES:
        raise OutputError(f"{shown(plain)}: is one file more than the {_MOST_FILES} that are allowed.")
    if len(data) > LARGEST_FILE or len(data) + sum(others) > _LARGEST_SUM:
        raise OutputError(f"{shown(plain)}: {TOO_LARGE}")
    if plain not in (*there, JOB) and os.path.lexists(place) and not _holds(place, data):
        raise OutputError(f"{shown(plain)}: is in the folder, but was not dropped on this page; move it away.")
    with sentences(shown(plain), OutputError, "cannot be kept"):  # such as for a file where a folder is to be
        place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_atomically(place, data)
    return plain


def _holds(place: Path, data: bytes) -> bool:
    """Return whether a file holds just this, as of a page that was killed before it could write down what it has."""
    with contextlib.suppress(OutputError):
        return read_inside(place.parent, place.name, OutputError, len(data)) == data
    return False


def remove(folder: Path, name: str) -> None:
    """Remove a dropped file, if it is there. Raises OutputError where it cannot be."""
    place = _place(folder, name_here(name))
    refuse_links(folder, [place])
    with sentences(shown(name), OutputError, "cannot be removed"):
        place.unlink(missing_ok=True)


def refuse_links(folder: Path, places: Iterable[Path]) -> None:
    """Raise OutputError where a folder between this one and a file in it is a link: the file would be somebody else's.

    A person may have put the link there while the page is served.
    """
    for above in sorted({above for place in places for above in place.parents if folder in above.parents}):
        if os.path.islink(above):  # noqa: PTH114 - also of a name longer than the file system takes
            raise OutputError(f"{shown(above.name)}: is a link, which this page does not follow; move it away.")


def is_there(folder: Path, name: str) -> bool:
    """Return whether a dropped file of this name is in the folder."""
    return name_here(name) == name and _place(folder, name).is_file()


def stamps(folder: Path, dropped: Iterable[str]) -> dict[str, list[int] | None]:
    """Return what changes when a file does, of those that count, by name: what was dropped or made, job, results."""
    places = (_place(folder, name).relative_to(folder).as_posix() for name in dropped)
    found = {name: stamp(folder / name) for name in {*places, *_made_here(folder), JOB, RESULT}}
    return {name: None if one is None else list(one) for name, one in found.items()}


def name_here(name: str) -> str:
    """Return the name of a dropped file; that of a mesh keeps its folders, which tell it from others."""
    if kind_of(name) != "mesh":
        return plain_name(name)
    return "/".join(plain_name(part) for part in name.replace("\\", "/").split("/")[-_DEEPEST:] if part)


def _place(folder: Path, plain: str) -> Path:
    inside = {"photograph": PHOTOGRAPHS, "mesh": _MESHES}.get(kind_of(plain))
    return folder / plain if inside is None else folder / inside / plain


def as_zip(folder: Path, *, results: bool = True, wanted: Callable[[], bool] = lambda: True) -> IO[bytes]:
    """Return an open file with all regular files of the folder, as a ZIP archive, from its beginning.

    ``results``: whether those in the folder are of what else it holds. Ends soon when the archive is not ``wanted`` any
    more. Raises OutputError then, and where it cannot be made, as on a full disk.
    """
    # Of a full disk a temporary file tells once more when it is closed.
    with sentences("The archive", OutputError, "cannot be made"), contextlib.ExitStack() as stack:
        archive = stack.enter_context(tempfile.TemporaryFile())
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as into:
            for path in _shown_to_others(folder, results=results):
                entry = zipfile.ZipInfo.from_file(
                    path, Path("calibration") / path.relative_to(folder), strict_timestamps=False
                )
                entry.compress_type = zipfile.ZIP_DEFLATED
                with path.open("rb") as file, into.open(entry, "w") as there:
                    while piece := file.read(_PIECE):
                        if not wanted():
                            raise OutputError("The archive: is not wanted any more.")
                        there.write(piece)
        archive.seek(0)
        stack.pop_all()  # whoever asked closes it
        return archive


def _shown_to_others(folder: Path, *, results: bool) -> Iterator[Path]:
    """Give the regular files that a person takes along, none behind a link."""
    inner = [folder / name for name in (MADE, PHOTOGRAPHS, ROBOT, *([RESULTS] if results else []))]
    for place in (folder, *(one for one in inner if not one.is_symlink())):
        inside = place.rglob("*") if place.name == ROBOT else place.iterdir()
        for path in sorted(inside) if place.is_dir() else ():
            if path.is_file() and not path.is_symlink() and path.name not in (SESSION, _OURS, _SERVED):
                yield path
