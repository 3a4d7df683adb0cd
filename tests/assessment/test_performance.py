"""Acceptance figures: on points whose figures a hand can compute, on tables, and on the arm in robots/arm_cmm."""

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.assessment.performance import (
    Performance,
    PerformanceFigure,
    articulated_location,
    before_and_after,
    performance,
    probing,
    single_point_articulation,
    volumetric_lengths,
)
from calib.foundations.errors import MeasurementError
from calib.job.inputs import load
from calib.job.run import run
from calib.measurement.table import table_from_arrays
from calib.measurement.touches import Touches, read_touches, touches
from calib.positioner.pivot import pivot
from calib.presentation.command_tables import performance_sheet
from calib.presentation.tables import plain, sheet_table
from calib.results.folder import write_results
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.terms import JointTerm

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "arm_cmm"
SCRIPT = ROOT / "scripts/studies/arm_cmm_performance.py"
TESTS = ("cone.csv", "lengths.csv", "sphere.csv", "articulations.csv")

AXES = np.vstack([np.eye(3), -np.eye(3)])


# ---- from points


def values(figures: Sequence[PerformanceFigure]) -> dict[str, float]:
    return {figure.name: figure.value for figure in figures}


def test_single_point_articulation_by_hand() -> None:
    # Six points 3 mm either way along the axes: all 3 mm off the mean, and 2 sqrt(6 * 9 / 5) mm.
    found = single_point_articulation([0.4, 0.2, 0.1] + 3e-3 * AXES, "near")
    assert values(found)["largest"] == pytest.approx(3e-3, abs=1e-15)
    assert values(found)["2s"] == pytest.approx(2e-3 * np.sqrt(54 / 5), abs=1e-15)
    assert {(figure.place, figure.n) for figure in found} == {("near", 6)}
    with pytest.raises(MeasurementError, match="two or more"):
        single_point_articulation(np.zeros((1, 3)))


def test_volumetric_lengths_by_hand() -> None:
    found = values(volumetric_lengths(np.array([0.300, 0.301, 0.598, 0.602]), np.array([0.3, 0.3, 0.6, 0.6])))
    assert found["largest"] in (pytest.approx(-2e-3), pytest.approx(2e-3))
    assert found["range"] == pytest.approx(4e-3)
    assert found["2s"] == pytest.approx(2e-3 * np.sqrt((0 + 1 + 4 + 4) / 4))
    # An error of scale shows: all lengths 1 mm too short have no range, and a 2s.
    short = values(volumetric_lengths(np.full(5, 0.299), np.full(5, 0.3)))
    assert short == {"largest": pytest.approx(-1e-3), "range": pytest.approx(0.0), "2s": pytest.approx(2e-3)}
    # A single length has no range.
    assert values(volumetric_lengths(np.array([0.3005]), np.array([0.3]))) == {
        "largest": pytest.approx(5e-4),
        "2s": pytest.approx(1e-3),
    }


def test_probing_by_hand() -> None:
    # Ball centres on a sphere of 15.05 mm radius, whose poles stand 20 um out and whose equator 10 um in, so that the
    # least-squares radius stays: the fit is symmetric, and the mean of 2 * 20 - 4 * 10 is nothing.
    radii = 15.05e-3 + np.array([-10e-6, -10e-6, 20e-6] * 2)
    found = probing([0.1, 0.2, 0.3] + radii[:, None] * AXES, diameter=24e-3, ball=6e-3, place="far")
    assert [figure.name for figure in found] == ["PSize.Sph.1x6", "PForm.Sph.1x6"]
    assert [figure.value for figure in found] == pytest.approx([0.1e-3, 30e-6], abs=1e-12)


def test_articulated_location_by_hand() -> None:
    # Centres on a circle of 40 um radius, one inside it; spheres of different size have centres all the same.
    centres = 40e-6 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1], [0.1, 0.2, 0.3]])
    sizes = 15e-3 + 1e-6 * np.arange(5)
    (found,) = articulated_location([c + r * AXES[:5] for c, r in zip(centres, sizes, strict=True)])
    assert found.value == pytest.approx(80e-6, abs=1e-12)
    assert found == PerformanceFigure("articulated location", "sphere", 5, "LDia.5x5", found.value)


