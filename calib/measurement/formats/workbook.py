"""The first sheet of a workbook (.xlsx). Needs the package openpyxl."""

import io
import warnings
import zipfile
from collections.abc import Sequence
from typing import Any

from calib.foundations.errors import MeasurementError
from calib.foundations.files import DAMAGED
from calib.measurement.layout import is_number

# Of the archive unpacked; a workbook of a million cells has some 50 MB.
_LARGEST = 200_000_000
_MOST_ROWS, _MOST_COLUMNS = 200_000, 1000


def from_xlsx(data: bytes, where: str) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """Return titles and cells of the first sheet; a first row of numbers is no header. Formulas are as shown."""
    try:
        import openpyxl  # noqa: PLC0415 - an extra
    except ImportError as e:
        raise MeasurementError(f"{where}: needs the package openpyxl: pip install 'urdf-calib[formats]'.") from e
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(member.file_size for member in archive.infolist()) > _LARGEST:
                raise MeasurementError(f"{where}: unpacks to more than {_LARGEST} bytes.")
            sheets = [name for name in archive.namelist() if name.startswith("xl/worksheets/")]
            formulas = any(b"<f" in archive.read(name) for name in sheets)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that are not needed
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            rows = []
            for row in book.worksheets[0].iter_rows(max_row=_MOST_ROWS + 1, max_col=_MOST_COLUMNS, values_only=True):
                cells = [_cell(value) for value in row]
                if any(cells):
                    rows.append(cells)
            book.close()
            uncomputed = _uncomputed(openpyxl, data) if formulas else ""
    except MeasurementError:
        raise
    except (zipfile.BadZipFile, *DAMAGED) as e:
        raise MeasurementError(f"{where}: is no workbook that can be read.") from e
    if uncomputed:
        raise MeasurementError(
            f"{where}: cell {uncomputed} has a formula that was never computed; save the workbook in the program that "
            "computes it."
        )
    if len(rows) > _MOST_ROWS:
        raise MeasurementError(f"{where}: has more than {_MOST_ROWS} rows.")
    width = max((1 + max(k for k, cell in enumerate(row) if cell) for row in rows), default=0)
    rows = [(row + [""] * width)[:width] for row in rows]
    if not rows:
        raise MeasurementError(f"{where}: has no rows.")
    if all(is_number(cell, ",") for cell in rows[0] if cell):
        return [f"column {k + 1}" for k in range(width)], rows
    titles = [title or f"column {k + 1}" for k, title in enumerate(rows[0])]
    return titles, rows[1:]


def _uncomputed(openpyxl: Any, data: bytes) -> str:
    """Return the first cell of the first sheet with a formula and no value, "" where there is none."""
    books = [openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=only) for only in (False, True)]
    try:
        sheets = (b.worksheets[0].iter_rows(max_row=_MOST_ROWS, max_col=_MOST_COLUMNS) for b in books)
        for row in zip(*sheets, strict=True):
            for formula, computed in zip(*row, strict=True):
                if formula.data_type == "f" and computed.value is None:
                    return str(formula.coordinate)
    finally:
        for book in books:
            book.close()
    return ""


def _cell(value: object) -> str:
    return "" if value is None else " ".join((repr(value) if isinstance(value, float) else str(value)).split())[:200]
