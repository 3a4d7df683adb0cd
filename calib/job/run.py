"""From a job file to a fit: everything is read and checked before anything is solved."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.assessment.metrics import Metrics, metrics
from calib.assessment.trust import doubts
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import read_bytes, sha256
from calib.foundations.units import parse_quantity
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.fit import Fit
from calib.identification.identify import identify, residuals_of
from calib.identification.sanity import signatures
from calib.job.schema import FrameSection, InstrumentSection, Job, MeasurementsSection, read_job
from calib.measurement.checks import Finding, check
from calib.measurement.instruments import LaserTracker
from calib.measurement.measurements import Measurements
from calib.measurement.read import read_measurements
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.sources import examples_folder, resolve

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Everything a job names, read and checked. ``hashes``: SHA-256 of every input file by its name in the job."""

    job: Job
    path: Path
    robot: Robot
    model: ErrorModel
    identify: tuple[Measurements, ...]
    validate: tuple[Measurements, ...]
    model_sigmas: tuple[float | None, ...]
    mesh_roots: tuple[Path, ...]
    findings: tuple[Finding, ...]
    hashes: Mapping[str, str]
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A finished calibration.

    ``metrics[use][when][quantity]``: use is identification or validation, when is before or after.
    ``validation_residuals``: (before, after) for every set held out. ``doubts``: why it should not be trusted.
    """

    inputs: Inputs
    fit: Fit
    validation_residuals: tuple[tuple[Array, Array], ...]
    metrics: Mapping[str, Mapping[str, Mapping[str, Metrics]]]
    doubts: tuple[str, ...]


def load(path: Path, progress: Progress = lambda _: None) -> Inputs:
    """Read a job and all it names. Raises CalibError with one sentence for the first thing that is wrong.

    Doubtful but usable things are returned as findings.
    """
    progress("reading the job")
    job = read_job(path)
    folder = path.parent
    urdf = resolve(job.robot.urdf) if job.robot.urdf.startswith("example:") else folder / job.robot.urdf
    robot = load_robot(urdf, job.robot.tip, job.robot.base)
    model = _model(job, robot)
    progress("reading the measurements")
    sets = [_measurements(section, job, robot, folder) for section in job.measurements]
    findings = [finding for data in sets for finding in check(data, robot.readings, robot.reach)]
    _refuse(findings)
    chosen = [data for data, section in zip(sets, job.measurements, strict=True) if section.use == "identify"]
    progress("looking for typical mistakes")
    findings += signatures(model, chosen)
    _refuse(findings)
    files = (path, urdf, *(folder / section.file for section in job.measurements))
    names = (path.name, job.robot.urdf, *(section.file for section in job.measurements))
    return Inputs(
        job,
        path,
        robot,
        model,
        tuple(chosen),
        tuple(data for data, section in zip(sets, job.measurements, strict=True) if section.use == "validate"),
        tuple(sigma for section in job.measurements if section.use == "identify" for sigma in _model_sigmas(section)),
        (
            urdf.parent,
            *(folder / root for root in job.robot.mesh_roots),
            *((examples_folder().parents[1],) if job.robot.urdf.startswith("example:") else ()),
        ),
        tuple(findings),
        {name: sha256(read_bytes(file, JobError)) for name, file in zip(names, files, strict=True)},
        files,
    )


def run(inputs: Inputs, progress: Progress = lambda _: None) -> Outcome:
    """Identify, and judge by the data held out."""
    progress("identifying")
    fit = identify(inputs.model, inputs.identify, blind=inputs.job.error_model.blind, model_sigmas=inputs.model_sigmas)
    progress("validating")
    before = residuals_of(fit, inputs.validate, fit.nominal)
    after = residuals_of(fit, inputs.validate, fit.machine)
    figures = {"identification": {"before": metrics(fit.nominal_residuals), "after": metrics(fit.residuals)}}
    if inputs.validate:
        figures["validation"] = {"before": metrics(before), "after": metrics(after)}
    judged = figures["validation" if inputs.validate else "identification"]
    return Outcome(
        inputs,
        fit,
        tuple(zip(before, after, strict=True)),
        figures,
        doubts(fit, judged["before"], judged["after"], held_out=bool(inputs.validate)),
    )


def resolved(inputs: Inputs) -> str:
    """Return the job with every default written out, as JSON."""
    return json.dumps(inputs.job.model_dump(by_alias=True), indent=2) + "\n"


def _refuse(findings: list[Finding]) -> None:
    for finding in findings:
        if finding.severity == "error":
            raise MeasurementError(finding.sentence)


def _model(job: Job, robot: Robot) -> ErrorModel:
    section = job.error_model
    if job.base is not None and section.base != "fixed":
        raise JobError('base: a pose is given, and the error model leaves the base free; write base = "fixed" there.')
    if job.tools and section.tool != "fixed":
        raise JobError('tools: poses are given, and the error model leaves the tool free; write tool = "fixed" there.')
    prior = section.prior
    return error_model(
        robot,
        offsets=section.offsets,
        placements=section.placements,
        base=section.base,
        tool=section.tool,
        prior_length=None if prior.length is None else parse_quantity(prior.length, "length", "prior.length"),
        prior_angle=None if prior.angle is None else parse_quantity(prior.angle, "angle", "prior.angle"),
        base_pose=None if job.base is None else _placement(job.base),
        tool_poses={name: _placement(tool) for name, tool in job.tools.items()},
    )


def _placement(frame: FrameSection) -> Array:
    position = np.array([parse_quantity(text, "length", "position") for text in frame.position])
    quaternion = np.array(frame.quaternion)
    if abs(np.linalg.norm(quaternion) - 1.0) > 1e-3:
        raise JobError(f"quaternion: {frame.quaternion} has norm {np.linalg.norm(quaternion):.6g}, and must have 1.")
    return rigid.placement(rigid.rotation_of_quaternion(quaternion), position)


def _measurements(section: MeasurementsSection, job: Job, robot: Robot, folder: Path) -> Measurements:
    where = f"measurements {section.file!r}"
    return read_measurements(
        folder / section.file,
        robot,
        section.observes,
        sigma=None if section.sigma is None else parse_quantity(section.sigma, "length", where),
        sigma_angle=None if section.sigma_angle is None else parse_quantity(section.sigma_angle, "angle", where),
        instrument=None if section.instrument is None else _instrument(job.instruments[section.instrument]),
        columns=section.columns,
    )


def _instrument(section: InstrumentSection) -> LaserTracker:
    x, y, z = (parse_quantity(text, "length", "station") for text in section.station)
    return LaserTracker(
        parse_quantity(section.sigma, "length", "sigma"),
        parse_quantity(section.sigma_per_metre, "length", "sigma_per_metre"),
        (x, y, z),
    )


def _model_sigmas(section: MeasurementsSection) -> tuple[float | None, ...]:
    position = None if section.model_sigma is None else parse_quantity(section.model_sigma, "length", "model_sigma")
    if section.observes == "position":
        return (position,)
    angle = section.model_sigma_angle
    return position, None if angle is None else parse_quantity(angle, "angle", "model_sigma_angle")
