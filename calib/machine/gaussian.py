"""What no model of the arm explains, as a Gaussian process over joint space: for errors measured anywhere.

The error vectors, measured minus predicted, are kept in the axes of the base or of the tip link; their three components
are independent and have one covariance, ``a^2 (1 + sqrt(3) d) exp(-sqrt(3) d)`` (Matern, nu = 3/2) of the distance d
of two rows in length scales of the joints, and noise at every row. Far from all rows the prediction fades to zero, and
its standard deviation grows to a. After Rasmussen and Williams, *Gaussian processes for machine learning*, 2006.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.machine.npz import NotReadableError
from calib.machine.residual_file import HEAD, head_of, load_residuals, named, residual_bytes
from calib.machine.residual_model import Frame, Leaning, axes_of, joint_numbers, measured_errors
from calib.machine.turns import points_of
from calib.robot.robot import Reading

Dimension = Literal["angle", "length"]

# Where measured rows leave more than this share of the prior's deviation, they say nothing.
_UNKNOWN = 0.9
# The likelihood has bad optima: with too long scales all is noise. Starts in rad or m, and where scales may go.
_STARTS = (0.1, 0.3, 1.0)
_SCALES = (0.02, 100.0)
# Of the variances of the process and of the noise, in units of the errors' mean square.
_VARIANCE = (1e-4, 1e3)
_NOISE = (1e-6, 10.0)
# The likelihood of errors that follow no joint is flat, and a search on it would not end for long. A rougher one would
# stop on the way to a better optimum.
_ENOUGH: Any = {"ftol": 1e-9, "maxiter": 100}
# Of so many rows or more, where a look takes long, a search ends that after so many steps is not likelier than noise
# alone by this much, as a logarithm, if none before it was: it has k + 2 numbers to choose, and chance brings as much.
_MANY_ROWS, _STEPS_TO_HOPE, _BY_CHANCE = 400, 15, 3.0
# Scales, amplitude and noise show in so many rows as well as in all, at a fraction of the cost.
_ROWS_FOR_SCALES = 600
_FEWEST_ROWS = 10
_MOST_ROWS = 5000
_BLOCK = 2048
_KEYS = (*HEAD, "points", "errors", "amplitude", "scales", "noise")


class Kernel(NamedTuple):
    """Standard deviation in m of an error component and of its noise; length scales (k) of joints, in rad or m."""

    amplitude: float
    scales: Array
    noise: float

    def between(self, a: Array, b: Array) -> Array:
        """Return the covariances (N, M) in m^2, without noise, of an error component at points (N, k) and (M, k)."""
        d = scipy.spatial.distance.cdist(a / self.scales, b / self.scales)
        d *= np.sqrt(3.0)
        # In place, as of 5000 rows each of these takes 200 MB.
        fading = np.negative(d)
        np.exp(fading, out=fading)
        d += 1.0
        d *= self.amplitude**2
        d *= fading
        return np.asarray(d)

    def of_rows(self, points: Array) -> Array:
        """Return the covariance (N, N) in m^2 of what was measured at points (N, k)."""
        found = self.between(points, points)
        found[np.diag_indices_from(found)] += self.noise**2
        return found


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class GaussianResiduals:
    """A Gaussian process of error vectors over some joints. Made by :func:`gaussian_from_residuals`.

    ``readings``: all joints of the robot, in the order of its readings, and ``joints``: numbers of the k that errors
    follow. ``points`` (n, k): where in rad and m the ``errors`` (n, 3) were measured, in m, in the axes of ``frame``.
    ``factor`` (n, n), ``weights`` (n, 3): lower Cholesky factor of the covariance of the rows, and its inverse times
    the errors. ``turning``: of all joints, or none, whether a whole turn brings them back. ``setups``,
    ``tools``: as of a grid.
    """

    __repr__ = brief

    readings: tuple[tuple[str, Dimension], ...]
    joints: tuple[int, ...]
    points: Array
    errors: Array
    frame: Frame
    kernel: Kernel
    factor: Array
    weights: Array
    turning: tuple[bool, ...] = ()
    setups: tuple[str, ...] = ()
    tools: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """How many measured rows are gone through for every vector: all."""
        return len(self.points)

    def at(self, readings: Array, *, clamp: bool = False) -> Array:  # noqa: ARG002 - it fades either way
        """Return the predicted error vectors (N, 3) in m at readings (N, nr) in rad and m; zero far from all rows.

        With ``clamp`` or without: nothing is extrapolated.
        """
        blocks = [self.kernel.between(points, self.points) @ self.weights for points in self._blocks(readings)]
        return np.concatenate([np.zeros((0, 3)), *blocks])

    def sigma(self, readings: Array) -> Array:
        """Return the standard deviation (N) in m of each component of :meth:`at` from the true error, without noise."""
        prior = self.kernel.amplitude**2
        known = [
            np.sum(
                scipy.linalg.solve_triangular(self.factor, self.kernel.between(self.points, points), lower=True) ** 2,
                axis=0,
            )
            for points in self._blocks(readings)
        ]
        return np.sqrt(np.maximum(prior - np.concatenate([np.zeros(0), *known]), 0.0))

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return the error vectors (N, 3) in the axes of the instrument.

        ``base`` (4, 4) is the robot's in the instrument's frame; ``tips`` (N, 4, 4): tip link in the base link.
        """
        return np.asarray((axes_of(self.frame, base, tips) @ self.at(readings)[:, :, None])[:, :, 0])

    def outside(self, readings: Array) -> tuple[str, ...]:
        """Return for every row of readings (N, nr) that no measured error is near, or an empty text."""
        prior = self.kernel.amplitude
        return tuple(
            f"no error was measured near: the standard deviation there is {sigma / MM:.3g} mm, of {prior / MM:.3g} mm"
            if sigma > _UNKNOWN * prior
            else ""
            for sigma in self.sigma(readings)
        )

    def leaning(self, readings: Array) -> Leaning:
        """Return how much of the errors the process leaves; it says for itself how sure it is of the rest."""
        sigma = self.sigma(readings)
        none = np.zeros((len(readings), 0))
        return Leaning(np.zeros((*none.shape, len(self.readings))), none, sigma / self.kernel.amplitude, sigma)

    def scatter(self, noise: float) -> float:
        """Return what its rows scatter by beyond their ``noise``: errors of the tool that its joints do not tell.

        Less what is chance, as one in two noises is found too large (James and Stein, 1961).
        """
        beyond = self.kernel.noise**2 - noise**2
        if beyond <= 0.0:
            return 0.0
        doubt = self.kernel.noise**4 * 2.0 / self.errors.size
        return float(np.sqrt(max(beyond - doubt / beyond, 0.0)))

    def own_errors(self, readings: Array, noise: float) -> Array:
        """Return a factor (N, N) of the covariance of the true errors given the rows, of :meth:`sigma` and scatter."""
        points = self._points(readings)
        known = scipy.linalg.solve_triangular(self.factor, self.kernel.between(self.points, points), lower=True)
        covariance = self.kernel.between(points, points) - known.T @ known
        covariance[np.diag_indices_from(covariance)] += self.scatter(noise) ** 2
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

    @property
    def when_clamped(self) -> str:
        """What :meth:`at` returns far from all rows."""
        return "the predicted error fades to zero"

    def _points(self, readings: Array) -> Array:
        """Return the readings (N, nr) of its joints (N, k), turned towards the rows where beyond all of them."""
        return points_of(readings, self.joints, self.points.min(axis=0), self.points.max(axis=0), self.turning)

    def _blocks(self, readings: Array) -> list[Array]:
        points = self._points(readings)
        return [points[n : n + _BLOCK] for n in range(0, len(points), _BLOCK)]


