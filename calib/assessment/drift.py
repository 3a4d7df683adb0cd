"""Two calibrations of one machine: what has moved by more than their joint uncertainty, and what that means at the tip.

Parameters are compared in the state of the robot: six deviations of every joint, the offsets of those that move, and
the coefficients of joint terms. What one of the two did not see, or what stated priors decided, is no difference: the
joint test takes the combinations that both have determined.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.brief import brief
from calib.foundations.chance import bound as bound_of
from calib.foundations.chance import exceeded
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread, svd
from calib.foundations.words import listed
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools
from calib.identification.parameters import DEFAULT_SIGMA
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import mean_square_shifts, tool_motions
from calib.machine.turns import turned_towards
from calib.machine.uncertainty import Uncertainty
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions, ordinary
from calib.robot.deviation import COMPONENTS
from calib.robot.joint_terms import with_joint_terms
from calib.robot.robot import Robot
from calib.robot.sampling import random_readings
from calib.robot.terms import kind_of

CONFIDENCE = 0.95
# As in calib.identification.identifiability: a direction of the null space that moves an entry by less has no part in
# it.
_MOVED = 0.02
# Directions of the null spaces of two calibrations that differ by less, as the sine of an angle, are the same.
_SAME_DIRECTION = 0.05
# What varies by less than this share of the rest, or of a parameter scale, varies by rounding.
_ROUNDING = 1e-9
_SAMPLES = 500
# In which readings are looked at, in s.
_YEARS = 1e11


# A machine, and readings with their conditions in the order of its joints.
_Told = tuple[CalibratedMachine, Array, Conditions]


@dataclass(frozen=True, slots=True)
class Change:
    """What became of one parameter: ``old``, ``new`` and the ``sigma`` of their difference, in ``unit``.

    ``unit``: m, rad, or that of the coefficient of a joint term. ``moved``: by more than chance explains at 95 %, for
    all parameters together. ``at_tip``: rms in m of what the difference alone does to the tool.
    """

    name: str
    unit: str
    old: float
    new: float
    sigma: float
    moved: bool
    at_tip: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two calibrations of one machine. Made by :func:`compare`.

    ``changes``: of parameters that both have determined by themselves. ``statistic`` follows chi-square (F, with
    estimated noise) with ``degrees_of_freedom``; ``probability`` of a larger one if nothing has moved; both None where
    the two free different parameters. ``tip_rms``, ``tip_max``: in m, of all tools that both have, over the poses
    that both were identified in, base and tools of the one fitted to the other; ``stated``: rms of what both
    uncertainties explain of that.
    """

    __repr__ = brief

    changes: tuple[Change, ...]
    statistic: float | None
    degrees_of_freedom: int
    probability: float | None
    tip_rms: float
    tip_max: float
    stated: float

    @property
    def moved(self) -> bool:
        """Whether some parameter has, or all together have, moved by more than the joint uncertainty."""
        together = self.probability is not None and self.probability < 1.0 - CONFIDENCE
        return together or any(change.moved for change in self.changes)

    def contents(self) -> dict[str, Any]:
        """Return the comparison as plain data, in m and rad."""
        return {
            "moved": self.moved,
            "changes": [asdict(change) for change in self.changes],
            "statistic": self.statistic,
            "degrees_of_freedom": self.degrees_of_freedom,
            "probability": self.probability,
            "tip": {"rms": self.tip_rms, "max": self.tip_max, "stated": self.stated},
        }


