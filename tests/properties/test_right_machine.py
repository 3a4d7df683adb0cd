"""Sessions of few rows and large errors: the machine that is found is the one that an independent search finds.

Truth, residuals and minimum are made without calib; scripts/development/judge_solver.py judges as many sessions as one
likes.
"""

import os

import numpy as np
import pytest

from scripts.development.judge_cases import FAMILIES, case
from scripts.development.judge_machines import minimise
from scripts.development.judge_verdict import judge, stated

# Of every family; others with CALIB_EXAMPLES, which counts them.
COUNT = int(os.environ.get("CALIB_EXAMPLES", "0"))
SEEDS = range(1_000, 1_000 + COUNT) if COUNT else range(2)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_is_the_least_and_the_tool_as_near_as_can_be(family: str, seed: int) -> None:
    verdict = judge(case(seed, family))
    assert verdict.right, verdict
    assert verdict.converged is not False
    if verdict.outcome == "right":
        # Residuals are those of the machine, in sigmas, whoever computes them.
        assert verdict.kinematics < 1e-6


@pytest.mark.parametrize(("family", "seed"), [("panda", 56), ("irb2400", 63), ("arm_cmm", 43)])
def test_noise_that_nobody_stated_settles_together_with_the_parameters(family: str, seed: int) -> None:
    # Positions and orientations of few rows: which of them weigh how much changes the minimum, and that the weights.
    verdict = judge(case(seed, family))
    assert verdict.right, verdict
    assert verdict.evaluations is not None
    assert verdict.evaluations <= 8


@pytest.mark.parametrize("family", ["ur5", "irb2400", "sockets", "pixels"])
def test_derivatives_of_the_judge_are_those_of_its_costs(family: str) -> None:
    session = case(1, family)
    cost = stated(session, None, "stated")
    h, J = 1e-6, cost.jacobian(session.truth)
    for k, column in enumerate(J.T):
        step = np.zeros(len(session.truth))
        step[k] = h
        (up, _), (down, _) = (cost.whitened((session.truth + s)[None]) for s in (step, -step))
        numeric = (up[0] - down[0]) / (2.0 * h)
        assert np.abs(column - numeric).max() <= 1e-7 * np.abs(J).max()


@pytest.mark.parametrize("family", ["ur5_few", "panda"])
def test_the_judge_finds_one_minimum_from_truth_and_from_nearby(family: str) -> None:
    session = case(2, family)
    cost = stated(session, None, "stated")
    scale = np.where(np.isfinite(cost.widths), np.minimum(cost.widths, 0.1), 0.1)
    away = session.truth + 0.2 * scale * np.random.default_rng(0).uniform(-1.0, 1.0, len(scale))
    there, back = minimise(cost, session.truth), minimise(cost, away)
    assert there.settled
    assert abs(back.total - there.total) <= 1e-6 * there.total
    assert cost.of(session.truth)[0] >= there.data