def test_where_the_arm_stands_and_in_which_order_it_touched_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    points = [15e-3 * AXES + 1e-5 * rng.standard_normal((6, 3)) for _ in range(5)]
    moved = [p @ Rotation.random(random_state=2).as_matrix().T + [3.0, -2.0, 1.0] for p in points]
    for a, b in ((points, moved), (points, [rng.permutation(p) for p in points[::-1]])):
        assert articulated_location(a)[0].value == pytest.approx(articulated_location(b)[0].value, abs=1e-12)
        for evaluate in (lambda p: single_point_articulation(p)[1].value, lambda p: probing(p, 24e-3, 6e-3)[1].value):
            assert sorted(map(evaluate, a)) == pytest.approx(sorted(map(evaluate, b)), abs=1e-12)


def test_probe_point_is_found_from_cones_at_unknown_places() -> None:
    rng = np.random.default_rng(4)
    point, cones = np.array([4e-3, -2e-3, 0.15]), rng.uniform(-0.5, 0.5, (3, 3))
    names = [name for name in "abc" for _ in range(4)]
    tips = np.tile(np.eye(4), (12, 1, 1))
    tips[:, :3, :3] = Rotation.random(12, random_state=4).as_matrix()
    tips[:, :3, 3] = np.repeat(cones, 4, axis=0) - tips[:, :3, :3] @ point
    assert np.abs(pivot(tips, names, guess=np.zeros(3)).tool_point - point).max() < 1e-14
    # Turned about one axis only, what lies along it cannot be seen and stays as guessed.
    tips[:, :3, :3] = Rotation.from_euler("z", np.arange(12.0)[:, None]).as_matrix()
    tips[:, :3, 3] = np.repeat(cones, 4, axis=0) - tips[:, :3, :3] @ point
    assert np.abs(pivot(tips, names, guess=np.full(3, 0.1)).tool_point - [4e-3, -2e-3, 0.1]).max() < 1e-14


# ---- from tables


@pytest.fixture(scope="module")
def robot() -> calib.Robot:
    return calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")


JOINTS = {f"joint_{i} [deg]": [10.0, 20.0, 30.0, 40.0] for i in range(1, 7)}
CONE: dict[str, Any] = {"target": ["a", "a", "b", "b"]}
LENGTH: dict[str, Any] = {"target": list("abab"), "pair": [1, 1, 2, 2], "length [mm]": [300.0, 300.0, 600.0, 600.0]}
SPHERE: dict[str, Any] = {"target": ["a"] * 4, "diameter [mm]": [25.0] * 4, "ball [mm]": [6.0] * 4}


def made(robot: calib.Robot, columns: Mapping[str, Any]) -> Touches:
    return touches(table_from_arrays(JOINTS | columns), robot.readings)


def test_a_table_says_which_test_it_is(robot: calib.Robot) -> None:
    assert made(robot, CONE).kind == "cone"
    assert made(robot, LENGTH).kind == "length"
    assert made(robot, SPHERE).kind == "sphere"
    assert made(robot, SPHERE | {"group": [1, 1, 2, 2]}).kind == "articulations"
    found = made(robot, LENGTH | {"time [s]": [0.0] * 4})
    assert found.sizes["length"].tolist() == [0.3, 0.3, 0.6, 0.6]
    assert found.words["pair"] == ("1", "1", "2", "2")
    assert found.readings[3] == pytest.approx(np.radians(40.0) * np.ones(6))


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({}, "no column 'target' of a cone test"),
        ({"targt [mm]": [0.0] * 4, **CONE}, "'targt' is not one of a cone test"),
        ({"target": ["a"] * 4, "length [mm]": [300.0] * 4}, "no column 'pair' of a length test"),
        ({"target": ["a"] * 4, "diameter [mm]": [25.0] * 4}, "no column 'ball' of a sphere test"),
        (LENGTH | {"length [mm]": [300.0, 300.0, 600.0, -600.0]}, "arrays:3: column 'length' is not positive"),
        ({**CONE, "length [deg]": [1.0] * 4, "pair": [1] * 4}, "'deg' is not a unit of length"),
    ],
    ids=["no target", "misspelt", "no pair", "no ball", "negative", "unit"],
)
def test_tables_that_are_no_test(robot: calib.Robot, columns: dict[str, Any], sentence: str) -> None:
    with pytest.raises(MeasurementError, match=sentence):
        made(robot, columns)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (LENGTH | {"pair": [1, 1, 1, 1]}, "column 'length' is 300 mm in line 0 and 600 mm in line 2"),
        (LENGTH | {"target": ["a"] * 4}, "pair '1' has the ends 'a'; a length has two"),
        (CONE | {"target": list("aaab")}, "cone 'b': has one touch"),
        (SPHERE | {"target": list("aaab")}, "sphere 'a': a sphere needs four points"),
        (SPHERE, "sphere 'a': has four touches; the test takes five or more"),
        (SPHERE | {"group": ["x"] * 4}, "sphere 'a': has one articulation; the test takes two or more"),
        (SPHERE | {"ball [mm]": [6.0, 6.0, 6.0, 7.0]}, "column 'ball' is 6 mm in line 0 and 7 mm in line 3"),
    ],
    ids=["two lengths", "one end", "one touch", "three points", "four points", "one articulation", "two balls"],
)
def test_tests_that_cannot_be_evaluated(robot: calib.Robot, columns: dict[str, Any], sentence: str) -> None:
    def tips(readings: Array, /, *, conditions: object) -> Array:
        frames = np.tile(np.eye(4), (len(readings), 1, 1))
        frames[:, :3, 3] = np.vstack([np.zeros(3), np.eye(3)])
        return frames

    with pytest.raises(MeasurementError, match=f"arrays: {sentence}"):
        performance(tips, [made(robot, columns)], None, np.zeros(3))


