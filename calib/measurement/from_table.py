"""From a table to measurements: a table's columns as readings, what was seen of the tool there, and its noise."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from calib.foundations.arrays import Array, IntArray, read_only, read_only_view
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.ranges import MOST_SETUPS, MOST_TARGETS, MOST_TOOLS, RANGES, refuse_beyond
from calib.foundations.units import Dimension
from calib.foundations.words import refuse_other
from calib.measurement.boards import Board
from calib.measurement.columns import (
    BOARD,
    PIXELS,
    POINT,
    POSITION,
    SIGMA_ANGLES,
    SIGMAS,
    filled,
    numbers,
    orientations,
    refuse_unknown,
    require,
    stacked,
    words,
)
from calib.measurement.conditions import conditions
from calib.measurement.instruments import Camera, LaserTracker
from calib.measurement.kinds import WITH_TARGET, Kind, size
from calib.measurement.measurements import ONLY_SETUP, ONLY_TOOL, Measurements
from calib.measurement.optics import seen_by
from calib.measurement.projection import undistort
from calib.measurement.scalars import Scalar
from calib.measurement.table import Table
from calib.robot.robot import Reading, Robot
from calib.robot.urdf import MOVING

# Of a coordinate, in m; of poses also a pair, in m and rad. None: not known here.
Sigma = float | tuple[float | None, float | None] | None


class Joints(NamedTuple):
    """Which joints a table may tell, and whose tool it is about.

    ``spare``: readings that do not move the ``tip``, so that there may be no column. ``idle``: joints that move nothing
    that is asked for. ``unread``: joints without a reading. ``tool``: what the tip's only tool is called.
    ``elsewhere``: no joint has a column, as another file has the readings.
    """

    tip: str = ""
    tool: str = ONLY_TOOL
    spare: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    elsewhere: bool = False

    @classmethod
    def of(cls, robot: Robot) -> "Joints":
        """Return what is asked of a table of a robot's tip."""
        needed = robot.driving((robot.tip,))
        read = [reading.name for reading in robot.readings]
        on_chain = {joint.name for joint in robot.chain}
        moving = [joint for joint in robot.urdf.joints if joint.name not in read and joint.name not in on_chain]
        idle = [joint.name for joint in moving if joint.type in MOVING and joint.mimic is None]
        return cls(
            robot.tip,
            ONLY_TOOL if robot.tip == robot.links[0] else robot.tip,
            tuple(name for name in read if name not in needed),
            tuple(idle),
            tuple(joint.name for joint in robot.urdf.joints if joint.name not in idle),
        )


ALL_READ = Joints()


