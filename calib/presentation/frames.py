"""A fit as pandas DataFrames, in SI units; pandas is imported when one is asked for."""

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.errors import OutputError
from calib.foundations.lazy import needed
from calib.foundations.words import refuse_other
from calib.identification.fit import Fit
from calib.presentation.sheets import correlation

if TYPE_CHECKING:
    from pandas import DataFrame

What = Literal["parameters", "residuals", "correlations"]
_LENGTHS = ("x", "y", "z")
_ANGLES = ("rx", "ry", "rz")


@checked
def data_frame(fit: Fit, what: What = "parameters") -> "DataFrame":
    """Return the parameters of a fit, its residuals, or the correlations of the identifiable parameters.

    ``parameters``: a row for each, by name: value, unit, sigma (nan where not identifiable), prior, identifiable,
    weakly_determined. ``residuals``: a row for each measured one: file, line, tool, and measured minus predicted of
    every coordinate, before and after, in m and rad, or px. ``correlations``: square, by names.

    Raises JobError for another word, OutputError where pandas is missing.
    """
    refuse_other(what, get_args(What), "what")
    with needed(OutputError, "A DataFrame needs pandas", "; install it"):
        import pandas as pd  # noqa: PLC0415 - calib must not load it on import
    if what == "parameters":
        return pd.DataFrame(fit.records()).set_index("name").astype({"sigma": float, "prior": float})
    if what == "correlations":
        seen, r = correlation(fit)
        names = [fit.parameters[k].name for k in seen]
        return pd.DataFrame(r, index=names, columns=names)
    return pd.concat([pd.DataFrame(_residuals(fit, k)) for k in range(len(fit.measurements))], ignore_index=True)


def _residuals(fit: Fit, k: int) -> dict[str, Any]:
    data = fit.measurements[k]
    columns: dict[str, Any] = {
        "file": [data.where] * len(data),
        "line": np.asarray(data.lines),
        "tool": [data.tools[tool] for tool in data.tool],
    }
    for when, residuals in (("before", fit.nominal_residuals[k]), ("after", fit.residuals[k])):
        for axis, values in zip((*_LENGTHS, *_ANGLES), residuals.T, strict=False):
            columns[f"{when}_{axis}"] = values
    return columns
