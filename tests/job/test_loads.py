"""Loads that differ from table to table, from a job file to what is made of the machine."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.job.arm import read_arm
from calib.job.schema import InstrumentSection
from tests.support import machines
from tests.support.cases import run
from tests.support.gears import UR10
from tests.support.machines import Array
from tests.support.sagging import BALL, CENTRE, DOWN, SOFT, WALL, Sagging, arm, two_arms

SIGMA = 3e-5
JOB = f"""
schema = 1
[robot]
urdf = "{UR10[0]}"
tip = "tool0"
[error_model]
offsets = "all"
placements = "all"
elastic = {list(SOFT)}
"""


def payload(mass: float) -> str:
    return f'{{ mass = "{mass} kg", position = {[f"{v} m" for v in CENTRE]} }}'


def write(path: Path, columns: Mapping[str, object]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One arm on the floor with 0, 1.25 and 2.5 kg, and on the wall with 2.5 kg, each to identify and to judge."""
    folder, rng = tmp_path_factory.mktemp("loads"), np.random.default_rng(21)
    machine, plain = arm(rng), machines.arm(*UR10)
    bases = {"floor": machines.anywhere(rng), "wall": machines.anywhere(rng)}

    def columns(place: str, mass: float, n: int) -> dict[str, object]:
        u, gravity = plain.draw(rng, n), WALL if place == "wall" else DOWN
        seen = [
            bases[place]
            @ machine.tip("tool0", dict(zip(plain.ranges, q, strict=True)), gravity, {"tool0": (mass, CENTRE)})
            @ BALL
            for q in u
        ]
        poses = np.array(seen)
        poses[:, :3, 3] += SIGMA * rng.standard_normal((n, 3))
        return machines.table(plain, u, poses, "position")

    for name, place, mass in (
        ("empty", "floor", 0.0),
        ("light", "floor", 1.25),
        ("heavy", "floor", 2.5),
        ("wall", "wall", 2.5),
    ):
        write(folder / f"{name}.csv", columns(place, mass, 45))
        write(folder / f"{name}_judge.csv", columns(place, mass, 15))
    return folder


def table(file: str, carried: str = "", setup: str = "", use: str = "identify") -> str:
    more = f"payload = {carried}\n" if carried else ""
    more += f'setup = "{setup}"\n' if setup else ""
    return f'[[measurements]]\nfile = "{file}.csv"\nsigma = "0.03 mm"\nuse = "{use}"\n{more}'


def calibrated(folder: Path, name: str, *sections: str, code: int = 0) -> tuple[Path, dict[str, object]]:
    job, out = folder / f"{name}.toml", folder / f"{name}_out"
    job.write_text(JOB + "".join(sections), encoding="utf-8")
    said = run("calibrate", job, "-o", out, "-q")
    assert said.code == code, said
    return out, json.loads((out / "result.json").read_text())


def judged(result: dict[str, object]) -> float:
    metrics = result["metrics"]
    assert isinstance(metrics, dict)
    return float(metrics["validation"]["after"]["position"]["rms"])