def measurements_from_table(
    table: Table,
    readings: Sequence[Reading],
    kind: Kind,
    *,
    sigma: Sigma = None,
    instrument: LaserTracker | Camera | None = None,
    offset: str | None = None,
    in_order: bool = False,
    joints: Joints = ALL_READ,
) -> Measurements:
    """Return what a table says of a robot with these ``readings``; ``joints``: which of the URDF's are needed.

    The noise comes from one place: ``sigma`` in m, ``instrument``, or the table's columns ``sigma`` or ``sigma_x,
    sigma_y, sigma_z``; that of poses likewise from a pair ``sigma`` in m and rad, or the columns ``sigma_angle`` or
    ``sigma_rx, sigma_ry, sigma_rz``. Without any it is 0: unknown. ``offset`` names an unknown length by which every
    length of a ``distance`` or ``pair_distance`` is too long, or the unknown radius of a ``sphere``. ``in_order``:
    poses were taken one after the other, and the order of the rows says from which side joints were reached. From where
    the first one was reached nobody knows: it is left out, and so are others until a joint has moved.

    Raises MeasurementError when a column is missing, not known or in a unit of another dimension, when a quaternion is
    not of unit length, when a pair has not two rows or two lengths, and when the noise is given twice or of coordinates
    that there are not; JobError when ``sigma``, ``instrument`` or ``offset`` cannot be used.
    """
    refuse_other(kind, get_args(Kind), "observes")
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in readings}
    unmoved = [name for name in joints.spare if name in dimensions and name not in table.columns]
    absent = tuple(dimensions) if joints.elsewhere else tuple(unmoved)
    require(table, [name for name in dimensions if name not in absent], "of a joint")
    refuse_unknown(table, dimensions, joints.unread, joints.idle)
    length, angle = sigma if isinstance(sigma, tuple) else (sigma, None)
    _refuse_useless(table, kind, sigma=length, sigma_angle=angle, instrument=instrument, offset=offset)
    seen = "position" if kind in ("position", "pose") else None
    position = None
    if seen:
        require(table, POSITION, f"of the measured {kind}")
        position = stacked(table, dict.fromkeys(POSITION, "length"))
    camera = instrument if isinstance(instrument, Camera) else None
    promised: Array | float | None = None if camera is None else camera.sigma or None
    if isinstance(instrument, LaserTracker) and position is not None:
        promised = instrument.sigma_at(position)[:, None]
    width = min(size(kind), 3)
    if width < 3 and (along := [name for name in SIGMAS[1] if name in table.columns]):
        raise MeasurementError(
            f"{table.where}: column {along[0]!r} is of a coordinate, and a {kind} has no coordinates; call it 'sigma'."
        )
    ways = SIGMAS if width == 3 else SIGMAS[:1]
    dimension: Dimension = "length" if camera is None else "pixel"
    noise = _noise(table, ways, dimension, {"sigma": length, "the instrument": promised}, width)
    if kind == "pose":
        noise = np.hstack([noise, _noise(table, SIGMA_ANGLES, "angle", {"sigma_angle": angle}, 3)])
    tools, tool = _numbered(words(table, "tool"), joints.tool, len(table))
    setups, setup = _numbered(words(table, "setup"), ONLY_SETUP, len(table))
    targets, target = (
        _numbered(words(table, "target"), "target", len(table))
        if kind in WITH_TARGET
        else ((), np.full(len(table), -1, dtype=np.intp))
    )
    for names, column, most in (
        (tools, "tool", MOST_TOOLS),
        (setups, "setup", MOST_SETUPS),
        (targets, "target", MOST_TARGETS),
    ):
        if len(names) > most:
            raise MeasurementError(f"{table.where}: column {column!r} has {len(names)} names; allowed are {most}.")
    unknown = "radius" if kind == "sphere" else "offset"
    found = Measurements(
        kind=kind,
        reading_names=tuple(dimensions),
        readings=filled(table, dimensions),
        position=position,
        orientation=orientations(table) if kind == "pose" else None,
        value=_value(table, kind, radius_is_known=offset is None) if camera is None else _pixels(table, camera),
        sigma=read_only(noise),
        tools=tools,
        tool=read_only_view(tool),
        setups=setups,
        setup=read_only_view(setup),
        targets=targets,
        target=read_only_view(target),
        other=None,
        # Millimetres; and no wire is longer than ten metres without anybody's knowing.
        scalars=() if offset is None else (Scalar(f"length.{offset}.{unknown}", "m", size=1e-3, weak_prior=10.0),),
        uses={} if offset is None else {unknown: 0},
        group=words(table, "group"),
        where=table.where,
        lines=table.lines,
        conditions=conditions(table, readings, in_order=in_order, absent=unmoved),
        camera=camera,
        tip=joints.tip,
        absent=absent,
        unused=tuple(name for name in joints.idle if name in table.columns),
        points=_points(table, kind),
        times=numbers(table, "time", "time") if "time" in table.columns else None,
    )
    if camera is not None:
        found = seen_by(found, camera, Board())
    elif kind == "pair_distance":
        found = _paired(found, words(table, "pair"))
    return reached(found) if in_order else found


