"""The job file, schema 1: what a user may write, and one clear sentence for anything else."""

import difflib
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.units import Dimension, parse_quantity
from calib.identification.joint_terms import HIGHEST_ORDER
from calib.identification.losses import Loss
from calib.identification.relations import RelationKind
from calib.measurement.kinds import Kind

_LARGEST_JOB = 1_000_000
# Six digits of each component are enough; half a quaternion or another order of magnitude is not.
_NORM_TOLERANCE = 1e-3
_LONGEST_SHOWN = 60
_MOST_ITERATIONS = 1000
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)

# What stands in a field. Each says itself what is wrong: pydantic's own words are for programmers. ----------------


def _quantity(dimension: Dimension, least: Literal["any", "zero", "more"] = "any") -> Callable[[object], object]:
    """Return a validator of text like ``"0.02 mm"``; ``least`` says which sign it may have."""

    def checked(text: object) -> object:
        if not isinstance(text, str):
            example = {
                "length": "0.02 mm",
                "mass": "5 kg",
                "acceleration": "9.81 m/s2",
                "turning compliance": "10 urad/Nm",
            }.get(dimension, "0.01 deg")
            raise ValueError(f"{_shown(text)} is not a text with a number and a unit, like {example!r}.")
        try:
            value = parse_quantity(text, dimension, "")
        except JobError as e:
            raise ValueError(str(e).removeprefix(": ")) from e
        if value < 0.0 and least == "zero":
            raise ValueError(f"{text!r} is negative; allowed is 0 or more.")
        if value <= 0.0 and least == "more":
            raise ValueError(f"{text!r} is not above 0; leave the key out where it is not known.")
        return text

    return checked


def _list_of(count: int, what: str) -> Callable[[object], object]:
    def checked(value: object) -> object:
        if not isinstance(value, tuple) or len(value) != count:
            raise ValueError(f"{_shown(value)} is not a list of {what}.")
        return value

    return checked


