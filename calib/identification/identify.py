"""Identification: measurements in, parameters with their doubts out."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only, read_only_view
from calib.foundations.errors import IdentificationError, JobError
from calib.foundations.linear import one_thread
from calib.foundations.ranges import RANGES
from calib.foundations.selection import named
from calib.foundations.words import counted, refuse_other
from calib.identification import identifiability, weights
from calib.identification.arrow import Arrow, Covariance
from calib.identification.earlier import following
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit, NullSpacePolicy
from calib.identification.identifiability import NullDirection
from calib.identification.initialisation.frames import is_fit
from calib.identification.initialisation.problem import initial_problem, with_common_names, with_new_frames
from calib.identification.learned import LearnedPrior, solve_learning
from calib.identification.losses import Loss, refuse_losses
from calib.identification.machine import Frames, Machine, values_at
from calib.identification.memory import with_memory
from calib.identification.minima import clearly_worse, searched, with_anchors
from calib.identification.mirrored import mirrored, with_turns
from calib.identification.noise import Noise, noise_of
from calib.identification.not_seen import AlongNullSpace
from calib.identification.parameters import Parameter, refuse_none_free, scales
from calib.identification.repeats import Repeats
from calib.identification.rows import photograph_numbers
from calib.identification.solver import Near, Solution, solution_at, solve
from calib.identification.system import Problem, residuals, with_twists
from calib.identification.together import FEWEST, Together, likeliest
from calib.measurement.lens import FOCAL
from calib.measurement.measurements import Measurements, as_sets
from calib.robot.robot import Deviations

# Two places tell a parameter as two values where these are that many standard deviations apart.
_TWO = 4.0
# Frames of the nominal robot where an earlier fit has them, or as they begin.
Placed = Literal["fitted", "begun"]
# Rows that err together are weighed anew so often, until their common variance stays within that, as a logarithm.
_MOST_WEIGHINGS, _SAME_WEIGHING = 4, 0.02


@checked
def identify(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    free: Collection[str] | None = None,
    start: Fit | None = None,
    null_space: NullSpacePolicy = "nearest",
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    spent: Sequence[float] | None = None,
) -> Fit:
    """Identify the free parameters of ``model`` from one or several sets of measurements.

    ``free``: names and globs of those parameters of the model that are free this time; all of them when None. What is
    not free stays as in ``start``, an earlier fit of the same model, or nominal; sigmas, and the uncertainty of the
    machine, count how sure that fit was. ``null_space`` says what to do about directions that the data do not
    determine: "nearest" takes, among all equal fits, the machine nearest to the nominal one; "minimal" holds at nominal
    what exceeds a minimal set of parameters; "refuse" raises. ``model_sigmas``: standard deviations (m or rad) of what
    the model cannot explain, one for each component of the data (position, then orientation, of each set in order);
    None for one that is to be estimated. ``losses``: one for each set: "linear" for least squares, or "huber",
    "soft_l1" or "cauchy", which give outlying rows less weight; all are linear when None. ``spent``: degrees of
    freedom, one number for each component, that a choice of the model by the same rows has spent (J. Ye, *JASA* 93,
    1998), as ``calib.judging.Choice.spent`` tells: residuals are smaller than the noise by these as well.

    Raises JobError when nothing is free, MeasurementError when the measurements are not of this robot,
    IdentificationError when the rows are too few or when there is a null space under "refuse".
    """
    with one_thread():
        return _identify(
            model,
            measurements,
            free=free,
            begin=start,
            null_space=null_space,
            model_sigmas=model_sigmas,
            losses=losses,
            spent=spent,
        )


def _holding(fit: Fit, start: Fit, every: Sequence[Parameter]) -> Fit:
    """Return the fit with what errors of what it holds of ``every`` parameter from an earlier one do."""
    known = {parameter.name for parameter in (*start.parameters, *(start.earlier.parameters if start.earlier else ()))}
    own = {parameter.name for parameter in (*fit.parameters, *fit.held)}
    held = tuple(p for p in every if p.name in known and p.name not in own and not p.nuisance)
    if not held:
        return fit
    parameters, at = (*fit.parameters, *held), fit.machine
    problem = Problem(
        fit.model,
        parameters,
        at.frames,
        fit.measurements,
        at.deviations,
        fit.model.relations,
        fit.losses,
        together=fit.together,
    )
    x = values_at(fit.model.robot, parameters, at.frames, at.deviations)
    sigmas = weights.sigmas_of(problem, fit.variances, fit.residuals)
    errors = start.errors_of([parameter.name for parameter in held])
    return replace(fit, earlier=following(problem, x, sigmas, len(fit.parameters), errors))


def identify_alike(
    fit: Fit,
    measurements: Sequence[Measurements],
    free: Sequence[str],
    *,
    start: Fit | None = None,
    together: tuple[Together | None, ...] | None = None,
    placed: Placed | None = None,
) -> Fit:
    """Identify again what is free, from as many sets, with the weights of a fit: how its rows err together is kept.

    Fits that are to be compared weigh rows alike; a model that explains less would call its own errors common ones.
    ``together``: of these rows, where they are others than those of the fit. ``placed``: frames of the nominal robot
    are not sought by a fit of their own; they begin where the fit found them ("fitted"), or in closed form ("begun").
    """
    kept, model = fit.together if together is None else together, fit.model.within(measurements)
    with one_thread():
        return _identify(
            model,
            measurements,
            free=free,
            begin=start,
            losses=fit.losses,
            together=kept,
            placed=None if placed is None else (placed, fit),
        )


def identify_near(
    fit: Fit,
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    spent: Sequence[float] | None = None,
) -> Fit:
    """Identify a model of the same arm from rows of the same machine as a fit, whose values are nearly those sought.

    Other options as in :func:`identify`. Base, tools and targets begin, and are held, where those of the nominal robot
    are in ``fit``, which has all of them and was begun there itself; the search goes on from its values.
    """
    with one_thread():
        return _identify(model, measurements, model_sigmas=model_sigmas, losses=losses, near=fit, spent=spent)


def _identify(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    free: Collection[str] | None = None,
    begin: Fit | None = None,
    null_space: NullSpacePolicy = "nearest",
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    spent: Sequence[float] | None = None,
    together: tuple[Together | None, ...] | None = None,
    near: Fit | None = None,
    placed: tuple[Placed, Fit] | None = None,
) -> Fit:
    """Identify as :func:`identify`, from ``begin``; ``together`` and ``placed`` as in :func:`identify_alike`.

    ``near``: the fit of :func:`identify_near`.
    """
    refuse_other(null_space, ("nearest", "minimal", "refuse"), "null_space")
    whole = initial_problem(model, as_sets(measurements))
    sets, parameters = whole.measurements, matching(whole.parameters, free)
    refuse_none_free(parameters)
    variances = _stated(model_sigmas)
    if near is not None:
        whole = replace(whole, reference=_frames_of(near.nominal.frames, near, whole.reference, sets[0]))
    elif placed is not None and placed[0] == "fitted":
        whole = replace(whole, reference=_places_of(placed[1], whole.reference, sets[0]))
    refuse_losses(losses, len(sets))
    if losses is not None:  # of the nominal robot as well: else rows that lie off would make it look worse than it is
        whole = replace(whole, given_losses=tuple(losses))
    before = replace(whole, parameters=tuple(p for p in whole.parameters if not p.of_robot))
    nominal = _nominal(before, variances, near, placed)

    reference, deviations = _beginning(begin, sets[0], nominal.frames)
    lost = _spent(spent, whole)
    problem = replace(whole, parameters=parameters, reference=reference, held=deviations, spent_before=lost)
    before_fit = problem.residuals_of(nominal)
    x0 = values_at(model.robot, parameters, reference, deviations)
    known = None if near is None else _near(near, problem, x0)
    once = near is not None or together is not None
    problem, found, learned, alike = searched(problem, x0, variances, known, once=once)
    plain = problem
    if together is None:
        problem, found, learned = _erring_together(problem, found, learned, variances)
    elif together:
        problem = replace(problem, together=together)
        problem, found, learned = solve_learning(problem, found.x, _given(problem, variances))
    parameters = problem.parameters
    kept, directions = _told(found, parameters)
    if null_space == "refuse" and directions:
        many = counted(len(directions), "combination")
        raise IdentificationError(f"the data do not determine {many} of parameters; the first: {directions[0]}")
    rank = found.directions.rank
    held: tuple[Parameter, ...] = ()
    if null_space == "minimal" and directions:
        problem, found, kept, directions = _minimal(problem, found, (kept, directions), variances)
        held = tuple(parameter for k, parameter in enumerate(parameters) if k not in kept)
        alike = None if alike is None else alike[list(kept)]
    machine = problem.machine(found.x)
    _refuse_nowhere(sets, machine)
    after = problem.residuals_of(machine)
    spread_out = _with_common(problem, found.variances)
    sigmas = weights.sigmas_of(plain, spread_out, after)
    spread, memories, repeats = with_memory(replace(problem, together=()), found.x, sigmas, after, found.spread)
    noise = _noise(problem, found._replace(variances=spread_out), after)
    twice = mirrored(problem, machine, sigmas)
    fit = Fit(
        model=model,
        measurements=tuple(data.at_clock(machine.frames.scalars) for data in sets),
        parameters=problem.parameters,
        values=read_only(found.x),
        spread=spread,
        spread_alone=found.spread,
        rank=rank,
        numerical_rank=found.directions.numerical_rank,
        spectrum=found.spectrum,
        null_space=directions,
        unidentifiable=read_only_view(found.unidentifiable | twice),
        null_basis=read_only(found.null_basis),
        along_null_space=AlongNullSpace(found.null_basis, found.spectrum.rows, problem, found.x, sigmas),
        mirrored=read_only_view(twice),
        policy=null_space,
        held=held,
        noise=_by_poses(problem, noise, repeats),
        noise_by_rows=noise,
        losses=problem.losses,
        machine=machine,
        nominal=nominal,
        residuals=tuple(read_only(r) for r in after),
        nominal_residuals=tuple(read_only(r) for r in before_fit),
        evaluations=found.evaluations,
        step=found.step,
        converged=found.converged,
        learned=learned,
        narrowed=found.narrowed,
        memories=memories,
        repeats=repeats,
        together=problem.together,
        spent=lost,
    )
    fit = fit if alike is None else _told_once(fit, problem, alike)
    # Of fits alike, which only compare, nobody asks how sure they are.
    return fit if begin is None or together is not None else _holding(fit, begin, whole.parameters)


def _erring_together(
    problem: Problem,
    found: Solution,
    learned: tuple[LearnedPrior, ...],
    variances: Sequence[float | None] | None,
) -> tuple[Problem, Solution, tuple[LearnedPrior, ...]]:
    """Return problem and solution with the rows of photographs weighed as they err together, where they do."""
    if problem.robust or (variances is not None and any(v is not None for v in variances)):
        return problem, found, learned
    before: tuple[Together | None, ...] = ()
    for _ in range(_MOST_WEIGHINGS):
        now = _together(problem, found)
        if all(own is None for own in now):
            return problem, found, learned
        problem = replace(problem, together=now)
        problem, found, learned = solve_learning(problem, found.x, _given(problem, variances))
        if before and all(
            one is other or (one and other and abs(np.log(one.common / other.common)) < _SAME_WEIGHING)
            for one, other in zip(now, before, strict=True)
        ):
            break
        before = now
    return problem, found, learned


def _given(problem: Problem, variances: Sequence[float | None] | None) -> Sequence[float | None] | None:
    """Return the model variances that are given, of every component: those of rows that err together, too."""
    if not problem.together:
        return variances
    return [None if (own := problem.together[c.measurements]) is None else own.variance for c in problem.components]


def _with_common(problem: Problem, variances: Sequence[float]) -> tuple[float, ...]:
    """Return model variances of every component with what its rows have in common."""
    if not problem.together:
        return tuple(variances)
    return tuple(
        v + (0.0 if (own := problem.together[c.measurements]) is None else own.common)
        for c, v in zip(problem.components, variances, strict=True)
    )


def _together(problem: Problem, found: Solution) -> tuple[Together | None, ...]:
    """Return how rows of photographs err together, of every set, at a solution."""
    units = scales(problem.parameters)
    at = problem.machine(found.x)
    hold = np.array([p.hold for p in problem.parameters])
    centre = np.array([0.0 if p.centre is None else p.centre for p in problem.parameters])
    centre = np.where([p.of_robot or p.centre is not None for p in problem.parameters], centre, found.x)
    known = Arrow.empty(problem.split).held(hold, hold * (found.x - centre) / units)
    return tuple(_of_set(problem, data, at, units, known) for data in problem.measurements)


def _of_set(problem: Problem, data: Measurements, at: Machine, units: Array, known: Arrow) -> Together | None:
    if data.board is None or data.times is not None:
        return None
    number = photograph_numbers(data)
    if int(number.max(initial=-1)) + 1 < FEWEST:
        return None
    rows = with_twists(problem, at, data, units, problem.split)
    told = likeliest(number, rows, data.sigma, known)
    if told is None:
        return None
    return Together.of(*told, number, rows.by_twist, np.sqrt(data.sigma**2 + told[2]))


def _nominal(
    before: Problem, variances: Sequence[float | None] | None, near: Fit | None, placed: tuple[Placed, Fit] | None
) -> Machine:
    """Return the nominal robot with frames and lenses as it explains the rows best, or as they are said to be."""
    x0 = values_at(before.model.robot, before.parameters, before.reference)
    if placed is not None:
        return before.machine(x0 if placed[0] == "begun" else _known(_nominal_values(placed[1]), before, x0))
    fitted = not before.parameters or (is_fit(before.measurements) and not before.robust) or near is not None
    return before.machine(x0 if fitted else _placed(before, x0, variances))


def _placed(before: Problem, x0: Array, variances: Sequence[float | None] | None) -> Array:
    """Return values (p,) of frames and lenses for the nominal robot; x0 where a search has only gone away from it."""
    found = with_anchors(before, solve(before, x0, variances), variances)
    if found.converged:
        return found.x
    ends, starts = (before.residuals_of(before.machine(x)) for x in (found.x, x0))
    farther = all(np.sum(end**2) > np.sum(start**2) for end, start in zip(ends, starts, strict=True))
    return x0 if farther else found.x


def _told_once(fit: Fit, problem: Problem, alike: Array) -> Fit:
    """Return the fit beside a machine that explains the rows as well, at values (p,), without what differs there."""
    one, other = (with_turns(problem, x) for x in (fit.values, alike))
    with np.errstate(invalid="ignore"):
        twice = np.abs(other - one) > _TWO * fit.sigmas
    return replace(
        fit,
        alike=problem.machine(alike),
        unidentifiable=read_only_view(fit.unidentifiable | twice),
        mirrored=read_only_view(fit.mirrored | twice),
    )


def _minimal(
    problem: Problem,
    found: Solution,
    told: tuple[tuple[int, ...], tuple[NullDirection, ...]],
    variances: Sequence[float | None] | None,
) -> tuple[Problem, Solution, tuple[int, ...], tuple[NullDirection, ...]]:
    """Return the problem of a minimal set of parameters, the others nominal or as they begin, with its solution.

    ``told``: the set and the directions at the start. What shows only in products of parameters that are zero there is
    determined as well, if the fit is clearly worse without it; returned are the set and the directions that hold then.
    Raises IdentificationError where the set is empty.
    """
    kept, directions = told
    if not kept:
        raise IdentificationError(
            'the data determine nothing of what is free, and null_space = "minimal" would hold all of it: '
            "measure other poses, or free something that moves what is measured."
        )
    smaller, less = _solved_for(problem, kept, variances)
    if clearly_worse(smaller, less, problem, found.x):
        kept, directions = identifiability.told(
            found.spectrum.rows, found.directions.common_rank(0.0), problem.parameters
        )
        near = Near(found.x[list(kept)], found.variances)
        smaller, less = _solved_for(problem, kept, variances, near)
        if clearly_worse(smaller, less, problem, found.x):
            less = less._replace(converged=False)
    return smaller, less, kept, directions


def _solved_for(
    problem: Problem, kept: Sequence[int], variances: Sequence[float | None] | None, near: Near | None = None
) -> tuple[Problem, Solution]:
    """Return the problem of some of its parameters, the others being nominal or as they begin, and its solution."""
    smaller = replace(problem, parameters=tuple(problem.parameters[k] for k in kept))
    x0 = values_at(problem.model.robot, smaller.parameters, problem.reference, problem.held)
    return smaller, solve(smaller, x0, _given(smaller, variances), near)


def matching(
    parameters: tuple[Parameter, ...], free: Collection[str] | None, where: str = "free"
) -> tuple[Parameter, ...]:
    """Return the parameters that some name or glob matches; raises JobError, with ``where``, for one that matches none.

    Targets and scalars are always free: nobody knows them, and nothing but the measurements at hand tells.
    """
    if free is None:
        return parameters
    names = [parameter.name for parameter in parameters]
    chosen: set[str] = set()
    for pattern in free:
        if not (found := named(pattern, names)):
            raise JobError(f"{where}: {pattern!r} matches none of the error model's parameters.")
        chosen.update(found)
    return tuple(p for p in parameters if p.nuisance or p.name in chosen)


def _stated(model_sigmas: Sequence[float | None] | None) -> tuple[float | None, ...] | None:
    """Return the variances of stated sigmas. Raises JobError when one is out of range."""
    # Of lengths, angles or pixels: which of them, each set says.
    low, high = RANGES["model_sigma"].ends[0], RANGES["model_sigma of pixels"].ends[1]
    for s in () if model_sigmas is None else model_sigmas:
        if not (s is None or s == 0.0 or low <= s <= high):
            raise JobError(f"model_sigmas: {s!r} is out of range; allowed is 0, or {low:g} to {high:g}.")
    return None if model_sigmas is None else tuple(None if s is None else s**2 for s in model_sigmas)


def _spent(spent: Sequence[float] | None, problem: Problem) -> tuple[float, ...]:
    """Return the degrees of freedom that a choice has spent. Raises JobError when they cannot be."""
    if spent is None:
        return ()
    if len(spent) != len(problem.components) or not all(0.0 <= one < np.inf for one in spent):
        many = counted(len(problem.components), "component")
        raise JobError(f"spent: {list(spent)!r} is no list of degrees of freedom, 0 or more, of {many} of the data.")
    return tuple(float(one) for one in spent)


def _refuse_nowhere(sets: Sequence[Measurements], machine: Machine) -> None:
    """Raise IdentificationError where a search has ended at what cannot be: a far tool, no focal length."""
    frames, place, focal = machine.frames, "position, station, point", "fx, fy"
    named = zip((*sets[0].tools, *sets[0].setups), (*frames.tools, *frames.bases), strict=True)
    found = [(repr(name), place, "m", float(value)) for name, T in named for value in T[:3, 3]]
    focal_lengths = {k for data in sets for role, k in data.uses.items() if role in FOCAL}
    found += [(sets[0].scalars[k].name, focal, "px", float(frames.scalars[k])) for k in sorted(focal_lengths)]
    for what, name, unit, value in found:
        if not RANGES[name].holds(value):
            raise IdentificationError(
                f"the search has ended where nothing can be, with {what} at {value:.3g} {unit}, as nothing nearer "
                "explains the measurements: are the readings theirs, and is it the right robot?"
            )


def _near(fit: Fit, problem: Problem, x0: Array) -> Near:
    """Return where a fit of the same machine has the minimum of a problem; what it does not know is as at x0 (p,)."""
    x = _known(dict(zip((parameter.name for parameter in fit.parameters), fit.values, strict=True)), problem, x0)
    sets = [data.where for data in fit.measurements]
    own = dict(zip([(sets[noise.measurements], noise.quantity) for noise in fit.noise], fit.variances, strict=True))
    return Near(x, [own[problem.measurements[c.measurements].where, c.quantity] for c in problem.components])


def _nominal_values(fit: Fit) -> dict[str, float]:
    """Return the values of a fit's parameters for the nominal robot, by their names."""
    values = values_at(fit.model.robot, fit.parameters, fit.nominal.frames)
    return {parameter.name: float(value) for parameter, value in zip(fit.parameters, values, strict=True)}


