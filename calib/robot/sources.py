"""Where a robot description and its meshes come from: paths of the user, and ``example:`` for example-robot-data."""

import contextlib
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from calib.foundations.errors import RobotError
from calib.foundations.words import near

EXAMPLE = "example:"

_DISTRIBUTION = "example-robot-data"
_FOLDER = f"share/{_DISTRIBUTION}/robots"


def resolve(path: str | Path) -> Path:
    """Return the file that ``path`` stands for: itself, or for ``example:x`` the file x of example-robot-data.

    A plain path is returned as it is; whoever opens it says why that fails. An example must exist. Raises RobotError
    when it does not, when its path leaves the folder of the examples, or when the examples are not installed.
    """
    text = str(path)
    if not text.startswith(EXAMPLE):
        return Path(path)
    inside = PurePosixPath(text.removeprefix(EXAMPLE))
    if inside.is_absolute() or ".." in inside.parts:
        raise RobotError(f"{text}: an example is a path inside the folder of the examples, without '..'.")
    robots = examples_folder()
    with contextlib.suppress(OSError):  # such as a name longer than the file system takes
        if (robots / inside).is_file():
            return robots / inside
    raise RobotError(f"{text[:200]}: there is no such example{_hint(str(inside))}")


def examples() -> tuple[str, ...]:
    """Return every URDF of example-robot-data as ``example:...``, sorted."""
    robots = examples_folder()
    return tuple(sorted(EXAMPLE + file.relative_to(robots).as_posix() for file in robots.rglob("*.urdf")))


def examples_folder() -> Path:
    """Return the folder ``robots`` of example-robot-data, or raise RobotError when it is not installed."""
    # The wheel keeps its data under a cmeel prefix and, since version 6, has no Python module to ask; conda and
    # system packages put the same folder under the interpreter's own prefix.
    candidates = [Path(sys.prefix) / _FOLDER]
    try:
        wheel = metadata.distribution(_DISTRIBUTION)
        candidates.insert(0, Path(str(wheel.locate_file(f"cmeel.prefix/{_FOLDER}"))))
    except metadata.PackageNotFoundError:
        pass
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise RobotError(f"The example robots are not installed; install the package {_DISTRIBUTION}.")


def find_mesh(uri: str, roots: Sequence[Path]) -> Path | None:
    """Return the file that a URDF's mesh ``filename`` means, or None when it is not a file below one of ``roots``.

    ``package://NAME/REST`` is ROOT/NAME/REST or ROOT/REST; a relative path starts at a root; ``file://`` and absolute
    paths must lead below one. Links are followed first, and a path that leaves its root is refused.
    """
    scheme, mark, rest = uri.partition("://")
    if not mark:
        names = [uri]
    elif scheme == "file":
        names = [unquote(rest)]
    elif scheme == "package":
        names = [rest, rest.partition("/")[2]]
    else:
        return None
    for root in roots:
        for name in names:
            try:
                path = (root / name).resolve()
                if path.is_relative_to(root.resolve()) and path.is_file():
                    return path
            except (OSError, RuntimeError, ValueError):
                # A loop of links, a name too long, a zero byte: no file of that name.
                continue
    return None


def _hint(inside: str) -> str:
    """Return the end of the sentence: the URDFs whose path resembles ``inside``, or where all of them are."""
    known = examples()
    # A robot's name alone, "panda", is found in its path; a slip of the pen by its likeness.
    word = PurePosixPath(inside).stem.lower()
    containing = [name for name in known if word and word in name.lower()]
    likest = (containing or near(EXAMPLE + inside, known))[:3]
    return f"; did you mean {' or '.join(likest)}?" if likest else f"; they are the files in {examples_folder()}."