@checked
def compare(old: CalibratedMachine, new: CalibratedMachine, *, seed: int = 0) -> Comparison:
    """Compare two calibrations of one machine.

    Raises MeasurementError when they are of different ones, or the uncertainty of one is not known.
    """
    robot = old.robot
    if differs := _other_arms(robot, new.robot):
        raise MeasurementError(f"the two calibrations are not of one machine: {differs}.")
    if set(old.tools).isdisjoint(new.tools):
        olds, news = (listed(list(machine.tools)) for machine in (old, new))
        raise MeasurementError(f"the two calibrations have no tool in common: {olds}; and {news}.")
    entries = _Entries.of(old, new)
    before, after = (_Side.of(machine, entries) for machine in (old, new))
    free_old, free_new = before.free, after.free
    difference = after.values - before.values
    apart = _along_null_spaces(before, after)
    # An entry that the data determine may have a small part in the null space, and the tool be decimetres off along it.
    sigmas = np.sqrt(sum(np.sum(part**2, axis=1) for part in (before.shown, after.shown, apart)))
    known = free_old & free_new & ~before.unidentifiable & ~after.unidentifiable
    nu = min(machine.known_uncertainty.degrees_of_freedom for machine in (old, new))
    readings = _common_readings(old, new, seed)
    told = _common_conditions(old, new, readings, seed)
    # All parameters together shall be called moved once in twenty when none is: Bonferroni's share for each.
    tests = max(int(np.count_nonzero(known)), 1)
    bound = np.sqrt(bound_of(1.0 - (1.0 - CONFIDENCE) / tests, 1, nu))
    tools = [name for name in old.tools if name in new.tools]
    by_entry = _by_entry(before, tools, readings, told)
    changes = []
    for k in np.flatnonzero(known):
        sigma = float(sigmas[k])
        changes.append(
            Change(
                entries.names[k],
                entries.units[k],
                float(before.values[k]),
                float(after.values[k]),
                sigma,
                bool(abs(difference[k]) > bound * sigma),
                float(by_entry[k] * abs(difference[k])),
            )
        )
    statistic, freedom, probability = None, 0, None
    if np.array_equal(free_old, free_new):
        statistic, freedom = _together(before, after, apart)
        if freedom:
            probability = float(exceeded(statistic, freedom, nu))
    told_to = [(machine, *_as_read_by(robot, machine, readings, told)) for machine in (old, _loaded_as(old, new))]
    errors = _at_tip(told_to[0], told_to[1], tools)
    stated = sum(_stated(*one, tools) for one in told_to)
    return Comparison(
        tuple(changes),
        statistic,
        freedom,
        probability,
        float(np.sqrt(np.mean(errors**2))),
        float(errors.max()),
        float(np.sqrt(stated)),
    )


def other_machine(one: Robot, other: Robot) -> str:
    """Return in words how two nominal robots are not the same, "" where they are."""
    if [reading.name for reading in one.readings] != [reading.name for reading in other.readings]:
        return "they have readings of other joints"
    if _joints(one) != _joints(other) or not np.allclose(
        [joint.placement for joint in one.chain], [joint.placement for joint in other.chain], atol=1e-9
    ):
        return "their nominal URDFs differ"
    return ""


def _other_arms(one: Robot, other: Robot) -> str:
    """Return :func:`other_machine` of two robots whose arms may be named in another order."""
    names = [[joint.name for joint in robot.chain] for robot in (one, other)]
    if names[0] == names[1] or set(names[0]) != set(names[1]):
        return other_machine(one, other)
    known = {joint.name: joint for joint in other.chain}
    alike = (
        joint.type == known[joint.name].type and np.allclose(joint.placement, known[joint.name].placement, atol=1e-9)
        for joint in one.chain
    )
    return "" if all(alike) else "their nominal URDFs differ"


def _joints(robot: Robot) -> tuple[tuple[str, str], ...]:
    return tuple((joint.name, joint.type) for joint in robot.chain)


class _Entries(NamedTuple):
    """What of the state of two robots is compared: names, units, and the parameter scale of each.

    The geometry of the old one, then the coefficients of the joint terms of either.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: Array

    @classmethod
    def of(cls, old: CalibratedMachine, new: CalibratedMachine) -> "_Entries":
        robot = old.robot
        names, units = [*_geometry(robot)], [*_geometry(robot).values()]
        dimensions = {reading.name: reading.dimension for reading in robot.readings}
        terms = {term.name: term for machine in (old, new) for term in machine.robot.terms}
        coefficients = [
            kind_of(term).coefficient(term, dimensions.get(term.reading, "angle")) for term in terms.values()
        ]
        scale = np.append(np.full(len(names), DEFAULT_SIGMA), [of_term.typical_size for of_term in coefficients])
        units.extend(of_term.unit for of_term in coefficients)
        return cls((*names, *terms), tuple(units), scale)


def _geometry(robot: Robot) -> dict[str, str]:
    """Return the names of the state of a robot without joint terms, in order, and the unit of each."""
    units = {f"{joint.name}.{c}": "m" if c.startswith("t") else "rad" for joint in robot.chain for c in COMPONENTS}
    moving = (robot.chain[i] for i in robot.moving)
    return units | {f"{joint.name}.offset": "m" if joint.type == "prismatic" else "rad" for joint in moving}


def _as_read_by(
    robot: Robot, machine: CalibratedMachine, readings: Array, told: Conditions
) -> tuple[Array, Conditions]:
    """Return readings (N, nr) of a robot, and their conditions, in the order of a machine's."""
    names = [reading.name for reading in robot.readings]
    order = [names.index(reading.name) for reading in machine.robot.readings]
    sides, torque = (None if values is None else values[:, order] for values in (told.approach, told.torque))
    return readings[:, order], replace(told, approach=sides, torque=torque)


