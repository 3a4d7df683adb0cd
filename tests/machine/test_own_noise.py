"""Set-ups and tools whose rows scatter more than others: a noise of their own, by tables and by columns, and kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import OutputError
from calib.machine.model_file import machine_files
from calib.machine.tool_uncertainty import row_freedom, row_noise
from calib.machine.uncertainty import NoiseLevel, OwnNoise, Uncertainty
from tests.support import machines
from tests.support.machines import Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA, MORE = 3e-5, 3e-4
PLACES = {"hall": SIGMA, "wall": float(np.hypot(SIGMA, MORE))}


def tables(scatter: dict[str, float], observes: str = "position", rows: int = 50) -> list[calib.Measurements]:
    rng = np.random.default_rng(5)
    robot, arm = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    found = []
    for setup, sigma in scatter.items():
        true = Machine(arm, anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})
        seen = true.measure(
            robot,
            arm.draw(rng, rows),
            observes,
            rng=rng,
            sigma=sigma,
            sigma_angle=10 * sigma,
            stated=(SIGMA, 10 * SIGMA),
        )
        found.append(seen.named(setup=setup))
    return found


def machine(sets: list[calib.Measurements], **options: object) -> calib.CalibratedMachine:
    keys = {"offsets": "all", "placements": "all", "tool": "position"} | options
    return calib.machine_of(calib.identify(machines.model(machines.load(*UR10), **keys), sets))


@pytest.fixture(scope="module")
def noisy() -> calib.CalibratedMachine:
    return machine(tables(PLACES))


def model_of(level: NoiseLevel | None) -> float:
    assert level is not None
    return level.model


def test_a_set_up_that_scatters_more_has_its_own_noise(noisy: calib.CalibratedMachine) -> None:
    known = noisy.known_uncertainty
    assert model_of(known.noise("wall", "tool")[0]) == pytest.approx(MORE, rel=0.15)
    # Elsewhere the common one holds: rows of a small volume scatter less, too.
    assert known.noise("hall", "tool")[0] == known.position
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    there, here = (calib.judging.tool_uncertainty(noisy.at(name), q).budget["model"][:, 0] for name in ("wall", "hall"))
    assert (there > np.sqrt(3.0) * 0.85 * MORE).all()
    assert (here < there).all()


def test_sound_set_ups_have_one_noise() -> None:
    known = machine(tables(dict.fromkeys(PLACES, SIGMA))).known_uncertainty
    assert known.own_noise == ()
    assert known.noise("hall", "tool") == known.noise("anywhere", "anything") == (known.position, known.orientation)


def places(seed: int, rows: dict[str, int], scatter: dict[str, float]) -> list[calib.Measurements]:
    """Positions of one arm in several places, whose noise is not stated."""
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    found = []
    for name, n in rows.items():
        true = Machine(arm, anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})
        seen = true.measure(robot, arm.draw(rng, n), "position", rng=rng, sigma=scatter.get(name, SIGMA))
        found.append(replace(seen, sigma=np.zeros_like(seen.sigma)).named(setup=name))
    return found


def test_few_rows_that_scatter_more_leave_others_as_sure_as_they_were() -> None:
    """Three rows of one place have a noise of their own; by its degrees of freedom all regions were twice as large."""
    hall, wall = places(3, {"hall": 60, "wall": 3}, {"wall": 100 * SIGMA})
    found = machine([hall, wall])
    known, q = found.known_uncertainty, np.zeros((1, 6))
    here, there = (known.freedom(name, "tool") for name in ("hall", "wall"))
    assert there < 4.0
    assert here == known.degrees_of_freedom > 100.0
    for name, freedom in (("hall", here), ("wall", there)):
        assert calib.judging.tool_uncertainty(found.at(name), q).degrees_of_freedom == freedom
    np.testing.assert_array_equal(row_freedom(found, wall), np.full(3, there))
    np.testing.assert_array_equal(row_freedom(found, hall), np.full(60, here))


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_of_many_set_ups_one_scatters_most_by_chance(seed: int) -> None:
    """What happens to one of a hundred happens to one of so many that it is no noise of their own."""
    assert machine(places(seed, {"hall": 40} | {f"{k}": 3 for k in range(24)}, {})).known_uncertainty.own_noise == ()


def test_a_sigma_that_says_it_is_no_noise_of_its_own() -> None:
    hall, wall = tables(PLACES)
    wall = replace(wall, sigma=np.full_like(wall.sigma, PLACES["wall"]))
    assert machine([hall, wall]).known_uncertainty.own_noise == ()


def test_half_of_few_rows_scatter_more_than_the_other_half() -> None:
    """Beside the noise of all, of which they are half, they are never more than twice that, whatever they are."""
    known = machine(tables(PLACES, rows=15)).known_uncertainty
    assert model_of(known.noise("wall", "tool")[0]) == pytest.approx(MORE, rel=0.3)
    assert known.noise("hall", "tool")[0] == known.position


def test_a_table_without_a_sigma_is_compared_by_all_of_its_scatter() -> None:
    """The instrument's part is no more of the model there than where it is stated."""
    hall, wall = tables(dict.fromkeys(PLACES, SIGMA))
    assert machine([hall, replace(wall, sigma=np.zeros_like(wall.sigma))]).known_uncertainty.own_noise == ()


