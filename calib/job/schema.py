"""The job file, schema 1: the sections that a user may write."""

from typing import Annotated, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from calib.identification.losses import Loss
from calib.identification.relations import RelationKind
from calib.job.fields import (
    AngleFromZero,
    AngleOrLength,
    AnglePrior,
    CompliancePrior,
    Direction,
    Gravity,
    Length,
    LengthFromZero,
    LengthOrPixelsFromZero,
    LengthPrior,
    LinkSelection,
    MassFromZero,
    Name,
    Pixels,
    Position,
    PositiveAngle,
    PositiveLength,
    PositivePixels,
    Quaternion,
    Selection,
    Share,
    iterations,
    list_of,
    orders,
    this_schema,
)
from calib.measurement.kinds import Kind


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class CouplingSection(_Section):
    """``[[robot.coupling]]``: a joint that follows several drivers, which URDF's mimic cannot say.

    ``offset``: an angle, or a length where the joint slides.
    """

    joint: Name
    drivers: dict[str, float] = Field(min_length=1)
    offset: AngleOrLength | None = None


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
    """``prior``: standard deviations that offsets and placements are expected to have, and amounts of joint terms.

    Or "learned": what the data teach of parameters that are alike.
    """

    length: LengthPrior | None = None
    angle: AnglePrior | None = None
    harmonics: AnglePrior | None = None
    elastic: CompliancePrior | None = None


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
    harmonic_orders: Annotated[tuple[int, ...], BeforeValidator(orders)] = (1, 2)
    elastic: Selection = "none"
    torque: Selection = "none"
    backlash: Selection = "none"
    thermal: Selection = "none"
    moments: Selection = "none"
    bending: Selection = "none"
    expansion: LinkSelection = "none"
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

    targets: Annotated[tuple[Name, Name], BeforeValidator(list_of(2, "two names"))]
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
    most: Annotated[int, BeforeValidator(iterations)] = 20


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
    """``[[measurements]]``: one table. ``hold_out``: share of its groups of rows by which the rest is judged."""

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
    hold_out: Share | None = None
    in_order: bool = False
    columns: dict[str, str] = Field(default_factory=dict)
    targets: dict[str, Name] = Field(default_factory=dict)


class Job(_Section):
    """A whole job."""

    schema_: Annotated[Literal[1], BeforeValidator(this_schema)] = Field(alias="schema")
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
