"""The summary of a fleet: one table, one JSON document and one page, from the results of every job.

It holds neither times nor which jobs were run anew: the same jobs give the same bytes.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.foundations.csv_text import csv_text
from calib.foundations.errors import OutputError
from calib.foundations.files import write_atomically
from calib.foundations.folders import still_meant
from calib.foundations.json_text import document
from calib.job.fleet import PAGE, SUMMARY_CSV, SUMMARY_JSON, Done, refuse_other_summary
from calib.presentation.fleet_tables import JobLine, QuantityError, fleet_report
from calib.presentation.report.page import render_page
from calib.presentation.sheets import SHOWN
from calib.results.folder import REPORT_FILE
from calib.results.result_file import ResultFile, read_result


def fleet_lines(finished: Sequence[Done]) -> tuple[JobLine, ...]:
    """Return what has become of every job, with the figures of its result."""
    return tuple(_line(done) for done in finished)


def _line(done: Done) -> JobLine:
    job = done.job
    file = job.path.as_posix()
    if done.failure is not None:
        return JobLine(job.name, file, "failed", (done.failure,))
    try:
        result = read_result(job.out)
        if done.inputs not in (None, result.inputs):
            why = f"{job.out}: holds the results of other inputs, which another run has written there meanwhile."
            return JobLine(job.name, file, "failed", (why,))
        return _calibrated(job.name, file, result)
    except OutputError as e:
        return JobLine(job.name, file, "failed", (str(e),))
    except KeyError:  # somebody else writes to this folder
        return JobLine(job.name, file, "failed", (f"{job.out}: holds no whole result of this version.",))


def _calibrated(name: str, file: str, result: ResultFile) -> JobLine:
    data = "validation" if "validation" in result.metrics else "identification"
    before, after = (result.metrics[data][when] for when in ("before", "after"))
    return JobLine(
        name,
        file,
        "trusted" if result.trusted else "not trusted",
        result.doubts,
        data,
        tuple(QuantityError(of, m.unit, m.n, before[of].rms, m.rms, m.max) for of, m in after.items()),
        result.rank,
        len(result.parameters),
        sum(one.told for every in result.outliers.values() for one in every),
        f"{name}/{REPORT_FILE}",
    )


def summary(lines: Sequence[JobLine]) -> dict[str, Any]:
    """Return what ``summary.json`` holds: lengths in m, angles in rad."""
    return {"fleet": [asdict(line) for line in lines]}


def summary_csv(lines: Sequence[JobLine]) -> str:
    """Return ``summary.csv``: a row for every job and quantity, in mm, degrees and pixels."""
    figures = ("data", "error", "n", "before", "after", "largest", "unit")
    rows: list[list[object]] = [["job", "file", "verdict", *figures, "rank", "parameters", "outliers", "report", "why"]]
    for line in lines:
        errors: tuple[QuantityError | None, ...] = line.errors or (None,)
        for error in errors:
            shown: tuple[object, ...] = ("",) * len(figures)
            if error is not None:
                factor, unit = SHOWN[error.unit]
                values = (f"{value * factor:.6f}" for value in (error.before, error.after, error.largest))
                shown = (line.data, error.quantity, error.n, *values, unit)
            rest = (line.rank, line.parameters, line.outliers, line.report, " ".join(line.why))
            rows.append([line.name, line.file, line.word, *shown, *("" if v is None else v for v in rest)])
    return csv_text(rows)


def write_summary(lines: Sequence[JobLine], out: Path, meant: Path | None = None) -> None:
    """Write the page and both summaries of a fleet into its folder.

    ``meant``: to what that led when the fleet began. Raises OutputError as ``write_atomically`` does, where it leads
    elsewhere now, and where a file of somebody else has come to be there.
    """
    still_meant(out, meant)
    refuse_other_summary(out)
    for name, contents in (
        (SUMMARY_JSON, document(summary(lines))),
        (SUMMARY_CSV, summary_csv(lines)),
        (PAGE, render_page(fleet_report(lines))),
    ):
        write_atomically(out / name, contents)
