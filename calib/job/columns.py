"""How a job reads its tables, for commands that are given more of the same kind."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, ValidationError

from calib.foundations.errors import MeasurementError, OutputError
from calib.foundations.files import LARGEST_JSON, read_bytes, sha256
from calib.foundations.folders import reading_folder
from calib.machine.run import refuse_other_run
from calib.measurement.kinds import Kind
from calib.measurement.table import AS_WRITTEN, Columns
from calib.results.folder import JOB_FILE
from calib.results.result_file import RESULT_FILE, read_result

if TYPE_CHECKING:
    from calib.job.schema import MeasurementsSection


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True)

    file: str = ""
    use: str = ""
    observes: Kind
    columns: dict[str, str]
    ignore: tuple[str, ...]
    orientation: str | None


class _Instrument(BaseModel):
    model_config = ConfigDict(frozen=True)

    kind: str


class _Job(BaseModel):
    model_config = ConfigDict(frozen=True)

    measurements: tuple[_Table, ...]
    instruments: dict[str, _Instrument] = {}
    run: str | None = None


def columns_alike(tables: "Iterable[MeasurementsSection | _Table]") -> Columns:
    """Return how a job reads its tables, where it reads all of them alike; else tables are read as they are written.

    What another table lacks of these columns is no error.
    """
    ways = {(tuple(sorted(table.columns.items())), table.ignore, table.orientation) for table in tables}
    if len(ways) != 1:
        return AS_WRITTEN
    ((names, ignore, orientation),) = ways
    return Columns(dict(names), ignore, orientation, where_present=True)


def columns_of_results(folder: Path, observes: Kind) -> Columns:
    """Return how the job of a folder of results read its tables of one kind, as :func:`columns_alike` does.

    Positions are read as those of its poses were, where it has no others. A folder that was written from Python has no
    job: tables are read as they are written. Raises OutputError when the job is not readable.
    """
    job = _job_of(folder)
    tables = () if job is None else job.measurements
    alike = [table for table in tables if table.observes == observes]
    if not alike and observes == "position":
        alike = [table for table in tables if table.observes == "pose"]
    return columns_alike(alike)


def not_new(folder: Path, measurements: Path) -> list[str]:
    """Return what is to be said of a table, the same byte for byte, that a folder's machine was identified from."""
    job = _job_of(folder)
    fitted = [] if job is None else [table.file for table in job.measurements if table.use == "identify"]
    if not fitted or not os.path.lexists(folder / RESULT_FILE):
        return []
    inputs, own = read_result(folder).inputs, sha256(read_bytes(measurements, MeasurementError))
    if own not in map(inputs.get, fitted):
        return []
    return [f"{measurements}: the machine was identified from this table; what was fitted verifies nothing."]


def arms_of_results(folder: Path) -> list[str]:
    """Return the names of the arms that measured for a folder of results."""
    job = _job_of(folder)
    return [] if job is None else [name for name, instrument in job.instruments.items() if instrument.kind == "arm"]


def _job_of(folder: Path) -> _Job | None:
    path = folder / JOB_FILE
    with reading_folder(folder):
        if not path.exists():
            return None
        source = read_bytes(path, OutputError, LARGEST_JSON)
        try:
            job = _Job.model_validate_json(source)
        except ValidationError as e:
            raise OutputError(f"{path}: is not a job of this toolkit.") from e
        refuse_other_run(path, job.run)
    return job
