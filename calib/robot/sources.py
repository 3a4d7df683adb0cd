"""Where a robot description and its meshes come from: paths of the user, and ``example:`` for example-robot-data."""

import contextlib
import os
import re
import sys
from collections.abc import Collection, Sequence
from importlib import metadata
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.foundations.words import near
from calib.foundations.xml_text import NotXmlError, read_xml

EXAMPLE = "example:"

_DISTRIBUTION = "example-robot-data"
_FOLDER = f"share/{_DISTRIBUTION}/robots"
_PACKAGE_NAME = re.compile(rb"<name>\s*([A-Za-z0-9_.-]{1,100})\s*</name>")
_LARGEST_MANIFEST = 100_000
_ABOVE = re.compile(r"^(?:\.\.?/)+")


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

    ``package://NAME/REST`` is ROOT/NAME/REST or ROOT/REST; a relative path starts at a root, and its leading ``..`` may
    be left out; ``file://`` and absolute paths must lead below one. Links are followed first, and a path that leaves
    its root is refused.
    """
    scheme, mark, rest = uri.partition("://")
    if not mark:
        names = [uri, _ABOVE.sub("", uri)]
    elif scheme == "file":
        names = [unquote(rest)]
    elif scheme == "package":
        names = [rest, rest.partition("/")[2]]
    else:
        return None
    for root in roots:
        for k, name in enumerate(names):
            try:
                # Where nothing is, which is nearly everywhere, one question to the system tells. Path takes long to
                # build of a long path.
                if not os.path.isfile(path := os.path.join(root, name)):  # noqa: PTH113, PTH118
                    continue
                # The folder of a package is no place for meshes of another one that have the same path there.
                other = k and scheme == "package" and _package_name(root) not in (None, rest.partition("/")[0])
                if not other and (found := Path(path).resolve()).is_relative_to(root.resolve()):
                    return found
            except (OSError, RuntimeError, ValueError):
                # A loop of links, a name too long, a zero byte: no file of that name.
                continue
    return None


def mesh_uris(source: bytes, shapes: Collection[str] = ("visual", "collision")) -> tuple[str, ...]:
    """Return what the ``<mesh filename>`` of a URDF's links name, each once; of what is no XML nothing."""
    try:
        robot = read_xml(source, generations=4)
    except NotXmlError:
        return ()
    meshes = (
        mesh.attributes.get("filename", "")
        for link in robot.all("link")
        for shape in link.children
        if shape.tag in shapes
        for geometry in shape.all("geometry")
        for mesh in geometry.all("mesh")
    )
    return tuple(dict.fromkeys(uri for uri in meshes if uri))


def package_folders(source: bytes, urdf: Path) -> tuple[Path, ...]:
    """Return the folders of the packages that the meshes of a URDF name by ``package://``, as far as they are found.

    A package is a folder with a ``package.xml`` that says its name: one that the URDF is in, one beside it, or, in
    ``AMENT_PREFIX_PATH``, ``share/NAME``.
    """
    names = {uri.split("/")[2] for uri in mesh_uris(source) if uri.startswith("package://") and uri.count("/") > 2}
    above = [folder for folder in urdf.absolute().parents if _package_name(folder) is not None][:1]
    candidates = [*above, *(folder.parent / name for folder in above for name in sorted(names))]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        candidates += [Path(prefix) / "share" / name for name in sorted(names) if prefix]
    found: dict[str, Path] = {}
    for folder in candidates:
        name = _package_name(folder)
        if name in names:
            found.setdefault(str(name), folder)
    return tuple(found.values())


def usual_mesh_roots(source: bytes, where: str) -> tuple[Path, ...]:
    """Return the folders where the meshes of a URDF usually are: its own, its packages, those of the examples.

    ``where`` the URDF was read: its file, or ``example:`` and a path.
    """
    examples = (examples_folder().parents[1],) if where.startswith(EXAMPLE) else ()
    urdf = resolve(where) if examples else Path(where)
    return (urdf.parent, *examples, *package_folders(source, urdf)) if urdf.is_file() else ()


def _package_name(folder: Path) -> str | None:
    """Return the name that a folder's ``package.xml`` states; None where it has none."""
    try:
        match = _PACKAGE_NAME.search(read_bytes(folder / "package.xml", RobotError, _LARGEST_MANIFEST))
    except RobotError:
        return None
    return None if match is None else match[1].decode()


def _hint(inside: str) -> str:
    """Return the end of the sentence: the URDFs whose path resembles ``inside``, or where all of them are."""
    known = examples()
    # A robot's name alone, "panda", is found in its path; a slip of the pen by its likeness.
    word = PurePosixPath(inside).stem.lower()
    containing = [name for name in known if word and word in name.lower()]
    likest = (containing or near(EXAMPLE + inside, known))[:3]
    return f"; did you mean {' or '.join(likest)}?" if likest else f"; they are the files in {examples_folder()}."