def test_a_cone_in_one_pose_shows_no_articulation(robot: calib.Robot) -> None:
    columns = JOINTS | {name: [values[0]] * 4 for name, values in JOINTS.items()} | CONE
    same = touches(table_from_arrays(columns), robot.readings)
    with pytest.raises(MeasurementError, match=r"cone '.*': all \d touches are in one pose; the test takes"):
        performance(robot.tips, [same], made(robot, CONE | {"target": ["a"] * 4}), np.zeros(3))


def test_touches_that_only_find_the_probe_judge_nothing(robot: calib.Robot) -> None:
    """Two touches of a cone are six numbers: its place and the probe take them all, and the figures would be zero."""
    rng = np.random.default_rng(0)
    columns = {name: rng.uniform(-90.0, 90.0, 2) for name in JOINTS}
    two = touches(table_from_arrays(columns | {"target": ["a"] * 2}), robot.readings)
    said = "arrays: 6 numbers were touched, and the places of cones and probe take 6; touch more"
    with pytest.raises(MeasurementError, match=said):
        performance(robot.tips, [two], None, np.zeros(3))


@pytest.mark.parametrize("tilts", [False, True])
def test_a_probe_that_was_never_tilted_judges_none_that_is(tilts: bool) -> None:
    """Nothing tells where it is along the axis of its turns: lengths were 80 mm off, of a machine without any error.

    Where all touches turn it about that axis alone, as those of a planar arm do, it does not matter.
    """
    ball, rng = np.array([0.02, 0.0, 0.08]), np.random.default_rng(0)

    def tips(readings: Array, /, *, conditions: Conditions) -> Array:
        T = np.tile(np.eye(4), (len(readings), 1, 1))
        T[:, :3, :3] = Rotation.from_euler("ZY", readings[:, :2]).as_matrix()
        T[:, :3, 3] = readings[:, 2:]
        return T

    def touching(points: Array, turns: Array) -> Array:
        at = tips(np.concatenate([turns, points], axis=1), conditions=NO_CONDITIONS)
        return np.concatenate([turns, points - at[:, :3, :3] @ ball], axis=1)

    turns = np.stack([np.linspace(-2.0, 2.0, 8), np.zeros(8)], axis=1)
    cone = touching(np.full((8, 3), 0.3), turns)
    ends = rng.uniform(-0.5, 0.5, (8, 3))
    known = np.repeat(np.linalg.norm(ends[::2] - ends[1::2], axis=1), 2)
    apart = touching(ends, turns + ([0.0, 1.0] * rng.uniform(-1.0, 1.0, (8, 2)) if tilts else 0.0))
    pairs = {"target": ("a", "b") * 4, "pair": tuple(f"p{k // 2}" for k in range(8))}
    tests = [
        Touches("cone", cone, {"target": ("c",) * 8}, {}, "cone.csv", np.arange(8)),
        Touches("length", apart, pairs, {"length": known}, "lengths.csv", np.arange(8)),
    ]
    if tilts:
        with pytest.raises(
            MeasurementError, match=r"cone.csv: .* the figures of lengths.csv, which turns it otherwise"
        ):
            performance(tips, tests, None, np.zeros(3))
    else:
        found = performance(tips, tests, None, np.zeros(3))
        assert max(abs(figure.value) for figure in found.figures) < 1e-12
        assert found.probe == pytest.approx([0.02, 0.0, 0.0], abs=1e-12)


def test_very_many_cones_and_spheres_are_refused(robot: calib.Robot) -> None:
    columns = {name: np.arange(202.0) for name in JOINTS} | {"target": [f"c{k // 2}" for k in range(202)]}
    with pytest.raises(MeasurementError, match="column 'target' has 101 names; allowed are 100"):
        touches(table_from_arrays(columns), robot.readings)


