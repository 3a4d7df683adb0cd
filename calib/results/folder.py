"""The folder of results: it stands alone, appears whole, and never takes the place of anything but older results."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.assessment.advice import advice
from calib.assessment.hand_eye import hand_eyes
from calib.assessment.metrics import Metrics
from calib.assessment.outliers import Outliers
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.csv_text import csv_text
from calib.foundations.errors import JobError, OutputError, RobotError
from calib.foundations.files import LARGEST_JSON, read_bytes, sentences
from calib.foundations.folders import (
    reading_folder,
    real_folder,
    refuse_kept,
    refuse_unwritable,
    still_meant,
    write_folder,
)
from calib.foundations.json_text import NotJsonError, document, parse_json
from calib.foundations.units import DEG, MM
from calib.identification.error_model import corrected_dh
from calib.identification.fit import Fit
from calib.machine.calibrated import CalibratedMachine
from calib.machine.model_file import (
    CALIBRATED_FILE,
    GAUSSIAN_FILE,
    GEOMETRY_FILE,
    GRID_FILE,
    NOMINAL_FILE,
    PoseEntry,
    machine_files,
    run_of,
)
from calib.machine.run import MODEL_FILE
from calib.machine.uncertainty_file import UNCERTAINTY_FILE
from calib.measurement.kinds import Kind, size
from calib.presentation.hand_eye import camera_info, static_transform, urdf_joint
from calib.presentation.inline import Page
from calib.presentation.machine_scene import machine_scene
from calib.presentation.report.document import Report
from calib.presentation.report.markdown import render_markdown
from calib.presentation.report.page import render_page
from calib.presentation.scene import render_scene
from calib.results.calibration import Calibration, InUrdf, assess, versions
from calib.results.report import report_of
from calib.results.result_file import RESULT_FILE
from calib.results.scene import scene_of
from calib.robot.dh.files import write_dh
from calib.robot.sources import usual_mesh_roots

JOB_FILE = "job.json"
RESIDUAL_FILE = "residuals.csv"
SCENE_FILE = "scene.html"
REPORT_FILE = "report.html"
MARKDOWN_FILE = "report.md"
DH_FILE = "calibrated_dh.csv"
ALWAYS = (CALIBRATED_FILE, NOMINAL_FILE, JOB_FILE, MODEL_FILE, RESULT_FILE, RESIDUAL_FILE, UNCERTAINTY_FILE)
TO_BE_SEEN = (REPORT_FILE, MARKDOWN_FILE, SCENE_FILE)
_RESULTS = (*ALWAYS, *TO_BE_SEEN, DH_FILE, GEOMETRY_FILE, GRID_FILE, GAUSSIAN_FILE)
_OF_POSES = ("x [mm]", "y [mm]", "z [mm]", "rx [deg]", "ry [deg]", "rz [deg]")
_OF_LENGTHS = ("error [mm]",)
_OF_PIXELS = ("u [px]", "v [px]")
_RESIDUAL_COLUMNS = (_OF_POSES, _OF_LENGTHS, _OF_PIXELS)
_MOST_WORST = 10
# What a file manager leaves behind when somebody looks at a folder.
_LEFT_BEHIND = (".DS_Store",)
STEPS_OF_WRITING = 4


def refuse_folder(out: Path, inputs: Sequence[Path] = ()) -> Path:
    """Raise OutputError when results cannot or may not be written to a folder, before any work is done for them.

    ``inputs``: files that are never replaced. Returns the folder that is meant where ``out`` is a link to one.
    """
    out = real_folder(out)
    with sentences(out, OutputError, "cannot hold the results"):
        for file in inputs:
            if _leads_through(file.resolve(), out):
                raise OutputError(f"{out}: holds the input {file.name!r}, which results never replace; choose another.")
        if _leads_through(Path.cwd(), out):
            raise OutputError(f"{out}: is the current folder or holds it, and is replaced as a whole; choose another.")
        refuse_unwritable(out)
        refuse_kept(out)
        _refuse_foreign(out)
        if out.is_mount():
            raise OutputError(f"{out}: is a mount point, which cannot be replaced; choose a folder inside.")
    return out


def _leads_through(path: Path, folder: Path) -> bool:
    """Return whether a path is a folder, or in it, also where it calls it otherwise: by a mount, or other capitals."""
    every = (path, *path.parents)
    return folder in every or (folder.exists() and any(one.exists() and one.samefile(folder) for one in every))


def _refuse_foreign(folder: Path) -> None:
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    entries = [entry.name for entry in found]
    known = (*_RESULTS, *_LEFT_BEHIND)
    foreign = [entry.name for entry in found if entry.name not in known or entry.is_symlink() or not entry.is_file()]
    if foreign:
        raise OutputError(
            f"{folder}: holds {foreign[0]!r}, which is no result of this toolkit, and results replace the whole "
            "folder; choose another."
        )
    if entries and not ({RESULT_FILE, MODEL_FILE} <= set(entries) and _is_ours(folder)):
        raise OutputError(f"{folder}: is not empty and holds no whole results of this toolkit; choose another folder.")


def _is_ours(folder: Path) -> bool:
    """Return whether ``model.json`` of a folder is one of this toolkit: others have files of this name, too."""
    try:
        with reading_folder(folder):
            contents = parse_json(read_bytes(folder / MODEL_FILE, OutputError, LARGEST_JSON))
    except NotJsonError:
        return False
    return isinstance(contents, dict) and contents.get("urdf") == NOMINAL_FILE


def write_results(
    found: Calibration, out: Path, progress: Callable[[str], None] = lambda _: None, *, meant: Path | None = None
) -> Report:
    """Write the folder of results, and return its report; on any error the folder stays as it was.

    ``meant``: to what ``out`` led when the work began, by :func:`refuse_folder`. Raises OutputError where it leads
    elsewhere now: that folder was never asked for.
    """
    out = still_meant(out, meant)  # a link stays a link: what it points to is replaced
    refuse_folder(out, found.origin.files)
    progress("writing the calibrated URDF")
    machine = machine_files(found.machine)
    progress("drawing the scene")
    scene = render_scene(scene_of(found))
    progress("writing the report")
    report = report_of(found, (("The scene in 3D", SCENE_FILE),))
    files: dict[str, bytes | str] = {
        **machine,
        RESULT_FILE: result_json(found),
        RESIDUAL_FILE: residual_table(found),
        SCENE_FILE: scene,
        REPORT_FILE: render_page(report),
        MARKDOWN_FILE: render_markdown(report),
        **_dh_table(found.fit if found.in_urdf is None else found.in_urdf.fit),
    }
    if found.origin.settings:
        files[JOB_FILE] = document({**json.loads(found.origin.settings), "run": run_of(found.machine)})
    progress("writing the results")
    write_folder(out, files, (*_RESULTS, *_LEFT_BEHIND))
    return report


@checked
def save(found: Calibration | Fit, folder: str | Path) -> Path:
    """Write a calibration as ``calib calibrate`` does: model, URDF, figures, residuals, report and scene.

        calib.save(calib.assess(fit, held_out), "results")

    A fit is judged by its own data. The folder appears whole, or stays as it was; it may hold older results and nothing
    else. Returns the folder. Raises OutputError with one sentence.
    """
    out = Path(folder)
    write_results(judged(found), out)
    return out


@checked
def report(found: Calibration | Fit) -> Page:
    """Return the report of a calibration as one HTML page that needs no other file; a notebook shows it in place."""
    return Page(render_page(report_of(judged(found))))


@checked
def scene(found: Calibration | Fit | CalibratedMachine) -> Page:
    """Return the 3D scene of a calibration as one HTML page that needs no other file; a notebook shows it in place.

    Meshes are read from ``found.origin.mesh_roots``, and sticks are drawn without them. Of a machine: its joints move
    one after the other, beside the nominal arm; meshes are looked for where its URDF was read.
    """
    if isinstance(found, CalibratedMachine):
        urdf = found.robot.urdf
        return Page(render_scene(machine_scene(found, usual_mesh_roots(urdf.source, urdf.where))))
    return Page(render_scene(scene_of(judged(found))))


def judged(found: Calibration | Fit) -> Calibration:
    """Return a calibration as it is, and a fit judged by its own data."""
    return assess(found) if isinstance(found, Fit) else found


def result_json(found: Calibration) -> str:
    """Return ``result.json`` as text: strict JSON, which knows neither nan nor infinity."""
    return document(result(found))


def result(found: Calibration) -> dict[str, Any]:
    """Return what ``result.json`` holds: plain data, lengths in m and angles in rad, None for what is not known."""
    fit, own, frames = found.fit, found.fit.measurements[0], found.fit.machine.frames
    names = {judged.data.where: judged.file for judged in found.sets}
    files = [names.get(data.where, data.where) for data in fit.measurements]
    contents: dict[str, Any] = {
        "trusted": not found.doubts,
        "doubts": list(found.doubts),
        "checks": [asdict(check) for check in found.checks],
        "shown": [*found.shown, *found.suggested],
        "findings": [finding.sentence for finding in found.findings],
        "metrics": {
            use: {when: _by_quantity(figures) for when, figures in by_when.items()}
            for use, by_when in found.metrics.items()
        },
        "in_urdf": None if found.in_urdf is None else _in_urdf(found.in_urdf),
        "rank": fit.rank,
        "numerical_rank": fit.numerical_rank,
        "null_space": {
            "policy": fit.policy,
            "held": [parameter.name for parameter in fit.held],
            "directions": [
                {"parameter": direction.parameter, "shares": direction.shares, "sentence": str(direction)}
                for direction in fit.null_space
            ],
        },
        "advice": [advised.sentence for advised in advice(fit)],
        "learned_priors": [asdict(prior) for prior in fit.learned],
        "parameters": fit.records(),
        "covariance": fit.told_covariance(fit.told_together).tolist(),
        "singular_values": fit.singular_values.tolist(),
        "noise": [asdict(noise) | {"measurements": files[noise.measurements]} for noise in fit.noise],
        "together": [
            {"measurements": file, "length": own.length, "angle": own.angle, "alone": math.sqrt(own.variance)}
            for file, own in zip(files, fit.together, strict=False)
            if own is not None
        ],
        "repeats": [asdict(own) | {"measurements": files[own.measurements]} for own in fit.repeats],
        "outliers": _worst(found.outliers),
        "base": _pose(frames.base),
        "setups": dict(zip(own.setups, map(_pose, frames.bases), strict=True)),
        "tools": dict(zip(own.tools, map(_pose, frames.tools), strict=True)),
        "targets": dict(zip(own.targets, map(_pose, frames.targets), strict=True)),
        "solver": {
            "converged": fit.converged,
            "evaluations": fit.evaluations,
            "last_step": fit.step,
            "narrowed": fit.narrowed,
        },
        "levels": [
            {"name": level.name, "free": level.free, "rank": level.rank, "metrics": _by_quantity(level.metrics)}
            for level in found.levels
        ],
        "choice": None if found.choice is None else found.choice.records(),
        "all_harmonics": None
        if found.choice is None or found.choice.all_harmonics is None
        else found.choice.all_harmonics.record(),
        "wind_up": None if found.choice is None or found.choice.weighed is None else found.choice.weighed.record(),
        "cameras": {
            one.camera: {
                "on": one.parent,
                "pose": _pose(one.pose),
                "pose_sigmas": {"position": one.pose_sigmas[:3].tolist(), "turn": one.pose_sigmas[3:].tolist()},
                "lens": one.lens._asdict(),
                "sigmas": dict(zip(one.lens._fields, one.sigmas.tolist(), strict=True)),
                "distance": one.distance,
                "rms": {"px": one.pixels, "m": one.across},
                "ros2": static_transform(one),
                "urdf": urdf_joint(one),
                "camera_info": camera_info(one),
            }
            for one in hand_eyes(fit, found.sets)
        },
        "optics": [asdict(one) for one in found.optics],
        "blame": None
        if found.blame is None
        else asdict(found.blame) | {"sentence": found.blame.sentence, "advice": found.blame.advice},
        "trace": None if found.trace is None else {"reason": found.trace.reason, "iterations": found.trace.records()},
        "versions": versions(),
        "inputs": dict(found.origin.hashes),
        "run": run_of(found.machine),
    }
    plain: dict[str, Any] = _strict(contents)
    return plain


def _pose(T: Array) -> dict[str, Any]:
    return PoseEntry.of(T).model_dump()


def _in_urdf(found: InUrdf) -> dict[str, Any]:
    return {
        "converged": found.fit.converged,
        "metrics": {use: _by_quantity(figures) for use, figures in found.metrics.items()},
    }


def _worst(found: Outliers) -> dict[str, Any]:
    """Return the rows, jumps and groups that are least likely, each with whether it is no accident."""
    told = {*map(id, found.outlying), *map(id, found.moved), *map(id, found.disagreeing)}
    return {
        name: [asdict(one) | {"told": id(one) in told} for one in every[:_MOST_WORST]]
        for name, every in (("rows", found.rows), ("jumps", found.jumps), ("groups", found.groups))
    }


def _strict(value: Any) -> Any:
    """Return plain data with None in the place of nan and infinity."""
    if isinstance(value, dict):
        return {key: _strict(v) for key, v in value.items()}
    if isinstance(value, list):
        return list(map(_strict, value))
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _by_quantity(figures: Mapping[str, Metrics]) -> dict[str, dict[str, Any]]:
    return {quantity: asdict(m) for quantity, m in figures.items()}


def residual_table(found: Calibration) -> str:
    """Return ``residuals.csv``: measured minus predicted of every row, before and after, in mm, degrees and pixels.

    A point's error has three components, that of a length, a height or an indicator one, called its ``error``.
    """
    columns = [
        title
        for titles in _RESIDUAL_COLUMNS
        if titles is _OF_POSES or any(_columns_of(judged.data.kind) is titles for judged in found.sets)
        for title in titles
    ]
    whens = ("before", "after")
    # The unit stands last in a title, so that columns of one unit follow one another.
    titles = [f"{when}_{title}" for unit in ("mm", "deg", "px") for when in whens for title in columns if unit in title]
    rows: list[Iterable[object]] = [["use", "file", "line", "tool", *titles]]
    for judged in found.sets:
        data, own = judged.data, _columns_of(judged.data.kind)
        for n, line in enumerate(data.lines):
            row: dict[str, str] = {}
            for when, r in zip(whens, (judged.before, judged.after), strict=True):
                row |= {f"{when}_{title}": _shown(value, title) for title, value in zip(own, r[n], strict=False)}
            errors = (row.get(title, "") for title in titles)
            rows.append([judged.use, judged.file, line, data.tools[data.tool[n]], *errors])
    return csv_text(rows)


def _columns_of(kind: Kind) -> tuple[str, ...]:
    return {1: _OF_LENGTHS, 2: _OF_PIXELS}.get(size(kind), _OF_POSES)


def _shown(value: float, title: str) -> str:
    if "[mm]" in title:
        return f"{value / MM:.6f}"
    return f"{value / DEG:.7f}" if "[deg]" in title else f"{value:.5f}"


def _dh_table(fit: Fit) -> dict[str, str]:
    """Return the corrected DH table, where DH parameters are free and a table can hold the arm."""
    if fit.model.dh is None:
        return {}
    try:
        return {DH_FILE: write_dh(corrected_dh(fit.model, fit.machine.deviations))}
    except (JobError, RobotError):
        return {}
