"""Planned photographs: they show the board, and bring more than random ones, by forecast and by the true tool."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.views import Views, plan_views, view_candidates
from calib.foundations.errors import JobError
from calib.identification.identify import identify
from calib.identification.machine import values_at
from calib.identification.parameters import Priors, scales
from calib.identification.system import Problem, with_twists
from calib.identification.together import Together
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from calib.measurement.optics import seen_by
from scripts.simulate import photographs as simulation

SIGMA, FIRST, MORE = 0.3, 8, 8
ROBOT = calib.load_robot(simulation.UR5, simulation.TIP)


def photographed(some: simulation.Session, readings: np.ndarray, rng: np.random.Generator) -> calib.Measurements:
    camera = calib.measuring.Camera("tip", free=NAMES[:9], size=some.lens.size, sigma=SIGMA)
    columns = simulation.corners_seen(replace(some, readings=readings), SIGMA, rng)
    data = calib.read_measurements(columns, ROBOT, "pixels", instrument=camera)
    marks = np.column_stack([some.sheet.corners(), np.zeros(len(some.sheet.corners()))])
    return seen_by(data, camera, Board(marks=marks))


@pytest.fixture(scope="module")
def true() -> simulation.Session:
    some = simulation.session(5, FIRST)
    flat = replace(some.sheet, aspect=0.0, shear=0.0, bend=(0.0, 0.0, 0.0))
    return replace(some, arm=simulation.Arm(np.random.default_rng(2), 1e-3, 1e-3, 0.0), sheet=flat)


@pytest.fixture(scope="module")
def fit(true: simulation.Session) -> calib.Fit:
    model = calib.error_model(
        ROBOT, offsets="all", placements="all", base="fixed", tool="pose", priors=Priors(1e-3, 1e-3)
    )
    return identify(model, photographed(true, true.readings, np.random.default_rng(1)))


@pytest.fixture(scope="module")
def views(fit: calib.Fit) -> Views:
    return Views(fit)


@pytest.fixture(scope="module")
def candidates(views: Views) -> np.ndarray:
    return view_candidates(views, 250).readings


def test_candidates_show_the_board_and_spread(true: simulation.Session, views: Views, candidates: np.ndarray) -> None:
    drawn, inside = true.sheet.corners(), []
    for q in candidates:
        T = np.linalg.inv(true.arm.tip(q) @ true.camera) @ true.board
        pixels = true.lens.see(true.sheet.place(drawn) @ T[:3, :3].T + T[:3, 3])
        inside.append(bool(np.all((pixels > 0.0) & (pixels < np.array(true.lens.size)))))
        assert T[:3, 2] @ T[:3, 3] / np.linalg.norm(T[:3, 3]) > np.cos(views.most_tilt) - 0.02
    # Eight photographs know the corners of the image little: some boards are not where they are expected.
    assert np.mean(inside) > 0.95
    assert np.all(candidates.std(axis=0) > 0.8 * true.readings.std(axis=0))
    np.testing.assert_array_equal(candidates, view_candidates(views, 250).readings)


def test_rows_are_the_derivatives_of_pixels(true: simulation.Session, views: Views, candidates: np.ndarray) -> None:
    """All rows of the photographs of a fit, mark by mark, say as much as the few marks that stand for them, nearly."""
    J, few = views.measured_rows().of_parameters[:, :], views.rows(true.readings).of_parameters
    whole, some = J.reshape(-1, J.shape[-1]), few.reshape(-1, few.shape[-1])
    assert some.shape == (FIRST * 12, whole.shape[1])
    diagonal = (
        np.sum(some**2, axis=0)[np.sum(whole**2, axis=0) > 0.0]
        / np.sum(whole**2, axis=0)[np.sum(whole**2, axis=0) > 0.0]
    )
    assert 0.5 < np.median(diagonal) < 2.0


def test_marks_of_a_photograph_that_err_together_bring_less(fit: calib.Fit, candidates: np.ndarray) -> None:
    """As much as the full covariance of a photograph's rows says."""
    own = Together.of(2e-4, 5e-4, 0.1**2, np.zeros(1, dtype=np.intp), np.zeros((1, 2, 6)), np.ones((1, 2)))
    with_it = replace(fit, together=(own,))
    (found,) = Views(with_it).rows(candidates[:1]).of_parameters
    (alone,) = Views(fit).rows(candidates[:1]).of_parameters
    data, count = Views(fit)._at(candidates[:1])
    frames = fit.machine.frames
    problem = Problem(fit.model, fit.parameters, frames, (data,), held=fit.deviations)
    at = problem.machine(values_at(ROBOT, fit.parameters, frames, fit.deviations))
    rows = with_twists(problem, at, data, scales(fit.parameters))
    U = rows.by_twist.reshape(-1, 6) * np.repeat([2e-4, 5e-4], 3)
    marks = len(np.unique(fit.measurements[0].value[:, 2:], axis=0))
    C = (SIGMA**2 + 0.1**2) * count / marks * np.eye(2 * count) + U @ U.T
    flat = rows.J.reshape(2 * count, -1)
    np.testing.assert_allclose(found.T @ found, flat.T @ np.linalg.solve(C, flat), rtol=1e-6, atol=1e-9)
    assert np.linalg.norm(found) < np.linalg.norm(alone)


def test_planned_photographs_beat_random_ones_in_forecast_and_in_truth(
    true: simulation.Session, fit: calib.Fit, views: Views, candidates: np.ndarray
) -> None:
    planned = plan_views(views, MORE, candidates=candidates)
    forecast = next(one for one in planned.forecasts if one.poses == MORE)
    # What no photograph shows, the size of all, is told apart.
    assert planned.floor > forecast.chosen
    assert forecast.chosen < 0.7 * forecast.random
    rng, marked = np.random.default_rng(3), []
    elsewhere = candidates[::3]
    for chosen in (planned.readings, *(candidates[rng.permutation(len(candidates))[:MORE]] for _ in range(3))):
        off = []
        for seed in range(1):
            own = np.concatenate([true.readings, chosen])
            again = identify(fit.model, photographed(true, own, np.random.default_rng(seed + 50)))
            at = calib.machine_of(again).predict(elsewhere)
            is_ = np.stack([true.arm.tip(q) @ true.camera for q in elsewhere])
            # Where the whole arm stands nothing shows but its priors: that part is common to all.
            d = at[:, :3, 3] - is_[:, :3, 3]
            off.append(float(np.sqrt(np.mean(np.sum((d - d.mean(axis=0)) ** 2, axis=1)))))
        marked.append(np.mean(off))
    assert marked[0] < np.median(marked[1:])


def test_what_cannot_be_planned_is_one_sentence(views: Views, fit: calib.Fit, tmp_path: Path) -> None:
    with pytest.raises(JobError, match="allowed are 1 to"):
        view_candidates(views, 0)
    with pytest.raises(JobError, match=r"only 0 of .* views show the board, and 500 are asked for: .* board"):
        view_candidates(replace(views, most_tilt=1e-9), 500)
    true = fit.measurements[0]
    lens = fit.machine.frames.scalars[:4]
    camera = replace(true.camera, size=None, **dict(zip(NAMES[:4], map(float, lens), strict=True)))
    unsized = replace(fit, measurements=(seen_by(true, camera, true.board),))
    with pytest.raises(JobError, match="by a camera with the size of its images"):
        Views(unsized)
