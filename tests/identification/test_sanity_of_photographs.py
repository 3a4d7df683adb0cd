"""Mistakes made with photographs of a board are named; sound photographs of badly made arms are left alone."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import calib
from calib.identification.sanity import signatures
from calib.measurement.checks import Finding
from tests.support import machines
from tests.support.cameras import BOARD, TIP, UR5, Array, eye, scene

PHOTOGRAPHS, MARKS = 16, len(BOARD)
PLACES = ("tip", "floor")
Change = Callable[[Array], Array]


@cache
def photographs(camera_on: str) -> tuple[calib.Robot, calib.Measurements]:
    """Photographs that an arm with ordinary errors took of a board."""
    rng, robot = np.random.default_rng(3), machines.load(UR5, TIP)
    arm = machines.arm(UR5, TIP).moved(rng, length=1e-3, angle=2e-3, zero=np.radians(1.0))
    true = scene(rng, arm, camera_on)
    return robot, true.measure(robot, true.draw(rng, PHOTOGRAPHS), rng, 0.1)


def found(
    camera_on: str,
    readings: Change = lambda J: J,
    pixels: Change = lambda uv: uv,
    places: Change = lambda p: p,
    said: str = "",
) -> tuple[Finding, ...]:
    """What is said of photographs (N, m, ...) of which something was changed."""
    robot, data = photographs(camera_on)
    value = data.value.reshape(PHOTOGRAPHS, MARKS, -1).copy()
    value[..., :2], value[..., 2:] = pixels(value[..., :2]), places(value[..., 2:])
    changed = replace(
        data,
        readings=np.repeat(readings(data.readings[::MARKS]), MARKS, axis=0),
        value=value.reshape(len(data), -1),
        camera=eye(said or camera_on, 0.1),
    )
    model = calib.error_model(robot, offsets="all", placements="all", base="fixed", tool="pose")
    return signatures(model, [changed])


def _of_rows(rows: dict[int, int]) -> Change:
    return lambda values: values[[rows.get(k, k) for k in range(len(values))]]


def _turned(number: int) -> Change:
    """Turn one photograph of 1280 x 1024 pixels upside down."""

    def turned(uv: Array) -> Array:
        uv = uv.copy()
        uv[number] = [1279.0, 1023.0] - uv[number]
        return uv

    return turned


@pytest.mark.parametrize("camera_on", PLACES)
def test_sound_photographs_are_left_alone(camera_on: str) -> None:
    assert found(camera_on) == ()


@pytest.mark.parametrize("camera_on", PLACES)
def test_sound_photographs_of_two_boards_in_one_table_are_left_alone(camera_on: str) -> None:
    """Every other photograph is of a second target, wherever that is."""
    robot, data = photographs(camera_on)
    of_other = np.arange(len(data)) // MARKS % 2
    both = replace(data, targets=(*data.targets, "other"), target=of_other)
    model = calib.error_model(robot, offsets="all", placements="all", base="fixed", tool="pose")
    assert signatures(model, [both]) == ()
    wrong = replace(both, readings=data.readings * [1, 1, -1, 1, 1, 1])
    assert [one.code for one in signatures(model, [wrong])] == ["flipped-sign"]


@pytest.mark.parametrize("camera_on", PLACES)
def test_a_joint_that_is_read_with_the_wrong_sign_is_named(camera_on: str) -> None:
    (finding,) = found(camera_on, readings=lambda J: J * [1, 1, -1, 1, 1, 1])
    assert (finding.severity, finding.code) == ("error", "flipped-sign")
    assert "'elbow_joint'" in finding.sentence


def test_columns_of_joints_that_are_swapped_are_named() -> None:
    (finding,) = found("tip", readings=lambda J: J[:, [0, 1, 3, 2, 4, 5]])
    assert finding.code == "swapped-joints"


@pytest.mark.parametrize(("camera_on", "size"), [("tip", 0.5), ("floor", 0.8), ("tip", 25.4), ("floor", 0.001)])
def test_a_board_of_another_size_is_named(camera_on: str, size: float) -> None:
    (finding,) = found(camera_on, places=lambda p: p / size)
    assert finding.code == "board-size"
    said = re.search(r"the board is (\S+) times as large as stated", finding.sentence)
    assert said is not None
    assert float(said.group(1)) == pytest.approx(size, rel=0.02)
    assert ("or the machine" in finding.sentence) == (0.25 < size < 4.0)


@pytest.mark.parametrize("camera_on", PLACES)
def test_a_camera_that_is_elsewhere_is_named(camera_on: str) -> None:
    other = "floor" if camera_on == "tip" else "tip"
    (finding,) = found(camera_on, said=other)
    assert finding.code == "camera-on"
    assert f'camera_on = "{camera_on}"' in finding.sentence


@pytest.mark.parametrize("camera_on", PLACES)
def test_photographs_with_the_readings_of_each_other_are_named(camera_on: str) -> None:
    (finding,) = found(camera_on, readings=_of_rows({4: 9, 9: 4}))
    assert (finding.severity, finding.code) == ("warning", "stray-photographs")
    assert f"'arrays:{4 * MARKS}'" in finding.sentence
    assert f"'arrays:{9 * MARKS}'" in finding.sentence


def test_a_photograph_that_was_turned_afterwards_is_named() -> None:
    (finding,) = found("tip", pixels=_turned(4))
    assert finding.code == "stray-photographs"
    said = re.search(rf"'arrays:{4 * MARKS}' by \S+ mm and (\S+) deg", finding.sentence)
    assert said is not None
    assert float(said.group(1)) == pytest.approx(180.0, abs=3.0)


def test_photographs_that_all_have_other_readings_are_not_explained() -> None:
    (finding,) = found("tip", readings=lambda J: np.roll(J, 1, axis=0))
    assert (finding.severity, finding.code) == ("warning", "unexplained")
