"""``calib plan --observes pixels``: which photographs of a board to take beside those of a job."""

from collections.abc import Sequence
from pathlib import Path

from calib.assessment.views import Views, plan_views, view_candidates
from calib.cli import plan_inputs as given
from calib.cli.application import Telling
from calib.foundations.choices import Criterion
from calib.foundations.errors import JobError
from calib.foundations.files import write_new
from calib.foundations.ranges import RANGES, parse_within
from calib.identification.identify import identify
from calib.job.columns import columns_alike
from calib.job.inputs import load


def plan_photographs(
    job: str,
    out: Path,
    count: int,
    candidates: str,
    working: Path | None,
    criterion: Criterion,
    target: str | None,
    collisions: bool,
    mesh_roots: Sequence[Path],
    seed: int,
    telling: Telling,
) -> None:
    """Write the readings at which to take photographs, as ``calib plan`` writes poses."""
    if not job.endswith(".toml"):
        raise JobError(f"{job}: photographs are planned beside those of a job; take a few, and calib import images.")
    with telling.progress(steps=4) as say:
        say("reading the job")
        inputs = load(Path(job))
        say("finding camera, board and lens")
        fit = identify(inputs.model, [*inputs.identify, *inputs.validate])
        views = Views(fit)
        right = (
            None
            if working is None
            else given.table_readings(working, fit.robot, columns_alike(inputs.job.measurements))
        )
        touching, notes = given.collision(fit.robot, (*inputs.mesh_roots, *mesh_roots), wanted=collisions)
        say("sampling views")
        found = view_candidates(views, given.parsed_count(candidates), touching, seed=seed)
        say(f"choosing {count} of {len(found.readings)} views")
        planned = plan_views(
            views,
            count,
            candidates=found.readings,
            criterion=criterion,
            working=right,
            target=None if target is None else parse_within(target, RANGES["sigma"], "target"),
        )
        write_new(out, given.pose_table(fit.robot, planned.readings))
    given.tell_plan(telling, planned, found, notes, ("views", "photographs to take"), out, target, more=True)
