"""The job file, schema 1: the sections that a user may write."""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, create_model

from calib.assessment.judged import Accepted
from calib.foundations.ranges import COUNTS
from calib.identification.losses import Loss
from calib.identification.relations import RelationKind
from calib.job import fields
from calib.job.fields import FileName, Name, Names, Quantity, at_most, quantity
from calib.measurement.boards import SQUARE_SIGMA
from calib.measurement.kinds import Kind
from calib.measurement.lens import CENTRE, FOCAL, NAMES
from calib.measurement.prints import PrintKind, PrintShape
from calib.robot.terms import KINDS

# Asked before anything of the entries is.
AT_MOST = {key: BeforeValidator(at_most(count)) for key, count in COUNTS.items()}
_NOTHING, _DOWN = (quantity("gravity")(text) for text in ("0 m/s2", "-9.80665 m/s2"))
_GRAVITY = (_NOTHING, _NOTHING, _DOWN)
_ORIGIN = (quantity("position, station, point")("0 m"),) * 3
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)


# The word for what does not move; it wins over a link of that name.
FLOOR = "floor"


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


class CouplingSection(_Section):
    """``[[robot.coupling]]``: a joint that follows several drivers, which URDF's mimic cannot say.

    ``offset``: an angle, or a length where the joint slides.
    """

    joint: Name
    drivers: Annotated[dict[str, fields.Multiple], Field(min_length=1), AT_MOST["robot.coupling.drivers"]]
    offset: fields.CouplingOffset | None = None


class LoopSection(_Section):
    """``[[robot.loop]]``: two links whose origins coincide in directions of the first one's frame."""

    name: Name
    frames: tuple[Name, Name]
    closes: tuple[Literal["x", "y", "z"], ...] = Field(min_length=1)
    passive: Annotated[Names, Field(min_length=1)]


class PayloadSection(_Section):
    """``payload``: what a link carries, the tip where none is named, of a table its own."""

    mass: Annotated[Quantity, PlainValidator(quantity("mass"))]
    position: fields.Position = _ORIGIN
    link: Name | None = None


class AboutSection(_Section):
    """``[about]``: what the report says of the calibration besides its figures."""

    date: fields.AboutDate | None = None
    serial: fields.AboutWords | None = None
    operator: fields.AboutWords | None = None
    note: fields.AboutWords | None = None


class RobotSection(_Section):
    """``[robot]``: the URDF, the links between which the arm is calibrated, and folders that hold its meshes.

    ``gravity`` in the base link, and ``payload``, matter where drives give way; ``links``: others whose joints are read
    for what hangs on them.
    """

    urdf: FileName
    tip: str | None = None
    base: str | None = None
    links: Names = ()
    mesh_roots: Annotated[tuple[FileName, ...], AT_MOST["robot.mesh_roots"]] = ()
    gravity: fields.Gravity = _GRAVITY
    payload: PayloadSection | None = None
    coupling: Annotated[tuple[CouplingSection, ...], AT_MOST["robot.coupling"]] = ()
    loop: Annotated[tuple[LoopSection, ...], AT_MOST["robot.loop"]] = ()


class PriorSection(_Section):
    """``prior``: standard deviations that offsets and placements are expected to have, and coefficients of joint terms.

    Or "learned": what the data teach of parameters that are alike.
    """

    length: fields.LengthPrior | None = None
    angle: fields.AnglePrior | None = None
    harmonics: fields.HarmonicsPrior | None = None
    elastic: fields.CompliancePrior | None = None


# A key for every kind of joint terms, and those beside it.
_TERM_KEYS: Any = {
    **{
        kind.key: (Annotated[Any, BeforeValidator(fields.selection(*kind.words, "all", "none"))], "none")
        for kind in KINDS
    },
    **{
        name: (Annotated[Any, BeforeValidator(fields.term_option(name, option))], option.default)
        for kind in KINDS
        for name, option in kind.options.items()
    },
}

if TYPE_CHECKING:
    _Terms = _Section
else:
    _Terms = create_model("_Terms", __base__=_Section, **_TERM_KEYS)