def _loaded_as(one: CalibratedMachine, other: CalibratedMachine) -> CalibratedMachine:
    """Return another machine under the load of one: first set-ups, at which machines are, may have carried others."""
    load, robot = one.robot.load, other.robot
    payload = load.payload and replace(load.payload, link=load.payload.link or one.robot.links[0])
    if not robot.terms or load == robot.load or (payload and payload.link not in robot.links):
        return other
    alike = replace(robot, gravity=load.gravity, payload=payload, loads={})
    return replace(other, robot=with_joint_terms(alike, robot.terms), in_urdf=None)


class _Side(NamedTuple):
    """One of two machines, in the n entries that are compared and, where it says so, in its whole state as well.

    ``rows`` (n,): where the entries are in the state; of a joint term that the machine does not have, behind its end.
    ``shown`` (n, k): as :attr:`Uncertainty.shown`. ``unseen`` (m + 1, k): of the whole state and of nothing behind it,
    the directions that the data do not determine, be they nobody's or a stated prior's.
    """

    machine: CalibratedMachine
    entries: _Entries
    rows: IntArray
    values: Array
    shown: Array
    unseen: Array

    @classmethod
    def of(cls, machine: CalibratedMachine, entries: _Entries) -> "_Side":
        layout, known = machine.layout, machine.known_uncertainty
        own = {name: k for k, name in enumerate((*_geometry(machine.robot), *(t.name for t in machine.robot.terms)))}
        rows = np.array([own.get(name, layout.size) for name in entries.names], dtype=np.intp)
        state = np.zeros(layout.size + 1)
        of_robot = machine.deviations
        state[: layout.base] = np.concatenate([of_robot.placements.ravel(), of_robot.offsets, of_robot.terms])
        scale = np.full(layout.size + 1, DEFAULT_SIGMA)
        scale[rows] = entries.scale
        unseen = _unseen(known, scale[:-1, None])
        return cls(machine, entries, rows, state[rows], _ended(known.shown)[rows], _ended(unseen))

    @property
    def free(self) -> BoolArray:
        """Which entries the calibration has moved."""
        of_null = self.machine.known_uncertainty
        whole = np.hstack([_ended(of_null.factor), _ended(of_null.null_basis)])[self.rows]
        return np.asarray(np.linalg.norm(whole, axis=1) > _ROUNDING * self.entries.scale)

    @property
    def unidentifiable(self) -> BoolArray:
        """Which entries have a part in what the data do not determine, or are held where the data show nothing."""
        scale = self.entries.scale
        held = np.linalg.norm(self.shown, axis=1) <= _ROUNDING * scale
        return np.asarray(held | (np.linalg.norm(self.unseen[self.rows], axis=1) > _MOVED * scale))


def _ended(columns: Array) -> Array:
    """Return columns (n, k) of a state, and behind them a row of zeros."""
    return np.vstack([columns, np.zeros((1, columns.shape[1]))])


def _unseen(known: Uncertainty, scale: Array) -> Array:
    """Return the null space (n, k), and the directions in which a stated prior decides more than the data.

    There the estimates of two sessions agree because both stay near what was stated, and their noise is next to none.
    ``scale`` (n, 1): parameter scales, by which entries are compared.
    """
    instrument, parameters, _ = known.causes
    by_priors = known.factor[:, instrument : instrument + parameters] / scale
    null = known.null_basis / scale
    inside, values, _ = svd(null, full_matrices=False)
    inside = inside[:, values > _ROUNDING * values.max(initial=0.0)]
    directions, sizes, _ = svd(by_priors - inside @ (inside.T @ by_priors), full_matrices=False)
    decided = directions[:, sizes > np.linalg.norm(directions.T @ (known.shown / scale), axis=1)]
    return np.hstack([known.null_basis, decided * scale])