def _unit_quaternion(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = float(np.linalg.norm(value))
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        raise ValueError(f"{_shown(value)} has the norm {norm:.6g}, and must have 1; the order is w, x, y, z.")
    return value


def _some_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not np.linalg.norm(value) > 0.0:
        raise ValueError(f"{_shown(value)} has no direction.")
    return value


def _selection(value: object) -> object:
    names = isinstance(value, tuple) and all(isinstance(name, str) for name in value)
    if not names and value not in ("all", "none"):
        raise ValueError(f"""{_shown(value)} is not "all", "none" or a list of names.""")
    return value


def _not_empty(text: str) -> str:
    if not text:
        raise ValueError("is empty.")
    return text


def _iterations(value: object) -> object:
    if type(value) is not int or not 1 <= value <= _MOST_ITERATIONS:
        raise ValueError(f"{_shown(value)} is not a whole number from 1 to {_MOST_ITERATIONS}.")
    return value


def _orders(value: object) -> object:
    if not isinstance(value, tuple) or not value or not all(type(k) is int and 1 <= k <= HIGHEST_ORDER for k in value):
        raise ValueError(f"{_shown(value)} is not a list of whole numbers from 1 to {HIGHEST_ORDER}.")
    return value


def _this_schema(value: object) -> object:
    # As Python has it, 1 == 1.0 == True.
    if type(value) is not int or value != 1:
        raise ValueError(f"{_shown(value)} is not a schema that this version reads; it must be 1.")
    return value


def _length_or_pixels(text: object) -> object:
    """Accept what the kind of the measurements or of the instrument decides: a length, or pixels."""
    return _quantity("pixel" if isinstance(text, str) and _in_pixels(text) else "length", "zero")(text)


def _compliance(text: object) -> object:
    """Accept what the unit decides: a compliance of what slides, or of what turns."""
    slides = isinstance(text, str) and text.rstrip().endswith("/N")
    return _quantity("sliding compliance" if slides else "turning compliance", "more")(text)


def _in_pixels(text: str) -> bool:
    return text.rstrip().endswith("px")


Name = Annotated[str, AfterValidator(_not_empty)]
Length = Annotated[str, BeforeValidator(_quantity("length"))]
LengthFromZero = Annotated[str, BeforeValidator(_quantity("length", "zero"))]
LengthOrPixelsFromZero = Annotated[str, BeforeValidator(_length_or_pixels)]
Pixels = Annotated[str, BeforeValidator(_quantity("pixel"))]
PositivePixels = Annotated[str, BeforeValidator(_quantity("pixel", "more"))]
Angle = Annotated[str, BeforeValidator(_quantity("angle"))]
PositiveCompliance = Annotated[str, BeforeValidator(_compliance)]
AngleFromZero = Annotated[str, BeforeValidator(_quantity("angle", "zero"))]
PositiveLength = Annotated[str, BeforeValidator(_quantity("length", "more"))]
PositiveAngle = Annotated[str, BeforeValidator(_quantity("angle", "more"))]
Position = Annotated[tuple[Length, Length, Length], BeforeValidator(_list_of(3, "three lengths x, y, z"))]
MassFromZero = Annotated[str, BeforeValidator(_quantity("mass", "zero"))]
Acceleration = Annotated[str, BeforeValidator(_quantity("acceleration"))]
Gravity = Annotated[
    tuple[Acceleration, Acceleration, Acceleration],
    BeforeValidator(_list_of(3, 'three accelerations, like ["0 m/s2", "0 m/s2", "-9.81 m/s2"]')),
]
Quaternion = Annotated[
    tuple[float, float, float, float],
    BeforeValidator(_list_of(4, "four numbers w, x, y, z")),
    AfterValidator(_unit_quaternion),
]
Direction = Annotated[
    tuple[float, float, float], BeforeValidator(_list_of(3, "three numbers x, y, z")), AfterValidator(_some_length)
]
Selection = Annotated[Literal["all", "none"] | tuple[str, ...], BeforeValidator(_selection)]


# The sections. -----------------------------------------------------------------------------------------------------


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class CouplingSection(_Section):
    """``[[robot.coupling]]``: a joint that follows several drivers, which URDF's mimic cannot say."""

    joint: Name
    drivers: dict[str, float] = Field(min_length=1)
    offset: Angle = "0 rad"


class LoopSection(_Section):
    """``[[robot.loop]]``: two links whose origins coincide in directions of the first one's frame."""

    name: Name
    frames: tuple[Name, Name]
    closes: tuple[Literal["x", "y", "z"], ...] = Field(min_length=1)
    passive: tuple[Name, ...] = Field(min_length=1)


class PayloadSection(_Section):
    """``payload`` of ``[robot]``: what the tip link carries."""

    mass: MassFromZero
    position: Position = ("0 m", "0 m", "0 m")


class RobotSection(_Section):
    """``[robot]``: the URDF, the links between which the arm is calibrated, and folders that hold its meshes.

    ``gravity`` in the base link, and ``payload``, matter where drives give way.
    """

    urdf: Name
    tip: str | None = None
    base: str | None = None
    mesh_roots: tuple[Name, ...] = ()
    gravity: Gravity = ("0 m/s2", "0 m/s2", "-9.80665 m/s2")
    payload: PayloadSection | None = None
    coupling: tuple[CouplingSection, ...] = ()
    loop: tuple[LoopSection, ...] = ()


class PriorSection(_Section):
    """``prior``: standard deviations that offsets and placements are expected to have, and amounts of joint terms."""

    length: PositiveLength | None = None
    angle: PositiveAngle | None = None
    harmonics: PositiveAngle | None = None
    elastic: PositiveCompliance | None = None


class ErrorModelSection(_Section):
    """``[error_model]``: what is free."""

    offsets: Selection = "none"
    placements: Selection = "none"
    dh: Selection = "none"
    dh_convention: Literal["standard", "modified"] = "standard"
    dh_parallel: PositiveAngle = "0.01 rad"
    terms: Literal["given", "auto"] = "given"
    gain: Selection = "none"
    harmonics: Selection = "none"
    harmonic_orders: Annotated[tuple[int, ...], BeforeValidator(_orders)] = (1, 2)
    elastic: Selection = "none"
    torque: Selection = "none"
    backlash: Selection = "none"
    thermal: Selection = "none"
    base: Literal["pose", "fixed"] = "pose"
    tool: Literal["pose", "position", "fixed"] = "position"
    prior: PriorSection = PriorSection()
    blind: Literal["nearest", "minimal", "refuse"] = "nearest"


class FrameSection(_Section):
    """``[base]`` or ``[tools.NAME]``: a known pose; the quaternion's order is w, x, y, z."""

    position: Position
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)


