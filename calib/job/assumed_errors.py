"""Assumed errors of parameters, as a table states them for a study of sensitivity."""

import csv
from collections.abc import Mapping
from pathlib import Path

from calib.foundations.arguments import checked
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

    Raises JobError for a parameter that is not free or comes twice, and for a quantity of another dimension.
    """
    units = {parameter.name: parameter.unit for parameter in model.parameters()}
    reader = csv.reader(_lines(path))
    rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    if not rows or [cell.strip() for cell in rows[0][1]] != ["parameter", "error"]:
        raise JobError(f"{path}: begins with the columns 'parameter,error', and has a row for every assumed error.")
    found: dict[str, float] = {}
    for line, row in rows[1:]:
        at = f"{path}:{line}"
        if len(row) != 2:
            raise JobError(f"{at}: has {len(row)} cells, and two are needed: parameter, error.")
        name, error = (cell.strip() for cell in row)
        if name not in units:
            raise JobError(f"{at}: {shown(name)} is not a free parameter of the model{nearest(name, units)}.")
        if name in found:
            raise JobError(f"{at}: {name!r} appears twice.")
        dimension = _DIMENSIONS.get(units[name])
        if dimension is None:
            raise JobError(f"{at}: {name!r} has the unit {units[name]}; errors are lengths and angles.")
        found[name] = parse_within(error, OF_DIMENSION[dimension], f"{at}: {name}")
    return found


def _lines(path: str | Path) -> list[str]:
    try:
        return read_bytes(Path(path), JobError, _LARGEST_TABLE).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as e:
        raise JobError(f"{path}: is not text in UTF-8.") from e
