"""A base that stands anywhere is found from known planes and indicators, and starts near a known place or two."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations import rigid
from calib.identification.initialisation.frames import initial_frames
from calib.identification.sanity import signatures
from calib.identification.targets import Target
from calib.robot.deviation import axis_frame
from tests.support import machines
from tests.support.machines import Array, pose
from tests.support.touching import HEIGHTS, NORMALS, Lab, lab, unit

TURNS = ((0.0, 0.0, 2.6), (0.3, 0.2, -1.9), (2.0, -1.5, 0.4))
# What was touched: normal and height; the last two are parallel to others.
PLANES = {name: (unit(NORMALS[name]), HEIGHTS[name]) for name in NORMALS} | {
    "step": (unit(NORMALS["floor"]), HEIGHTS["floor"] + 0.3),
    "shelf": (unit(NORMALS["left"]), HEIGHTS["left"] - 0.2),
}


def known(base: Array, turned_over: tuple[str, ...] = ()) -> dict[str, Target]:
    """The planes where ``base`` has them, some with normals that point to the other side."""
    found = {}
    for name, (normal, height) in PLANES.items():
        sign = -1.0 if name in turned_over else 1.0
        found[name] = Target(base @ axis_frame(sign * normal) @ pose((0.0, 0.0, sign * height)))
    return found


def above(normal: Array, height: float) -> Callable[[Array], Array]:
    """How high points are above a plane."""
    return lambda x: (x @ normal - height)[:, None]


def touches(here: Lab, **more: object) -> calib.Measurements:
    """Every plane touched from its side."""
    q = [here.touching(above(normal, height), np.zeros((20, 1)), outside=normal) for normal, height in PLANES.values()]
    names = np.repeat(list(PLANES), 20).tolist()
    return here.read(np.concatenate(q), "plane", target=names, ball_m=np.zeros(100), **more)


def dials(here: Lab) -> calib.Measurements:
    """What indicators along three directions show, with zeros at the planes' heights."""
    q, names = here.draw(75), np.repeat(list(NORMALS), 25)
    normals, heights = (np.array([PLANES[name][k] for name in names]) for k in (0, 1))
    shown = np.sum(here.where(q) * normals, axis=1) - heights
    return here.read(q, "indicator", indicated_m=shown, target=names.tolist())


def is_found(here: Lab, data: calib.Measurements, base: Array, targets: dict[str, Target]) -> None:
    """The base starts near, nothing is taken for a mistake, and the fit finds the truth."""
    free = {"offsets": "all", "placements": "all"}
    model = machines.model(here.robot, targets={name: targets[name] for name in data.seen_targets}, **free)
    start = rigid.inverse(base) @ initial_frames(model, [data]).bases
    assert np.max(rigid.lengths_and_angles(start)) < 0.3
    assert signatures(model, [data]) == ()
    fit = calib.identify(model, data)
    assert fit.converged
    assert here.miss(fit) < 1e-6


@pytest.mark.parametrize("turn", TURNS)
def test_known_planes_and_indicators_show_the_base(turn: tuple[float, ...]) -> None:
    here, base = lab(3), rigid.placement(Rotation.from_rotvec(turn).as_matrix(), np.array([1.2, -0.7, 0.4]))
    is_found(here, touches(here), base, known(base))
    is_found(here, dials(here), base, known(base))


@pytest.mark.parametrize("turn", TURNS)
def test_known_planes_show_the_base_of_a_second_set_up(turn: tuple[float, ...]) -> None:
    """It was refused: nothing was said to show where that base is."""
    here, base = lab(3), rigid.placement(Rotation.from_rotvec(turn).as_matrix(), np.array([1.2, -0.7, 0.4]))
    sets = [here.positions(40), touches(here, setup=["second"] * 100)]
    model = machines.model(here.robot, offsets="all", placements="all", targets=known(base))
    fit = calib.identify(model, sets)
    assert fit.converged
    second = fit.measurements[0].setups.index("second")
    # A base and the first placement share what they are off.
    assert np.max(rigid.lengths_and_angles(rigid.inverse(base) @ fit.machine.frames.bases[second])) < 0.02
    assert max(np.abs(r).max() for r in fit.residuals) < 1e-8


