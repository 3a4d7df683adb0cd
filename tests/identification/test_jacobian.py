"""Every column of the Jacobian against central differences, and the triangle against the whole Jacobian."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.identification import system
from calib.identification.machine import Frames
from calib.identification.parameters import scales
from calib.identification.system import Problem
from tests.identification import machines

ARMS = {"ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0")} | {
    name: (text, "tip") for name, text in machines.INLINE.items()
}
TOOLS = ("near", "far")


def problem(
    urdf: str, tip: str, observes: str, tool: str, rows: int = 6, base: str | None = None
) -> tuple[Problem, machines.Array]:
    """Everything free, fixed joints too, at a point far from zero; residual turns up to 2 rad."""
    rng = np.random.default_rng(7)
    robot, arm = machines.load(urdf, tip, base), machines.arm(urdf, tip, base)
    model = calib.error_model(robot, offsets="all", placements=["*"], tool=tool)
    parameters = model.parameters(TOOLS)
    reference = Frames(machines.anywhere(rng), np.stack([machines.anywhere(rng, 0.3) for _ in TOOLS]))
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


def check(found: Problem, x: machines.Array) -> None:
    """Analytic and numeric columns agree to 1e-6 of the column, or of 1 mm per m where a column is smaller."""

    def residuals(at: machines.Array) -> machines.Array:
        return system.residuals(found.model.robot, found.measurements, found.machine(at))[0].ravel()

    h = 1e-5
    (J,) = system.jacobian(found, x)
    J = J.reshape(-1, len(x))
    for k, parameter in enumerate(found.parameters):
        step = h * (np.arange(len(x)) == k)
        numeric = (residuals(x + step) - residuals(x - step)) / (2 * h)
        error = np.abs(J[:, k] - numeric).max()
        assert error <= 1e-6 * max(np.abs(numeric).max(), 1e-3), parameter.name


@pytest.mark.parametrize(("observes", "tool"), [("position", "position"), ("position", "pose"), ("pose", "pose")])
@pytest.mark.parametrize("name", ARMS)
def test_columns_match_central_differences(name: str, observes: str, tool: str) -> None:
    check(*problem(*ARMS[name], observes, tool))


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_the_triangles_have_the_gram_matrix_of_the_whole_system(observes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found, x = problem(*ARMS["mimic"], observes, "pose", rows=50)
    (data,), (J,) = found.measurements, system.jacobian(found, x)
    monkeypatch.setattr(system, "BLOCK", 7)
    (residual,), triangles, _, _ = system.evaluate(found, [data.sigma], x)
    np.testing.assert_allclose(system.jacobian(found, x)[0], J, rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(
        residual, system.residuals(found.model.robot, found.measurements, found.machine(x))[0]
    )
    for component, triangle in zip(found.components, triangles, strict=True):
        whole = np.concatenate([J * scales(found.parameters), residual[:, :, None]], axis=2) / data.sigma[:, :, None]
        whole = whole[:, component.columns].reshape(-1, len(x) + 1)
        assert triangle.shape[0] <= len(x) + 1
        gram = whole.T @ whole
        size = np.sqrt(np.outer(gram.diagonal(), gram.diagonal())) + 1e-300
        np.testing.assert_allclose((triangle.T @ triangle) / size, gram / size, atol=1e-12)
