"""The case robots/positioner: its data is what the script makes, its URDFs are the script's machines."""

import io
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import calib
from calib import positioner
from calib.job.inputs import load
from scripts.simulate import positioner as simulation
from tests.support.cases import ROOT, run
from tests.support.scenes import commands_of

CASE = ROOT / "robots" / "positioner"
SCRIPT = ROOT / "scripts/simulate/positioner.py"
FILES = ("pivot.csv", "touched.csv", "validation.csv", "truth.toml")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("case") / "out"
    said = run("calibrate", CASE / "calibration.toml", "-o", out)
    assert (said.code, said.err) == (0, "")
    return out


def test_tables_are_what_the_script_makes(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(SCRIPT), str(tmp_path)], check=True)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (CASE / name).read_bytes()
        if name.endswith(".csv"):
            assert (CASE / name).read_text(encoding="utf-8").startswith("# Simulated, not measured on a real machine")


def test_truth_is_the_scripts() -> None:
    truth = tomllib.loads((CASE / "truth.toml").read_text(encoding="utf-8"))
    assert truth["spike_on_flange_mm"] == list(simulation.SPIKE)
    assert truth["rotary"]["translation_mm"] == list(simulation.ROTARY_PLACE)
    assert truth["marks_on_table_mm"] == {name: list(mark) for name, mark in simulation.MARKS.items()}


def test_welder_is_the_scripts_robot() -> None:
    urdf = yourdfpy.URDF.load(str(CASE / "welder.urdf"))
    names = [f"joint_{k}" for k in range(1, 7)]
    rng = np.random.default_rng(0)
    limits = np.degrees([[urdf.joint_map[n].limit.lower, urdf.joint_map[n].limit.upper] for n in names])
    np.testing.assert_allclose(limits, simulation.LIMITS_DEG, atol=1e-9)
    for q in rng.uniform(-1.5, 1.5, (10, 6)):
        urdf.update_cfg(dict(zip(names, q, strict=True)))
        T = urdf.get_transform("flange", "base_link")
        place, pointing = simulation.tip(q)
        np.testing.assert_allclose(1e3 * T[:3, 3] + T[:3, :3] @ simulation.SPIKE, place, atol=1e-9)
        np.testing.assert_allclose(T[:3, 2], pointing, atol=1e-12)


def test_positioner_is_nearly_the_scripts_one() -> None:
    """As designed, the axes are at right angles and 58 mm apart; the one made is 5 mrad and 2 mm off."""
    urdf = yourdfpy.URDF.load(str(CASE / "positioner.urdf"))
    urdf.update_cfg({"tilt": 0.0, "rotary": 0.0})
    here = urdf.get_transform("table", "cradle")
    np.testing.assert_allclose(urdf.get_transform("cradle", "pedestal")[:3, :3], simulation.Q, atol=1e-12)
    np.testing.assert_allclose(here[:3, 3] * 1e3 + [2.0, 0.0, 0.0], simulation.ROTARY_PLACE, atol=1e-9)
    made = simulation.Q @ simulation.rotation(simulation.ROTARY_TURN)
    turned = np.arccos((np.trace(here[:3, :3].T @ made) - 1.0) / 2.0)
    assert turned == pytest.approx(5e-3, rel=1e-6)
    R0, _ = simulation.table((0.0, 0.0))
    stands = simulation.rotation(simulation.BASE_TURN)
    for tilt, rotary in ((90.0, 0.0), (0.0, 90.0)):
        R, _ = simulation.table((tilt, rotary))
        urdf.update_cfg({"tilt": np.radians(tilt), "rotary": np.radians(rotary)})
        designed = urdf.get_transform("table", "pedestal")[:3, :3] @ (simulation.Q @ simulation.Q).T
        assert np.abs(designed - stands.T @ R @ R0.T @ stands).max() < 0.01


def test_calibration_finds_the_axes(results: Path) -> None:
    model = calib.load_machine(results)
    rng = np.random.default_rng(1)
    q = np.column_stack([rng.uniform(-90, 90, 300), rng.uniform(-180, 180, 300)])
    s = np.column_stack([rng.uniform(-500, 500, (300, 2)), rng.uniform(0, 300, 300)])
    zero = model.base @ model.tips(np.zeros((1, 2)))[0]
    errors = []
    for readings, point in zip(q, s, strict=True):
        R0, place0 = simulation.table((0.0, 0.0))
        R, place = simulation.table(readings)
        start, there = 1e-3 * (R0 @ point + place0), 1e-3 * (R @ point + place)
        T = model.base @ model.tips(np.radians(readings)[None])[0] @ np.linalg.inv(zero)
        errors.append(T[:3, :3] @ start + T[:3, 3] - there)
    # Twice the expected error of 20 poses of one mark would be 0.2 mm; here are two marks, and the spike's own error.
    assert np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) < 0.15e-3


