"""The verdict says no where it must, and yes where it may; the page of docs/ has many more sessions."""

import pytest

from scripts.studies.verdict_moving import NEXT, moving
from scripts.studies.verdict_sessions import BAD, LAST, LATER, bad, judge, poor, sound


@pytest.mark.parametrize("seed", range(8))
def test_sound_sessions_are_trusted(seed: int) -> None:
    session = sound(seed)
    found = judge(session)
    assert (found.word, found.failed) == ("trusted", ()), session.label


@pytest.mark.parametrize(
    "what",
    [
        "random numbers as positions",
        "rows shifted by one",
        "gear ratio 5 % off",
        "lengths 5 % too long",
        "base moved 1 mm midway",
        "ten samples late on a path",
        "validation is it, shuffled and rounded",
        "joints in reverse order",
    ],
)
def test_bad_sessions_are_not(what: str) -> None:
    assert judge(bad(what, "ur5", 0)).word != "trusted"


def test_there_are_enough_of_them() -> None:
    assert len(BAD) >= 30
    assert len(LATER) == len(LAST) == len(NEXT) == 10


@pytest.mark.parametrize(
    ("what", "which", "check"),
    [
        ("three payloads, not said", "z1", "one machine"),
        ("readings rounded to whole degrees", "z1", "resolution"),
        ("one axis of the instrument 1 % too long", "z1", "axes"),
        ("stream: readings are means of the last half second", "baxter", "timing"),
    ],
)
def test_what_only_one_check_finds(what: str, which: str, check: str) -> None:
    assert check in judge(bad(what, which, 0, NEXT)).failed


def test_an_arm_that_leans_is_what_is_stated_of_it() -> None:
    """It looks like a worse arm, and regions are as much larger."""
    found = judge(bad("a base that leans by 2 mrad after the arm", "z1", 1))
    assert found.word == "trusted"
    assert found.inside > 0.9


@pytest.mark.parametrize("seed", [0, 1, 9])
def test_sound_sessions_in_motion_and_through_a_lens(seed: int) -> None:
    found = judge(moving(seed))
    assert (found.word, found.failed) == ("trusted", ())


@pytest.mark.parametrize("seed", range(2))
def test_poor_arms_are_trusted(seed: int) -> None:
    assert judge(poor(seed)).word == "trusted"


@pytest.mark.parametrize("seed", range(2))
def test_rows_with_a_payload_are_told_from_those_without(seed: int) -> None:
    assert "one machine" in judge(bad("half of the rows with a payload that bends", "xarm7", seed)).failed
