"""From a folder of photographs and the readings of the arm at each to a table of pixels, and a job that reads it."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.compensation.commands import for_poses
from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.csv_text import csv_text
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import sentences
from calib.foundations.sealing import sealed
from calib.foundations.units import MM, NUMBER
from calib.foundations.words import listed, noun, shown
from calib.job.chains import chains, whole_chains
from calib.job.flange_poses import LEAST, Seen, orientation_of, refuse_mistakes, shown_by, way_up
from calib.job.read import read_board
from calib.job.toml_text import toml_text
from calib.machine.calibrated import CalibratedMachine
from calib.measurement.columns import BOARD, KNOWN, PIXELS, POSITION, filled, orientations, stacked
from calib.measurement.formats.images import (
    ENDINGS,
    LEAST_CORNERS,
    MOST_BLUR,
    NOTHING_SEEN,
    Detection,
    detector,
    marker_bits,
    may_be_old,
    read_image,
    thumbnail,
)
from calib.measurement.formats.sheet import Sheet, read_sheet
from calib.measurement.instruments import CameraPlace
from calib.measurement.orientations import ANGLES, MATRIX
from calib.measurement.prints import Print
from calib.measurement.raw import split_title
from calib.measurement.roles import matrices
from calib.measurement.table import (
    APPROACH,
    QUATERNION_COLUMNS,
    TORQUE,
    UNITLESS,
    Columns,
    Table,
    holds_words,
    no_unit,
    read_table,
)
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf

IMAGE = "image"
LEAST_PHOTOGRAPHS = 3
# Of these a quarter is held out; eight photographs and more teach how well an arm is made (docs/cameras.md).
_TEACH = 11
# What is written of a pixel and of its sigma: a ten-thousandth.
_DIGITS = 4
# How much farther than the poses a flange may go, and at least, in m.
_FARTHER, _LEAST_TRAVEL = 2.0, 0.1
_FLANGE = ("flange_x", "flange_y", "flange_z", "flange_rz", "flange_ry", "flange_rx")
# One of these columns beside a position makes it a pose.
_TURNED = {"qw", "rx", "r11"}
_OF_BOARD = "the board looks the same upside down, and which way up it is here"
_CONTRADICTS = f"{_OF_BOARD} is not known: its readings contradict those of other photographs"
_EITHER = f"{_OF_BOARD} its readings do not tell clearly"
# What the table of pixels says of marks, so that no column of the readings is taken over under one of these names.
_WRITTEN = frozenset(("group", *PIXELS, *BOARD, "sigma"))
_MARKS = ("u [px]", "v [px]", "board_x [mm]", "board_y [mm]", "board_z [mm]", "sigma [px]")


class Photograph(NamedTuple):
    """One photograph as it was read: its name and size, what was found, why it is left out ("": it is not), a copy."""

    name: str
    size: tuple[int, int]
    found: Detection
    left_out: str
    small: bytes


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Imported:
    """Photographs of one size (w, h) with readings: ``titles`` and ``readings`` by name. ``remarks``: how these came.

    ``robot``: what the readings are of. ``urdf``: of the six axes that stand for the flange's pose, where no robot is
    known.
    """

    photographs: tuple[Photograph, ...]
    size: tuple[int, int]
    titles: tuple[str, ...]
    readings: Mapping[str, tuple[str, ...]]
    print_: Print
    remarks: tuple[str, ...]
    robot: Robot | None
    urdf: str = ""

    @property
    def used(self) -> tuple[Photograph, ...]:
        """Those that are not left out."""
        return tuple(one for one in self.photographs if not one.left_out)

    def contents(self) -> dict[str, object]:
        """Return what was found, as plain data."""
        sigma = np.concatenate([one.found.sigma for one in self.used])
        return {
            "used": len(self.used),
            "corners": len(sigma),
            "sigma": float(np.sqrt(np.mean(sigma**2))),
            "size": list(self.size),
            "left_out": [{"image": one.name, "why": one.left_out} for one in self.photographs if one.left_out],
            "remarks": list(self.remarks),
        }

    @property
    def sentences(self) -> list[str]:
        """How readings came, what is left out and why, and how many corners there are."""
        told = self.contents()
        said = [f"{remark}." for remark in self.remarks]
        said += [f"{one.name} is left out: {one.left_out}." for one in self.photographs if one.left_out]
        of = f"{told['corners']} corners of {told['used']} of {len(self.photographs)} photographs"
        return [*said, f"{of}; {told['sigma']:.3f} px each."]

    def table(self) -> str:
        """Return the table of pixels: a row for every corner, with the readings of its photograph."""
        marks = self.print_.marks / MM
        rows: list[Sequence[object]] = [(*self.titles, "group", *_MARKS)]
        for one in self.used:
            before = (*self.readings[one.name], one.name)
            for mark, (u, v), sigma in zip(one.found.marks, one.found.pixels, one.found.sigma, strict=True):
                x, y, z = marks[mark]
                numbers = (f"{u:.{_DIGITS}f}", f"{v:.{_DIGITS}f}", f"{x:g}", f"{y:g}", f"{z:g}")
                rows.append((*before, *numbers, f"{max(sigma, 1e-3):.{_DIGITS}f}"))
        return csv_text(rows)

    def job(self, urdf: str, table: str, board: str, *, camera_on: str) -> str:
        """Return a job of a table of pixels: all that may deviate free, the lens too, a quarter held out."""
        alone = bool(self.urdf)
        free = ["# The robot is taken as given: hand-eye and lens alone."] if alone else []
        free += [f'{key} = "{"none" if alone else "all"}"' for key in ("offsets", "placements")]
        # Widths that are stated hold worse arms back; but few photographs teach none.
        learned = len(self.used) >= _TEACH
        widths = '{ length = "learned", angle = "learned" }' if learned else '{ length = "1 mm", angle = "1 mrad" }'
        prior = [] if alone else [f"prior = {widths}  # how well arms are made"]
        lines = [
            "schema = 1",
            "",
            "[robot]",
            f"urdf = {toml_text(urdf)}",
            *self._ends(),
            "",
            "[error_model]",
            *free,
            'base = "fixed"  # cameras see how board and arm are to each other: the base is the world',
            'tool = "pose"',
            *prior,
            "",
            "[instruments.camera]",
            'kind = "camera"',
            f'camera_on = "{camera_on}"',
            'lens = "free"',
            f"size = [{self.size[0]}, {self.size[1]}]",
            "",
            "[[measurements]]",
            f"file = {toml_text(table)}",
            'observes = "pixels"',
            'instrument = "camera"',
            f"board = {toml_text(board)}",
            "hold_out = 0.25",
        ]
        return "\n".join(lines) + "\n"

    def _ends(self) -> list[str]:
        if self.robot is None:
            return ['tip = "flange"'] if self.urdf else []
        root = self.robot.urdf.root
        base = [] if self.robot.base == root else [f"base = {toml_text(self.robot.base)}"]
        return [f"tip = {toml_text(self.robot.tip)}", *base]


def read_photographed_board(path: Path) -> Print:
    """Read what is printed on a board, whose markers OpenCV has to know. Raises JobError as :func:`read_board` does.

    Nor may it look the same from all four sides.
    """
    print_ = read_board(path)
    if print_.four_ways:
        raise JobError(
            f"{path}: a chessboard of {print_.squares[0]} x {print_.squares[1]} squares looks the same from all four "
            "sides, so that nothing tells which corner is which; photograph another board."
        )
    if print_.dictionary:
        marker_bits(print_, str(path))
    return print_


def import_photographs(
    folder: Path,
    print_: Print,
    readings: Path,
    *,
    urdf: str | Path | None = None,
    tip: str | None = None,
    orientation: str | None = None,
    camera_on: CameraPlace = "tip",
    progress: Callable[[str], None] = lambda _: None,
) -> Imported:
    """Find a board in the photographs of a folder, and join them with the arm's readings at each.

    ``readings``: a table with the column ``image``, and columns of the joints; or ``x``, ``y``, ``z`` and the
    quaternion, or three angles, of the flange as its controller states it. Then the readings are those with which the
    nominal robot of ``urdf`` is there; without it they are six axes that put the flange there. Without an
    ``orientation``, the photographs tell what three angles are, and poses that they contradict are refused where a
    typical mistake explains it. For this, they ask ``camera_on``. Where a board looks the same upside down, the
    readings tell which way up it was in each photograph.
    Without a ``tip``, it is that of the arm whose joints the readings have.

    Raises CalibError where less than three photographs remain, or readings cannot be had.
    """
    files = _files(folder)
    robot, said = (None, ()) if urdf is None else _arm(urdf, tip, readings)
    given = _given(readings, robot, orientation)
    if print_.half_turn is not None and given.table is None and robot is None:
        raise JobError(
            f"{readings}: has readings of the joints, and the board looks the same upside down: where the robot is "
            "tells which way up it is in each photograph; name the robot."
        )
    remarks = said
    seen = _looked_at(files, detector(print_), progress)
    if may_be_old(print_) and not any(len(one.found.marks) for one in seen):
        seen = _looked_at(files, detector(print_, old=True), progress)
        if any(len(one.found.marks) for one in seen):
            remarks += (
                "the board begins with a white square, as OpenCV before 4.6 drew those of an even number of rows",
            )
    sizes = [one.size for one in seen if not one.left_out]
    size = max(dict.fromkeys(sizes), key=sizes.count, default=(0, 0))
    images = frozenset(given.images)  # thousands are looked for among thousands
    named = {one.name: _named(one.name, images) for one in seen}
    owner = {row: name for name, row in reversed(named.items())}
    photographs = tuple(
        one._replace(left_out=_unfit(one, size, named[one.name], owner.get(named[one.name]))) for one in seen
    )
    lost = [image for image in given.images if image not in owner]
    if lost:
        more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        remarks += (f"{readings}: there is no photograph {shown(lost[0])}{more} in {folder}",)
    used = [one for one in photographs if not one.left_out]
    if len(used) < LEAST_PHOTOGRAPHS:
        first = next((f"; {one.name}: {one.left_out}" for one in photographs if one.left_out), "")
        raise MeasurementError(
            f"{folder}: {len(used)} of {len(photographs)} photographs can be used, and {LEAST_PHOTOGRAPHS} "
            f"are the fewest that tell anything{first}."
        )
    made, told = "", None
    if given.table is not None or print_.half_turn is not None:
        progress("holding poses of the flange against photographs")
        told = _told(used, named, given, print_, size)
    if given.table is None:
        titles, rows = given.titles, list(given.rows)
        poses = None if told is None or robot is None else _nominal(given, robot)
    else:
        titles, rows, own, made, poses = _of_flange(given, given.table, robot, told, camera_on)
        given = given._replace(remarks=(*own, *given.remarks))
    if print_.half_turn is not None:
        photographs, turned = _one_way_up(photographs, named, given, told, poses, print_)
        remarks += (turned,)
    by_image = dict(zip(given.images, rows, strict=True))
    taken = {name: by_image[row] for name, row in named.items() if row is not None}
    return Imported(photographs, size, titles, taken, print_, (*given.remarks, *remarks), robot, made)


def _files(folder: Path) -> list[Path]:
    with sentences(folder, MeasurementError):
        found = sorted(file for file in folder.iterdir() if file.suffix.lower() in ENDINGS and file.is_file())
    if not found:
        raise MeasurementError(f"{folder}: holds no photographs; they end with {', '.join(ENDINGS)}.")
    return found


def _looked_at(
    files: Sequence[Path], detect: Callable[[Array], Detection], progress: Callable[[str], None]
) -> list[Photograph]:
    seen: list[Photograph] = []
    for file in files:
        progress(f"looking at {file.name}")
        seen.append(_look(file, detect))
    return seen


def _look(file: Path, detect: Callable[[Array], Detection]) -> Photograph:
    try:
        grey = read_image(file)
    except MeasurementError as e:
        return Photograph(file.name, (0, 0), NOTHING_SEEN, str(e).removeprefix(f"{file}: ").rstrip("."), b"")
    found = detect(grey)
    return Photograph(file.name, (grey.shape[1], grey.shape[0]), found, _why(found), thumbnail(grey))


def _unfit(one: Photograph, size: tuple[int, int], row: str | None, owner: str | None) -> str:
    """Return why a photograph is left out among others: nothing where it is of their size, and has readings.

    ``owner``: the photograph that has its ``row``, if it has one.
    """
    if row is not None and owner not in (None, one.name):
        return f"has the readings of {owner}"
    if not one.left_out and one.size != size:
        return f"has {one.size[0]} x {one.size[1]} pixels, and most have {size[0]} x {size[1]}"
    return one.left_out or ("" if row is not None else "has no row in the readings")


def _why(found: Detection) -> str:
    """Return why a photograph is of no use, nothing where it is."""
    if not len(found.marks) and found.twice:
        return "markers of the board are seen twice; of boards in one photograph each needs a dictionary of its own"
    if not len(found.marks):
        return "no board is found"
    if len(found.marks) < LEAST_CORNERS:
        return f"only {len(found.marks)} corners are found, and {LEAST_CORNERS} are the fewest"
    blur = float(np.median(found.blur))
    return f"is blurred over {blur:.1f} px, and {MOST_BLUR:g} are allowed" if blur > MOST_BLUR else ""


def _named(name: str, by_image: Collection[str]) -> str | None:
    """Return the image of the readings that a file is, by its name with or without its ending."""
    return next((image for image in (name, Path(name).stem) if image in by_image), None)


class _Given(NamedTuple):
    """Readings with the ``images`` of their rows: cells of the joints, or a ``table`` of the flange's poses."""

    path: Path
    images: tuple[str, ...]
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...]
    table: Table | None
    columns: Columns