def _known(values: Mapping[str, float], problem: Problem, x0: Array) -> Array:
    """Return the values (p,) of a problem's parameters that are known by name; others as at x0 (p,)."""
    return np.array([values.get(parameter.name, at) for parameter, at in zip(problem.parameters, x0, strict=True)])


def _beginning(begin: Fit | None, names: Measurements, frames: Frames) -> tuple[Frames, Deviations | None]:
    """Return frames and deviations to begin from: of an earlier fit, what it did not know as in ``frames``."""
    if begin is None:
        return frames, None
    return _frames_of(begin.machine.frames, begin, frames, names), begin.machine.deviations


def _frames_of(old: Frames, fit: Fit, frames: Frames, names: Measurements) -> Frames:
    """Return frames that a fit knows, by the ``names`` of these measurements; others as in ``frames``."""
    known = fit.measurements[0]

    def taken(new: Array, new_names: Sequence[object], old: Array, old_names: Sequence[object]) -> Array:
        found = dict(zip(old_names, old, strict=True))
        placed = [found.get(name, value) for name, value in zip(new_names, new, strict=True)]
        return np.array(placed).reshape(new.shape)

    return Frames(
        taken(frames.bases, names.setups, old.bases, known.setups),
        taken(frames.tools, names.tools, old.tools, known.tools),
        taken(frames.targets, names.targets, old.targets, known.targets),
        taken(frames.scalars, names.scalars, old.scalars, known.scalars),
    )