def test_one_table_with_a_column_says_the_same(noisy: calib.CalibratedMachine) -> None:
    """Rows of one table have one noise in the fit; how they scatter about it tells set-ups apart."""
    hall, wall = tables(PLACES)
    assert hall.position is not None
    assert wall.position is not None
    robot, names = machines.load(*UR10), [f"{name} [rad]" for name in hall.reading_names]
    both = np.concatenate([hall.readings, wall.readings])
    places = np.concatenate([hall.position, wall.position])
    columns: dict[str, object] = {name: both[:, k] for k, name in enumerate(names)}
    columns |= {f"{axis} [m]": places[:, k] for k, axis in enumerate("xyz")} | {"setup": ["hall"] * 50 + ["wall"] * 50}
    fit = calib.identify(
        machines.model(robot, offsets="all", placements="all", tool="position"),
        calib.read_measurements(columns, robot, sigma=SIGMA),
    )
    known = calib.machine_of(fit).known_uncertainty
    assert model_of(known.noise("wall", "tool")[0]) == pytest.approx(MORE, rel=0.25)
    assert known.noise("hall", "tool")[0] == known.position


def test_outliers_that_a_robust_loss_passes_over_are_no_noise() -> None:
    hall, wall = tables(dict.fromkeys(PLACES, SIGMA))
    assert wall.position is not None
    off = wall.position.copy()
    off[::12] += 5e-3
    keys = {"offsets": "all", "placements": "all", "tool": "position"}
    model = machines.model(machines.load(*UR10), **keys)
    fit = calib.identify(model, [hall, replace(wall, position=off)], losses=["huber", "huber"])
    assert calib.machine_of(fit).known_uncertainty.own_noise == ()


def test_a_tool_and_orientations() -> None:
    hall, _ = tables(dict.fromkeys(PLACES, SIGMA), "pose")
    other = tables(PLACES, "pose")[1]
    known = machine([hall, other], tool="pose").known_uncertainty
    assert known.orientation is not None
    assert model_of(known.noise("wall", "tool")[1]) == pytest.approx(10 * MORE, rel=0.15)
    assert known.noise("hall", "tool")[1] == known.orientation
    rows = row_noise(machine([hall, other], tool="pose"), other)
    np.testing.assert_allclose(rows, [3 * [PLACES["wall"]] + 3 * [10 * PLACES["wall"]]] * len(rows), rtol=0.15)


def test_of_a_pair_that_was_not_measured_the_largest_counts(noisy: calib.CalibratedMachine) -> None:
    small, large, huge = (NoiseLevel(sigma, sigma, 50.0) for sigma in (1e-5, 1e-4, 1e-3))
    pairs = (OwnNoise("a", "s", small, None), OwnNoise("b", "t", large, None), OwnNoise("b", "u", huge, None))
    known: Uncertainty = replace(noisy.known_uncertainty, own_noise=pairs)
    assert known.noise("a", "s") == (small, None)
    assert known.noise("b", "s") == (huge, None)
    assert known.noise("a", "t") == (large, None)
    assert known.freedom("a", "s") == 50.0 < known.degrees_of_freedom


def test_it_is_kept_and_verifies(noisy: calib.CalibratedMachine, tmp_path: Path) -> None:
    for name, content in machine_files(noisy).items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    again = calib.load_machine(tmp_path)
    assert again.known_uncertainty.own_noise == noisy.known_uncertainty.own_noise != ()
    for one in (noisy, again):
        for setup, data in zip(PLACES, tables(PLACES), strict=True):
            assert calib.verify(one, data).passed, setup
        # As much scatter in the hall is no accident.
        hall, _ = tables({"hall": 3 * PLACES["wall"], "wall": SIGMA})
        assert not calib.verify(one, hall).passed
    file = tmp_path / "uncertainty.json"
    file.write_text(file.read_text().replace('"tool": "tool"', '"tool": 3'))
    with pytest.raises(OutputError, match=r"own_noise"):
        calib.load_machine(tmp_path)
