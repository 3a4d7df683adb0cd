"""Priors whose width the data teach: solve, learn the widths where all is linear, solve again until they stay.

A group that too few directions of the data speak of keeps a usual width, since one of one or two numbers would be
chance; unless even these are farther off, which says that the others may be as well. One of which nothing shows comes
to what could hide from the data. One at the widest that is allowed is as good as without a prior. Joint terms of which
the data clearly ask that they be larger than weak priors would let them be are of a larger scale from then on: what
they leave, held as narrowly as is usual, would be taken for noise beside which the data say too little of them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array, BoolArray
from calib.identification.arrow import Arrow
from calib.identification.parameters import UNSHOWN_TOOLS, Parameter, scales
from calib.identification.solver import Near, Solution, Sought, seek, solve
from calib.identification.system import Evaluation, Problem
from calib.identification.widths import WIDEST, NormalEquations, likeliest_widths, likelihood

Outcome = Literal["learned", "too few", "nothing shows", "widest"]

# Directions of a group that the data must see, given priors of a usual width, before they may teach one.
_FEWEST = 3.0
# Usual widths are one parameter scale, but zeros of joints that turn, which are set by hand, so many: 5 mrad.
_ZEROS = 5.0
_MOST_ROUNDS = 8
_NEGLIGIBLE_CHANGE = 0.01
# Where widths change by less, as a logarithm, another search would only end within the rounding of the last one.
_NO_CHANGE = 1e-3


@dataclass(frozen=True, slots=True)
class LearnedPrior:
    """The standard deviation, in ``unit``, that the parameters of a group have about zero, and what taught it.

    ``parameters``: how many are in the group; ``taught``: how many of them, in sum, the data determine rather than the
    prior. ``outcome``: "learned"; "too few" to learn from, so that the width is a usual one, or wider where these
    few are farther off; "nothing shows" where the data are no likelier with the group than without it, so that the
    width is what they could not notice; or the "widest" that is allowed.
    """

    group: str
    unit: str
    width: float
    parameters: int
    taught: float
    outcome: Outcome


def solve_learning(
    problem: Problem,
    x0: Array,
    variances: Sequence[float | None] | None,
    near: Near | None = None,
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...]]:
    """Solve a problem from x0 (p,) and learn the widths of its groups; returns it with the learned priors.

    Joint terms have their wider weak priors in what is returned, where rows ask for them. ``near``: where the first
    minimum is, if that is nearly known. Raises what :func:`calib.identification.solver.solve` raises.
    """
    problem, found, learned = _solved(problem, x0, variances, near)
    while terms := found.widened - {UNSHOWN_TOOLS}:
        problem = with_widened(problem, terms)
        problem, again, learned = _solved(problem, x0, variances, Near(found.x, found.variances))
        found = again._replace(evaluations=found.evaluations + again.evaluations)
    return problem, found, learned


def with_widened(problem: Problem, groups: Collection[str]) -> Problem:
    """Return a problem with the wider weak priors of parameters of these groups."""
    return replace(problem, parameters=tuple(parameter.widened(groups) for parameter in problem.parameters))


def _solved(
    problem: Problem, x0: Array, variances: Sequence[float | None] | None, near: Near | None
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...]]:
    names = tuple(dict.fromkeys(p.group for p in problem.parameters if p.group is not None))
    if not names:
        return problem, solve(problem, x0, variances, near), ()
    usual = _usual(problem.parameters, names)
    widths = usual
    problem = _with_widths(problem, names, widths)
    found = seek(problem, x0, variances, near, roughly=True)
    while found.converged and (larger := found.asked):
        problem = _with_widths(with_widened(problem, larger), names, widths)
        found = seek(problem, x0, variances, Near(found.x, found.noise.variances), roughly=True)
    rows = _equations(problem, found, variances, names)
    seen = _seen(rows, usual)
    few = np.asarray(seen < _FEWEST)
    taught, shown = seen, ~few
    closely = False
    for first in (True, *(False,) * (_MOST_ROUNDS - 1)):
        new, _, taught, shown = likeliest_widths(rows, widths, usual=np.where(few, usual, 0.0))
        change = float(np.max(np.abs(np.log(new / widths))))
        if closely and change < _NO_CHANGE:
            break
        widths = new
        problem = _with_widths(problem, names, widths)
        settled = change < _NEGLIGIBLE_CHANGE
        # Noise that was found with widths as wide as a guess may hold a search where it is: the first one begins anew.
        found = seek(problem, found.x, variances) if first else found.again(problem, roughly=not settled)
        closely = first or settled
        if settled:
            break
        rows = _equations(problem, found, variances, names)
    taught = np.where(few, seen, taught)
    return problem, found.told, tuple(_told(problem.parameters, names, widths, taught, few, shown))


def _with_widths(problem: Problem, names: Sequence[str], widths: Array) -> Problem:
    known: Mapping[str | None, float] = dict(zip(names, widths.tolist(), strict=True))
    return replace(
        problem,
        parameters=tuple(
            p if p.group is None else replace(p, prior=known[p.group] * p.typical_size) for p in problem.parameters
        ),
    )


def _equations(
    problem: Problem, found: Sought, variances: Sequence[float | None] | None, names: Sequence[str]
) -> NormalEquations:
    """Return the equations at a solution, shifted to where stated priors have their means; weak ones hold there."""
    sigmas, evaluation = found.noise.sigmas, found.evaluation
    hold = np.array([parameter.hold for parameter in problem.parameters])
    triangles, taken = _without_blocks(evaluation, hold)
    parameters = [problem.parameters[k] for k in evaluation.split.common]
    hold = hold[evaluation.split.common]
    p = len(parameters)
    stated = np.array([parameter.prior is not None for parameter in parameters])
    shift = np.eye(p + 1)
    shift[:p, p] = np.where(stated, -found.x[evaluation.split.common] / scales(parameters), 0.0)

    def gram(triangle: Array) -> Array:
        shifted = triangle @ shift
        return np.asarray(shifted.T @ shifted)

    known = gram(evaluation.relations)
    learned = np.array([parameter.group is not None for parameter in parameters])
    known[range(p), range(p)] += np.where(learned, 0.0, hold**2)
    least, counts = [], []
    for component, used, spent in zip(problem.components, taken, problem.spent, strict=True):
        instrument = problem.measurements[component.measurements].sigma[:, component.columns]
        total = sigmas[component.measurements][:, component.columns]
        least.append(np.sqrt(np.mean(instrument**2) / np.mean(total**2)))
        counts.append(instrument.size - used - spent)
    given = [None] * len(counts) if variances is None else list(variances)
    # Where rows that lie off weigh less, their number says too little; the solver alone finds the noise.
    fixed = [v is not None or problem.robust for v in given]
    return NormalEquations.weighed(
        np.stack([gram(triangle) for triangle in triangles]),
        np.array(counts, dtype=np.float64),
        known,
        np.array(least),
        np.array(fixed),
        np.array([-1 if q.group is None else names.index(q.group) for q in parameters], dtype=np.intp),
    )


def _without_blocks(evaluation: Evaluation, hold: Array) -> tuple[list[Array], list[float]]:
    """Return the rows (q, c + 1) of every component without blocks, and how many numbers these take of each.

    ``hold`` (p,): how strongly weak priors hold what rows do not tell.
    """
    split, triangles, taken = evaluation.split, list[Array](), list[float]()
    held = Arrow.empty(split).held(hold, np.zeros(len(hold))).heads
    for part in evaluation.alone:
        which, rows = part.heads
        own = Arrow(split.of_blocks(which), np.concatenate([rows, held[which]], axis=1), part.rest)
        reduced = own.reduced(linear.ROUNDING)
        triangles.append(reduced.rest)
        weak = np.einsum("mab,ma->", reduced.root**2, split.parts(hold)[1][which] ** 2)
        taken.append(float(np.count_nonzero(split.real[which]) - weak))
    return triangles, taken


def _usual(parameters: Sequence[Parameter], names: Sequence[str]) -> Array:
    zeros = {q.group for q in parameters if q.kind == "offset" and q.unit == "rad"}
    return np.array([_ZEROS if name in zeros else 1.0 for name in names])


def too_few(rows: NormalEquations, groups: int) -> BoolArray:
    """Return which of so many groups, of the scale of their parameters, the data say too little of to teach a width."""
    return np.asarray(_seen(rows, np.ones(groups)) < _FEWEST)


def _seen(rows: NormalEquations, widths: Array) -> Array:
    return likelihood(rows, widths, np.ones(len(rows.counts))).gamma


def _told(
    parameters: Sequence[Parameter],
    names: Sequence[str],
    widths: Array,
    taught: Array,
    few: BoolArray,
    shown: BoolArray,
) -> list[LearnedPrior]:
    told = []
    for k, name in enumerate(names):
        own = [parameter for parameter in parameters if parameter.group == name]
        outcome: Outcome = "learned"
        if few[k]:
            outcome = "too few"
        elif not shown[k]:
            outcome = "nothing shows"
        elif widths[k] > WIDEST / (1.0 + _NEGLIGIBLE_CHANGE):
            outcome = "widest"
        width = float(widths[k] * own[0].typical_size)
        told.append(LearnedPrior(name, own[0].unit, width, len(own), float(taught[k]), outcome))
    return told
