"""``calib performance``: acceptance tests of an arm CMM."""

from pathlib import Path
from typing import Annotated

from calib.cli.application import IN_WORDS, JUDGE, Telling, command
from calib.cli.options import ResultFolder, SetupName, argument, option
from calib_start import loading


@command("performance", JUDGE, "calib performance out/ cone.csv lengths.csv")
def performance(
    results: ResultFolder,
    touches: Annotated[list[Path], argument("TOUCHES...", "Touched points (CSV).")],
    probe: Annotated[Path | None, option("--probe", "FILE", "A cone touched to find the probe point.")] = None,
    setup: SetupName = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Evaluate acceptance tests of an arm CMM.

    Before and after its calibration: single-point articulation, lengths, and spheres, after the methods of
    ASME B89.4.22 and ISO 10360-12. The columns of a file say which test it is.
    """
    with loading():
        from calib.assessment.performance import before_and_after
        from calib.machine.model_file import load_machine
        from calib.measurement.touches import read_touches
        from calib.presentation.command_tables import performance_sheet
        from calib.presentation.console import warning
        from calib.results.result_file import doubts_of
    with telling.progress(steps=1) as say:
        say("reading the model and the touches")
        model = load_machine(results)
        model = model.standing(setup, str(results)) if model.sags_by_set_up else model.at(setup)
        tests = [read_touches(path, model.robot) for path in touches]
        before, after = before_and_after(model, tests, None if probe is None else read_touches(probe, model.robot))
        doubts = doubts_of(results)
    telling.tell(
        lambda: {"before": before.records(), "after": after.records(), "notes": doubts},
        lambda: [*map(warning, doubts), performance_sheet({"before": before, "after": after})],
    )
