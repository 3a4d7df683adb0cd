"""How far from nominal is what the data do not show? As far as what they do show.

Weak priors are wide, so that they decide nothing that data decide. As a statement of what is not known of a machine
they are too wide: an arm whose visible lengths are off by half a millimetre has no other ones that are off by ten. So
all translations of links, all their rotations and all joint offsets are taken to be alike, and those that show teach
the likeliest width (:mod:`calib.identification.widths`) of those that do not. A stated prior is taken at its word. A
tool point that poses do not show is held narrowly for the sake of the search alone, and may be as far as tools are.

So far away the null space bends: a tool may be anywhere on a circle about the axis that turns it, and is moved towards
the axis as it goes along the tangent. Where residuals notice that, Gauss-Newton steps from there say by how much. One
step does not do where the tangent leads far: what it leaves unexplained would count as an error of what is well known.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.foundations.arrays import Array, IntArray, number_in_kind, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import PoseError
from calib.foundations.linear import ROUNDING, one_thread, svd, triangle
from calib.foundations.sealing import sealed
from calib.identification.arrow import Arrow, Inverse
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.parameters import Parameter, scales
from calib.identification.system import Problem, evaluate, residuals
from calib.identification.widths import POWER, NormalEquations, likeliest_widths, likelihood

# Directions of a group that the data must see, given weak priors, before they may teach a width: else it stays weak.
_FEWEST = 3.0
# The power of widths where errors of many kinds are summed up, as of the sizes of what is left out: it keeps the sum as
# large as errors are.
_IN_SUMS = 0.25
# Whitened residuals that change by less, in sum, move no parameter by more than that share of its sigma.
_NOTICED = 0.3
# Where it is so little, steps have led back to the valley; it makes sigmas a few times too wide at most.
_LEFT = 10.0 * _NOTICED
# So many steps lead back; else the valley's floor is sought from nearer, by these shares of the way.
_MOST_STEPS = 4
_SHARES = (1.0, 0.3, 0.1, 0.03)
# Changes by less, in parameter scales, are rounding.
_ALONE = 1e-6
# So many rows of a set tell whether that is so, and where steps lead.
_ENOUGH_TO_NOTICE, _ENOUGH_TO_STEP = 500, 2000


@dataclass(frozen=True, eq=False)
@sealed
class AlongNullSpace:
    """What ``values`` (p,) in SI units may be off by along ``null_basis`` (p, k), scaled; found when asked for.

    ``problem``: what they solve, by ``sigmas`` (N, d) of every set. ``rows``: the data's, whitened, at the values.
    """

    __repr__ = brief

    null_basis: Array
    rows: Arrow
    problem: Problem
    values: Array
    sigmas: tuple[Array, ...]

    @cached_property
    def factor(self) -> Array:
        """A factor (p, r) of their expected squares, in SI units.

        The truth is anywhere along the null space about nominal, as far as parameters may be; and the values are off
        nominal themselves, where curved valleys have led the search. A tool's height that may be wrong by decimetres,
        and moves another parameter by thousandths of that, moves it by far more than noise does.
        """
        if not self.null_basis.size:
            return self.null_basis
        parameters = self.problem.parameters
        units = scales(parameters)
        centre = np.array([q.centre or 0.0 for q in parameters])
        of_robot = np.array([q.of_robot for q in parameters])
        off = np.where(of_robot, (self.values - centre) / units, 0.0)
        with one_thread():
            widths = self._widths(units)
            U, s, Wt = svd(self.null_basis / widths[:, None], full_matrices=False)
            held = s > ROUNDING * s[0]
            root = self.null_basis @ (Wt[held].T / s[held])
            along = units[:, None] * np.column_stack([root, root @ (U[:, held].T @ (off / widths))])
            return read_only(np.column_stack([along, *self._bent(along)]))

    def _bent(self, along: Array) -> Iterator[Array]:
        """Yield by how much (p,) the null space bends at what is one standard deviation ``along`` (p, k) it.

        It does so with the square of how far one goes; beyond what steps lead back from, it may go on straight, as a
        circle does at most. Where stated priors hold what bends, the truth is nearer. Where bases and targets move
        alone, as a base turns about two points that are all of its set-up, nothing else follows.
        """
        parameters = self.problem.parameters
        held = np.array([0.0 if q.prior is None else 1.0 / q.prior for q in parameters])
        others = np.array([parameter.kind not in ("base", "target") for parameter in parameters])
        moves = np.any(np.abs(along[others]) > _ALONE * scales(parameters)[others, None], axis=0)
        off = self._some_residuals()
        at, here, floor = off(self.values), None, None
        for f in along.T[moves]:
            for share in _SHARES:
                ends = self.values + share * f, self.values - share * f
                try:
                    noticed = np.linalg.norm(0.5 * sum(map(off, ends)) - at)
                    if noticed <= _NOTICED:
                        break
                    if not np.isfinite(noticed):
                        continue
                    if here is None or floor is None:
                        here = self._step(self.values)
                        floor = off(self.values + here)
                    floors = self._floors(ends, off, floor)
                except PoseError:  # a loop does not close there, so that the truth is nearer
                    continue
                if floors is not None:
                    bent = (0.5 * sum(floors) - self.values - here) / share
                    yield bent * np.sqrt(_mean_fourth_power(float(np.sum((held * bent) ** 2))))
                    break

    def _floors(self, ends: tuple[Array, Array], off: Callable[[Array], Array], at: Array) -> list[Array] | None:
        """Return where steps lead from both ends (p,), if that is where residuals are those of the valley, ``at``."""
        floors = list(ends)
        for _ in range(_MOST_STEPS):
            floors = [x + self._step(x) for x in floors]
            if np.linalg.norm(0.5 * sum(map(off, floors)) - at) <= _LEFT:
                return floors
        return None

    def _some_residuals(self) -> Callable[[Array], Array]:
        """Return whitened residuals as a function of values (p,), of many rows some for all."""
        some, sigmas = self._some(_ENOUGH_TO_NOTICE, alike=True)

        def found(x: Array) -> Array:
            machine = some.machine(x)
            all_of_them = residuals(some.model.robot, some.measurements, machine, some.nominals)
            return np.concatenate([(r / sigma).ravel() for r, sigma in zip(all_of_them, sigmas, strict=True)])

        return found

    def _step(self, x: Array) -> Array:
        """Return the Gauss-Newton step (p,) from x (p,), what the data hardly see staying where it is."""
        parameters = self.problem.parameters
        some, sigmas = self._enough_to_step
        rows = evaluate(some, sigmas, x, self.rows.split).rows.whole
        hold = np.array([parameter.hold for parameter in parameters])
        return scales(parameters) * Inverse.of(rows.held(hold, np.zeros(len(hold)))).step

    @cached_property
    def _enough_to_step(self) -> tuple[Problem, list[Array]]:
        return self._some(_ENOUGH_TO_STEP, alike=False)

    def _some(self, enough: int, *, alike: bool) -> tuple[Problem, list[Array]]:
        """Return the problem with so many rows of every set, some of each set-up, tool and target, and their sigmas.

        All rows of streams; and those that err together, as in a photograph, or weigh less where they lie off, unless
        all are taken to be ``alike``.
        """
        problem = self.problem
        sets, sigmas = [], []
        for i, (data, sigma) in enumerate(zip(problem.measurements, self.sigmas, strict=True)):
            together = problem.together[i] if problem.together else None
            every = -(-len(data) // enough)
            plain = alike or (together is None and problem.losses[i] == "linear")
            if every > 1 and data.stream is None and plain:
                rows = np.flatnonzero(number_in_kind(data.setup, data.tool, data.target) % every == 0)
                sets.append(data.subset(rows))
                sigmas.append(sigma[rows] * np.sqrt(len(rows) / len(data)))
            else:
                sets.append(data)
                sigmas.append(sigma)
        return replace(problem, measurements=tuple(sets)), sigmas

    def _widths(self, units: Array) -> Array:
        """Return the widths (p,) of all parameters, in their scales."""
        parameters = self.problem.parameters
        found, common = np.array([q.width / q.scale for q in parameters]), self.rows.split.common
        left = self.rows.reduced(RANK_TOLERANCE).rest
        likely = [parameters[k] for k in common]
        found[common] = likely_widths(likely, -left[:, :-1], left[:, -1], (self.values / units)[common], POWER)
        return found


def _mean_fourth_power(cost: float) -> float:
    """Return the mean of u^4 for a number u whose density is ``exp(-(u^2 + cost u^4) / 2)``: 3 without a cost."""
    u = np.linspace(0.0, 6.0, 301)
    density = np.exp(-0.5 * (u**2 + cost * u**4))
    return float(np.sum(density * u**4) / np.sum(density))


def likely_widths(parameters: Sequence[Parameter], J: Array, r: Array, z: Array, power: float = _IN_SUMS) -> Array:
    """Return how wide the priors (p,) of parameters are, in their scales: as known, or as the data teach.

    ``J`` (q, p) and ``r`` (q,): derivatives of what is predicted, and measured less predicted, whitened by the noise,
    at parameters ``z`` (p,), in scales from nominal. ``power``: of a width by which the likelihood is multiplied.
    """
    held = np.array([parameter.width / parameter.scale for parameter in parameters])
    group = _groups(parameters)
    while np.any(group >= 0):
        rows = _equations(J, r, z, held, group)
        _, of_row = np.unique(rows.group, return_index=True)
        widths = held[group >= 0][of_row]
        few = likelihood(rows, widths, np.ones(1)).gamma < _FEWEST
        if not few.any():
            taught = likeliest_widths(rows, widths, power).widths
            return np.where(group >= 0, taught[group], held)
        # What shows too little is no longer among those that are taught.
        left = np.where(few, -1, np.cumsum(~few) - 1)
        group = np.append(left, -1)[group]
    return held


def _groups(parameters: Sequence[Parameter]) -> IntArray:
    """Return the group (p,) of every parameter, from 0; -1 of those that are held as they were."""
    weak = [q.prior is None and q.kind in ("offset", "placement") for q in parameters]
    names = list(dict.fromkeys((q.kind, q.unit) for q, is_ in zip(parameters, weak, strict=True) if is_))
    return np.array(
        [names.index((q.kind, q.unit)) if is_ else -1 for q, is_ in zip(parameters, weak, strict=True)], dtype=np.intp
    )


def _equations(J: Array, r: Array, z: Array, held: Array, group: IntArray) -> NormalEquations:
    """Return the equations of grouped parameters about nominal, all others integrated out."""
    own = group >= 0
    others = int(np.count_nonzero(~own))
    known = np.hstack([np.diag(1.0 / held[~own]), np.zeros((others, int(own.sum()) + 1))])
    left = triangle(np.vstack([known, np.column_stack([J[:, ~own], -J[:, own], r + J[:, own] @ z[own]])]))[
        others:, others:
    ]
    gram = left.T @ left
    ones = np.ones(1)
    return NormalEquations.weighed(gram[None], ones, np.zeros(gram.shape), ones, np.ones(1, dtype=np.bool_), group[own])
