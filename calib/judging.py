"""How sure, how good, which model: uncertainty, outliers, drift, comparison of models, sensitivity, acceptance."""

from calib.assessment.bootstrap import Bootstrap, bootstrap
from calib.assessment.choice import Choice, choose_terms
from calib.assessment.comparison import JudgedModel, ModelComparison, compare_models, nested_models
from calib.assessment.drift import compare
from calib.assessment.iso9283 import figures as iso9283_figures
from calib.assessment.outliers import outliers
from calib.assessment.performance import Performance, before_and_after
from calib.assessment.sensitivity import (
    GroupStudy,
    Sensitivity,
    error_coefficients,
    exact_error,
    group_study,
    predicted_error,
    sensitivity,
)
from calib.assessment.validation import CrossValidation, HeldOut, cross_validate
from calib.identification.observability import Observability, observability
from calib.identification.total_differential import Trace, total_differential
from calib.job.assumed_errors import read_errors
from calib.machine.identified import not_placed, outside_identified
from calib.machine.tool_uncertainty import tool_uncertainty, uncertainty_map
from calib.measurement.cycles import read_cycles
from calib.measurement.touches import Touches, read_touches

__all__ = [
    "Bootstrap",
    "Choice",
    "CrossValidation",
    "GroupStudy",
    "HeldOut",
    "JudgedModel",
    "ModelComparison",
    "Observability",
    "Performance",
    "Sensitivity",
    "Touches",
    "Trace",
    "before_and_after",
    "bootstrap",
    "choose_terms",
    "compare",
    "compare_models",
    "cross_validate",
    "error_coefficients",
    "exact_error",
    "group_study",
    "iso9283_figures",
    "nested_models",
    "not_placed",
    "observability",
    "outliers",
    "outside_identified",
    "predicted_error",
    "read_cycles",
    "read_errors",
    "read_touches",
    "sensitivity",
    "tool_uncertainty",
    "total_differential",
    "uncertainty_map",
]