class TargetSection(_Section):
    """``[targets.NAME]``: what is known of a point, a board or camera (position and quaternion), or a plane.

    Of a plane its normal is known, and perhaps its height along it.
    """

    position: Position | None = None
    quaternion: Quaternion | None = None
    normal: Direction | None = None
    height: Length | None = None


class RelationSection(_Section):
    """``[[relations]]``: one number known of two targets. An angle's sigma is an angle, that of the others a length."""

    targets: Annotated[tuple[Name, Name], BeforeValidator(_list_of(2, "two names"))]
    distance: LengthFromZero | None = None
    angle: AngleFromZero | None = None
    offset: Length | None = None
    sigma: str

    @property
    def kind(self) -> RelationKind:
        """Which number is known."""
        return next(kind for kind in get_args(RelationKind) if getattr(self, kind) is not None)


class InstrumentSection(_Section):
    """``[instruments.NAME]``: what measured. Sigmas are one standard deviation of each coordinate.

    An ``arm`` measures by its joint readings: its ``model``, a folder of results, or its ``urdf`` and ``tip``; where
    its tool point is: a ``tool`` of the model, a ``point`` on the tip link, or found by a ``pivot``, a table of
    touches. A laser tracker has a station; a camera is on the floor or on the tip, and has OpenCV's numbers.
    """

    kind: Literal["laser_tracker", "arm", "camera"]
    sigma: LengthOrPixelsFromZero
    sigma_per_metre: LengthFromZero = "0 um"
    station: Position = ("0 m", "0 m", "0 m")
    model: Name | None = None
    urdf: Name | None = None
    tip: Name | None = None
    tool: Name | None = None
    point: Position | None = None
    pivot: Name | None = None
    camera_on: Literal["floor", "tip"] | None = None
    fx: PositivePixels | None = None
    fy: PositivePixels | None = None
    cx: Pixels | None = None
    cy: Pixels | None = None
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0


class SolverSection(_Section):
    """``[solver]``: how the parameters are found; the other keys belong to the total differential."""

    kind: Literal["least_squares", "total_differential"] = "least_squares"
    stop: PositiveLength = "0.3 mm"
    rounding: PositiveAngle | None = None
    most: Annotated[int, BeforeValidator(_iterations)] = 20


class ResidualModelSection(_Section):
    """``residual_model`` of a level: errors over some joints, kept in axes of ``frame``.

    Those of a grid are measured at its nodes. A Gaussian process follows all joints where none are named, and takes the
    nodes, or, where there are none, what the job identifies from.
    """

    kind: Literal["grid", "gaussian_process"]
    joints: tuple[Name, ...] | None = Field(default=None, min_length=1)
    frame: Literal["base", "tip"] = "base"


class LevelSection(_Section):
    """``[[levels]]``: one step of several; each begins with what the one before has found.

    ``free``: names and globs among the parameters that ``[error_model]`` frees; or, in the last level, a
    ``residual_model`` of what they leave unexplained. ``measurements``: files to identify from, all of them when left
    out; files of nodes for a residual model.
    """

    name: Name
    free: tuple[Name, ...] = ()
    measurements: tuple[Name, ...] | None = None
    residual_model: ResidualModelSection | None = None


class MeasurementsSection(_Section):
    """``[[measurements]]``: one table."""

    file: Name
    observes: Kind = "position"
    sigma: PositiveLength | None = None
    sigma_angle: PositiveAngle | None = None
    instrument: str | None = None
    length_offset: Name | None = None
    use: Literal["identify", "validate", "nodes"] = "identify"
    model_sigma: LengthOrPixelsFromZero | None = None
    model_sigma_angle: AngleFromZero | None = None
    loss: Loss = "linear"
    in_order: bool = False
    columns: dict[str, str] = Field(default_factory=dict)
    targets: dict[str, Name] = Field(default_factory=dict)


