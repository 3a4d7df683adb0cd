"""Make the measurements of robots/positioner: a two-axis positioner touched by the spike of a welding robot.

    python scripts/simulate/positioner.py [output folder] [--seed 1]

Its own mathematics, on purpose: whoever calibrates this positioner cannot repeat a mistake made here. Lengths in mm,
angles in deg at the edges and rad inside. The same seed writes the same bytes; another seed touches otherwise.

    places(readings_deg, mark)     where a mark of the table really is, mm in the robot's base
    tip(joints_rad)                where the spike's tip is, and which way it points
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEED = 1

# The true positioner: B_P in the robot's base and L_R in the tilting frame, rotation vectors in rad, mm.
Q = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
BASE_TURN, BASE_PLACE = (0.02, -0.03, 0.4), (1500.0, -200.0, 600.0)
ROTARY_TURN, ROTARY_PLACE = (0.004, -0.003, 0.0), (60.0, 0.0, 15.0)
MARKS = {"A": (300.0, 0.0, 80.0), "B": (-180.0, 260.0, 50.0)}

# The robot: where each joint is in the link before, mm, and the axis it turns about; the spike's tip at the flange.
JOINTS = (
    ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ((150.0, 0.0, 600.0), (0.0, 1.0, 0.0)),
    ((0.0, 0.0, 950.0), (0.0, 1.0, 0.0)),
    ((0.0, 0.0, 150.0), (1.0, 0.0, 0.0)),
    ((1000.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    ((150.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
)
LIMITS_DEG = np.array([(-170, 170), (-90, 120), (-150, 90), (-185, 185), (-130, 130), (-360, 360)], dtype=float)
SPIKE = (5.3, -3.8, 212.4)

# Standard deviation of a touched coordinate, and of one in the pivot's cone, which seats the tip; mm. Encoders in deg.
NOISE, SEAT = 0.1, 0.05
DIGITS = 4
CONE = (1100.0, 450.0, 700.0)
ORIENTATIONS, LEAN_DEG = 16, 40.0

# What is touched to identify from, (tilt, rotary) in deg: the 20 mixed poses of the table of expected errors.
TOUCHED = (
    [(0, r) for r in (0, 60, 120, 180, -120, -60)]
    + [(t, 0) for t in (90, 45, -45, -90)]
    + [(60, 90), (60, -90), (-60, 90), (-60, -90), (30, 180), (-30, 180), (90, 45), (-90, 45), (80, 150), (-80, -150)]
)
VALIDATED = 24


def rotation(w: tuple[float, ...] | Array) -> Array:
    """The rotation (3, 3) by a vector, in rad (Rodrigues)."""
    v = np.asarray(w, dtype=float)
    angle = float(np.linalg.norm(v))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = v / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def table(readings_deg: tuple[float, float] | Array) -> tuple[Array, Array]:
    """Rotation and place (mm) of the table in the robot's base at tilt and rotary."""
    tilt, rotary = np.radians(readings_deg)
    about_z = [rotation((0.0, 0.0, a)) for a in (tilt, rotary)]
    R = rotation(BASE_TURN) @ Q @ about_z[0]
    place = np.array(BASE_PLACE) + R @ np.array(ROTARY_PLACE)
    return R @ Q @ rotation(ROTARY_TURN) @ about_z[1], place


def places(readings_deg: tuple[float, float] | Array, mark: tuple[float, float, float]) -> Array:
    R, place = table(readings_deg)
    return place + R @ np.array(mark)


def tip(joints: Array) -> tuple[Array, Array]:
    """Place (mm) of the spike's tip in the robot's base, and the direction it points in, at joint angles (rad)."""
    place, direction, _ = walk(joints)
    return place, direction


def walk(joints: Array) -> tuple[Array, Array, Array]:
    """The same, and how both change (6, 6) with every joint."""
    R, place = np.eye(3), np.zeros(3)
    pivots, axes = [], []
    for q, (offset, axis) in zip(joints, JOINTS, strict=True):
        place = place + R @ np.array(offset)
        pivots.append(place)
        axes.append(R @ np.array(axis))
        R = R @ rotation(q * np.array(axis))
    # z of the flange points along x of the last link, x against its z.
    flange = R @ rotation((0.0, np.pi / 2, 0.0))
    place, direction = place + flange @ np.array(SPIKE), flange[:, 2]
    J = [np.concatenate([np.cross(a, place - p), np.cross(a, direction)]) for a, p in zip(axes, pivots, strict=True)]
    return place, direction, np.stack(J, axis=1)


def reach(target: Array, pointing: Array, rng: np.random.Generator) -> Array | None:
    """Joint angles (rad) that bring the tip to ``target`` (mm), pointing as asked, by damped Gauss-Newton; or None."""
    low, high = np.radians(LIMITS_DEG).T
    weight = np.repeat((1.0, 500.0), 3)
    for _ in range(8):
        q = np.array([np.arctan2(target[1], target[0]), 0.4, 0.0, 0.0, 0.5, 0.0]) + rng.normal(scale=0.5, size=6)
        for step in range(40):
            place, direction, J = walk(q)
            r = weight * np.concatenate([place - target, direction - pointing])
            if np.abs(r).max() < 1e-9:
                break
            J *= weight[:, None]
            # At first well damped; then hardly, as no turn of the spike about itself is asked for.
            damping = (1e4 if step < 10 else 1e-3) * np.eye(6)
            move = np.linalg.solve(J.T @ J + damping, -J.T @ r)
            q = q + move * min(1.0, 0.5 / float(np.abs(move).max()))
        if np.abs(r).max() < 1e-6:
            q[[3, 5]] = (q[[3, 5]] + np.pi) % (2.0 * np.pi) - np.pi
            if np.all((q > low) & (q < high)):
                return q
    return None


