"""Inverse kinematics of the calibrated machine: the readings at which its tool is where it should be.

Damped Newton steps on all rows at once, with the exact derivative of the calibrated machine's tip by its readings; the
residual grid shifts the predicted position and changes too slowly to be differentiated. Redundant arms, and arms of
which positions alone are asked, take the readings that change least from where they start; 1 mm counts as 1 mrad.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.compensation.corrections import Corrections, joined
from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.choices import What
from calib.foundations.errors import JobError, PoseError
from calib.foundations.linear import one_thread, svd
from calib.foundations.sealing import sealed
from calib.foundations.units import DEG, MM, MRAD
from calib.machine.calibrated import CalibratedMachine
from calib.machine.residual_model import ResidualModel
from calib.robot.conditions import Conditions
from calib.robot.robot import Reading, TipModel
from calib.robot.sampling import limited_followers, limits, outside
from calib.robot.terms import kind_of

_MOST_STEPS = 60
_MOST_REFINEMENTS = 40
# Steps that are longer, in rad or m, tell little about the next one.
_TELLING = 0.5
_MOST_SECANTS = 4
_ALIKE = 1e-12
# Least eigenvalue of J J^T, as a share of their sum, for which an inverse by it has ten digits.
_SOUND = 1e-5
# How often the machine may be looked at for N targets: a row of positions without a start needs some twenty looks, of a
# few microseconds each; one that cannot be reached, several hundreds. With readings to start from, half a dozen.
_LOOKS, _LOOKS_PER_ROW, _LOOKS_FROM_READINGS = 500_000, 24, 12
# What these cost is bounded where a look costs more: so many looks at an arm of six readings, without loops or terms.
_MOST_SPENT = 2_500_000
# What a look costs, in looks at such an arm: more for every loop, and for so many rows of a Gaussian process.
_OF_A_LOOP, _ROWS_OF_ONE = 6.0, 130.0
# Once more for so many terms, for so many ways in which links give way, and for so many joints that are weighed; more
# with the square of the readings beyond those of an arm.
_TERMS_OF_ONE, _FLEXURES_OF_ONE, _WEIGHED_OF_ONE = 60.0, 6.0, 6.0
_READINGS, _READINGS_OF_ONE = 6, 20.0
# And where fewer than half of those tried so far are reached: of some thousand targets it is more than they may take.
# Fewer as well where a look costs more.
_LOOKS_OF_HOPELESS = 800_000
# Newton doubles the digits: where a thousandth of the tolerance is reached, the rest is rounding.
_GOAL = 1e-3
# Longest step of a reading, in rad or m, so that the linear prediction means something.
_LONGEST_STEP = 0.5
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6
# Singular values below this share of the largest one are rounding, and no motion.
_NOTHING = 1e-12
# Below this smallest singular value, in m or rad at the tip per rad or m, a machine is called singular.
_SINGULAR = 1e-2
# Far above what anybody would call reached, in m or rad.
_LARGEST_TOLERANCE = 10.0
# Null motion left, in rad or m, where a redundant arm is as near to its start as it gets.
_NEAREST = 1e-9
# Two answers whose distances from the start differ by less are equally near.
_NO_NEARER = 1e-7
# A search that comes nearer by less than this share so often in a row ends: there is nothing nearer.
_HARDLY_NEARER, _IN_A_ROW = 1e-3, 5
# So many rows are searched for at once; fewer where a look costs more and not all can be, and no fewer than these.
_BLOCK, _LEAST_BLOCK = 4096, 64
# Said of rows that the effort did not suffice for.
_CUT_SHORT = "; the search was cut short, as many targets took long: give readings to start from, or fewer targets"

_NOT_TRIED = f"was not looked for{_CUT_SHORT}"


# ---- what is asked


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Asked:
    """What is asked of N rows: ``targets`` and ``tools`` (N, 4, 4), where to ``start`` (N, nr), why ``refused``."""

    targets: Array
    tools: Array
    start: Array
    refused: tuple[str, ...]
    conditions: Conditions

    def subset(self, rows: IntArray) -> "Asked":
        """Return what is asked of some of the rows."""
        refused = tuple(self.refused[n] for n in rows)
        return Asked(self.targets[rows], self.tools[rows], self.start[rows], refused, self.conditions.subset(rows))


@dataclass(frozen=True, slots=True, eq=False)
class How:
    """How rows are to be reached; a reading that changes by more than ``remarkable`` earns a remark."""

    what: What
    residuals: ResidualModel | None
    clamp: bool
    tolerances: tuple[float, float]
    remarkable: float


class Effort:
    """Counts how often the machine is looked at for N targets, so that what cannot be reached ends in time.

    ``left`` is what the rows of now may still take; ``reserve`` keeps their share for others that come after them.
    ``price``: what a look costs, as :func:`price` tells. With readings ``to_start`` from every target has what it
    needs; without them, where a look costs more, the first targets have it, searched for in smaller blocks.
    """

    def __init__(self, targets: int, price: float = 1.0, *, to_start: bool = False) -> None:
        wanted = _LOOKS + _LOOKS_PER_ROW * targets
        least = min(_LOOKS_FROM_READINGS, _LOOKS_PER_ROW) if to_start else 0
        self._left = max(least * targets, min(wanted, int(max(_MOST_SPENT, wanted) / price)))
        self._share = _LOOKS_PER_ROW if self._left >= _LOOKS_PER_ROW * targets else least
        self._reserved = self._spent = self._tried = self._reached = 0
        self._of_hopeless = _LOOKS_OF_HOPELESS / price
        self.block = _BLOCK if self._share else max(_LEAST_BLOCK, int(_BLOCK / price))

    def reserve(self, targets: int) -> None:
        """Keep the share of so many targets for later."""
        self._reserved = min(self._share * targets, self._left)

    def spend(self, looks: int) -> None:
        """Count some looks."""
        self._left -= looks
        self._spent += looks

    def told(self, tried: int, reached: int) -> None:
        """Count targets that were tried, and those of them that are reached."""
        self._tried += tried
        self._reached += reached

    @property
    def over(self) -> bool:
        """Whether nothing is left for any rows."""
        return self._left <= 0

    @property
    def spent(self) -> bool:
        """Whether nothing is left for the rows of now."""
        hopeless = 2 * self._reached < self._tried and self._spent > self._of_hopeless
        return hopeless or self._left <= self._reserved


def price(model: CalibratedMachine, residuals: ResidualModel | None) -> float:
    """Return what a look at a machine costs, in looks at an arm of six readings, without loops or terms."""
    robot, rows = model.robot, 0 if residuals is None else residuals.rows
    weighed = len(robot.moving) if any(kind_of(term).masses != "none" for term in robot.terms) else 0
    giving = len(robot.terms) / _TERMS_OF_ONE + len(robot.flexures.every) / _FLEXURES_OF_ONE + weighed / _WEIGHED_OF_ONE
    more = max(len(robot.readings) - _READINGS, 0) / _READINGS_OF_ONE
    return 1.0 + _OF_A_LOOP * len(robot.loops) + rows / _ROWS_OF_ONE + giving + more**2


# ---- the machine as the solver sees it


def rowwise(calls: Callable[[Array], Array], readings: Array, shape: tuple[int, ...]) -> tuple[Array, list[str]]:
    """Return values (N, *shape), and why a row has none: a row whose loop does not close spoils its block alone."""
    values, why = np.full((len(readings), *shape), np.nan), [""] * len(readings)
    rows = np.arange(len(readings))
    while len(rows):
        try:
            values[rows] = calls(readings[rows])
            break
        except PoseError as e:
            for row in rows[list(e.rows)]:
                why[row] = e.reason
            rows = np.delete(rows, e.rows)
    return values, why


class _Seen(NamedTuple):
    """Gaps (N, m) to the targets in the tool's frame, in m and rad times its length; slopes (N, m, nr); why not."""

    gap: Array
    slope: Array
    why: list[str]

    @property
    def cost(self) -> Array:
        """Length of the gap; infinite where the machine cannot be, of which no gap is known."""
        length = np.linalg.norm(self.gap, axis=1)
        return np.asarray(np.where(np.isnan(length), np.inf, length))