class Job(_Section):
    """A whole job."""

    schema_: Annotated[Literal[1], BeforeValidator(_this_schema)] = Field(alias="schema")
    robot: RobotSection
    error_model: ErrorModelSection = ErrorModelSection()
    solver: SolverSection = SolverSection()
    base: FrameSection | None = None
    tools: dict[str, FrameSection] = Field(default_factory=dict)
    instruments: dict[str, InstrumentSection] = Field(default_factory=dict)
    targets: dict[str, TargetSection] = Field(default_factory=dict)
    relations: tuple[RelationSection, ...] = ()
    levels: tuple[LevelSection, ...] = ()
    measurements: tuple[MeasurementsSection, ...] = Field(min_length=1)


_HEADERS: dict[type[BaseModel], str] = {
    Job: "",
    RobotSection: "[robot]",
    ErrorModelSection: "[error_model]",
    PriorSection: "prior of [error_model]",
    PayloadSection: "payload of [robot]",
    FrameSection: "[base] or [tools.NAME]",
    InstrumentSection: "[instruments.NAME]",
    TargetSection: "[targets.NAME]",
    RelationSection: "[[relations]]",
    MeasurementsSection: "[[measurements]]",
}


# From a file to a job. ---------------------------------------------------------------------------------------------


def read_job(path: Path) -> Job:
    """Read a job file. Raises JobError with the file, the key, the value and what is allowed."""
    source = read_bytes(path, JobError, _LARGEST_JOB)
    try:
        contents = tomllib.loads(source.decode("utf-8-sig"))
    except UnicodeDecodeError as e:
        raise JobError(f"{path}: is not UTF-8 text.") from e
    except RecursionError as e:
        raise JobError(f"{path}: is nested too deep.") from e
    except ValueError as e:  # beside TOMLDecodeError also that of a number with thousands of digits
        reason = str(e) if isinstance(e, tomllib.TOMLDecodeError) else "a number has too many digits"
        raise JobError(f"{path}: is not TOML: {reason}.") from e
    return parse_job(contents, str(path))


def parse_job(contents: dict[str, Any], where: str) -> Job:
    """Return the job of a parsed TOML document. Raises JobError as :func:`read_job` does."""
    try:
        # TOML knows arrays; tuples are how a frozen job keeps them.
        job = Job.model_validate(_tuples(contents))
    except RecursionError as e:
        raise JobError(f"{where}: is nested too deep.") from e
    except ValidationError as e:
        raise JobError(f"{where}: {_sentence(e)}") from e
    for sentence in _contradictions(job):
        raise JobError(f"{where}: {sentence}")
    return job


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(v) for key, v in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _contradictions(job: Job) -> Iterator[str]:
    """Yield what no single field can know: keys that point nowhere, or that another key makes meaningless."""
    for name, instrument in job.instruments.items():
        yield from _instrument_contradictions(_dotted(("instruments", name)), instrument)
    for i, section in enumerate(job.measurements):
        yield from _measurement_contradictions(job, f"measurements[{i}]", section)
    if job.error_model.terms == "auto":
        for key in ("gain", "harmonics", "elastic", "torque", "backlash", "thermal"):
            if getattr(job.error_model, key) != "none":
                yield f'error_model.{key}: is chosen where terms = "auto"; leave one of them out.'
    for i, level in enumerate(job.levels):
        residual = level.residual_model
        if residual is not None and residual.kind == "grid" and residual.joints is None:
            yield f"levels[{i}].residual_model.joints: is missing; a grid spans joints that are named."
    if not any(section.use == "identify" for section in job.measurements):
        yield 'measurements: none has use = "identify"; there is nothing to identify from.'
    for name, target in job.targets.items():
        if (target.position is None) == (target.normal is None):
            yield f"targets.{name}: a point has a position, a plane a normal; give one of them."
        if target.quaternion is not None and target.position is None:
            yield f"targets.{name}.quaternion: belongs to a position, and there is none."
        if target.height is not None and target.normal is None:
            yield f"targets.{name}.height: belongs to a normal, and there is none."
    for i, relation in enumerate(job.relations):
        yield from _relation_contradictions(f"relations[{i}]", relation)
    if job.base is not None and job.error_model.base != "fixed":
        yield 'base: a pose is given, and error_model.base leaves it free; write base = "fixed" there.'
    if job.tools and job.error_model.tool != "fixed":
        yield 'tools: poses are given, and error_model.tool leaves them free; write tool = "fixed" there.'


