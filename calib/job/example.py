"""The shipped example: a simulated IRB2400, calibrated on three levels, with its measurements."""

import csv
import itertools
from collections.abc import Mapping
from pathlib import Path

from calib.foundations.csv_text import csv_text
from calib.foundations.errors import OutputError
from calib.foundations.files import read_bytes, refuse_taken
from calib.foundations.folders import real_folder, refuse_unwritable, write_folder

JOB = "calibration.toml"
TARGETS = "targets.csv"
RESULTS = "out"
_NAME = "irb2400"
_FILES = (JOB, "irb2400.urdf", "base_fit.csv", "level1.csv", "level2.csv", "nodes.csv", "test.csv")
_TARGET_ROWS = 20


def example_folder() -> Path:
    """Return the folder of the example: in the installed package, or in the source tree it was installed from.

    Raises OutputError where neither has it.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "examples" / _NAME, package.parent / "robots" / _NAME):
        if all((folder / name).is_file() for name in _FILES):
            return folder
    raise OutputError("The example is not installed with this package; it is robots/irb2400 of its source.")


def copy_example(folder: Path) -> tuple[Path, Path, Path]:
    """Make a folder with the example's files and with targets; return its job, its targets and where results belong.

    A folder that is this already, and nothing more, as a run that was ended leaves it, is taken as it is.

    Raises OutputError when there is anything else of that name already, or no folder can be made there.
    """
    source = example_folder()
    files = {name: (source / name).read_bytes() for name in _FILES}
    files[TARGETS] = _targets((source / "test.csv").read_text(encoding="utf-8")).encode()
    if not _holds(folder, files):
        refuse_taken(folder, with_parents=True)
        meant = real_folder(folder)
        refuse_unwritable(meant)
        write_folder(meant, files)
    return folder / JOB, folder / TARGETS, folder / RESULTS


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Return whether a folder has these files, and nothing else."""
    try:
        if folder.is_symlink() or {entry.name for entry in folder.iterdir()} != files.keys():
            return False
        return all(read_bytes(folder / name, OutputError) == contents for name, contents in files.items())
    except (OSError, ValueError, OutputError):
        return False


def _targets(table: str) -> str:
    """Return the joints of the first rows of a table of measurements, as targets."""
    rows = csv.reader(line for line in table.splitlines() if not line.startswith("#"))
    first = itertools.islice(rows, 1 + _TARGET_ROWS)
    return "# Where the nominal robot would go at these joints, the machine is to be taken.\n" + csv_text(
        [cell.strip() for cell in row[:6]] for row in first
    )