def test_one_plane_does_not_show_the_base_of_a_second_set_up() -> None:
    here = lab(3)
    q = here.touching(above(*PLANES["floor"]), np.zeros((20, 1)), outside=PLANES["floor"][0])
    touched = here.read(q, "plane", target=["floor"] * 20, ball_m=np.zeros(20), setup=["second"] * 20)
    model = machines.model(here.robot, offsets="all", targets={"floor": known(np.eye(4))["floor"]})
    with pytest.raises(calib.MeasurementError, match="planes of known heights in three directions"):
        calib.identify(model, [here.positions(40), touched])


def test_normals_that_were_stated_to_the_other_side_do_not_mislead() -> None:
    """The steps between parallel planes tell."""
    here, base = lab(3), rigid.placement(Rotation.from_rotvec(TURNS[1]).as_matrix(), np.array([1.2, -0.7, 0.4]))
    is_found(here, touches(here), base, known(base, ("left", "shelf", "front")))


@pytest.mark.parametrize("turn", TURNS)
def test_two_known_anchors_are_where_they_are_known_to_be(turn: tuple[float, ...]) -> None:
    """All but the turn about the line through them shows, and what does not is no mistake of the readings."""
    here, base = lab(3), rigid.placement(Rotation.from_rotvec(turn).as_matrix(), np.array([1.2, -0.7, 0.4]))
    places = {"one": (1.2, 0.3, -0.2), "two": (-0.4, 0.9, 0.5)}
    q, names = here.draw(60), np.repeat(list(places), 30)
    length = np.linalg.norm(here.where(q) - [places[name] for name in names], axis=1)
    data = here.read(q, "distance", length_m=length, target=names.tolist())
    targets = {name: Target(base @ pose(place)) for name, place in places.items()}
    model = machines.model(here.robot, offsets="all", placements="all", targets=targets)
    start = initial_frames(model, [data]).bases[0]
    for name, place in places.items():
        np.testing.assert_allclose((start @ pose(place))[:3, 3], targets[name].pose[:3, 3], atol=0.1)
    assert signatures(model, [data]) == ()
    fit = calib.identify(model, data)
    assert fit.converged
    assert np.abs(fit.residuals[0]).max() < 1e-8


def test_a_base_that_was_given_well_is_not_moved_by_what_two_anchors_hardly_tell() -> None:
    """The tool is unknown, so that lengths show an anchor within some cm alone."""
    here = lab(3)
    places = {"one": (1.2, 0.3, -0.2), "two": (-0.4, 0.9, 0.5)}
    q, names = here.draw(60), np.repeat(list(places), 30)
    length = np.linalg.norm(here.where(q) - [places[name] for name in names], axis=1)
    data = here.read(q, "distance", length_m=length, target=names.tolist())
    targets = {name: Target(pose(place)) for name, place in places.items()}
    model = machines.model(here.robot, offsets="all", placements="all", targets=targets)
    np.testing.assert_array_equal(initial_frames(model, [data]).bases[0], np.eye(4))


def test_what_one_plane_does_not_tell_of_the_base_stays_as_it_is() -> None:
    here = lab(3)
    tilt = rigid.placement(Rotation.from_rotvec((0.2, -0.1, 0.0)).as_matrix(), np.array([0.0, 0.0, 0.4]))
    data = here.planes(40)
    model = machines.model(here.robot, offsets="all", placements="all", targets=known(tilt))
    start = initial_frames(model, [data]).bases[0]
    assert float(start[:3, 2] @ tilt[:3, 2]) > 0.99
    normal = tilt[:3, :3] @ PLANES["floor"][0]
    np.testing.assert_allclose(np.cross(start[:3, 3], normal), 0.0, atol=1e-5)
