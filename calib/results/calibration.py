"""A fit, judged: its machine, its errors before and after, whether it may be trusted, which rows lie off."""

import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.assessment.blame import Blame
from calib.assessment.checking import looks_wrong
from calib.assessment.checks.of_arm import wrong_lens
from calib.assessment.judged import Accepted, Check, JudgedSet, Use
from calib.assessment.metrics import Metrics, metrics
from calib.assessment.outliers import Outliers, outliers
from calib.assessment.own_base import tables_with_own_base
from calib.assessment.trust import remarks, verdict, with_cause
from calib.foundations.arguments import checked
from calib.foundations.brief import brief
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import DISPLAY, MM
from calib.foundations.version import __version__
from calib.identification.fit import Fit
from calib.identification.identify import at_clocks, residuals_of
from calib.identification.total_differential import Trace
from calib.machine.calibrated import CalibratedMachine
from calib.machine.in_urdf import fit_in_urdf, machine_in_urdf
from calib.machine.of_fit import machine_of
from calib.machine.residual_model import ResidualModel
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements

if TYPE_CHECKING:
    from calib.assessment.choice import Choice
    from calib.identification.optics_choice import OpticsChoice


@dataclass(frozen=True, slots=True)
class LevelReport:
    """What one level has brought: metrics by quantity of the held-out data, base and tool fitted anew.

    Of the data to identify from, where nothing is held out. ``free``: number of parameters; ``rank``: of those seen.
    """

    name: str
    free: int
    rank: int
    metrics: Mapping[str, Metrics]


@dataclass(frozen=True, slots=True, eq=False)
class InUrdf:
    """The best fit that a URDF holds, base and tool fitted with it, and its metrics by use and quantity.

    ``metrics`` is empty where joints of the URDF take other readings, so that nothing can be said of it alone.
    """

    __repr__ = brief

    fit: Fit
    metrics: Mapping[str, Mapping[str, Metrics]]


def judged_in_urdf(
    fit: Fit, own: Sequence[Measurements], uses: Sequence[tuple[str, Sequence[Measurements]]]
) -> InUrdf | None:
    """Return what the URDF of a fit reaches on the tables of each use; None where it holds the whole machine.

    ``own``: the tables to identify from.
    """
    alone = fit_in_urdf(fit, own)
    if alone is None and not (fit.robot.loops or fit.robot.couplings):
        return None
    found = fit if alone is None else alone
    if found.robot.loops or found.robot.couplings:
        return InUrdf(found, {})
    return InUrdf(
        found,
        {
            use: metrics((data.kind, r) for data, r in zip(some, residuals_of(found, some, found.machine), strict=True))
            for use, some in uses
        },
    )


@dataclass(frozen=True, slots=True)
class Origin:
    """What a calibration was made by and from: a command, its settings as JSON, files, and their SHA-256 by name.

    ``about``: what its job says of date, serial number, operator and the like, in words by name.
    """

    command: str = ""
    settings: str = ""
    files: tuple[Path, ...] = ()
    hashes: Mapping[str, str] = field(default_factory=dict)
    mesh_roots: tuple[Path, ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)


