"""Planes that an arm seems to have touched from behind, by its parts, are turned over as stated angles say."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.foundations.arrays import Array
from calib.identification.initialisation.target_poses import _turn_as_related
from calib.identification.relations import Relation

NAMES = ("a", "b", "c", "d")


def planes(seed: int) -> tuple[Array, list[Relation]]:
    """Poses of four planes whose normals are far from at right angles, and the angles of each to the next."""
    rng = np.random.default_rng(seed)
    while True:
        poses = np.tile(np.eye(4), (4, 1, 1))
        poses[:, :3, :3] = Rotation.random(4, random_state=rng).as_matrix()
        between = [float(poses[k, :3, 2] @ poses[k + 1, :3, 2]) for k in range(3)]
        if min(map(abs, between)) > 0.3:
            pairs = zip(NAMES[:3], NAMES[1:], between, strict=True)
            return poses, [Relation("angle", (p, q), float(np.arccos(cos)), 1e-4) for p, q, cos in pairs]


def over(poses: Array, *which: int) -> Array:
    found = poses.copy()
    for k in which:
        found[k, :3, 1:3] *= -1.0
    return found


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("which", range(4))
def test_the_one_of_four_that_is_turned_over_is_turned_back(seed: int, which: int) -> None:
    true, relations = planes(seed)
    found = over(true, which)
    _turn_as_related(found, NAMES, NAMES, relations)
    np.testing.assert_array_equal(found, true)
    assert np.linalg.det(found[:, :3, :3]) == pytest.approx(1.0)
    _turn_as_related(found, NAMES, NAMES, relations[::-1])
    np.testing.assert_array_equal(found, true)


def test_planes_whose_places_are_known_are_not_turned() -> None:
    true, relations = planes(0)
    found = over(true, 1, 2, 3)
    _turn_as_related(found, NAMES[1:], NAMES, relations)
    np.testing.assert_array_equal(found, true)


def test_what_angles_do_not_tell_stays() -> None:
    """Right angles are their own supplements, offsets tell no angle, and no sides agree with angles that contradict."""
    true, relations = planes(4)
    right = [Relation("angle", relation.targets, np.pi / 2, 1e-4) for relation in relations]
    offsets = [Relation("offset", relation.targets, 0.1, 1e-4) for relation in relations]
    cosines = np.cos([relation.value for relation in relations])
    last = float(true[3, :3, 2] @ true[0, :3, 2])
    assert abs(last) > 0.25 and abs(cosines).min() > 0.3
    wrong = [*relations, Relation("angle", ("d", "a"), float(np.arccos(-last)), 1e-4)]
    for told in (right, offsets, wrong):
        found = over(true, 2)
        _turn_as_related(found, NAMES, NAMES, told)
        np.testing.assert_array_equal(found, over(true, 2))