# ---- from measured errors


def gaussian_from_residuals(
    readings: Array,
    errors: Array,
    robot_readings: Sequence[Reading],
    joints: Sequence[str] | None = None,
    frame: Frame = "base",
    *,
    where: str = "residuals",
) -> GaussianResiduals:
    """Return the Gaussian process of error vectors (N, 3) in m, in the axes of ``frame``, at readings (N, nr).

    ``joints``: names, out of ``robot_readings``, of those that errors may follow; all when None. Amplitude, length
    scales and noise are those of the largest marginal likelihood of up to 600 rows, the best of three starts; the
    prediction is from all rows. The order of the rows does not matter. ``where``: of the rows, for messages.

    Raises JobError when an option cannot be used; MeasurementError for rows of other shapes, rows that are not finite,
    and too few or too many rows.
    """
    names = [reading.name for reading in robot_readings]
    numbers = sorted(joint_numbers(names, names if joints is None else joints, frame))
    readings, errors = measured_errors(readings, errors, len(names), where)
    if not _FEWEST_ROWS <= len(errors) <= _MOST_ROWS:
        raise MeasurementError(
            f"{where}: a Gaussian process is made of {_FEWEST_ROWS} to {_MOST_ROWS} rows, and there are {len(errors)}."
        )
    if not errors.any():
        raise MeasurementError(f"{where}: all errors are zero; there is nothing to explain.")
    points, errors = in_row_order(readings[:, numbers], errors)
    with one_thread():
        kernel = likeliest_kernel(points, errors)
        dimensions = tuple((reading.name, reading.dimension) for reading in robot_readings)
        found = _trained(dimensions, tuple(numbers), points, errors, frame, kernel)
    return replace(found, turning=tuple(reading.turns for reading in robot_readings))


