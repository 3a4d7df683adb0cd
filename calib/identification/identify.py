"""Identification: measurements in, parameters with their doubts out."""

import fnmatch
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only, read_only_view
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.linear import one_thread
from calib.identification import identifiability
from calib.identification.error_model import ErrorModel
from calib.identification.fit import BlindPolicy, Fit
from calib.identification.machine import Frames, Machine, values_at
from calib.identification.noise import Noise, noise_of
from calib.identification.parameters import Parameter
from calib.identification.solver import Solution, solve
from calib.identification.start import start_frames
from calib.identification.system import Problem, residuals
from calib.measurement.measurements import Measurements
from calib.robot.robot import Deviations


def identify(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    free: Sequence[str] | None = None,
    start: Fit | None = None,
    blind: BlindPolicy = "nearest",
    model_sigmas: Sequence[float | None] | None = None,
) -> Fit:
    """Identify the free parameters of ``model`` from one or several sets of measurements.

    ``free``: names and globs of those parameters of the model that are free this time; all of them when None. What is
    not free stays as in ``start``, an earlier fit of the same model, or nominal. ``blind`` says what to do about
    directions that the data cannot see: "nearest" takes, among all equal fits, the machine nearest to the nominal one;
    "minimal" holds what exceeds a minimal set of parameters; "refuse" raises. ``model_sigmas``: standard deviations (m
    or rad) of what the model cannot explain, one for each component of the data (position, then orientation, of each
    set in order); None stands for one to be estimated.

    Raises JobError when nothing is free, MeasurementError when the measurements are not of this robot,
    IdentificationError when the rows are too few or when directions are blind under "refuse".
    """
    with one_thread():
        return _identify(model, measurements, free, start, blind, model_sigmas)


def _identify(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    free: Sequence[str] | None,
    begin: Fit | None,
    blind: BlindPolicy,
    model_sigmas: Sequence[float | None] | None,
) -> Fit:
    if blind not in ("nearest", "minimal", "refuse"):
        raise JobError(f"blind: {blind!r} is not one of nearest, minimal, refuse.")
    sets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    sets = with_common_tools(model, sets)
    parameters = _chosen(model.parameters(sets[0].tools), free)
    if not parameters:
        raise JobError("no parameter is free: free joint offsets, placements, the base or the tool.")
    variances = None if model_sigmas is None else tuple(None if s is None else s**2 for s in model_sigmas)

    aligned = start_frames(model, sets)
    bare = replace(model, offsets=(), placements=())
    before = Problem(bare, bare.parameters(sets[0].tools), aligned, sets)
    start = solve(before, values_at(model.robot, before.parameters, aligned), variances) if before.parameters else None
    nominal = before.machine(np.zeros(0) if start is None else start.x)

    reference, deviations = _beginning(begin, sets[0].tools, nominal.frames)
    problem = Problem(model, parameters, reference, sets, deviations)
    found = solve(problem, values_at(model.robot, parameters, reference, deviations), variances)
    # Told at the start point: at the solution second-order shares would blur what cannot be told apart.
    usable = min(found.directions.usable, identifiability.directions(found.start).rank)
    kept, directions = identifiability.told(found.start, usable, parameters)
    if blind == "refuse" and directions:
        many = "1 direction" if len(directions) == 1 else f"{len(directions)} directions"
        raise IdentificationError(f"the data are blind in {many}; the first: {directions[0]}")
    rank = found.directions.rank
    held: tuple[Parameter, ...] = ()
    if blind == "minimal" and directions:
        held = tuple(parameter for k, parameter in enumerate(parameters) if k not in kept)
        problem = replace(problem, parameters=tuple(parameters[k] for k in kept))
        found = solve(problem, values_at(model.robot, problem.parameters, reference, deviations), variances)
    machine = problem.machine(found.x)
    after = residuals(model.robot, sets, machine)
    return Fit(
        model=model,
        measurements=sets,
        parameters=problem.parameters,
        values=read_only(found.x),
        covariance=read_only(found.covariance),
        rank=rank,
        usable_rank=found.directions.usable,
        singular_values=read_only(found.directions.singular_values),
        blind_directions=directions,
        blind=read_only_view(identifiability.blind_parameters(found.unseen)),
        unseen=read_only(found.unseen),
        policy=blind,
        held=held,
        noise=_noise(problem, found, after),
        machine=machine,
        nominal=nominal,
        residuals=tuple(read_only(r) for r in after),
        nominal_residuals=tuple(read_only(r) for r in residuals(model.robot, sets, nominal)),
        evaluations=found.evaluations,
        step=found.step,
        converged=found.converged,
    )


def _chosen(parameters: tuple[Parameter, ...], free: Sequence[str] | None) -> tuple[Parameter, ...]:
    """Return the parameters that some name or glob matches; raises JobError for one that matches none."""
    if free is None:
        return parameters
    names = [parameter.name for parameter in parameters]
    for pattern in free:
        if not fnmatch.filter(names, pattern):
            raise JobError(f"free: {pattern!r} matches none of the error model's parameters.")
    return tuple(p for p in parameters if any(fnmatch.fnmatchcase(p.name, pattern) for pattern in free))


def _beginning(begin: Fit | None, tools: Sequence[str], frames: Frames) -> tuple[Frames, Deviations | None]:
    """Return base, tools and deviations to begin from: of an earlier fit, tools it did not know as in ``frames``."""
    if begin is None:
        return frames, None
    known = dict(zip(begin.measurements[0].tools, begin.machine.frames.tools, strict=True))
    placed = np.stack([known.get(name, T) for name, T in zip(tools, frames.tools, strict=True)])
    return Frames(begin.machine.frames.base, placed), begin.machine.deviations


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


def residuals_of(fit: Fit, measurements: Sequence[Measurements], machine: Machine) -> tuple[Array, ...]:
    """Return residuals (N, 3 or 6) of other measurements, in m and rad, for a machine of the fit.

    Raises MeasurementError when they are not of this robot, or made with a tool that the fit does not know.
    """
    tools = fit.measurements[0].tools
    for data in measurements:
        for tool in data.tools:
            if tool not in tools:
                known = ", ".join(map(repr, tools))
                raise MeasurementError(f"{data.where}: tool point {tool!r} was not identified; known are {known}.")
    known_first = (fit.measurements[0], *measurements)
    return residuals(fit.model.robot, with_common_tools(fit.model, known_first)[1:], machine)


def with_values(fit: Fit, values: Array, machine: Machine) -> Fit:
    """Return the fit with other values (p,) of its parameters, found in another way, and their ``machine``.

    What the data can see, and how well, stays as identified.
    """
    after = residuals(fit.model.robot, fit.measurements, machine)
    return replace(fit, values=read_only(values), machine=machine, residuals=tuple(read_only(r) for r in after))


def with_common_tools(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with one common list of tools; raises MeasurementError when they are not of this robot."""
    names = tuple(reading.name for reading in model.robot.readings)
    for data in sets:
        if data.reading_names != names:
            raise MeasurementError(
                f"{data.where}: the readings {data.reading_names} are not those of the robot, {names}."
            )
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    return tuple(
        replace(data, tools=tools, tool=np.array([tools.index(name) for name in data.tools], dtype=np.intp)[data.tool])
        for data in sets
    )
