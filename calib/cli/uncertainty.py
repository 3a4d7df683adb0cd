"""``calib uncertainty``: how sure a calibrated machine is of its tool."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, JUDGE, Telling, command
from calib.cli.options import ResultFolder, SetupName, option, written
from calib.foundations.choices import MOST_POSES
from calib_start import loading


@command("uncertainty", JUDGE, "calib uncertainty out/ -o sigmas.csv")
def uncertainty(
    results: ResultFolder,
    out: Annotated[Path | None, written("FILE", "Also write every sampled pose (CSV).")] = None,
    samples: Annotated[
        int, typer.Option("--samples", metavar="N", min=2, max=MOST_POSES, help="How many random poses.")
    ] = 2000,
    tool: Annotated[str, option("--tool", "NAME", "The tool to tell the uncertainty of.")] = "tool",
    setup: SetupName = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="Sample up to the joints' limits, not only the identified range.")
    ] = False,
    telling: Telling = IN_WORDS,
) -> None:
    """Show the uncertainty of the tool, and its causes.

    Over the identified range of readings, or with --whole over the joints' limits; in the instrument's frame.
    """
    with loading():
        from calib.foundations.files import refuse_taken, write_new
        from calib.machine.identified import outside_identified
        from calib.machine.model_file import load_machine
        from calib.machine.tool_uncertainty import uncertainty_map
        from calib.machine.uncertainty import rms_by_cause
        from calib.presentation.console import warning
        from calib.presentation.map_tables import map_csv, map_sheet
        from calib.presentation.sheets import budget_sheet
        from calib.results.result_file import doubts_of
    refuse_taken(out)
    with telling.progress(steps=1) as say:
        machine = load_machine(results).standing(setup, str(results))
        found = uncertainty_map(
            machine,
            samples,
            tool=tool,
            limits=None if whole else machine.known_uncertainty.identified,
            closure_determinant=None if whole else machine.known_uncertainty.closure_determinant,
            progress=lambda done, of: say(f"{done} of {of} poses"),
        )
    budget = rms_by_cause(found.budget)
    # What geometry leaves out is counted everywhere; of joint terms, whether they are the right ones is not.
    outside = outside_identified(machine, found.readings) if machine.robot.terms else ()
    if outside:
        outside = (*outside, "There the uncertainty holds only if the machine's joint terms are the right ones.")
    doubts = doubts_of(results)
    if out is not None:
        write_new(out, map_csv(found, machine.robot.readings))
    telling.tell(
        lambda: {
            "sigmas": found.percentiles(),
            "known": found.known_shares(),
            "budget": budget,
            "outside": list(outside),
            "notes": doubts,
        },
        lambda: [
            *map(warning, (*doubts, *outside)),
            map_sheet(found, found.known),
            budget_sheet(budget, len(found.readings)),
            *([] if out is None else [f"Every pose is in {out}."]),
        ],
    )