def test_five_points_of_the_table_agree(results: Path) -> None:
    """The rows at zero, rotary +-60 and tilt +-90 of mark A: the closed form as a check of the fit."""
    inputs = load(CASE / "calibration.toml")
    (touched,) = inputs.identify
    first = {(round(t), round(r)): x for (t, r), x, mark in zip(np.degrees(touched.readings), touched.position,
             touched.tool, strict=True) if mark == 0}  # fmt: skip
    P = [first[pose] for pose in ((0, 0), (0, 60), (0, -60), (90, 0), (-90, 0))]
    found = positioner.five_point(*P, angles=np.radians([60, -60, 90, -90]).tolist())
    assert not found.findings
    model = calib.load_machine(results)
    T = model.base @ model.tips(np.radians([[50.0, -100.0], [0.0, 0.0]]))
    carried = T[0] @ np.linalg.inv(T[1])
    assert (
        np.linalg.norm((carried[:3, :3] @ P[0] + carried[:3, 3]) - found.points(P[0], *np.radians([50, -100]))) < 1e-3
    )


def test_cell_has_both_machines_at_the_calibrated_place(results: Path, tmp_path: Path) -> None:
    cell, scene = tmp_path / "cell.urdf", tmp_path / "cell.html"
    said = run("cell", CASE / "welder.urdf", results, "-o", cell, "--scene", scene)
    assert (said.code, said.err) == (0, "")
    model = calib.load_machine(results)
    both, alone = (yourdfpy.URDF.load(str(path)) for path in (cell, CASE / "welder.urdf"))
    rng = np.random.default_rng(2)
    for q, a in zip(rng.uniform(-1.5, 1.5, (5, 2)), rng.uniform(-1.5, 1.5, (5, 6)), strict=True):
        arm = {f"joint_{k + 1}": v for k, v in enumerate(a)}
        both.update_cfg({"tilt": q[0], "rotary": q[1], **arm})
        alone.update_cfg(arm)
        T = model.base @ model.tips(q[None])[0]
        np.testing.assert_allclose(both.get_transform("table", "base_link"), T, atol=1e-9)
        np.testing.assert_allclose(
            both.get_transform("flange", "base_link"), alone.get_transform("flange", "base_link"), atol=1e-12
        )
    page = scene.read_text(encoding="utf-8")
    assert "cell.urdf: calibrated cell" in page
    drawn = {c["path"].split("/")[2] for c in commands_of(page) if c["path"].startswith("/robot/")}
    assert {"lower_arm", "hand", "pedestal", "table"} <= drawn
    # A second time, nothing is overwritten.
    again = run("cell", CASE / "welder.urdf", results, "-o", cell)
    assert (again.code, again.err) == (1, f"Error: {cell}: already exists; choose another name.\n")


def without(folder: Path, to: Path, *files: str) -> Path:
    """A copy of results that do not say in whose frame the base is, and without some files."""
    shutil.copytree(folder, to)
    model = json.loads((to / "model.json").read_text(encoding="utf-8"))
    model["placed"] = None
    (to / "model.json").write_text(json.dumps(model), encoding="utf-8")
    for name in files:
        (to / name).unlink()
    return to


def test_cell_says_how_sure_the_place_is(results: Path, tmp_path: Path) -> None:
    said = run("cell", CASE / "welder.urdf", results, "-o", tmp_path / "cell.urdf")
    assert re.search(r"Its place is known to 0\.\d{3} mm and 0\.\d{4} deg \(standard", " ".join(said.out.split()))
    assert f"{results}: does not hold the errors of the arm that touched" in " ".join(said.out.split())
    told = json.loads(run("cell", CASE / "welder.urdf", results, "-o", tmp_path / "again.urdf", "--json").out)
    place = told["uncertainty"]
    variances = np.diag(place["covariance"])
    assert place["sigma_position"] == pytest.approx(np.sqrt(variances[:3].sum()))
    assert place["sigma_orientation"] == pytest.approx(np.sqrt(variances[3:].sum()))
    # Noise of 0.1 mm of 40 touches; and no doubt that is a convention of frames on axes.
    assert 0.02e-3 < place["sigma_position"] < 0.2e-3
    assert (place["undetermined"], told["placed_in"], told["notes"]) == ([], "arm", [])


