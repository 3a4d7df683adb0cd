"""What scripts/benchmarks/benchmark_peers.py computes by itself: the machine, the judge, medians, ratios, the page."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.robot.sources import resolve
from scripts.benchmarks import benchmark_peers as script


@pytest.fixture
def chain() -> Any:
    return script.chain_of(resolve(script.URDF).read_text(encoding="utf-8"), script.BASE_LINK, script.exchange.TIP)


def line(program: str, *runs: tuple[float, float], converged: bool = True, extra: bool = False) -> Any:
    """A line whose runs took so many seconds and missed by so many mm."""
    entry = script.Entry(program, "default", "`solve()`", extra)
    made = [
        script.Run(2.0 * cpu, cpu, error, 27, converged, "4 steps", {"numpy": "1.2.3"}) if cpu > 0.0 else failed()
        for cpu, error in runs
    ]
    return script.Line(entry, tuple(made))


def failed() -> Any:
    return script.Run(failure="stopped after 10 min")


def test_its_kinematics_are_those_of_the_robot(chain: Any) -> None:
    robot = calib.load_robot(script.URDF, tip=script.exchange.TIP)
    readings = np.random.default_rng(3).uniform(-3.0, 3.0, (20, 6))
    assert np.allclose(script.tips(chain, readings), robot.tips(readings), atol=1e-12)


def test_the_axes_turn_the_home_pose_as_the_chain_does(chain: Any) -> None:
    """Product of exponentials: every peer's own kinematics are built on these axes."""
    points, directions, home = script.axes(chain)
    readings = np.random.default_rng(4).uniform(-3.0, 3.0, 6)
    T = np.eye(4)
    for q, p, w in zip(readings, points, directions, strict=True):
        R = script.Rotation.from_rotvec(q * w).as_matrix()
        T = T @ script.pose(R, p - R @ p)
    assert np.allclose(T @ home, script.tips(chain, readings[None])[0], atol=1e-12)


def test_the_guess_finds_base_and_tool_of_a_nominal_machine(chain: Any) -> None:
    rng = np.random.default_rng(5)
    base = script.pose(script.Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix(), np.array([2.0, -1.0, 0.5]))
    tool = np.array([0.05, 0.02, 0.15])
    T = script.tips(chain, rng.uniform(-3.0, 3.0, (60, 6)))
    found_base, found_tool = script.guess(T, (base @ T @ np.append(tool, 1.0))[:, :3])
    assert np.allclose(found_base, base, atol=1e-5)
    assert np.allclose(found_tool, tool, atol=1e-5)


def test_the_simulated_case_has_a_known_floor_and_keeps_what_the_judge_knows(chain: Any) -> None:
    race = script.simulated(chain)
    assert race.floor == pytest.approx(1e3 * script.NOISE * np.sqrt(3.0), rel=0.05)
    assert race.measured.shape == (len(race.case.unseen), 3)
    # The nominal robot is far from the floor: there is something to find.
    T = script.tips(chain, race.case.unseen)
    nominal = (race.case.base @ T @ np.append(race.case.tool, 1.0))[:, :3]
    assert script.held_out(nominal, race.measured) > 20.0 * race.floor
    again = script.simulated(chain)
    assert np.array_equal(again.case.measured, race.case.measured)
    for told in race.case:
        assert told.shape != race.measured.shape or not np.allclose(told, race.measured, atol=1e-2)


LOADED_WITHIN_THE_WATCH = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import exchange
loaded = set()
class Watch(exchange.Stopwatch):
    def __enter__(self):
        self.before = set(sys.modules)
        return super().__enter__()
    def __exit__(self, *error):
        loaded.update(set(sys.modules) - self.before)
        return super().__exit__(*error)
