"""How often do stated 95 % regions hold the truth? 1000 simulated calibrations of four kinds.

    python scripts/studies/coverage.py [--calibrations 1000] [--out docs/coverage.md]

The machines are made by this script alone: an arm of the UR10's size whose six axes are the z axes of its joint frames,
so that the deviations Trans Rx Ry Rz are written down as they stand in docs/theory.md, in a dozen lines of numpy. A
minimal set of parameters deviates, by 0.5 mm and 1 mrad (joint offsets 5 mrad), base and tool anywhere. A parameter's
interval is Student's t with the degrees of freedom of the estimated noise; the tool's region an ellipsoid after F.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

import calib
from calib.machine.calibrated import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.robot.urdf import parse_urdf

Array = NDArray[np.float64]

# xyz in m and rpy in rad of the six joint frames, each in the one before: lengths of a UR10.
JOINTS = (
    ((0.0, 0.0, 0.1273), (0.0, 0.0, 0.0)),
    ((0.0, 0.2209, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((0.612, 0.0, -0.1719), (0.0, 0.0, 0.0)),
    ((0.5723, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((0.0, -0.1157, 0.1149), (np.pi / 2, 0.0, 0.0)),
    ((0.0, 0.0922, 0.0), (-np.pi / 2, 0.0, 0.0)),
)
NAMES = tuple(f"joint_{i + 1}" for i in range(6))
POSES, UNSEEN, LIMIT = 40, 20, 2.5
SIGMA, SIGMA_ANGLE = 0.05e-3, 0.1e-3
PROBABILITY = 0.95


class Kind(NamedTuple):
    title: str
    observes: str
    stated: float  # as a share of the true sigma


KINDS = (
    Kind("positions, sigma stated as it is", "position", 1.0),
    Kind("positions, sigma stated 20 times too small", "position", 1.0 / 20.0),
    Kind("poses, sigmas stated as they are", "pose", 1.0),
    Kind("poses, sigmas stated 20 times too small", "pose", 1.0 / 20.0),
)


class Truth(NamedTuple):
    """Deviations (6, 6) of the joints, offsets (6,), base and tool (4, 4)."""

    deviations: Array
    offsets: Array
    base: Array
    tool: Array


class Counts(NamedTuple):
    parameters: int
    of_parameters: int
    poses: int
    of_poses: int


def placement(xyz: Array, R: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, xyz
    return T


def rx_ry_rz(angles: Array) -> Array:
    return Rotation.from_euler("XYZ", angles).as_matrix()


def nominal_origins() -> Array:
    return np.stack([placement(np.array(xyz), Rotation.from_euler("xyz", rpy).as_matrix()) for xyz, rpy in JOINTS])


def see(truth: Truth, readings: Array) -> Array:
    """Poses (N, 4, 4) of the tool in the instrument's frame."""
    T = np.broadcast_to(truth.base, (len(readings), 4, 4))
    for i, origin in enumerate(nominal_origins()):
        d = truth.deviations[i]
        turn = np.zeros((len(readings), 4, 4))
        turn[:, :3, :3] = Rotation.from_rotvec((readings[:, i] + truth.offsets[i])[:, None] * [0, 0, 1]).as_matrix()
        turn[:, 3, 3] = 1.0
        T = T @ origin @ placement(d[:3], rx_ry_rz(d[3:])) @ turn
    return T @ truth.tool


def urdf() -> bytes:
    links = ["base", *NAMES[:-1], "tip"]
    text = [f'<link name="link_{name}"/>' for name in links]
    for name, parent, child, (xyz, rpy) in zip(NAMES, links, links[1:], JOINTS, strict=False):
        text.append(
            f'<joint name="{name}" type="revolute"><parent link="link_{parent}"/><child link="link_{child}"/>'
            f'<origin xyz="{" ".join(map(repr, map(float, xyz)))}" rpy="{" ".join(map(repr, map(float, rpy)))}"/>'
            '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="coverage">{"".join(text)}</robot>'.encode()


def truth_of(rng: np.random.Generator, names: frozenset[str]) -> Truth:
    """A machine whose named parameters deviate."""
    components = ("tx", "ty", "tz", "rx", "ry", "rz")
    deviations = rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(6, 6))
    free = np.array([[f"{joint}.{component}" in names for component in components] for joint in NAMES])
    offsets = rng.normal(scale=5e-3, size=6) * [f"{joint}.offset" in names for joint in NAMES]
    base = placement(rng.uniform(-3, 3, 3), Rotation.random(rng=rng).as_matrix())
    tool = placement(
        np.array([0.05, 0.03, 0.12]) + rng.normal(scale=0.01, size=3), Rotation.random(rng=rng).as_matrix()
    )
    return Truth(deviations * free, offsets, base, tool)


def measured(
    truth: Truth, robot: calib.Robot, kind: Kind, readings: Array, rng: np.random.Generator
) -> calib.Measurements:
    poses = see(truth, readings)
    position = poses[:, :3, 3] + rng.normal(scale=SIGMA, size=(len(poses), 3))
    columns: dict[str, Array] = {f"{name} [rad]": readings[:, i] for i, name in enumerate(NAMES)}
    columns |= {f"{axis} [m]": position[:, k] for k, axis in enumerate("xyz")}
    if kind.observes == "position":
        return calib.read_measurements(columns, robot, "position", sigma=kind.stated * SIGMA)
    turns = Rotation.from_rotvec(rng.normal(scale=SIGMA_ANGLE, size=(len(poses), 3)))
    x, y, z, w = (Rotation.from_matrix(poses[:, :3, :3]) * turns).as_quat().T
    columns |= {"qw": w, "qx": x, "qy": y, "qz": z}
    return calib.read_measurements(columns, robot, "pose", sigma=(kind.stated * SIGMA, kind.stated * SIGMA_ANGLE))


