"""What a residual and its Jacobian must cost at least: a loop in C++ over Pinocchio, and plain NumPy over all rows.

Both know one machine alone: a chain of joints that turn, seen by one instrument, one base and one tool. They have the
same unknowns as the problem that they are made of, and are held against its own answer before they are timed.
"""

import ctypes
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.foundations import rigid
from calib.identification.machine import Layout, Machine
from calib.identification.parameters import directions
from calib.identification.system import Problem
from calib.measurement.measurements import Measurements
from calib.robot.robot import segments
from calib.robot.skeleton import Outline, derivative

Array = NDArray[np.float64]
Answer = tuple[Array, Array]  # residuals (N, d) and Jacobians (N, d, p)

_SOURCE = Path(__file__).with_name("pinocchio_loop.cpp")
# As Pinocchio itself is built: its joints are more than Boost has room for by default.
_FLAGS = ("-O3", "-DNDEBUG", "-std=c++17", "-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS")
_EIGEN = ("/usr/include/eigen3", "/usr/local/include/eigen3", "/opt/homebrew/include/eigen3")


@dataclass(frozen=True)
class Plain:
    """A machine as bare arrays: ``placements`` (nj, 4, 4) of joints, ``tip`` behind the last, ``base`` and ``tool``.

    ``follow`` (6 nj + 6, p): local twists of the joints' placements, and last of the tool, for one unit of every
    parameter. ``rotations`` (N, 3, 3) are empty for positions.
    """

    placements: Array
    tip: Array
    base: Array
    tool: Array
    follow: Array
    readings: Array
    positions: Array
    rotations: Array

    @property
    def size(self) -> int:
        """How many numbers a row measures."""
        return 6 if self.rotations.size else 3


def plain(problem: Problem, data: Measurements, at: Machine, units: Array) -> Plain:
    """Return the machine of a problem at some values, derivatives by ``units`` (p,) of its parameters."""
    robot, frames = problem.model.robot, at.frames
    if set(robot.moving_types) != {"revolute"} or robot.loops or robot.terms or len(frames.tools) > 1:
        raise ValueError("the yardsticks know chains of turning joints, one base and one tool")
    layout, own = Layout.of(robot, frames), Outline(segments(robot)).skeleton(at.deviations.placements)
    S, (joints, tail) = directions(problem.parameters, layout.size) * units, derivative(own, robot.tip_joint)
    end, tool, moving = own.end_frame(robot.tip_joint), frames.tools[0], len(robot.moving)
    follow, placed = np.zeros((6 * moving + 6, len(units))), layout.offsets
    follow[:-6] = joints @ S[:placed]
    follow[5:-6:6] += robot.offset_coupling @ S[placed : layout.terms]
    follow[:6] += (
        rigid.adjoint(rigid.inverse(own.tree.placements[0])) @ at.base_twists[0] @ S[layout.base : layout.tools]
    )
    follow[-6:] = rigid.adjoint(rigid.inverse(tool)) @ tail @ S[:placed]
    follow[-6:] += at.tool_twists[0] @ S[layout.tools : layout.targets]
    readings = data.readings @ robot.coupling.T + robot.coupling_offset + robot.offset_coupling @ at.deviations.offsets
    rotations = np.zeros((0, 3, 3)) if data.orientation is None else data.orientation
    assert data.position is not None, "the yardsticks know positions and poses"
    return Plain(own.tree.placements, end.placement, frames.base, tool, follow, readings, data.position, rotations)


# ---- NumPy over all rows


class Walked(NamedTuple):
    """Where joints and tool are, rows last: ``axes`` (nj, 3, 3, N) and ``origins`` (nj, 3, N), the tool at R and p."""

    axes: Array
    origins: Array
    R: Array
    p: Array


def batched(plain: Plain) -> Answer:
    """Return residuals and Jacobians of all rows at once, as anyone could write them who has one such machine."""
    return from_frames(plain, walked(plain))


def walked(plain: Plain) -> Walked:
    """Return where joints and tool are in all rows."""
    n, nj = len(plain.readings), len(plain.placements)
    c, s = np.cos(plain.readings.T), np.sin(plain.readings.T)
    # Rows come last, so that every step is one over all of them; axes: joint, column, coordinate.
    axes, origins = np.empty((nj, 3, 3, n)), np.empty((nj, 3, n))
    R = np.broadcast_to(plain.base[:3, :3].T[:, :, None], (3, 3, n))
    p = np.broadcast_to(plain.base[:3, 3, None], (3, n))

    def moved(T: Array) -> Answer:
        there = (T[:3].T @ R.reshape(3, -1)).reshape(4, 3, n)
        return there[:3], p + there[3]

    for j, placement in enumerate(plain.placements):
        axes[j], origins[j] = moved(placement)
        R, p = np.empty((3, 3, n)), origins[j]
        R[0], R[1] = c[j] * axes[j, 0] + s[j] * axes[j, 1], c[j] * axes[j, 1] - s[j] * axes[j, 0]
        R[2] = axes[j, 2]
    return Walked(axes, origins, *moved(plain.tip @ plain.tool))


