"""Tables and sentences of acceptance: verification, comparison, ISO 9283, and the map of uncertainty."""

from collections.abc import Sequence

from rich.text import Text

from calib.assessment.acceptance import ChiSquare, FoundAnew, Verification
from calib.assessment.drift import Comparison
from calib.assessment.frames_anew import SIGNIFICANCE, Anew
from calib.assessment.iso9283 import IsoFigure
from calib.compensation.cell import CalibratedCell
from calib.foundations.units import DEG, MM
from calib.machine.place import undetermined_in_words
from calib.presentation.report.document import Row, Sheet
from calib.presentation.sheets import SHOWN, figures_in, signed

# So many times larger than stated are errors of which a test of few rows finds half, that it is said.
_SURELY = 1.5
_ELSEWHERE: dict[Anew, str] = {
    "base": "as far as these rows show, the arm is as calibrated, but stands elsewhere",
    "tool": "as far as these rows show, the arm is as calibrated, but carries another tool, or its tool elsewhere",
    "both": "these rows do not show that the arm itself has changed",
}
# Three shifts and three turns.
_ALL_DIRECTIONS = 6
# Tips that differ by so many times of what is stated do so by no chance, of however few parameters.
_FAR = 3.0


def verification_sheet(found: Verification) -> Sheet:
    """Return the errors of new measurements, as calibrated and with frames found anew."""
    rows = []
    judgements = {"as calibrated": found.as_calibrated}
    judgements |= {f"{what} found anew": anew.judgement for what, anew in found.anew.items()}
    for when, judgement in judgements.items():
        for m in judgement.metrics.values():
            shown = figures_in(m.unit, m.mean, m.rms, m.p95, m.max)
            rows.append(Row((when, str(m.n), *shown), strong=judgement is found.decisive))
    columns = ("frames", ">n", ">mean", ">rms", ">p95", ">max", "unit")
    return Sheet.of("Tip errors, measured minus predicted", columns, rows)


def verification_lines(found: Verification) -> list[str | Text]:
    """Return the verdict in sentences."""
    lines: list[str | Text] = []
    if found.limit is not None:
        largest = found.decisive.metrics["position"].max
        side = "is within" if found.within_limit else "exceeds"
        lines.append(f"The largest position error, {largest / MM:.4f} mm, {side} the limit, {found.limit / MM:g} mm.")
    if found.refit is not None:
        lines.append(f"Found anew: {_moved(found.anew[found.refit])}.")
    test = found.decisive.test
    lines.append(_tested(test))
    if test.passed and test.half_seen > _SURELY:
        times = f"{test.half_seen:.1f}"
        lines.append(
            f"So few rows show little: with errors {times} times as large as stated, half of such tests would pass."
        )
    if not test.passed:
        lines += _explained(found)
    lines.append(Text("Passed." if found.passed else "Failed.", style="bold green" if found.passed else "bold red"))
    return lines


def _explained(found: Verification) -> list[str]:
    """Return what explains rows that the stated uncertainty does not, or that nothing does."""
    more: dict[Anew, FoundAnew] = {
        what: anew for what, anew in found.anew.items() if found.refit is None or (what == "both" != found.refit)
    }
    enough = {what: anew for what, anew in more.items() if anew.judgement.test.passed}
    if any(what != "both" for what in enough):
        enough.pop("both", None)
    lines = list[str]()
    for what, anew in enough.items():
        also, joint = " as well" if lines else "", anew.or_offset_of
        alike = f", or the offset of {joint!r} has changed, which looks the same" if joint else ""
        lines.append(f"{_as_subject(_moved(anew))} explains them{also}: {_ELSEWHERE[what]}{alike}.")
    tried = list(more.values()) or ([] if found.refit is None else [found.anew[found.refit]])
    if tried and not enough:
        anew = min(tried, key=lambda one: one.judgement.metrics["position"].rms)
        left = figures_in("m", anew.judgement.metrics["position"].rms)[0]
        both = "" if "both" in found.anew else "base and tool have both moved, which these rows cannot show, "
        lines.append(
            f"{_as_subject(_moved(anew))} leaves {left} mm rms, more than the stated uncertainty explains: {both}the "
            "arm itself has changed, it bears a load or a temperature that was not told, or its uncertainty is stated "
            "too small."
        )
    return lines