def _places_of(fit: Fit, frames: Frames, names: Measurements) -> Frames:
    """Return frames with the places of base, tools and targets that a fit has for the nominal robot.

    Numbers are not taken: one that is held, of a lens or a print, is as it was given.
    """
    return replace(_frames_of(fit.nominal.frames, fit, frames, names), scalars=frames.scalars)


def _told(found: Solution, parameters: Sequence[Parameter]) -> tuple[tuple[int, ...], tuple[NullDirection, ...]]:
    """Return a minimal set of parameters, and the directions of the null space.

    Told at the start point, as at the solution second-order shares would blur what cannot be told apart; but at the
    solution where more is determined there, by products of parameters that are zero at the start.
    """
    rank = found.directions.common_rank(identifiability.NUMERICAL_TOLERANCE)
    start = identifiability.directions_of(found.start.reduced(identifiability.RANK_TOLERANCE))
    rows = found.start if start.common_rank(0.0) >= rank else found.spectrum.rows
    return identifiability.told(rows, rank, parameters)


def _noise(problem: Problem, found: Solution, after: Sequence[Array]) -> tuple[Noise, ...]:
    return tuple(
        noise_of(
            component.measurements,
            component.quantity,
            after[component.measurements][:, component.columns].ravel(),
            problem.measurements[component.measurements].sigma[:, component.columns].ravel(),
            variance,
            redundancy,
        )
        for component, variance, redundancy in zip(problem.components, found.variances, found.redundancies, strict=True)
    )


