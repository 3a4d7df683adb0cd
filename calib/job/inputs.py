"""What a job names, read and checked before anything is solved."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calib.foundations.errors import JobError
from calib.foundations.files import name_as_text, read_bytes, sha256, stamp
from calib.foundations.sealing import sealed
from calib.identification.error_model import ErrorModel
from calib.identification.losses import Loss
from calib.job import refusals, tables
from calib.job.read import Progress
from calib.job.schema import Job, MeasurementsSection
from calib.job.stated import load_arm, meshes_not_found
from calib.measurement.checks import Finding, copied_tables, refuse_findings, sides_asked, table_findings, unreached
from calib.measurement.measurements import Measurements
from calib.robot.robot import Robot

if TYPE_CHECKING:
    from calib.identification.optics_choice import OpticsChoice

# How often :func:`load` tells of its progress.
STEPS_OF_LOADING = 3


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Inputs:
    """Everything a job names, read and checked.

    ``model``: with what is known of targets and set-ups that are identified from; ``whole_model``: of all.
    ``hashes``: SHA-256 of every input file by its name in the job. ``optics``: how many numbers lenses and boards have.
    ``bases``: what shows where they are.
    """

    job: Job
    path: Path
    robot: Robot
    model: ErrorModel
    whole_model: ErrorModel
    identify: tuple[Measurements, ...]
    validate: tuple[Measurements, ...]
    nodes: tuple[Measurements, ...]
    model_sigmas: tuple[tuple[float | None, ...], ...]
    mesh_roots: tuple[Path, ...]
    findings: tuple[Finding, ...]
    hashes: Mapping[str, str]
    files: tuple[Path, ...]
    optics: "tuple[OpticsChoice, ...]" = ()
    bases: tables.ShownBy | None = None

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses of the sets to identify from."""
        return tuple(section.loss for section in self.job.measurements if section.use == "identify")

    def tables(self, use: Literal["identify", "validate", "nodes"]) -> tuple[str, ...]:
        """Return the names, as the job has them, of the tables of one use."""
        return tuple(section.file for section in self.job.measurements if section.use == use)


def load(path: Path, progress: Progress = lambda _: None, job: Job | None = None) -> Inputs:
    """Read a job and all it names. Raises CalibError with one sentence for the first thing that is wrong.

    Doubtful but usable things are returned as findings. ``job``: what would stand in ``path``, which is not there yet.
    """
    progress("reading the job")
    stamps = {path: stamp(path)}
    written = job is None
    arm = load_arm(path, job)
    job, urdf, robot, model, folder = tables.with_held_out(arm.job), arm.urdf, arm.robot, arm.model, path.parent
    progress("reading the measurements")
    sections = job.measurements
    named = list(dict.fromkeys(name for section in sections for name in (section.file, section.readings) if name))
    prints = tables.prints_of(job, folder)
    lenses = tables.lenses_of(job, folder)
    named += [name for name in (*prints, *lenses) if name not in named]
    stamps |= {folder / name: stamp(folder / name) for name in named}
    arms = tables.arms_of(job, path)
    doubts = [finding for arm in arms.values() for finding in arm.findings]
    # Rows held out are those of a table above: it is read once.
    before: list[tuple[MeasurementsSection, Measurements]] = []
    sets: list[Measurements] = []
    for section in sections:
        own = section.model_copy(update={**tables.OF_HELD_OUT, "use": "identify"})
        data = next((read for other, read in before if other == own), None)
        if data is None:
            of = tables.of_one_clock(section, before)
            data = tables.measurements_of(section, job, robot, folder, arms, prints, lenses, doubts, of)
            before.append((own, data))
        sets.append(data if section.hold_out is None else tables.shared_out(data, section, job))
    seen = any(data.camera is not None for data in sets)
    sets, optics = tables.with_optics(job, sets, prints, progress) if seen else (sets, ())
    refusals.refuse_unusable_rows(robot, model, sets, path)
    chosen = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "identify")
    held_out = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "validate")
    nodes = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "nodes")
    refusals.refuse_levels(job, model, chosen, nodes, path)
    refusals.refuse_unknown_names(job, model, sets, path)
    refusals.refuse_wrong_targets(job, sets, path)
    whole, model = model, model.within(chosen)
    doubts += [*refusals.found_from_held_out(whole, chosen, held_out), *refusals.relations_left_out(whole, model, path)]
    refusals.refuse_no_noise(job, sets, path)
    doubts += [
        *refusals.weights_not_known(model, sets),
        *refusals.cameras_at_one_place(sets),
        *(finding for _, data in before for finding in unreached(data, sides_asked(data, model.robot))),
        *meshes_not_found(robot.urdf.source, arm.mesh_roots, job.robot.urdf),
    ]
    # Of a whole table, also where some of its rows are held out: what a joint does in these few says nothing.
    findings = doubts + [
        finding for _, data in before for finding in table_findings(data, robot.readings, data.reach(robot))
    ]
    findings += [finding for one_use in (chosen, held_out, nodes) for finding in copied_tables(one_use)]
    if len(chosen) > 1:
        # A joint that rests in one table may move in another; what is never seen, the rank says.
        findings = [finding for finding in findings if finding.code != "joint-at-rest"]
    refuse_findings(findings)
    progress("looking for typical mistakes")
    findings += refusals.signatures_of(model, chosen, path)
    refuse_findings(findings)
    refusals.refuse_unmatched(job, model, chosen, path)
    hashes = {
        **({name_as_text(path): sha256(read_bytes(path, JobError))} if written else {}),
        job.robot.urdf: sha256(robot.urdf.source),
        **{name: sha256(read_bytes(folder / name, JobError)) for name in named},
        **{name: sha256(read_bytes(file, JobError)) for arm in arms.values() for name, file in arm.files.items()},
    }
    # The hashes are to be those of what was read.
    for file, known in stamps.items():
        if stamp(file) != known:
            raise JobError(f"{file}: has changed while it was read; run again when it is whole.")
    findings += [*refusals.not_held_out(job, hashes, path), *refusals.findings_of_rank(model, chosen, path)]
    return Inputs(
        job=job,
        path=path,
        robot=robot,
        model=model,
        whole_model=whole,
        identify=chosen,
        validate=held_out,
        nodes=nodes,
        model_sigmas=tuple(tables.model_sigmas(section) for section in sections if section.use == "identify"),
        mesh_roots=arm.mesh_roots,
        findings=tuple(findings),
        hashes=hashes,
        files=(
            path,
            urdf,
            *(folder / name for name in named),
            *(file for arm in arms.values() for file in arm.files.values()),
        ),
        optics=optics,
        bases=tables.bases_shown_by(sections, sets, arms, folder),
    )