def _along_null_spaces(old: _Side, new: _Side) -> Array:
    """Return by how much (n, k) the robots may differ along the null spaces though nothing has moved.

    As far as the common tools do: values of what is not seen are those that somebody has stated, or chance. And as far
    as these tools may have changed unseen, if they were mounted anew: by what is seen of that. Bases may have moved,
    and tell nothing.
    """
    count, tools_old, tools_new = len(old.values), old.machine.tools, new.machine.tools
    common = [name for name in tools_old if name in tools_new]
    changes = np.array([tools_new[name][:3, 3] - tools_old[name][:3, 3] for name in common])
    turns = [rigid.log3(tools_old[name][:3, :3].T @ tools_new[name][:3, :3]) for name in common]
    # A robot shows what of it is in a direction; of what is not, the tools tell.
    weight = np.append(DEFAULT_SIGMA / old.entries.scale / _SAME_DIRECTION, np.ones(6 * len(common)))
    d = np.zeros((len(weight), 1 + 3 * len(common)))
    d[:, 0] = np.append(new.values - old.values, np.column_stack([changes, turns]))
    for t, size in enumerate(np.linalg.norm(changes, axis=1)):
        d[count + 6 * t :, 1 + 3 * t :][:3, :3] = size * np.eye(3)
    found = []
    for side in (old, new):
        layout, names = side.machine.layout, list(side.machine.tools)
        tools = [layout.tools + 6 * names.index(name) + np.arange(6) for name in common]
        basis = side.unseen[np.concatenate([side.rows, *tools])]
        along = np.linalg.lstsq(weight[:, None] * basis, weight[:, None] * d, rcond=_ROUNDING)[0]
        found.append(basis[:count] @ along)
    return np.hstack(found)


def _together(old: _Side, new: _Side, apart: Array) -> tuple[float, int]:
    """Return the statistic of the difference in the combinations that both have determined, and their number.

    ``apart`` (n, k): by how much the two may differ along their null spaces, which is no difference.
    One parameter may move several entries, as DH parameters do: no more combinations vary than there are parameters.
    """
    free = old.free
    scale = old.entries.scale[free][:, None]
    null_basis = np.hstack([side.unseen[side.rows] for side in (old, new)])[free] / scale
    d = (new.values - old.values)[free] / scale[:, 0]
    seen = [*(side.shown[free] / scale for side in (old, new)), apart[free] / scale, d[:, None]]
    *factors, allowed, d_across = _across(null_basis, seen)
    both = np.hstack([*factors, allowed])
    size = np.linalg.norm(both, axis=1)
    size[size == 0.0] = 1.0
    # Of both together a few more seem to vary: what a parameter moves differs a little from one machine to the other.
    varying = max(np.linalg.matrix_rank(factor / size[:, None], rtol=_ROUNDING) for factor in factors)
    V, spread, _ = svd(both / size[:, None], full_matrices=False)
    z = V[:, :varying].T @ (d_across[:, 0] / size) / spread[:varying]
    return float(z @ z), int(varying)


def _across(basis: Array, columns: Sequence[Array]) -> list[Array]:
    """Return columns (n, k) in axes (n - r, k) that stand on all directions of a basis (n, m), of which r differ.

    The axes are never made: of a machine of thousands of joint terms they would take half a gigabyte.
    """
    if not basis.size:
        return list(columns)
    (reflections, tau), R = scipy.linalg.qr(basis, mode="raw")
    reflections = reflections[:, : len(tau)]
    U, values, _ = svd(np.asarray(R[: len(tau)], dtype=np.float64))
    size = int(np.count_nonzero(values > _SAME_DIRECTION * values.max(initial=0.0)))
    found = []
    for part in columns:
        turned, _, info = scipy.linalg.lapack.dormqr("L", "T", reflections, tau, part, max(64 * part.shape[1], 1))
        assert info == 0, "shapes are as they should be"
        found.append(np.vstack([(U.T @ turned[: len(U)])[size:], turned[len(U) :]]))
    return found


