"""Set-ups and tools by name, from a job file through the command line, and what is wrong with them."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import calib
from tests.support import machines
from tests.support.cases import run, write_table
from tests.support.machines import Array, anywhere, pose
from tests.support.touching import UR10

SIGMA = 3e-5
JOB = """
schema = 1
[robot]
urdf = "example:ur_description/urdf/ur10_robot.urdf"
tip = "tool0"
[error_model]
offsets = "all"
placements = "all"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of one arm, from the left with two tools, from the right with one, and from afar to judge alone."""
    folder, rng = tmp_path_factory.mktemp("set_ups"), np.random.default_rng(2)
    arm = machines.arm(*UR10).moved(rng)
    tools = {"ball": pose((0.02, 0.03, 0.12)), "long": pose((-0.1, 0.03, 0.25))}
    bases = {"left": anywhere(rng), "right": anywhere(rng), "far": anywhere(rng)}

    def columns(setup: str, tool: str, n: int) -> dict[str, object]:
        q = arm.draw(rng, n)
        seen = machines.Machine(arm, bases[setup], {tool: tools[tool]}).see(q)
        seen[:, :3, 3] += rng.normal(scale=SIGMA, size=(n, 3))
        return machines.table(arm, q, seen, "position")

    for name, setup, tool, n in (
        ("left", "left", "ball", 60),
        ("left_long", "left", "long", 20),
        ("right", "right", "ball", 40),
        ("judge", "right", "ball", 20),
        ("far", "far", "long", 20),
    ):
        write_table(folder / f"{name}.csv", columns(setup, tool, n))
    both = [columns("left", "ball", 30), columns("right", "ball", 30)]
    write_table(
        folder / "both.csv",
        {name: np.concatenate([part[name] for part in both]) for name in both[0]}
        | {"setup": ["left"] * 30 + ["right"] * 30, "tool": ["ball"] * 60},
    )
    return folder


def table(file: str, **keys: str) -> str:
    more = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    return f'[[measurements]]\nfile = "{file}.csv"\nsigma = "0.03 mm"\n{more}\n'


LEFT, RIGHT = table("left", setup="left", tool="ball"), table("right", setup="right", tool="ball")


def said_of(folder: Path, *sections: str) -> tuple[Path, Path]:
    job = folder / "job.toml"
    job.write_text(JOB + "".join(sections), encoding="utf-8")
    return job, folder / "out"


def test_a_set_up_that_the_last_level_has_no_rows_of_is_told(folder: Path) -> None:
    """The arm from the left, then where it stands on the right: the results did not know the left any more."""
    levels = "".join(
        f'[[levels]]\nname = "{name}"\nmeasurements = [{files}]\nfree = ["{free}"]\n'
        for name, files, free in (("arm", '"left.csv"', "*"), ("place", '"right.csv"', "base*"))
    )
    job, out = said_of(folder, levels, LEFT, RIGHT)
    said = " ".join(run("calibrate", job, "-o", out).out.split())
    assert "levels: the last one has no rows of the set-up 'left', which the results therefore do not have" in said
    job, _ = said_of(folder, levels.replace('["right.csv"]', '["left.csv", "right.csv"]'), LEFT, RIGHT)
    assert "the last one has no rows" not in " ".join(run("calibrate", job, "-o", out).out.split())
    assert list(json.loads((out / "result.json").read_text())["setups"]) == ["left", "right"]


def test_an_arm_from_two_places(folder: Path) -> None:
    held_out = table("judge", setup="right", tool="ball", use="validate")
    unseen = table("far", setup="far", tool="long", use="validate")
    job, out = said_of(folder, LEFT, RIGHT, table("both"), held_out, unseen)
    said = run("calibrate", job, "-o", out)
    assert said.code == 0, said
    # Nothing but these rows knows where the base was there, nor the longer tool.
    assert "the tool 'long' is in no table to identify from" in " ".join(said.out.split())
    result = json.loads((out / "result.json").read_text())
    names = {record["name"] for record in result["parameters"]}
    assert {"base.left.x", "base.right.rz", "tool.ball.z"} <= names
    assert result["metrics"]["validation"]["after"]["position"]["rms"] < 3 * SIGMA
    assert list(result["setups"]) == ["left", "right"]

    # What the machine is used for, by name.
    assert run("verify", out, folder / "judge.csv", "--setup", "right", "--tool", "ball", "-q").code == 0
    assert run("verify", out, folder / "judge.csv", "--setup", "left", "--tool", "ball", "-q").code == 3
    # Rows of two set-ups: each base is found anew by itself.
    both = run("verify", out, folder / "both.csv", "--sigma", "0.03 mm", "--refit-base", "--json")
    assert both.code == 0, both
    anew = json.loads(both.out)["with_base_refitted"]
    assert anew["test"]["degrees_of_freedom"] == 60 * 3 - 12
    assert anew["metrics"]["position"]["rms"] < 3 * SIGMA
    # A new place, and rows that name none: how such are judged is said, and so it is.
    head, *rows = (folder / "judge.csv").read_text().splitlines()
    (folder / "new.csv").write_text("\n".join([f"{head}, setup", *(f"{row}, new" for row in rows)]) + "\n")
    judge = ("verify", out, folder / "new.csv", "--tool", "ball", "--refit-base", "-q")
    assert "judged as of a known one, with its base found anew: ignore the column, name setup 'left'" in run(*judge).err
    assert run(*judge, "--ignore", "setup", "--setup", "left").code == 0
    nameless = run("verify", out, folder / "judge.csv", "--tool", "ball", "--refit-base", "-q").err
    assert "no column says in which set-up the rows were measured; known are 'left', 'right': name one" in nameless
    machine = calib.load_machine(out)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 6))
    for setup in ("left", "right"):
        placed = machine.at(setup).predict(q, tool="ball")[:, :3, 3]
        write_table(folder / "wanted.csv", {f"{axis} [m]": placed[:, k] for k, axis in enumerate("xyz")})
        (folder / "corrected.csv").unlink(missing_ok=True)
        options = ("--tool", "ball", "--setup", setup, "--frame", "instrument", "-q")
        assert run("compensate", out, folder / "wanted.csv", "-o", folder / "corrected.csv", *options).code == 0
        with (folder / "corrected.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        found = np.radians(
            [[float(row[f"{reading.name} [deg]"]) for reading in machine.robot.readings] for row in rows]
        )
        again = machine.at(setup).predict(found, tool="ball")[:, :3, 3]
        np.testing.assert_allclose(again, placed, atol=1e-6)
        placed_in = ("--placed-in", "instrument", "--setup", setup, "--json")
        cell = run("cell", out, out, "-o", folder / f"{setup}.urdf", *placed_in)
        np.testing.assert_allclose(json.loads(cell.out)["placement"], np.eye(4), atol=1e-9)
    # Which one is meant is not guessed.
    which = f"{out}: was calibrated in several set-ups, 'left', 'right'; say which one is meant, by setup.\n"
    said = run("cell", out, out, "-o", folder / "cell.urdf")
    assert (said.code, said.err) == (1, f"Error: {which}")
    options = ("--tool", "ball", "--frame", "instrument", "-q")
    said = run("compensate", out, folder / "wanted.csv", "-o", folder / "guessed.csv", *options)
    assert (said.code, said.err) == (1, f"Error: {which}")
    assert not (folder / "cell.urdf").exists() and not (folder / "guessed.csv").exists()
    assert run("uncertainty", out, "--setup", "right", "--tool", "ball", "--samples", "20", "-q").code == 0
    said = run("uncertainty", out, "--tool", "ball")
    assert (said.code, said.err) == (1, f"Error: {which}")
    unknown = run("uncertainty", out, "--setup", "moon", "--tool", "ball")
    assert (unknown.code, unknown.err.count("\n")) == (1, 1)
    assert "there is no set-up 'moon'; the calibrated ones are 'left', 'right'" in unknown.err


def _toml(T: Array) -> str:
    position = ", ".join(f'"{v:.9f} m"' for v in T[:3, 3])
    w, x, y, z = calib.foundations.rigid.quaternion_of(T[:3, :3])
    return f"position = [{position}]\nquaternion = [{w:.12f}, {x:.12f}, {y:.12f}, {z:.12f}]\n"


def test_a_base_that_is_known_or_about_known(folder: Path) -> None:
    job, out = said_of(folder, LEFT, RIGHT)
    assert run("calibrate", job, "-o", out, "-q").code == 0
    bases = calib.load_machine(out).bases
    prior = 'prior = { length = "1 mm", angle = "1 mrad" }\n'
    job, out = said_of(folder, f"[setups.right]\n{_toml(bases['right'])}{prior}", LEFT, RIGHT)
    assert run("calibrate", job, "-o", out, "-q").code == 0
    records = {r["name"]: r for r in json.loads((out / "result.json").read_text())["parameters"]}
    assert records["base.right.x"]["prior"] == 1e-3
    assert records["base.left.x"]["prior"] is None
    job, out = said_of(folder, f"[setups.right]\n{_toml(bases['right'])}", LEFT, RIGHT)
    assert run("calibrate", job, "-o", out, "-q").code == 0
    np.testing.assert_allclose(calib.load_machine(out).bases["right"], bases["right"], atol=1e-8)
    assert "base.right.x" not in (out / "result.json").read_text()


FRAME = 'position = ["0 m", "0 m", "0 m"]\n'
WRONG = {
    "tool by key and column": (
        (table("both", tool="ball"),),
        "both.csv: the tool is given twice, as 'ball' and by column",
    ),
    "set-up by key and column": ((table("both", setup="left"),), "both.csv: the setup is given twice, as 'left'"),
    "set-up of nothing": (
        (LEFT, f"[setups.moon]\n{FRAME}"),
        "job.toml: setups: 'moon' is in no measurement; the measurements have 'left'.",
    ),
    "base of no set-up": (
        (LEFT, f'[base]\n{FRAME}prior = {{ length = "1 mm", angle = "1 mrad" }}\n'),
        "job.toml: base: a pose is given, and every measurement has a named set-up: 'left'; give it in [setups.NAME].",
    ),
    "base by name": ((LEFT, f"[setups.base]\n{FRAME}"), "job.toml: setups.base: is the set-up without a name"),
    "half a prior": (
        (LEFT, f'[setups.left]\n{FRAME}prior = {{ length = "1 mm" }}\n'),
        "job.toml: setups.left.prior.angle: is missing.",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_names_are_refused_in_one_sentence(folder: Path, case: str) -> None:
    sections, sentence = WRONG[case]
    job, out = said_of(folder, *sections)
    said = run("calibrate", job, "-o", out.with_name("none"))
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    assert sentence in said.err
    assert not out.with_name("none").exists()


def test_a_fixed_base_needs_a_pose_in_every_set_up(folder: Path) -> None:
    job, out = said_of(folder, LEFT, RIGHT, f"[setups.left]\n{FRAME}")
    job.write_text(job.read_text().replace("[error_model]", '[error_model]\nbase = "fixed"'), encoding="utf-8")
    said = run("calibrate", job, "-o", out.with_name("none"))
    assert "job.toml: setups: the pose of the base in 'right' is missing, and the base is fixed." in said.err


LEVELS = """
harmonics = ["elbow_joint"]
[[levels]]
name = "geometry"
measurements = ["left.csv"]
free = ["*_joint.t?", "*_joint.r?", "*.offset", "base.*", "tool.*"]
[[levels]]
name = "gear"
measurements = ["right.csv"]
free = ["elbow_joint.*", "base.*", "tool.*"]
"""


def test_levels_of_other_set_ups_and_tools_make_one_machine(folder: Path) -> None:
    """What a URDF holds is fitted to all tables; of the machine only the last level's set-ups and tools are kept."""
    job, out = said_of(folder, LEVELS, table("left", setup="left", tool="long"), RIGHT)
    assert run("calibrate", job, "-o", out, "-q").code in (0, 3)
    machine = calib.load_machine(out)
    assert machine.in_urdf is not None
    assert machine.in_urdf.bases.keys() == machine.bases.keys()
    assert machine.in_urdf.tools.keys() == machine.tools.keys()