def _given(path: Path, robot: Robot | None, orientation: str | None) -> _Given:
    """Return what a table has. Raises CalibError where there is no column of images, or poses cannot be read."""
    sheet = read_sheet(path)
    names = sheet.names
    if IMAGE not in names:
        raise MeasurementError(f"{path}: there is no column {IMAGE!r}; the columns are {', '.join(map(repr, names))}.")
    images = tuple(_images(sheet, names.index(IMAGE)))
    own, said = [k for k, name in enumerate(names) if name != IMAGE], f"{path} has readings of the joints"
    columns = _of_poses(sheet, orientation)
    joints = [] if robot is None else [reading.name for reading in robot.readings]
    if columns is not None and not (joints and set(joints) <= set(names)):
        table = read_table(path, replace(columns, orientation=None))
        if columns.orientation is not None or not set(ANGLES) <= set(names):
            _poses(path, columns)
        remarks = tuple(f"{path}: {said}" for said in _not_read(columns.ignore))
        return _Given(path, images, (), (), remarks, table, columns)
    if columns is not None:
        own = [k for k in own if names[k] in joints]
        said += ", which are taken; its poses of the flange are not needed"
    elif robot is not None:
        told = {f"{what}{joint}" for what in ("", APPROACH, TORQUE) for joint in joints}
        own = [k for k in own if names[k] in told | KNOWN - _WRITTEN]
    else:
        own = [k for k in own if names[k] not in _WRITTEN]
    left = tuple(sheet.titles[k] for k in range(len(names)) if k not in own and names[k] != IMAGE)
    if robot is not None:
        _refuse_unreadable(sheet, own, robot)
    if columns is None:
        said = "; ".join((said, *_not_read(left)))
    rows = tuple(tuple(row[k] for k in own) for row in sheet.rows)
    as_read = Columns({"group": IMAGE}, ignore=left)
    return _Given(path, images, tuple(sheet.titles[k] for k in own), rows, (said,), None, as_read)


