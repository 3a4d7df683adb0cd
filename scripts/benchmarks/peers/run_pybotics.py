"""pybotics in the race of scripts/benchmarks/benchmark_peers.py.

It knows modified DH parameters only, four for each axis, so the nominal axes are turned into them here; of parallel
axes they cannot say that they lean. Its fit, as in its example, is SciPy's least squares of its function of errors,
which are distances: without a sign, and not smooth where they vanish. The setting "vectors" puts differences of
positions in their place, which is not its own doing but the best that its robot can do. Parameters that base or tool
imitate exactly are held, as its example advises. Lengths in mm, as it has them.
"""

from itertools import pairwise
from pathlib import Path

import exchange
import numpy as np
from exchange import Array, Case, Solved, Stopwatch
from pybotics.geometry import position_from_matrix
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

PARALLEL = 1e-6
SAME = 1e-6


def solve(case: Case, _: Path, setting: str) -> Solved:
    frames = axis_frames(case.points, case.directions)
    table = modified_dh(frames)
    robot = Robot.from_parameters(in_mm(table))
    robot.world_frame = millimetres(case.base @ frames[0])
    last = np.linalg.inv(frames[-1]) @ case.home
    last[:3, 3] += last[:3, :3] @ case.tool
    robot.tool = Tool(millimetres(last))
    positions = 1e3 * case.measured
    handler = OptimizationHandler(
        robot, kinematic_chain_mask=free(table).ravel(), tool_mask=[True] * 3 + [False] * 3, world_mask=True
    )

    def vectors(x: Array) -> Array:
        handler.apply_optimization_vector(x)
        found = np.array([position_from_matrix(handler.robot.fk(q)) for q in case.readings])
        return (positions - found).ravel()

    def distances(x: Array) -> Array:
        return optimize_accuracy(x, handler, case.readings, positions)

    x0 = handler.generate_optimization_vector()
    with Stopwatch() as watch:
        result = least_squares(vectors if setting == "vectors" else distances, x0, method="lm", x_scale="jac")
    handler.apply_optimization_vector(result.x)
    predicted = np.array([position_from_matrix(handler.robot.fk(q)) for q in case.unseen])
    return Solved(1e-3 * predicted, watch, len(x0), bool(result.success), f"{result.nfev} calls of its function")


def axis_frames(points: Array, directions: Array) -> Array:
    """Return frames (n, 4, 4) on axes: z along each, x along the common normal to the next, as modified DH wants."""
    frames, origin, x = [], points[0], np.zeros(3)
    for k, (p, z) in enumerate(zip(points, directions, strict=True)):
        origin = p + z * ((origin - p) @ z)
        if k + 1 < len(points):
            p_next, z_next = points[k + 1], directions[k + 1]
            across = np.cross(z, z_next)
            if np.linalg.norm(across) > PARALLEL:
                x = across / np.linalg.norm(across)
                # p + z s + x d = p_next + z_next t
                s = np.linalg.solve(np.column_stack([z, x, -z_next]), p_next - p)[0]
                origin = p + z * s
            else:
                across = p_next - origin
                across = across - z * (across @ z)
                x = across / np.linalg.norm(across)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = np.column_stack([x, np.cross(z, x), z]), origin
        frames.append(frame)
    return np.array(frames)


def modified_dh(frames: Array) -> Array:
    """Return rows (n, 4) of alpha, a, theta, d; of the first, which the base takes up, zeros."""
    rows = [np.zeros(4)]
    for one, other in pairwise(frames):
        T = np.linalg.inv(one) @ other
        alpha, theta = np.arctan2(-T[1, 2], T[2, 2]), np.arctan2(-T[0, 1], T[0, 0])
        rows.append(np.array([alpha, T[0, 3], theta, np.array([0.0, -np.sin(alpha), np.cos(alpha)]) @ T[:3, 3]]))
        assert np.allclose(link(rows[-1]), T, atol=SAME)
    return np.array(rows)


def link(row: Array) -> Array:
    """Return Rx(alpha) Tx(a) Rz(theta) Tz(d)."""
    alpha, a, theta, d = row
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [[ct, -st, 0.0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0.0, 0.0, 0.0, 1.0]]
    )


def free(table: Array) -> Array:
    """Return which of alpha, a, theta, d are free: not what the base, the tool or a parallel neighbour imitates."""
    mask = np.ones(table.shape, dtype=bool)
    mask[0] = False
    mask[-1, 2:] = False
    mask[1:, 3] &= np.abs(np.sin(table[1:, 0])) > PARALLEL
    return mask


def in_mm(table: Array) -> Array:
    return table * np.array([1.0, 1e3, 1.0, 1e3])


def millimetres(T: Array) -> Array:
    T = T.copy()
    T[:3, 3] *= 1e3
    return T


if __name__ == "__main__":
    exchange.run(solve, ("pybotics", "numpy", "scipy"))