AFTER = """
schema = 1
[robot]
urdf = "whole/calibrated.urdf"
tip = "tool0"
[error_model]
tool = "position"
[[measurements]]
file = "after.csv"
sigma = "0.03 mm"
"""


def test_base_and_tool_after_a_crash_are_found_from_a_few_rows(folder: Path) -> None:
    """The arm is as it was calibrated; it stands elsewhere and carries another tool."""
    job, _ = said_of(folder, LEFT, RIGHT)
    assert run("calibrate", job, "-o", folder / "whole", "-q").code == 0
    rng = np.random.default_rng(2)
    arm = machines.arm(*UR10).moved(rng)
    rng = np.random.default_rng(8)
    true = machines.Machine(arm, anywhere(rng), {"new": pose((0.08, -0.05, 0.2))})

    def seen(n: int) -> tuple[Array, Array]:
        q = arm.draw(rng, n)
        return q, true.see(q)

    q, poses = seen(8)
    poses[:, :3, 3] += rng.normal(scale=SIGMA, size=(8, 3))
    write_table(folder / "after.csv", machines.table(arm, q, poses, "position"))
    (folder / "after.toml").write_text(AFTER, encoding="utf-8")
    assert run("calibrate", folder / "after.toml", "-o", folder / "after", "-q").code in (0, 3)
    result = json.loads((folder / "after" / "result.json").read_text())
    assert result["rank"] == len(result["parameters"]) == 9
    q, poses = seen(200)
    machine = calib.load_machine(folder / "after")
    d = machine.predict(q)[:, :3, 3] - poses[:, :3, 3]
    nominal = calib.load_robot(*UR10).tips(q) @ machine.tools["tool"]
    assert np.sqrt(np.mean(np.sum(d**2, axis=1))) < 4.0 * SIGMA
    assert np.abs((machine.base @ nominal)[:, :3, 3] - poses[:, :3, 3]).max() > 1e-3