class _Machine:
    """The calibrated machine at N targets."""

    def __init__(self, model: CalibratedMachine, asked: Asked, how: How, effort: Effort) -> None:
        self.effort = effort
        self._tips, self._residuals = TipModel(model.robot, model.deviations), how.residuals
        self._conditions, self._targets, self._tools = asked.conditions, asked.targets, asked.tools
        length, angle = how.tolerances
        self.size = 3 if how.what == "position" else 6
        self._to_tool = rigid.adjoint(rigid.inverse(asked.tools))[:, : self.size]
        self._weights = np.repeat((1.0, length / angle), 3)[: self.size]
        self._columns = len(model.robot.readings)

    def look(self, rows: IntArray, q: Array) -> _Seen:
        """Return what is seen of some rows (n) at readings (n, nr)."""
        size = self._columns
        self.effort.spend(len(rows))

        def flat(numbered: Array) -> Array:
            readings, own = numbered[:, :-1], rows[numbered[:, -1].astype(np.intp)]
            tip, slope = self._tips.driven(readings, self._conditions.subset(own))
            return np.concatenate([tip.reshape(-1, 16), slope.reshape(-1, 6 * size)], axis=1)

        values, why = rowwise(flat, np.column_stack([q, np.arange(len(q))]), (16 + 6 * size,))
        tip, slope = values[:, :16].reshape(-1, 4, 4), values[:, 16:].reshape(-1, 6, size)
        T, target = tip @ self._tools[rows], self._targets[rows]
        position = T[:, :3, 3]
        if self._residuals is not None:
            vectors = self._residuals.at(q, clamp=True)
            if self._residuals.frame == "tip":
                vectors = (tip[:, :3, :3] @ vectors[:, :, None])[:, :, 0]
            position = position + vectors
        turned = np.swapaxes(T[:, :3, :3], 1, 2)
        gap = (turned @ (target[:, :3, 3] - position)[:, :, None])[:, :, 0]
        if self.size == 6:
            gap = np.concatenate([gap, rigid.log3(turned @ target[:, :3, :3])], axis=1)
        return _Seen(gap * self._weights, (self._to_tool[rows] @ slope) * self._weights[:, None], why)

    def errors(self, gap: Array) -> tuple[Array, Array]:
        """Return position errors (N) in m and orientation errors (N) in rad of gaps (N, m)."""
        gap = gap / self._weights
        position = np.linalg.norm(gap[:, :3], axis=1)
        angle = np.linalg.norm(gap[:, 3:], axis=1) if self.size == 6 else np.full(len(gap), np.nan)
        return position, angle


