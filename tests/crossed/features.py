"""The features of a job that carry state: what calibrations, and all that is made of them, must not lose.

A new feature joins the matrix by one more ``Feature`` in ``FEATURES``; two that do not go together by one more
``Refusal`` in ``REFUSALS``, with the sentence that says so. Keys of a job that are in neither are in ``EXEMPT``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, get_args

from calib.measurement import kinds as measured
from calib.measurement.lens import NAMES
from calib.robot.conditions import NO_CONDITIONS
from calib.robot.terms import KINDS, JointTerm, Kind
from tests.support import machines
from tests.support.loops import four_bar_urdf

# A six-axis arm whose links weigh something, from ``base`` to ``tip``.
_JOINTS = (
    ("joint_1", "revolute", "0 0 0.30", "0 0 1"),
    ("joint_2", "revolute", "0.05 0 0.10", "0 1 0"),
    ("joint_3", "revolute", "0 0 0.40", "0 1 0"),
    ("joint_4", "revolute", "0.20 0 0.02", "1 0 0"),
    ("joint_5", "revolute", "0.18 0 0", "0 1 0"),
    ("joint_6", "revolute", "0.08 0 0", "1 0 0"),
)


def _urdf(changes: Mapping[str, tuple[str, str, str]] | None = None, more: Mapping[str, str] | None = None) -> str:
    """The arm with other kinds, places and axes of some joints, and more elements in some."""
    joints = [(name, *(changes or {}).get(name, rest)) for name, *rest in _JOINTS]
    links = ["base", *(f"link_{k}" for k in range(1, 6)), "tip"]
    mass = '<inertial><origin xyz="0.05 0 0.1"/><mass value="4"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'  # noqa: E501
    elements = ['<link name="floor"/>', *(f'<link name="{link}">{mass}</link>' for link in links)]
    elements.append('<joint name="foot" type="fixed"><parent link="floor"/><child link="base"/></joint>')
    for (name, kind, xyz, axis), parent, child in zip(joints, links, links[1:], strict=False):
        elements.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{(more or {}).get(name, "")}{machines.LIMIT[kind]}</joint>'
        )
    return f'<robot name="crossed">{"".join(elements)}</robot>'


# A parallelogram on a turret, its rod and crank as heavy as the rest.
def _four_bar() -> str:
    mass = '<inertial><origin xyz="0.05 0 0.1"/><mass value="4"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'  # noqa: E501
    text = four_bar_urdf()
    for link in ("turret", "lower", "elbow", "roll", "tip"):
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{mass}</link>')
    return text.replace(
        '<link name="base"/>',
        '<link name="floor"/><link name="base"/><joint name="foot" type="fixed"><parent link="floor"/>'
        '<child link="base"/></joint>',
    )


@dataclass
class Draft:
    """A job in the making, and how its measurements are simulated. Keys as in :class:`calib.job.schema.Job`."""

    urdf: str = field(default_factory=_urdf)
    robot: dict[str, Any] = field(default_factory=lambda: {"urdf": "arm.urdf", "tip": "tip"})
    error_model: dict[str, Any] = field(default_factory=dict)
    job: dict[str, Any] = field(default_factory=dict)
    section: dict[str, Any] = field(default_factory=dict)  # of every table to identify from
    kind: str = "position"
    beside_positions: bool = False
    said: str = ""
    told: bool = False
    noise: str = "sigma"
    tools: tuple[str, ...] = ("tool",)
    judge: str = "validate"
    known: str = ""
    levels: str = ""
    renamed: bool = False
    geometry: str = "all"
    arm: str = "turning"
    motion: str = ""
    places: tuple[str, ...] = ("",)
    placed_by: str = ""
    points: bool = False
    board: bool = False
    elbow: bool = False


@dataclass(frozen=True)
class Feature:
    """One level of one axis: the keys of a job that it stands for, and what it makes of a draft.

    ``twin``: a feature that goes the same way through the program; scripts/development/cross_features.py alone meets
    this one. ``beside``: in the suite it stands in the rows of ``BESIDE`` alone, and the script crosses it with all.
    """

    axis: str
    name: str
    keys: tuple[str, ...] = ()
    draft: Mapping[str, Any] = field(default_factory=dict)
    robot: Mapping[str, Any] = field(default_factory=dict)
    error_model: Mapping[str, Any] = field(default_factory=dict)
    job: Mapping[str, Any] = field(default_factory=dict)
    section: Mapping[str, Any] = field(default_factory=dict)
    twin: str = ""
    beside: bool = False

    @cached_property
    def label(self) -> str:
        return f"{self.axis}: {self.name}"

    def apply(self, draft: Draft) -> None:
        for name, value in self.draft.items():
            setattr(draft, name, value)
        draft.robot |= self.robot
        draft.error_model |= self.error_model
        draft.job |= self.job
        draft.section |= self.section


_PAYLOAD = {"mass": "3 kg", "position": ["0.02 m", "0 m", "0.05 m"]}
_LOOP = {"name": "parallelogram", "frames": ["rod_end", "pin"], "closes": ["x", "z"], "passive": ["elbow", "rod"]}
_COUPLED = {"joint": "joint_3", "drivers": {"joint_2": -1.0, "joint_1": 0.2}, "offset": "0.1 rad"}
_SLIDES = {"joint_3": ("prismatic", "0 0 0.30", "0 0 1")}
_MIMIC = {"joint_5": '<mimic joint="joint_2" multiplier="-0.7" offset="0.1"/>'}

# The first of every axis is the usual one.
# Of which joint a kind of joint terms is, where that is not the second: two waves, and two compliances, of one reading
# would hardly be told apart.
_TERMS_OF = {"harmonics": "@first", "moments": "@third", "thermal": "@first"}


# All at once with wind-up and bending of one arm they cannot be told apart: tests/identification/test_bearings.py.
# What is remembered of a session is not of single rows: tests/identification/test_memory.py.
_BY_THEMSELVES = ("torsion", "lateral", "lateral_moments", "warming")


def _of_masses() -> list[Kind]:
    return [kind for kind in KINDS if kind.masses != "none" and kind.key not in _BY_THEMSELVES and kind not in _told()]


def _told() -> list[Kind]:
    told = [kind for kind in KINDS if kind.lacking(JointTerm("", kind.names[0]), 0, NO_CONDITIONS)]
    return [kind for kind in told if kind.key not in _BY_THEMSELVES]


def _of_readings() -> list[Kind]:
    others = (*_of_masses(), *_told())
    return [kind for kind in KINDS if kind not in others and kind.key not in _BY_THEMSELVES]


def _keys(kinds: Sequence[Kind], *more: str) -> tuple[str, ...]:
    return (*(f"error_model.{kind.key}" for kind in kinds), *more)


def _free(kinds: Sequence[Kind]) -> dict[str, Any]:
    """The keys that free a kind of one joint, or of the whole arm where it may be."""

    def of(kind: Kind) -> Any:
        return kind.words[0] if kind.words else [_TERMS_OF.get(kind.key, "@wrist" if kind.of_link else "@second")]

    return {kind.key: of(kind) for kind in kinds}


FEATURES: tuple[Feature, ...] = (
    Feature("arm", "turning", ("robot.urdf", "robot.tip")),
    Feature("arm", "coupled", ("robot.coupling",), {"arm": "coupled"}, robot={"coupling": [_COUPLED]}),
    Feature("arm", "sliding and mimicking", (), {"arm": "sliding", "urdf": _urdf(_SLIDES, _MIMIC)}),
    Feature("arm", "loop", ("robot.loop",), {"arm": "loop", "urdf": _four_bar()}, robot={"loop": [_LOOP]}),
    Feature("frame", "root"),
    Feature("frame", "link", ("robot.base",), robot={"base": "base"}),
    Feature("terms", "none"),
    Feature(
        "terms",
        "of readings",
        _keys(_of_readings(), "error_model.harmonic_orders"),
        error_model=_free(_of_readings()) | {"harmonic_orders": [1, 3]},
    ),
    Feature(
        "terms",
        "of masses",
        _keys(_of_masses(), "robot.payload", "robot.gravity"),
        robot={"payload": _PAYLOAD, "gravity": ["1 m/s2", "0 m/s2", "-9.7 m/s2"]},
        error_model=_free(_of_masses()),
    ),
    Feature(
        "terms",
        "told",
        _keys(_told()),
        {"told": True},
        error_model=_free(_told()),
    ),
    Feature(
        "terms",
        "torque offsets",
        ("error_model.torque_offsets",),
        {"told": True},
        error_model=_free(_told()) | {"torque_offsets": "free"},
        beside=True,
    ),
    Feature("terms", "bearings", ("error_model.lateral",), error_model={"lateral": ["@second"]}, beside=True),
    Feature("terms", "auto", ("error_model.terms",), {"told": True}, error_model={"terms": "auto"}),
    Feature("sides", "by joint", (), {"said": "each"}),
    Feature("sides", "by row", (), {"said": "row"}),
    Feature("sides", "in order", ("measurements.in_order",), {"said": "order"}, section={"in_order": True}),
    Feature("geometry", "all", ("error_model.offsets", "error_model.placements")),
    Feature("geometry", "offsets", (), {"geometry": "offsets"}),
    Feature(
        "geometry",
        "dh",
        ("error_model.dh", "error_model.dh_convention", "error_model.dh_parallel"),
        {"geometry": "dh"},
    ),
    Feature("observes", "position", ("measurements.observes", "measurements.file")),
    Feature("observes", "pose", ("measurements.sigma_angle",), {"kind": "pose"}),
    Feature("observes", "socket", (), {"kind": "socket"}),
    Feature("observes", "distance", (), {"kind": "distance", "beside_positions": True}, twin="sphere"),
    Feature("observes", "pair_distance", (), {"kind": "pair_distance", "beside_positions": True}),
    Feature("observes", "plane", (), {"kind": "plane", "beside_positions": True}),
    Feature("observes", "sphere", (), {"kind": "sphere", "beside_positions": True}),
    Feature(
        "observes",
        "indicator",
        ("targets.normal", "targets.height"),
        {"kind": "indicator", "beside_positions": True},
        twin="plane",
    ),
    Feature(
        "observes",
        "pixels",
        tuple(f"instruments.{key}" for key in ("camera_on", "fx", "fy", "cx", "cy", "k1")),
        {"kind": "pixels"},
    ),
    Feature(
        "observes",
        "board",
        (
            *(f"instruments.{key}" for key in ("lens", "size", *(f"lens_sigma.{name}" for name in ("fx", "fy")))),
            "measurements.board",
        ),
        {"kind": "pixels", "board": True},
        beside=True,
    ),
    Feature("noise", "sigma", ("measurements.sigma",)),
    Feature("noise", "column", (), {"noise": "column"}),
    Feature("noise", "column of each axis", (), {"noise": "axes"}, twin="column"),
    Feature(
        "noise",
        "an arm",
        ("instruments.urdf", "instruments.tip", "instruments.point"),
        {"noise": "arm"},
        beside=True,
    ),
    Feature(
        "noise",
        "tracker",
        (
            "measurements.instrument",
            "instruments.kind",
            "instruments.sigma",
            "instruments.sigma_per_metre",
            "instruments.station",
        ),
        {"noise": "tracker"},
    ),
    Feature("noise", "estimated", (), {"noise": "estimated"}),
    Feature("noise", "model", ("measurements.model_sigma", "measurements.model_sigma_angle"), {"noise": "model"}),
    Feature("loss", "linear"),
    Feature("loss", "huber", ("measurements.loss",), section={"loss": "huber"}),
    Feature("loss", "soft_l1", ("measurements.loss",), section={"loss": "soft_l1"}),
    Feature("loss", "cauchy", ("measurements.loss",), section={"loss": "cauchy"}),
    Feature("prior", "none"),
    Feature(
        "prior",
        "stated",
        ("error_model.prior.length", "error_model.prior.angle"),
        error_model={"prior": {"length": "0.5 mm", "angle": "4 mrad"}},
    ),
    Feature(
        "prior",
        "learned",
        (
            "error_model.prior.length",
            "error_model.prior.angle",
            "error_model.prior.harmonics",
            "error_model.prior.elastic",
        ),
        error_model={"prior": dict.fromkeys(("length", "angle", "harmonics", "elastic"), "learned")},
    ),
    Feature("tools", "one", ("error_model.tool",), error_model={"tool": "position"}),
    Feature("tools", "two", (), {"tools": ("A", "B[2]")}, error_model={"tool": "position"}),
    Feature("tools", "turned", (), error_model={"tool": "pose"}),
    Feature(
        "tools",
        "known",
        ("tools.position", "tools.quaternion"),
        {"tools": ("A", "B[2]")},
        error_model={"tool": "fixed"},
    ),
    Feature("base", "sought", ("error_model.base",), error_model={"base": "pose"}),
    Feature("base", "known", ("base.position", "base.quaternion"), error_model={"base": "fixed"}),
    Feature("place", "one"),
    Feature("place", "two", (), {"places": ("left", "right")}, beside=True),
    Feature(
        "place",
        "about known",
        tuple(f"setups.{key}" for key in ("position", "quaternion", "prior.length", "prior.angle")),
        {"places": ("left", "right"), "placed_by": "prior"},
        beside=True,
    ),
    Feature(
        "place",
        "loaded",
        tuple(f"setups.{key}" for key in ("gravity", "payload.mass", "payload.position", "payload.link")),
        {"places": ("left", "right"), "placed_by": "load"},
        beside=True,
    ),
    Feature("tips", "one"),
    Feature("tips", "two", ("measurements.tip", "measurements.tool"), {"elbow": True}, beside=True),
    Feature("point", "the tool's"),
    Feature("point", "of each row", (), {"points": True}, beside=True),
    Feature("motion", "at rest"),
    Feature(
        "motion",
        "stream",
        tuple(f"measurements.{key}" for key in ("readings", "clock", "clock_of", "gap")),
        {"motion": "stream"},
        beside=True,
    ),
    Feature("motion", "late", ("measurements.latency",), {"motion": "late"}, beside=True),
    Feature("judge", "validate", ("measurements.use",)),
    Feature("judge", "held out", ("measurements.hold_out",), {"judge": "hold_out"}, section={"hold_out": 0.25}),
    Feature("judge", "nothing", (), {"judge": ""}),
    Feature("levels", "none"),
    Feature("levels", "two", ("levels.name", "levels.free", "levels.measurements"), {"levels": "two"}),
    Feature(
        "levels",
        "grid",
        ("levels.residual_model.kind", "levels.residual_model.joints", "levels.residual_model.frame"),
        {"levels": "grid"},
    ),
    Feature("levels", "gaussian", (), {"levels": "gaussian"}),
    Feature("solver", "least squares", ("solver.kind",)),
    Feature(
        "solver",
        "total differential",
        ("solver.kind", "solver.stop", "solver.rounding", "solver.most"),
        job={"solver": {"kind": "total_differential", "stop": "0.1 mm", "rounding": "0.00001 mrad", "most": 15}},
    ),
    Feature("null_space", "nearest", ("error_model.null_space",), error_model={"null_space": "nearest"}),
    Feature("null_space", "minimal", (), error_model={"null_space": "minimal"}),
    Feature("null_space", "refuse", (), error_model={"null_space": "refuse"}),
    Feature("known", "nothing"),
    Feature("known", "targets", ("targets.position", "targets.quaternion"), {"known": "targets"}),
    Feature(
        "known",
        "relation",
        ("relations.targets", "relations.distance", "relations.angle", "relations.offset", "relations.sigma"),
        {"known": "relation"},
    ),
    Feature("known", "renamed", ("measurements.targets",), {"known": "renamed"}),
    Feature("known", "length", ("measurements.length_offset",), {"known": "length"}),
    Feature("known", "on a link", ("targets.on",), {"known": "link"}, beside=True),
    Feature("header", "ours"),
    Feature(
        "header",
        "theirs",
        ("measurements.columns", "measurements.ignore"),
        {"renamed": True},
        section={"ignore": ["remark"]},
    ),
)

AXES: tuple[str, ...] = tuple(dict.fromkeys(feature.axis for feature in FEATURES))


def of_axis(axis: str) -> tuple[Feature, ...]:
    return tuple(feature for feature in FEATURES if feature.axis == axis)


@dataclass(frozen=True)
class Refusal:
    """Two features that do not go together: every pair of one of ``a`` and one of ``b``, and the sentence's pattern."""

    a: tuple[str, ...]
    b: tuple[str, ...]
    sentence: str


