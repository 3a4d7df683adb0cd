"""``calib verify``: whether a calibrated machine is still what it was."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.application import IN_WORDS, JUDGE, NOT_TRUSTED, Telling, command
from calib.cli.options import ResultFolder, SetupName, argument, option
from calib.cli.proposing import AS_TITLED, AsTitled
from calib.foundations.choices import Observed
from calib_start import loading

if TYPE_CHECKING:
    from calib.machine.calibrated import CalibratedMachine
    from calib.measurement.table import Table

# Tables of which no positions can be read, by columns that they have.
_NOT_VERIFIED = (
    ("pixels of photographs", {"u", "v"}),
    ("touches of targets", {"target"}),
    ("lengths of pairs", {"pair"}),
)
# Of columns that may be passed over, as many are named.
_LISTED = 4


@command("verify", JUDGE, 'calib verify out/ new.csv --limit "0.3 mm"')
def verify(
    results: ResultFolder,
    measurements: Annotated[Path, argument("MEASUREMENTS", "New measurements (CSV).")],
    observes: Annotated[Observed, typer.Option(help="What was measured.")] = "position",
    sigma: Annotated[str | None, option("--sigma", "LENGTH", "Sigma of one number.")] = None,
    limit: Annotated[str | None, option("--limit", "LENGTH", "Largest error allowed.")] = None,
    refit_base: Annotated[
        bool, typer.Option("--refit-base", help="The instrument was moved: find the base anew.")
    ] = False,
    refit_tool: Annotated[
        bool, typer.Option("--refit-tool", help="Another tool is mounted: find the tool anew.")
    ] = False,
    tool: Annotated[str | None, option("--tool", "NAME", "The tool that was measured.")] = None,
    setup: SetupName = None,
    in_order: Annotated[
        bool, typer.Option("--in-order", help="Rows are in the order of measurement, which tells the side of approach.")
    ] = False,
    titles: AsTitled = AS_TITLED,
    telling: Telling = IN_WORDS,
) -> None:
    """Verify a calibrated machine by new measurements.

    Ten points or more are enough. It passes when every error is within the limit, if one is given, and the errors
    together are no larger than the stated uncertainty explains (chi-square test, 1 %). Without --column, --ignore and
    --orientation, columns are read as the calibration read them. Exit codes: 0 passed, 1 bad input, 2 wrong usage,
    3 failed.
    """
    with loading():
        from calib.assessment.acceptance import verify as judged
        from calib.foundations.errors import MeasurementError
        from calib.foundations.ranges import RANGES, parse_within
        from calib.job.columns import columns_of_results, not_new
        from calib.machine.identified import outside_identified
        from calib.machine.model_file import load_machine
        from calib.measurement.checks import refuse_findings, sides_asked, table_findings, unreached
        from calib.measurement.formats.sheet import read_sheet
        from calib.measurement.read import read_measurements
        from calib.measurement.table import HeaderError, read_table
        from calib.presentation.acceptance_tables import verification_lines, verification_sheet
        from calib.presentation.console import warning
        from calib.results.result_file import doubts_of
    with telling.progress(steps=2) as say:
        say("reading the model and the measurements")
        machine = load_machine(results).at(setup)
        machine = machine if tool is None else machine.of(tool)
        columns = titles.columns() or columns_of_results(results, observes)
        try:
            if tool is None and machine.tool_tips:
                machine = _at_the_tip_of(machine, read_table(measurements, columns))
            data = read_measurements(
                measurements,
                machine.robot,
                observes,
                sigma=None if sigma is None else parse_within(sigma, RANGES["sigma"], "sigma"),
                in_order=in_order,
                columns=columns,
            ).named(tool=tool, setup=setup)
        except HeaderError as e:
            names = set(read_sheet(measurements).names)
            if beyond := _not_positions(results, names):
                raise MeasurementError(
                    f"{measurements}: {beyond} are not verified; name this table in a [[measurements]] of the job, "
                    'with use = "validate", and calibrate again: the report tells its errors apart.'
                ) from e
            if not e.unitless:
                raise
            passed_over = " ".join(f"--ignore {name!r}" for name in e.unitless[:_LISTED])
            raise MeasurementError(
                f"{str(e).removesuffix('.')}; or pass over what is not needed: {passed_over}."
            ) from e
        # Else a wrong unit would be told as an arm that has changed.
        refuse_findings(table_findings(data, machine.robot.readings, data.reach(machine.robot)))
        left_out = [finding.sentence for finding in unreached(data, sides_asked(data, machine.robot))]
        doubts = [*doubts_of(results), *not_new(results, measurements)]
        say("judging")
        found = judged(
            machine,
            data,
            limit=None if limit is None else parse_within(limit, RANGES["sigma"], "limit"),
            refit=refit_base,
            refit_tool=refit_tool,
        )
        conditions, own = data.loaded(machine.robot).conditions, [data.tools[k] for k in set(data.tool.tolist())]
        outside = outside_identified(machine, data.readings, conditions, tool=own)
    telling.tell(
        lambda: {**found.contents(), "outside": list(outside), "notes": [*doubts, *left_out]},
        lambda: [*map(warning, (*doubts, *left_out, *outside)), verification_sheet(found), *verification_lines(found)],
    )
    if not found.passed:
        raise typer.Exit(NOT_TRUSTED)


def _not_positions(results: Path, names: set[str]) -> str | None:
    """Return what a table with columns ``names`` has in the place of positions; None where nothing tells it."""
    with loading():
        from calib.foundations.words import shown
        from calib.job.columns import arms_of_results
    if names & {"x", "y", "z"}:
        return None
    for what, own in _NOT_VERIFIED:
        if own <= names:
            return what
    arms = arms_of_results(results)
    return f"rows that {' or '.join(map(shown, arms))} touched" if arms else None


def _at_the_tip_of(machine: "CalibratedMachine", table: "Table") -> "CalibratedMachine":
    """Return the machine at the tip that carries the tools of a table's column, where they are all on one."""
    named = table.columns.get("tool")
    tools = () if named is None else [str(name) for name in dict.fromkeys(named.values) if name in machine.tools]
    tips = {machine.of(tool).robot.tip: tool for tool in tools}
    return machine.of(next(iter(tips.values()))) if len(tips) == 1 else machine
