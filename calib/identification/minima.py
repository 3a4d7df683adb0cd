"""The lowest of several minima: searches from where anchors, tools and the sides of planes are elsewhere."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.identification import weights
from calib.identification.initialisation.anchors import anchors_anew
from calib.identification.initialisation.tools_elsewhere import tools_elsewhere
from calib.identification.learned import LearnedPrior, solve_learning, with_widened
from calib.identification.mirrored import LIKELY, behind, with_turns
from calib.identification.parameters import UNSHOWN_TOOLS, scales
from calib.identification.solver import Near, Solution, seek, solve
from calib.identification.system import Problem

# Searches from where anchors are elsewhere, at most: each time fewer are.
_MOST_TURNS = 3
# By this share of the sum of squares a search with tools elsewhere must end better, and by more than rounding.
_CLEARLY, _SOME = 0.05, 1.0
# A search has ended elsewhere if that differs by so many parameter scales.
_ELSEWHERE = 1e-2


def searched(
    problem: Problem, x0: Array, variances: Sequence[float | None] | None, known: Near | None, *, once: bool
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...], Array | None]:
    """Return problem and solution, and other values (p,) that explain the rows as well; ``once``: none are sought."""
    alike = None
    problem, found, learned = solve_learning(problem, x0, variances, known)
    found = with_anchors(problem, found, variances)
    if not once:
        problem, found, learned = _with_tools(problem, found, learned, x0, variances)
        problem, found, learned, alike = _behind(problem, found, learned, x0, variances)
    return with_widened(problem, found.widened & {UNSHOWN_TOOLS}), found, learned, alike


def with_anchors(problem: Problem, found: Solution, variances: Sequence[float | None] | None) -> Solution:
    """Return the solution, or the one from where anchors are elsewhere, while some fit clearly better there."""
    for _ in range(_MOST_TURNS):
        x0 = anchors_anew(problem, found.x)
        if x0 is None:
            break
        again = solve(problem, x0, variances)
        found = again._replace(evaluations=found.evaluations + again.evaluations)
    return found


def _with_tools(
    problem: Problem,
    found: Solution,
    learned: tuple[LearnedPrior, ...],
    x0: Array,
    variances: Sequence[float | None] | None,
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...]]:
    """Return problem and solution, or those to which a search with tools elsewhere has led, if they fit clearly better.

    The search ends there with tools held where they were stated, as wide as where the data ask for another place.
    """
    ends = [seek(problem, start, variances) for start in tools_elsewhere(problem, x0)]
    if not ends:
        return problem, found, learned
    count = found.evaluations + sum(end.search.evaluator.count for end in ends)
    sigmas = _sigmas(problem, found)
    before, after = _squares(problem, found.x, sigmas), [_squares(problem, end.x, sigmas) for end in ends]
    best = ends[int(np.argmin(after))]
    if _clearly_less(min(after), before):
        widened = with_widened(problem, {UNSHOWN_TOOLS})
        for begin, near in ((x0, Near(best.x, best.noise.variances)), (best.x, None)):
            new, again, anew = solve_learning(widened, begin, variances, near)
            count += again.evaluations
            if _clearly_less(_squares(new, again.x, sigmas), before):
                return new, again._replace(evaluations=count), anew
        # It is known not to be the minimum.
        found = found._replace(converged=False)
    return problem, found._replace(evaluations=count), learned


def _behind(
    problem: Problem,
    found: Solution,
    learned: tuple[LearnedPrior, ...],
    x0: Array,
    variances: Sequence[float | None] | None,
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...], Array | None]:
    """Return problem and solution, or those of a search from behind the planes of lengths, if they fit clearly better.

    And the values (p,) to which that search has led, where they explain the rows as well. Frames are held as at x0.
    """
    start = behind(problem, found.x)
    if start is None:
        return problem, found, learned, None
    sigmas = _sigmas(problem, found)
    end = seek(problem, x0, variances, Near(start, found.variances))
    found = found._replace(evaluations=found.evaluations + end.search.evaluator.count)
    before, after = (_squares(problem, x, sigmas) + _of_stated_places(problem, x, x0) for x in (found.x, end.x))
    if _clearly_less(after, before - LIKELY):
        problem, again, learned = solve_learning(problem, x0, variances, Near(end.x, end.noise.variances))
        return problem, again._replace(evaluations=found.evaluations + again.evaluations), learned, None
    apart = np.abs(with_turns(problem, end.x) - with_turns(problem, found.x)) / scales(problem.parameters)
    alike = end.converged and after < before + LIKELY and apart.max() > _ELSEWHERE
    return problem, found, learned, end.x if alike else None


def clearly_worse(problem: Problem, found: Solution, other: Problem, x: Array) -> bool:
    """Return whether another problem at x (p,) fits clearly better than the solution of one does."""
    sigmas = _sigmas(problem, found)
    return _clearly_less(_squares(other, x, sigmas), _squares(problem, found.x, sigmas))


def _clearly_less(one: float, other: float) -> bool:
    """Return whether a sum of squares is clearly less than another one."""
    return one < (1.0 - _CLEARLY) * other - _SOME


def _squares(problem: Problem, x: Array, sigmas: Sequence[Array]) -> float:
    """Return the sum of squares of residuals and of the robot's priors at x (p,)."""
    residual = problem.residuals_of(problem.machine(x))
    priors = [p.hold * value / p.scale for p, value in zip(problem.parameters, x, strict=True) if p.of_robot]
    return sum(float(np.sum((r / s) ** 2)) for r, s in zip(residual, sigmas, strict=True)) + float(
        np.sum(np.square(priors))
    )


def _of_stated_places(problem: Problem, x: Array, x0: Array) -> float:
    """Return the sum of squares at x (p,) of the priors that are stated for frames, about their centres or x0 (p,)."""
    return sum(
        float((value - (start if p.centre is None else p.centre)) / p.prior) ** 2
        for p, value, start in zip(problem.parameters, x, x0, strict=True)
        if not p.of_robot and p.prior is not None
    )


def _sigmas(problem: Problem, found: Solution) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of the rows of every set, as a solution weighs them."""
    return weights.sigmas_of(problem, found.variances, problem.residuals_of(problem.machine(found.x)), search=True)
