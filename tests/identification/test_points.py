"""Points that differ from row to row in the tool's frame: scanners, profilers and depth cameras on the arm."""

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import MeasurementError
from calib.identification import system
from calib.identification.initialisation.problem import with_common_names
from calib.identification.machine import Frames, Layout
from calib.identification.observability import rank_findings
from calib.identification.system import Problem
from calib.identification.targets import unknowns
from tests.support import jacobians, machines
from tests.support.machines import Array, anywhere, pose
from tests.support.trees import tree

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
ROWS = 8
SIGMA = 2e-5
SENSOR = pose((0.05, -0.03, 0.11), (0.4, -0.3, 0.8))
KINDS: Mapping[str, Mapping[str, object]] = {
    "position": {"x [m]": np.linspace(-1.0, 1.0, ROWS), "y [m]": np.ones(ROWS), "z [m]": np.zeros(ROWS)},
    "socket": {},
    "distance": {"length [m]": np.full(ROWS, 0.7)},
    "pair_distance": {"length [m]": np.full(ROWS, 0.7), "pair": list("aabbccdd")},
    "plane": {},
    "sphere": {"diameter [m]": np.full(ROWS, 0.03)},
}


def points(seen: Array) -> dict[str, object]:
    return {f"point_{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}


# ---- derivatives


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("links", [{}, {"a": "right_hand", "b": "head"}], ids=["floor", "links"])
def test_columns_match_central_differences(kind: str, links: dict[str, str]) -> None:
    rng, made = np.random.default_rng(6), tree()
    robot = made.robot.with_tip("left_hand")
    columns = made.columns(made.draw(rng, ROWS)) | KINDS[kind] | points(rng.uniform(-0.4, 0.4, (ROWS, 3)))
    if kind not in ("position", "pair_distance"):
        columns |= {"target": ["a", "b", "c", "d"] * (ROWS // 4)}
    data = calib.read_measurements(columns, robot, kind, sigma=1e-3).named(on=links)
    model = calib.error_model(made.robot, offsets="all", placements=["*"], tool="pose")
    (data,) = with_common_names(model, [data])
    reference = Frames(
        np.stack([anywhere(rng)]),
        np.stack([anywhere(rng, 0.3)]),
        np.stack([anywhere(rng) for _ in data.targets]) if data.targets else np.zeros((0, 4, 4)),
    )
    parameters = (
        *model.parameters(data.tools, data.setups),
        *unknowns((data,), {}, Layout.of(model.robot, reference)),
    )
    jacobians.check(Problem(model, parameters, reference, (data,)), rng.uniform(-0.3, 0.3, len(parameters)))


# ---- truths found again


class Cell:
    """A badly made arm with a sensor of unknown pose on a link, and what it sees of things that stand on the floor."""

    def __init__(self, seed: int = 1) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot = machines.load(*UR5)
        self.arm = machines.arm(*UR5).moved(self.rng, length=0.3e-3, angle=0.5e-3, zero=2e-3)

    def sees(self, places: Array, names: list[str], *, flat: bool = False, sensor: Array = SENSOR) -> dict[str, object]:
        """The columns of rows in which the sensor sees places (n, 3) of the floor; ``flat``: in its plane y = 0.

        Of a plane sensor the arm is brought to where each place is in its plane.
        """
        q = self.arm.draw(self.rng, len(places))
        if flat:
            q = self.brought(q, places, sensor)
        seen = self.seen(q, places, sensor) + self.rng.normal(scale=SIGMA, size=places.shape) * [1.0, not flat, 1.0]
        found = {f"{name} [rad]": q[:, k] for k, name in enumerate(self.arm.ranges)} | points(seen)
        if flat:
            assert np.abs(seen[:, 1]).max() < 1e-9
            del found["point_y [m]"]
        return found | {"target": names}

    def seen(self, q: Array, places: Array, sensor: Array) -> Array:
        at = self.arm.tips(q) @ sensor
        return ((places - at[:, :3, 3])[:, None] @ at[:, :3, :3])[:, 0]

    def brought(self, q: Array, places: Array, sensor: Array) -> Array:
        """Readings near q at which the places are in the plane y = 0, by Newton's method in the joint that helps."""
        h = 1e-7
        for _ in range(60):
            y = self.seen(q, places, sensor)[:, 1]
            rates = np.stack([(self.seen(q + h * e, places, sensor)[:, 1] - y) / h for e in np.eye(q.shape[1])], axis=1)
            step = -y[:, None] * rates / np.sum(rates**2, axis=1)[:, None]
            q = q + step / np.maximum(1.0, 10.0 * np.abs(step).max(axis=1, keepdims=True))
        return q

    def off(self, fit: calib.Fit) -> float:
        """How far (m, rms) sensed points are from where they are, at new poses, machine and sensor together."""
        q = self.arm.draw(self.rng, 100)
        p = self.rng.uniform(-0.1, 0.1, (100, 3))
        machine = calib.machine_of(fit)
        found = (machine.predict(q) @ pose(p))[:, :3, 3]
        true = (self.arm.tips(q) @ SENSOR @ pose(p))[:, :3, 3]
        # What is not seen is where the base is: the machine is nominal there.
        A, B = found - found.mean(axis=0), true - true.mean(axis=0)
        R = Rotation.align_vectors(B, A)[0]
        return float(np.sqrt(np.mean(np.sum((R.apply(A) - B) ** 2, axis=1))))


BALLS = {"a": (0.5, 0.1, 0.2), "b": (-0.3, 0.5, 0.4), "c": (0.2, -0.5, 0.1)}


@pytest.mark.parametrize("flat", [False, True], ids=["3D sensor", "line scanner"])
def test_a_sensor_on_the_arm_that_looks_at_balls(flat: bool) -> None:
    cell = Cell()
    names = np.repeat(list(BALLS), 60)
    rows = cell.sees(np.array([BALLS[name] for name in names]), names.tolist(), flat=flat)
    data = calib.read_measurements(rows, cell.robot, "socket", sigma=SIGMA)
    fit = calib.identify(calib.error_model(cell.robot, offsets="all", placements="all", tool="pose"), data)
    assert fit.converged
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.2 * SIGMA
    assert cell.off(fit) < 3.0 * SIGMA
    # What is not seen is what no poses of this arm show either: of the cell as a whole, and what has two names.
    (J,) = system.jacobian(Problem(fit.model, fit.parameters, fit.machine.frames, fit.measurements), fit.values)
    seen = np.linalg.svd(J.reshape(-1, len(fit.parameters)) * 1e-3 / SIGMA, compute_uv=False) > 1.0
    assert fit.rank == fit.numerical_rank == np.count_nonzero(seen) == len(fit.parameters) - 18
    # The base is held: a cell that is turned and shifted as a whole looks the same. Its size does not.
    assert not [p for p in fit.parameters if p.kind == "base"]
    told = {finding.code for finding in rank_findings(fit.model, [data])}
    assert told == {"base-unseen"}


def test_a_plane_seen_by_a_line_scanner_whose_pose_is_about_known() -> None:
    cell = Cell(2)
    floor = {
        "low": (np.array([0.1, 0.2, 1.0]), -0.1),
        "side": (np.array([1.0, 0.1, -0.2]), 0.7),
        "back": (np.array([0.2, 1.0, 0.1]), 0.6),
    }
    names = np.repeat(list(floor), 80)
    places = []
    for name in names:
        n, h = floor[name]
        n = n / np.linalg.norm(n)
        x = cell.rng.uniform(-0.6, 0.6, 3)
        places.append(x - n * (n @ x - h))
    rows = cell.sees(np.array(places), names.tolist(), flat=True)
    data = calib.read_measurements(rows, cell.robot, "plane", sigma=SIGMA)
    about = SENSOR @ pose((0.01, 0.01, -0.01), (0.1, -0.1, 0.1))
    known = calib.Known(tools={"tool": about})
    model = calib.error_model(cell.robot, offsets="all", placements="all", tool="pose", known=known)
    fit = calib.identify(model, data)
    assert fit.converged
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.2 * SIGMA
    assert cell.off(fit) < 5.0 * SIGMA
    assert len(fit.parameters) - fit.rank == 18


# ---- what is wrong


@pytest.mark.parametrize("kind", ["pose", "pixels"])
def test_points_of_rows_that_are_about_more_are_refused(kind: str) -> None:
    robot = machines.load(*UR5)
    rows = {f"{r.name} [rad]": np.zeros(1) for r in robot.readings} | {"point_z [mm]": np.ones(1)}
    rows |= {f"{axis} [m]": np.zeros(1) for axis in "xyz"} | {f"q{axis}": np.ones(1) / 2 for axis in "wxyz"}
    if kind == "pixels":
        rows = {k: v for k, v in rows.items() if k[0] not in "xyzq"} | {"u [px]": np.ones(1), "v [px]": np.ones(1)}
    camera = calib.measuring.Camera("tip", 1e3, 1e3, 500.0, 500.0) if kind == "pixels" else None
    with pytest.raises(
        MeasurementError, match=rf"column 'point_z' .* observes = '{kind}' has no such point; leave it out"
    ):
        calib.read_measurements(rows, robot, kind, instrument=camera)


def test_the_nominal_robot_is_judged_with_the_turn_of_its_tool() -> None:
    """Positions alone do not turn a tool, and points beside it do: the fit without errors of the arm must have it."""
    cell = Cell()
    q, seen = cell.arm.draw(cell.rng, 40), cell.rng.uniform(-0.1, 0.1, (40, 3))
    there = np.einsum("nij,nj->ni", cell.arm.tips(q) @ SENSOR, np.column_stack([seen, np.ones(40)]))[:, :3]
    columns = {f"{name} [rad]": q[:, k] for k, name in enumerate(cell.arm.ranges)} | points(seen)
    columns |= {f"{axis} [m]": there[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, cell.robot, sigma=SIGMA)
    fit = calib.identify(calib.error_model(cell.robot, offsets="all", placements="all", tool="pose"), data)
    before = calib.assess(fit).metrics["identification"]["before"]["position"].rms
    # Errors of the arm make millimetres; a tool of another turn, a decimetre.
    assert before < 4e-3
    turn = Rotation.from_matrix(fit.nominal.frames.tools[0, :3, :3].T @ SENSOR[:3, :3])
    assert turn.magnitude() < 0.05
