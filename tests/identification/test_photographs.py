"""Photographs alone: lens and board of a known truth, and how many numbers the photographs ask for."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.identification import photographs as bundle
from calib.identification.initialisation.resection import camera_pose, camera_poses
from calib.identification.photographs import Photograph
from calib.measurement.boards import Board, shape_modes
from calib.measurement.lens import BENT, CENTRE, FOCAL, Lens
from tests.support.cameras import BENT as TRUE
from tests.support.cameras import eye, see

MARKS = np.array([(0.03 * i, 0.03 * j, 0.0) for j in range(4) for i in range(6)])
SIZE = (1280, 1024)
FIVE = (*FOCAL, *CENTRE, *BENT)
GUESS = Lens(1280.0, 1280.0, 639.5, 511.5)


def photographs(
    shape: str = "flat", sigma: float = 0.1, n: int = 24, values: np.ndarray | None = None
) -> list[Photograph]:
    """Photographs of a board with modes of a shape, made by another projection."""
    rng = np.random.default_rng(5)
    modes = shape_modes(MARKS, shape)
    at = MARKS if values is None else MARKS + shape_modes(MARKS, "quadratic") @ values
    found = []
    while len(found) < n:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(rng.normal(scale=0.45, size=3)).as_matrix()
        T[:3, 3] = (*rng.uniform(-0.12, 0.12, 2), rng.uniform(0.2, 0.5))
        T[:3, 3] -= T[:3, :3] @ MARKS.mean(axis=0)
        Y = at @ T[:3, :3].T + T[:3, 3]
        pixels = see(eye("tip"), Y)
        if (pixels > 0).all() and (pixels < SIZE).all():
            pixels = pixels + rng.normal(scale=sigma, size=pixels.shape)
            found.append(Photograph(pixels, MARKS, modes, np.ones((24, 2))))
    return found


def test_without_noise_the_lens_is_the_true_one() -> None:
    found = bundle.found_optics(photographs(sigma=0.0), FIVE, GUESS)
    assert found is not None and found.rms < 1e-6
    for name, value in TRUE.items():
        assert getattr(found.optics.lens, name) == pytest.approx(value, rel=1e-6, abs=1e-7), name


def test_homographies_alone_give_the_focal_length() -> None:
    assert bundle.first_lens(photographs(), GUESS).fx == pytest.approx(1200.0, rel=0.1)


def test_photographs_of_few_and_of_many_marks_are_fitted_in_any_order() -> None:
    some, rng = photographs(), np.random.default_rng(0)
    cut = [Photograph(*(part[: 10 + k % 3] for part in one)) for k, one in enumerate(some)]
    order = rng.permutation(len(cut)).tolist()
    optics = bundle.Optics(GUESS, np.zeros(0))
    both = (cut, [cut[k] for k in order])
    found = [bundle.fit(those, FIVE, optics, bundle.poses_of(those, optics)[0]) for those in both]
    np.testing.assert_allclose(found[0].optics.lens, found[1].optics.lens, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found[0].poses[order], found[1].poses, atol=1e-8)
    for k, residuals in zip(order, found[1].residuals, strict=True):
        np.testing.assert_allclose(found[0].residuals[k], residuals, atol=1e-5)


def test_a_search_that_goes_nowhere_says_so() -> None:
    found = bundle.found_optics(photographs(), FIVE, GUESS)
    assert found is not None and found.converged
    rng = np.random.default_rng(2)
    mixed = [one._replace(pixels=one.pixels[rng.permutation(24)]) for one in photographs()]
    lost = bundle.found_optics(mixed, FIVE, GUESS)
    assert lost is not None and not lost.converged


def test_a_grossly_wrong_mark_hardly_moves_the_lens() -> None:
    some = photographs()
    some[3].pixels[5] += 80.0
    found = bundle.found_optics(some, FIVE, GUESS)
    assert found is not None and found.optics.lens.fx == pytest.approx(TRUE["fx"], rel=4e-3)


@pytest.mark.parametrize("count", [24, 6, 4])
def test_photographs_held_out_ask_for_the_shape_that_a_board_has_and_for_no_more(count: int) -> None:
    bent = np.array([4e-4, -2e-4, 3e-4, 1e-4, -1e-4])
    for values, wins in ((None, False), (bent, True)):
        squares = []
        for shape in ("flat", "quadratic", "free"):
            some = photographs(shape, n=count, values=values)
            found = bundle.found_optics(some, FIVE, GUESS)
            assert found is not None
            squares.append(bundle.held_out(some, FIVE, found))
            if shape == "quadratic" and values is not None and count == 24:
                np.testing.assert_allclose(found.optics.shape, values, atol=3e-5)
        assert bundle.clearly_better(squares[0], squares[1]) is wins
        assert not bundle.clearly_better(squares[1], squares[2])


def test_one_photograph_unlike_the_others_does_not_hide_what_all_of_them_ask_for() -> None:
    rng = np.random.default_rng(4)
    rich = rng.uniform(0.002, 0.008, 16)
    simple = rich * rng.uniform(2.0, 8.0, 16)
    assert bundle.clearly_better(simple, rich)
    # As of the only tilted photograph among those from straight above.
    simple[7] = 60.0 * simple.max()
    assert bundle.clearly_better(simple, rich)
    # What all but one gain is lost by that one.
    rich[7] = 2.0 * simple.sum()
    assert not bundle.clearly_better(simple, rich)
    same = rng.uniform(0.002, 0.008, 16)
    assert not bundle.clearly_better(same, same * np.exp(rng.normal(scale=0.5, size=16)))
    assert bundle.clearly_better(np.full(4, 0.01), np.zeros(4))
    assert not bundle.clearly_better(np.array([np.nan, 1.0, np.nan]), np.array([0.1, 0.1, 0.1]))


def test_too_few_marks_tell_nothing() -> None:
    some = photographs()
    poor = some[0]._replace(**{k: getattr(some[0], k)[:3] for k in Photograph._fields})
    assert bundle.found_optics([*some[1:], poor], FIVE, GUESS) is None


@pytest.mark.skipif("CALIB_DATASETS" not in os.environ, reason="CALIB_DATASETS does not say where the datasets are")
def test_real_photographs_of_a_print_that_is_not_flat() -> None:
    pytest.importorskip("cv2")
    from calib.measurement.formats.images import detector, read_image
    from calib.measurement.prints import Print

    squares = {}
    folder = Path(os.environ["CALIB_DATASETS"]) / "board_photos"
    print_ = Print("charuco", (7, 5), 0.03, 0.022, "DICT_4X4_50")
    detect = detector(print_)
    seen = [detect(read_image(file)) for file in sorted(folder.glob("*.jpg"))]
    for shape in ("flat", "quadratic", "free"):
        board = Board(marks=print_.marks, shape=shape)
        some = [
            Photograph(s.pixels, board.marks[s.marks], board.modes[s.marks], np.repeat(s.sigma[:, None], 2, axis=1))
            for s in seen
        ]
        found = bundle.found_optics(some, FIVE, Lens(1280.0, 1280.0, 639.5, 359.5))
        assert found is not None
        squares[shape] = np.sqrt(np.average(bundle.held_out(some, FIVE, found), weights=[len(s.marks) for s in seen]))
    assert squares["flat"] < 0.68
    assert squares["quadratic"] < 0.42
    assert squares["free"] < 0.20


def test_poses_of_many_photographs_are_those_of_each_one() -> None:
    """Of planes and of solids, of many marks and of few, one mark of some by far off; lines tell none, nor do three."""
    rng = np.random.default_rng(2)
    points, b, poses = [], [], []
    for k in range(30):
        n = (3, 5, 6, 20, 40)[k % 5]
        places = rng.uniform(-0.1, 0.1, (n, 3)) * (1.0, k != 8, k % 2)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), (0.02, -0.03, rng.uniform(0.4, 1.0))
        seen = places @ T[:3, :3].T + T[:3, 3]
        if k % 5 == 4:
            seen[7] += (0.2, 0.1, 0.0)
        middle = np.array([k, 0.0, -2.0])
        points.append(places + middle)
        b.append(seen / np.linalg.norm(seen, axis=1)[:, None])
        T[:3, 3] -= T[:3, :3] @ middle
        poses.append(np.linalg.inv(T))
    found, told = camera_poses(points, b)
    expected = [len(one) > 5 if k % 2 else len(one) > 3 and k != 8 for k, one in enumerate(points)]
    np.testing.assert_array_equal(told, expected)
    np.testing.assert_allclose(found[told], np.array(poses)[told], atol=1e-8)
    alone = [camera_pose(*one) for one in zip(points, b, strict=True)]
    assert [one is not None for one in alone] == expected
    np.testing.assert_allclose([one for one in alone if one is not None], found[told], atol=1e-9)