exchange.Stopwatch = Watch
import run_ours
folder = Path(sys.argv[2])
run_ours.solve(exchange.load_case(folder), folder / exchange.ROBOT, sys.argv[3])
print(*sorted(loaded))
"""


@pytest.mark.parametrize("setting", ["geometry", "terms"])
def test_nothing_of_ours_is_loaded_within_the_watch(chain: Any, setting: str, tmp_path: Path) -> None:
    """Loading SciPy takes longer than the fit, and the page says that importing is not timed."""
    case = script.simulated(chain).case
    few = case._replace(readings=case.readings[:60], measured=case.measured[:60], sigma=case.sigma[:60])
    script.exchange.save_case(tmp_path, few)
    (tmp_path / script.exchange.ROBOT).write_bytes(resolve(script.URDF).read_bytes())
    command = [sys.executable, "-c", LOADED_WITHIN_THE_WATCH, str(script.PEERS), str(tmp_path), setting]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, cwd=script.ROOT)
    assert ran.stdout.split() == []


def test_the_judge_takes_the_3d_rms_in_mm() -> None:
    measured = np.zeros((4, 3))
    predicted = np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 5e-3]])
    assert script.held_out(predicted, measured) == pytest.approx(5.0 / np.sqrt(2.0))
    predicted[2, 1] = np.nan
    assert script.held_out(predicted, measured) == np.inf
    with pytest.raises(ValueError, match=r"\(3, 3\) positions are predicted and \(4, 3\) were measured"):
        script.held_out(predicted[:3], measured)


def test_a_line_is_the_median_of_the_runs_that_ended() -> None:
    found = line("figaroh", (4.0, 0.3), (-1.0, 0.0), (2.0, 0.1), (3.0, 0.2))
    assert (found.cpu, found.wall, found.error) == (3.0, 6.0, 0.2)
    assert not script.Line(found.entry, (failed(),)).done


def test_the_ratio_pairs_runs_that_were_made_in_turn() -> None:
    ours = line(script.OURS, (0.1, 0.1), (0.2, 0.1), (0.4, 0.1))
    peer = line("figaroh", (3.0, 0.1), (8.0, 0.1), (20.0, 0.1))
    assert script.ratio(peer, ours) == pytest.approx(40.0)
    assert script.ratio(line("pybotics", (50.0, 0.1)), ours) == pytest.approx(500.0)


def test_the_fastest_peer_counts_only_if_it_converged_at_the_floor() -> None:
    ours = line(script.OURS, (0.01, 0.0855))
    good, better = line("figaroh", (5.0, 0.0856)), line("robotkinecal", (2.0, 0.0857))
    off, early = line("pybotics", (1.0, 0.3)), line("robotkinecal", (1.0, 0.0856), converged=False)
    assert script.fastest_peer([ours, good, off, early, better], 0.085) is better
    assert script.fastest_peer([ours, off, early], 0.085) is None
    # Where no floor is known, the best of the peers stands for it.
    assert script.fastest_peer([ours, good, better, off], None) is better
    assert script.fastest_peer([ours, off], None) is off
    assert script.fastest_peer([ours], None) is None


def test_the_page_says_who_is_at_the_floor_how_many_times_longer_and_what_failed(chain: Any) -> None:
    race = script.simulated(chain)
    race = script.Race(race.name, race.title, race.case, race.measured, 0.085)
    lines = [
        line(script.OURS, (0.02, 0.0855)),
        line("robotkinecal", (1.0, 0.0856)),
        line("pybotics", (4.0, 0.3), converged=False),
        line("figaroh", (-1.0, 0.0)),
    ]
    text = script.page([(race, lines)], "a machine", 1, "figures/peers.svg")
    assert "| calib | `solve()` | **0.0855** | 0.020 | 0.040 |  | 27 | 1 |" in text
    assert "| robotkinecal | `solve()` | **0.0856** | 1.000 | 2.000 | 50.0 | 27 | 1 |" in text
    assert "| pybotics | `solve()` | 0.3000 | 4.000 | 8.000 | 200.0 | 27 | 1 |" in text
    assert "| figaroh | `solve()` | stopped after 10 min |  |  |  |  | 1 |" in text
    assert "robotkinecal (`solve()`), takes 50.0 times as long as calib**" in text
    assert "- pybotics, default: 4 steps; by its own test not converged." in text
    assert "- robotkinecal: numpy 1.2.3." in text
    assert "](figures/peers.svg)" in text
    columns = {row.count("|") for row in text.splitlines() if row.startswith("|")}
    assert columns == {9}
    without = script.page([(race, [lines[0], lines[3]])], "a machine", 1)
    assert "No peer reaches the floor; calib is at 0.0855 mm." in without


def test_runs_that_are_kept_are_read_again_from_several_files(tmp_path: Path) -> None:
    one, two = line("figaroh", (2.0, 0.1), (3.0, 0.2)).runs, line("pybotics", (-1.0, 0.0)).runs
    script.keep(tmp_path / "a.json", {"real, figaroh, map": list(one), "real, figaroh, none": []})
    script.keep(tmp_path / "b.json", {"real, pybotics, distances": list(two)})
    files = [tmp_path / "a.json", tmp_path / "b.json", tmp_path / "missing.json"]
    assert script.known_from(files) == {"real, figaroh, map": list(one), "real, pybotics, distances": list(two)}
