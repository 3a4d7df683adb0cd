"""robotkinecal in the race of scripts/benchmarks/benchmark_peers.py.

It reads URDF through the Robotics Toolbox and takes every axis for a z axis, which those of a UR10 are not; so a URDF
of the same nominal axes is written here in the form that it wants, with the guessed tool as its last link. (Its other
way, a PoERobot, fails: it counts base and end as joints.) It has no unknown base: measurements are brought into the
base by the guess, and what is left of it goes into the axes, which may move freely.
"""

import contextlib
import io
import tempfile
from pathlib import Path

import exchange
import numpy as np
import roboticstoolbox as rtb
from exchange import Array, Case, Solved, Stopwatch
from robotkinecal import SerialRobotKineCal
from spatialmath import SE3

PROBE = "probe"


def solve(case: Case, _: Path, setting: str) -> Solved:
    R, t = case.base[:3, :3], case.base[:3, 3]
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / "robot.urdf"
        file.write_text(urdf(case), encoding="utf-8")
        calibration = SerialRobotKineCal(rtb.ERobot.URDF(str(file)), PROBE)
    calibration.set_observations(list(case.readings), list((case.measured - t) @ R))
    np.random.seed(0)  # noqa: NPY002 - it draws its bases from here
    steps = {"max_iterations": 2} if setting == "two steps" else {}
    heard = io.StringIO()
    with contextlib.redirect_stdout(heard), Stopwatch() as watch:
        result = calibration.solve(**steps)
    joints = calibration.N_JOINTS
    predicted = np.array([calibration.forward_kinematics(joints + 1, q).t for q in case.unseen]) @ R.T + t
    said = f"{result.nb_iterations_executed} steps"
    if result.is_diverging:
        said += "; stopped because the error grew"
    if warnings := [line for line in heard.getvalue().splitlines() if "WARNING" in line]:
        said += f"; {warnings[0]}"
    return Solved(predicted, watch, calibration.N_PARAMS, bool(result.has_converged), said)


def urdf(case: Case) -> str:
    """Return a URDF of the nominal axes, each the z axis of its own frame, and of the tool."""
    placements = [frame(p, z) for p, z in zip(case.points, case.directions, strict=True)]
    tool = case.home.copy()
    tool[:3, 3] += tool[:3, :3] @ case.tool
    names = [f"link_{k}" for k in range(len(placements) + 1)]
    parts, last = [], np.eye(4)
    for k, (T, parent) in enumerate(zip([*placements, tool], names, strict=True)):
        origin, last = SE3(np.linalg.inv(last) @ T, check=False), T
        xyz, rpy = (" ".join(map(repr, map(float, v))) for v in (origin.t, origin.rpy(order="zyx")))
        kind, child = ("revolute", names[k + 1]) if k < len(placements) else ("fixed", PROBE)
        parts.append(
            f'<joint name="joint_{k}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.3" upper="6.3" effort="1" velocity="1"/></joint>'
        )
    links = "".join(f'<link name="{name}"/>' for name in [*names, PROBE])
    return f'<robot name="ur10">{links}{"".join(parts)}</robot>'


def frame(point: Array, z: Array) -> Array:
    """Return a frame (4, 4) at a point whose z is the unit vector ``z``."""
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), point
    return T


if __name__ == "__main__":
    exchange.run(solve, ("robotkinecal", "roboticstoolbox-python", "spatialmath-python", "numpy", "scipy"))
