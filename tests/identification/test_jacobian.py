"""Every column of the Jacobian against central differences, and the triangle against the whole Jacobian."""

import numpy as np
import pytest

from calib.foundations.errors import RobotError
from calib.identification import rows, system
from calib.identification.parameters import scales
from tests.support import machines
from tests.support.jacobians import check, problem

ARMS = {"ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0")} | {
    name: (text, "tip") for name, text in machines.INLINE.items()
}


@pytest.mark.parametrize(("observes", "tool"), [("position", "position"), ("position", "pose"), ("pose", "pose")])
@pytest.mark.parametrize("name", ARMS)
def test_columns_match_central_differences(name: str, observes: str, tool: str) -> None:
    check(*problem(*ARMS[name], observes, tool))


def test_a_machine_whose_deviations_are_no_numbers_is_refused() -> None:
    found, x = problem(*ARMS["ur10"], "position", "position", rows=10)
    with pytest.raises(RobotError, match="not finite"):
        found.machine(np.full_like(x, np.nan))


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_the_triangles_have_the_gram_matrix_of_the_whole_system(observes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found, x = problem(*ARMS["mimic"], observes, "pose", rows=50)
    (data,), (J,) = found.measurements, system.jacobian(found, x)
    monkeypatch.setattr(rows, "BLOCK", 7)
    (residual,), triangles, *_ = system.evaluate(found, [data.sigma], x)
    np.testing.assert_allclose(system.jacobian(found, x)[0], J, rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(
        residual, system.residuals(found.model.robot, found.measurements, found.machine(x))[0]
    )
    for component, triangle in zip(found.components, triangles, strict=True):
        whole = np.concatenate([J * scales(found.parameters), residual[:, :, None]], axis=2) / data.sigma[:, :, None]
        whole = whole[:, component.columns].reshape(-1, len(x) + 1)
        assert triangle.shape[0] <= len(x) + 1
        gram = whole.T @ whole
        # A turn of a tool about its own point moves nothing: what is left of it is rounding.
        lengths = np.maximum(np.sqrt(gram.diagonal()), 1e-6 * np.sqrt(gram.diagonal().max()))
        size = np.outer(lengths, lengths)
        np.testing.assert_allclose((triangle.T @ triangle) / size, gram / size, atol=1e-12)
