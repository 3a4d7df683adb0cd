"""Two results of one machine beside each other, as a report."""

from collections.abc import Mapping
from pathlib import Path

from calib.assessment.drift import Comparison
from calib.foundations.units import MM
from calib.presentation.acceptance_tables import change_sheet, comparison_sentences
from calib.presentation.report.document import Block, Prose, Report, Row, Section, Sheet, Tile, Verdict
from calib.presentation.sheets import BEFORE, SHOWN
from calib.results.result_file import ResultFile, not_trusted, read_result


def side_by_side(folders: tuple[Path, Path], found: Comparison) -> Report:
    """Return a report of the results in an old and a new folder, and of what has moved between them.

    Raises OutputError when one holds no readable result.
    """
    old, new = map(read_result, folders)
    *reasons, headline = comparison_sentences(found)
    both = zip(folders, (old, new), strict=True)
    warnings = [not_trusted(folder) for folder, one in both if not one.trusted]
    tiles = [
        Tile("tips differ by (rms)", f"{found.tip_rms / MM:.4f} mm"),
        Tile("explained", f"{found.stated / MM:.4f} mm"),
    ]
    moved: list[Block] = [change_sheet(found)] if found.changes else []
    told_apart = ("Of parameters that both calibrations have determined. Moved: by more than chance explains at 95 %.",)
    sections = [
        Section("errors", "Errors of both", (_errors(old, new),)),
        Section("changes", "What has moved", (*moved, Prose(told_apart))),
        Section("checks", "What was checked", (_both("Checks", "check", _passed(old), _passed(new)),)),
        Section("provenance", "What they were made from", (_both("Inputs, SHA-256", "file", old.inputs, new.inputs),)),
    ]
    return Report(
        " beside ".join(folder.resolve().name for folder in folders),
        Verdict(not found.moved, headline, tuple(reasons), tuple(tiles), tuple(warnings)),
        tuple(sections),
    )


def _errors(*results: ResultFile) -> Sheet:
    rows = []
    every = [
        {
            (use, when, quantity): m
            for use, whens in one.metrics.items()
            for when, quantities in whens.items()
            for quantity, m in quantities.items()
        }
        for one in results
    ]
    for key in dict.fromkeys(key for figures in every for key in figures):
        pair = [figures.get(key) for figures in every]
        unit = next(m.unit for m in pair if m is not None)
        same = [m if m is not None and m.unit == unit else None for m in pair]
        factor, shown = SHOWN[unit]
        sizes = [
            ("-", "-", "-") if m is None else (str(m.n), f"{m.rms * factor:.4f}", f"{m.max * factor:.4f}") for m in same
        ]
        use, when, quantity = key
        rows.append(Row((use, when, quantity.replace("_", " "), *sizes[0], *sizes[1], shown), strong=when == "after"))
    numbers = (">n, old", ">rms, old", ">max, old", ">n, new", ">rms, new", ">max, new")
    columns = ("data", "robot", "quantity", *numbers, "unit")
    return Sheet.of("Errors, measured minus predicted", columns, rows, BEFORE)


def _passed(one: ResultFile) -> Mapping[str, str]:
    return {check.name: "yes" if check.passed else "NO" for check in one.checks}


def _both(title: str, what: str, old: Mapping[str, str], new: Mapping[str, str]) -> Sheet:
    """Return what both say of the same things; strong where they differ."""
    pairs = [(name, old.get(name, "-"), new.get(name, "-")) for name in dict.fromkeys([*old, *new])]
    return Sheet.of(title, (what, "old", "new"), [Row(pair, strong=pair[1] != pair[2]) for pair in pairs])
