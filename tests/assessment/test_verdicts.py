"""The verdict says no where it must, and yes where it may; the page of docs/ has many more sessions."""

import pytest

from scripts.studies.verdict_sessions import BAD, LATER, bad, judge, sound


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
    assert len(LATER) == 10