def _not_read(titles: Sequence[str]) -> tuple[str, ...]:
    """Return what is said of columns of a table that are not read, nothing where there are none."""
    return (f"{listed(titles)} {noun(len(titles), 'is', 'are')} not read",) if titles else ()


def _of_poses(sheet: Sheet, orientation: str | None) -> Columns | None:
    """Return how columns are read that state poses of the flange, one matrix in cells such as ``T_0_3`` among them.

    All others are passed over. Raises MeasurementError where cells of a matrix have no unit, or a wrong one.
    """
    names = sheet.names
    if set(POSITION) <= set(names) and _TURNED & set(names):
        matrix = "r11" in names and not {"qw", "rx"} & set(names)
        known, own = {IMAGE, *POSITION, *QUATERNION_COLUMNS, *ANGLES, *MATRIX}, {}
    else:
        found = [(nine, point) for nine, point in matrices(names, range(len(names))) if point is not None]
        if len(found) != 1:
            return None
        (nine, point), matrix = found[0], True
        if unitless := [names[k] for k in point.columns if split_title(sheet.titles[k])[1] is None]:
            raise MeasurementError(
                f"{sheet.where}: {listed(unitless)} {noun(len(unitless), 'has', 'have')} no unit; write one in "
                f"brackets, like '{unitless[0]} [mm]'."
            )
        for k in nine.columns:
            if split_title(sheet.titles[k])[1] not in (None, "1"):
                raise MeasurementError(f"{sheet.where}: column {sheet.titles[k]!r} is of a rotation, and has no unit.")
        cells = [names[k] for k in (*nine.columns, *point.columns)]
        known, own = {IMAGE, *cells}, dict(zip((*MATRIX, *POSITION), cells, strict=True))
    others = tuple(title for title, name in zip(sheet.titles, names, strict=True) if name not in known)
    return Columns({"group": IMAGE, **own}, ignore=others, orientation=orientation or ("matrix" if matrix else None))


