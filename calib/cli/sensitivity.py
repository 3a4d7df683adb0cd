"""``calib sensitivity``: how far every parameter moves the tip."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from calib.cli.application import IN_WORDS, PREPARE, Telling, command
from calib.cli.options import JobFile, option, written
from calib.foundations.files import is_there
from calib_start import loading

if TYPE_CHECKING:
    from calib.assessment.sensitivity import GroupStudy, Sensitivity
    from calib.foundations.arrays import Array
    from calib.identification.error_model import ErrorModel
    from calib.job.inputs import Inputs

_ERRORS = "Results of calib calibrate on this job, or assumed errors (CSV: parameter, error)."


@command("sensitivity", PREPARE, "calib sensitivity calibration.toml --plot sensitivity.svg")
def sensitivity(
    job: JobFile,
    errors: Annotated[Path | None, option("--errors", "FOLDER|FILE", _ERRORS)] = None,
    plot: Annotated[Path | None, written("FILE", "Also draw it, as .svg, .png or .pdf.", "--plot")] = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Show how much every free parameter of a job moves the tip.

    At the poses of the job's measurements, for 1 mm or 1 mrad of each parameter. With --errors also how the tip error
    changes if one kind of errors, identified or assumed, is ten times as large, or a tenth.
    """
    with loading():
        import numpy as np

        from calib.assessment.sensitivity import sensitivity as sensitivity_of
        from calib.foundations.files import refuse_taken
        from calib.job.inputs import STEPS_OF_LOADING, load
        from calib.presentation.command_tables import group_sheet, sensitivity_sentence, sensitivity_sheet
        from calib.presentation.tables import null_space_lines
    refuse_taken(plot)
    with telling.progress(STEPS_OF_LOADING + 1) as say:
        inputs = load(job, say)
        say("differentiating")
        readings = np.concatenate([end.readings for data in inputs.identify for end in data.ends])
        model = inputs.model if errors is None else _model(inputs, errors)
        found = sensitivity_of(model, readings)
        study = None if errors is None else _study(model, readings, errors)
    if plot is not None:
        _draw(found, plot)
    telling.tell(
        lambda: {"parameters": found.records(), "groups": [] if study is None else study.records()},
        lambda: [
            sensitivity_sheet(found),
            sensitivity_sentence(found),
            *null_space_lines(found.undetermined),
            *([] if study is None else [group_sheet(study)]),
        ],
    )


def _model(inputs: "Inputs", errors: Path) -> "ErrorModel":
    """Return the error model of a job, with the terms of its results where the job left these open."""
    if _assumed(errors):
        return inputs.model
    with loading():
        from calib.assessment.drift import other_machine
        from calib.foundations.errors import JobError
        from calib.identification.error_model import with_terms
        from calib.machine.model_file import load_machine
    model, calibrated = inputs.model, load_machine(errors).robot
    if differs := other_machine(model.urdf_robot, calibrated):
        raise JobError(f"{errors}: is no result of this job: {differs}.")
    return with_terms(model, calibrated.terms) if inputs.job.error_model.terms == "auto" else model


def _study(model: "ErrorModel", readings: "Array", errors: Path) -> "GroupStudy":
    with loading():
        from calib.assessment.sensitivity import group_study
        from calib.foundations.errors import JobError, naming
        from calib.job.assumed_errors import read_errors
        from calib.results.result_file import robot_errors
    given = read_errors(errors, model) if _assumed(errors) else robot_errors(errors)
    with naming(f"{errors}: is no result of this job", JobError):
        return group_study(model, readings, given)


def _assumed(errors: Path) -> bool:
    """Return whether assumed errors are given: a file, whatever its name; results are a folder."""
    return errors.suffix.lower() == ".csv" or is_there(errors, Path.is_file)


def _draw(found: "Sensitivity", plot: Path) -> None:
    with loading():
        import logging

        from calib.foundations.files import write_new
        from calib.presentation.plots import figure_bytes, load_matplotlib, sensitivity_figure
    # matplotlib refuses to load for a window that it does not know, though none is opened, and tells of its cache.
    os.environ.pop("MPLBACKEND", None)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    load_matplotlib()
    write_new(plot, figure_bytes(sensitivity_figure(found), plot))