FROM_PYTHON = Origin()
_LIBRARIES = ("pin", "numpy", "scipy", "meshcat", "trimesh")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
@sealed
class Calibration:
    """A judged calibration. Made by :func:`assess`.

    ``machine``: the calibrated machine of ``fit``. ``metrics[use][when][quantity]``: use is identification or
    validation, when is before or after. ``sets``: residuals of every table; those after calibration are of ``machine``,
    with its residual model where that has values. ``doubts``: why the calibration should not be trusted; ``checks``:
    all checks of the verdict; ``shown``: for which range the verdict holds, and what would make it more certain.
    ``suggested``: joint terms that nobody asked for and that make errors of rows held out clearly smaller.
    ``findings``: what looks wrong in the data, but is usable. ``outliers``: of the data to identify from. ``in_urdf``:
    the metrics of the calibrated URDF alone, if it cannot hold the machine because of closed loops or joint terms.
    ``levels``, ``trace`` and ``choice``: the steps before the fit. ``origin``: from what it was made.
    Of a job with boards, ``optics``: how many numbers lenses and boards have, and why; ``blame``: what lens, print, arm
    and corners explain.
    """

    fit: Fit
    machine: CalibratedMachine
    sets: tuple[JudgedSet, ...]
    metrics: Mapping[str, Mapping[str, Mapping[str, Metrics]]]
    doubts: tuple[str, ...]
    findings: tuple[Finding, ...]
    outliers: Outliers
    in_urdf: InUrdf | None
    levels: tuple[LevelReport, ...] = ()
    trace: Trace | None = None
    choice: "Choice | None" = None
    origin: Origin = FROM_PYTHON
    checks: tuple[Check, ...] = ()
    shown: tuple[str, ...] = ()
    suggested: tuple[str, ...] = ()
    optics: "tuple[OpticsChoice, ...]" = ()
    blame: Blame | None = None

    @property
    def trusted(self) -> bool:
        """Whether there is no reason not to use it."""
        return not self.doubts

    @property
    def judged_by(self) -> Mapping[str, Mapping[str, Metrics]]:
        """The metrics of the verdict, by when and quantity: of the held-out data, else of the data to identify from."""
        return self.metrics["validation" if "validation" in self.metrics else "identification"]

    @checked
    def accepting(self, names: Collection[Accepted]) -> "Calibration":
        """Return the calibration with some checks of the verdict accepted by the user, so that they count as passed."""
        if not names:
            return self
        now = [
            (check, check.answered() if check.name in names and not check.passed else check) for check in self.checks
        ]
        gone = {old.sentence for old, new in now if new.passed}
        doubts = tuple(doubt for doubt in self.doubts if doubt not in gone)
        return replace(self, doubts=doubts, checks=tuple(new for _, new in now))

    @checked
    def blaming(self, blame: Blame | None) -> "Calibration":
        """Return the calibration with what photographs held out say of causes, which may contradict a given lens."""
        if blame is None or not blame.lens_is_wrong:
            return replace(self, blame=blame)
        new = wrong_lens(blame)
        old = next(check for check in self.checks if check.name == new.name)
        doubts = (*(doubt for doubt in self.doubts if doubt != old.sentence), new.sentence)
        checks = tuple(new if check is old else check for check in self.checks)
        return replace(self, blame=blame, doubts=doubts, checks=checks)

    def __repr__(self) -> str:
        by = "held out" if "validation" in self.metrics else "identified from"
        errors = ", ".join(
            f"{quantity} {_shown(self.judged_by['before'][quantity])} -> {_shown(now)} rms"
            for quantity, now in self.judged_by["after"].items()
        )
        said = "to be trusted" if self.trusted else "not to be trusted: " + " ".join(self.doubts)
        return f"<Calibration, {said}; {errors}, by data {by}>"


def _shown(found: Metrics) -> str:
    factor, unit = DISPLAY[found.unit]
    return f"{found.rms * factor:.4g} {unit}"


