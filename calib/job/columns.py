"""How a job reads its tables, for commands that are given more of the same kind."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, ValidationError

from calib.foundations.errors import OutputError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.folders import reading_folder
from calib.machine.run import refuse_other_run
from calib.measurement.kinds import Kind
from calib.measurement.table import AS_WRITTEN, Columns
from calib.results.folder import JOB_FILE

if TYPE_CHECKING:
    from calib.job.schema import MeasurementsSection


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True)

    observes: Kind
    columns: dict[str, str]
    ignore: tuple[str, ...]
    orientation: str | None


class _Job(BaseModel):
    model_config = ConfigDict(frozen=True)

    measurements: tuple[_Table, ...]
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

    A folder that was written from Python has no job: tables are read as they are written. Raises OutputError when the
    job is not readable.
    """
    path = folder / JOB_FILE
    with reading_folder(folder):
        if not path.exists():
            return AS_WRITTEN
        source = read_bytes(path, OutputError, LARGEST_JSON)
        try:
            job = _Job.model_validate_json(source)
        except ValidationError as e:
            raise OutputError(f"{path}: is not a job of this tool.") from e
        refuse_other_run(path, job.run)
    return columns_alike(table for table in job.measurements if table.observes == observes)
