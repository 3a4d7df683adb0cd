"""Acceptance figures of articulated arm CMMs, after the methods of ASME B89.4.22 and ISO 10360-12.

After the method of: the figures are those that the tests define, computed from touches whose number and places are the
user's affair; they certify nothing. Where the wording of a standard was not at hand, a definition says what it assumes.
Sources: ASME B89.4.22-2004, for its tests (effective diameter, single-point articulation, volumetric performance);
ISO 10360-12:2016 as Kreon, a maker of arms, describes it; ISO 10360-5:2020, whose symbols it shares. All are named
where they are used, and in docs/arm_cmm_performance.md.

All points are centres of the probe ball in the arm's base: where the arm stands does not enter. Where the ball sits on
the arm does. It is found as that of every such probe, from a cone touched in many articulations, and in the same way
for the nominal and the calibrated arm: see :func:`calib.positioner.pivot.pivot`. SI throughout.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from calib.assessment.spheres import Sphere, least_squares_sphere, smallest_enclosing_sphere
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only, rows_by_word
from calib.foundations.brief import brief
from calib.foundations.errors import MeasurementError, naming_rows
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.machine.calibrated import CalibratedMachine
from calib.measurement.conditions import refuse_lacking
from calib.measurement.poses import ONE_POSE
from calib.measurement.touches import Touches
from calib.positioner.pivot import pivot
from calib.robot.conditions import Conditions

# What is not known of a probe moves touches alike up to this turn of it, in rad: readings scatter by less.
_TURNED = 1e-2


class Tips(Protocol):
    """Where an arm's tip link is."""

    def __call__(self, readings: Array, /, *, conditions: Conditions) -> Array:
        """Return its placements (N, 4, 4) in the base at readings (N, nr) in rad and m."""


# ---- the figures, from points


@dataclass(frozen=True, slots=True)
class PerformanceFigure:
    """One acceptance figure: ``value`` in m, from ``n`` touches, lengths or articulations."""

    test: str
    place: str
    n: int
    name: str
    value: float


Figures = tuple[PerformanceFigure, ...]


def _figures(test: str, place: str, n: int, values: Mapping[str, float]) -> Figures:
    return tuple(PerformanceFigure(test, place, n, name, float(value)) for name, value in values.items())


def single_point_articulation(points: Array, place: str = "cone") -> Figures:
    """Return the single-point articulation performance of points (N, 3), N >= 2, after the method of ASME B89.4.22.

    One cone, touched with the arm in articulations as different as can be. With d_n = |x_n - mean(x)|:

        largest = max d_n,    2s = 2 sqrt(sum d_n^2 / (N - 1)).

    Usual are 10 touches at each of three places, near, middle and far. Assumed, since the standard's wording was not at
    hand: the divisor N - 1, and that s takes the three coordinates together, as the distance does.

    Raises MeasurementError for a single point.
    """
    if len(points) < 2:
        raise MeasurementError(f"cone {place!r}: has one touch; the test takes two or more.")
    squares = np.sum((points - points.mean(axis=0)) ** 2, axis=1)
    two_s = 2.0 * np.sqrt(squares.sum() / (len(points) - 1))
    values = {"largest": np.sqrt(squares.max()), "2s": two_s}
    return _figures("single-point articulation", place, len(points), values)


def volumetric_lengths(measured: Array, known: Array) -> Figures:
    """Return the volumetric performance of measured lengths (N,) in m, after the method of ASME B89.4.22.

    With D_n = measured - known:

        largest = D_n of the largest |D_n|, signed,    range = max D_n - min D_n,    2s = 2 sqrt(sum D_n^2 / N).

    Usual are 20 lengths, short and long, all about the volume. Assumed, since the standard's wording was not at hand: s
    is taken about zero and not about the mean. The lengths are known, so an error of scale shall count.
    """
    D = measured - known
    two_s = 2.0 * np.sqrt(np.mean(D**2))
    values = {"largest": D[np.argmax(np.abs(D))], "range": np.ptp(D), "2s": two_s}
    if len(D) < 2:
        del values["range"]  # it would be zero, whatever the arm
    return _figures("volumetric length", "all", len(D), values)


