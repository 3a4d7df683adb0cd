"""``calib compare``: what has moved between two calibrations of one machine."""

from pathlib import Path
from typing import Annotated

from calib.cli.application import IN_WORDS, JUDGE, Telling, command
from calib.cli.options import argument, written
from calib_start import loading


@command("compare", JUDGE, "calib compare old/ new/")
def compare(
    old: Annotated[Path, argument("OLD", "Results of the earlier calibration.")],
    new: Annotated[Path, argument("NEW", "Results of the later calibration.")],
    out: Annotated[Path | None, written("FILE", "A page with both side by side (.html).")] = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Compare two calibrations of one machine.

    Says which parameters have changed by more than chance explains, and how much this moves the tip; as a page, also
    the errors, checks and inputs of both. Exit codes: 0 good, 1 bad input and nothing written, 2 wrong usage.
    """
    with loading():
        from calib.assessment.drift import compare as compared
        from calib.foundations.files import refuse_taken, write_new
        from calib.machine.model_file import load_machine
        from calib.presentation.acceptance_tables import change_sheet, comparison_sentences
        from calib.presentation.console import strong, warning
        from calib.results.result_file import doubted, not_trusted
    refuse_taken(out)
    with telling.progress(steps=2) as say:
        say("reading both models")
        before, after = (load_machine(folder) for folder in (old, new))
        say("comparing")
        found = compared(before, after)
    notes = list(map(not_trusted, doubted(old, new)))
    if out is not None:
        from calib.presentation.report.page import render_page
        from calib.results.side_by_side import side_by_side

        write_new(out, render_page(side_by_side((old, new), found)))
    changes = [change_sheet(found)] if found.changes else []
    *said, moved = comparison_sentences(found)
    telling.tell(
        lambda: {**found.contents(), "notes": notes},
        lambda: [*map(warning, notes), *changes, *said, strong(moved)],
    )
