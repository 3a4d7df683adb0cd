"""The case robots/panda_sockets: made by its script, its truth found again, and the tutorial about it holds."""

import json
import math
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.identification.relations import Relation
from calib.job.inputs import load
from tests.support import machines

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "panda_sockets"
TUTORIAL = ROOT / "docs" / "tutorial_sockets.md"
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def recorded(place: str, hole: str) -> Array:
    return np.loadtxt(CASE / "recordings" / place / f"{hole}.csv", delimiter=",")


@pytest.fixture(scope="module")
def truth() -> dict[str, object]:
    return tomllib.loads((CASE / "truth.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    """From front, left and raised, as the tutorial has it, with the play as it is."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", "panda_hand_tcp")
    sets = []
    for place in ("front", "left", "raised"):
        holes = [recorded(place, hole) for hole in ("hole_0", "hole_1")]
        table: dict[str, object] = {f"panda_joint{k + 1} [rad]": np.concatenate(holes)[:, k] for k in range(7)}
        table["target"] = [f"{place}/hole_{h}" for h in (0, 1) for _ in holes[h]]
        sets.append(calib.read_measurements(table, robot, "socket"))
    relations = [Relation("distance", (f"{p}/hole_0", f"{p}/hole_1"), 0.05, 1e-4) for p in ("front", "left", "raised")]
    model = machines.model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        prior_length=1e-3,
        prior_angle=5e-3,
        relations=relations,
    )
    return calib.identify(model, sets)


def test_the_script_makes_these_bytes(tmp_path: Path) -> None:
    subprocess.run([sys.executable, ROOT / "scripts/simulate/panda_sockets.py", tmp_path], check=True)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    assert made == sorted(path.relative_to(CASE) for path in CASE.rglob("*.*") if path.name != "README.md")
    for path in made:
        assert (tmp_path / path).read_bytes() == (CASE / path).read_bytes()


def test_joints_may_give_way(tmp_path: Path) -> None:
    script = ROOT / "scripts/examples/sockets_job.py"
    arguments = [sys.executable, script, CASE / "recordings", tmp_path, "--robot", "panda"]
    subprocess.run([*arguments, "--identify", "front", "left", "--wind-up"], check=True, capture_output=True)
    joints = [f"panda_joint{k}.elastic" for k in range(2, 7)]
    parameters = load(tmp_path / "calibration.toml").model.parameters()
    found = {p.name: p.prior for p in parameters if p.kind == "term"}
    assert found == pytest.approx(dict.fromkeys(joints, 1e-4))


def test_the_truth_is_found(fit: calib.Fit, truth: dict[str, object]) -> None:
    """Distances between true sockets, which do not depend on where the base is thought to be."""
    true = {f"{p}/{h}": np.array(x) for p, holes in truth["sockets"].items() for h, x in holes.items()}  # type: ignore[attr-defined]
    names = [name for name in true if not name.startswith("right")]
    found = {name: np.array([fit.value(f"target.{name}.{c}") for c in "xyz"]) for name in names}
    C = fit.covariance
    numbers = {p.name: k for k, p in enumerate(fit.parameters)}
    within = []
    for i, a in enumerate(names):
        for b in names[:i]:
            apart = found[a] - found[b]
            along = apart / np.linalg.norm(apart)
            g = np.zeros(len(C))
            for c, value in zip("xyz", along, strict=True):
                g[numbers[f"target.{a}.{c}"]] += value
                g[numbers[f"target.{b}.{c}"]] -= value
            off = np.linalg.norm(apart) - np.linalg.norm(true[a] - true[b])
            within.append(abs(off) / np.sqrt(g @ C @ g))
    assert np.mean(np.array(within) < 2.0) > 0.8
    assert max(within) < 4.0
    assert all(noise.total == pytest.approx(truth["play"], rel=0.25) for noise in fit.noise)


def test_what_was_pushed_at_a_place_that_took_no_part(fit: calib.Fit, truth: dict[str, object]) -> None:
    pushed = truth["pushed"]
    assert isinstance(pushed, dict)
    q = recorded(pushed["place"], pushed["hole"])
    x = (fit.robot.tips(q, fit.deviations) @ fit.machine.frames.tools[0])[:, :3, 3]
    shift = x[pushed["after"] :].mean(axis=0) - x[: pushed["after"]].mean(axis=0)
    assert np.linalg.norm(shift) == pytest.approx(np.linalg.norm(pushed["by"]), abs=0.15e-3)


def test_moving_the_robot_and_permuting_rows_change_nothing(fit: calib.Fit) -> None:
    order = [np.random.default_rng(k).permutation(len(data)) for k, data in enumerate(fit.measurements)]
    again = calib.identify(fit.model, [d.subset(o) for d, o in zip(fit.measurements, order, strict=True)])
    assert np.allclose(again.values, fit.values, atol=1e-9)


def test_every_command_of_the_tutorial(tmp_path: Path) -> None:
    """Blocks of commands are run in turn, and what follows them is found in what they print, to two per cent."""
    for name in ("scripts", "robots"):
        (tmp_path / name).symlink_to(ROOT / name)
    bin_folder = tmp_path / "bin"
    bin_folder.mkdir()
    run = f"exec {sys.executable}"
    for name, text in (("python", f'{run} "$@"'), ("calib", f'{run} -c "from calib.cli import main; main()" "$@"')):
        (bin_folder / name).write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
        (bin_folder / name).chmod(0o755)
    environment = os.environ | {
        "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", ""))),
    }
    printed, shown = "", 0
    for kind, text in re.findall(r"```(\w+)\n(.*?)```", TUTORIAL.read_text(encoding="utf-8"), re.DOTALL):
        if kind == "sh":
            done = subprocess.run(
                ["sh", "-e", "-c", text], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            printed = done.stdout
        else:
            assert found_in(text.split(), printed.split()), f"{text}\nis not in\n{printed}"
            shown += 1
    assert shown >= 5
    worst = json.loads((tmp_path / "out_all" / "result.json").read_text(encoding="utf-8"))["outliers"]
    assert (worst["jumps"][0]["file"], worst["jumps"][0]["line"], worst["jumps"][0]["told"]) == ("right.csv", 33, True)
    assert not any(jump["told"] for jump in worst["jumps"][1:])
    assert not any(one["told"] for one in (*worst["rows"], *worst["groups"]))


def found_in(wanted: list[str], words: list[str]) -> bool:
    return any(
        all(map(alike, wanted, words[start : start + len(wanted)])) for start in range(len(words) - len(wanted) + 1)
    )


def alike(a: str, b: str) -> bool:
    numbers = [[float(word) for word in NUMBER.findall(text)] for text in (a, b)]
    return NUMBER.sub("#", a) == NUMBER.sub("#", b) and all(
        math.isclose(x, y, rel_tol=0.02, abs_tol=0.02) for x, y in zip(*numbers, strict=True)
    )