def true_values(fit: calib.Fit, truth: Truth) -> Array:
    """The truth in the parameters of the fit; angles of base and tool are counted from its own reference."""
    values: dict[str, float] = {}
    for i, joint in enumerate(NAMES):
        values |= {
            f"{joint}.{c}": v for c, v in zip(("tx", "ty", "tz", "rx", "ry", "rz"), truth.deviations[i], strict=True)
        }
        values[f"{joint}.offset"] = truth.offsets[i]
    found = {parameter.name: value for parameter, value in zip(fit.parameters, fit.values, strict=True)}
    frames = fit.machine.frames
    for name, true, now in (("base", truth.base, frames.base), ("tool", truth.tool, frames.tools[0])):
        values |= {f"{name}.{axis}": true[k, 3] for k, axis in enumerate("xyz")}
        angles = np.array([found.get(f"{name}.{turn}", 0.0) for turn in ("rx", "ry", "rz")])
        reference = now[:3, :3] @ rx_ry_rz(angles).T
        turned = Rotation.from_matrix(reference.T @ true[:3, :3]).as_euler("XYZ")
        values |= {f"{name}.{turn}": turned[k] for k, turn in enumerate(("rx", "ry", "rz"))}
    return np.array([values[parameter.name] for parameter in fit.parameters])


def minimal(robot: calib.Robot, kind: Kind) -> list[str]:
    """Names of a minimal set of parameters, of which the data see every single one."""
    rng = np.random.default_rng(0)
    data = measured(truth_of(rng, frozenset()), robot, kind, rng.uniform(-LIMIT, LIMIT, (POSES, 6)), rng)
    fit = calib.identify(model_of(robot, kind), data, null_space="minimal")
    return [parameter.name for parameter in fit.parameters]


def model_of(robot: calib.Robot, kind: Kind) -> calib.ErrorModel:
    tool = "pose" if kind.observes == "pose" else "position"
    return calib.error_model(robot, offsets="all", placements="all", tool=tool)


def cover(kind: Kind, calibrations: int, seed: int = 1) -> Counts:
    """Count how often parameters and tool positions at unseen poses are inside their regions."""
    robot = calib.load_robot(parse_urdf(urdf(), "coverage.urdf"), tip="link_tip")
    model, names = model_of(robot, kind), minimal(robot, kind)
    rng = np.random.default_rng(seed)
    counts = Counts(0, 0, 0, 0)
    for _ in range(calibrations):
        truth = truth_of(rng, frozenset(names))
        data = measured(truth, robot, kind, rng.uniform(-LIMIT, LIMIT, (POSES, 6)), rng)
        fit = calib.identify(model, data, free=names)
        machine = machine_of(fit)
        radius = stats.t.ppf(0.5 + PROBABILITY / 2, machine.known_uncertainty.degrees_of_freedom)
        inside = np.abs(fit.values - true_values(fit, truth)) <= radius * fit.sigmas
        readings = rng.uniform(-LIMIT, LIMIT, (UNSEEN, 6))
        frames = fit.machine.frames
        predicted = frames.base @ robot.tips(readings, fit.deviations) @ frames.tools[0]
        errors = predicted[:, :3, 3] - see(truth, readings)[:, :3, 3]
        held = tool_uncertainty(machine, readings).inside(errors, PROBABILITY)
        counts = Counts(
            counts.parameters + int(inside.sum()),
            counts.of_parameters + inside.size,
            counts.poses + int(held.sum()),
            counts.of_poses + held.size,
        )
    return counts


def page(results: list[tuple[Kind, Counts]], calibrations: int) -> str:
    lines = [
        "# Do stated regions hold the truth?",
        "",
        f"{calibrations} simulated calibrations of each kind, {POSES} poses and {UNSEEN} unseen ones a time, noise "
        f"{SIGMA * 1e3:g} mm and",
        f"{SIGMA_ANGLE * 1e3:g} mrad a coordinate; share of stated 95 % regions that hold the truth, pooled over all. "
        "Made by `python scripts/studies/coverage.py`, whose",
        "first lines say how: the simulation shares no code with the toolkit.",
        "",
        "| measured | parameters | tool position at unseen poses |",
        "|---|--:|--:|",
    ]
    for kind, c in results:
        shares = (100 * c.parameters / c.of_parameters, 100 * c.poses / c.of_poses)
        lines.append(f"| {kind.title} | {shares[0]:.2f} % | {shares[1]:.2f} % |")
    return "\n".join([*lines, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibrations", type=int, default=1000)
    parser.add_argument("--out", type=Path, default=Path("docs/coverage.md"))
    arguments = parser.parse_args()
    results = [(kind, cover(kind, arguments.calibrations)) for kind in KINDS]
    text = page(results, arguments.calibrations)
    arguments.out.write_text(text, encoding="utf-8", newline="\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