def from_frames(plain: Plain, there: Walked) -> Answer:
    """Return residuals and Jacobians of all rows, where joints and tool are being known."""
    n, nj, size = len(plain.readings), len(plain.placements), plain.size
    axes, origins, R, p = there
    # How the tool's position follows a shift and a turn of every placement, and how the tool turns with it.
    by = np.zeros((size, 6 * nj + 6, n))
    joints = by[:, :-6].reshape(size, nj, 6, n)
    arm = p - origins
    for i, k, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        joints[i, :, :3] = -axes[:, :, i]
        joints[i, :, 3:] = axes[:, :, m] * arm[:, None, k] - axes[:, :, k] * arm[:, None, m]
        by[i, -6:-3] = -R[:, i]
    residual = np.empty((n, size))
    residual[:, :3] = plain.positions - p.T
    if size == 6:
        turn = rigid.log3(R.transpose(2, 0, 1) @ plain.rotations)
        residual[:, 3:] = turn
        back = -rigid.left_jacobian_inverse(turn)
        about = (back @ R.transpose(2, 0, 1)).transpose(1, 2, 0)
        for i in range(3):
            joints[3 + i, :, 3:] = np.einsum("jkxn,xn->jkn", axes, about[i], optimize=False)
            by[3 + i, -3:] = back[:, i].T
    J = np.empty((n, size, plain.follow.shape[1]))
    for i in range(size):
        J[:, i] = by[i].T @ plain.follow
    return residual, J


def in_blocks(plain: Plain, rows: int = 256) -> None:
    """Do it for all rows of :func:`batched`, few at a time, nothing kept."""
    for start in range(0, len(plain.readings), rows):
        some = slice(start, start + rows)
        own = plain.rotations[some] if plain.size == 6 else plain.rotations
        batched(
            Plain(
                plain.placements,
                plain.tip,
                plain.base,
                plain.tool,
                plain.follow,
                plain.readings[some],
                plain.positions[some],
                own,
            )
        )


# ---- C++


class Loop:
    """The compiled loop for one machine."""

    def __init__(self, library: ctypes.CDLL, plain: Plain) -> None:
        self._library, self._plain = library, plain
        placements, tip = np.ascontiguousarray(plain.placements), np.ascontiguousarray(plain.tip)
        self._robot = ctypes.c_void_p(library.make(len(placements), _at(placements), _at(tip)))
        self._base, self._tool = np.ascontiguousarray(plain.base), np.ascontiguousarray(plain.tool)
        self._q = np.ascontiguousarray(plain.readings)
        self._positions = np.ascontiguousarray(plain.positions)
        self._rotations = np.ascontiguousarray(plain.rotations)
        at = np.argwhere(plain.follow)
        self._shares, self._where = plain.follow[tuple(at.T)], np.ascontiguousarray(at, dtype=np.intc)
        n, d, p = len(self._q), plain.size, plain.follow.shape[1]
        self._answer = np.empty((n, d)), np.empty((n, d, p))

    def kinematics(self) -> None:
        """Frames and regressors of all rows, nothing kept."""
        self._library.kinematics(self._robot, len(self._q), _at(self._q))

    def __call__(self) -> Answer:
        """Return residuals and Jacobians of all rows."""
        residuals, jacobians = self._answer
        self._library.residual_and_jacobian(
            self._robot,
            *jacobians.shape,
            *map(_at, (self._q, self._base, self._tool, self._positions, self._rotations)),
            len(self._shares),
            *map(_at, (self._where, self._shares, residuals, jacobians)),
        )
        return self._answer


def compiled(eigen: Path | None = None, folder: Path | None = None) -> ctypes.CDLL | str:
    """Build the loop in C++ and load it; where that cannot be, return the sentence that says why.

    ``folder``: where it is built and kept, a temporary one when None: to build it takes a minute.
    """
    compiler, prefix = shutil.which("g++"), Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix"
    if compiler is None:
        return "no C++ loop: there is no g++"
    if not (prefix / "include" / "pinocchio").is_dir():
        return f"no C++ loop: Pinocchio's headers are not in {prefix.name} of this environment"
    places = [eigen] if eigen is not None else [prefix / "include" / "eigen3", *map(Path, _EIGEN)]
    found = next((place for place in places if (place / "Eigen").is_dir()), None)
    if found is None:
        return "no C++ loop: Eigen's headers are missing (libeigen3-dev, or pip install cmeel-eigen)"
    with tempfile.TemporaryDirectory() as temporary:
        library = Path(temporary if folder is None else folder) / "loop.so"
        command = [
            compiler,
            *_FLAGS,
            "-march=native",
            "-shared",
            "-fPIC",
            "-w",
            f"-I{prefix / 'include'}",
            f"-I{found}",
        ]
        if not library.exists() or library.stat().st_mtime < _SOURCE.stat().st_mtime:
            command += [str(_SOURCE), "-o", str(library)]
            built = subprocess.run(command, capture_output=True, text=True, check=False)
            if built.returncode != 0:
                return f"no C++ loop: {next(iter(built.stderr.splitlines()), 'g++ failed')}"
        loaded = ctypes.CDLL(str(library))
    loaded.make.restype = ctypes.c_void_p
    loaded.make.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
    loaded.kinematics.restype = ctypes.c_double
    return loaded


def _at(values: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def same(answer: Callable[[], Answer], ours: Answer) -> float:
    """Return the largest difference of an answer from ours, beside the largest number there."""
    return max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in zip(answer(), ours, strict=True))
