"""A robot that a measuring arm touches, both free in one job: docs/two_arms.md, held against the simulated truth."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import calib
from scripts.simulate import two_arms
from tests.support.cases import ROOT, run

PAGE = (ROOT / "docs" / "two_arms.md").read_text(encoding="utf-8")
JOBS = dict(re.findall(r"```toml\n# (\w+\.toml)\n(.*?)```", PAGE, re.DOTALL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the page makes, of another machine than the page's."""
    folder = tmp_path_factory.mktemp("two_arms")
    for name, columns in two_arms.Cell(2).tables().items():
        rows = np.column_stack([values for _, values in columns])
        header = ", ".join(title for title, _ in columns)
        np.savetxt(folder / f"{name}.csv", rows, "%.4f", ", ", header=header, comments="")
    for name, text in JOBS.items():
        (folder / name).write_text(text.replace("robots/", f"{ROOT}/robots/"), encoding="utf-8")
    for name in ("arm", "robot"):
        assert run("calibrate", folder / f"{name}.toml", "-o", folder / f"{name}_out", "-q").code == 0
    said = run("cell", folder / "arm_out", folder / "robot_out", "-o", folder / "cell.urdf", "-q")
    assert said.code == 0, said
    assert run("calibrate", folder / "both.toml", "-o", folder / "out", "-q").code == 0
    return folder


def readings(machine: calib.CalibratedMachine, cell: two_arms.Cell, n: int) -> tuple[np.ndarray, ...]:
    """Readings of the machine, the arm's angles in deg and the robot's readings in rad."""
    arm, robot = np.round(cell.rng.uniform(-100.0, 100.0, (n, 6)), 4), cell.robot.draw(n)
    own = dict(zip([f"joint_{k}" for k in range(1, 7)], np.radians(arm).T, strict=True))
    own |= dict(zip([joint[0] for joint in two_arms.observations.JOINTS], robot.T, strict=True))
    return np.column_stack([own[reading.name] for reading in machine.robot.readings]), arm, robot


def test_both_arms_are_found(folder: Path) -> None:
    """Of 20 poses of the arm before a tracker; what is said of both has the other's errors in it."""
    machine, cell = calib.load_machine(folder / "out"), two_arms.Cell(2)
    q, arm, robot = readings(machine, cell, 300)
    for tool, true in (("reflector", cell.balls(arm)), ("tool", cell.cones(robot))):
        off = machine.predict(q, tool=tool)[:, :3, 3] - cell.to_tracker(true)
        assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.06e-3
        assert np.mean(calib.judging.tool_uncertainty(machine, q, tool).inside(off)) > 0.9


def test_touches_say_what_few_poses_did_not(folder: Path) -> None:
    """Distances between points of the arm need no common frame: those of both in one job are better than its own."""
    cell, both, alone = two_arms.Cell(2), calib.load_machine(folder / "out"), calib.load_machine(folder / "arm_out")
    q, arm, _ = readings(both, cell, 400)
    names = [reading.name for reading in both.robot.readings]
    own = q[:, [names.index(reading.name) for reading in alone.robot.readings]]
    found = both.predict(q, tool="reflector"), alone.predict(own, tool="tool")
    lengths = [np.linalg.norm(x[::2] - x[1::2], axis=1) for x in (cell.balls(arm), *(T[:, :3, 3] for T in found))]
    errors = [float(np.sqrt(np.mean((some - lengths[0]) ** 2))) for some in lengths[1:]]
    assert errors[0] < 0.9 * errors[1]


def test_rank_and_the_ball(folder: Path) -> None:
    """27 for each arm, and the ball's place; the ball is where the reflector is, which nothing said."""
    result = json.loads((folder / "out" / "result.json").read_text())
    assert result["rank"] == result["numerical_rank"] == 27 + 27 + 3
    machine = calib.load_machine(folder / "out")
    apart = np.array(result["targets"]["ball"]["position"]) - machine.tools["reflector"][:3, 3]
    assert np.linalg.norm(apart) < 0.1e-3


def test_exports_for_both(folder: Path) -> None:
    machine = calib.load_machine(folder / "out")
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 12))
    again = calib.load_robot(folder / "out" / "calibrated.urdf", "tool0", links=["probe"])
    for tip, tool in (("tool0", "tool"), ("probe", "reflector")):
        np.testing.assert_allclose(again.with_tip(tip).tips(q), machine.of(tool).tips(q), atol=1e-9)
        said = run("export", folder / "out", "--to", "ros", "-o", folder / f"{tool}.yaml", "--tool", tool)
        assert said.code == 0, said


def test_a_place_that_is_only_guessed(folder: Path) -> None:
    """Found from 20 mm and 20 mrad away; from 3 m and half a turn not, which is said."""
    text, job = (folder / "cell.urdf").read_text(encoding="utf-8"), folder / "guessed.toml"
    place = re.compile(r'(world_mount" type="fixed">.*?<origin xyz=")(.*?)(" rpy=")(.*?)(")', re.DOTALL)
    codes = []
    for k, (far, turn) in enumerate(((0.02, 0.02), (3.0, 3.0))):

        def moved(found: re.Match[str], far: float = far, turn: float = turn) -> str:
            xyz, rpy = (np.array(found[k].split(), dtype=float) for k in (2, 4))
            xyz, rpy = xyz + np.array((far, -far, far)), rpy + np.array((0.5 * turn, 0.0, turn))
            return found[1] + " ".join(map(str, xyz)) + found[3] + " ".join(map(str, rpy)) + found[5]

        changed, count = place.subn(moved, text)
        assert count == 1
        (folder / "guessed.urdf").write_text(changed, encoding="utf-8")
        job.write_text((folder / "both.toml").read_text().replace("cell.urdf", "guessed.urdf"), encoding="utf-8")
        codes.append(run("calibrate", job, "-o", folder / f"guessed_{k}", "-q").code)
    assert codes[0] == 0 and codes[1] != 0
    q, one = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 12)), calib.load_machine(folder / "out")
    other = calib.load_machine(folder / "guessed_0")
    np.testing.assert_allclose(
        other.predict(q, tool="tool")[:, :3, 3], one.predict(q, tool="tool")[:, :3, 3], atol=2e-5
    )
