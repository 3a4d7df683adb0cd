"""Figures of ISO 9283 against cases worked out by hand, an independent formula, and what must not change."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.assessment import iso9283
from calib.assessment.iso9283 import IsoFigure, figures
from calib.foundations.errors import CalibError, MeasurementError
from calib.measurement.cycles import cycles, read_cycles
from calib.measurement.table import table_from_arrays
from scripts.simulate import irb2400 as simulation
from tests.support.cases import run

RNG = np.random.default_rng


def cloud(n: int = 30, seed: int = 0) -> np.ndarray:
    return np.array([0.7, -0.2, 0.5]) + 1e-4 * RNG(seed).standard_normal((n, 3)) * [1.0, 2.0, 0.5]


def columns(**arrays: object) -> dict[str, object]:
    position = np.asarray(arrays.pop("position"))
    found: dict[str, object] = {f"{axis} [m]": position[:, k] for k, axis in enumerate("xyz")}
    command = arrays.pop("command", None)
    if command is not None:
        found |= {f"command_{axis} [m]": np.asarray(command)[:, k] for k, axis in enumerate("xyz")}
    for name, prefix in (("turn", ""), ("command_turn", "command_")):
        turn = arrays.pop(name, None)
        if isinstance(turn, Rotation):
            x, y, z, w = turn.as_quat().T
            unit = " [1]" if prefix else ""
            found |= {f"{prefix}q{c}{unit}": v for c, v in zip("wxyz", (w, x, y, z), strict=True)}
    return found | arrays


def by_name(found: tuple[IsoFigure, ...], place: str) -> dict[str, float]:
    return {f.name: f.value for f in found if f.place == place}


# ---- formulas


def test_four_points_by_hand() -> None:
    """Distances 1, 1, 2, 2 mm from the mean: their mean 1.5, their deviation sqrt(1/3)."""
    attained = 1e-3 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0]])
    assert iso9283.position_repeatability(attained) == pytest.approx(1e-3 * (1.5 + 3 * np.sqrt(1 / 3)))
    assert iso9283.position_accuracy(attained, np.array([0.0, 3e-3, -4e-3])) == pytest.approx(5e-3)


def test_repeatability_is_that_of_the_simulated_irb2400() -> None:
    assert iso9283.position_repeatability(cloud()) == pytest.approx(simulation.repeatability(cloud()), rel=1e-12)


def test_distances_by_hand() -> None:
    """Distances 10, 11, 12 mm of a commanded 10.5: mean 11, deviation 1."""
    first = np.zeros((3, 3))
    second = 1e-3 * np.array([[10.0, 0, 0], [0, 11, 0], [0, 0, 12]])
    assert iso9283.distance_accuracy(first, second, 10.5e-3) == pytest.approx(0.5e-3)
    assert iso9283.distance_repeatability(first, second) == pytest.approx(3e-3)


def test_directions_and_drift_by_hand() -> None:
    ways = [np.array([[x, 0.0, 0.0], [x + 2, 0, 0]]) for x in (0.0, 1.0, 5.0)]
    assert iso9283.multidirectional_variation(ways) == pytest.approx(5.0)
    first, last = np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[0.0, 3, 0], [8, 3, 0]])
    command = np.array([1.0, 0, 0])
    assert iso9283.accuracy_drift(first, last, command) == pytest.approx(np.hypot(3, 3))
    assert iso9283.repeatability_drift(first, last) == pytest.approx(3.0)  # two points lie equally far from their mean


def test_turns_are_about_the_axes_of_the_frame() -> None:
    wanted = Rotation.from_rotvec([0.4, -1.0, 2.0])
    a = np.array([1e-3, 2e-3, -3e-3])
    turns = Rotation.from_rotvec(np.outer([0.5, 1.0, 1.5], a)) * wanted
    data = cycles(
        table_from_arrays(
            columns(position=cloud(3), turn=turns, command_turn=Rotation.concatenate([wanted] * 3), target=["A"] * 3)
        )
    )
    found = by_name(figures(data), "A")
    np.testing.assert_allclose([found[f"AP_{axis}"] for axis in "abc"], a, rtol=1e-6)
    np.testing.assert_allclose([found[f"RP_{axis}"] for axis in "abc"], 3 * 0.5 * np.abs(a), rtol=1e-6)


# ---- tables


def whole() -> dict[str, object]:
    """Two poses, two directions, 12 cycles each, with commands and time."""
    n = 48
    target = [name for name in ("P1", "P2") for _ in range(24)]
    direction = (["left"] * 12 + ["right"] * 12) * 2
    command = np.array([[0.7, -0.2, 0.5] if name == "P1" else [0.7, 0.2, 0.5] for name in target])
    side = np.array([2e-4 if way == "left" else -2e-4 for way in direction])
    position = command + 1e-5 * RNG(1).standard_normal((n, 3)) + np.stack([side, np.full(n, 1e-4), np.zeros(n)], axis=1)
    return columns(position=position, command=command, target=target, direction=direction) | {
        "time [s]": np.arange(n) * 60.0
    }


def test_a_table_with_everything() -> None:
    found = figures(cycles(table_from_arrays(whole())))
    names = {(f.name, f.place) for f in found}
    assert {
        ("vAP_P", "P1"),
        ("AP_P", "P1 from left"),
        ("RP_l", "P2 from right"),
        ("AD_P", "P1 to P2"),
        ("RD_P", "P1 to P2"),
        ("dAP_P", "P1"),
        ("dRP_P", "P2"),
        ("drift of the mean", "P1"),
    } <= names
    left = by_name(found, "P1 from left")
    assert left["AP_P"] == pytest.approx(np.hypot(2e-4, 1e-4), rel=0.1)
    assert left["AP_x"] == pytest.approx(2e-4, rel=0.1)
    assert by_name(found, "P1")["vAP_P"] == pytest.approx(4e-4, rel=0.05)
    assert by_name(found, "P1 to P2")["AD_P"] == pytest.approx(0.0, abs=2e-5)
    # From left in the first third of the cycles and from right in the last: the mean went as the sides do.
    assert by_name(found, "P1")["drift of the mean"] == pytest.approx(4e-4, rel=0.05)


@pytest.mark.parametrize(
    ("target", "direction", "said"),
    [
        ([f"P{k // 2}" for k in range(202)], None, "column 'target' has 101 names; allowed are 100."),
        (["A"] * 1002, [f"d{k // 2}" for k in range(1002)], "from 501 directions together; allowed are 500."),
    ],
)
def test_very_many_poses_are_refused(target: list[str], direction: list[str] | None, said: str) -> None:
    """Between every two of them there would be figures: minutes from a few kilobytes."""
    table = columns(position=cloud(len(target)), target=target, **({"direction": direction} if direction else {}))
    with pytest.raises(MeasurementError) as caught:
        cycles(table_from_arrays(table))
    assert str(caught.value).endswith(said)


def test_without_commands_only_repeatability_is_told() -> None:
    found = figures(cycles(table_from_arrays(columns(position=cloud(), target=["A"] * 30))))
    assert [f.name for f in found] == ["RP_l"]
    assert (found[0].n, found[0].unit) == (30, "m")


def test_the_order_of_rows_and_the_place_of_the_frame_do_not_matter() -> None:
    table = whole()
    order = RNG(3).permutation(48)
    shuffled = {name: np.asarray(values)[order] for name, values in table.items()}
    here, there = (
        {
            (f.name, f.place): f.value
            for f in figures(cycles(table_from_arrays(some)))
            if not f.name.startswith(("AD", "RD"))
        }
        for some in (table, shuffled)
    )
    assert set(here) == set(there)
    for key, value in here.items():
        assert there[key] == pytest.approx(value, rel=1e-9, abs=1e-15)
    R = Rotation.from_rotvec([0.3, 0.2, -0.5]).as_matrix()
    turned = {
        f"{axis} [m]": (np.stack([np.asarray(table[f"{c} [m]"]) for c in "xyz"], axis=1) @ R.T + 1.0)[:, k]
        for k, axis in enumerate("xyz")
    }
    turned |= {
        f"command_{axis} [m]": (np.stack([np.asarray(table[f"command_{c} [m]"]) for c in "xyz"], axis=1) @ R.T + 1.0)[
            :, k
        ]
        for k, axis in enumerate("xyz")
    }
    moved = {(f.name, f.place): f.value for f in figures(cycles(table_from_arrays(table | turned)))}
    for key, value in here.items():
        if key[0] not in ("AP_x", "AP_y", "AP_z"):
            assert moved[key] == pytest.approx(value, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda t: t.pop("target"), "there is no column 'target' of the cycles"),
        (lambda t: t.pop("command_y [m]"), "there is no column 'command_y' of the cycles"),
        (lambda t: t.update({"speed [m]": np.zeros(48)}), "column 'speed' is not one of cycles"),
        (lambda t: t.update({"x [deg]": t.pop("x [m]")}), "unit 'deg' is not a unit of length"),
        (lambda t: t["command_x [m]"].__setitem__(3, 9.0), "target 'P1' has several commands"),
    ],
    ids=["target", "command", "unknown", "unit", "several"],
)
def test_tables_of_something_else_are_refused(change: object, why: str) -> None:
    table = {name: np.array(values) for name, values in whole().items()}
    change(table)  # type: ignore[operator]
    with pytest.raises(MeasurementError) as caught:
        cycles(table_from_arrays(table))
    assert why in str(caught.value)


def test_one_cycle_is_not_repeated() -> None:
    data = cycles(table_from_arrays(columns(position=cloud(3), target=["A", "A", "B"])))
    with pytest.raises(MeasurementError, match="pose 'B' has one cycle; repeatability takes two or more"):
        figures(data)


def test_the_command(tmp_path: Path) -> None:
    table = whole()
    path = tmp_path / "cycles.csv"
    rows = zip(*(np.asarray(values).tolist() for values in table.values()), strict=True)
    path.write_text("\n".join([",".join(table), *(",".join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")
    said = run("iso9283", path)
    assert (said.code, said.err) == (0, "")
    assert "vAP_P" in said.out
    found = json.loads(run("iso9283", path, "--json").out)["figures"]
    assert len(found) == len(figures(read_cycles(path)))
    assert max(map(len, said.out.splitlines())) <= 80
    assert run("iso9283", tmp_path / "none.csv").code == 1


def test_formulas_are_told_what_is_no_cycle_in_a_sentence() -> None:
    one, two = np.zeros((1, 3)), np.zeros((2, 3))
    for slip, said in (
        (lambda: iso9283.position_repeatability(one), "repeatability needs 2 cycles or more."),
        (lambda: iso9283.orientation_repeatability(one), "repeatability needs 2 cycles or more."),
        (lambda: iso9283.distance_repeatability(one, one), "repeatability needs 2 cycles or more."),
        (lambda: iso9283.position_accuracy(np.zeros((0, 3)), np.zeros(3)), "must be finite numbers (n, 3)"),
        (lambda: iso9283.position_accuracy(two, np.zeros(2)), "the commanded position must be three finite numbers"),
        (lambda: iso9283.distance_accuracy(one, two, 0.1), "1 cycle of one pose and 2 of the other."),
        (lambda: iso9283.multidirectional_variation([two]), "needs two directions or more."),
        (lambda: iso9283.position_accuracy(None, np.zeros(3)), "attained is None; needs an array of numbers."),  # type: ignore[arg-type]
    ):
        with pytest.raises(CalibError) as caught:
            slip()
        assert said in str(caught.value)