def leaning(direction: Array, most_deg: float, rng: np.random.Generator) -> Array:
    """A direction up to so far from another."""
    axis = np.cross(direction, rng.normal(size=3))
    return rotation(axis / np.linalg.norm(axis) * np.radians(rng.uniform(0.0, most_deg))) @ direction


def touch(readings_deg: tuple[float, float] | Array, mark: str, rng: np.random.Generator) -> Array:
    """Joint angles (deg) of the robot as it touches a mark, give or take the noise."""
    target = places(readings_deg, MARKS[mark]) + rng.normal(scale=NOISE, size=3)
    normal = table(readings_deg)[0][:, 2]
    for most in (20.0, 20.0, 50.0, 50.0, 80.0, 80.0, 110.0, 110.0, 150.0, 150.0):
        q = reach(target, leaning(-normal, most, rng), rng)
        if q is not None:
            return np.degrees(q)
    raise RuntimeError(f"the robot does not reach mark {mark} at {readings_deg}")


def pivot(rng: np.random.Generator) -> Array:
    """Joint angles (N, 6) in deg: the tip in a cone, the spike leaning in many ways."""
    found: list[Array] = []
    while len(found) < ORIENTATIONS:
        target = np.array(CONE) + rng.normal(scale=SEAT, size=3)
        q = reach(target, leaning(np.array([0.0, 0.0, -1.0]), LEAN_DEG, rng), rng)
        if q is not None:
            found.append(np.degrees(q))
    return np.array(found)


def rows(poses: list[tuple[float, float]], marks: list[str], rng: np.random.Generator) -> list[str]:
    return [
        ", ".join([*(f"{v:.{DIGITS}f}" for v in touch(pose, mark, rng)), *(f"{v:g}" for v in pose), mark])
        for pose, mark in zip(poses, marks, strict=True)
    ]


def text(seed: int, says: str, header: list[str], lines: list[str]) -> str:
    origin = f"# Simulated, not measured on a real machine: scripts/simulate/positioner.py, seed {seed}."
    return "\n".join([origin, f"# {says}", ", ".join(header), *lines, ""])


def truth_text(seed: int) -> str:
    def listed(values: tuple[float, ...]) -> str:
        return f"[{', '.join(map(repr, values))}]"

    lines = [
        f"# The simulated positioner and robot: scripts/simulate/positioner.py, seed {seed}.",
        "# Axes are z of their frames. The tilt axis' frame is turned by R(rotation) Q in the robot's base, the rotary",
        "# axis' one by Q R(rotation) in the tilting frame; R of a rotation vector, Q takes x, y, z to y, z, x.",
        f"seed = {seed}",
        f"sigma_mm = {NOISE}",
        f"sigma_pivot_mm = {SEAT}",
        f"spike_on_flange_mm = {listed(SPIKE)}",
        "",
        "[tilt]",
        f"translation_mm = {listed(BASE_PLACE)}",
        f"rotation_rad = {listed(BASE_TURN)}",
        "",
        "[rotary]",
        f"translation_mm = {listed(ROTARY_PLACE)}",
        f"rotation_rad = {listed(ROTARY_TURN)}",
        "",
        "[marks_on_table_mm]",
        *(f"{name} = {listed(mark)}" for name, mark in MARKS.items()),
    ]
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    case = Path(__file__).resolve().parents[2] / "robots" / "positioner"
    parser.add_argument("output", type=Path, nargs="?", default=case, help="folder to write (default: the case)")
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    seed = arguments.seed
    rng = np.random.default_rng(seed)
    joints = [f"joint_{k} [deg]" for k in range(1, 7)]
    header = [*joints, "tilt [deg]", "rotary [deg]", "tool"]
    identified = [(pose, mark) for mark in MARKS for pose in TOUCHED]
    drawn = [(round(rng.uniform(-90, 90), 1), round(rng.uniform(-180, 180), 1)) for _ in range(VALIDATED)]
    names = list(MARKS)
    texts = {
        "pivot.csv": text(
            seed,
            f"A cone touched in {ORIENTATIONS} orientations of the spike: where its tip is on the flange.",
            [*joints, "target"],
            [", ".join([*(f"{v:.{DIGITS}f}" for v in row), "cone"]) for row in pivot(rng)],
        ),
        "touched.csv": text(
            seed,
            "Two marks on the table, each touched at 20 poses: readings of the robot and of the positioner.",
            header,
            rows([pose for pose, _ in identified], [mark for _, mark in identified], rng),
        ),
        "validation.csv": text(
            seed,
            f"The same marks at {VALIDATED} other poses.",
            header,
            rows(drawn, [names[k % len(names)] for k in range(VALIDATED)], rng),
        ),
    }
    texts["truth.toml"] = truth_text(seed)
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name, contents in texts.items():
        (arguments.output / name).write_text(contents, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