REFUSALS: tuple[Refusal, ...] = (
    Refusal(
        ("solver: total differential",), ("geometry: all", "geometry: dh"), "the points determine .* of .* parameters"
    ),
    Refusal(
        ("solver: total differential",),
        tuple(f"terms: {name}" for name in ("of readings", "of masses", "told", "torque offsets", "bearings", "auto")),
        "the total differential takes no joint terms",
    ),
    Refusal(
        ("solver: total differential",),
        ("prior: stated", "prior: learned", "place: about known"),
        "the total differential takes no priors",
    ),
    Refusal(
        ("solver: total differential",),
        tuple(f"observes: {kind}" for kind in (*get_args(measured.Kind), "board") if kind != "position"),
        "the total differential takes positions only",
    ),
    Refusal(
        ("solver: total differential",),
        ("levels: two", "levels: grid", "levels: gaussian"),
        "'total_differential' does not work in levels",
    ),
    Refusal(
        ("solver: total differential",),
        ("loss: huber", "loss: soft_l1", "loss: cauchy"),
        "has no effect with solver.kind",
    ),
    Refusal(("solver: total differential",), ("tools: turned",), "the points determine .* of .* parameters"),
    # An offset of the torques is one of the joint, and of a horizontal joint's bearing nothing loads the vertical axis.
    Refusal(
        ("null_space: refuse",),
        ("geometry: all", "geometry: dh", "tools: turned", "terms: torque offsets", "terms: bearings"),
        "the data do not determine",
    ),
    Refusal(
        ("known: targets",),
        ("observes: position", "observes: pose", "observes: pair_distance"),
        "targets: 's0' does not appear in the measurements",
    ),
    Refusal(
        ("known: relation",),
        tuple(f"observes: {kind}" for kind in ("position", "pose", "pair_distance", "indicator", "pixels", "board")),
        "relations: a known distance is between two points, and 's[01]' is (in no measurement|a plane|a frame)",
    ),
    Refusal(
        ("known: renamed",),
        ("observes: position", "observes: pose", "observes: pair_distance"),
        "there is no target 's0' to rename; there are none",
    ),
    Refusal(
        ("known: length",),
        tuple(f"observes: {kind}" for kind in ("position", "pose", "socket", "plane", "indicator", "pixels", "board")),
        "length_offset: a .* has no length",
    ),
    Refusal(
        ("geometry: dh",),
        ("terms: of masses", "terms: told", "terms: torque offsets", "terms: bearings"),
        "links bend and expand between joints of the URDF",
    ),
    Refusal(("geometry: dh",), ("arm: loop",), "an arm with closed loops has no DH table"),
    Refusal(
        ("levels: gaussian",),
        ("observes: socket", "observes: pixels", "observes: board"),
        "needs measurements of positions",
    ),
    Refusal(
        ("noise: tracker",), ("observes: socket", "observes: pixels", "observes: board"), "a laser.tracker measures no"
    ),
    Refusal(
        ("noise: an arm",),
        ("observes: pose", "observes: socket", "observes: pixels", "observes: board"),
        "an arm that touches sees positions only",
    ),
    Refusal(
        ("noise: an arm",), ("motion: stream", "motion: late"), "an arm that measures has its own, and is no stream"
    ),
    Refusal(
        ("observes: board",),
        ("tools: one", "tools: two"),
        'tool: is "position", and the orientation of the camera on the tip in .* is not known; write "pose"',
    ),
    Refusal(
        ("point: of each row",),
        ("observes: pose", "observes: pixels", "observes: board"),
        "point",
    ),
    Refusal(("tips: two",), ("levels: grid", "levels: gaussian"), "is of one tip, and the measurements are of several"),
    Refusal(
        ("known: on a link",),
        ("observes: position", "observes: pose", "observes: pair_distance"),
        "targets: 's0' does not appear in the measurements",
    ),
)

