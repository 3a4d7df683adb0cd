"""Lengths that are stated and that no row checks, on machines of known truth."""

from collections.abc import Sequence

import numpy as np
import pytest

import calib
from calib.identification.targets import Target
from calib.robot.deviation import axis_frame
from tests.support import machines
from tests.support.machines import pose
from tests.support.touching import HEIGHTS, NORMALS, PROBE, Lab, lab, unit

# Normals and heights of known faces; the last two look the other way.
FACES = {name: (unit(NORMALS[name]), HEIGHTS[name]) for name in NORMALS} | {
    "ceiling": (-unit(NORMALS["floor"]), -HEIGHTS["floor"] - 0.4),
    "right": (-unit(NORMALS["left"]), HEIGHTS["left"]),
}
BLOCK = ("floor", "left", "front")


def touched(here: Lab, faces: Sequence[str], too_large: float) -> calib.Measurements:
    """Faces touched by the ball of the probe, whose radius is stated too large."""
    q = [
        here.touching(
            lambda x, n=normal, h=height: (x @ n - h)[:, None],
            PROBE + here.scatter(25, 1),
            outside=normal,
        )
        for normal, height in (FACES[name] for name in faces)
    ]
    names = np.repeat(list(faces), 25)
    return here.read(
        np.concatenate(q), "plane", target=names.tolist(), ball_m=np.full(len(names), 2.0 * (PROBE + too_large))
    )


def places(here: Lab, faces: Sequence[str]) -> dict[str, Target]:
    """Where the faces are."""
    return {
        name: Target(here.machine.base @ axis_frame(FACES[name][0]) @ pose((0.0, 0.0, FACES[name][1])))
        for name in faces
    }


def said(found: calib.Calibration) -> list[str]:
    """What is said of stated lengths."""
    return [sentence for sentence in found.shown if "is taken as stated" in sentence]


def calibrated(
    here: Lab, faces: Sequence[str], *more: calib.Measurements, too_large: float = 0.0, known: bool = True
) -> calib.Calibration:
    """A calibration of touched faces, and of more."""
    targets = places(here, faces) if known else {}
    model = machines.model(here.robot, offsets="all", placements="all", targets=targets)
    return calib.assess(calib.identify(model, [touched(here, faces, too_large), *more]))


@pytest.mark.parametrize("too_large", [0.0, 1e-3])
def test_a_ball_that_touched_known_faces_from_one_side_each_is_said_to_be_taken_as_stated(too_large: float) -> None:
    """Regions were a tenth as large as the errors, and nothing was said of it."""
    here = lab(5, noise=3e-5)
    found = calibrated(here, BLOCK, too_large=too_large)
    (sentence,) = said(found)
    assert sentence.startswith(
        "The radius of the ball where 'floor', 'left', 'front' were touched is taken as stated, and no row checks it: "
        "if it is 0.1 mm off, the tool is 0."
    )
    # The faces are not quite at right angles.
    normals = np.array([FACES[name][0] for name in BLOCK])
    moved = np.linalg.norm(np.linalg.solve(normals, np.full(3, 0.1)))
    assert f"the tool is {moved:.2g} mm elsewhere" in sentence


def test_a_ball_of_which_the_size_of_the_arm_takes_up_the_rest_is_said_as_well() -> None:
    """One known step tells the size of the arm or that of the ball, and not both."""
    (sentence,) = said(calibrated(lab(5, noise=3e-5), (*BLOCK, "ceiling")))
    assert "where 'floor', 'left', 'front', 'ceiling' were touched is taken as stated" in sentence


def test_it_is_not_said_where_rows_check_it_or_where_the_arm_does_not_follow() -> None:
    here = lab(5, noise=3e-5)
    assert said(calibrated(here, tuple(FACES))) == []
    assert said(calibrated(here, BLOCK, here.positions(20))) == []
    # The planes take it up.
    assert said(calibrated(here, BLOCK, here.positions(20), known=False)) == []


@pytest.mark.parametrize(
    ("too_long", "offset", "doubted"), [(0.3e-3, None, True), (0.3e-3, "bar", False), (0.0, None, False)]
)
def test_an_offset_of_lengths_that_rows_contradict_is_a_doubt(
    too_long: float, offset: str | None, doubted: bool
) -> None:
    """The fit bent to it: residuals were small, the verdict trusted, and regions half as large as the errors."""
    here = lab(5, noise=3e-5)
    model = machines.model(here.robot, offsets="all", placements="all", targets=here.known("anchor"))
    found = calib.assess(calib.identify(model, here.distances(80, too_long, offset)))
    said = [doubt for doubt in found.doubts if "is not what rows say" in doubt]
    assert bool(said) == doubted, found.doubts
    assert found.trusted == (not doubted), found.doubts
    if doubted:
        assert said[0].startswith("The offset that all lengths of ")
        assert "it seems 0.35 mm off" in said[0]


@pytest.mark.parametrize(("too_large", "doubted"), [(1e-3, True), (0.0, False)])
def test_a_radius_that_rows_contradict_is_a_doubt(too_large: float, doubted: bool) -> None:
    found = calibrated(lab(5, noise=3e-5), tuple(FACES), too_large=too_large)
    assert found.trusted == (not doubted), found.doubts
    assert said(found) == []
    assert any(doubt.startswith("The radius of the ball where ") for doubt in found.doubts) == doubted


def test_an_anchor_that_is_elsewhere_than_is_stated_is_a_doubt() -> None:
    """Of one that is 0.3 mm off, what is left was less than three times the scatter."""
    here = lab(5, noise=3e-5)
    q = here.draw(90)
    anchors = np.array([(1.2, 0.3, -0.2), (-0.9, 1.1, 0.4), (0.2, -1.4, 0.9)])
    which = np.arange(90) % 3
    length = np.linalg.norm(here.where(q) - anchors[which], axis=1) + here.scatter(90)
    data = here.read(q, "distance", length_m=length, target=[f"anchor {k}" for k in which])
    anchors[1, 2] += 0.3e-3
    targets = {f"anchor {k}": Target(here.machine.base @ pose(tuple(place))) for k, place in enumerate(anchors)}
    model = machines.model(here.robot, offsets="all", placements="all", targets=targets)
    found = calib.assess(calib.identify(model, data))
    assert not found.trusted
    (doubt,) = found.doubts
    assert "the place of 'anchor 1' is not what rows say" in doubt