def test_payloads_by_table_and_a_wall_by_set_up(folder: Path) -> None:
    heavy = payload(2.5)
    wall = f"[setups.wall]\ngravity = {[f'{g} m/s2' for g in WALL]}\npayload = {heavy}\n"
    tables = [
        table(f"{name}{more}", carried, setup, use)
        for more, use in (("", "identify"), ("_judge", "validate"))
        for name, carried, setup in (
            ("empty", "", ""),
            ("light", payload(1.25), ""),
            ("heavy", heavy, ""),
            ("wall", "", "wall"),
        )
    ]
    out, result = calibrated(folder, "all", wall, *tables)
    assert judged(result) < 1.2 * SIGMA * np.sqrt(3.0)
    blind = [text.replace(f"payload = {heavy}\n", "").replace(f"payload = {payload(1.25)}\n", "") for text in tables]
    _, unknowing = calibrated(folder, "blind", *blind, code=3)
    assert judged(unknowing) > 2.0 * judged(result)

    # Whoever uses the machine names the set-up, and has its load.
    machine = calib.load_machine(out)
    assert machine.at("wall").robot.load == calib.measuring.Load(WALL, calib.measuring.Payload(2.5, CENTRE))
    assert machine.at("base").robot.load == calib.measuring.Load(DOWN)
    assert run("verify", out, folder / "wall_judge.csv", "--setup", "wall", "-q").code == 0
    assert run("verify", out, folder / "empty_judge.csv", "-q").code == 0
    assert run("verify", out, folder / "heavy_judge.csv", "-q").code == 3  # carries nothing there
    assert run("uncertainty", out, "--setup", "wall", "--samples", "20", "-q").code == 0
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 6))
    found: list[Array] = []
    bases_of = ("base", "wall")
    for setup in bases_of:
        there = machine.at(setup)
        placed = there.predict(q)[:, :3, 3]
        write(folder / "wanted.csv", {f"{axis} [m]": placed[:, k] for k, axis in enumerate("xyz")})
        (folder / "corrected.csv").unlink(missing_ok=True)
        options = ("--setup", setup, "--frame", "instrument", "--what", "position", "-q")
        assert run("compensate", out, folder / "wanted.csv", "-o", folder / "corrected.csv", *options).code == 0
        with (folder / "corrected.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        asked = np.radians([[float(row[f"{r.name} [deg]"]) for r in machine.robot.readings] for row in rows])
        np.testing.assert_allclose(there.predict(asked)[:, :3, 3], placed, atol=1e-6)
        found.append((np.linalg.inv(there.base) @ there.predict(q))[:, :3, 3])
    assert np.abs(found[0] - found[1]).max() > 3e-5  # the same readings, under another load

    # Nor does it touch anything elsewhere than where it is said to stand.
    touching = {"kind": "arm", "sigma": "0.1 mm", "model": out.name, "tool": "tool"}
    arms = [read_arm("it", InstrumentSection.model_validate(touching | {"setup": name}), folder) for name in bases_of]
    assert [one.arm.machine.robot.load for one in arms] == [machine.at(name).robot.load for name in bases_of]
    with pytest.raises(calib.JobError, match=r"instruments\.it: .* set-ups, 'base', 'wall'; say by setup"):
        read_arm("it", InstrumentSection.model_validate(touching), folder)
    with pytest.raises(calib.JobError, match=r"instruments\.it\.setup: there is no set-up 'moon'"):
        read_arm("it", InstrumentSection.model_validate(touching | {"setup": "moon"}), folder)
    turns = {f"{reading.name} [rad]": q[:, k] for k, reading in enumerate(machine.robot.readings)}
    write(folder / "cone.csv", turns | {"target": ["cone"] * 3})
    asked_for = run("performance", out, folder / "cone.csv")
    assert (asked_for.code, "say which one is meant, by setup" in asked_for.err) == (1, True)
    told = [
        json.loads(run("performance", out, folder / "cone.csv", "--setup", name, "--json").out) for name in bases_of
    ]
    assert told[0]["after"] != told[1]["after"]

    # What a file for a controller leaves out costs another distance in each.
    asked_for = run("export", out, "--to", "offsets", "-o", folder / "none.csv")
    assert (asked_for.code, "say which one is meant, by setup" in asked_for.err) == (1, True)
    costs = []
    for name in bases_of:
        written = run("export", out, "--to", "offsets", "-o", folder / f"of_{name}.csv", "--setup", name, "--json")
        assert written.code == 0, written.err
        costs.append(json.loads(written.out)["lost"])
    assert costs[0] != costs[1]
    assert run("export", out, "--to", "ros", "-o", folder / "all.yaml", "-q").code == 0
    assert run("export", out, "--to", "ros", "-o", folder / "of_wall.yaml", "--setup", "wall", "-q").code == 0
    assert "there is no set-up 'moon'" in run("export", out, "--to", "ros", "-o", folder / "m", "--setup", "moon").err


def test_a_payload_that_a_set_up_bears_is_as_good_as_one_of_the_table(folder: Path) -> None:
    heavy = payload(2.5)
    by_table = [table("empty"), table("heavy", heavy), table("heavy_judge", heavy, use="validate")]
    by_setup = [
        f"[setups.loaded]\npayload = {heavy}\n",
        table("empty"),
        table("heavy", setup="loaded"),
        table("heavy_judge", setup="loaded", use="validate"),
    ]
    (_, one), (_, other) = calibrated(folder, "by_table", *by_table), calibrated(folder, "by_setup", *by_setup)
    assert judged(other) == pytest.approx(judged(one), rel=0.1)
    assert judged(one) < 1.3 * SIGMA * np.sqrt(3.0)


def test_the_other_arm_is_read_where_it_is_named(tmp_path: Path) -> None:
    """A table of one arm of two tells the joints of the other: unused, they make a warning; named, they weigh."""
    rng, text = np.random.default_rng(22), two_arms()
    (tmp_path / "two.urdf").write_text(text, encoding="utf-8")
    truth, base = Sagging(text, {"lean": 4e-5, "left_lift": 3e-5}), machines.anywhere(rng)
    names = ["lean", "left_lift", "left_bend", "right_lift", "right_bend"]
    for file, n in (("left.csv", 50), ("judge.csv", 20)):
        u = rng.uniform(-1.2, 1.2, (n, 5))
        x = np.array(
            [(base @ truth.tip("left_hand", dict(zip(names, q, strict=True))) @ [0.1, 0.03, 0.02, 1])[:3] for q in u]
        )
        columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(names)}
        write(
            tmp_path / file,
            columns | {f"{a} [m]": x[:, k] + SIGMA * rng.standard_normal(n) for k, a in enumerate("xyz")},
        )
    results = []
    for links, code in (('links = ["right_hand"]\n', 0), ("", 3)):
        (tmp_path / "job.toml").write_text(
            f'schema = 1\n[robot]\nurdf = "two.urdf"\ntip = "left_hand"\n{links}'
            '[error_model]\nelastic = ["lean", "left_lift"]\n' + table("left") + table("judge", use="validate"),
            encoding="utf-8",
        )
        said = run("calibrate", tmp_path / "job.toml", "-o", tmp_path / "out", "-q")
        assert said.code == code, (links, said)
        results.append(json.loads((tmp_path / "out" / "result.json").read_text()))
    assert judged(results[0]) < 1.2 * SIGMA * np.sqrt(3.0) < 0.5 * judged(results[1])
    said_of = [" ".join(result["findings"]) for result in results]
    assert ["is taken as if the joint were at zero" in text for text in said_of] == [False, True]
