"""The private folder of a page: what may be dropped into it, under which names, and all of it as one file."""

import contextlib
import os
import re
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Literal

from calib.foundations.errors import OutputError
from calib.foundations.files import write_atomically
from calib.foundations.words import shown
from calib.measurement.formats.images import ENDINGS

JOB, RESULTS, MADE, PHOTOGRAPHS = "calibration.toml", "results", "tables", "photographs"
# A table of a million rows has some 100 MB; photographs come in hundreds.
LARGEST_FILE = 200_000_000
_LARGEST_SUM = 1_000_000_000
_MOST_FILES = 1000
TOO_LARGE = (
    f"is too large; a file may have {LARGEST_FILE // 1_000_000} MB, and all together {_LARGEST_SUM // 1_000_000} MB."
)

Kind = Literal["robot", "table", "photograph", "settings"]
_OTHERS: dict[Kind, tuple[str, ...]] = {
    "robot": (".urdf",),
    "table": (
        *(".csv", ".tsv", ".txt", ".dat", ".asc", ".log"),
        *(".json", ".jsonl", ".ndjson", ".yaml", ".yml", ".xlsx", ".npz"),
    ),
    "settings": (".toml",),
}
KINDS: dict[Kind, tuple[str, ...]] = {**_OTHERS, "photograph": ENDINGS}
_ODD = re.compile(r"[^\w.+ -]|^[. -]+", re.ASCII)
_LONGEST_NAME = 100


def kind_of(name: str) -> Kind:
    """Return what a file is by its ending. Raises OutputError for others."""
    for kind, endings in KINDS.items():
        if name.lower().endswith(endings):
            return kind
    listed = ", ".join(ending for endings in KINDS.values() for ending in endings)
    raise OutputError(f"{shown(name)}: is no robot, table, photograph or job; their names end with {listed}.")


def plain_name(name: str) -> str:
    """Return a name for a file that somebody called ``name``: no folder, and letters that no system stumbles over."""
    last = name.replace("\\", "/").rpartition("/")[2]
    plain = _ODD.sub("_", last) or "file"
    ending = Path(plain).suffix
    return plain.removesuffix(ending)[:_LONGEST_NAME] + ending[:_LONGEST_NAME]


@contextlib.contextmanager
def private_folder(path: Path | None) -> Iterator[Path]:
    """Give an empty folder that this user alone can enter; without a ``path`` it goes when the block ends.

    Raises OutputError where ``path`` is there and not an empty folder.
    """
    if path is None:
        with tempfile.TemporaryDirectory(prefix="calib-app-") as made:
            yield Path(made)
        return
    try:
        if os.path.lexists(path) and (path.is_symlink() or not path.is_dir() or any(path.iterdir())):
            raise OutputError(f"{path}: is there, and no empty folder; choose another.")
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.chmod(0o700)
    except OutputError:
        raise
    except (OSError, ValueError) as e:
        raise OutputError(f"{path}: cannot be made ({getattr(e, 'strerror', None) or e}).") from e
    yield path.absolute()


def take(folder: Path, name: str, data: bytes, there: Mapping[str, int]) -> str:
    """Write a dropped file under a plain name, in the place of one of that name, and return this name.

    ``there``: sizes of those that were dropped before. Raises OutputError where it is none that can be used, or the
    folder has enough.
    """
    plain = plain_name(name)
    place = _place(folder, plain)
    others = [size for known, size in there.items() if known != plain]
    if len(others) >= _MOST_FILES:
        raise OutputError(f"{shown(plain)}: is one file more than the {_MOST_FILES} that are allowed.")
    if len(data) > LARGEST_FILE or len(data) + sum(others) > _LARGEST_SUM:
        raise OutputError(f"{shown(plain)}: {TOO_LARGE}")
    place.parent.mkdir(mode=0o700, exist_ok=True)
    write_atomically(place, data)
    return plain


def remove(folder: Path, name: str) -> None:
    """Remove a dropped file, if it is there."""
    _place(folder, plain_name(name)).unlink(missing_ok=True)


def _place(folder: Path, plain: str) -> Path:
    return folder / PHOTOGRAPHS / plain if kind_of(plain) == "photograph" else folder / plain


def as_zip(folder: Path) -> IO[bytes]:
    """Return an open file with all regular files of the folder, as a ZIP archive, from its beginning."""
    archive = tempfile.TemporaryFile()  # noqa: SIM115 - whoever asked closes it
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as into:
        for place in (folder, *(folder / name for name in (MADE, PHOTOGRAPHS, RESULTS))):
            for path in sorted(place.iterdir()) if place.is_dir() else ():
                if path.is_file() and not path.is_symlink():
                    into.write(path, Path("calibration") / path.relative_to(folder))
    archive.seek(0)
    return archive
