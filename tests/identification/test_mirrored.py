"""Anchors and tools that lengths put at two places alike: none of these is told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.assessment.control import names_of_mirrored
from calib.identification.fit import Fit
from calib.identification.mirrored import _at_two_places
from calib.identification.mirrored_boards import Photographed, photographed
from calib.identification.parameters import ParameterKind
from calib.identification.set_ups import SetUp
from calib.identification.system import Problem
from calib.identification.targets import Target
from calib.robot.urdf import parse_urdf
from tests.support import cameras, jacobians, machines
from tests.support.machines import Array

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
SIGMA = 2e-5
ANCHORS = 6
TOOL, OTHER = machines.pose((0.08, 0.05, 0.25)), machines.pose((-0.1, 0.12, 0.2))


def session(readings_of: Array | None = None, *, each: int = 3, other_tool: bool = False) -> tuple[Fit, Array]:
    """Positions that tell a UR10, and lengths to anchors that are not known; or of another tool, to two that are."""
    rng = np.random.default_rng(7)
    robot, true = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    places, base = rng.uniform(-2.0, 2.0, (ANCHORS, 3)), machines.anywhere(rng)
    seen = machines.Machine(true, base, {"tool": TOOL}).measure(
        robot, true.draw(rng, 60), "position", points=["tool"] * 60, rng=rng, sigma=SIGMA, sigma_angle=SIGMA
    )
    count = each if other_tool else ANCHORS * each
    target = np.arange(count) % ANCHORS
    readings = true.draw(rng, count) if readings_of is None else readings_of
    points = (base @ true.tips(readings) @ (OTHER if other_tool else TOOL))[:, :3, 3]
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns["length [m]"] = np.linalg.norm(points - places[target], axis=1) + rng.normal(scale=SIGMA, size=count)
    columns |= {"target": [f"A{t}" for t in target], "tool": ["other" if other_tool else "tool"] * count}
    known = {f"A{t}": Target(machines.pose(places[t])) for t in set(target.tolist()) if other_tool}
    data = calib.read_measurements(columns, robot, "distance", sigma=SIGMA)
    model = calib.error_model(robot, offsets="all", placements="all", known=calib.Known(targets=known))
    return calib.identify(model, [seen, data]), places


@pytest.mark.parametrize(("each", "mirrored"), [(3, True), (5, False)])
def test_three_lengths_put_an_anchor_at_two_places(each: int, mirrored: bool) -> None:
    """A fit ends at one of them without a remainder: some of these were metres off, and told to micrometres."""
    fit, places = session(each=each)
    of_targets = np.array([parameter.kind == "target" for parameter in fit.parameters])
    assert np.array_equal(fit.mirrored, of_targets & mirrored)
    assert np.isnan(fit.sigmas[of_targets]).all() == mirrored
    assert names_of_mirrored(fit, "point") == (tuple(f"A{t}" for t in range(ANCHORS)) if mirrored else ())
    assert [f.code for f in calib.assess(fit).findings].count("mirrored") == mirrored
    off = np.abs(fit.values[of_targets] - places.ravel())
    assert off.max() > 0.1 if mirrored else (off < 5.0 * fit.sigmas[of_targets]).all()


def test_more_lengths_in_a_plane_do_so_as_well() -> None:
    """The second and third joint carry the tool point about in a plane."""
    readings = np.tile((0.3, -1.0, 0.7, -0.4, 0.6, 0.2), (8 * ANCHORS, 1))
    readings[:, 1:3] += np.random.default_rng(3).uniform(-0.5, 0.5, (len(readings), 2))
    fit, _ = session(readings, each=8)
    assert len(names_of_mirrored(fit, "point")) == ANCHORS


@pytest.mark.parametrize(("height", "mirrored"), [(0.0, False), (2e-4, False), (0.1, True)])
def test_an_anchor_in_the_plane_of_its_lengths_is_at_one_place(height: float, mirrored: bool) -> None:
    """Its mirror image is itself, or no farther than its sigma tells: 1.5 mm across the plane, of lengths to 20 um."""
    rng = np.random.default_rng(5)
    ends = np.append(rng.uniform(-0.5, 0.5, (8, 2)), np.zeros((8, 1)), axis=1)
    noise = rng.normal(scale=SIGMA, size=8)
    assert _at_two_places(np.array([0.6, 0.2, height]), ends, noise, np.full(8, SIGMA)) == mirrored


@pytest.mark.parametrize(("each", "mirrored"), [(3, ("other",)), (6, ())])
def test_a_tool_that_three_lengths_tell(each: int, mirrored: tuple[str, ...]) -> None:
    fit, _ = session(each=each, other_tool=True)
    assert names_of_mirrored(fit, "tool") == mirrored
    assert names_of_mirrored(fit, "point") == ()
    told = calib.assess(fit)
    assert [check.passed for check in told.checks if check.name == "redundancy"] == [not mirrored]
    assert any("two places" in doubt for doubt in told.doubts) == bool(mirrored)


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
@pytest.mark.parametrize(("size", "distance", "mirrored"), [(0.025, 1.5, True), (0.2, 0.8, False)])
def test_a_small_board_in_one_photograph_may_be_tilted_to_either_side(
    camera_on: str, size: float, distance: float, mirrored: bool
) -> None:
    """Of 12 fits to a board of 40 mm one ended 86 degrees off, and told it to a quarter of one."""
    off = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        robot, arm = machines.load(*UR5), machines.arm(*UR5)
        true = cameras.scene(rng, arm, camera_on, sigma=0.1)
        every = true.columns(true.draw(rng, 20), rng, 0.1)
        tilted = Rotation.from_rotvec((np.pi, 0.0, 0.0)) * Rotation.from_rotvec((0.4, 0.57, 0.0))
        board = machines.pose((0.05, -0.1, distance), tilted.as_rotvec())
        readings = arm.draw(rng, 1)
        tool = true.base @ arm.tips(readings)[0] @ true.tool
        there = tool @ (board if camera_on == "tip" else np.linalg.inv(board))
        small = replace(true, target=there, places=true.places * size / 0.12)
        once = small.columns(readings, rng, 0.1)
        columns = [{**some, "target": [name] * len(some["u [px]"])} for some, name in ((every, "A"), (once, "B"))]
        sets = [calib.read_measurements(some, robot, "pixels", instrument=true.camera) for some in columns]
        fit = calib.identify(calib.error_model(robot, tool="pose", base="fixed"), sets)
        own = [k for k, parameter in enumerate(fit.parameters) if parameter.name.startswith("target.B.")]
        assert fit.mirrored[own].all() == mirrored
        assert not np.delete(fit.mirrored, own).any()
        turned = fit.machine.frames.targets[1, :3, :3].T @ there[:3, :3]
        off.append(float(np.linalg.norm(Rotation.from_matrix(turned).as_rotvec())))
    assert mirrored or max(off) < 0.02


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
def test_a_board_is_at_one_place_where_marks_of_a_photograph_err_together(camera_on: str) -> None:
    """The fit weighs them by how they do; by the marks alone, the one place was farther off than is told of it."""
    rng = np.random.default_rng(2)
    robot, arm = machines.load(*UR5), machines.arm(*UR5)
    true = cameras.scene(rng, arm, camera_on, sigma=0.02)
    off = np.array([machines.pose(*(rng.normal(scale=s, size=3) for s in (5e-4, 1e-3))) for _ in range(14)])
    data = true.measure(robot, true.draw(rng, 14), rng, 0.02, off)
    fit = calib.identify(calib.error_model(robot, tool="pose", base="fixed"), [data])
    assert fit.together[0] is not None
    assert not fit.mirrored.any()
    apart = np.linalg.inv(fit.machine.frames.targets[0]) @ true.target
    assert np.linalg.norm(apart[:3, 3]) < 2e-3


@pytest.mark.parametrize(("size", "mirrored"), [(0.03, True), (0.1, False)])
def test_a_set_up_that_one_photograph_of_a_small_board_tells_is_not_trusted(size: float, mirrored: bool) -> None:
    """Its base may be metres off, and tools there were stated to be known to a centimetre."""
    rng = np.random.default_rng(4)
    robot, arm = machines.load(*UR5), machines.arm(*UR5)
    near = cameras.scene(rng, arm, "tip", places=cameras.BOARD * size / 0.12, sigma=0.1)
    once, tilted = arm.draw(rng, 1), Rotation.from_rotvec((np.pi, 0.0, 0.0)) * Rotation.from_rotvec((0.4, 0.57, 0.0))
    board = machines.pose((0.05, -0.1, 1.5 if mirrored else 0.8), tilted.as_rotvec())
    base = near.target @ np.linalg.inv(arm.tips(once)[0] @ near.tool @ board)
    far = replace(near, base=base)
    sets = [
        there.measure(robot, readings, rng, 0.1).named(setup=name)
        for name, there, readings in (("near", near, near.draw(rng, 20)), ("far", far, once))
    ]
    fit = calib.identify(calib.error_model(robot, tool="pose"), sets)
    assert names_of_mirrored(fit, "base") == (("far",) if mirrored else ())
    found = calib.assess(fit)
    assert any("show the board alike if tilted" in doubt for doubt in found.doubts) == mirrored
    assert found.trusted != mirrored


def _twice(camera_on: str, size: float) -> tuple[cameras.Scene, cameras.Scene, Array, Array]:
    """Return a scene and its readings (20, 6), and one of a small board, tilted, and one reading (1, 6) there."""
    rng = np.random.default_rng(0)
    arm = machines.arm(*UR5)
    near = cameras.scene(rng, arm, camera_on, sigma=0.1)
    tilted = Rotation.from_rotvec((np.pi, 0.0, 0.0)) * Rotation.from_rotvec((0.4, 0.57, 0.0))
    board, once = machines.pose((0.05, -0.1, 1.5), tilted.as_rotvec()), arm.draw(rng, 1)
    there = near.base @ arm.tips(once)[0] @ near.tool @ (board if camera_on == "tip" else np.linalg.inv(board))
    return near, replace(near, target=there, places=near.places * size / 0.12), near.draw(rng, 20), once


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
def test_photographs_of_a_board_in_several_tables_are_of_one_board(camera_on: str) -> None:
    """In tables of their own they were taken for what tells more: a board 73 degrees off was told to half of one."""
    rng, robot = np.random.default_rng(1), machines.load(*UR5)
    near, small, readings, once = _twice(camera_on, 0.02)
    tables = [(near, readings, "A"), (small, once, "B"), (small, once + 1e-5, "B")]
    columns = [some.columns(q, rng, 0.1) | {"target": [name] * 20 * len(q)} for some, q, name in tables]
    sets = [calib.read_measurements(some, robot, "pixels", instrument=near.camera) for some in columns]
    fit = calib.identify(calib.error_model(robot, tool="pose", base="fixed"), sets)
    assert names_of_mirrored(fit, "frame") == ("B",)


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
@pytest.mark.parametrize(("size", "mirrored"), [(0.03, ("other",)), (0.2, ())])
def test_a_tool_that_one_photograph_of_a_small_board_tells_is_not_trusted(
    camera_on: str, size: float, mirrored: tuple[str, ...]
) -> None:
    """A second camera on the tip was 72 degrees off, and trusted."""
    rng, robot = np.random.default_rng(1), machines.load(*UR5)
    near, small, readings, once = _twice(camera_on, size)
    tip = near.base @ near.arm.tips(once)[0]
    seen = np.linalg.inv(tip @ near.tool) @ small.target
    other = replace(small, tool=np.linalg.inv(tip) @ near.target @ np.linalg.inv(seen), target=near.target)
    tables = [(near, readings, "tool"), (other, once, "other")]
    columns = [some.columns(q, rng, 0.1) | {"tool": [name] * 20 * len(q)} for some, q, name in tables]
    sets = [calib.read_measurements(some, robot, "pixels", instrument=near.camera) for some in columns]
    fit = calib.identify(calib.error_model(robot, tool="pose", base="fixed"), sets)
    assert names_of_mirrored(fit, "tool") == mirrored
    assert names_of_mirrored(fit, "frame") == ()
    assert any("two places" in doubt for doubt in calib.assess(fit).doubts) == bool(mirrored)


@pytest.mark.parametrize(("angle", "mirrored"), [(0.01, ()), (1.0, ("far",))])
def test_where_a_set_up_was_stated_to_be_tells_to_which_side(angle: float, mirrored: tuple[str, ...]) -> None:
    rng, robot = np.random.default_rng(1), machines.load(*UR5)
    near, small, readings, once = _twice("tip", 0.03)
    far = replace(small, base=near.target @ np.linalg.inv(small.target) @ near.base, target=near.target)
    sets = [
        some.measure(robot, q, rng, 0.1).named(setup=name)
        for some, q, name in ((near, readings, "near"), (far, once, "far"))
    ]
    stated = far.base @ machines.pose((5e-3, 0.0, 0.0), (0.0, 5e-3, 0.0))
    known = calib.Known(setups={"near": SetUp(near.base), "far": SetUp(stated, angle, angle)})
    fit = calib.identify(calib.error_model(robot, tool="pose", known=known), sets)
    assert names_of_mirrored(fit, "base") == mirrored


@pytest.mark.parametrize("kind", ["base", "tool", "target"])
@pytest.mark.parametrize("camera_on", ["tip", "floor"])
def test_derivatives_of_what_photographs_show_of_a_frame(kind: ParameterKind, camera_on: str) -> None:
    """At its place and far from it; with a base that was stated to be somewhere."""
    rng, robot = np.random.default_rng(3), machines.load(*UR5)
    near, small, readings, once = _twice(camera_on, 0.1)
    few = readings[:8]
    seen = [near.columns(few, rng) | {"target": ["A"] * 160}, small.columns(once, rng) | {"target": ["B"] * 20}]
    sets = [calib.read_measurements(some, robot, "pixels", instrument=near.camera) for some in seen]
    named = [sets[0].named(setup="near"), sets[1].named(setup="far")]
    known = calib.Known(setups={"near": SetUp(near.base), "far": SetUp(small.base, 0.01, 0.02)})
    fit = calib.identify(calib.error_model(robot, tool="pose", known=known), named)
    problem = Problem(fit.model, (), fit.machine.frames, fit.measurements)
    sigmas = [np.full(data.sigma.shape, 0.1) for data in fit.measurements]
    asked = {"base": {1}, "tool": {0}, "target": {1}}[kind]
    found = dict(photographed(problem, fit.machine, sigmas, kind, asked))
    assert set(found) == asked
    for frame in found.values():
        for pose in (frame.here, frame.here @ machines.pose((0.01, -0.02, 0.03), (0.1, -0.2, 0.15))):

            def off(twist: Array, frame: Photographed = frame, pose: Array = pose) -> Array:
                return frame.look(pose @ machines.pose(twist[:3], twist[3:]))[0]

            jacobians.compare(frame.look(pose)[1], off, np.zeros(6), ["x", "y", "z", "rx", "ry", "rz"], 1e-6, 1e-5)


def planar(
    heights: tuple[float, ...], *, base: str = "pose", known: bool = True, size: float = 5e-4, seed: int = 1
) -> tuple[Fit, float]:
    """Lengths from the tool of an arm that moves in a plane to anchors; and how far the tool is off, rms, in m."""
    joints = "".join(
        f'<link name="l{k}"/><joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{x} 0 {z}"/><axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>'
        for k, (name, x, z) in enumerate((("a", 0.0, 0.1), ("b", 0.4, 0.0), ("c", 0.3, 0.0)))
    )
    robot = calib.load_robot(parse_urdf(f'<robot name="r">{joints}<link name="l3"/></robot>'.encode(), "r.urdf"), "l3")
    rng = np.random.default_rng(seed)
    # The offset of a joint is no deviation of its placement.
    moved = rng.normal(0.0, size, (3, 6)) * (1.0, 1.0, 1.0, 1.0, 1.0, 0.0)
    stands = np.eye(4) if base == "fixed" else machines.pose((1.9, -0.7, 0.4), (0.3, 0.0, 1.1))
    true = calib.CalibratedMachine(
        robot, calib.Deviations(moved, rng.normal(0.0, 1e-3, 3), np.zeros(0)), stands, {"tool": TOOL}
    )
    readings, target = rng.uniform(-2.0, 2.0, (60, 3)), np.arange(60) % len(heights)
    places = np.array([(0.9, 0.2, 0.0), (-0.3, 0.8, 0.0), (0.4, -0.7, 0.0), (-0.5, -0.4, 0.0), (1.0, 0.9, 0.0)])
    places[: len(heights), 2] = heights
    places = places @ stands[:3, :3].T + stands[:3, 3]
    points = true.predict(readings)[:, :3, 3]
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns["length [m]"] = np.linalg.norm(points - places[target], axis=1) + rng.normal(scale=SIGMA, size=60)
    columns["target"] = [f"A{t}" for t in target]
    data = calib.read_measurements(columns, robot, "distance", sigma=SIGMA)
    told = calib.Known(
        targets={f"A{t}": Target(machines.pose(places[t])) for t in set(target.tolist())} if known else {}
    )
    if base == "prior":
        told = replace(told, setups={"base": SetUp(stands, length=5e-3, angle=1e-2)})
    where = "fixed" if base == "fixed" else "pose"
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all", base=where, known=told), data)
    off = calib.machine_of(fit).predict(readings)[:, :3, 3] - points
    return fit, float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


@pytest.mark.parametrize(
    ("heights", "base", "trusted"),
    [
        ((0.0, 0.0, 0.0), "fixed", False),
        ((0.0, 0.3, 0.1), "fixed", True),
        ((0.0, 0.3, 0.1), "pose", False),
        ((0.0, 0.3, 0.1), "prior", True),
    ],
)
def test_lengths_of_a_planar_arm_are_the_same_on_both_sides(
    heights: tuple[float, float, float], base: str, *, trusted: bool
) -> None:
    """Its tilts have other signs there: with them held, no second place explained the lengths, and one was trusted.

    It was 100 mm off, or 280 mm, and told to 10 mm, or to less than 0.1 mm.
    """
    fit, off = planar(heights, base=base)
    assert (fit.alike is None) == trusted
    redundancy = next(check for check in calib.assess(fit).checks if check.name == "redundancy")
    assert redundancy.passed == trusted
    assert ("on the other side" in redundancy.sentence) != trusted
    assert off < 1e-3 or not trusted


@pytest.mark.parametrize("seed", range(4))
def test_anchors_around_the_plane_of_an_arm_place_its_base(seed: int) -> None:
    """Every anchor was put on the side that chance chose, and the base metres away from there."""
    fit, off = planar((0.3, 0.0, 0.9, 0.6), seed=seed)
    assert fit.converged
    assert fit.alike is None
    assert off < 1e-3


def test_an_anchor_of_a_planar_arm_leaves_signs_of_tilts_open() -> None:
    """They were told with a sigma, and were off by ten of it."""
    fit, _ = planar((0.1, 0.1, 0.1), base="fixed", known=False, size=1e-3)
    twice = {p.name for p, alike in zip(fit.parameters, fit.mirrored, strict=True) if alike}
    assert twice & {"b.rx", "b.ry", "c.rx", "c.ry"}
    assert np.isnan(fit.sigmas[fit.mirrored]).all()
    said = [finding.sentence for finding in calib.assess(fit).findings if finding.code == "mirrored"]
    # Whether the anchor is at two places as well depends on the last digits.
    assert "with other signs of" in said[-1]
