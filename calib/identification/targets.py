"""Targets: what was touched or seen beside an instrument, or a camera there, and which of it is unknown.

Sockets, anchors, balls and marks are points, surfaces are planes, boards and cameras are frames.

Targets are nuisances: their unknowns are found with the robot's and are of no use elsewhere.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.ranges import refuse_no_placement
from calib.foundations.sealing import sealed
from calib.identification.machine import POSE, Layout
from calib.identification.parameters import Parameter, width
from calib.measurement.kinds import Kind
from calib.measurement.measurements import Measurements

Shape = Literal["point", "plane", "frame"]

SHAPES: Mapping[Kind, Shape] = {
    "socket": "point",
    "distance": "point",
    "sphere": "point",
    "plane": "plane",
    "indicator": "plane",
    "pixels": "frame",
}
# What cannot be one and the same thing, though both are points. An anchor may sit in a socket or carry a ball.
_THINGS: Mapping[Kind, str] = {"socket": "socket", "sphere": "ball"}
_UNKNOWN: Mapping[Shape, tuple[tuple[str, int], ...]] = {
    "point": (("x", 0), ("y", 1), ("z", 2)),
    "plane": (("height", 2), ("rx", 3), ("ry", 4)),
    "frame": tuple((component, entry) for entry, component in enumerate(POSE)),
}


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Target:
    """What is known of a target, in the instrument's frame.

    ``pose`` (4, 4): that of a board or camera, a point's position, or a frame in whose x and y a plane lies; its z
    points to the side from which the plane is touched. ``height_is_known``: False where a plane's normal alone is
    known, such as an indicator's direction; its zero is then found.
    """

    __repr__ = brief

    pose: Array
    height_is_known: bool = True

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_no_placement(self.pose, "target: pose")


def shape_of(data: Measurements) -> Shape | None:
    """Return the shape of the targets of one set, None where its kind has none."""
    # Of a single mark beside the robot, which way it is turned does not show.
    mark = data.camera is not None and data.camera.camera_on == "tip" and not data.of_boards
    return "point" if mark else SHAPES.get(data.kind)


def shapes(sets: Sequence[Measurements]) -> dict[str, Shape]:
    """Return the shape of every target of sets with common names.

    Raises MeasurementError when one target is a point in one set and a plane in another, or a socket and a ball.
    """
    found: dict[str, Shape] = {}
    things: dict[str, str] = {}
    for data in sets:
        shape = shape_of(data)
        for name in dict.fromkeys(data.targets[t] for t in data.target) if shape else ():
            if shape and found.setdefault(name, shape) != shape:
                raise MeasurementError(
                    f"{data.where}: the target {name!r} is a {shape} here and a {found[name]} in another table; give "
                    "one of them another name."
                )
            thing = _THINGS.get(data.kind)
            if thing and things.setdefault(name, thing) != thing:
                raise MeasurementError(
                    f"{data.where}: the target {name!r} is a {thing} here and a {things[name]} in another table; give "
                    "one of them another name."
                )
    return found


def refuse_unmeasured(names: Iterable[str], found: Mapping[str, Shape]) -> None:
    """Raise JobError for a known target that is none of those ``found`` in measurements."""
    for name in names:
        if name not in found:
            there = ", ".join(found) or "no targets"
            raise JobError(f"targets: {name!r} does not appear in the measurements, which have {there}.")


def unknowns(sets: Sequence[Measurements], known: Mapping[str, Target], layout: Layout) -> tuple[Parameter, ...]:
    """Return the parameters of targets and scalars for sets with common names, in the order of the state.

    Raises MeasurementError as :func:`shapes` does, JobError for an indicator whose direction nobody gave.
    """
    parameters: list[Parameter] = []
    found = shapes(sets)
    for t, name in enumerate(sets[0].targets):
        of_target = known.get(name)
        if name not in found or (of_target is not None and of_target.height_is_known):
            continue
        for component, entry in _UNKNOWN[found[name]][: 1 if of_target is not None else None]:
            unit: Literal["m", "rad"] = "rad" if entry > 2 else "m"
            entries = ((layout.targets + 6 * t + entry, 1.0),)
            parameters.append(
                Parameter(f"target.{name}.{component}", unit, "target", entries, weak_prior=width("target", unit))
            )
    for data in sets:
        if data.kind == "indicator":
            _refuse_no_direction(data, known)
    for k, one in enumerate(sets[0].scalars):
        entries = ((layout.scalars + k, 1.0),)
        centre = None if one.prior is None else one.start
        parameters.append(
            Parameter(
                one.name,
                one.unit,
                "instrument",
                entries,
                one.prior,
                one.size,
                weak_prior=one.weak_prior,
                centre=centre,
            )
        )
    return tuple(parameters)


def _refuse_no_direction(data: Measurements, known: Mapping[str, Target]) -> None:
    for name in dict.fromkeys(data.targets[t] for t in data.target):
        if name not in known:
            raise JobError(f"{data.where}: the direction of the indicator {name!r} is not given; give its normal.")