def in_row_order(points: Array, errors: Array) -> tuple[Array, Array]:
    """Return rows in an order of their own, so that the one they came in is forgotten."""
    order = np.lexsort(np.column_stack([errors, points]).T)
    return points[order], errors[order]


def likeliest_kernel(points: Array, errors: Array) -> Kernel:
    """Return the kernel of the largest marginal likelihood of errors (N, 3) in m at points (N, k)."""
    some = np.random.default_rng(0).permutation(len(points))[:_ROWS_FOR_SCALES]
    # In units of the errors' own size the same bounds fit every machine.
    unit = float(np.sqrt(np.mean(errors[some] ** 2))) or 1.0
    scaled = errors[some] / unit
    bounds = [tuple(map(float, np.log(two))) for two in (_VARIANCE, *[_SCALES] * points.shape[1], _NOISE)]
    # In these units noise alone has the variance 1.
    hopeless = 0.5 * scaled.size * (1.0 + np.log(2.0 * np.pi)) - _BY_CHANCE if len(some) >= _MANY_ROWS else np.inf
    found = []
    for scale in _STARTS:
        start = np.log([0.7, *[scale] * points.shape[1], 0.3])
        best: Any = scipy.optimize.minimize(  # type: ignore[call-overload]
            _unlikely,
            start,
            (points[some], scaled),
            method="L-BFGS-B",
            jac=True,
            bounds=bounds,
            options=_ENOUGH,
            callback=_hoping(hopeless),
        )
        found.append((float(best.fun), np.exp(best.x)))
        if best.fun < hopeless:  # there is something to be found, and the others may find more of it
            hopeless = np.inf
    _, (variance, *scales, noise) = min(found, key=lambda one: one[0])
    return Kernel(unit * float(np.sqrt(variance)), read_only(scales), unit * float(np.sqrt(noise)))


def _hoping(hopeless: float) -> Callable[[Any], None]:
    """Return what ends a search, after some steps, at a value of :func:`_unlikely` that is ``hopeless``."""
    steps = itertools.count(1)

    def after(intermediate_result: Any) -> None:
        if next(steps) >= _STEPS_TO_HOPE and float(intermediate_result.fun) > hopeless:
            raise StopIteration

    return after