# ---- the solver


def solve(model: CalibratedMachine, asked: Asked, how: How, effort: Effort | None = None) -> Corrections:
    """Return the corrections of all rows, within an effort; None: that of as many rows with readings to start from."""
    effort = effort or Effort(len(asked.start), price(model, how.residuals), to_start=True)
    what, tolerances = how.what, how.tolerances
    if what not in ("pose", "position"):
        raise JobError(f"what shall be reached is {what!r}; allowed are pose, position.")
    if not all(0.0 < value <= _LARGEST_TOLERANCE for value in tolerances):
        raise JobError(
            f"the tolerances are {tolerances[0]:g} and {tolerances[1]:g}; allowed are positive numbers up to "
            f"{_LARGEST_TOLERANCE:g} (m and rad)."
        )
    with one_thread(of_scipy=False):
        rows = np.array_split(np.arange(len(asked.start)), max(1, -(-len(asked.start) // effort.block)))
        blocks = []
        for block in rows:
            effort.reserve(len(asked.start) - int(block[-1]) - 1 if len(block) else 0)
            own = asked.subset(block)
            if len(block) and effort.over:
                blocks.append(_left_out(own))
                continue
            found = _solve_block(model, own, how, effort)
            effort.told(own.refused.count(""), int(np.count_nonzero(found.reached)))
            blocks.append(found)
    return joined(blocks)


def cut_short(found: Corrections, refused: Sequence[str]) -> Corrections:
    """Return corrections that say of every row for which more could have been tried that the search was cut short."""
    reasons = tuple(
        why if reached or never or why.endswith(_CUT_SHORT) else why + _CUT_SHORT
        for why, reached, never in zip(found.reasons, found.reached.tolist(), refused, strict=True)
    )
    return replace(found, reasons=reasons)


def _left_out(asked: Asked) -> Corrections:
    """Return what there is to say of rows that are not looked for, as nothing of the effort is left."""
    none, error = np.full(asked.start.shape, np.nan), np.full(len(asked.start), np.nan)
    reached, steps = np.zeros(len(error), dtype=np.bool_), np.zeros(len(error), dtype=np.intp)
    return Corrections(none, none, reached, error, error, tuple(why or _NOT_TRIED for why in asked.refused), steps)


def _solve_block(model: CalibratedMachine, asked: Asked, how: How, effort: Effort) -> Corrections:
    readings, start, tolerances = model.robot.readings, asked.start, how.tolerances
    machine = _Machine(model, asked, how, effort)
    low, high = limits(readings)
    why = list(asked.refused)
    for n in map(int, np.flatnonzero(outside(start, low, high).any(axis=1))):
        why[n] = why[n] or _beyond(start[n], readings)
    tried = np.flatnonzero([not text for text in why])
    q, steps, free = start.copy(), np.zeros(len(start), dtype=np.intp), np.ones(start.shape)
    rows, passed = tried, dict[int, str]()
    # A joint that would pass its limit stays there, where the others can take its part.
    for _ in range(1 + max(0, len(readings) - machine.size)):
        q[rows], taken, hit = _newton(machine, rows, q[rows], start[rows], free[rows], tolerances[0])
        steps[rows] += taken
        beyond = outside(q[rows], low, high)
        passed |= {int(n): _beyond(q[n], readings) for n in rows[beyond.any(axis=1) & hit] if n not in passed}
        again = beyond.any(axis=1) & ((free[rows] - beyond).sum(axis=1) >= machine.size)
        rows, beyond = rows[again], beyond[again]
        if not len(rows):
            break
        free[rows] = np.where(beyond, 0.0, free[rows])
        q[rows] = np.where(free[rows] > 0.0, start[rows], np.clip(q[rows], low, high))
    allowed = np.clip(q, low, high)
    # A clipped reading may take the tool farther from the target than it was where the search began.
    clipped = tried[outside(q[tried], low, high).any(axis=1)]
    no_nearer = machine.look(clipped, start[clipped]).cost < machine.look(clipped, allowed[clipped]).cost
    allowed[clipped[no_nearer]] = start[clipped[no_nearer]]
    seen = machine.look(np.arange(len(q)), allowed)
    position, angle = machine.errors(seen.gap)
    near = (position <= tolerances[0]) & ~(angle > tolerances[1])
    missed = ~near | outside(q, low, high).any(axis=1) | np.array([bool(text) for text in seen.why], dtype=np.bool_)
    short = _CUT_SHORT if effort.spent else ""
    lost = tried[missed[tried]]
    least = _least(seen.slope[lost])
    for n, slope in zip(map(int, lost), least, strict=True):
        if seen.why[n]:
            why[n] = seen.why[n]
        elif n in passed:
            why[n] = f"the corrected {passed[n]}{short}"
        else:
            why[n] = f"{_far(position[n], angle[n], slope)}{short}"
    reached = np.array([not text for text in why], dtype=np.bool_) & near
    if how.residuals is not None:
        # All rows at once: each time a Gaussian process goes through a matrix of all its own rows.
        arrived = np.flatnonzero(reached)
        for n, said in zip(map(int, arrived), how.residuals.outside(q[arrived]), strict=True):
            why[n] = said
            if why[n] and how.clamp:
                why[n] += f"; {how.residuals.when_clamped}"
            reached[n] = how.clamp or not why[n]
    change = q - start
    for n in map(int, np.flatnonzero(reached & (np.abs(change).max(axis=1, initial=0.0) > how.remarkable))):
        j = int(np.argmax(np.abs(change[n])))
        why[n] = "; ".join(filter(None, [why[n], f"{readings[j].name} changes by {_said(change[n, j], readings[j])}"]))
    arrived = np.flatnonzero(reached)
    led_beyond = _led_beyond(model, q[arrived], asked.conditions.subset(arrived))
    for n, said in zip(map(int, arrived), led_beyond, strict=True):
        why[n] = "; ".join(filter(None, [why[n], said]))
    change[~reached] = q[~reached] = np.nan
    return Corrections(q, change, reached, position, angle, tuple(why), steps)


def _beyond(row: Array, readings: Sequence[Reading]) -> str:
    for value, reading in zip(row, readings, strict=True):
        low, high = limits([reading])
        if outside(np.array([value]), low, high)[0]:
            return (
                f"{reading.name} at {_said(value, reading)} is beyond its limits, "
                f"{_said(low[0], reading)} and {_said(high[0], reading)}"
            )
    return ""


def _led_beyond(model: CalibratedMachine, q: Array, conditions: Conditions) -> list[str]:
    """Return which joint that has no reading, and follows others, is beyond its limits at readings (n, nr), or ""."""
    robot, said = model.robot, [""] * len(q)
    led = limited_followers(robot)
    positions = robot.joint_positions(q, model.deviations, conditions) if led and len(q) else np.zeros((len(q), 0))
    for k, joint in led if positions.size else ():
        follower = [Reading(joint.name, "length" if joint.type == "prismatic" else "angle", joint.lower, joint.upper)]
        for n in map(int, np.flatnonzero(outside(positions[:, [k]], *limits(follower))[:, 0])):
            said[n] = said[n] or f"{_beyond(positions[n, [k]], follower)}; it follows others"
    return said


def _said(value: float, reading: Reading) -> str:
    return f"{value / DEG:.7g} deg" if reading.dimension == "angle" else f"{value / MM:.7g} mm"


def _least(slope: Array) -> Array:
    """Return the least singular values (n) of slopes (n, m, nr): of fewer columns than rows infinite, of NaN NaN."""
    known, (n, m, columns) = np.isfinite(slope).all(axis=(1, 2)), slope.shape
    found = np.full(n, np.inf if columns < m else np.nan)
    if columns >= m:
        found[known] = np.linalg.svd(slope[known], compute_uv=False)[:, -1]
    return found


def _far(position: float, angle: float, least: float) -> str:
    turn = "" if np.isnan(angle) else f" and {angle / MRAD:.4g} mrad"
    where = ", where the arm is singular" if least < _SINGULAR else ""
    return f"no solution found: the nearest found is {position / MM:.4g} mm{turn} away{where}"


def _newton(
    machine: _Machine, rows: IntArray, q: Array, start: Array, free: Array, tolerance: float
) -> tuple[Array, IntArray, BoolArray]:
    """Return readings (n, nr) nearest to the targets of some rows, from q (n, nr), the steps taken, which are there.

    Where ``free`` (n, nr) is 0 a reading stays. What the targets leave open ends nearest to ``start``.
    """
    q, goal = q.copy(), _GOAL * tolerance
    steps, damping = np.zeros(len(q), dtype=np.intp), np.zeros(len(q))
    hardly = np.zeros(len(q), dtype=np.intp)
    seen = machine.look(rows, q)
    gap, slope, cost = seen.gap.copy(), seen.slope.copy(), seen.cost
    for _ in range(_MOST_STEPS):
        open_ = np.flatnonzero((cost > goal) & np.isfinite(cost) & (damping < _MOST_DAMPING))
        if not len(open_) or machine.effort.spent:
            break
        step = _step(slope[open_] * free[open_, None], gap[open_], damping[open_])[0]
        trial = q[open_] + step
        seen = machine.look(rows[open_], trial)
        better = seen.cost < cost[open_]
        hardly[open_] = np.where(seen.cost < (1.0 - _HARDLY_NEARER) * cost[open_], 0, hardly[open_] + 1)
        to = open_[better]
        q[to], gap[to], slope[to], cost[to] = trial[better], seen.gap[better], seen.slope[better], seen.cost[better]
        steps[open_] += 1
        damping[to] = np.where(damping[to] > _LEAST_DAMPING, damping[to] / 10.0, 0.0)
        worse = open_[~better]
        damping[worse] = np.maximum(damping[worse] * 10.0, 1e-6)
        # Where not even rounding is left to gain, it is over.
        damping[worse[np.abs(step[~better]).max(axis=1, initial=0.0) < 1e-13]] = _MOST_DAMPING
        damping[hardly >= _IN_A_ROW] = _MOST_DAMPING
    spare = free.sum(axis=1) > gap.shape[1]
    open_ = np.flatnonzero(spare & (cost <= tolerance) & (np.abs(q - start).max(axis=1, initial=0.0) > 0.0))
    first, hit = q.copy(), cost <= tolerance
    secants = _Secants(q, gap.shape[1])
    for _ in range(_MOST_REFINEMENTS):
        if not len(open_) or machine.effort.spent:
            break
        J = slope[open_] * free[open_, None]
        step, inverse = _step(J, gap[open_], np.zeros(len(open_)))
        away = (q[open_] - start[open_]) * free[open_]
        null = away - (inverse @ (J @ away[:, :, None]))[:, :, 0]
        left = (np.abs(null).max(axis=1) > _NEAREST) | (cost[open_] > goal)
        open_, step, null = open_[left], step[left], null[left]
        trial = q[open_] + secants.shortened(open_, q[open_], step - _capped(null))
        seen = machine.look(rows[open_], trial)
        fine = np.isfinite(seen.cost)
        open_ = open_[fine]
        q[open_], gap[open_], slope[open_], cost[open_] = (
            values[fine] for values in (trial, seen.gap, seen.slope, seen.cost)
        )
        steps[open_] += 1
    # The way to the nearest readings is curved; where it was lost, the first ones stand.
    lost = (cost > tolerance) | (np.linalg.norm(q - start, axis=1) > np.linalg.norm(first - start, axis=1) + _NO_NEARER)
    hit = np.where(spare & lost, hit, cost <= tolerance)
    q[spare & lost] = first[spare & lost]
    return q, steps, hit


class _Secants:
    """What the last steps of a search tell about the next one, for every row by itself: Anderson's acceleration.

    Along directions that the targets leave open the plain search is one of steepest descent, which takes tens of steps;
    as many differences of points and of steps are kept as there are such directions. H. F. Walker, P. Ni, Anderson
    acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49 (2011), algorithm AA and equation 2.2.
    """

    def __init__(self, q: Array, known: int) -> None:
        n, k = q.shape
        kept = min(max(k - known, 0), _MOST_SECANTS)
        self._moved, self._changed = np.zeros((n, k, kept)), np.zeros((n, k, kept))
        self._from, self._step = np.full((n, k), np.nan), np.zeros((n, k))

    def shortened(self, rows: IntArray, q: Array, step: Array) -> Array:
        """Return the steps (n, nr) to take from q (n, nr) in some rows (n), given the plain ones."""
        moved, changed = q - self._from[rows], step - self._step[rows]
        length = np.linalg.norm(step, axis=1)
        # Where steps grow, or are long, what was learned does not hold.
        holds = np.isfinite(moved[:, 0]) & (length < np.linalg.norm(self._step[rows], axis=1)) & (length < _TELLING)
        for kept, new in ((self._moved, moved), (self._changed, changed)):
            newest_first = np.concatenate([new[:, :, None], kept[rows][:, :, :-1]], axis=2)[:, :, : kept.shape[2]]
            kept[rows] = np.where(holds[:, None, None], newest_first, 0.0)
        self._from[rows], self._step[rows] = q, step
        changes = self._changed[rows]
        sizes = np.linalg.norm(changes, axis=1)[:, None]
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        unit = changes / sizes
        turned = np.swapaxes(unit, 1, 2)
        # The small number keeps differences of one direction, and those that are not there, from being told apart.
        shares = np.linalg.solve(turned @ unit + _ALIKE * np.eye(unit.shape[2]), turned @ step[:, :, None])
        return _capped(step - (((self._moved[rows] + changes) / sizes) @ shares)[:, :, 0])


def _step(J: Array, gap: Array, damping: Array) -> tuple[Array, Array]:
    """Return damped least steps (n, nr) that close gaps (n, m) by slopes J (n, m, nr), and the inverses (n, nr, m)."""
    inverse = _inverse(J, damping)
    return _capped((inverse @ gap[:, :, None])[:, :, 0]), inverse


def _inverse(J: Array, damping: Array) -> Array:
    """Return damped inverses (n, nr, m) of slopes J (n, m, nr); ``damping`` (n) is relative to the largest slope."""
    # By normal equations, at a fraction of the price, where these lose no digits that matter.
    inverse, sound = _by_normal_equations(J)
    sound &= damping == 0.0
    U, s, Vt = svd(J[~sound], full_matrices=False)
    largest = np.maximum(s[:, :1], 1e-300)
    shares, damping = s / largest, damping[~sound, None]
    damped = np.where(shares > _NOTHING, shares / (np.maximum(shares, _NOTHING) ** 2 + damping), 0.0) / largest
    inverse[~sound] = np.swapaxes(Vt, 1, 2) @ (damped[:, :, None] * np.swapaxes(U, 1, 2))
    return inverse


def _by_normal_equations(J: Array) -> tuple[Array, BoolArray]:
    """Return J^T (J J^T)^-1 (n, nr, m) of slopes J (n, m, nr), and which of them (n) are sound: the others are not."""
    # Rows last, so that what is done to all of them is done at once.
    n, m, columns = J.shape
    rows = np.empty((m, m + columns, n))
    slope = rows[:, m:]
    slope[:] = J.transpose(1, 2, 0)
    np.einsum("ikn,jkn->ijn", slope, slope, out=rows[:, :m])
    trace = np.maximum(np.einsum("iin->n", rows[:, :m]), 1e-300)
    rows /= trace
    product = np.ones(n)
    # Positive definite, so that no order of elimination is better; where it is none, nothing of this is taken.
    with np.errstate(all="ignore"):
        for j in range(m):
            product *= rows[j, j]
            rows[j, j + 1 :] /= rows[j, j]
            for i in range(m):
                if i != j:
                    rows[i, j + 1 :] -= rows[i, j] * rows[j, j + 1 :]
        # Of positive numbers with the sum 1 none is smaller than their product by what the others can be at most.
        sound = product * float(max(m - 1, 1)) ** (m - 1) > _SOUND
    return slope.transpose(2, 1, 0).copy(), np.asarray(sound)


def _capped(step: Array) -> Array:
    longest = np.abs(step).max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300)))