def _measurement_contradictions(job: Job, at: str, section: MeasurementsSection) -> Iterator[str]:
    measured_by = job.instruments.get(section.instrument or "")
    if measured_by is not None and measured_by.kind == "arm" and section.observes != "position":
        yield f'{at}.observes: an arm that touches sees positions only; write "position".'
    if section.instrument is not None and section.instrument not in job.instruments:
        known = ", ".join(map(repr, job.instruments)) or "none"
        yield f"{at}.instrument: {section.instrument!r} is not declared; there are {known}."
    if section.instrument is not None and section.sigma is not None:
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
                yield f'{at}.{key}: means nothing with use = "validate"; leave it out.'
    if section.use != "identify" and section.loss != "linear":
        yield f'{at}.loss: means nothing with use = "{section.use}"; leave it out.'


def _relation_contradictions(at: str, relation: RelationSection) -> Iterator[str]:
    given = [kind for kind in get_args(RelationKind) if getattr(relation, kind) is not None]
    if len(set(relation.targets)) < len(relation.targets):
        yield f"{at}.targets: {relation.targets[0]!r} comes twice; a relation is between two."
    if len(given) != 1:
        yield f"{at}: says {' and '.join(given) or 'nothing'}; give one of distance, angle, offset."
    else:
        try:
            sigma = parse_quantity(relation.sigma, "angle" if given == ["angle"] else "length", "")
        except JobError as e:
            yield f"{at}.sigma: {str(e).removeprefix(': ')}"
        else:
            if not sigma > 0.0:
                yield f"{at}.sigma: {relation.sigma!r} is not above 0."


def _of_pixels(section: MeasurementsSection, job: Job, at: str) -> Iterator[str]:
    """Yield what is wrong with pixels and cameras of one section of measurements."""
    if section.instrument is None:
        if section.observes == "pixels":
            yield f"{at}.instrument: is missing; pixels need the camera that saw them."
    elif section.instrument in job.instruments:
        kind = job.instruments[section.instrument].kind
        if (kind == "camera") != (section.observes == "pixels"):
            yield f"{at}.instrument: a {_words(kind)} measures no {section.observes}."
    if section.observes == "pixels" and section.sigma is not None:
        yield f"{at}.sigma: the noise of pixels is the camera's; give it there."
    if section.model_sigma is not None and _in_pixels(section.model_sigma) != (section.observes == "pixels"):
        unit = "pixels, like '0.1 px'" if section.observes == "pixels" else "a length, like '0.02 mm'"
        yield f"{at}.model_sigma: {section.model_sigma!r} does not fit what is observed; allowed are {unit}."


