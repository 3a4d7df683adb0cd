"""What is not seen is as uncertain as what is seen deviates; what too little shows, or a user stated, stays."""

from dataclasses import replace

import numpy as np
import pytest

from calib.identification.not_seen import likely_widths
from calib.identification.parameters import TOOL, UNSHOWN_TOOL_WIDTH, UNSHOWN_TOOLS, Parameter, Wider

LENGTHS = tuple(Parameter(f"joint_{k}.tx", "m", "placement", ((k, 1.0),), weak_prior=1e-2) for k in range(40))
ZEROS = tuple(Parameter(f"joint_{k}.offset", "rad", "offset", ((k, 1.0),), weak_prior=0.1) for k in range(6))
BASE = (Parameter("base.x", "m", "base", ((50, 1.0),), weak_prior=10.0),)
ALL = (*LENGTHS, *ZEROS, *BASE)


def system(rng: np.random.Generator, true: np.ndarray, seen: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """J, r at where weak priors leave the parameters, and these, of which the first ones are seen."""
    p = len(true)
    J = 20.0 * rng.standard_normal((200, p))
    J[:, seen : len(LENGTHS)] = 0.0
    y = J @ true + rng.standard_normal(200)
    hold = np.diag([q.hold for q in ALL])
    z = np.linalg.solve(J.T @ J + hold**2, J.T @ y)
    return J, y - J @ z, z


def test_the_width_of_a_drawn_machine_comes_back() -> None:
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true = np.concatenate([0.5 * rng.standard_normal(40), 20.0 * rng.standard_normal(6), [300.0]])
        widths = likely_widths(ALL, *system(rng, true, 25))
        assert len(set(widths[:40])) == 1
        ratios.append((widths[0] / 0.5, widths[40] / 20.0))
        assert widths[-1] == pytest.approx(1e4)
    middle = np.median(ratios, axis=0)
    assert middle[0] == pytest.approx(1.0, abs=0.15)
    assert middle[1] == pytest.approx(1.1, abs=0.3)


def test_a_few_directions_teach_nothing() -> None:
    rng = np.random.default_rng(1)
    true = np.concatenate([0.5 * rng.standard_normal(40), 20.0 * rng.standard_normal(6), [300.0]])
    widths = likely_widths(ALL, *system(rng, true, 2))
    np.testing.assert_allclose(widths[:40], 10.0)
    assert 8.0 < widths[40] < 60.0


def test_a_stated_prior_is_taken_at_its_word() -> None:
    rng = np.random.default_rng(2)
    true = np.concatenate([0.1 * rng.standard_normal(40), 20.0 * rng.standard_normal(6), [300.0]])
    J, r, z = system(rng, true, 25)
    stated = (*(replace(q, prior=1e-3) for q in LENGTHS), *ZEROS, *BASE)
    np.testing.assert_allclose(likely_widths(stated, J, r, z)[:40], 1.0)
    assert likely_widths(BASE, J[:, -1:], r, z[-1:]) == pytest.approx(1e4)


def test_without_noise_nothing_breaks() -> None:
    rng = np.random.default_rng(3)
    true = np.concatenate([0.5 * rng.standard_normal(40), 20.0 * rng.standard_normal(6), [300.0]])
    J, r, z = system(rng, true, 25)
    widths = likely_widths(ALL, 1e7 * J, 1e7 * r, z)
    assert 0.2 < widths[0] < 1.0


def test_a_tool_that_is_held_nearer_than_it_is_known_is_as_far_as_tools_are() -> None:
    tool = Parameter("tool.x", "m", "tool", ((0, 1.0),), weak_prior=UNSHOWN_TOOL_WIDTH, wider=Wider(1.3, UNSHOWN_TOOLS))
    nothing = np.zeros((1, 1)), np.zeros(1), np.zeros(1)
    assert likely_widths((tool,), *nothing) * tool.scale == pytest.approx(TOOL)
    assert likely_widths((tool.widened({UNSHOWN_TOOLS}),), *nothing) * tool.scale == pytest.approx(1.3)