class ErrorModelSection(_Terms):
    """``[error_model]``: what is free."""

    offsets: fields.Selection = "none"
    placements: fields.Selection = "none"
    dh: fields.Selection = "none"
    dh_convention: Literal["standard", "modified"] = "standard"
    dh_parallel: Annotated[Quantity, PlainValidator(quantity("error_model.dh_parallel"))] = quantity(
        "error_model.dh_parallel"
    )("0.01 rad")
    terms: Literal["given", "auto"] = "given"
    base: Literal["pose", "fixed"] = "pose"
    tool: Literal["pose", "position", "fixed"] = "position"
    prior: PriorSection = PriorSection()
    null_space: Literal["nearest", "minimal", "refuse"] = "nearest"

    @property
    def chosen_terms(self) -> dict[str, object]:
        """The keys of joint terms with their values, as :func:`calib.error_model` takes them."""
        return {key: getattr(self, key) for key in _TERM_KEYS}


class FrameSection(_Section):
    """``[tools.NAME]``: a known pose; the quaternion's order is w, x, y, z."""

    position: fields.Position
    quaternion: fields.Quaternion = _UPRIGHT


class BasePriorSection(_Section):
    """``prior`` of a base: standard deviations of its positions and of its angles."""

    length: Annotated[Quantity, PlainValidator(quantity("prior.length"))]
    angle: Annotated[Quantity, PlainValidator(quantity("prior.angle"))]


class BaseSection(FrameSection):
    """``[base]``: where the base stood, exactly, or about where a ``prior`` is given."""

    prior: BasePriorSection | None = None


class SetupSection(_Section):
    """``[setups.NAME]``: where the base stood, as ``[base]`` has it, or not known; and what bore on the robot there."""

    position: fields.Position | None = None
    quaternion: fields.Quaternion | None = None
    prior: BasePriorSection | None = None
    gravity: fields.Gravity | None = None
    payload: PayloadSection | None = None

    @property
    def base(self) -> BaseSection | None:
        """Where the base stood, None where that is to be found."""
        if self.position is None:
            return None
        return BaseSection(position=self.position, quaternion=self.quaternion or _UPRIGHT, prior=self.prior)


class TargetSection(_Section):
    """``[targets.NAME]``: what is known of a point, a board or camera (position and quaternion), or a plane.

    Of a plane its normal is known, and perhaps its height along it. All of it in the link that the target is ``on``, or
    in the instrument's frame where it stands on the floor.
    """

    on: Name = FLOOR

    position: fields.Position | None = None
    quaternion: fields.Quaternion | None = None
    normal: fields.Direction | None = None
    height: Annotated[Quantity, PlainValidator(quantity("height"))] | None = None

    @property
    def says_where(self) -> bool:
        """Whether something is known of the place."""
        return self.position is not None or self.normal is not None


class RelationSection(_Section):
    """``[[relations]]``: one number known of two targets. An angle's sigma is an angle, that of the others a length."""

    targets: Annotated[tuple[Name, Name], BeforeValidator(fields.list_of(2, "two names"))]
    distance: Annotated[Quantity, PlainValidator(quantity("relations.distance"))] | None = None
    angle: Annotated[Quantity, PlainValidator(quantity("relations.angle"))] | None = None
    offset: Annotated[Quantity, PlainValidator(quantity("relations.offset"))] | None = None
    sigma: fields.RelationSigma

    @property
    def kind(self) -> RelationKind:
        """Which number is known."""
        return next(kind for kind in get_args(RelationKind) if getattr(self, kind) is not None)


_SIGMAS: Any = {
    name: (fields.LensSigma | None if name in (*FOCAL, *CENTRE) else fields.DistortionSigma | None, None)
    for name in NAMES
}

if TYPE_CHECKING:
    _LensSigmas = _Section
else:
    _LensSigmas = create_model("_LensSigmas", __base__=_Section, **_SIGMAS)