def _unlikely(logarithms: Array, points: Array, errors: Array) -> tuple[float, Array]:
    """Return minus the log marginal likelihood of errors (N, c), and its derivative by the logarithms (k + 2).

    These are of the variance, the k length scales and the variance of the noise; (5.8) and (5.9) of Rasmussen and
    Williams. Beside the factor and its inverse nothing costs more than some passes over the covariance.
    """
    variance, *scales, noise = np.exp(logarithms)
    x = (points - points.mean(axis=0)) / scales
    d = np.sqrt(3.0) * scipy.spatial.distance.cdist(x, x)
    fading = variance * np.exp(-d)
    covariance = fading * (1.0 + d)
    factor, fails = scipy.linalg.lapack.dpotrf(covariance + noise * np.eye(len(x)), lower=True)
    if fails:
        return np.inf, np.zeros_like(logarithms)
    weights, _ = scipy.linalg.lapack.dpotrs(factor, errors, lower=True)
    inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=True)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    logs = float(np.sum(np.log(np.diag(factor)))) + 0.5 * len(x) * np.log(2.0 * np.pi)
    value = 0.5 * float(np.sum(errors * weights)) + errors.shape[1] * logs
    # Half of what the value gains by an entry of the covariance.
    by_entry = 0.5 * (errors.shape[1] * inverse - weights @ weights.T)
    spread = 3.0 * by_entry * fading
    apart = 2.0 * (spread.sum(axis=1) @ x**2 - np.sum(x * (spread @ x), axis=0))
    return value, np.array([np.sum(by_entry * covariance), *apart, noise * np.trace(by_entry)])


def _trained(
    readings: tuple[tuple[str, Dimension], ...],
    joints: tuple[int, ...],
    points: Array,
    errors: Array,
    frame: Frame,
    kernel: Kernel,
) -> GaussianResiduals:
    """Return the process conditioned on all rows. Raises LinAlgError where rounding makes their covariance singular."""
    factor = scipy.linalg.cholesky(kernel.of_rows(points), lower=True)
    weights = scipy.linalg.cho_solve((factor, True), errors)
    return GaussianResiduals(
        readings, joints, read_only(points), read_only(errors), frame, kernel, read_only(factor), read_only(weights)
    )


# ---- files


def gaussian_bytes(known: GaussianResiduals, run: str | None = None) -> bytes:
    """Return a process as an npz file, of a run's results: rows and kernel, the same bytes for the same process."""
    kernel = known.kernel
    arrays = {
        "points": known.points,
        "errors": known.errors,
        "amplitude": np.array(kernel.amplitude),
        "scales": kernel.scales,
        "noise": np.array(kernel.noise),
    }
    return residual_bytes(known.frame, known.joints, known.readings, arrays | named(known.setups, known.tools), run)


def load_gaussian(path: str | Path, robot_readings: Sequence[Reading] | None = None) -> GaussianResiduals:
    """Read a process as :func:`gaussian_bytes` makes it; nothing in the file is ever executed.

    Raises OutputError with one sentence when the file is not such a process, or not one of a robot with these readings.
    """
    return load_residuals(path, _KEYS, _gaussian_of, ("a Gaussian process", "of"), robot_readings)


def _gaussian_of(arrays: Mapping[str, npt.NDArray[Any]]) -> GaussianResiduals:
    frame, readings, numbers = head_of(arrays, {})
    for key, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise NotReadableError(f"{key} has a value that is not a finite number")
    if sorted(numbers) != list(numbers):
        raise NotReadableError("its joints are not in the order of the robot's")
    points, errors, scales = arrays["points"], arrays["errors"], arrays["scales"]
    n = len(points) if points.ndim else 0
    if not 0 < n <= _MOST_ROWS or points.shape != (n, len(numbers)) or errors.shape != (n, 3):
        raise NotReadableError("its errors are not those of its points")
    sizes = (arrays["amplitude"], scales, arrays["noise"])
    if [size.shape for size in sizes] != [(), (len(numbers),), ()] or min(map(np.min, sizes)) <= 0.0:
        raise NotReadableError("its amplitude, scales and noise are not positive numbers")
    kernel = Kernel(float(sizes[0]), read_only(scales), float(sizes[2]))
    try:
        with np.errstate(over="ignore", invalid="ignore"), one_thread():
            return _trained(readings, numbers, points, errors, frame, kernel)
    except (np.linalg.LinAlgError, ValueError) as e:
        raise NotReadableError("its rows cannot be told apart") from e
