"""What all exports share: where they are judged, what they leave out and what that costs at the tip."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.errors import OutputError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import usual_conditions
from calib.machine.urdf import ROUNDING_AT_TIP, lost_in_urdf
from calib.robot.sampling import random_readings

Part = Literal[
    "placements",
    "placements of fixed joints",
    "offsets of joints that follow others",
    "joint terms",
    "closed loops and couplings",
    "residual model",
]

_POSES = 500


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A part of the calibration that a format has no place for; ``cost``: rms in m at the tip that the part makes.

    nan where nothing can be said, as the machine does not even take the same readings without it.
    """

    part: Part
    cost: float


@dataclass(frozen=True, slots=True)
class Export:
    """A file for a controller. ``text``: its contents. All figures are rms distances in m at the tip, base kept.

    ``before``: the nominal machine, and ``lost``: the machine of the file, both from the calibrated one whole. Over
    random poses of the identified range of readings, or of the joints' limits where the results do not tell it.
    """

    __repr__ = brief

    text: str
    before: float
    lost: float
    left_out: tuple[LeftOut, ...]

    def contents(self) -> dict[str, Any]:
        """Return the figures as plain data, None for a cost that is not known."""
        left = [{"part": part.part, "cost": None if np.isnan(part.cost) else part.cost} for part in self.left_out]
        return {"before": self.before, "lost": self.lost, "left_out": left}


def judged_readings(model: CalibratedMachine) -> Array:
    """Return random readings (500, nr) of the identified range, always the same, at which exports are judged."""
    known = model.uncertainty
    limits, determinant = (None, None) if known is None else (known.identified, known.closure_determinant)
    plain = replace(model.deviations, terms=np.zeros_like(model.deviations.terms))
    return random_readings(model.robot, _POSES, limits, (None, plain), determinant=determinant)


def whole_positions(model: CalibratedMachine, readings: Array) -> Array:
    """Return the positions (N, 3) in m of the tip in the base link: joint terms and residual grid included."""
    return np.asarray(model.tips(readings, usual_conditions(model, readings))[:, :3, 3])


def plain_tips(model: CalibratedMachine, readings: Array) -> Array:
    """Return the tips (N, 4, 4) in the base link of the best placements and offsets alone, at readings (N, nr)."""
    held = model.geometry
    return held.robot.tips(readings, replace(held.deviations, terms=np.zeros_like(held.deviations.terms)))


def as_placed(model: CalibratedMachine, tips: Array) -> Array:
    """Return tips (N, 4, 4) of ``model.geometry`` in the base link of the machine, as its own base and tool put them.

    Geometry that was fitted alone has a base and tools of its own.
    """
    held = model.geometry
    if held is model or not model.tools:
        return tips
    tool = next(iter(model.tools))
    to_base = rigid.inverse(model.base) @ held.base
    return np.asarray(to_base @ tips @ held.tools[tool] @ rigid.inverse(model.tools[tool]))


def rms(a: Array, b: Array) -> float:
    """Return the rms distance of positions (N, 3)."""
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))


def judged_export(
    model: CalibratedMachine,
    text: str,
    read_back: Callable[[Array], Array],
    expected: Array,
    holds: frozenset[Part],
    more: Sequence[LeftOut] = (),
) -> Export:
    """Return the export of a text that reads back as a machine with tips ``read_back(readings)`` (N, 4, 4).

    ``expected`` (N, 4, 4): what these are to be at :func:`judged_readings`; ``holds``: parts that the format has a
    place for, ``more``: what is left out beside whole parts.
    Raises OutputError when the machine read back is another one.
    """
    readings = judged_readings(model)
    tips = read_back(readings)
    difference = float(np.max(np.abs(tips - expected)))
    if not difference < ROUNDING_AT_TIP:
        raise OutputError(f"the file read back differs from the calibrated machine by {difference:.3g}.")
    whole = whole_positions(model, readings)
    nominal = model.robot.tips(readings, model.robot.no_deviations())[:, :3, 3]
    seen = as_placed(model, tips) if "placements" in holds else tips
    left = tuple(part for part in _parts(model, readings, holds) if part.part not in holds)
    return Export(text, rms(nominal, whole), rms(seen[:, :3, 3], whole), (*more, *left))


def _parts(model: CalibratedMachine, readings: Array, holds: frozenset[Part]) -> list[LeftOut]:
    """Return the parts that this calibration has, each with the distance that it makes at the tip.

    Of geometry that was fitted without them, terms and loops together are what it lacks.
    """
    robot, d, conditions = model.robot, model.deviations, usual_conditions(model, readings)
    tips = robot.tips(readings, d, conditions)
    found: list[LeftOut] = []
    if d.placements.any():
        without = robot.tips(readings, replace(d, placements=np.zeros_like(d.placements)), conditions)
        found.append(LeftOut("placements", rms(without[:, :3, 3], tips[:, :3, 3])))
    alone = model.in_urdf is not None and "placements" in holds
    lacking = rms(as_placed(model, plain_tips(model, readings))[:, :3, 3], tips[:, :3, 3]) if alone else np.nan
    if d.terms.any():
        without = robot.tips(readings, replace(d, terms=np.zeros_like(d.terms)))
        found.append(LeftOut("joint terms", lacking if alone else rms(without[:, :3, 3], tips[:, :3, 3])))
    if alone and (robot.loops or robot.couplings):
        found.append(LeftOut("closed loops and couplings", lacking))
    elif robot.loops or robot.couplings:
        bare, without_terms = replace(robot, terms=(), weights=None), replace(d, terms=np.zeros(0))
        found.append(LeftOut("closed loops and couplings", lost_in_urdf(bare, without_terms, readings)))
    if model.residual_model is not None:
        found.append(
            LeftOut("residual model", rms(model.residual_model.shifts(np.eye(4), tips, readings), np.zeros((1, 3))))
        )
    return found
