"""The first sheet of a workbook (.xlsx). Needs the package openpyxl."""

import io
import warnings
import zipfile
from collections.abc import Sequence

from calib.foundations.errors import MeasurementError
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
            size = sum(member.file_size for member in archive.infolist())
        if size > _LARGEST:
            raise MeasurementError(f"{where}: unpacks to more than {_LARGEST} bytes.")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that are not needed
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            rows = []
            for row in book.worksheets[0].iter_rows(max_row=_MOST_ROWS + 1, max_col=_MOST_COLUMNS, values_only=True):
                cells = [_cell(value) for value in row]
                if any(cells):
                    rows.append(cells)
            book.close()
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError, IndexError, OSError, SyntaxError) as e:
        raise MeasurementError(f"{where}: is no workbook that can be read.") from e
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


def _cell(value: object) -> str:
    return "" if value is None else " ".join((repr(value) if isinstance(value, float) else str(value)).split())[:200]
