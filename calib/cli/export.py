"""The command that writes what controllers take."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from calib.cli.options import Json, Quiet, ResultFolder, app
from calib.compensation.controllers import Export, export_dh, export_offsets, export_ros, export_ur
from calib.compensation.model_file import CalibratedModel, load_model
from calib.foundations.errors import CalibError, OutputError
from calib.foundations.files import refuse_taken, write_new
from calib.foundations.folders import reading_folder
from calib.job.results import DH_FILE
from calib.presentation.console import sentence, show, warning, write
from calib.robot import dh

Target = Literal["ur", "offsets", "dh", "ros"]
_EXPORTS: Mapping[Target, Callable[[CalibratedModel], Export]] = {
    "ur": export_ur,
    "offsets": export_offsets,
    "ros": export_ros,
}
_WORSE = (
    "The file alone is worse than no correction: what it leaves out was fitted together with what it holds. For this "
    "controller, calibrate without those parts."
)
_MACHINES: Mapping[Target, str] = {"ros": "the nominal URDF with this file alone"}


@app.command(name="export")
def export_command(
    results: ResultFolder,
    to: Annotated[Target, typer.Option("--to", help="Universal Robots, joint offsets, a DH table, YAML for ROS.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The file, to be written.", readable=False)],
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a calibrated machine as a controller takes it.

    The file is read back and compared before it is written. What it has no place for is named, with what that costs at
    the tip: no such file holds all that model.json does.
    """
    refuse_taken(out)
    with reading_folder(results):
        model = load_model(results)
        corrected = results / DH_FILE
        table = dh.read_dh(corrected) if to == "dh" and corrected.is_file() else None
    try:
        found = export_dh(model, table) if to == "dh" else _EXPORTS[to](model)
    except CalibError as e:
        raise OutputError(f"{results}: cannot be exported to {to}: {e}") from e
    write_new(out, found.text)
    if as_json:
        left = [{"part": part.part, "cost": _known(part.cost)} for part in found.left_out]
        contents = {"schema": 1, "file": str(out), **asdict(found), "left_out": left}
        write(json.dumps({k: v for k, v in contents.items() if k != "text"}, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        where = "within the joints' limits" if model.uncertainty is None else "of the identified range"
        machine = _MACHINES.get(to, "the machine of the file")
        show(
            *(warning(f"{part.part}: not in the file; at the tip {_said(part.cost)}.") for part in found.left_out),
            sentence(
                f"At the tip the nominal machine is {_said(found.before)} from the calibrated one, {machine} "
                f"{_said(found.lost)}, over random poses {where}."
            ),
            *([warning(_WORSE)] if found.lost > found.before else []),
            sentence(f"Read back and compared; the file is {out}."),
        )


def _known(cost: float) -> float | None:
    return None if np.isnan(cost) else cost


def _said(cost: float) -> str:
    return "all, as its readings are others" if np.isnan(cost) else f"{cost * 1e3:.4f} mm rms"
