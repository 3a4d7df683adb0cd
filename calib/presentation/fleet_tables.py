"""What has become of a fleet of jobs, as tables and as one page: millimetres and degrees, each number rounded once."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal
from urllib.parse import quote

import numpy as np

from calib.foundations.words import counted
from calib.presentation.report.charts import Axis, Mark, Points, chart, logarithmic
from calib.presentation.report.document import Block, Picture, Prose, Report, Row, Section, Sheet, Tile, Verdict
from calib.presentation.sheets import SHOWN, figure

Word = Literal["trusted", "not trusted", "failed"]
_NAMES_BELOW = 13


@dataclass(frozen=True, slots=True)
class QuantityError:
    """Error norms of one quantity, in ``unit`` m, rad or px: rms before and after, largest after, over ``n`` rows."""

    quantity: str
    unit: str
    n: int
    before: float
    after: float
    largest: float


@dataclass(frozen=True, slots=True)
class JobLine:
    """One job of a fleet. ``data``: what it was judged by; ``why``: why it failed or is not to be trusted, or nothing.

    ``report``: where its report is from the fleet's folder; None where there is none, as of a job that failed.
    ``outliers``: rows, jumps and groups that are no accident, of those least likely that a result lists.
    """

    name: str
    file: str
    word: Word
    why: tuple[str, ...] = ()
    data: str = ""
    errors: tuple[QuantityError, ...] = ()
    rank: int | None = None
    parameters: int | None = None
    outliers: int | None = None
    report: str | None = None


def fleet_sheet(lines: Sequence[JobLine]) -> Sheet:
    """Return the table of a fleet for the terminal: a row for every job and quantity."""
    rows = []
    for line in lines:
        errors: tuple[QuantityError | None, ...] = line.errors or (None,)
        for k, error in enumerate(errors):
            shown = ("", "", "") if error is None else _shown(error)
            seen = (_rank(line), line.word) if k == 0 else ("", "")
            rows.append(Row((line.name if k == 0 else "", *shown, *seen), strong=line.word != "trusted"))
    found = [f"{line.name} {line.outliers}" for line in lines if line.outliers]
    caption = "rms, of held-out data where there are any" + (f"; outliers: {', '.join(found)}" if found else "")
    columns = ("job", "error", ">before", ">after", ">rank", "verdict")
    return Sheet.of("Fleet", columns, rows, caption, brief=True)


def fleet_report(lines: Sequence[JobLine]) -> Report:
    """Return the page of a fleet: the verdict, every job with a link to its report, and what is wrong with which."""
    bad = [line for line in lines if line.word != "trusted"]
    blocks: list[Block] = [_table(lines)]
    blocks += [picture for unit in SHOWN if (picture := _picture(lines, unit)) is not None]
    sections = [Section("jobs", "Jobs", tuple(blocks))]
    if bad:
        told = tuple(f"{line.name}: {line.word}. {' '.join(line.why)}" for line in bad)
        sections.insert(0, Section("doubts", "Failed, or not to be trusted", (Prose(told, "list"),)))
    return Report(f"Fleet of {counted(len(lines), 'job')}", _verdict(lines), tuple(sections))


def fleet_sentence(lines: Sequence[JobLine]) -> str:
    """Return how many jobs ended in which way."""
    told = [(w, sum(line.word == w for line in lines)) for w in ("trusted", "not trusted", "failed")]
    return f"{counted(len(lines), 'job')}: {', '.join(f'{n} {word}' for word, n in told if n)}."


def _verdict(lines: Sequence[JobLine]) -> Verdict:
    bad = [line.name for line in lines if line.word != "trusted"]
    reasons = (f"Look at {', '.join(bad[:8])}{' and others' if len(bad) > 8 else ''}.",) if bad else ()
    tiles = []
    for quantity, unit in dict.fromkeys((error.quantity, error.unit) for line in lines for error in line.errors):
        found = [error for line in lines for error in line.errors if (error.quantity, error.unit) == (quantity, unit)]
        if len(found) > 1:
            what = quantity.replace("_", " ")
            for when, values in (("before", [e.before for e in found]), ("after", [e.after for e in found])):
                tiles.append(Tile(f"{what}, {when} (rms, median of {len(found)})", figure(median(values), unit)))
            tiles.append(Tile(f"{what}, after (rms, worst job)", figure(max(e.after for e in found), unit)))
    return Verdict(not bad, fleet_sentence(lines), reasons, tuple(tiles))


def _table(lines: Sequence[JobLine]) -> Sheet:
    """Return the table of the page, whose columns have one unit each, so that it can be sorted by any of them."""
    units = [unit for unit in SHOWN if any(error.unit == unit for line in lines for error in line.errors)]
    figures = [f">{when} [{SHOWN[unit][1]}]" for unit in units for when in ("before", "after", "largest")]
    rows = []
    for line in lines:
        errors: tuple[QuantityError | None, ...] = line.errors or (None,)
        for error in errors:
            values = [
                "" if error is None or error.unit != unit else f"{value * SHOWN[unit][0]:.4f}"
                for unit in units
                for value in ((0.0, 0.0, 0.0) if error is None else (error.before, error.after, error.largest))
            ]
            what = ("", "", "") if error is None else (error.quantity.replace("_", " "), line.data, str(error.n))
            seen = (_rank(line), "" if line.outliers is None else str(line.outliers))
            link = "" if line.report is None else quote(line.report, errors="surrogateescape")
            rows.append(Row((line.name, line.word, *seen, *what, *values), strong=line.word != "trusted", link=link))
    columns = ("job", "verdict", ">rank", ">outliers", "error", "data", ">n", *figures)
    caption = (
        "A job's name leads to its report. A click on the head of a column sorts by it. before and after: rms; "
        "largest: after calibration; rank: formal rank, of how many parameters; outliers: rows, jumps and groups that "
        "are too large to be chance, at most ten of each."
    )
    return Sheet.of("Jobs", columns, rows, caption, brief=True, sortable=True)


def _picture(lines: Sequence[JobLine], unit: str) -> Picture | None:
    """Return errors of one unit before and after, job by job in the order of the table; None where nothing has it."""
    with_it = [(line.name, error) for line in lines for error in line.errors if error.unit == unit]
    if len({name for name, _ in with_it}) < 2:
        return None
    names = tuple(dict.fromkeys(name for name, _ in with_it))
    factor, shown = SHOWN[unit]
    x = np.array([names.index(name) for name, _ in with_it], dtype=np.float64)
    values = {when: np.array([getattr(error, when) for _, error in with_it]) * factor for when in ("before", "after")}
    short = names if len(names) < _NAMES_BELOW else ()
    axis = Axis("job", -0.6, len(names) - 0.4, names=tuple(str(k + 1) for k in range(len(names))) if short else ())
    marks: list[Mark] = [Points(when, x, values[when], 5.0) for when in ("before", "after")]
    drawn = chart(
        axis,
        logarithmic(f"rms [{shown}]", np.concatenate(list(values.values()))),
        marks,
        (("before", "before"), ("after", "after")),
    )
    numbered = "; ".join(f"{k + 1} {name}" for k, name in enumerate(short)) if short else "in the order of the table"
    return Picture(f"Errors in {shown}, job by job", drawn, f"Jobs: {numbered}.")


def _shown(error: QuantityError) -> tuple[str, str, str]:
    factor, name = SHOWN[error.unit]
    return f"{error.quantity.replace('_', ' ')} [{name}]", f"{error.before * factor:.4f}", f"{error.after * factor:.4f}"


def _rank(line: JobLine) -> str:
    return "" if line.rank is None else f"{line.rank}/{line.parameters}"