def probing(points: Array, diameter: float, ball: float, place: str = "sphere") -> Figures:
    """Return the probing errors of ball centres (N, 3) that touch a sphere, after the method of ISO 10360-12.

    With the Gaussian associated sphere (:func:`calib.assessment.spheres.least_squares_sphere`) of diameter D:

        PSize.Sph.1x25 = D - ball - diameter,    PForm.Sph.1x25 = max r_n - min r_n,

    r_n the distances from its centre: the thickness of the shell about that centre that holds all points. Both come
    from the same touches (ISO 10360-5:2020, clause 6). A touching ball stays half its diameter away, hence ``ball``.
    The standard asks for 25 touches in each of two places; of these the worse one counts (Kreon).

    Raises MeasurementError when the points do not determine a sphere, and for four, which always lie on one.
    """
    sphere = _sphere(points, place)
    if len(points) < 5:
        raise MeasurementError(f"sphere {place!r}: has four touches; the test takes five or more.")
    sizes = {"PSize": 2.0 * sphere.radius - ball - diameter, "PForm": np.ptp(sphere.distances(points))}
    n = len(points)
    return _figures("probing", place, n, {f"{name}.Sph.1x{n}": value for name, value in sizes.items()})


def articulated_location(points: Sequence[Array], place: str = "sphere") -> Figures:
    """Return the articulated location error of one sphere, after the method of ISO 10360-12.

    ``points``: ball centres (N, 3) in m, one array for each articulation. In every one the sphere's centre is found by
    least squares; LDia.5x5 (five articulations of five touches) is the diameter of the smallest sphere that holds these
    centres. Assumed, since the standard's wording was not at hand: that sphere, as the name LDia says, and that every
    fit has its own diameter. So neither ball nor reference diameter enters.

    Raises MeasurementError when the points of an articulation do not determine a sphere, and for a single articulation.
    """
    if len(points) < 2:
        raise MeasurementError(f"sphere {place!r}: has one articulation; the test takes two or more.")
    centres = np.stack([_sphere(touched, place).centre for touched in points])
    diameter = 2.0 * smallest_enclosing_sphere(centres).radius
    n, touches = len(points), max(map(len, points))
    return _figures("articulated location", place, n, {f"LDia.{n}x{touches}": diameter})


def _sphere(points: Array, place: str) -> Sphere:
    try:
        return least_squares_sphere(points)
    except MeasurementError as e:
        raise MeasurementError(f"sphere {place!r}: {e}") from e


# ---- the figures, from touches


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Performance:
    """What the tests say of one arm: its ``figures``, in the order of the tests.

    ``probe`` (3,): the ball's centre on the tip link, in m, as it was found.
    """

    __repr__ = brief

    probe: Array
    figures: Figures

    def records(self) -> list[dict[str, Any]]:
        """Return one plain record for every figure."""
        return [asdict(figure) for figure in self.figures]


@checked
def before_and_after(
    machine: CalibratedMachine, tests: Sequence[Touches], probe: Touches | None = None
) -> tuple[Performance, Performance]:
    """Return the performance of the nominal and of the calibrated arm in the same tests.

    The probe is found anew for both arms, from ``probe``, touches of cones, or else from the tests' own cones. There
    are two reasons: the reflector of the calibration is not the ball of the test, and with the ball of the calibrated
    arm, the nominal arm would also show what the calibration shifted between the tip link and the tool. Separate
    touches are the better choice, because the tests' own cones would lose three degrees of freedom to the probe.
    Without any cone, both arms use the first tool on the tip of the calibrated arm, or the tip itself.

    Raises MeasurementError when a test cannot be evaluated, as of a cone touched in one pose, or lacks what a joint
    term of the arm needs.
    """
    for test in (*tests, *(() if probe is None else (probe,))):
        refuse_lacking(machine.robot, test.conditions, test.where)
    own = [T[:3, 3] for name, T in machine.tools.items() if machine.of(name).robot.tip == machine.robot.tip]
    tool = own[0] if own else np.zeros(3)
    return performance(machine.robot.tips, tests, probe, tool), performance(machine.tips, tests, probe, tool)


def _placed(tips: Tips, test: Touches) -> Array:
    with naming_rows(test.where, test.lines):
        return tips(test.readings, conditions=test.conditions)