def _refuse_unreadable(sheet: Sheet, own: Sequence[int], robot: Robot) -> None:
    """Raise MeasurementError where a job could not read its ``own`` columns of a table of the robot's joints.

    The job would not say so before all photographs have been searched.
    """
    names, needed = [sheet.names[k] for k in own], robot.driving((robot.tip,))
    joints = [reading.name for reading in robot.readings if reading.name in needed]
    if missing := [joint for joint in joints if joint not in names]:
        raise MeasurementError(
            f"{sheet.where}: there is no column {', '.join(map(repr, missing))} of a joint, and no pose of the flange "
            f"is found in each row; the columns are {', '.join(map(repr, sheet.names))}."
        )
    several = (*sheet.again, *(name for name, count in Counter(names).items() if count > 1))
    if twice := next((name for name in several if name in names), None):
        raise MeasurementError(f"{sheet.where}: column {twice!r} appears more than once.")
    unitless = [sheet.names[k] for k in own if split_title(sheet.titles[k])[1] is None]
    if unitless := [name for name in unitless if not (holds_words(name) or name in UNITLESS)]:
        raise MeasurementError(f"{sheet.where}: {no_unit(unitless)}.")
    of_joints = [(k, sheet.names[k]) for k in own if sheet.names[k] in joints]
    images = sheet.names.index(IMAGE)
    for row in sheet.rows:
        for k, joint in of_joints:
            if NUMBER.fullmatch(row[k].strip().replace(",", ".")) is None:
                at = f"{sheet.where}: the row of {shown(row[images])}: column {joint!r}"
                raise MeasurementError(f"{at}: {shown(row[k])} is not a number.")


