"""Base and tools without a guess: exact on exact data, globally best on imperfect data."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.identification.initialisation import base_and_tools as module
from calib.identification.initialisation.base_and_tools import (
    KnownFrames,
    TipObservations,
    _base_and_change,
    _best_rotation,
    base_and_tools,
)
from tests.support.machines import Array, anywhere, pose

NOTHING = KnownFrames(None, None, None)


class Scene:
    """Random tips, a base anywhere and tools up to 0.3 m away, of which every row saw one."""

    def __init__(self, seed: int, n: int = 30, tools: int = 2, noise: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.base = anywhere(rng)
        self.tools = np.stack([anywhere(rng, 0.2) for _ in range(tools)])
        self.tips = np.stack([anywhere(rng, 1.0) for _ in range(n)])
        self.tool = np.arange(n) % tools
        self.seen = self.base @ self.tips @ self.tools[self.tool]
        self.seen[:, :3, 3] += rng.normal(scale=noise, size=(n, 3))
        self.guess = np.tile(np.eye(4), (tools, 1, 1))

    def rows(self, turned: bool | Array) -> TipObservations:
        orientation = np.where(np.reshape(turned, (-1, 1, 1)), self.seen[:, :3, :3], np.nan)
        return TipObservations(self.tips, self.seen[:, :3, 3], orientation, self.tool)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("knows", ["nothing", "base", "points", "base and points"])
def test_positions_place_base_and_points(seed: int, knows: str) -> None:
    scene = Scene(seed)
    known = KnownFrames(
        scene.base if "base" in knows else None,
        scene.tools[:, :3, 3] if "points" in knows else None,
        scene.guess[:, :3, :3],
    )
    base, tools, _ = base_and_tools(scene.rows(turned=False), known, scene.guess)
    np.testing.assert_allclose(base, scene.base, atol=1e-12)
    np.testing.assert_allclose(tools[:, :3, 3], scene.tools[:, :3, 3], atol=1e-12)
    np.testing.assert_array_equal(tools[:, :3, :3], scene.guess[:, :3, :3])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("knows", ["nothing", "base", "points", "rotations", "base and rotations"])
def test_poses_place_base_and_tools(seed: int, knows: str) -> None:
    scene = Scene(seed)
    known = KnownFrames(
        scene.base if "base" in knows else None,
        scene.tools[:, :3, 3] if "points" in knows else None,
        scene.tools[:, :3, :3] if "rotations" in knows else None,
    )
    base, tools, _ = base_and_tools(scene.rows(turned=True), known, scene.guess)
    np.testing.assert_allclose(base, scene.base, atol=1e-12)
    np.testing.assert_allclose(tools, scene.tools, atol=1e-12)


def test_a_tool_that_only_positions_saw_keeps_the_rotation_of_the_guess() -> None:
    scene = Scene(0)
    base, tools, _ = base_and_tools(scene.rows(turned=scene.tool == 0), NOTHING, scene.guess)
    np.testing.assert_allclose(base, scene.base, atol=1e-12)
    np.testing.assert_allclose(tools[0], scene.tools[0], atol=1e-12)
    np.testing.assert_allclose(tools[1], pose(scene.tools[1, :3, 3]), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_positions_of_a_bad_machine_are_explained_as_well_as_from_the_truth(seed: int) -> None:
    """Errors of 50 mm, few rows: a local search that starts at the truth finds nothing better."""
    scene = Scene(seed, n=8, tools=1, noise=0.05)

    def residual(x: Array) -> Array:
        seen = pose(x[:3], x[3:6]) @ scene.tips @ pose(x[6:])
        return (seen[:, :3, 3] - scene.seen[:, :3, 3]).ravel()

    def x_of(base: Array, tools: Array) -> Array:
        return np.concatenate([base[:3, 3], Rotation.from_matrix(base[:3, :3]).as_rotvec(), tools[0, :3, 3]])

    best = least_squares(residual, x_of(scene.base, scene.tools), xtol=1e-12, ftol=1e-12)
    found = residual(x_of(*base_and_tools(scene.rows(turned=False), NOTHING, scene.guess)[:2]))
    assert found @ found <= 2 * best.cost * (1 + 1e-9)


def test_what_the_rows_do_not_determine_stays_as_guessed() -> None:
    """All tips turn about one axis, so the point's place along it cannot be told from the base's."""
    scene = Scene(0, tools=1)
    angles = np.linspace(0.0, 5.0, len(scene.tips))
    scene.tips = pose(rotvec=np.outer(angles, [0.0, 0.0, 1.0]))
    scene.seen = scene.base @ scene.tips @ scene.tools
    guess = pose([[0.0, 0.0, 0.7]])
    base, tools, _ = base_and_tools(scene.rows(turned=False), NOTHING, guess)
    assert tools[0, 2, 3] == pytest.approx(0.7, abs=1e-9)
    assert np.hypot(*tools[0, :2, 3]) == pytest.approx(np.hypot(*scene.tools[0, :2, 3]), abs=1e-9)
    np.testing.assert_allclose((base @ scene.tips @ tools)[:, :3, 3], scene.seen[:, :3, 3], atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-320, 1e-300, 1e-160, 1e-99])
def test_positions_so_near_to_one_point_that_no_number_is_left_place_something(size: float) -> None:
    scene = Scene(0)
    rows = scene.rows(turned=False)
    base, tools, _ = base_and_tools(rows._replace(position=size * rows.position), NOTHING, scene.guess)
    assert np.isfinite(base).all()
    assert np.isfinite(tools).all()


def test_the_rotation_found_is_the_best_also_where_much_is_left() -> None:
    """As of a table with a mistake in it: sums of squares at random, beside scipy from all turns of a cube."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        X, c = rng.normal(size=(10, 9)), 3.0 * rng.normal(size=10)

        def residual(w: Array, A: Array, X: Array = X, c: Array = c) -> Array:
            return X @ (A @ Rotation.from_rotvec(w).as_matrix()).T.ravel() - c

        starts = Rotation.create_group("O").as_matrix()
        least = min(least_squares(residual, np.zeros(3), args=(A,)).cost for A in starts)
        found = _best_rotation(X, c)
        assert 0.5 * np.sum(residual(np.zeros(3), found) ** 2) <= least * (1.0 + 1e-9)


def test_directions_of_tools_that_positions_do_not_show_are_left_out_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tip that never turns shows no tool but beside others: of forty tools, only their differences."""
    calls: list[int] = []

    def counted(*arguments: Any) -> tuple[Array, Array]:
        calls.append(arguments[-1].shape[2])
        return _base_and_change(*arguments)

    monkeypatch.setattr(module, "_base_and_change", counted)
    scene = Scene(3, n=400, tools=40, noise=1e-3)
    # Each tool is seen with the tip turned one way, up to a hundredth of a degree.
    turns = Rotation.random(40, random_state=4).as_matrix()[scene.tool]
    jitter = Rotation.from_rotvec(np.random.default_rng(5).normal(scale=2e-4, size=(400, 3))).as_matrix()
    scene.tips[:, :3, :3] = turns @ jitter
    scene.seen = scene.base @ scene.tips @ scene.tools[scene.tool]
    scene.seen[:, :3, 3] += np.random.default_rng(6).normal(scale=0.05, size=(400, 3))
    base_and_tools(scene.rows(turned=False), KnownFrames(None, None, scene.guess[:, :3, :3]), scene.guess)
    assert len(calls) <= 4
    assert calls[-1] < calls[0]