def performance(tips: Tips, tests: Sequence[Touches], probe: Touches | None, guess: Array) -> Performance:
    """Return the performance of the arm whose tip link is where ``tips`` says; ``guess`` (3,) as in probe_point.

    Raises MeasurementError when a test cannot be evaluated, or when ``probe`` holds other touches than of cones.
    """
    if probe is not None and probe.kind != "cone":
        raise MeasurementError(f"{probe.where}: is a {probe.kind} test; the probe is found from touches of a cone.")
    cones = [test for test in tests if test.kind == "cone"] if probe is None else [probe]
    point, unseen, where = guess, np.zeros((3, 0)), ", ".join(cone.where for cone in cones)
    if cones:
        frames = np.concatenate([_placed(tips, cone) for cone in cones])
        # The same name in two tables is not the same cone.
        names = [f"{i} {name}" for i, cone in enumerate(cones) for name in cone.words["target"]]
        point, unseen = _probe(frames, names, guess, where)
    found: list[PerformanceFigure] = []
    for test in tests:
        frames = _placed(tips, test)
        if test not in cones:
            _refuse_unseen(test, frames[:, :3, :3] @ unseen, where)
        found += _figures_of(test, frames[:, :3, :3] @ point + frames[:, :3, 3])
    return Performance(read_only(point), tuple(found))


def _probe(tips: Array, cones: Sequence[str], guess: Array, where: str) -> tuple[Array, Array]:
    """Return the probe point, found from touches that leave something to be judged once it and the cones are known.

    Also the directions (3, k) on the tip link along which they do not tell it, since they do not turn it so.
    """
    found = pivot(tips, cones, guess=guess)
    unknown = 3 * len(found.targets) + 3
    if 3 * len(tips) <= unknown:
        raise MeasurementError(
            f"{where}: {3 * len(tips)} numbers were touched, and the places of cones and probe take {unknown}; touch "
            "more, in many articulations."
        )
    return found.tool_point, found.null_basis


def _refuse_unseen(test: Touches, unseen: Array, where: str) -> None:
    """Raise MeasurementError where what is not known of the probe enters the figures of a test.

    ``unseen`` (N, 3, k): its directions at the touches. Where they are the same at all touches that are compared, as
    those of planar arms are, it moves all of these alike.
    """
    moved = [
        np.ptp(unseen[rows], axis=0)
        for rows in rows_by_word(test.words["pair" if test.kind == "length" else "target"]).values()
    ]
    if moved and float(np.max(moved, initial=0.0)) > _TURNED:
        raise MeasurementError(
            f"{where}: the touches of a cone turn the probe about one axis or none, and do not tell where it is along "
            f"that; the figures of {test.where}, which turns it otherwise, depend on it. Touch the cone at other tilts "
            "as well."
        )


def _figures_of(test: Touches, points: Array) -> Figures:
    try:
        if test.kind == "length":
            return _lengths(test, points)
        places = rows_by_word(test.words["target"]).items()
        return tuple(figure for place, rows in places for figure in _at_place(test, points, rows, place))
    except MeasurementError as e:
        raise MeasurementError(f"{test.where}: {e}") from e


def _at_place(test: Touches, points: Array, rows: IntArray, place: str) -> Figures:
    if test.kind == "sphere":
        return probing(points[rows], _only(test, "diameter", rows), _only(test, "ball", rows), place)
    if test.kind == "articulations":
        each = rows_by_word([test.words["group"][n] for n in rows]).values()
        return articulated_location([points[rows[own]] for own in each], place)
    if len(rows) > 1 and float(np.ptp(test.readings[rows], axis=0).max()) <= ONE_POSE:
        raise MeasurementError(
            f"cone {place!r}: all {len(rows)} touches are in one pose; the test takes articulations as different as "
            "can be."
        )
    return single_point_articulation(points[rows], place)


def _lengths(test: Touches, points: Array) -> Figures:
    measured, known = [], []
    for pair, rows in rows_by_word(test.words["pair"]).items():
        ends = rows_by_word([test.words["target"][n] for n in rows])
        if len(ends) != 2:
            listed = ", ".join(map(repr, ends))
            raise MeasurementError(f"pair {pair!r} has the ends {listed}; a length has two.")
        a, b = (points[rows[own]].mean(axis=0) for own in ends.values())
        measured.append(float(np.linalg.norm(b - a)))
        known.append(_only(test, "length", rows))
    return volumetric_lengths(np.array(measured), np.array(known))


def _only(test: Touches, column: str, rows: IntArray) -> float:
    values = test.sizes[column][rows]
    if (other := values != values[0]).any():
        n = int(np.argmax(other))
        lines = test.lines[rows]
        raise MeasurementError(
            f"column {column!r} is {values[0] / MM:.6g} mm in line {lines[0]} and {values[n] / MM:.6g} mm in line "
            f"{lines[n]} of the same target or pair."
        )
    return float(values[0])
