"""Is a calibrated machine still what it was? New measurements against a limit and against the stated uncertainty.

With residuals r of all rows, their noise S (instrument and model part), and what is common to rows (factor F): errors
of the parameters, what the model leaves out along the readings, and what a residual model itself gets wrong,

    T = r^T (S + F F^T)^-1 r

follows chi-square with as many degrees of freedom as measured numbers, if nothing has changed; with a noise that was
itself estimated with nu degrees of freedom, T / n follows F(n, nu). Where bases are
found anew, in every set-up of the rows by itself, each takes six of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import scipy

from calib.assessment.frames_anew import (
    SIGNIFICANCE,
    WAYS,
    Anew,
    frame_columns,
    motion,
    not_shown,
    offset_alike,
    realigned,
)
from calib.assessment.metrics import Metrics, metrics
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import bound, exceeded
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread, svd
from calib.foundations.ranges import refuse_beyond
from calib.foundations.sealing import sealed
from calib.machine.calibrated import CalibratedMachine
from calib.machine.remembered import Remembered
from calib.machine.tool_uncertainty import common_errors, residual_errors, row_freedom, row_noise
from calib.measurement.conditions import refuse_lacking
from calib.measurement.measurements import Measurements

# What a residual model gets wrong is common to its neighbours; of more rows so many are looked at together.
_TOGETHER = 300
# In m or rad: nothing is left of the square of less.
_LEAST_NOISE = 1e-100
# What else than columns tells the side of approach of rows by which a machine is verified.
_IN_ORDER = "; rows in the order of measurement tell it, too: say in_order"


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
@sealed
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
class FoundAnew:
    """A judgement with frames found anew where they explain the rows best.

    ``base_moved``, ``tool_moved``: by how much, in m (at their origin) and rad, where they moved most; None for what
    stays, and where rows hardly tell which of both moved. ``or_offset_of``: where that explains what the machine as
    calibrated does not, the reading of a joint whose offset, changed, would look the same, or None.
    """

    __repr__ = brief

    judgement: Judgement
    base_moved: tuple[float, float] | None
    tool_moved: tuple[float, float] | None
    or_offset_of: str | None

    def contents(self) -> dict[str, Any]:
        """Return the figures as plain data, in m and rad."""
        return {
            **self.judgement.contents(),
            "base_moved": self.base_moved,
            "tool_moved": self.tool_moved,
            "or_offset_of": self.or_offset_of,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """New measurements of a calibrated machine. Made by :func:`verify`.

    ``as_calibrated`` with base and tool where they were; ``anew``: with the base found anew in every set-up of the
    rows, the tool, or both, as far as the rows show them. ``limit`` in m of every position error, or None. ``refit``:
    which of them decides, None where the machine is judged as it was calibrated.
    """

    __repr__ = brief

    as_calibrated: Judgement
    anew: Mapping[Anew, FoundAnew]
    limit: float | None
    refit: Anew | None

    @property
    def base_refitted(self) -> Judgement | None:
        """The judgement with the base found anew; None where the rows do not show it."""
        return self.anew["base"].judgement if "base" in self.anew else None

    @property
    def base_moved(self) -> tuple[float, float] | None:
        """By how much the base alone would have moved, in m and rad."""
        return self.anew["base"].base_moved if "base" in self.anew else None

    @property
    def or_offset_of(self) -> str | None:
        """The reading of a joint whose offset, changed, would look the same as a base that explains the rows."""
        return self.anew["base"].or_offset_of if "base" in self.anew else None

    @property
    def decisive(self) -> Judgement:
        """The judgement that decides."""
        return self.as_calibrated if self.refit is None else self.anew[self.refit].judgement

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
            "base_refitted": self.refit in {"base", "both"},
            "tool_refitted": self.refit in {"tool", "both"},
            "as_calibrated": self.as_calibrated.contents(),
            **{f"with_{what}_refitted": self.anew[what].contents() if what in self.anew else None for what in WAYS},
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
    refit_tool: bool = False,
) -> Verification:
    """Judge new measurements of a calibrated machine by a limit in m, and by what it says of its own uncertainty.

    ``refit``: find the base anew and judge with it, as after the instrument was moved; ``refit_tool``: find the tool
    anew, as after another one was mounted. If the table does not state the instrument's noise, that of the calibration
    is used.

    Raises JobError for a limit out of range; MeasurementError when the machine's uncertainty is not known, when a tool
    was not identified, when a joint term needs a condition that the rows do not have, when orientations are judged by a
    calibration without any, or when base or tool are to be found anew from fewer than three rows or from rows that do
    not determine them; RobotError when a loop does not close.

        found = calib.verify(machine, data, limit=0.3e-3, refit_tool=True)
        found.passed, found.anew["tool"].tool_moved  # whether; in m and rad
    """
    if limit is not None:
        refuse_beyond(limit, "sigma", "limit")
    if data.kind not in ("position", "pose"):
        raise MeasurementError(f"{data.where}: a machine is verified by positions or poses, and not by {data.kind}.")
    if not len(data):
        raise MeasurementError(f"{data.where}: has no rows to verify by.")
    data = _of_this_machine(machine, data)
    if machine.residual_model is not None:  # of the same rows it is asked with every base and tool
        machine = replace(machine, residual_model=Remembered(machine.residual_model))
    refuse_lacking(machine.robot, data.conditions, data.where, _IN_ORDER)
    sigma = _sigma(machine, data)
    data.tips(machine.robot, machine.deviations)  # refuses rows whose loops do not close
    as_calibrated = _judged(machine, data, sigma, None)
    wanted: Anew | None = ("both" if refit_tool else "base") if refit else "tool" if refit_tool else None
    anew: dict[Anew, FoundAnew] = {}
    for what in WAYS:
        if (why := not_shown(machine, data, what)) is None:
            anew[what] = _found_anew(machine, data, sigma, what, changed=not as_calibrated.test.passed)
        elif what == wanted:
            raise MeasurementError(f"{data.where}: {why}.")
    return Verification(as_calibrated, anew, limit, wanted)


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
            # Of photographs or gauges alone: `calib verify` takes none of them.
            remedy = "verify by positions" if k else 'judge it in its job, by a table with use = "validate"'
            raise MeasurementError(f"{data.where}: the calibration was made without any {quantity}; {remedy}.")
        if not (part > _LEAST_NOISE).all():
            raise MeasurementError(
                f"{data.where}: neither the rows nor uncertainty.json of the calibration state any noise of a "
                f"{quantity}; give the standard deviation of the instrument."
            )
    return sigma


def _found_anew(
    machine: CalibratedMachine, data: Measurements, sigma: Array, what: Anew, *, changed: bool
) -> FoundAnew:
    """Return the judgement with frames found anew; ``changed``: whether the machine as calibrated does not explain."""
    found = realigned(machine, data, what)
    judgement, alike = _judged(found, data, sigma, what), None
    if changed and judgement.test.passed and what != "both":
        with one_thread():
            whitened = _whitening(found, data, sigma)
            alike = offset_alike(
                machine, found, data, what, lambda J: whitened((J / sigma[:, :, None]).reshape(sigma.size, -1))
            )
    return FoundAnew(judgement, *motion(machine, found, data, what), alike)


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


def _judged(machine: CalibratedMachine, data: Measurements, sigma: Array, what: Anew | None) -> Judgement:
    """Judge the rows by a machine of which ``what`` was found anew from them."""
    r = machine.residuals(data)
    with one_thread():
        whitened = _whitening(machine, data, sigma)
        w, n = whitened((r / sigma).ravel()), r.size
        if what is not None:
            B = whitened((frame_columns(machine, data, what) / sigma[:, :, None]).reshape(sigma.size, -1))
            moved, _, rank, _ = np.linalg.lstsq(B, w)
            w, n = w - B @ moved, n - int(rank)
        T = float(w @ w)
    return Judgement(
        dict(metrics([(data.kind, r)])),
        read_only(r),
        ChiSquare(T, n, float(exceeded(T, n, row_freedom(machine, data).min()))),
    )