@checked
def assess(
    fit: Fit,
    held_out: Measurements | Sequence[Measurements] = (),
    *,
    data: Sequence[Measurements] | None = None,
    residual_model: ResidualModel | None = None,
    names: Sequence[str] | None = None,
    findings: Sequence[Finding] | None = None,
    trace: Trace | None = None,
    origin: Origin = FROM_PYTHON,
) -> Calibration:
    """Judge a fit by its own data, and by measurements that were held out of it.

        found = calib.assess(fit, held_out)
        found.metrics["validation"]["after"]["position"].rms  # m

    ``data``: all tables to identify from, if the fit is a level that used only some of them. ``residual_model``: what
    the machine adds to positions. ``names``: names of the tables, first those to identify from; by default where they
    come from. ``findings``: what looks wrong in the data; when None, it is found here. ``trace``: that of the total
    differential that led to the fit.

    Tools, set-ups and targets that held-out data alone have are found from these rows, with the calibrated machine.
    Raises MeasurementError when held-out data have no rows, or no more of a tool or set-up than find it.
    """
    validation = (held_out,) if isinstance(held_out, Measurements) else tuple(held_out)
    own = fit.measurements if data is None else tuple(data)
    if not own:
        raise MeasurementError("data: there are no tables to judge the fit by.")
    for table in (*own, *validation):
        if not len(table):
            raise MeasurementError(f"{table.where}: has no rows to judge by.")
    tables = at_clocks(fit, (*own, *validation))
    own, validation = tables[: len(own)], tables[len(own) :]
    given = tuple(names) if names is not None else tuple(table.where for table in tables)
    if len(given) != len(tables):
        raise MeasurementError(f"{len(given)} names are given for {len(tables)} tables.")
    machine = machine_of(fit, residual_model)
    uses: list[tuple[Use, tuple[Measurements, ...]]] = [("identification", own)]
    if validation:
        uses.append(("validation", validation))
    in_urdf = judged_in_urdf(fit, own, uses)
    if in_urdf is not None and in_urdf.fit is not fit:
        machine = replace(machine, in_urdf=machine_in_urdf(in_urdf.fit, machine))
    sets, without_model = list[JudgedSet](), list[JudgedSet]()
    for use, some in uses:
        before, after = residuals_of(fit, some, fit.nominal), residuals_of(fit, some, fit.machine)
        for table, b, a in zip(some, before, after, strict=True):
            left = a if table.position is None else machine.less_shifts(a, table)
            without_model.append(JudgedSet(use, given[len(sets)], table, b, a))
            sets.append(without_model[-1]._replace(after=left))
    figures: dict[str, Mapping[str, Mapping[str, Metrics]]] = {
        use: {
            "before": metrics((judged.data.kind, judged.before) for judged in sets if judged.use == use),
            "after": metrics((judged.data.kind, judged.after) for judged in sets if judged.use == use),
        }
        for use, _ in uses
    }
    stopped = () if trace is None or trace.reason == "below the limit" else (_not_stopped(trace),)
    findings = looks_wrong(fit.model, own) if findings is None else findings
    told = any(finding.code == "not-held-out" for finding in findings)
    findings = (*findings, *([] if told else _not_held_out(own, validation)), *_off_least_squares(fit))
    files = {table.where: name for name, table in zip(given, own, strict=False)}
    found = outliers(fit, files=files)
    # A residual model of nodes that were measured from elsewhere moves the predictions of all other tables.
    moved = tables_with_own_base(fit.model, replace(machine, residual_model=None), without_model)
    # Sentences call tables what the calibration calls them, and not what they are called on this computer.
    called = replace(
        fit, measurements=tuple(replace(data, where=files.get(data.where, data.where)) for data in fit.measurements)
    )
    judged_sets = [judged._replace(data=replace(judged.data, where=judged.file)) for judged in sets]
    judged_fit = verdict(called, machine, judged_sets, found, findings, moved)
    if residual_model is None and trace is None:
        judged_fit = with_cause(judged_fit, called, judged_sets)
    return Calibration(
        fit,
        machine,
        tuple(sets),
        figures,
        (*stopped, *judged_fit.doubts),
        (*findings, *remarks(fit), *(Finding.warning("own-base", one.sentence) for one in moved if not one.wide)),
        found,
        in_urdf,
        trace=trace,
        origin=origin,
        checks=judged_fit.checks,
        shown=judged_fit.shown,
    )


def _not_held_out(own: Sequence[Measurements], validation: Sequence[Measurements]) -> list[Finding]:
    """Find tables that the model is both fitted to and judged by."""
    return [
        Finding.warning(
            "not-held-out",
            f"{table.where}: the model is fitted to these rows as well; as a validation it proves nothing.",
        )
        for table in validation
        if any(
            table.kind == other.kind
            and np.array_equal(table.readings, other.readings)
            and np.array_equal(table.value, other.value)
            and (table.position is None or np.array_equal(table.position, np.asarray(other.position)))
            for other in own
        )
    ]


def _off_least_squares(fit: Fit) -> list[Finding]:
    """Find values that another way than least squares has left farther off than noise puts them."""
    if fit.off is None:
        return []
    noise = np.sqrt(fit.spread_alone.variances)
    shares = np.divide(np.abs(fit.off), noise, out=np.zeros_like(noise), where=~fit.unidentifiable & (noise > 0.0))
    k = int(np.argmax(shares))
    if shares[k] < 1.0:
        return []
    return [
        Finding.warning(
            "off-least-squares",
            f"The total differential leaves {fit.parameters[k].name!r} {shares[k]:.2g} standard deviations of its "
            "noise off the least-squares solution: what looks wrong in the residuals may come from that, and the "
            "stated uncertainty includes it. A smaller solver.stop and a finer solver.rounding leave less, and "
            'solver.kind = "least_squares" leaves nothing.',
        )
    ]


def _not_stopped(trace: Trace) -> str:
    largest = trace.iterations[-1].largest / MM
    return f"The total differential ended because {trace.reason}, with a largest error of {largest:.3g} mm."


def versions() -> dict[str, str | None]:
    """Return the versions of this package, of Python and of the libraries that matter; None where one is not known."""
    return {
        "calib": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _LIBRARIES},
    }


@cache
def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:  # conda and system packages know it by another name
        return None