class LensSigmaSection(_LensSigmas):
    """``lens_sigma`` of a camera: standard deviations of free numbers of its lens about those given."""

    @property
    def by_name(self) -> dict[str, float]:
        """What is stated, in px or without unit, by the number of the lens."""
        stated = {name: getattr(self, name) for name in NAMES}
        return {name: getattr(value, "si", value) for name, value in stated.items() if value is not None}


class InstrumentSection(_Section):
    """``[instruments.NAME]``: what measured. Sigmas are one standard deviation of each coordinate.

    An ``arm`` measures by its joint readings: its ``model``, a folder of results, or its ``urdf`` and ``tip``; where
    its tool point is: a ``tool`` of the model, a ``point`` on the tip link, or found by a ``pivot``, a table of
    touches; in which ``setup`` of the model it stands, where it sags otherwise in others.

    A laser tracker has a station; a camera is on the floor, the tip or a link, and has OpenCV's numbers: a ``lens``
    that is given, or free, in which case the ``size`` of its images is enough; or numbers of it that are free.
    ``lens_file``: a YAML of OpenCV, ROS or Kalibr, or an .npz, that gives the numbers; ``lens_sigma``: how well they
    are known.
    """

    kind: Literal["laser_tracker", "arm", "camera"]
    sigma: fields.InstrumentSigma | None = None
    sigma_per_metre: Annotated[Quantity, PlainValidator(quantity("sigma_per_metre"))] = quantity("sigma_per_metre")(
        "0 um"
    )
    station: fields.Position = _ORIGIN
    model: FileName | None = None
    urdf: FileName | None = None
    tip: Name | None = None
    setup: Name | None = None
    tool: Name | None = None
    point: fields.Position | None = None
    pivot: FileName | None = None
    camera_on: Annotated[Any, BeforeValidator(fields.camera_place)] = None
    fx: fields.FocalLength | None = None
    fy: fields.FocalLength | None = None
    cx: fields.PrincipalPoint | None = None
    cy: fields.PrincipalPoint | None = None
    k1: fields.Distortion = 0.0
    k2: fields.Distortion = 0.0
    p1: fields.Distortion = 0.0
    p2: fields.Distortion = 0.0
    k3: fields.Distortion = 0.0
    k4: fields.Distortion = 0.0
    k5: fields.Distortion = 0.0
    k6: fields.Distortion = 0.0
    lens: Annotated[Any, BeforeValidator(fields.free_of_lens)] = "given"
    lens_sigma: LensSigmaSection = LensSigmaSection()
    size: fields.Counts | None = None
    lens_file: FileName | None = None


class BoardSection(_Section):
    """A ``board.toml``: what was printed, how well its scale is known, and which shape the print may have."""

    kind: PrintKind
    squares: fields.Counts
    square: fields.PrintedLength
    marker: fields.PrintedLength | None = None
    dictionary: str = ""
    square_sigma: fields.PrintedShare = SQUARE_SIGMA
    shape: PrintShape = "auto"


class SolverSection(_Section):
    """``[solver]``: how the parameters are found; the other keys belong to the total differential."""

    kind: Literal["least_squares", "total_differential"] = "least_squares"
    stop: Annotated[Quantity, PlainValidator(quantity("solver.stop"))] = quantity("solver.stop")("0.3 mm")
    rounding: Annotated[Quantity, PlainValidator(quantity("solver.rounding"))] | None = None
    most: Annotated[int, BeforeValidator(fields.iterations)] = 20


class ResidualModelSection(_Section):
    """``residual_model`` of a level: errors over some joints, kept in axes of ``frame``.

    Those of a grid are measured at its nodes. A Gaussian process follows all joints where none are named, and takes the
    nodes, or, where there are none, what the job identifies from.
    """

    kind: Literal["grid", "gaussian_process"]
    joints: Annotated[Names, Field(min_length=1)] | None = None
    frame: Literal["base", "tip"] = "base"