_KEYS_OF: Mapping[str, tuple[str, ...]] = {
    "laser_tracker": ("sigma_per_metre", "station"),
    "arm": ("model", "urdf", "tip", "tool", "point", "pivot"),
    "camera": ("camera_on", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
}


def _instrument_contradictions(at: str, section: InstrumentSection) -> Iterator[str]:
    """Yield keys that an instrument lacks, or that belong to another kind."""
    for key in [key for kind, keys in _KEYS_OF.items() if kind != section.kind for key in keys]:
        if key in section.model_fields_set:
            yield f'{at}.{key}: means nothing with kind = "{section.kind}"; leave it out.'
    if _in_pixels(section.sigma) != (section.kind == "camera"):
        unit = "pixels, like '0.2 px'" if section.kind == "camera" else "a length, like '7.5 um'"
        yield f"{at}.sigma: {section.sigma!r} is not of a {_words(section.kind)}; allowed are {unit}."
    if section.kind == "camera":
        needed = _KEYS_OF["camera"][:5]
        for key in needed:
            if getattr(section, key) is None:
                yield f"{at}.{key}: is missing; a camera has {', '.join(needed)} and sigma."
    if section.kind != "arm":
        return
    if (section.model is None) == (section.urdf is None):
        yield f"{at}: an arm has either a model, the folder of its results, or a urdf."
    if section.model is not None and section.tip is not None:
        yield f"{at}.tip: the model has its own; leave it out."
    if section.urdf is not None and section.tool is not None:
        yield f"{at}.tool: a urdf has no tools; give a point on its tip, or a pivot."
    given = [key for key in ("tool", "point", "pivot") if getattr(section, key) is not None]
    if len(given) > 1 or (section.model is not None and not given):
        yield f"{at}: where the arm's tool point is, one of tool, point and pivot says."


def _words(kind: str) -> str:
    return kind.replace("_", " ")


# One sentence for what is wrong. -----------------------------------------------------------------------------------


def _sentence(error: ValidationError) -> str:
    """Return the first thing to mend: another schema explains all else, and unknown keys most missing ones."""

    def order(e: ErrorDetails) -> int:
        return 0 if e["loc"] == ("schema",) and e["type"] == "value_error" else 1 + (e["type"] != "extra_forbidden")

    first = min(error.errors(include_url=False), key=order)
    key, kind, value = _dotted(first["loc"]), first["type"], first["input"]
    if kind == "extra_forbidden":
        *section, name = first["loc"]
        return f"{key}: is not a known key; {_hint(str(name), _section(section))}"
    if kind == "missing":
        return f"{key}: is missing."
    if kind == "value_error":
        return f"{key}: {first['ctx']['error']}"
    if kind == "literal_error":
        return f"{key}: {_shown(value)} is not allowed; it must be {first['ctx']['expected']}."
    if kind == "too_short":
        return f"{key}: is empty."
    if kind == "tuple_type" and isinstance(value, dict):
        return f"{key}: is one section; write [[{key}]] with two brackets, once for each."
    if kind in ("model_type", "dict_type") and isinstance(value, tuple) and any(isinstance(v, dict) for v in value):
        return f"{key}: is a list of sections; write [{key}] with single brackets, once."
    expected = {
        "string_type": "a text",
        "float_type": "a number",
        "bool_type": "true or false",
        "finite_number": "a finite number",
        "tuple_type": "a list",
        "model_type": "a section with keys",
        "dict_type": "a section with keys",
    }
    return f"{key}: {_shown(value)} is not {expected.get(kind, 'allowed')}."


def _hint(name: str, section: type[BaseModel]) -> str:
    """Return the end of the sentence about an unknown key: where it belongs, or which key is near."""
    homes = [header for other, header in _HEADERS.items() if name in _keys(other)]
    if homes:
        return f"it belongs in {' or '.join(homes)}." if homes != [""] else "it belongs at the top of the file."
    known = _keys(section)
    if near := difflib.get_close_matches(name[:_LONGEST_SHOWN], known, 1):
        return f"did you mean {near[0]!r}?"
    for other, header in _HEADERS.items():
        if near := difflib.get_close_matches(name[:_LONGEST_SHOWN], _keys(other), 1, 0.8):
            return f"did you mean {near[0]!r} in {header}?" if header else f"did you mean {near[0]!r}?"
    return f"allowed are {', '.join(known)}."


def _section(location: list[int | str]) -> type[BaseModel]:
    """Return the section at a location; indices and the user's own names stand between a field and its section."""
    section: type[BaseModel] = Job
    for part in location:
        field = section.model_fields.get(str(part))
        if field is not None:
            section = next(filter(_is_section, (field.annotation, *get_args(field.annotation))), section)
    return section


def _is_section(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _keys(section: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in section.model_fields.items()]


def _dotted(location: tuple[int | str, ...]) -> str:
    """Return a location as a user writes it: ``measurements[0].sigma``, ``tools."left ball".position``."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if len(part) <= _LONGEST_SHOWN else f"{part[:_LONGEST_SHOWN]}..."
            name = name if _BARE_KEY.fullmatch(part) else json.dumps(name)
            text += f".{name}" if text else name
    return text


def _shown(value: object) -> str:
    """Return a value as TOML has it, short enough for a sentence."""
    if isinstance(value, dict):
        return "a section with keys"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value[:5]))}{', ...' if len(value) > 5 else ''}]"
    if isinstance(value, bool):
        return str(value).lower()
    text = str(value)
    text = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
    return repr(text) if isinstance(value, str) else text