def reached(found: Measurements) -> Measurements:
    """Return the rows at whose ends the side is known from which every joint was reached that moves at all.

    Where these are less than half of those that know it of some joint, as where each joint moves in rows of its own,
    all the latter, with joints of which nothing is known in the middle; all rows if there are none. A tool, set-up or
    target that only others have is none of theirs.
    """
    sides = [end.conditions.approach for end in found.ends]
    told = [np.zeros_like(end.readings) if own is None else own for own, end in zip(sides, found.ends, strict=True)]
    moving = np.any(np.concatenate(told) != 0.0, axis=0)
    every, some = (np.all([of(own[:, moving] != 0.0, axis=1) for own in told], axis=0) for of in (np.all, np.any))
    if not moving.any() or not some.any():
        return found
    known = every if 2 * np.count_nonzero(every) >= np.count_nonzero(some) else some
    return replace(found.subset(known).with_own_names(), unreached=int(np.count_nonzero(~known)))


_SIGMAS: Mapping[Dimension, str] = {
    "length": "instruments.sigma",
    "angle": "model_sigma_angle",
    "pixel": "instruments.sigma of a camera",
}


def _refuse_useless(
    table: Table,
    kind: Kind,
    *,
    sigma: float | None,
    sigma_angle: float | None,
    instrument: LaserTracker | Camera | None,
    offset: str | None,
) -> None:
    """Refuse an option that would be passed over in silence, and pixels without the camera that saw them."""
    if kind == "pixels" and not isinstance(instrument, Camera):
        raise JobError(f"{table.where}: observes pixels, and no camera is given that saw them; give an instrument.")
    if kind == "pixels" and sigma is not None:
        raise JobError(f"{table.where}: sigma is given, and the noise of pixels is the camera's; give it there.")
    if kind != "pixels" and isinstance(instrument, Camera):
        raise JobError(f"{table.where}: a camera is given, which measures pixels and not a {kind}.")
    if sigma_angle is not None and kind != "pose":
        raise JobError(f"{table.where}: sigma_angle is given, and only poses have angles.")
    if isinstance(instrument, LaserTracker) and kind not in ("position", "pose"):
        raise JobError(f"{table.where}: a laser tracker is given, which does not measure a {kind}; give sigma.")
    if offset is not None and kind not in ("distance", "pair_distance", "sphere"):
        raise JobError(f"{table.where}: an unknown offset is given, and a {kind} has no length.")
    if offset is not None and kind == "sphere" and "diameter" in table.columns:
        raise JobError(
            f"{table.where}: the radius is unknown by length_offset and known by column 'diameter'; keep one."
        )


def _numbered(given: tuple[str, ...] | None, only: str, n: int) -> tuple[tuple[str, ...], IntArray]:
    """Return the names in order of appearance and the number of each of n rows; ``only`` where none are given."""
    names = (only,) if given is None else tuple(dict.fromkeys(given))
    number = {name: i for i, name in enumerate(names)}
    return names, np.array([number[word] for word in given] if given else [0] * n, dtype=np.intp)


def _value(table: Table, kind: Kind, *, radius_is_known: bool) -> Array:
    """Return what a kind measures beside positions (N, v): lengths in m."""

    def lengths(name: str) -> Array:
        require(table, (name,), f"of the measured {kind}")
        return stacked(table, {name: "length"})

    # A ball that touches has its centre off the surface by its radius.
    ball = 0.5 * lengths("ball") if "ball" in table.columns else np.zeros((len(table), 1))
    if kind in ("distance", "pair_distance"):
        return lengths("length")
    if kind == "indicator":
        return lengths("indicated")
    if kind == "plane":
        return read_only(ball)
    if kind == "sphere":
        return read_only(0.5 * lengths("diameter") + ball if radius_is_known else ball)
    return read_only(np.zeros((len(table), 0)))


