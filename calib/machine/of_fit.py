"""The calibrated machine of a fit, with its uncertainty.

Whoever reads a machine from a folder of results needs none of this, nor what a fit is made of.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.chance import exceeded
from calib.foundations.errors import JobError
from calib.foundations.linear import svd
from calib.identification.earlier import Earlier, Errors
from calib.identification.fit import Fit
from calib.identification.losses import scatter_weight
from calib.identification.machine import Layout, Machine
from calib.identification.noise import Noise
from calib.identification.parameters import Parameter, directions, scales
from calib.machine.budget import ErrorsByCause, errors_by_cause
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import condition_ranges
from calib.machine.residual_model import ResidualModel
from calib.machine.uncertainty import NoiseLevel, OwnNoise, Uncertainty
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.measurement.measurements import ONLY_SETUP, Measurements
from calib.robot.joint_terms import in_setup
from calib.robot.sampling import least_determinant

# Directions of the covariance below this share of the largest are rounding.
_ROUNDING = 1e-12
# Rows of some pair scatter more than others where chance makes any do so less often than this.
_CHANCE = 0.01
# Directions of the null spaces of a fit and of one before it that differ by less, in parameter scales, are the same.
_SAME_DIRECTION = 0.05


@checked
def machine_of(fit: Fit, residual_model: ResidualModel | None = None) -> CalibratedMachine:
    """Return the calibrated machine of a fit, in the frames of its URDF, with its uncertainty.

        machine = calib.machine_of(calib.identify(model, data))

    ``residual_model``: what it adds to positions. Raises JobError when the fit has no tool.
    """
    if not fit.measurements[0].tools:
        raise JobError("the fit has no tool: a machine has one or more.")
    found = replace(assembled(fit, as_named=False), residual_model=residual_model, uncertainty=_uncertainty(fit))
    return _in_default_setup(found)


def assembled(fit: Fit, *, as_named: bool = True) -> CalibratedMachine:
    """Return the machine of a fit without its uncertainty; ``as_named``: in the set-up without a name, if there is one.

    Else it is in the first set-up of the fit, as the rows of its state are.
    """
    frames, names = fit.machine.frames, fit.measurements[0]
    setup, *others = names.setups
    found = CalibratedMachine(
        in_setup(fit.robot, setup),
        fit.deviations,
        read_only(frames.bases[0]),
        {name: read_only(T) for name, T in zip(names.tools, frames.tools, strict=True)},
        setup=setup,
        others={name: read_only(T) for name, T in zip(others, frames.bases[1:], strict=True)},
        tool_tips=fit.tool_tips,
    )
    return _in_default_setup(found) if as_named else found


def _in_default_setup(machine: CalibratedMachine) -> CalibratedMachine:
    return machine.at(ONLY_SETUP) if ONLY_SETUP in machine.others else machine


def _uncertainty(fit: Fit) -> Uncertainty:
    told = np.concatenate([_told(data, end.readings) for data in fit.measurements for end in data.ends])
    readings = np.where(np.isnan(told).all(axis=0), 0.0, told)
    identified = np.stack([np.nanmin(readings, axis=0), np.nanmax(readings, axis=0)], axis=1)
    errors = errors_by_cause(fit, identified)
    state = _to_state(fit, errors.parameters, errors.at) * scales(errors.parameters)
    parts = [state @ part for part in (errors.instrument, errors.unseen, errors.scatter, errors.of_readings)]
    noises = _parts(fit, errors)
    if fit.earlier is not None:  # what has measured there is told no more: its noise counts as the instrument's
        earlier = _of_earlier(fit, fit.earlier)
        parts[0], parts[1] = np.hstack([parts[0], earlier.noise]), np.hstack([parts[1], earlier.along])
    return Uncertainty(
        read_only(np.hstack(parts)),
        (parts[0].shape[1], parts[1].shape[1], parts[2].shape[1] + parts[3].shape[1]),
        errors.left_out,
        read_only(_null_basis(fit)),
        _level(noises, "m"),
        _level(noises, "rad"),
        read_only(identified),
        _closure_determinant(fit),
        _own_noise(fit, noises),
        condition_ranges(fit.robot, (end for data in fit.measurements for end in data.loaded(fit.robot).ends)),
    )


def _null_basis(fit: Fit) -> Array:
    """Return changes (n, k) of the machine's state in the null space of a fit and of those before it.

    Directions are orthonormal in the scales of parameters.
    """
    basis, parameters = fit.null_basis, fit.parameters
    if fit.earlier is not None:
        parameters = fit.earlier.parameters
        basis = np.vstack([basis, np.zeros((len(parameters) - len(basis), basis.shape[1]))])
        # What is free may follow one direction by many scales, and another one hardly at all.
        both = np.hstack([basis, fit.earlier.errors.null_basis / scales(parameters)[:, None]])
        U, s, _ = svd(both, full_matrices=False)
        basis = U[:, s > _SAME_DIRECTION]
    own = _of_machine(parameters)
    named = [parameters[k] for k in own]
    return _to_state(fit, named, fit.machine) @ (basis[own] * scales(named)[:, None])


def _closure_determinant(fit: Fit) -> float | None:
    """Return how near the loops came to a dead centre in the rows that tell where all joints stood, terms left out."""
    rows = [end.readings for data in fit.measurements if not data.absent for end in data.ends]
    plain = replace(fit.deviations, terms=np.zeros_like(fit.deviations.terms))
    return least_determinant(fit.robot, plain, np.concatenate(rows)) if rows else None


def measured_factor(fit: Fit) -> Array:
    """Return a factor (n, r) of the covariance of the machine's state by noise alone, null space left out."""
    own = _of_machine(fit.parameters)
    parameters = [fit.parameters[k] for k in own]
    return np.asarray(_to_state(fit, parameters, fit.machine) @ _factor(fit.spread.of(own), scales(parameters)))


