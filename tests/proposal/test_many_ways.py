"""Tables that may be read in very many ways: what is looked at is limited, and said in one sentence."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.job.foreign import fits, seen
from calib.measuring import propose
from tests.support.people import UR10

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
WORDS = [f"spot{a}{b}" for a in "abcdefghijk" for b in "abcdefghijk"]


def written(path: Path, titles: list[str]) -> Path:
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (12, len(titles)))
    lines = (",".join(f"{value:.3f}" for value in row) for row in rows)
    path.write_text("\n".join([",".join(titles), *lines]) + "\n", encoding="utf-8")
    return path


def fork(path: Path, length: int, fingers: int) -> tuple[Path, list[str]]:
    """An arm of so many joints that ends in fingers, and the names of all."""
    names = [*(f"f{k}" for k in range(length)), *(f"finger_x{k}" for k in range(fingers))]
    parents = ["base", *names[: length - 1], *[names[length - 1]] * fingers]
    joint = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}"/><axis xyz="0 {2} 1"/></joint>'
    links = "".join(f'<link name="{name}"/>' for name in ("base", *names))
    joints = "".join(joint.format(*pair, k % 2) for k, pair in enumerate(zip(names, parents, strict=True)))
    path.write_text(f'<robot name="r">{links}{joints}</robot>', encoding="utf-8")
    return path, names


def test_more_ways_than_can_be_tried_are_told_before_any_is_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [f"{axis}_{word}" for word in WORDS for axis in "xyz"]
    table = written(tmp_path / "a.csv", [*(f"{name}_joint" for name in JOINTS), *points])
    monkeypatch.setattr(fits, "followed", lambda *_: pytest.fail("a way was tried"))
    (question,) = propose(UR10, [table]).questions
    assert "may be read in 484 ways (arms: 1; points: 121); 400 are tried at most" in question.sentence
    assert "--column 'x=TITLE'" in question.sentence


def test_of_very_many_points_a_sentence_has_the_first(tmp_path: Path) -> None:
    points = [f"{axis}_{word} [m]" for word in WORDS[:30] for axis in "xyz"]
    table = written(tmp_path / "a.csv", [*(f"{name}_joint [rad]" for name in JOINTS), *points])
    (question,) = propose(UR10, [table]).questions
    assert question.about == "position"
    assert len(question.choices) == 30
    assert " or 18 more?" in question.sentence
    assert "or one of 18 more." in question.sentence
    assert len(question.sentence) < 1500


def test_of_very_many_long_arms_a_few_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdf, names = fork(tmp_path / "fork.urdf", 120, 30)
    table = written(tmp_path / "a.csv", [*(f"{name} [rad]" for name in names), "px [m]", "py [m]", "pz [m]"])
    loaded = []

    def load(*given: object) -> calib.Robot:
        robot = calib.load_robot(*given)  # type: ignore[arg-type]
        loaded.append(len(robot.readings))
        return robot

    monkeypatch.setattr(seen, "load_robot", load)
    assert propose(urdf, [table]).questions
    assert loaded.count(121) == 8, "a thousand joints in all"
    assert sum(loaded) <= 3000, "a thousand of those that are taken by their numbers, and of those before fingers"
