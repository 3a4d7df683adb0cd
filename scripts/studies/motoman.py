"""Two arms on one external axis, seen by a laser tracker: a real dual arm, judged by rows that were held out.

    python scripts/studies/motoman.py REPOSITORY [output folder]

REPOSITORY: a clone of https://github.com/ctu-vras/multirobot-calibration (a folder, or its git directory). It states
no licence, so none of its data is here: this script converts it. A Motoman of two six-axis arms on a common turntable,
which rested; a reflector on each hand (Leica), 6 x 6 x 6 grids, each from a station of its own. Every third row is held
out. Printed are mean errors in mm of these: by the nominal robot with base and tool fitted, by each arm alone, by both
arms in one job with a set-up each, and by plain least squares over DH numbers, with its own kinematics and SciPy; and
what is said of both arms with one base for all.
"""

import argparse
import io
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.foundations import rigid

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
    name = WHERE.format(side)
    if (repository / name).is_file():
        source = (repository / name).read_bytes()
    else:
        source = subprocess.run(
            ["git", f"--git-dir={repository}", "show", f"HEAD:{name}"], check=True, stdout=subprocess.PIPE
        ).stdout
    rows = loadmat(io.BytesIO(source))["dataset"]
    first = JOINTS[side]
    kept = rows[:, [TURNTABLE, *range(first, first + 6), *range(REFLECTOR.start, REFLECTOR.stop)]]
    kept = kept[np.sort(np.unique(kept, axis=0, return_index=True)[1])]
    kept = kept[np.isfinite(kept).all(axis=1) & (np.abs(kept[:, 7:]).max(axis=1) > 0.0)]
    return kept[:, :7], kept[:, 7:]


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


def main() -> None:
    """Convert, calibrate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("repository", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("motoman"))
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    (chosen.folder / "motoman.urdf").write_text(urdf(), encoding="utf-8")
    robot = calib.load_robot(chosen.folder / "motoman.urdf", "right_hand", links=["left_hand"])
    model = calib.error_model(robot, offsets="all", placements="all")
    sets: dict[str, tuple[calib.Measurements, calib.Measurements]] = {}
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
        print(
            f"{side}: {len(q)} rows, turntable over {np.ptp(q[:, 0]):.3f} rad; mean of every third row, held out, mm:"
        )
        print(
            f"  nominal {before * 1e3:.4f}, alone {after * 1e3:.4f}, plain least squares {plain(q, x, held) * 1e3:.4f}"
        )
    fit = calib.identify(model, [some for some, _ in sets.values()])
    for side, (_, rest) in sets.items():
        found = calib.assess(fit, rest).judged_by["after"]["position"].mean
        print(f"{side}: both arms in one job {found * 1e3:.4f}")
    print(f"formal rank {fit.rank} of {len(fit.parameters)}")
    as_one = [replace(some, setups=("base",), where=f"{side}.csv") for side, (some, _) in sets.items()]
    judged = calib.assess(calib.identify(model, as_one))
    named = [finding.sentence for finding in judged.findings if finding.code == "own-base"]
    print("with one base for both stations:", *judged.doubts, *named, sep="\n  ")


if __name__ == "__main__":
    main()
