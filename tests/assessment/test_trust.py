"""A calibration that should not be used says so."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.metrics import Metrics
from calib.assessment.trust import doubts, remarks
from calib.identification.identify import with_values
from tests.support import machines


def figures(rms: float, quantity: str = "position") -> dict[str, Metrics]:
    return {quantity: Metrics("m", 10, rms, rms, rms, rms)}


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    text = machines.INLINE["negative"]
    rng = np.random.default_rng(4)
    true = machines.arm(text, "tip").moved(rng)
    machine = machines.Machine(true, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    robot = machines.load(text, "tip")
    data = machine.measure(robot, true.draw(rng, 40), rng=rng, sigma=1e-5)
    return calib.identify(calib.error_model(robot, offsets="all"), data)


def test_good_calibration_has_no_doubts(fit: calib.Fit) -> None:
    assert doubts(fit, figures(2e-3), figures(1e-3), held_out=True) == ()


def test_no_better_on_held_out_data(fit: calib.Fit) -> None:
    assert doubts(fit, figures(1e-3), figures(1e-3), held_out=True) == (
        "On data that the fit never saw the position error is no smaller than before calibration.",
    )


def test_no_better_on_its_own_data(fit: calib.Fit) -> None:
    (said,) = doubts(fit, figures(1e-3, "orientation"), figures(2e-3, "orientation"), held_out=False)
    assert said == "On the data it was fitted to the orientation error is no smaller than before calibration."


def test_frames_alone_need_not_be_better(fit: calib.Fit) -> None:
    frames = replace(fit, parameters=tuple(p for p in fit.parameters if not p.of_robot))
    assert doubts(frames, figures(1e-3), figures(1e-3), held_out=True) == ()


def test_not_converged(fit: calib.Fit) -> None:
    (said,) = doubts(replace(fit, converged=False, step=0.25), figures(2e-3), figures(1e-3), held_out=True)
    assert said == "The solver did not converge: its last step was 0.25 parameter scales."


def test_narrowed_priors_are_remarked(fit: calib.Fit) -> None:
    assert remarks(fit) == ()
    (finding,) = remarks(replace(fit, narrowed=10.0))
    assert finding.code == "priors-narrowed"
    assert "made 10 times narrower" in finding.sentence
    # What did not converge has a doubt, which is more.
    assert remarks(replace(fit, narrowed=100.0, converged=False)) == ()
    # Values that were found in another way were searched without any.
    assert with_values(replace(fit, narrowed=10.0), fit.values, fit.machine).narrowed == 1.0
