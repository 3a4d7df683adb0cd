"""The folder of results: it stands alone, appears whole, and never takes the place of anything but older results."""

import csv
import io
import json
import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import calib
from calib.compensation.model_file import MODEL_FILE, NOMINAL_FILE, PoseEntry, model_json
from calib.compensation.urdf import calibrated_urdf
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.foundations.files import recover_folder, replace_folder
from calib.identification.fit import Fit
from calib.job.run import Inputs, Outcome, Progress, resolved
from calib.measurement.measurements import Measurements
from calib.presentation.scene import Scene, render_scene

RESULT_FILE = "result.json"
CALIBRATED_FILE = "calibrated.urdf"
_LIBRARIES = ("pin", "numpy", "scipy", "meshcat", "yourdfpy")


def refuse_folder(out: Path, inputs: Inputs) -> None:
    """Raise OutputError when results may not be written to a folder: it holds an input, or things that are not ours."""
    out = out.resolve()
    for file in inputs.files:
        if out in file.resolve().parents:
            raise OutputError(f"{out}: holds the input {file.name!r}, which results never replace; choose another.")
    recover_folder(out)
    if out.is_dir() and any(out.iterdir()) and not (out / RESULT_FILE).is_file():
        raise OutputError(f"{out}: is not empty and holds no results of this tool; choose another folder.")


def write_results(outcome: Outcome, out: Path, progress: Progress = lambda _: None) -> None:
    """Write the folder of results; on any error it stays as it was."""
    refuse_folder(out, outcome.inputs)
    fit, robot = outcome.fit, outcome.inputs.robot
    progress("writing the calibrated URDF")
    calibrated = calibrated_urdf(robot, fit.machine.deviations)
    progress("drawing the scene")
    scene = render_scene(_scene(outcome, calibrated))
    files: dict[str, bytes | str] = {
        CALIBRATED_FILE: calibrated,
        NOMINAL_FILE: robot.urdf.source,
        "job.json": resolved(outcome.inputs),
        MODEL_FILE: model_json(fit),
        RESULT_FILE: json.dumps(result(outcome), indent=2, allow_nan=False) + "\n",
        "residuals.csv": residual_table(outcome),
        "scene.html": scene,
    }
    progress("writing the results")
    with replace_folder(out) as folder:
        for name, contents in files.items():
            (folder / name).write_bytes(contents.encode() if isinstance(contents, str) else contents)


def result(outcome: Outcome) -> dict[str, Any]:
    """Return ``result.json``, schema 1: plain data, lengths in m and angles in rad."""
    fit = outcome.fit
    return {
        "schema": 1,
        "trusted": not outcome.doubts,
        "doubts": list(outcome.doubts),
        "findings": [finding.sentence for finding in outcome.inputs.findings],
        "metrics": {
            use: {
                when: {
                    quantity: {"unit": m.unit, "n": m.n, "mean": m.mean, "rms": m.rms, "p95": m.p95, "max": m.max}
                    for quantity, m in by_quantity.items()
                }
                for when, by_quantity in by_when.items()
            }
            for use, by_when in outcome.metrics.items()
        },
        "rank": fit.rank,
        "usable_rank": fit.usable_rank,
        "blind": {
            "policy": fit.policy,
            "held": [parameter.name for parameter in fit.held],
            "directions": [
                {"parameter": direction.parameter, "shares": direction.shares, "sentence": str(direction)}
                for direction in fit.blind_directions
            ],
        },
        "parameters": fit.records(),
        "covariance": fit.covariance.tolist(),
        "singular_values": fit.singular_values.tolist(),
        "noise": [
            {
                "measurements": fit.measurements[noise.measurements].where,
                "quantity": noise.quantity,
                "instrument": noise.instrument,
                "model": noise.model,
                "degrees_of_freedom": noise.degrees_of_freedom,
                "chi_square": None if np.isnan(noise.chi_square) else noise.chi_square,
            }
            for noise in fit.noise
        ],
        "base": PoseEntry.of(fit.machine.frames.base).model_dump(),
        "tools": {
            name: PoseEntry.of(tool).model_dump()
            for name, tool in zip(fit.measurements[0].tools, fit.machine.frames.tools, strict=True)
        },
        "solver": {"converged": fit.converged, "evaluations": fit.evaluations, "last_step": fit.step},
        "versions": {
            "calib": calib.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _LIBRARIES},
        },
        "inputs": dict(outcome.inputs.hashes),
    }


def residual_table(outcome: Outcome) -> str:
    """Return ``residuals.csv``: measured minus predicted of every row, before and after, in mm and degrees."""
    fit = outcome.fit
    sets = [
        *(("identification", *row) for row in zip(fit.measurements, fit.nominal_residuals, fit.residuals, strict=True)),
        *(
            ("validation", data, *pair)
            for data, pair in zip(outcome.inputs.validate, outcome.validation_residuals, strict=True)
        ),
    ]
    whens = ("before", "after")
    columns = [f"{when}_{axis} [mm]" for when in whens for axis in "xyz"]
    columns += [f"{when}_{axis} [deg]" for when in whens for axis in ("rx", "ry", "rz")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["use", "file", "line", "point", *columns])
    for use, data, before, after in sets:
        writer.writerows(_residual_rows(use, data, before, after))
    return text.getvalue()


def _residual_rows(use: str, data: Measurements, before: Array, after: Array) -> Iterator[list[str]]:
    for n, line in enumerate(data.lines):
        lengths = [f"{value * 1e3:.6f}" for r in (before, after) for value in r[n, :3]]
        angles = [f"{np.degrees(value):.7f}" for r in (before, after) for value in r[n, 3:]] or [""] * 6
        yield [use, Path(data.where).name, str(line), data.tools[data.tool[n]], *lengths, *angles]


def _scene(outcome: Outcome, calibrated: bytes) -> Scene:
    fit, robot = outcome.fit, outcome.inputs.robot
    sets: Sequence[Measurements] = (*fit.measurements, *outcome.inputs.validate)
    before = [*fit.nominal_residuals, *(b for b, _ in outcome.validation_residuals)]
    after = [*fit.residuals, *(a for _, a in outcome.validation_residuals)]
    measured = np.concatenate([data.position for data in sets])
    shown = fit.measurements[0].readings[:1]
    tip = fit.machine.frames.base @ robot.tips(shown, fit.machine.deviations)[0]
    return Scene(
        title=f"{robot.urdf.name or robot.urdf.where}: calibration",
        urdf=calibrated,
        mesh_roots=outcome.inputs.mesh_roots,
        joint_positions=dict(zip((reading.name for reading in robot.readings), map(float, shown[0]), strict=True)),
        T_world_base=fit.machine.frames.base @ _base_in_root(fit),
        tool_points={
            name: (tip @ tool)[:3, 3]
            for name, tool in zip(fit.measurements[0].tools, fit.machine.frames.tools, strict=True)
        },
        tip=robot.tip,
        measured=measured,
        before=measured - np.concatenate([r[:, :3] for r in before]),
        after=measured - np.concatenate([r[:, :3] for r in after]),
    )


def _base_in_root(fit: Fit) -> Array:
    """Return the root link of the URDF in the arm's base link, joints between them at zero."""
    robot = fit.model.robot
    if robot.base == robot.urdf.root:
        return np.eye(4)
    T = np.eye(4)
    link = robot.base
    while link != robot.urdf.root:
        joint = robot.urdf.parent_joint(link)
        assert joint is not None, "every link but the root has a parent"
        T = joint.origin @ T
        link = joint.parent
    return rigid.inverse(T)