# Keys of the job's schema that no feature stands for, and why.
EXEMPT: Mapping[str, str] = {
    "schema": "says which schema this is",
    "robot.mesh_roots": "matters to drawing alone; tests/presentation/test_scene.py",
    **{
        f"error_model.{key}": "gives way by itself; tests/identification/test_bearings.py"
        for key in _BY_THEMSELVES
        if key != "lateral"
    },
    **{
        f"instruments.{key}": "an arm that touches; its backlash and its grid: tests/job/test_arm.py"
        for key in ("model", "setup", "tool", "pivot")
    },
    **dict.fromkeys(
        (
            *(f"base.prior.{key}" for key in ("length", "angle")),
            "measurements.setup",
        ),
        "several set-ups, tips and tools by name; tests/job/test_set_ups.py, tests/job/test_trees.py",
    ),
    **dict.fromkeys(
        (
            "robot.links",
            *(f"measurements.payload.{key}" for key in ("mass", "position", "link")),
        ),
        "loads that differ from table to table; tests/job/test_loads.py",
    ),
    **{
        f"about.{key}": "repeated in the report; tests/presentation/test_report.py"
        for key in ("date", "note", "operator", "serial")
    },
    "accept": "answers checks of the verdict; tests/assessment/test_trust.py",
    "measurements.orientation": "how a table is read; tests/proposal",
    **{f"instruments.{key}": "a camera's lens, as k1 is" for key in ("k2", "k3", "k4", "k5", "k6", "p1", "p2")},
    **{
        f"instruments.lens_sigma.{key}": "priors of a lens; tests/identification/test_lenses.py"
        for key in NAMES
        if key not in ("fx", "fy")
    },
    "instruments.lens_file": "the numbers of a lens in other words; tests/measurement/test_lens_files.py",
}
