"""Which cause is named, by mean squares of photographs held out, and what is to be done next."""

from types import SimpleNamespace

import pytest

from calib.assessment.blame import Blame, Cause, _named
from calib.assessment.checks.of_fit import stated_sigma
from calib.identification.noise import Noise


@pytest.mark.parametrize(
    ("whole", "left", "corners", "alone", "beside", "named"),
    [
        # One that alone explains nearly all; one without which most is left; corners; none of several.
        (4.0, 0.1, 0.01, (("scale", 3.9), ("shape", 0.1)), (("scale", 0.1), ("shape", 3.8)), "shape"),
        (4.0, 0.1, 0.01, (("scale", 3.9), ("shape", 1.5)), (("scale", 0.9), ("shape", 3.8)), "shape"),
        (4.0, 3.0, 3.0, (("scale", 3.9), ("shape", 3.9)), (("scale", 3.0), ("shape", 3.0)), "corners"),
        (4.0, 0.1, 0.01, (("scale", 3.9), ("shape", 3.9)), (("scale", 3.9), ("shape", 3.9)), None),
        # Photographs of a real arm whose poses are off by millimetres: all together leave nine tenths.
        (4.016, 3.561, 0.008, (("scale", 4.0), ("shape", 3.74)), (("scale", 3.74), ("shape", 8.19)), None),
    ],
)
def test_a_cause_is_named_where_it_explains_most(whole, left, corners, alone, beside, named) -> None:
    assert _named(whole, left, corners, alone, beside) == named


@pytest.mark.parametrize(("corners", "says"), [(0.09, "take more photographs"), (1.5, "photograph sharper")])
def test_sharper_photographs_are_asked_for_where_corners_are_most_of_what_is_left(corners: float, says: str) -> None:
    causes = (Cause("scale", 0.0, 0.4, 7e-4), Cause("shape", 0.5, 2.2, 5e-4))
    found = Blame(causes, 2.0, 1.9, corners, 15e-4, None, lens_held=False)
    assert found.advice.startswith(f"To be surer where the tool is, {says}")


@pytest.mark.parametrize(
    ("free", "says"), [(False, "the arm is taken as it is stated"), (True, "the sigma is far too small")]
)
def test_an_arm_that_is_held_is_named_where_corners_are_far_better(free: bool, says: str) -> None:
    noise = Noise(0, "pixels", instrument=0.02, model=1.6, degrees_of_freedom=3000.0, chi_square=6000.0)
    parameters = [SimpleNamespace(of_robot=False), SimpleNamespace(of_robot=free)]
    fit = SimpleNamespace(noise=[noise], parameters=parameters, measurements=[])
    check = stated_sigma(fit)  # type: ignore[arg-type]
    assert not check.passed
    assert check.sentence.startswith("The pixels residuals scatter 80 times as much as the stated sigma: " + says)