def _poses(path: Path, columns: Columns) -> Array:
    table = read_table(path, columns)
    return rigid.placement(orientations(table), stacked(table, dict.fromkeys(POSITION, "length")))


def _told(
    used: Sequence[Photograph], named: Mapping[str, str | None], given: _Given, print_: Print, size: tuple[int, int]
) -> Seen | None:
    row = {image: k for k, image in enumerate(given.images)}
    own = [row[image] for one in used if (image := named[one.name]) is not None]
    shown = [(one.found.pixels, print_.marks[one.found.marks]) for one in used]
    return shown_by(shown, own, size, print_.half_turn)


def _nominal(given: _Given, robot: Robot) -> Array:
    """Return where the tip of a nominal robot is (N, 4, 4) by the readings of a table."""
    table = read_table(given.path, given.columns)
    return _machine(robot).tips(filled(table, {reading.name: reading.dimension for reading in robot.readings}))


def _machine(robot: Robot) -> CalibratedMachine:
    return CalibratedMachine(robot, robot.no_deviations(), read_only(np.eye(4)), {"tool": read_only(np.eye(4))})


def _one_way_up(
    photographs: Sequence[Photograph],
    named: Mapping[str, str | None],
    given: _Given,
    told: Seen | None,
    poses: Array | None,
    print_: Print,
) -> tuple[tuple[Photograph, ...], str]:
    """Return photographs of a board that looks the same upside down, their marks numbered alike, and a remark.

    Those of which the poses (N, 4, 4) of the flange do not tell it are left out. Raises MeasurementError where most are
    such.
    """
    board = f"a chessboard of {print_.squares[0]} x {print_.squares[1]} squares looks the same upside down"
    if told is None or poses is None:
        raise MeasurementError(
            f"{given.path}: {board}; to tell which way up it is, {LEAST} photographs with readings that show how it "
            "lies are needed, and there are fewer."
        )
    found = way_up(told, poses)
    if found is None:
        raise MeasurementError(
            f"{given.path}: {board}, and the readings do not tell which way up it is in most photographs: these turn "
            "otherwise than the board does in the photographs, or all by a quarter about its normal; are the readings "
            "those of these photographs, in their units?"
        )
    row, last, kept = {image: k for k, image in enumerate(given.images)}, len(print_.marks) - 1, []
    for one in photographs:
        image = named[one.name]
        k = -1 if image is None else row[image]
        if not one.left_out and k not in found.told:
            one = one._replace(left_out=_CONTRADICTS if k in found.contradict else _EITHER)  # noqa: PLW2901
        elif not one.left_out and k in found.turned:
            one = one._replace(found=one.found._replace(marks=last - one.found.marks))  # noqa: PLW2901
        kept.append(one)
    used = [one for one in kept if not one.left_out]
    said = f"{board}: the readings tell which way up it is, and {len(found.turned)} of {len(used)} photographs"
    return tuple(kept), f"{said} are numbered from the other end than OpenCV does"


