"""The error model: which parameters are free, under which names, and how a wrong wish is refused."""

from collections.abc import Callable

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError
from calib.identification.error_model import with_terms
from calib.identification.identify import matching
from calib.robot.terms import JointTerm
from tests.support import machines
from tests.support.machines import urdf

GANTRY = machines.load(machines.INLINE["gantry"], "tip")
T, R = ("tx", "ty", "tz"), ("rx", "ry", "rz")


def names(**options: object) -> list[str]:
    options = {"base": "fixed", "tool": "fixed"} | options
    return [parameter.name for parameter in machines.model(GANTRY, **options).parameters()]


def test_all_placements_are_those_of_moving_joints_without_what_is_their_offset() -> None:
    assert names(placements="all") == [
        *(f"{joint}.{c}" for joint in ("bridge", "carriage", "ram") for c in ("tx", "ty", *R)),
        *(f"{joint}.{c}" for joint in ("c", "a", "b") for c in (*T, "rx", "ry")),
    ]
    assert names(offsets="all") == [f"{joint}.offset" for joint in ("bridge", "carriage", "ram", "c", "a", "b")]
    assert names() == []


@pytest.mark.parametrize(
    ("wish", "found"),
    [
        (["probe"], [f"probe.{c}" for c in (*T, *R)]),
        (["ram"], ["ram.tx", "ram.ty", "ram.rx", "ram.ry", "ram.rz"]),
        (["b.rx", "a.tz"], ["a.tz", "b.rx"]),
        (["?"], [f"{joint}.{c}" for joint in "cab" for c in (*T, "rx", "ry")]),
        (["*.rz"], ["column.rz", "bridge.rz", "carriage.rz", "ram.rz", "probe.rz"]),
        (["c*.tx", "c.tx"], ["column.tx", "carriage.tx", "c.tx"]),
    ],
)
def test_placements_are_chosen_by_joint_component_and_glob(wish: list[str], found: list[str]) -> None:
    assert names(placements=wish) == found


def test_offsets_are_chosen_by_name_and_glob() -> None:
    assert names(offsets=["c*"]) == ["carriage.offset", "c.offset"]


@pytest.mark.parametrize(
    ("tool", "components"), [("fixed", ()), ("position", ("x", "y", "z")), ("pose", ("x", "y", "z", "rx", "ry", "rz"))]
)
def test_base_and_tools_are_named_after_their_points(tool: str, components: tuple[str, ...]) -> None:
    model = calib.error_model(GANTRY, tool=tool)
    base = [f"base.{c}" for c in ("x", "y", "z", *R)]
    assert [p.name for p in model.parameters()] == [*base, *(f"tool.{c}" for c in components)]
    several = model.parameters(("left", "right"))
    assert [p.name for p in several] == [*base, *(f"tool.{side}.{c}" for side in ("left", "right") for c in components)]