def _pixels(table: Table, camera: Camera) -> Array:
    """Return u and v in px and the mark's place on its board in m, zero where no column says it (N, 5)."""
    require(table, PIXELS, "of the pixel that was seen")
    pixels = stacked(table, dict.fromkeys(PIXELS, "pixel"))
    # Of a lens that is to be found nothing is known that a pixel could contradict.
    seen = np.ones(len(pixels), dtype=np.bool_) if camera.free else undistort(camera.lens, pixels)[1]
    if not seen.all():
        row = int(np.argmin(seen))
        u, v = pixels[row]
        raise MeasurementError(
            f"{table.where}:{table.lines[row]}: the camera cannot see anything at the pixel u = {u:.6g}, v = "
            f"{v:.6g}: its distortion ends the image before; is the pixel outside the image, or are k1, k2, p1, p2, k3 "
            "wrong?"
        )
    return read_only(np.column_stack([pixels, filled(table, dict.fromkeys(BOARD, "length"))]))


def _points(table: Table, kind: Kind) -> Array | None:
    """Return where in the tool's frame the rows' points are (N, 3), None where no column says it."""
    told = [name for name in POINT if name in table.columns]
    if told and kind in ("pose", "pixels"):
        raise MeasurementError(
            f"{table.where}: column {told[0]!r} says where in the tool's frame a point was seen, and observes = "
            f"{kind!r} has no such point; leave it out."
        )
    return filled(table, dict.fromkeys(POINT, "length")) if told else None


def _paired(rows: Measurements, pair: tuple[str, ...] | None) -> Measurements:
    """Return rows of which each has both ends, from rows of one end each; those of one ``pair`` belong together."""
    if pair is None:
        raise MeasurementError(f"{rows.where}: there is no column 'pair', which says which two rows are the ends.")
    ends: dict[str, list[int]] = {}
    for row, name in enumerate(pair):
        ends.setdefault(name, []).append(row)
    for name, found in ends.items():
        if len(found) != 2:
            raise MeasurementError(
                f"{rows.where}:{rows.lines[found[-1]]}: the pair {name!r} has {len(found)} "
                f"{'row' if len(found) == 1 else 'rows'}; a pair has 2 ends."
            )
        if rows.value[found[0], 0] != rows.value[found[1], 0]:
            raise MeasurementError(
                f"{rows.where}:{rows.lines[found[1]]}: the pair {name!r} has two lengths; both rows must have "
                "the same one."
            )
        if rows.setup[found[0]] != rows.setup[found[1]]:
            raise MeasurementError(
                f"{rows.where}:{rows.lines[found[1]]}: the pair {name!r} has its ends in two set-ups; both must be "
                "in one."
            )
    first, second = np.array(list(ends.values()), dtype=np.intp).T
    return replace(rows.subset(first), other=rows.ends[0].subset(second))


def _noise(
    table: Table,
    groups: Sequence[tuple[str, ...]],
    dimension: Dimension,
    options: dict[str, Array | float | None],
    width: int,
) -> Array:
    """Return standard deviations (N, width) from the only one of options and column groups that is there, or 0."""
    given = {name: value for name, value in options.items() if value is not None}
    columns = [names for names in groups if any(name in table.columns for name in names)]
    sources = [*given, *("column " + ", ".join(names) for names in columns)]
    if len(sources) > 1:
        raise MeasurementError(f"{table.where}: the noise is given twice, by {' and by '.join(sources)}; keep one.")
    for name, value in given.items():
        if isinstance(value, float | int):
            refuse_beyond(value, _SIGMAS[dimension], f"{table.where}: {name}")
    values: Array | float = next(iter(given.values()), 0.0)
    for names in columns:
        require(table, names, "of the noise")
        values = stacked(table, dict.fromkeys(names, dimension))
        allowed = RANGES[_SIGMAS[dimension]]
        low, high = allowed.ends
        wrong = ((values < low) & (values != 0.0)) | (values > high)
        if wrong.any():
            row, axis = np.argwhere(wrong)[0]
            raise MeasurementError(
                f"{table.where}:{table.lines[row]}: column {names[axis]!r} is out of range; allowed is {allowed}."
            )
    return np.broadcast_to(values, (len(table), width))
