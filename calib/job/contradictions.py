"""What no single field of a job can know: keys that point nowhere, or that another key makes meaningless."""

from collections.abc import Iterator, Mapping
from typing import get_args

from calib.foundations.errors import JobError
from calib.identification.relations import RelationKind
from calib.job.schema import FLOOR, InstrumentSection, Job, MeasurementsSection, RelationSection
from calib.job.sentences import dotted
from calib.measurement.lens import BENT, CENTRE, FOCAL, NAMES, RATIONAL
from calib.measurement.measurements import ONLY_SETUP
from calib.robot.terms import KINDS

# Kinds of which no closed form finds the tool: the search begins where the job says, or at the tip link.
_FROM_A_START = frozenset({"distance", "pair_distance", "plane", "indicator"})


def contradictions(job: Job) -> Iterator[str]:
    """Yield what no single field can know: keys that point nowhere, or that another key makes meaningless."""
    for name, instrument in job.instruments.items():
        yield from _instrument_contradictions(dotted(("instruments", name)), instrument)
    for i, section in enumerate(job.measurements):
        yield from _measurement_contradictions(job, f"measurements[{i}]", section)
    if job.error_model.terms == "auto":
        for key in (kind.key for kind in KINDS):
            if job.error_model.chosen_terms[key] != "none":
                yield f'error_model.{key}: is given, and terms = "auto" chooses joint terms; leave one of them out.'
    for i, level in enumerate(job.levels):
        residual = level.residual_model
        if residual is not None and residual.kind == "grid" and residual.joints is None:
            yield f"levels[{i}].residual_model.joints: is missing; a grid spans joints that are named."
    if job.solver.kind == "total_differential":
        for i, section in enumerate(job.measurements):
            if section.loss != "linear":
                yield (
                    f'measurements[{i}].loss: {section.loss!r} has no effect with solver.kind = "total_differential", '
                    "which weighs all rows alike; leave it out."
                )
    if not any(section.use == "identify" for section in job.measurements):
        yield 'measurements: none has use = "identify"; there is nothing to identify from.'
    for name, target in job.targets.items():
        nothing = target.position is None and target.normal is None
        if (target.position is not None and target.normal is not None) or (nothing and target.on == FLOOR):
            yield f"targets.{name}: a point has a position, a plane a normal; give one of them."
        if target.quaternion is not None and target.position is None:
            yield f"targets.{name}.quaternion: is given without a position; give the position as well."
        if target.height is not None and target.normal is None:
            yield f"targets.{name}.height: is given without a normal; give the normal as well."
    for i, relation in enumerate(job.relations):
        yield from _relation_contradictions(f"relations[{i}]", relation)
    yield from _of_bases(job)
    shown = {section.observes for section in job.measurements if section.use == "identify"} - _FROM_A_START
    if job.tools and job.error_model.tool != "fixed" and shown:
        yield 'tools: poses are given, and error_model.tool leaves them free; write tool = "fixed" there.'


def _of_bases(job: Job) -> Iterator[str]:
    """Yield what is wrong with the poses of the base."""
    fixed = job.error_model.base == "fixed"
    if job.base is not None and job.base.prior is None and not fixed:
        yield (
            'base: a pose is given, and error_model.base leaves it free; write base = "fixed" there, or give a prior.'
        )
    if ONLY_SETUP in job.setups:
        yield f"setups.{ONLY_SETUP}: is the set-up without a name, whose pose is in [base]."
    for name, setup in job.setups.items():
        for key in ("quaternion", "prior"):
            if setup.position is None and getattr(setup, key) is not None:
                yield f"{dotted(('setups', name))}.{key}: is given without a position; give the position as well."
    for at, section in (("base", job.base), *((dotted(("setups", name)), one) for name, one in job.setups.items())):
        if section is not None and section.prior is not None and fixed:
            yield f'{at}.prior: has no effect with error_model.base = "fixed"; leave it out.'


def _measurement_contradictions(job: Job, at: str, section: MeasurementsSection) -> Iterator[str]:
    measured_by = job.instruments.get(section.instrument or "")
    if measured_by is not None and measured_by.kind == "arm" and section.observes != "position":
        yield f'{at}.observes: an arm that touches sees positions only; write "position".'
    if section.instrument is not None and section.instrument not in job.instruments:
        known = ", ".join(map(repr, job.instruments)) or "none"
        yield f"{at}.instrument: {section.instrument!r} is not declared; there are {known}."
    if section.instrument is not None and section.sigma is not None and section.observes != "pixels":
        yield f"{at}.instrument: the noise is given by sigma as well; keep one of them."
    if section.observes != "pose":
        for key in ("sigma_angle", "model_sigma_angle"):
            if getattr(section, key) is not None:
                yield f'{at}.{key}: only poses have angles; leave it out or write observes = "pose".'
    yield from _of_pixels(section, job, at)
    if section.observes not in ("position", "pose"):
        if section.instrument is not None and section.observes != "pixels":
            yield f"{at}.instrument: a laser tracker measures no {section.observes}; give sigma."
        if section.use == "nodes":
            yield f"{at}.use: nodes of a residual model need positions, and a {section.observes} has none."
    if section.length_offset is not None and section.observes not in ("distance", "pair_distance", "sphere"):
        yield f"{at}.length_offset: a {section.observes} has no length; leave it out."
    if section.use == "validate":
        for key in ("model_sigma", "model_sigma_angle"):
            if getattr(section, key) is not None:
                yield f'{at}.{key}: has no effect with use = "validate"; leave it out.'
    if section.use != "identify" and section.hold_out is not None:
        yield f'{at}.hold_out: has no effect with use = "{section.use}"; leave it out.'
    if section.use != "identify" and section.loss != "linear":
        yield f'{at}.loss: has no effect with use = "{section.use}"; leave it out.'