def _arm(urdf: str | Path, tip: str | None, readings: Path) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot of a URDF up to a tip, and remarks. Without a ``tip``: the arm whose joints the readings have.

    Raises CalibError where several arms are meant alike, or the URDF has no such link.
    """
    document = read_urdf(urdf)
    if tip is not None:
        return load_robot(document, tip), ()
    known = set(read_sheet(readings).names)
    found = next((arm for arm in chains(document) if known.issuperset(arm.joints)), None)
    whole = whole_chains(document)
    if found is None and len(whole) == 1:
        found = whole[0]
    if found is None:
        return load_robot(document), ()
    others = f"; {listed(found.others, most=4)} would do as well" if found.others else ""
    return load_robot(document, found.tip, found.base), (f"{document.where}: the tip is {found.tip}{others}",)


def _images(sheet: Sheet, column: int) -> list[str]:
    images = [Path(row[column].strip().replace("\\", "/")).name for row in sheet.rows]
    if twice := next((image for image, rows in Counter(images).items() if rows > 1), None):
        raise MeasurementError(f"{sheet.where}: the image {shown(twice)} has two rows; it was taken once.")
    return images


def _of_flange(
    given: _Given,
    table: Table,
    robot: Robot | None,
    told: Seen | None,
    camera_on: CameraPlace,
) -> tuple[tuple[str, ...], list[tuple[str, ...]], tuple[str, ...], str, Array]:
    """Return titles and cells of the readings, how these came, the URDF that they are of, if it is made, and poses."""
    path, columns, known = given.path, given.columns, ""
    if columns.orientation is None:
        orientation, known = orientation_of(table, told, camera_on)
        columns = replace(columns, orientation=orientation)
    poses = _poses(path, columns)
    refuse_mistakes(table, poses, told, camera_on, given.images)
    if robot is None:
        angles = rigid.rpy_of(poses[:, :3, :3])
        values = np.column_stack([poses[:, :3, 3], angles[:, ::-1]])
        names: tuple[str, ...] = _FLANGE
        said = f"{path} has poses of the flange, and no robot is given: hand-eye alone, the robot as it is"
        units, urdf = ["m"] * 3 + ["rad"] * 3, flange_urdf(poses[:, :3, 3])
    else:
        values, names = _inverse(path, robot, poses, given.images), tuple(reading.name for reading in robot.readings)
        units = ["m" if reading.dimension == "length" else "rad" for reading in robot.readings]
        said = (
            f"{path} has poses of the flange: readings are those with which the robot of the URDF is there; where the "
            "controller computes with the numbers of its own arm, its joints are others, and a calibration needs these"
        )
        urdf = ""
    titles = tuple(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True))
    cells = [tuple(f"{value:.9f}" for value in row) for row in values]
    return titles, cells, (said, *([known] if known else [])), urdf, poses


def _inverse(path: Path, robot: Robot, poses: Array, images: Sequence[str]) -> Array:
    """Return readings (N, nr) with which a nominal robot has its tip at poses, each near to the one before."""
    nominal = _machine(robot)
    found = for_poses(nominal, poses)
    if not found.reached.all():
        k = int(np.argmin(found.reached))
        raise JobError(
            f"{path}: the robot does not reach the pose of {shown(images[k])} ({found.reasons[k]}); are the flange and "
            "the base of the controller the tip and the base of the URDF?"
        )
    readings = np.array(found.readings)
    # One configuration for all, as far as there is one: an arm seldom changes it between photographs.
    for k in range(1, len(readings)):
        near = for_poses(nominal, poses[k : k + 1], readings[k - 1 : k])
        if near.reached[0]:
            readings[k] = near.readings[0]
    return readings


def flange_urdf(places: Array) -> str:
    """Return a URDF of six axes that put a flange anywhere: its readings are the flange's pose itself.

    It reaches twice as far as the ``places`` (n, 3): how far an arm reaches says what is large and small for it.
    """
    text = files("calib.job").joinpath("flange.urdf").read_text(encoding="utf-8")
    for axis, farthest in zip("xyz", np.maximum(np.abs(places).max(axis=0), _LEAST_TRAVEL), strict=True):
        text = text.replace(f"@{axis}@", f"{_FARTHER * farthest:.3g}")
    return text