def _of_earlier(fit: Fit, earlier: Earlier) -> Errors:
    """Return the errors of an earlier fit in the machine's state."""
    own = _of_machine(earlier.parameters)
    to_state = _to_state(fit, [earlier.parameters[k] for k in own], fit.machine)
    return Errors(*(to_state @ part for part in earlier.errors.of(own)))


def _of_machine(parameters: Sequence[Parameter]) -> IntArray:
    """Return the parameters, by number, that the state can follow: targets and instruments are no part of it."""
    return np.array([k for k, parameter in enumerate(parameters) if not parameter.nuisance], dtype=np.intp)


def _to_state(fit: Fit, parameters: Sequence[Parameter], machine: Machine) -> Array:
    """Return how the state (n, p) of the machine in the frames of its URDF follows parameters, in SI units."""
    own = Layout(fit.model.robot)
    # Targets and lengths are no part of the machine, which the results are about.
    to_state = directions(parameters, Layout.of(fit.model.robot, machine.frames).size)
    parts = [to_state[: own.offsets], to_state[own.offsets : own.base]]
    if fit.model.dh is not None:
        parts[0] = fit.model.dh.source_rates(machine.deviations) @ parts[0]
    frames = np.concatenate([machine.frames.bases, machine.frames.tools])
    twists = np.concatenate([machine.base_twists, machine.tool_twists])
    for k, (T, W) in enumerate(zip(frames, twists, strict=True)):
        local = W @ to_state[own.base + 6 * k : own.base + 6 * k + 6]
        parts.append(np.concatenate([T[:3, :3] @ local[:3], local[3:]]))
    state = np.concatenate(parts)
    counts = len(machine.frames.bases), len(machine.frames.tools)
    assert len(state) == Layout(fit.robot, *counts).size, "one state of the machine, two ways"
    return state


def _told(data: Measurements, readings: Array) -> Array:
    """Return readings (N, nr), nan where no column told them."""
    return np.where([name in data.absent for name in data.reading_names], np.nan, readings)