def _by_poses(problem: Problem, noise: Sequence[Noise], repeats: Sequence[Repeats]) -> tuple[Noise, ...]:
    """Return the noise of every component as poses tell it, where rows of a pose err together."""
    told = {(one.measurements, one.quantity): one for one in repeats}
    found = []
    for component, own in zip(problem.components, noise, strict=True):
        one = told.get((own.measurements, own.quantity))
        size = component.columns.stop - component.columns.start
        found.append(own if one is None else own.by_poses(one.alone, one.common, size * (one.rows - one.poses)))
    return tuple(found)


def residuals_of(fit: Fit, measurements: Sequence[Measurements], machine: Machine) -> tuple[Array, ...]:
    """Return residuals (N, d) of other measurements, in SI units, for a machine of the fit.

    Set-ups, tools, targets and scalars that the fit does not know are found from these measurements, the machine
    staying as it is.

    Raises MeasurementError when they are not of this robot; IdentificationError when they are too few to find these.
    """
    sets = with_common_names(fit.model, (fit.measurements[0], *measurements))[1:]
    return residuals(fit.model.robot, sets, with_new_frames(fit.model, sets, machine)) if sets else ()


def at_clocks(fit: Fit, measurements: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return measurements with the readings of streams as the fit has found their clocks. Raises as residuals_of."""
    if all(data.stream is None for data in measurements):
        return tuple(measurements)
    sets = with_common_names(fit.model, (fit.measurements[0], *measurements))[1:]
    scalars = with_new_frames(fit.model, sets, fit.machine).frames.scalars
    return tuple(
        replace(data, readings=common.at_clock(scalars).readings)
        for data, common in zip(measurements, sets, strict=True)
    )


def with_values(fit: Fit, values: Array, machine: Machine) -> Fit:
    """Return the fit with other values (p,) of its parameters, found in another way, and their ``machine``.

    Noise, covariance and what the data determine are those of these values. The covariance includes by how much they
    are off the least-squares solution: a search that stops early, or rounds, is off by more than the noise.
    """
    frames = machine.frames
    problem = Problem(
        fit.model,
        fit.parameters,
        frames,
        fit.measurements,
        fit.machine.deviations,
        fit.model.relations,
        fit.losses,
        spent_before=fit.spent,
    )
    with one_thread():
        x = values_at(fit.model.robot, fit.parameters, frames, machine.deviations)
        found = solution_at(problem, x)
    after = residuals(fit.model.robot, fit.measurements, machine)
    noise = _noise(problem, found, after)
    sigmas = weights.sigmas_of(problem, found.variances, after)
    spread, memories, repeats = with_memory(problem, found.x, sigmas, after, found.spread)
    twice = mirrored(problem, machine, sigmas)
    assert found.off is not None, "values found in another way are off"
    return replace(
        fit,
        values=read_only(values),
        # Of one split, by which parts of both are asked for.
        spread=Covariance.whole(spread.of() + np.outer(found.off, found.off)),
        spread_alone=Covariance.whole(found.spread.of()),
        memories=memories,
        repeats=repeats,
        rank=found.directions.rank,
        numerical_rank=found.directions.numerical_rank,
        spectrum=found.spectrum,
        unidentifiable=read_only_view(found.unidentifiable | twice),
        null_basis=read_only(found.null_basis),
        along_null_space=AlongNullSpace(found.null_basis, found.spectrum.rows, problem, found.x, sigmas),
        mirrored=read_only_view(twice),
        noise=_by_poses(problem, noise, repeats),
        noise_by_rows=noise,
        machine=machine,
        residuals=tuple(read_only(r) for r in after),
        narrowed=found.narrowed,
        off=read_only(found.off),
    )