def test_whose_frame_it_is_is_known(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "cell.urdf"
    said = run("cell", CASE / "welder.urdf", results, "-o", out, "--placed-in", "instrument")
    assert said.code == 1 and said.err == (
        f"Error: {results}: its base was found in the base of an arm that touched it, and not in an instrument's "
        "frame: placed_in 'instrument' is wrong here.\n"
    )
    assert not out.exists()
    old = without(results, tmp_path / "old", "uncertainty.json")
    said = run("cell", CASE / "welder.urdf", old, "-o", out, "--json")
    told = json.loads(said.out)
    assert (said.code, told["placed_in"], told["uncertainty"]) == (0, "arm", None)
    assert told["remarks"][0].startswith(f"{old}: does not say in whose frame its base was found;")
    assert told["remarks"][1] == f"{old}: its uncertainty is not known; calibrate it again."
    said = run("cell", CASE / "welder.urdf", old, "-o", tmp_path / "words.urdf")
    assert "How sure its place is in the cell is not known." in said.out


def test_arm_and_positioner_named_the_wrong_way_round(results: Path, tmp_path: Path) -> None:
    seen = without(results, tmp_path / "seen")
    text = (seen / "model.json").read_text(encoding="utf-8")
    placed = '"placed": {"within": "instrument", "by_arm": null}'
    (seen / "model.json").write_text(text.replace('"placed": null', placed, 1), encoding="utf-8")
    out = tmp_path / "cell.urdf"
    said = run("cell", results, seen, "-o", out)
    assert (said.code, said.err) == (
        1,
        f"Error: {results}: its base was found in the base of an arm that touched it, and that of {seen} in an "
        "instrument's frame; the arm is named first, what it touched second.\n",
    )
    assert not out.exists()


def test_a_doubted_result_is_told(results: Path, tmp_path: Path) -> None:
    doubted = tmp_path / "doubted"
    shutil.copytree(results, doubted)
    text = (doubted / "result.json").read_text(encoding="utf-8")
    (doubted / "result.json").write_text(text.replace('"trusted": true', '"trusted": false', 1), encoding="utf-8")
    said = run("cell", CASE / "welder.urdf", doubted, "-o", tmp_path / "cell.urdf")
    assert said.code == 3 and f"{doubted} is not trusted: see its own report." in " ".join(said.out.split())
    assert (tmp_path / "cell.urdf").exists()


def test_cell_of_machines_that_one_instrument_saw(results: Path, tmp_path: Path) -> None:
    """Both bases in the instrument's frame, as older results may be taken; and names that both use."""
    old = without(results, tmp_path / "old")
    said = run("cell", old, old, "-o", tmp_path / "cell.urdf", "--placed-in", "instrument", "--prefix", "two")
    assert (said.code, said.err) == (0, "")
    assert "Renamed, as both use the name: two_pedestal, two_cradle, two_table, two_tilt, two_rotary." in " ".join(
        said.out.split()
    )
    cell = yourdfpy.URDF.load(io.BytesIO((tmp_path / "cell.urdf").read_bytes()))
    cell.update_cfg({"tilt": 0.3, "rotary": 1.0, "two_tilt": 0.3, "two_rotary": 1.0})
    np.testing.assert_allclose(cell.get_transform("table", "two_table"), np.eye(4), atol=1e-9)


def test_cells_that_cannot_be_are_one_sentence(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "cell.urdf"
    welder = CASE / "welder.urdf"
    old = without(results, tmp_path / "old")
    for arguments, sentence in (
        ((welder, old, "--placed-in", "instrument"), f"{welder}: a URDF does not say where the arm stood in "
         "the instrument's frame; give the folder of its results."),
        ((welder, results, "--setup", "north"), "there is no set-up 'north'; the calibrated one is 'base'."),
        ((welder, tmp_path), f"{tmp_path / 'model.json'}: there is no such file."),
        ((tmp_path / "no.urdf", results), f"{tmp_path / 'no.urdf'}: there is no such file."),
        ((CASE / "truth.toml", results), f"{CASE / 'truth.toml' / 'model.json'}: there is no such file."),
    ):  # fmt: skip
        said = run("cell", *arguments, "-o", out)
        assert (said.code, said.err) == (1, f"Error: {sentence}\n")
    said = run("cell", welder, results, "-o", out, "--scene", out)
    assert said.err == f"Error: {out}: cannot be the cell and its scene; choose another name for one of them.\n"
    assert not out.exists()