def test_every_parameter_has_the_unit_and_the_prior_of_its_dimension() -> None:
    model = machines.model(GANTRY, offsets="all", placements=["*"], tool="pose", prior_length=2e-3, prior_angle=3e-3)
    parameters = model.parameters(("a", "b"))
    assert len({p.name for p in parameters}) == len(parameters)
    prismatic = ("bridge.offset", "carriage.offset", "ram.offset")
    for p in parameters:
        length = p.name.rpartition(".")[2] in (*T, "x", "y", "z") or p.name in prismatic
        assert p.unit == ("m" if length else "rad")
        assert p.prior == ((2e-3 if length else 3e-3) if p.of_robot else None)
        assert p.scale == (p.prior or 1e-3)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"offsets": "some"}, 'offsets: \'some\' is not "all", "none" or a list of names.'),
        ({"placements": "some"}, 'placements: \'some\' is not "all", "none" or a list of joint names.'),
        ({"offsets": ["brigde"]}, "offsets: 'brigde' matches no joint of the arm; did you mean 'bridge'?"),
        ({"offsets": ["probe"]}, "offsets: 'probe' matches no joint of the arm; "),
        ({"placements": ["bridge.tz"]}, "placements: 'bridge.tz' matches no joint of the arm; did you mean 'bridge.t"),
        ({"placements": ["q*"]}, "placements: 'q*' matches no joint of the arm; there are column.tx, column.ty, "),
        ({"base": "position"}, "base: 'position' is not one of pose, fixed."),
        ({"tool": "free"}, "tool: 'free' is not one of pose, position, fixed."),
        ({"offsets": None}, 'error_model: offsets is None; needs "all", "none" or a list of texts.'),
        ({"offsets": 5}, 'error_model: offsets is 5; needs "all", "none" or a list of texts.'),
        ({"offsets": ["bridge", 5]}, "error_model: offsets is ['bridge', 5];"),
        ({"offsets": {"bridge": 1}}, "error_model: offsets is a dict;"),
        ({"placements": None}, "error_model: placements is None;"),
        ({"placements": [None]}, "error_model: placements is [None];"),
        ({"base": None}, 'error_model: base is None; needs "pose" or "fixed".'),
        ({"tool": np.zeros(3)}, "error_model: tool is an array of float64;"),
        ({"terms": {"gains": "all"}}, "terms: there are no 'gains'; allowed are gain, harmonics, elastic, "),
        ({"terms": {"gain": None}}, 'gain: None is not "all", "none" or a list of names.'),
        ({"terms": {"expansion": 5}}, 'expansion: 5 is not "arm", "all", "none" or a list of names.'),
        ({"terms": {"harmonic_orders": "12"}}, "harmonic_orders: '12' is not a list of whole numbers from 1 to 1000."),
        ({"terms": {"harmonic_orders": ""}}, "harmonic_orders: '' is not a list of whole numbers from 1 to 1000."),
        ({"terms": "gain"}, "error_model: terms is 'gain';"),
        ({"terms": None}, "error_model: terms is None;"),
        ({"terms": [calib.JointTerm("elbow", "gain")]}, "terms: 'elbow.gain' belongs to no joint or link of the"),
        ({"terms": [calib.JointTerm("bridge", "magic")]}, "terms: 'bridge.magic' belongs to no joint"),
        ({"terms": [calib.JointTerm("bridge", "cos", 1)]}, "terms: 'bridge.cos_1' belongs to no joint"),
        ({"terms": [calib.JointTerm("bridge", "gain")] * 2}, "terms: 'bridge.gain' comes twice."),
        ({"priors": 1e-3}, "error_model: priors is 0.001; needs a Priors."),
        ({"priors": None}, "error_model: priors is None; needs a Priors."),
        ({"known": np.eye(4)}, "error_model: known is an array of float64; needs a Known."),
        ({"prior_length": 0.0}, "prior length: 0.0 is not a positive number; leave it out for no prior."),
        ({"prior_angle": np.nan}, "prior angle: nan is not a positive number; leave it out for no prior."),
        ({"base_pose": np.ones((4, 4))}, "known.base: needs a point (3,) in m or a rigid placement (4, 4)."),
        ({"base_pose": [np.nan, 0, 0]}, "known.base: needs a point (3,) in m or a rigid placement (4, 4)."),
        ({"tool_poses": {"tool": [1.0]}}, "known.tools: 'tool': needs a point (3,) in m or a rigid placement (4, 4)."),
        ({"base_pose": np.diag([1, 1, -1, 1])}, "known.base: needs a point (3,) in m or a rigid placement (4, 4)."),
        (
            {"base_pose": 2 * np.eye(4) - np.diag([1, 1, 1, 0])},
            "known.base: needs a point (3,) in m or a rigid placement",
        ),
    ],
)
def test_a_wrong_wish_is_refused_in_a_sentence(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(JobError) as caught:
        machines.model(GANTRY, **options)
    assert str(caught.value).startswith(sentence)


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: calib.dh.Free(None), 'Free: numbers is None; needs "all", "none" or a list of texts.'),
        (lambda: calib.dh.Free(placements=5), 'Free: placements is 5; needs "all", "none" or a list of texts.'),
        (lambda: calib.dh.Free(parallel="1 deg"), "Free: parallel is '1 deg'; needs a number."),
        (lambda: calib.dh.Free(convention=None), 'Free: convention is None; needs "standard" or "modified".'),
        (lambda: calib.Priors([1e-3]), 'Priors: length is [0.001]; needs a number, "learned" or None.'),
        (lambda: calib.Known(base="here"), "Known: base is 'here'; needs an array of numbers or None."),
        (lambda: calib.Known(tools=np.eye(4)), "Known: tools is an array of float64;"),
        (lambda: calib.Known(targets={"a": (1, 2, 3)}), "Known: targets is a dict;"),
        (lambda: calib.Known(relations=5), "Known: relations is 5;"),
    ],
)
def test_what_is_of_another_kind_is_refused_where_it_is_made(made: Callable[[], object], sentence: str) -> None:
    with pytest.raises(JobError) as caught:
        made()
    assert str(caught.value).startswith(sentence)


def test_brackets_of_a_name_are_no_glob_of_it() -> None:
    """A name stands for itself, also beside ``finger0``, which it would match as a glob."""
    text = machines.INLINE["gantry"]
    for old, new in {"bridge": "finger[0]", "carriage": "finger[1]", "ram": "finger0"}.items():
        text = text.replace(f'<joint name="{old}"', f'<joint name="{new}"')
    robot = machines.load(text, "tip")
    model = calib.error_model(
        robot, offsets=["finger[0]"], placements=["finger[0].rx", "finger[1]"], terms={"gain": ["finger[0]"]}
    )
    assert model.offsets == ("finger[0]",)
    assert model.placements == (("finger[0]", "rx"), *(("finger[1]", c) for c in ("tx", "ty", *R)))
    assert [term.reading for term in model.robot.terms] == ["finger[0]"]
    assert calib.error_model(robot, placements=["finger[1].t*"]).placements == (
        ("finger[1]", "tx"),
        ("finger[1]", "ty"),
    )
    assert calib.error_model(robot, offsets=["finger[[]?]"]).offsets == ("finger[0]", "finger[1]")
    freed = matching(model.parameters(("tool",)), ["finger[0].offset", "base.*"])
    assert [p.name for p in freed][:2] == ["finger[0].offset", "base.x"]


def test_a_joint_may_not_be_called_like_a_frame() -> None:
    robot = machines.load(
        urdf(("base", "revolute", "0 0 0", "0 0 0", "0 0 1"), ("tool", "fixed", "1 0 0", "0 0 0", "0 0 0")), "tip"
    )
    model = calib.error_model(robot, placements=["base"])
    with pytest.raises(
        JobError, match=r"^the parameter name 'base\.rx' means two things: a joint may not be called base"
    ):
        model.parameters()


def test_very_many_joint_terms_are_refused() -> None:
    """A machine of them is not read back: what is told of it takes memory for every term and pose."""
    many = [JointTerm("c", "sin", order) for order in range(1, 8002)]
    with pytest.raises(JobError, match=r"^the model has 8001 joint terms; allowed are 8000\.$"):
        with_terms(machines.model(GANTRY), many)
