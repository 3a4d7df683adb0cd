"""A problem far from zero with everything free, and its analytic columns against central differences."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.identification import system
from calib.identification.machine import Frames
from calib.identification.stances import touches
from calib.identification.system import Problem
from tests.support import machines

TOOLS = ("near", "far")


def problem(
    urdf: str, tip: str, observes: str, tool: str, rows: int = 6, base: str | None = None
) -> tuple[Problem, machines.Array]:
    """Everything free, fixed joints too, at a point far from zero; residual turns up to 2 rad."""
    rng = np.random.default_rng(7)
    robot, arm = machines.load(urdf, tip, base), machines.arm(urdf, tip, base)
    model = calib.error_model(robot, offsets="all", placements=["*"], tool=tool)
    parameters = model.parameters(TOOLS)
    reference = Frames(machines.anywhere(rng)[None], np.stack([machines.anywhere(rng, 0.3) for _ in TOOLS]))
    x = rng.uniform(-0.3, 0.3, len(parameters))
    of_base = [k for k, parameter in enumerate(parameters) if parameter.kind == "base"]
    x[of_base] = rng.uniform(-2.0, 2.0, 6)
    true = machines.Machine(arm, machines.anywhere(rng), dict.fromkeys(TOOLS, np.eye(4)))
    data = true.measure(
        robot, arm.draw(rng, rows), observes, points=(TOOLS * rows)[:rows], sigma=1e-3, sigma_angle=2e-3
    )
    found = Problem(model, parameters, reference, (data,))
    if data.orientation is not None:
        at = found.machine(x)
        tips = at.frames.base @ robot.tips(data.readings, at.deviations) @ at.frames.tools[data.tool]
        turns = Rotation.from_rotvec(rng.uniform(-1.1, 1.1, (rows, 3))).as_matrix()
        found = replace(found, measurements=(replace(data, orientation=tips[:, :3, :3] @ turns),))
    return found, x


def check(
    found: Problem, x: machines.Array, steps: machines.Array | float = 1e-5, within: float = 1e-6, least: float = 1e-3
) -> None:
    """Analytic and numeric columns agree as :func:`compare` asks, at the readings at which they are taken."""
    (data,) = found.measurements
    if touches(data):
        blocks = found.rates(found.machine(x), np.ones(len(x))).blocks(data)
        data = replace(data, readings=np.concatenate([block.readings for block in blocks]))

    def residuals(at: machines.Array) -> machines.Array:
        return system.residuals(found.model.robot, [data], found.machine(at))[0].ravel()

    (J,) = system.jacobian(found, x)
    names = [parameter.name for parameter in found.parameters]
    compare(J.reshape(-1, len(x)), residuals, x, names, steps, within, least)


def compare(
    analytic: machines.Array,
    of: Callable[[machines.Array], machines.Array],
    x: machines.Array,
    names: Sequence[str],
    steps: machines.Array | float = 1e-5,
    within: float = 1e-6,
    least: float = 1e-3,
) -> None:
    """Columns (m, p) agree with central differences, by ``within`` of the column, or of ``least`` where it is smaller.

    ``steps``: one of each parameter (p,), or the same for all.
    """
    for k, (name, h) in enumerate(zip(names, np.broadcast_to(steps, x.shape), strict=True)):
        step = h * (np.arange(len(x)) == k)
        numeric = (of(x + step) - of(x - step)) / (2 * h)
        error = np.abs(analytic[:, k] - numeric).max()
        assert error <= within * max(np.abs(numeric).max(), least), name
