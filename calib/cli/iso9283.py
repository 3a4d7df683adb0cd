"""``calib iso9283``: pose accuracy and repeatability from repeated cycles."""

from pathlib import Path
from typing import Annotated

from calib.cli.application import IN_WORDS, JUDGE, Telling, command
from calib.cli.options import argument
from calib_start import loading


@command("iso9283", JUDGE, "calib iso9283 cycles.csv")
def iso9283(
    cycles: Annotated[Path, argument("CYCLES", "Attained poses of repeated cycles (CSV).")],
    telling: Telling = IN_WORDS,
) -> None:
    """Evaluate repeated cycles after ISO 9283.

    Accuracy and repeatability of poses and of distances, variation between directions of approach, and drift. The
    columns decide which of them (target, x, y, z; command_x, ...; qw, ...; direction; time).
    """
    with loading():
        from calib.assessment.iso9283 import figures, records
        from calib.measurement.cycles import read_cycles
        from calib.presentation.acceptance_tables import iso_sheet
    found = figures(read_cycles(cycles))
    telling.tell(lambda: {"figures": records(found)}, lambda: [iso_sheet(found)])
