"""The part of a report on rows, targets and groups that do not go with the rest."""

from math import isfinite

from calib.assessment.outliers import Outliers
from calib.foundations.words import counted
from calib.presentation.report.document import Block, Prose, Section, Sheet
from calib.presentation.sheets import SHOWN

_MOST_ROWS = 10
_MOST_GROUPS = 3
_COLUMNS = ("row", ">leverage", ">distance", ">chance", "moves most", ">by sigmas")


def outlier_section(found: Outliers) -> Section:
    """Return the rows that are no accident, or the worst ones; targets that moved; groups that disagree."""
    told = found.outlying
    title = "Outlying rows" if told else "No outlying rows; the farthest from the others"
    sheet = Sheet.of(
        title,
        _COLUMNS,
        [
            (
                f"{row.file}:{row.line}",
                f"{row.leverage:.3f}",
                f"{row.studentised:.2f}",
                f"{row.chance:.1g}",
                row.without.parameter,
                f"{row.without.change:+.2f}",
            )
            for row in (told or found.rows)[:_MOST_ROWS]
        ],
        "distance: from the prediction by the other rows, in standard deviations; chance: that data without errors "
        "have one such row; moves most: the parameter that changes most without the row",
        brief=bool(told),
    )
    blocks: list[Block] = [sheet]
    if len(told) > _MOST_ROWS:
        blocks.append(Prose((f"And {counted(len(told) - _MOST_ROWS, 'row')} more.",), brief=True))
    if found.moved:
        blocks.append(Prose(_moved(found), brief=True))
    if found.disagreeing:
        blocks.append(Prose(_disagreeing(found), brief=True))
    return Section("outliers", "Outliers", tuple(blocks))


def _moved(found: Outliers) -> tuple[str, ...]:
    sentences = []
    for jump in found.moved:
        by = [
            f"{component} {value * SHOWN[unit][0]:+.2f} {SHOWN[unit][1]}"
            for component, value in zip(jump.components, jump.shift, strict=True)
            for unit in ("rad" if component.startswith("r") else "m",)
        ]
        sentences.append(
            f"The target {jump.target} seems to have moved after {jump.file}:{jump.line}, by {', '.join(by)} "
            f"({jump.rows[0]} rows before, {jump.rows[1]} after; chi-squared {jump.gain:.0f}, degrees of freedom "
            f"{len(jump.shift)})."
        )
    return (*sentences, "A model that is wrong at the postures after such a row looks the same.")


def _disagreeing(found: Outliers) -> tuple[str, ...]:
    sentences = []
    for group in found.disagreeing[:_MOST_GROUPS]:
        others = (
            f"Without it the others scatter {group.scatter:.2f} times as much."
            if isfinite(group.scatter)
            else "Without it the others are too few to say how they scatter."
        )
        best = f", {group.differs_gain:.0f} of it by {group.differs} alone" if group.differs else ""
        sentences.append(
            f"The {group.kind} {group.name} disagrees with the rest and would fit better with other parameters: "
            f"chi-squared {group.gain:.0f}, degrees of freedom {group.freedom}{best}. {others}"
        )
    more = len(found.disagreeing) - _MOST_GROUPS
    return (*sentences, *([f"{counted(more, 'group')} more disagree."] if more > 0 else []))