class LevelSection(_Section):
    """``[[levels]]``: one step of several; each begins with what the one before has found.

    ``free``: names and globs among the parameters that ``[error_model]`` frees; or, in the last level, a
    ``residual_model`` of what they leave unexplained. ``measurements``: files to identify from, all of them when left
    out; files of nodes for a residual model.
    """

    name: Name
    free: Names = ()
    measurements: Annotated[Names, Field(min_length=1)] | None = None
    residual_model: ResidualModelSection | None = None


class MeasurementsSection(_Section):
    """``[[measurements]]``: one table. ``hold_out``: share of its groups of rows by which the rest is judged.

    Of a stream, ``readings`` is the file of its joints, and ``clock`` says whether both are one clock; ``latency``, of
    a given clock, or of that of another stream, ``clock_of``, whether measurements come late; longer gaps than ``gap``
    are not bridged.
    ``board``: the board.toml of what a camera saw.
    """

    file: FileName
    readings: FileName | None = None
    clock: Literal["free", "given"] | None = None
    clock_of: Name | None = None
    latency: Literal["free"] | None = None
    gap: Annotated[Quantity, PlainValidator(quantity("gap"))] | None = None
    observes: Kind = "position"
    sigma: fields.Sigma | None = None
    sigma_angle: fields.SigmaAngle | None = None
    instrument: str | None = None
    board: FileName | None = None
    tip: Name | None = None
    tool: Name | None = None
    setup: Name | None = None
    payload: PayloadSection | None = None
    length_offset: Name | None = None
    use: Literal["identify", "validate", "nodes"] = "identify"
    model_sigma: fields.ModelSigma | None = None
    model_sigma_angle: Annotated[Quantity, PlainValidator(quantity("model_sigma_angle"))] | None = None
    loss: Loss = "linear"
    hold_out: fields.Share | None = None
    in_order: bool = False
    columns: Annotated[dict[str, str], AT_MOST["measurements.columns"]] = Field(default_factory=dict)
    ignore: Names = ()
    orientation: Annotated[str | None, BeforeValidator(fields.orientation_name)] = None
    targets: Annotated[dict[str, Name], AT_MOST["measurements.targets"]] = Field(default_factory=dict)


class Job(_Section):
    """A whole job. ``accept``: checks of the verdict that the user answers for, and that do not count."""

    schema_: Annotated[Literal[1], BeforeValidator(fields.this_schema)] = Field(alias="schema")
    about: AboutSection = AboutSection()
    robot: RobotSection
    error_model: ErrorModelSection = ErrorModelSection()
    accept: tuple[Accepted, ...] = ()
    solver: SolverSection = SolverSection()
    base: BaseSection | None = None
    setups: Annotated[dict[str, SetupSection], AT_MOST["setups"]] = Field(default_factory=dict)
    tools: Annotated[dict[str, FrameSection], AT_MOST["tools"]] = Field(default_factory=dict)
    instruments: Annotated[dict[str, InstrumentSection], AT_MOST["instruments"]] = Field(default_factory=dict)
    targets: Annotated[dict[str, TargetSection], AT_MOST["targets"]] = Field(default_factory=dict)
    relations: Annotated[tuple[RelationSection, ...], AT_MOST["relations"]] = ()
    levels: Annotated[tuple[LevelSection, ...], AT_MOST["levels"]] = ()
    measurements: Annotated[tuple[MeasurementsSection, ...], Field(min_length=1), AT_MOST["measurements"]]


def named_files(section: BaseModel) -> Iterator[tuple[str, str]]:
    """Give the key and the name of every file, and folder of files, that a job, or a section of one, has read."""
    for key, field in type(section).model_fields.items():
        value = getattr(section, key)
        values = value.values() if isinstance(value, Mapping) else value if isinstance(value, tuple) else (value,)
        for one in values:
            if isinstance(one, BaseModel):
                yield from named_files(one)
            elif one is not None and _is_read(field.metadata, field.annotation):
                yield key, one


def _is_read(marks: Iterable[object], kind: Any) -> bool:
    """Return whether a kind of value, with its marks, is that of a file, or holds such ones."""
    return fields.READ in marks or any(_is_read(getattr(one, "__metadata__", ()), one) for one in get_args(kind))