def _common_readings(old: CalibratedMachine, new: CalibratedMachine, seed: int) -> Array:
    names = [reading.name for reading in new.robot.readings]
    order = [names.index(reading.name) for reading in old.robot.readings]
    before, after = old.known_uncertainty.identified, new.known_uncertainty.identified[order]
    # The same readings, told in another turn, are a range in common.
    middle = after.mean(axis=1)
    turned = turned_towards(
        middle[None], before[:, 0], before[:, 1], [reading.turns for reading in old.robot.readings]
    )[0]
    after = after + (turned - middle)[:, None]
    low, high = np.maximum(before[:, 0], after[:, 0]), np.minimum(before[:, 1], after[:, 1])
    # Where the two have no range in common, that of the new one.
    apart = (low > high)[:, None]
    limits = np.where(apart, after, np.stack([low, high], axis=1))
    known = (machine.known_uncertainty.closure_determinant for machine in (old, new))
    determinants = [one for one in known if one is not None]
    nearest = max(determinants, key=abs) if len({one > 0.0 for one in determinants}) == 1 else None
    # Loops are those of the old robot, whose deviations have another order where its arms have, and maybe other terms.
    later = new.deviations
    if new.robot.terms != old.robot.terms:
        later = replace(later, terms=np.zeros_like(old.deviations.terms))
    machines = (old.deviations, later if order == sorted(order) else None)
    return random_readings(old.robot, _SAMPLES, limits, machines, determinant=nearest, seed=seed)


def _common_conditions(old: CalibratedMachine, new: CalibratedMachine, readings: Array, seed: int) -> Conditions:
    """Return conditions of readings (N, nr) in which terms that need some show: any side, temperatures of both."""
    rng, usual = np.random.default_rng(seed), ordinary(readings)
    ranges = [m.known_uncertainty.conditions.get("temperature") for m in (old, new)]
    known = np.array([one for one in ranges if one is not None] or [2 * (REFERENCE_TEMPERATURE,)])
    low, high = known[:, 0].max(), known[:, 1].min()
    if low > high:
        low, high = known[-1]
    sides, temperature = rng.choice([-1.0, 1.0], readings.shape), rng.uniform(low, high, len(readings))
    # So far apart in time that what follows late has followed.
    return replace(usual, approach=sides, temperature=temperature).in_time(np.linspace(0.0, _YEARS, len(readings)))


def _by_entry(side: _Side, tools: Sequence[str], readings: Array, told: Conditions) -> Array:
    """Return the rms motion of the tool for each entry of the robot's state, in m per unit of it.

    Of several tools, of the one that it moves most.
    """
    moved = [mean_square_shifts(side.machine, readings, tool, conditions=told) for tool in tools]
    return np.append(np.sqrt(np.max(moved, axis=0)), 0.0)[side.rows]


def _stated(machine: CalibratedMachine, readings: Array, told: Conditions, tools: Sequence[str]) -> float:
    """Return the mean variance of the tools' positions that is left when base and tools are fitted, in m^2."""
    layout, names = machine.layout, list(machine.tools)
    of_robot = machine.known_uncertainty.shown.copy()
    of_robot[layout.base :] = 0.0
    places = [layout.tools + 6 * names.index(tool) + k for tool in tools for k in range(3)]
    entries = [*range(layout.base, layout.tools), *places]
    fitted = np.zeros((len(of_robot), len(entries)))
    fitted[entries, range(len(entries))] = 1.0
    columns = np.hstack([of_robot, fitted])
    moved = [tool_motions(machine, columns, readings, tool, conditions=told)[:, :3] for tool in tools]
    rows = np.concatenate(moved).reshape(-1, columns.shape[1])
    robots, frames = rows[:, : of_robot.shape[1]], rows[:, of_robot.shape[1] :]
    rest = robots - frames @ np.linalg.lstsq(frames, robots, rcond=None)[0]
    return float(np.sum(rest**2)) / (len(readings) * len(tools))


def _at_tip(old: _Told, new: _Told, tools: Sequence[str]) -> Array:
    """Return by how much (N,) the tools differ, base and tools of the old machine fitted to the new one."""
    (before, readings, told), (after, of_new, told_of_new) = old, new
    tips = np.concatenate([before.of(tool).tips(readings, told) for tool in tools])
    targets = np.concatenate(
        [(after.of(tool).tips(of_new, told_of_new) @ after.tools[tool])[:, :3, 3] for tool in tools]
    )
    guess = np.array([before.tools[tool] for tool in tools])
    number = np.repeat(np.arange(len(tools)), len(tips) // len(tools))
    rows = TipObservations(tips, targets, np.full((len(tips), 3, 3), np.nan), number)
    with one_thread(of_scipy=False):
        base, found, _ = base_and_tools(rows, KnownFrames(None, None, guess[:, :3, :3]), guess)
    return np.asarray(np.linalg.norm((base @ tips @ found[number])[:, :3, 3] - targets, axis=1))
