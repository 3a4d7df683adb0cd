"""``calib compare``: what has moved between two calibrations of one machine."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import JUDGE, Telling, command
from calib.cli.options import Json, Quiet
from calib_start import loading

_OLD = typer.Argument(metavar="OLD", help="Results of the earlier calibration.", show_default=False, readable=False)
_LATER = typer.Argument(metavar="NEW", help="Results of the later calibration.", show_default=False, readable=False)


@command("compare", JUDGE, "calib compare old/ new/")
def compare(
    old: Annotated[Path, _OLD], new: Annotated[Path, _LATER], as_json: Json = False, quiet: Quiet = False
) -> None:
    """Compare two calibrations of one machine.

    Says which parameters have changed by more than chance explains, and how much this moves the tip.
    """
    with loading():
        from calib.assessment.drift import compare as compared
        from calib.machine.model_file import load_machine
        from calib.presentation.acceptance_tables import change_table, comparison_lines
    telling = Telling(as_json, quiet)
    with telling.progress(steps=2) as say:
        say("reading both models")
        before, after = (load_machine(folder) for folder in (old, new))
        say("comparing")
        found = compared(before, after)
    telling.tell(found.contents, lambda: [*([change_table(found)] if found.changes else []), *comparison_lines(found)])
