"""``calib fleet``: many jobs at once."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import BAD_INPUT, IN_WORDS, INTERRUPTED, MORE, NOT_TRUSTED, Telling, command
from calib.cli.options import argument, option, written
from calib_start import loading


@command("fleet", MORE, "calib fleet jobs/*.toml -o fleet/")
def fleet(
    jobs: Annotated[list[Path], argument("JOBS...", "Job files (TOML).")],
    out: Annotated[Path, written("FOLDER", "Folder of all results: one in it for every job.")] = Path("fleet"),
    workers: Annotated[
        int | None,
        typer.Option("--jobs", "-j", metavar="N", min=1, help="Number of processes.  [default: one for every core]"),
    ] = None,
    dask: Annotated[str | None, option("--dask", "ADDRESS", "A Dask scheduler, as tcp://host:8786.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Also run jobs whose inputs have not changed.")] = False,
    telling: Telling = IN_WORDS,
) -> None:
    """Calibrate many jobs at once.

    Runs each job as calib calibrate does, into a folder of its name, and writes one table and one page for all. A bad
    job does not stop the others. A finished job with the same inputs and versions is not run again, so after Ctrl-C the
    same command continues. Exit codes: 0 good, 1 a job failed, 2 wrong usage, 3 a job is not to be trusted.
    """
    with loading():
        from calib.foundations.folders import made_folder, real_folder
        from calib.job.fleet import PAGE, SUMMARY_CSV, SUMMARY_JSON, fleet_jobs, quieten_dask, run_fleet
        from calib.job.fleet_summary import fleet_lines, summary, write_summary
        from calib.presentation.console import show_error, warning
        from calib.presentation.fleet_tables import fleet_sentence, fleet_sheet
    meant, chosen = real_folder(out), fleet_jobs(jobs, out)
    if dask is not None:
        quieten_dask()
    try:
        with made_folder(out):
            with telling.progress(len(chosen), alike=True) as say:
                finished = run_fleet(chosen, workers, dask, say, again=again)
            lines = fleet_lines(finished)
            write_summary(lines, out, meant)
    except KeyboardInterrupt:
        show_error("interrupted; what is finished is kept, and the same command goes on with the rest.")
        raise typer.Exit(INTERRUPTED) from None
    earlier = sum(done.earlier for done in finished)
    unchanged = f" Unchanged and not run again: {earlier}." if earlier else ""
    telling.tell(
        lambda: summary(lines),
        lambda: [
            fleet_sheet(lines),
            *(warning(f"{line.name}: {line.word}: {' '.join(line.why)}") for line in lines if line.word != "trusted"),
            fleet_sentence(lines) + unchanged,
            f"The fleet is in {out}: {PAGE}, {SUMMARY_CSV}, {SUMMARY_JSON}, and a folder for every job.",
        ],
    )
    if telling.quiet:
        for line in lines:
            if line.word == "failed":
                show_error(f"{line.name}: {' '.join(line.why)}")
    words = {line.word for line in lines}
    if "failed" in words:
        raise typer.Exit(BAD_INPUT)
    if "not trusted" in words:
        raise typer.Exit(NOT_TRUSTED)