def _relation_contradictions(at: str, relation: RelationSection) -> Iterator[str]:
    given = [kind for kind in get_args(RelationKind) if getattr(relation, kind) is not None]
    if len(set(relation.targets)) < len(relation.targets):
        yield f"{at}.targets: {relation.targets[0]!r} comes twice; a relation is between two."
    if len(given) != 1:
        yield f"{at}: says {' and '.join(given) or 'nothing'}; give one of distance, angle, offset."
    else:
        try:
            relation.sigma.of("angle" if given == ["angle"] else "length", f"{at}.sigma")
        except JobError as e:
            yield str(e)


def _of_pixels(section: MeasurementsSection, job: Job, at: str) -> Iterator[str]:
    """Yield what is wrong with pixels and cameras of one section of measurements."""
    if section.instrument is None:
        if section.observes == "pixels":
            yield f"{at}.instrument: is missing; pixels need the camera that saw them."
    elif section.instrument in job.instruments:
        kind = job.instruments[section.instrument].kind
        if (kind == "camera") != (section.observes == "pixels"):
            yield f"{at}.instrument: a {_words(kind)} measures no {section.observes}."
    if section.observes != "pixels" and section.board is not None:
        yield f"{at}.board: only cameras see boards; leave it out."
    pixels = section.observes == "pixels"
    if pixels and section.sigma is not None:
        there = dotted(("instruments", section.instrument or "camera"))
        say = f"leave it out, and give [{there}] a sigma, like '0.2 px'"
        yield f"{at}.sigma: the noise of pixels is the camera's; {say}."
    for key, sigma in (("sigma", None if pixels else section.sigma), ("model_sigma", section.model_sigma)):
        if sigma is not None and (sigma.dimension == "pixel") != pixels:
            unit = "pixels, like '0.1 px'" if pixels else "a length, like '0.02 mm'"
            yield f"{at}.{key}: {sigma!r} does not fit what is observed; allowed are {unit}."


_KEYS_OF: Mapping[str, tuple[str, ...]] = {
    "laser_tracker": ("sigma_per_metre", "station"),
    "arm": ("model", "urdf", "tip", "setup", "tool", "point", "pivot"),
    "camera": ("camera_on", *NAMES, "lens", "lens_sigma", "size", "lens_file"),
}


def _instrument_contradictions(at: str, section: InstrumentSection) -> Iterator[str]:
    """Yield keys that an instrument lacks, or that belong to another kind."""
    for key in [key for kind, keys in _KEYS_OF.items() if kind != section.kind for key in keys]:
        if key in section.model_fields_set:
            yield f'{at}.{key}: has no effect with kind = "{section.kind}"; leave it out.'
    if section.sigma is None:
        if section.kind != "camera":
            yield f"{at}.sigma: is missing."
    elif (section.sigma.dimension == "pixel") != (section.kind == "camera"):
        unit = "pixels, like '0.2 px'" if section.kind == "camera" else "a length, like '7.5 um'"
        yield f"{at}.sigma: {section.sigma!r} is not of a {_words(section.kind)}; allowed are {unit}."
    if section.kind == "camera":
        yield from _of_lens(at, section)
    if section.kind != "arm":
        return
    if (section.model is None) == (section.urdf is None):
        yield f"{at}: an arm has either a model, the folder of its results, or a urdf."
    if section.model is not None and section.tip is not None:
        yield f"{at}.tip: the model has its own; leave it out."
    if section.urdf is not None and section.tool is not None:
        yield f"{at}.tool: a urdf has no tools; give a point on its tip, or a pivot."
    if section.urdf is not None and section.setup is not None:
        yield f"{at}.setup: a urdf has no set-ups; leave it out."
    given = [key for key in ("tool", "point", "pivot") if getattr(section, key) is not None]
    if len(given) > 1 or (section.model is not None and not given):
        yield f"{at}: where the arm's tool point is, one of tool, point and pivot says."


def _of_lens(at: str, section: InstrumentSection) -> Iterator[str]:
    """Yield what a camera lacks: where it is, and a lens, or the size of images from which that is found."""
    if section.camera_on is None:
        yield f"{at}.camera_on: is missing."
    numbers = (*FOCAL, *CENTRE)
    known = {"given": (), "free": (*numbers, *BENT)}.get(section.lens, section.lens)
    for key in section.lens_sigma.by_name:
        if key not in known:
            yield f'{at}.lens_sigma.{key}: {key} is not free; write lens = "free" or name it there.'
        if section.lens_file is None and section.fx is None:
            yield f"{at}.lens_sigma.{key}: is about what is given, and fx, fy, cx, cy are not; leave it out."
    if section.lens_file is not None:
        for key in NAMES:
            if key in section.model_fields_set:
                yield f"{at}.{key}: is given by lens_file as well; keep one of them."
        return
    missing = [key for key in numbers if getattr(section, key) is None]
    free = numbers if section.lens == "free" else () if section.lens == "given" else section.lens
    if missing and (len(missing) < 4 or not set(numbers) <= set(free)):
        yield (
            f'{at}.{missing[0]}: is missing; a camera has {", ".join(numbers)}, or lens = "free" and the size of its '
            "images."
        )
    elif missing and section.size is None:
        yield f"{at}.size: is missing, and no more is known of the lens; write that of its images, like [1920, 1080]."
    bent = [key for key in (*BENT, *RATIONAL) if key in section.model_fields_set]
    if missing and bent:
        yield f"{at}.{bent[0]}: has no effect without fx, fy, cx, cy."


def _words(kind: str) -> str:
    return kind.replace("_", " ")
