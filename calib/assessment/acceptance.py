"""Is a calibrated machine still what it was? New measurements against a limit and against the stated uncertainty.

With residuals r of all rows, their noise S (instrument and model part), and what is common to rows (factor F): errors
of the parameters, what the model leaves out along the readings, and what a residual model itself gets wrong,

    T = r^T (S + F F^T)^-1 r

follows chi-square with as many degrees of freedom as measured numbers, if nothing has changed; with a noise that was
itself estimated with nu degrees of freedom, T / n follows F(n, nu). Where bases are
found anew, in every set-up of the rows by itself, each takes six of them.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import scipy

from calib.assessment.metrics import Metrics, metrics
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import bound, exceeded
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread, svd, triangle
from calib.foundations.ranges import refuse_beyond
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import common_errors, residual_errors, row_freedom, row_noise
from calib.measurement.conditions import refuse_lacking
from calib.measurement.measurements import Measurements
from calib.robot.robot import TipModel

# A machine that has not changed is failed once in so many tests.
SIGNIFICANCE = 0.01
# Places that differ from one, or from a line, by less than a millionth of the reach.
_NEARLY_IN_LINE = 1e-6
# What a residual model gets wrong is common to its neighbours; of more rows so many are looked at together.
_TOGETHER = 300
# In m or rad: nothing is left of the square of less.
_LEAST_NOISE = 1e-100
# What else than columns tells the side of approach of rows by which a machine is verified.
_IN_ORDER = "; rows in the order of measurement tell it, too: say in_order"
# Entries of twists of length one that differ by rounding alone.
_SAME_AXIS = 1e-9


@dataclass(frozen=True, slots=True)
class ChiSquare:
    """A test of residuals against the stated uncertainty: T over ``degrees_of_freedom``, and its ``probability``.

    The probability is that of a larger T if nothing has changed.
    """

    statistic: float
    degrees_of_freedom: int
    probability: float

    @property
    def passed(self) -> bool:
        """Whether the residuals are no larger than the stated uncertainty explains, at ``SIGNIFICANCE``."""
        return self.probability >= SIGNIFICANCE

    @property
    def half_seen(self) -> float:
        """How many times larger than stated errors are of which this test finds half; 1 of very many rows."""
        freedom = self.degrees_of_freedom
        return float(np.sqrt(bound(1.0 - SIGNIFICANCE, freedom) / bound(0.5, freedom)))


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """One judgement of new measurements. ``residuals`` (N, 3 or 6): measured minus predicted, in m and rad."""

    __repr__ = brief

    metrics: dict[str, Metrics]
    residuals: Array
    test: ChiSquare

    def contents(self) -> dict[str, Any]:
        """Return the figures as plain data."""
        return {
            "metrics": {quantity: asdict(m) for quantity, m in self.metrics.items()},
            "test": {**asdict(self.test), "passed": self.test.passed},
        }


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """New measurements of a calibrated machine. Made by :func:`verify`.

    ``as_calibrated`` with the base where it was; ``base_refitted`` with the base found anew in every set-up of them,
    None where rows are too few; ``base_moved``: by how much, in m (at the base's origin) and rad, where it moved most.
    ``or_offset_of``: where a base that moved explains what the machine as calibrated does not, the reading of a joint
    whose offset, changed, would look the same, or None. ``limit`` in m of every position error, or None. ``refit``:
    which of the two decides.
    """

    __repr__ = brief

    as_calibrated: Judgement
    base_refitted: Judgement | None
    base_moved: tuple[float, float] | None
    or_offset_of: str | None
    limit: float | None
    refit: bool

    @property
    def decisive(self) -> Judgement:
        """The judgement that decides."""
        return self.base_refitted if self.refit and self.base_refitted is not None else self.as_calibrated

    @property
    def within_limit(self) -> bool | None:
        """Whether every position error is within the limit; None without one."""
        return None if self.limit is None else self.decisive.metrics["position"].max <= self.limit

    @property
    def passed(self) -> bool:
        """Whether the errors are within the limit, where there is one, and within the stated uncertainty."""
        return self.within_limit is not False and self.decisive.test.passed

    def contents(self) -> dict[str, Any]:
        """Return the verdict as plain data, in m and rad."""
        return {
            "passed": self.passed,
            "limit": self.limit,
            "within_limit": self.within_limit,
            "base_refitted": self.refit,
            "as_calibrated": self.as_calibrated.contents(),
            "with_base_refitted": None if self.base_refitted is None else self.base_refitted.contents(),
            "base_moved": self.base_moved,
            "or_offset_of": self.or_offset_of,
        }


@checked
def verify(
    machine: CalibratedMachine,
    data: Measurements,
    *,
    limit: float | None = None,
    refit: bool = False,
) -> Verification:
    """Judge new measurements of a calibrated machine by a limit in m, and by what it says of its own uncertainty.

    ``refit``: find the base anew and judge with it, as after the instrument was moved. If the table does not state the
    instrument's noise, that of the calibration is used.

    Raises JobError for a limit out of range; MeasurementError when the machine's uncertainty is not known, when a tool
    was not identified, when a joint term needs a condition that the rows do not have, when orientations are judged by a
    calibration without any, or when the base is to be found anew from fewer than three positions or from positions that
    do not determine it; RobotError when a loop does not close.
    """
    if limit is not None:
        refuse_beyond(limit, "sigma", "limit")
    if data.kind not in ("position", "pose"):
        raise MeasurementError(f"{data.where}: a machine is verified by positions or poses, and not by {data.kind}.")
    if not len(data):
        raise MeasurementError(f"{data.where}: has no rows to verify by.")
    data = _of_this_machine(machine, data)
    refuse_lacking(machine.robot, data.conditions, data.where, _IN_ORDER)
    sigma = _sigma(machine, data)
    data.tips(machine.robot, machine.deviations)  # refuses rows whose loops do not close
    as_calibrated = _judged(machine, data, sigma, base=False)
    refitted, moved, alike, shown = None, None, None, True
    places = [data.setup == k for k in np.unique(data.setup)]
    fewest = min(int(np.count_nonzero(own)) for own in places)
    enough = fewest >= 3 and data.sigma.size > 6 * len(places)
    if enough and (shown := all(_shows_base(machine, data.subset(own)) for own in places)):
        found = _realigned(machine, data)
        refitted = _judged(found, data, sigma, base=True)
        moved = max(_motion(base, found.bases[name]) for name, base in machine.bases.items())
        if refitted.test.passed and not as_calibrated.test.passed:
            alike = _offset_alike(machine, found, data, sigma)
    elif refit and not shown:
        raise MeasurementError(
            f"{data.where}: all rows are at one place or in line, which do not show where the base is; it takes three "
            "places."
        )
    elif refit:
        few = next(data.setups[data.setup[own][0]] for own in places if np.count_nonzero(own) == fewest)
        of_it = f" at set-up {few!r}" if len(places) > 1 else ""
        raise MeasurementError(f"{data.where}: {fewest} rows{of_it} are too few to find the base anew; it takes three.")
    return Verification(as_calibrated, refitted, moved, alike, limit, refit)


def _of_this_machine(machine: CalibratedMachine, data: Measurements) -> Measurements:
    names = tuple(reading.name for reading in machine.robot.readings)
    if data.reading_names != names:
        raise MeasurementError(f"{data.where}: the readings {data.reading_names} are not those of the robot, {names}.")
    return machine.with_own_names(data)


def _sigma(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return the standard deviations (N, 3 or 6) of the rows: instrument and model part."""
    sigma = row_noise(machine, data)
    for k, quantity in enumerate(("position", "orientation")[: sigma.shape[1] // 3]):
        part = sigma[:, 3 * k : 3 * k + 3]
        if np.isnan(part).any():
            raise MeasurementError(
                f"{data.where}: the calibration was made without any {quantity}; verify by the kind of data it was "
                "made from."
            )
        if not (part > _LEAST_NOISE).all():
            raise MeasurementError(
                f"{data.where}: neither the rows nor uncertainty.json of the calibration state any noise of a "
                f"{quantity}; give the standard deviation of the instrument."
            )
    return sigma


def _realigned(machine: CalibratedMachine, data: Measurements) -> CalibratedMachine:
    """Return the machine with its base, in every set-up of the rows, where it explains these best."""
    tips = machine.tips(data.readings, data.conditions)
    turned = np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation
    tools = machine.state.frames.tools
    assert data.position is not None, "positions and poses have one"
    known, bases = KnownFrames(None, tools[:, :3, 3], tools[:, :3, :3]), machine.bases
    for name, own in ((data.setups[k], data.setup == k) for k in np.unique(data.setup)):
        rows = TipObservations(tips[own], data.position[own], turned[own], data.tool[own])
        bases[name] = base_and_tools(rows, known, tools).base
    return replace(machine, base=bases.pop(machine.setup), others=bases)


def _motion(before: Array, after: Array) -> tuple[float, float]:
    """Return by how much a base has moved, in m at its origin, and rad."""
    change = rigid.inverse(before) @ after
    return float(np.linalg.norm(change[:3, 3])), float(np.linalg.norm(rigid.log3(change[:3, :3])))


def _offset_alike(machine: CalibratedMachine, found: CalibratedMachine, data: Measurements, sigma: Array) -> str | None:
    """Return the reading whose offset, changed, moves the arm as all bases found anew; None without one."""
    tips, by_reading = TipModel(machine.robot, machine.deviations).driven(data.readings, data.conditions)
    # In the axes of the base a joint that nothing carries moves the tip about the same axis wherever it is.
    twists = rigid.adjoint(tips) @ by_reading
    twists /= np.maximum(np.linalg.norm(twists, axis=1, keepdims=True), np.finfo(float).tiny)
    freedom = float(row_freedom(machine, data).min())
    moves = []
    with one_thread():
        whitened = _whitening(found, data, sigma)
        for k, columns in _base_columns(found, data, sigma).items():
            change = rigid.inverse(machine.bases[data.setups[k]]) @ found.bases[data.setups[k]]
            w = rigid.log3(change[:3, :3])
            moves.append((whitened(columns), np.concatenate([rigid.left_jacobian_inverse(w) @ change[:3, 3], w])))
        for j, reading in enumerate(machine.robot.readings):
            twist = twists[0, :, j]
            same_axis = np.allclose(twists[:, :, j], twist, rtol=0.0, atol=_SAME_AXIS)
            if same_axis and all(_explains(B @ twist, B @ move, freedom) for B, move in moves):
                return reading.name
    return None


def _explains(a: Array, b: Array, freedom: float) -> bool:
    """Return whether a multiple of a (n,) explains b (n,), both whitened and of six numbers."""
    rest = b - a * float(a @ b) / max(float(a @ a), np.finfo(float).tiny)
    return bool(exceeded(float(rest @ rest), 5, freedom) >= SIGNIFICANCE)


def _whitening(machine: CalibratedMachine, data: Measurements, sigma: Array) -> Callable[[Array], Array]:
    """Return what whitens numbers (n,), or columns (n, k), of rows over sigma by what is common to all of them."""
    less = _less_residual_errors(machine, data, sigma)
    F = common_errors(machine, data) / sigma[:, :, None]
    U, s, _ = svd(less(F.reshape(sigma.size, -1)), full_matrices=False)

    def whitened(x: Array) -> Array:
        # By the root of (I + F F^T)^-1, also where F is so large that the sum would lose the I.
        y = less(x)
        return np.asarray(y - (U * (1.0 - 1.0 / np.hypot(1.0, s))) @ (U.T @ y))

    return whitened


def _less_residual_errors(machine: CalibratedMachine, data: Measurements, sigma: Array) -> Callable[[Array], Array]:
    """Return what whitens numbers (n,), or columns (n, k), over sigma by noise and what a residual model gets wrong."""
    if machine.residual_model is None:
        return np.asarray
    d, factors = sigma.shape[1], []
    for start in range(0, len(data), _TOGETHER):
        rows = np.arange(start, min(start + _TOGETHER, len(data)))
        G = (residual_errors(machine, data.subset(rows)) / sigma[rows, :, None]).reshape(d * len(rows), -1)
        factors.append(
            (slice(d * start, d * start + len(G)), scipy.linalg.cholesky(np.eye(len(G)) + G @ G.T, lower=True))
        )

    def less(x: Array) -> Array:
        return np.concatenate([scipy.linalg.solve_triangular(factor, x[rows], lower=True) for rows, factor in factors])

    return less


def _judged(machine: CalibratedMachine, data: Measurements, sigma: Array, *, base: bool) -> Judgement:
    r = machine.residuals(data)
    with one_thread():
        whitened = _whitening(machine, data, sigma)
        w, n = whitened((r / sigma).ravel()), r.size
        if base:
            B = whitened(np.concatenate([*_base_columns(machine, data, sigma).values()], axis=1))
            w, n = w - B @ np.linalg.lstsq(B, w)[0], n - B.shape[1]
        T = float(w @ w)
    return Judgement(
        dict(metrics([(data.kind, r)])),
        read_only(r),
        ChiSquare(T, n, float(exceeded(T, n, row_freedom(machine, data).min()))),
    )


def _shows_base(machine: CalibratedMachine, data: Measurements) -> bool:
    """Return whether the rows see every motion of the base: positions at one place, or in line, do not."""
    B = _base_motion(machine, data).reshape(-1, 6)
    B = B / np.repeat([1.0, machine.robot.reach], 3)
    values = np.linalg.svd(triangle(B), compute_uv=False)
    return bool(values[-1] > _NEARLY_IN_LINE * values[0])


def _base_columns(machine: CalibratedMachine, data: Measurements, sigma: Array) -> dict[int, Array]:
    """Return how residuals over sigma follow the base of every set-up (n, 6), which other rows do not follow."""
    motion = _base_motion(machine, data) / sigma[:, :, None]
    return {
        int(k): np.where((data.setup == k)[:, None, None], motion, 0.0).reshape(-1, 6) for k in np.unique(data.setup)
    }


def _base_motion(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return the motions (N, 3 or 6, 6) of the tools for local twists of the base, as residuals count them."""
    in_base = data.tips(machine.robot, machine.deviations) @ data.placed_by(machine.state.frames.tools)
    local = rigid.adjoint(rigid.inverse(in_base))
    placed = machine.state.frames.bases[data.setup] @ in_base
    motion = np.concatenate([placed[:, :3, :3] @ local[:, :3], local[:, 3:]], axis=1)
    return np.asarray(motion[:, : data.sigma.shape[1]])
