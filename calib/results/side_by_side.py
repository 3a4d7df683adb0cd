"""Two results of one machine beside each other, as a report."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from calib.assessment.drift import Comparison
from calib.assessment.metrics import Metrics
from calib.foundations.errors import OutputError
from calib.foundations.units import MM
from calib.presentation.acceptance_tables import change_sheet, comparison_sentences
from calib.presentation.report.document import Block, Prose, Report, Row, Section, Sheet, Tile, Verdict
from calib.presentation.sheets import SHOWN
from calib.results.folder import RESULT_FILE, read_result

_Figures = Mapping[tuple[str, str, str], Metrics]


@dataclass(frozen=True, slots=True)
class Told:
    """What a folder of results tells of itself: metrics by use, when and quantity, checks by name, input hashes."""

    folder: Path
    trusted: bool
    figures: _Figures
    checks: Mapping[str, bool]
    inputs: Mapping[str, str]


def told(folder: Path) -> Told:
    """Read what a folder of results tells of itself. Raises OutputError when it holds no readable result."""
    contents = read_result(folder)
    try:
        return Told(
            folder,
            bool(contents["trusted"]),
            _figures(contents["metrics"]),
            {str(check["name"]): bool(check["passed"]) for check in contents["checks"]},
            {str(name): str(sha) for name, sha in contents["inputs"].items()},
        )
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as e:
        raise OutputError(f"{folder / RESULT_FILE}: is not a result of this tool.") from e


def _figures(metrics: Mapping[str, Any]) -> _Figures:
    found = {}
    for use, whens in metrics.items():
        for when, quantities in whens.items():
            for quantity, m in quantities.items():
                sizes = [float(m[name]) for name in ("mean", "rms", "p95", "max")]
                if m["unit"] not in SHOWN or not all(isfinite(size) and size >= 0.0 for size in sizes):
                    raise ValueError
                found[str(use), str(when), str(quantity)] = Metrics(m["unit"], int(m["n"]), *sizes)
    return found


def side_by_side(old: Told, new: Told, found: Comparison) -> Report:
    """Return a report of two results and of what has moved between them."""
    *reasons, headline = comparison_sentences(found)
    warnings = [f"{one.folder} is not trusted: see its own report." for one in (old, new) if not one.trusted]
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
        f"{old.folder.resolve().name} beside {new.folder.resolve().name}",
        Verdict(not found.moved, headline, tuple(reasons), tuple(tiles), tuple(warnings)),
        tuple(sections),
    )


def _errors(old: Told, new: Told) -> Sheet:
    rows = []
    for key in dict.fromkeys([*old.figures, *new.figures]):
        pair = [told.figures.get(key) for told in (old, new)]
        unit = next(m.unit for m in pair if m is not None)
        same = [m if m is not None and m.unit == unit else None for m in pair]
        factor, shown = SHOWN[unit]
        sizes = [
            ("-", "-", "-") if m is None else (str(m.n), f"{m.rms * factor:.4f}", f"{m.max * factor:.4f}") for m in same
        ]
        use, when, quantity = key
        rows.append(Row((use, when, quantity.replace("_", " "), *sizes[0], *sizes[1], shown), strong=when == "after"))
    numbers = ("n, old", "rms, old", "max, old", "n, new", "rms, new", "max, new")
    return Sheet(
        "Errors, measured minus predicted",
        ("data", "robot", "quantity", *numbers, "unit"),
        frozenset(numbers),
        tuple(rows),
        "before: nominal robot, base and tool fitted",
    )


def _passed(one: Told) -> Mapping[str, str]:
    return {name: "yes" if passed else "NO" for name, passed in one.checks.items()}


def _both(title: str, what: str, old: Mapping[str, str], new: Mapping[str, str]) -> Sheet:
    """Return what both say of the same things; strong where they differ."""
    pairs = [(name, old.get(name, "-"), new.get(name, "-")) for name in dict.fromkeys([*old, *new])]
    return Sheet(
        title, (what, "old", "new"), frozenset(), tuple(Row(pair, strong=pair[1] != pair[2]) for pair in pairs)
    )