def test_touches_by_several_tools_are_refused(robot: calib.Robot) -> None:
    """They were taken for touches of one probe, whose place then was that of neither."""
    columns = {name: np.arange(4.0) for name in JOINTS} | {"target": ["a"] * 4}
    assert touches(table_from_arrays(columns | {"tool": ["short"] * 4}), robot.readings).kind == "cone"
    with pytest.raises(MeasurementError, match="column 'tool' has 'short', 'long'; a test is of one probe"):
        touches(table_from_arrays(columns | {"tool": ["short", "long"] * 2}), robot.readings)


def test_the_table_says_whose_probe_it_is(robot: calib.Robot) -> None:
    given = performance(robot.tips, [made(robot, LENGTH)], None, np.zeros(3))
    assert "the probe is the tool of the results" in " ".join(told(given, given).split())


def test_the_probe_is_found_from_cones_only(robot: calib.Robot) -> None:
    with pytest.raises(MeasurementError, match="the probe is found from touches of a cone"):
        performance(robot.tips, [made(robot, CONE)], made(robot, LENGTH), np.zeros(3))


def test_without_a_cone_the_tool_of_the_model_serves(robot: calib.Robot) -> None:
    point = np.array([0.01, 0.02, 0.03])
    assert performance(robot.tips, [made(robot, LENGTH)], None, point).probe.tolist() == point.tolist()


# ---- the arm in robots/arm_cmm


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> calib.CalibratedMachine:
    out = tmp_path_factory.mktemp("arm") / "out"
    write_results(run(load(CASE / "calibration_realistic.toml")), out)
    return calib.load_machine(out)


def test_the_side_of_approach_of_touches_is_told_by_columns_alone(model: calib.CalibratedMachine) -> None:
    """There is nothing to say of their order: the sentence shall not send anybody there."""
    robot = replace(model.robot, terms=(JointTerm("joint_2", "backlash"),))
    loose = replace(model, robot=robot, deviations=replace(model.deviations, terms=np.ones(1)), uncertainty=None)
    with pytest.raises(MeasurementError) as caught:
        before_and_after(loose, [made(robot, CONE)])
    assert str(caught.value).endswith("there is no column 'direction_joint_2', which joint_2.backlash needs.")


def test_calibration_brings_the_arm_from_centimetres_to_its_encoders(model: calib.CalibratedMachine) -> None:
    tests = [read_touches(CASE / name, model.robot) for name in TESTS]
    before, after = before_and_after(model, tests, read_touches(CASE / "probe.csv", model.robot))
    assert [(f.test, f.place, f.n, f.name) for f in before.figures] == [
        (f.test, f.place, f.n, f.name) for f in after.figures
    ]
    for b, a in zip(before.figures, after.figures, strict=True):
        assert abs(b.value) > 4e-3
        assert abs(a.value) < 0.15e-3
    text = told(before, after)
    assert max(map(len, text.splitlines())) <= 80
    assert "LDia.5x5" in text
    assert "no certificate" in text


def test_the_order_of_files_only_orders_the_figures(model: calib.CalibratedMachine) -> None:
    tests = [read_touches(CASE / name, model.robot) for name in TESTS]
    _, after = before_and_after(model, tests)
    _, again = before_and_after(model, tests[::-1])
    assert set(after.figures) == set(again.figures)


def test_the_page_shows_what_the_script_prints() -> None:
    printed = subprocess.run([sys.executable, str(SCRIPT), "--markdown"], check=True, capture_output=True, text=True)
    page = (ROOT / "docs" / "arm_cmm_performance.md").read_text(encoding="utf-8")
    start, _, rest = page.partition("<!-- scripts/studies/arm_cmm_performance.py --markdown -->\n")
    shown = rest.partition("<!-- end -->")[0]
    assert start
    assert rows(shown) == rows(printed.stdout)
    for a, b in zip(numbers(shown), numbers(printed.stdout), strict=True):
        # The last digit may go with the machine that computes.
        assert a == pytest.approx(b, abs=1.5e-4)


def told(before: Performance, after: Performance) -> str:
    return plain(sheet_table(performance_sheet({"before": before, "after": after})))


def rows(table: str) -> list[list[str]]:
    return [line.split(" | ")[:4] for line in table.splitlines()]


def numbers(table: str) -> list[float]:
    return [float(cell.strip(" |")) for line in table.splitlines()[2:] for cell in line.split(" | ")[4:]]