def _factor(covariance: Array, s: Array) -> Array:
    """Return F (p, r) with ``F F^T = covariance``, of as many columns as something is known of."""
    values, vectors = np.linalg.eigh(covariance / (s[:, None] * s))
    kept = values > _ROUNDING * max(float(values.max(initial=0.0)), 0.0)
    return np.asarray(s[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _beyond(variance: float, noise: Noise) -> float:
    """Return by how much a variance is beyond the instrument's, shrunk the more the less sure that is.

    What is within chance is none: a variance less one that is known is positive in half of all cases where nothing is
    left out. The positive part of W. James and C. Stein's estimate (1961).
    """
    beyond, chance = variance - noise.instrument**2, variance**2 * 2.0 / max(noise.degrees_of_freedom, 1.0)
    if noise.instrument == 0.0 or beyond <= 0.0:
        return max(beyond, 0.0)
    return max(beyond - chance / beyond, 0.0)


class _Part(NamedTuple):
    """Rows of a component: their ``noise``, as the errors have its freedom, of ``freedom`` and ``variance``.

    ``repeated``: whether rows of one pose err together, ``apart``: whether the rows are not all of the component's.
    """

    noise: Noise
    freedom: float
    variance: float
    repeated: bool
    apart: bool = False

    def of_rows(self, share: float, square: float) -> "_Part":
        """Return it for a share of the rows, whose squares are so much larger than those of all."""
        return self._replace(freedom=share * self.freedom, variance=square * self.variance, apart=True)


def _parts(fit: Fit, errors: ErrorsByCause) -> list[_Part]:
    """Return all rows of every component."""
    return [
        _Part(replace(noise, degrees_of_freedom=freedom), freedom, (share * noise.total) ** 2, repeated)
        for noise, freedom, share, repeated in zip(
            fit.noise_by_rows, errors.freedom.tolist(), errors.noise.tolist(), errors.repeated.tolist(), strict=True
        )
    ]


def _own_noise(fit: Fit, parts: Sequence[_Part]) -> tuple[OwnNoise, ...]:
    """Return the noise of every set-up with every tool, as measured; of those that scatter no more, the common one.

    None where none scatters more than the others: the model errs elsewhere as it does there.
    """
    by_pair: dict[tuple[int, int], list[_Part]] = {}
    for part in parts:
        for pair, own in _by_pair(fit, part):
            by_pair.setdefault(pair, []).append(own)
    if len(by_pair) < 2:
        return ()
    by_unit = [_levels(by_pair, parts, unit) for unit in ("m", "rad")]
    names, pairs = fit.measurements[0], sorted(by_pair)
    apart = any(len(set(levels.values())) > 1 for levels in by_unit)
    return tuple(
        OwnNoise(names.setups[setup], names.tools[tool], *(levels[setup, tool] for levels in by_unit))
        for setup, tool in (pairs if apart else ())
    )


def _levels(
    by_pair: Mapping[tuple[int, int], Sequence[_Part]], parts: Sequence[_Part], unit: str
) -> dict[tuple[int, int], NoiseLevel | None]:
    """Return the noise of lengths or angles of every pair: its own, where its rows surely scatter more than others."""
    common, squares = _level(parts, unit), {pair: _squares(own, unit) for pair, own in by_pair.items()}
    every = np.sum(list(squares.values()), axis=0)
    found: dict[tuple[int, int], NoiseLevel | None] = dict.fromkeys(by_pair, common)
    for pair, own in squares.items():
        level = _level(by_pair[pair], unit)
        if level is None or common is None or level.model <= common.model:
            continue
        if _chance(own, every - own) < _CHANCE / len(by_pair):
            found[pair] = level
    return found


def _squares(parts: Sequence[_Part], unit: str) -> Array:
    """Return the freedom of lengths or angles, and sums of squares that it has of all noise and of the instrument's."""
    found = np.zeros(3)
    for part in parts:
        if UNIT_OF[part.noise.quantity] == unit:
            found += part.freedom * np.array([1.0, part.variance, part.noise.instrument**2])
    return found


def _chance(own: Array, others: Array) -> float:
    """Return how often rows scatter as much by chance, if the model leaves in them what it does in others (3,)."""
    if own[0] <= 0.0 or others[0] <= 0.0:
        return 1.0
    total, instrument = np.maximum(others[1:], 0.0) / others[0]
    level = NoiseLevel(float(np.sqrt(max(total - instrument, 0.0))), float(np.sqrt(total)), float(others[0]))
    expected = float(level.of_rows(np.sqrt(own[2] / own[0]))) ** 2
    return float(exceeded(own[1] / expected, max(round(own[0]), 1), others[0])) if expected > 0.0 else 0.0


def _by_pair(fit: Fit, part: _Part) -> Iterator[tuple[tuple[int, int], _Part]]:
    """Yield every set-up and tool of a component, by number, with the rows that have them; outliers weigh less."""
    data, loss = fit.measurements[part.noise.measurements], fit.losses[part.noise.measurements]
    pairs = np.array([np.stack([data.setup, end.tool], axis=1) for end in data.ends])
    every = np.unique(pairs.reshape(-1, 2), axis=0)
    if len(every) == 1:
        yield (int(every[0, 0]), int(every[0, 1])), part
        return
    columns = next(one.columns for one in QUANTITIES[data.kind] if one.name == part.noise.quantity)
    sigma = np.hypot(data.sigma[:, columns], part.noise.model)
    squares = np.mean((fit.residuals[part.noise.measurements][:, columns] / sigma) ** 2, axis=1)
    squares = squares * scatter_weight(loss, np.sqrt(squares))
    mean = float(np.mean(squares))
    for setup, tool in every:
        own = np.any(np.all(pairs == (setup, tool), axis=2), axis=0)
        square = float(np.mean(squares[own])) / mean if mean > 0.0 else 1.0
        yield (int(setup), int(tool)), part.of_rows(float(np.mean(own)), square)


def _level(every: Sequence[_Part], unit: str) -> NoiseLevel | None:
    """Return the noise of lengths or angles that parts of components have."""
    parts = [part for part in every if UNIT_OF[part.noise.quantity] == unit]
    freedom = np.array([part.freedom for part in parts])
    if not parts or freedom.sum() <= 0.0:
        return None

    def mean(squares: Sequence[float]) -> float:
        return float(np.sqrt(np.average(squares, weights=freedom)))

    total = mean([part.variance for part in parts])
    model = mean([_beyond(part.variance, part.noise) for part in parts])
    estimated = any(part.noise.model > 0.0 or part.repeated or part.apart for part in parts)
    # The estimate of the total has the freedom of the residuals; where nothing had to be added, it is not an estimate.
    # Few poses may leave less than one degree of freedom to positions, or to orientations.
    return NoiseLevel(model, total, max(float(freedom.sum()), 1.0) if estimated else float("inf"))