def _moved(anew: FoundAnew) -> str:
    """Return by how much frames would have moved, in words."""
    parts = []
    for name, moved in (("a base", anew.base_moved), ("a tool", anew.tool_moved)):
        if moved is not None:
            turn = f" and {moved[1] / DEG:.4f} deg" if moved[1] else ""
            parts.append(f"{name} moved by {moved[0] / MM:.3f} mm{turn}")
    return ", with ".join(parts) or "a motion of base and tool together"


def _as_subject(said: str) -> str:
    return said[0].upper() + said[1:] + ("," if ", with " in said else "")


def place_lines(found: CalibratedCell) -> list[str]:
    """Return in sentences how sure it is where the second machine of a cell stands."""
    if found.place is None:
        return ["How sure its place is in the cell is not known."]
    undetermined = [said for said, _ in undetermined_in_words(found.place)]
    position, orientation = found.place.sigmas
    # Results name the instrument's frame, and not which instrument it was.
    one = ["Both are taken to be found by one instrument that stood still."] if found.placed_in == "instrument" else []
    sure = f"{position / MM:.3f} mm and {orientation / DEG:.4f} deg"
    if not undetermined:
        return [*one, f"Its place is known to {sure} (standard deviations of its position and of its orientation)."]
    if len(undetermined) == _ALL_DIRECTIONS:
        return [*one, "Its place is not determined: the data show none of it."]
    return [
        *one,
        f"Its place is not determined {', nor '.join(undetermined)}, in the axes of the arm's base. In all other "
        f"directions it is known to {sure} (standard deviations of its position and of its orientation).",
    ]


def _tested(test: ChiSquare) -> str:
    per = test.statistic / test.degrees_of_freedom
    said = "explains" if test.passed else "does not explain"
    return (
        f"The stated uncertainty {said} the errors: chi-square per degree of freedom {per:.3g} "
        f"({test.degrees_of_freedom} of them), probability {test.probability:.2g}, limit {SIGNIFICANCE:g}."
    )


def change_sheet(found: Comparison) -> Sheet:
    """Return the parameters of two calibrations, in mm and degrees, those that moved first."""
    rows = []
    for change in sorted(found.changes, key=lambda c: (not c.moved, -abs(c.new - c.old) / c.sigma)):
        factor, unit = SHOWN[change.unit]
        values = (change.old, change.new, change.new - change.old, change.sigma)
        shown = (signed(value * factor, 4) for value in values[:3])
        told = f"{change.sigma * factor:.4f}", f"{change.at_tip / MM:.3f}", unit, "yes" if change.moved else "no"
        rows.append(Row((change.name, *shown, *told), strong=change.moved))
    columns = ("parameter", ">old", ">new", ">change", ">sigma", ">tip [mm]", "unit", "moved")
    return Sheet.of("Changes", columns, rows, "tip: rms motion of the tip by this change alone", sortable=True)


def comparison_sentences(found: Comparison) -> tuple[str, ...]:
    """Return what a comparison says, and at the end its verdict."""
    if found.statistic is None or found.probability is None:
        together = "The two calibrations have different free parameters: only their tips can be compared as a whole."
    else:
        per = found.statistic / max(found.degrees_of_freedom, 1)
        together = (
            f"All {found.degrees_of_freedom} combinations that both have determined: chi-square per degree of "
            f"freedom {per:.3g}, probability {found.probability:.2g}."
        )
    at_tip = (
        f"At the tip the two differ by {found.tip_rms / MM:.4f} mm rms, {found.tip_max / MM:.4f} mm at most, "
        f"base and tool refitted; their uncertainties explain {found.stated / MM:.4f} mm."
    )
    moved = [change.name for change in found.changes if change.moved]
    if moved:
        verdict = f"Moved by more than chance: {', '.join(moved)}."
    elif found.moved:
        verdict = "The machine has changed, though no single parameter shows it."
    elif found.statistic is None and found.tip_rms > _FAR * found.stated:
        verdict = (
            "No parameter that both have identified has moved, but the tips differ by more than the uncertainty of "
            "both explains: the machine has changed, or one of the two models leaves out what the other has."
        )
    else:
        verdict = "Nothing has moved by more than the uncertainty of both explains."
    return together, at_tip, verdict


def iso_sheet(figures: Sequence[IsoFigure]) -> Sheet:
    """Return the figures of ISO 9283 in mm and degrees."""
    rows = [(one.name, one.place, str(one.n), *figures_in(one.unit, one.value)) for one in figures]
    columns, said = ("figure", "pose", ">n", ">value", "unit"), "after the method of the standard; no certificate"
    return Sheet.of("Figures after ISO 9283", columns, rows, said)
