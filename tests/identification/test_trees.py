"""Several tips of one tree: derivatives, what cancels, truths found again, ranks, and what is wrong with frames."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

import calib
from calib.foundations.errors import MeasurementError, RobotError
from calib.identification import system
from calib.identification.identify import residuals_of
from calib.identification.initialisation.problem import initial_problem, with_common_names
from calib.identification.machine import Frames, Layout
from calib.identification.system import Problem
from calib.identification.targets import Target, unknowns
from calib.identification.unseen_strains import unseen_strains
from calib.measurement.checks import sides_asked, table_findings, unreached
from calib.measuring import Camera
from calib.robot.urdf import parse_urdf
from tests.support import jacobians, machines
from tests.support.machines import Array, anywhere, pose
from tests.support.trees import TIPS, TOOLS, Tree, touching, tree, urdf

SIGMA = 2e-5


def tracked(made: Tree, tip: str, rng: np.random.Generator, n: int, base: Array, **more: object) -> calib.Measurements:
    q = made.draw(rng, n)
    seen = (base @ made.link(tip, q) @ TOOLS[tip])[:, :3, 3] + rng.normal(scale=SIGMA, size=(n, 3))
    columns = made.columns(q, (tip,)) | {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")} | more
    return calib.read_measurements(columns, made.robot.with_tip(tip), sigma=SIGMA)


def touches(made: Tree, rng: np.random.Generator, n: int, at: Mapping[str, Sequence[float]]) -> calib.Measurements:
    """The left tool touches cones on the right hand, n times each."""
    names = np.repeat(list(at), n)
    places = np.array([at[name] for name in names]) + rng.normal(scale=SIGMA, size=(len(names), 3))
    q = touching(made, rng, places)
    columns = made.columns(q, TIPS[:2]) | {"target": names.tolist()}
    robot = made.robot.with_tip("left_hand")
    return calib.read_measurements(columns, robot, "socket", sigma=SIGMA).named(on=dict.fromkeys(at, "right_hand"))


# ---- derivatives

ROWS = 8
KINDS: dict[str, dict[str, object]] = {
    "socket": {},
    "distance": {"length [m]": [0.7] * ROWS},
    "plane": {"ball [m]": [0.004] * ROWS},
    "sphere": {"diameter [m]": [0.03] * ROWS, "ball [m]": [0.004] * ROWS},
}


def at_random(kind: str, links: Mapping[str, str]) -> tuple[Problem, Array]:
    """Rows of the left hand about targets on links and on the floor, everything free, far from zero."""
    rng, made = np.random.default_rng(6), tree()
    robot = made.robot.with_tip("left_hand")
    columns = made.columns(made.draw(rng, ROWS)) | KINDS[kind] | {"target": ["a", "b", "c", "d"] * (ROWS // 4)}
    columns |= {"setup": ["here", "there"] * (ROWS // 2)}
    data = calib.read_measurements(columns, robot, kind, sigma=1e-3).named(on=links)
    model = calib.error_model(made.robot, offsets="all", placements=["*"], tool="pose")
    (data,) = with_common_names(model, [data])
    names = data.targets
    reference = Frames(
        np.stack([anywhere(rng) for _ in data.setups]),
        np.stack([anywhere(rng, 0.3)]),
        np.stack([anywhere(rng) for _ in names]),
    )
    parameters = (
        *model.parameters(data.tools, data.setups),
        *unknowns((data,), {}, Layout.of(model.robot, reference)),
    )
    return Problem(model, parameters, reference, (data,)), rng.uniform(-0.3, 0.3, len(parameters))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "links",
    [{}, {"a": "right_hand", "b": "head"}, {"a": "right_hand", "b": "right_hand", "c": "base", "d": "chest_link"}],
    ids=["floor", "mixed", "links"],
)
def test_columns_match_central_differences(kind: str, links: dict[str, str]) -> None:
    made = tree()
    if "d" in links:
        made = Tree(calib.load_robot(made.robot.urdf, TIPS[0], links=[*TIPS[1:], "base", "chest_link"]), made.arms)
    found, x = at_random(kind, {})
    data = found.measurements[0].named(on=links)
    model = calib.error_model(made.robot, offsets="all", placements=["*"], tool="pose")
    found = Problem(model, found.parameters, found.reference, (data,))

    jacobians.check(found, x)


def test_what_both_frames_have_in_common_cancels() -> None:
    """The torso, the base and its set-up move both hands alike: not even a large residual sees them."""
    found, x = at_random("socket", dict.fromkeys("abcd", "right_hand"))
    (J,) = system.jacobian(found, x)
    size = np.abs(J).max()
    common = [p.name.startswith(("waist", "lean", "chest", "base.")) for p in found.parameters]
    assert sum(common) == 3 * 6 + 12  # of chest, which is fixed, six; of each other five and an offset
    assert np.abs(J[:, :, common]).max() < 1e-14 * size
    right = [p.name.startswith("right_") for p in found.parameters]
    assert np.abs(J[:, :, right]).max() > 0.1 * size


# ---- truths found again


def test_two_arms_on_a_torso_are_identified_together() -> None:
    rng = np.random.default_rng(3)
    made, base = tree(rng), anywhere(rng)
    sets = [tracked(made, tip, rng, 120, base) for tip in TOOLS]
    model = calib.error_model(made.robot, offsets="all", placements="all")
    fit = calib.identify(model, sets)
    machine = calib.machine_of(fit)
    assert list(machine.tools) == ["tool", "left_hand"]
    q = made.draw(rng, 200)
    for tip, tool in zip(TOOLS, machine.tools, strict=True):
        d = machine.predict(q, tool=tool)[:, :3, 3] - (base @ made.link(tip, q) @ TOOLS[tip])[:, :3, 3]
        assert np.sqrt(np.mean(np.sum(d**2, axis=1))) < 3.0 * SIGMA
        inside = calib.judging.tool_uncertainty(machine, q, tool).inside(d)
        assert np.mean(inside) > 0.8
    # Each alone does not know the torso from the arm as well: one fit of both has it once.
    alone = [calib.identify(model, [data]) for data in sets]
    assert fit.rank < sum(one.rank for one in alone)


def test_the_order_of_tables_and_an_unused_joint_change_nothing() -> None:
    rng = np.random.default_rng(3)
    made, base = tree(rng), anywhere(rng)
    sets = [tracked(made, tip, rng, 60, base) for tip in TOOLS]
    model = calib.error_model(made.robot, offsets="all")
    one, other = (calib.identify(model, s, model_sigmas=[0.0, 0.0]) for s in (sets, sets[::-1]))
    for name in (p.name for p in one.parameters):
        assert other.value(name) == pytest.approx(one.value(name), abs=1e-8)
    # The head is in no path that matters: its joints do not move anything here.
    assert one.value("nod.offset") == 0.0


def test_hands_that_touch_each_other() -> None:
    """Self-touch alone: the hands to each other are found; where the torso and the base are, is not."""
    rng = np.random.default_rng(5)
    made = tree(rng, length=0.2e-3, angle=0.3e-3)
    at = {"a": (0.05, 0.02, 0.15), "b": (-0.06, 0.03, 0.12), "c": (0.01, -0.07, 0.2)}
    data = touches(made, rng, 60, at)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    fit = calib.identify(model, [data])
    assert not [p for p in fit.parameters if p.kind == "base"]
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.2 * SIGMA
    # What touches nothing is nominal, and the scale of both arms together is as well.
    for name in ("waist.offset", "lean.offset", "neck.offset"):
        assert fit.value(name) == pytest.approx(0.0, abs=1e-12)
    assert fit.unidentifiable[[p.name for p in fit.parameters].index("waist.offset")]
    new = touches(made, rng, 10, at)
    (r,) = residuals_of(fit, [new], fit.machine)
    (before,) = residuals_of(fit, [new], fit.nominal)
    assert np.sqrt(np.mean(r**2)) < 4.0 * SIGMA < 0.2 * np.sqrt(np.mean(before**2))


RANKS = {"right": 35, "both": 62, "touch": 44, "known touch": 47, "touch and right": 62}


def test_ranks_are_as_tabulated() -> None:
    """Of robot, base and tools; those of docs/observations.md."""
    rng = np.random.default_rng(8)
    made, base = tree(rng), anywhere(rng)
    at = {"a": (0.05, 0.02, 0.15), "b": (-0.06, 0.03, 0.12), "c": (0.01, -0.07, 0.2)}
    right, left = (tracked(made, tip, rng, 60, base) for tip in TOOLS)
    touch = touches(made, rng, 40, at)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    found = {}
    cases = {"right": [right], "both": [right, left], "touch": [touch], "touch and right": [touch, right]}
    for name, sets in cases.items():
        fit = calib.identify(model, sets)
        found[name] = fit.rank - 3 * len([d for d in sets if d is touch]) * len(at)
    known = calib.Known(targets={name: Target(pose(at[name])) for name in "ab"})
    model = calib.error_model(made.robot, offsets="all", placements="all", known=known)
    found["known touch"] = calib.identify(model, [touch]).rank - 3
    assert found == RANKS


def test_a_camera_on_the_head_sees_a_mark_on_the_hand() -> None:
    rng = np.random.default_rng(9)
    made = tree(rng)
    q = made.draw(rng, 30_000, 0.9)
    eye = pose((0.02, 0.06, 0.05), (-1.9, 0.1, 0.1))
    seen = np.linalg.inv(made.link("head", q) @ eye) @ made.link("left_hand", q) @ TOOLS["left_hand"]
    x = seen[:, :3, 3]
    good = np.flatnonzero((x[:, 2] > 0.2) & (np.abs(x[:, :2]).max(axis=1) < x[:, 2]))[:150]
    q, x = q[good], x[good]
    assert len(q) == 150
    pixels = 800.0 * x[:, :2] / x[:, 2:] + 500.0 + rng.normal(scale=0.05, size=(len(q), 2))
    columns = made.columns(q, TIPS[1:]) | {"u [px]": pixels[:, 0], "v [px]": pixels[:, 1], "target": ["eye"] * len(q)}
    camera = Camera("floor", 800.0, 800.0, 500.0, 500.0, sigma=0.05)
    data = calib.read_measurements(columns, made.robot.with_tip("left_hand"), "pixels", instrument=camera)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    fit = calib.identify(model, [data.named(on={"eye": "head"})])
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 0.06
    assert np.linalg.norm((fit.machine.frames.targets[0] @ np.linalg.inv(eye))[:3, 3]) < 0.02


# ---- what is known


def test_a_cone_at_a_known_place_of_the_other_hand() -> None:
    rng = np.random.default_rng(5)
    made = tree(rng)
    at = {"a": (0.05, 0.02, 0.15), "b": (-0.06, 0.03, 0.12), "c": (0.01, -0.07, 0.2)}
    data = touches(made, rng, 30, at)
    known = calib.Known(targets={name: Target(pose(place)) for name, place in at.items()})
    model = calib.error_model(made.robot, offsets="all", placements="all", known=known)
    problem = initial_problem(model, [data])
    np.testing.assert_allclose(problem.reference.targets[:, :3, 3], list(at.values()))
    assert not unseen_strains(problem).size  # known places on a link tell a length


# ---- what is wrong with frames


def test_wrong_frames_are_refused() -> None:
    rng = np.random.default_rng(1)
    made, base = tree(), np.eye(4)
    model = calib.error_model(made.robot, offsets="all")
    right, left = (tracked(made, tip, rng, 10, base) for tip in TOOLS)
    with pytest.raises(MeasurementError, match="the tool 'ball' is on 'left_hand' here and on 'right_hand' in another"):
        calib.identify(model, [right.named(tool="ball"), left.named(tool="ball")])
    with pytest.raises(RobotError, match="'tail' is not one of the links that the robot was loaded with: 'right_hand'"):
        made.robot.with_tip("tail")
    with pytest.raises(RobotError, match="link 'tail' is not a link of the URDF"):
        calib.load_robot(made.robot.urdf, TIPS[0], links=["tail"])
    columns = made.columns(made.draw(rng, 6), ("left_hand",)) | {"target": ["a", "b"] * 3}
    data = calib.read_measurements(columns, made.robot.with_tip("left_hand"), "socket", sigma=SIGMA)
    with pytest.raises(MeasurementError, match="the target 'a' is on 'left_hand', which carries the tool as well"):
        data.named(on={"a": "left_hand"})
    with pytest.raises(
        MeasurementError, match=r"there is no column 'right_shoulder_pan', .* of a joint, which is needed"
    ):
        calib.identify(model, [data.named(on={"a": "right_hand"})])
    with pytest.raises(MeasurementError, match="the target 'a' is on the floor here and on right_hand in another"):
        full = calib.read_measurements(
            made.columns(made.draw(rng, 6)) | {"target": ["a", "b"] * 3}, made.robot.with_tip("left_hand"), "socket"
        )
        calib.identify(model, [full.named(on={"a": "right_hand"}), full])
    del columns["waist [rad]"]
    with pytest.raises(MeasurementError, match="there is no column 'waist' of a joint"):
        calib.read_measurements(columns, made.robot.with_tip("left_hand"), "socket")


def test_a_column_of_a_joint_that_matters_to_nothing_is_remarked() -> None:
    rng, made = np.random.default_rng(1), tree()
    robot = calib.load_robot(made.robot.urdf, "right_hand")
    q = made.draw(rng, 20)
    seen = made.link("right_hand", q)[:, :3, 3]
    columns = made.columns(q) | {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, sigma=SIGMA)
    (finding,) = [f for f in table_findings(data, robot.readings, robot.reach) if f.code == "joint-unused"]
    assert "'left_elbow'" in finding.sentence and "'neck'" in finding.sentence


def test_sides_are_asked_of_the_joints_of_the_own_arm() -> None:
    """The order of a table tells the sides of its own arm; nothing misses those of the other."""
    robot = calib.load_robot(parse_urdf(urdf().encode(), "tree"), TIPS[0], links=[TIPS[1]])
    model = machines.model(robot, backlash="all")
    own = [reading.name for reading in robot.readings if not reading.name.startswith("right")]
    columns = {f"{name} [rad]": np.array([0.1, 0.2, 0.3, 0.2]) for name in own}
    columns |= {f"{axis} [m]": np.arange(4.0) for axis in "xyz"}
    data = calib.read_measurements(columns, robot.with_tip("left_hand"), sigma=1e-4, in_order=True)
    assert sides_asked(data, model.robot) == set(own)
    assert unreached(data, sides_asked(data, model.robot)) == ()
