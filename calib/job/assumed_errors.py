"""Assumed errors of parameters, as a table states them for a study of sensitivity."""

from collections.abc import Mapping
from pathlib import Path

from calib.foundations.arguments import checked
from calib.foundations.csv_text import lines_of
from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.ranges import OF_DIMENSION, parse_within
from calib.foundations.units import Dimension
from calib.foundations.words import shown
from calib.identification.error_model import ErrorModel
from calib.measurement.table import nearest

_DIMENSIONS: Mapping[str, Dimension] = {"m": "length", "rad": "angle"}
_LARGEST_TABLE = 1_000_000


@checked
def read_errors(path: str | Path, model: ErrorModel) -> dict[str, float]:
    """Read assumed errors of parameters from a CSV file, in SI units: ``parameter,error``, as ``joint_1.a,0.1 mm``.

        calib.judging.group_study(model, readings, calib.judging.read_errors("errors.csv", model))

    Raises JobError for a parameter that is not free or comes twice, for a quantity of another dimension, and for a
    table without rows.
    """
    units = {parameter.name: parameter.unit for parameter in model.parameters()}
    data = read_bytes(Path(path), JobError, _LARGEST_TABLE)
    rows = lines_of(data, str(path), "a table of assumed errors", JobError)
    if not rows or rows[0][1] != ["parameter", "error"]:
        raise JobError(f"{path}: begins with the columns 'parameter,error', and has a row for every assumed error.")
    if len(rows) == 1:
        raise JobError(f"{path}: has a header and no rows.")
    found: dict[str, float] = {}
    for at, row in rows[1:]:
        if len(row) != 2:
            raise JobError(f"{at}: has {len(row)} cells, and two are needed: parameter, error.")
        name, error = row
        if name not in units:
            raise JobError(f"{at}: {shown(name)} is not a free parameter of the model{nearest(name, units)}.")
        if name in found:
            raise JobError(f"{at}: {name!r} appears twice.")
        dimension = _DIMENSIONS.get(units[name])
        if dimension is None:
            raise JobError(f"{at}: {name!r} has the unit {units[name]}; errors are lengths and angles.")
        found[name] = parse_within(error, OF_DIMENSION[dimension], f"{at}: {name}")
    return found
