"""The race: figaroh, robotkinecal, pybotics and calib on the same data, side by side.

    python scripts/benchmarks/benchmark_peers.py [--environments FOLDER] [--dataset <ur10_leica folder>] [--runs 3]
        [--limit 600] [--only PROGRAM ...] [--results FILE ...] [--markdown FILE] [--figure FILE]

Each program gets an environment of its own (a venv in --environments, by default one in the folder for temporary files,
kept for the next time) with pinned versions from PyPI; calib runs in the environment of this script. Each is started
anew for every run as scripts/benchmarks/peers/run_<program>.py, one BLAS thread for all, and times its own solving,
reading excluded. It is told readings and positions, the nominal robot, and guesses of base and tool that are the same
for all; of the rows held out it sees the readings only. Its predictions there are judged here, by one function.

Two cases. Simulated: a UR10 whose links all deviate, by forward kinematics of this script's own, so that truth and
noise are known. Real: the UR10 and the laser tracker of scripts/examples/ur10_leica_job.py, a third of the rows held
out.
"""

import argparse
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import venv
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.robot.sources import resolve
from scripts.benchmarks.peers import exchange
from scripts.examples.ur10_leica_job import JOINTS, NotTheDatasetError, read

ROOT = Path(__file__).resolve().parents[2]
PEERS = Path(__file__).resolve().parent / "peers"

Array = NDArray[np.float64]

URDF = "example:ur_description/urdf/ur10_robot.urdf"
BASE_LINK = "base_link"
POSES, UNSEEN = 500, 1000
NOISE = 0.05e-3
SPREAD_LENGTH, SPREAD_ANGLE, SPREAD_ZERO = 0.5e-3, 1e-3, 5e-3
# A program reaches the floor when, converged by its own test, its predictions miss the rows held out by at most this
# many times what the truth itself misses them by. Where the truth is unknown, the best peer stands for it.
AT_THE_FLOOR = 1.05
# What takes longer than this is run once: its ratio does not hang on a few percent.
ONCE = 60.0
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")}

PINS = {
    "figaroh": ("figaroh==1.0.2", "pin==4.1.0", "numpy==2.4.6", "scipy==1.17.1"),
    "robotkinecal": (
        "robotkinecal==0.1.0",
        "roboticstoolbox-python==1.4.4",
        "spatialmath-python==1.1.18",
        "numpy==1.26.4",
        "scipy==1.17.1",
    ),
    "pybotics": ("pybotics==3.1.2", "numpy==1.26.4", "scipy==1.17.1"),
}
OURS = "calib"


class Entry(NamedTuple):
    """One program with one of its settings; ``means`` says it to the reader. What is ``extra`` takes no part."""

    program: str
    setting: str
    means: str
    extra: bool = False
    simulated: bool = True


ENTRIES = (
    Entry(OURS, "geometry", "all placements and joint offsets"),
    Entry(OURS, "terms", "with joint terms, the choice of them timed too", extra=True, simulated=False),
    Entry("robotkinecal", "default", "`solve()`"),
    Entry("robotkinecal", "two steps", "`solve(max_iterations=2)`, before its test of convergence"),
    Entry("figaroh", "structural", "`estimation.method: structural`, its default"),
    Entry("figaroh", "excitation", "`estimation.method: excitation`"),
    Entry("figaroh", "map", "`estimation.method: map`"),
    Entry("pybotics", "vectors", "differences of positions in place of its distances"),
    Entry("pybotics", "distances", "`optimize_accuracy`, as in its example"),
)


# ---- the simulated machine: forward kinematics of its own


class Joint(NamedTuple):
    """A joint of the way from base to tip: ``origin`` (4, 4), and the axis (3,) it turns about, or None if fixed."""

    name: str
    origin: Array
    axis: Array | None


def chain_of(urdf: str, base: str, tip: str) -> tuple[Joint, ...]:
    """Return the joints of a URDF text from link ``base`` to link ``tip``."""
    by_child = {}
    for element in ET.fromstring(urdf).findall("joint"):  # noqa: S314 - the file of a package, not of a user
        child, parent, origin = element.find("child"), element.find("parent"), element.find("origin")
        assert child is not None and parent is not None
        xyz, rpy = ((origin.get(key) if origin is not None else None) or "0 0 0" for key in ("xyz", "rpy"))
        axis = element.find("axis")
        turns = None if element.get("type") == "fixed" or axis is None else numbers(axis.get("xyz", "1 0 0"))
        placement = pose(Rotation.from_euler("xyz", numbers(rpy)).as_matrix(), numbers(xyz))
        by_child[child.get("link")] = (parent.get("link"), Joint(str(element.get("name")), placement, turns))
    joints, link = [], tip
    while link != base:
        link, joint = by_child[link]
        joints.append(joint)
    return tuple(reversed(joints))


def numbers(text: str) -> Array:
    return np.array([float(part) for part in text.split()])


def pose(R: Array, t: Array) -> Array:
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def tips(chain: Sequence[Joint], readings: Array) -> Array:
    """Return the placements (n, 4, 4) of the tip in the base link at readings (n, moving joints)."""
    T, k = np.tile(np.eye(4), (len(readings), 1, 1)), 0
    for joint in chain:
        T = T @ joint.origin
        if joint.axis is not None:
            T = T @ pose(Rotation.from_rotvec(readings[:, k, None] * joint.axis).as_matrix(), np.zeros(3))
            k += 1
    return np.asarray(T)


def axes(chain: Sequence[Joint]) -> tuple[Array, Array, Array]:
    """Return points and directions (k, 3) of the moving axes at zero, and the tip (4, 4) there, in the base link."""
    T, points, directions = np.eye(4), [], []
    for joint in chain:
        T = T @ joint.origin
        if joint.axis is not None:
            points.append(T[:3, 3])
            directions.append(T[:3, :3] @ joint.axis)
    return np.array(points), np.array(directions), T


def deviating(chain: Sequence[Joint], rng: np.random.Generator) -> tuple[Joint, ...]:
    """Return a machine of this make: every link a little other than drawn."""
    return tuple(
        joint._replace(
            origin=joint.origin
            @ pose(
                Rotation.from_rotvec(rng.normal(scale=SPREAD_ANGLE, size=3)).as_matrix(),
                rng.normal(scale=SPREAD_LENGTH, size=3),
            )
        )
        for joint in chain
    )


def guess(T: Array, measured: Array) -> tuple[Array, Array]:
    """Return base (4, 4) and tool point (3,) that fit nominal tips T (n, 4, 4) to positions (n, 3), by turns.

    The rotation for a given tool by Kabsch's formula, then tool and origin for a given rotation by linear least
    squares, until nothing moves.
    """
    tool, base = np.zeros(3), np.eye(4)
    for _ in range(500):
        points = T[:, :3, 3] + T[:, :3, :3] @ tool
        one, other = points - points.mean(axis=0), measured - measured.mean(axis=0)
        R = Rotation.align_vectors(other, one)[0].as_matrix()
        A = np.concatenate([R @ T[:, :3, :3], np.tile(np.eye(3), (len(T), 1, 1))], axis=2).reshape(-1, 6)
        found = np.linalg.lstsq(A, (measured - T[:, :3, 3] @ R.T).ravel(), rcond=1e-6)[0]
        moved = float(np.linalg.norm(found[:3] - tool))
        tool, base = found[:3], pose(R, found[3:])
        if moved < 1e-7:
            break
    return base, tool


# ---- cases


@dataclass(frozen=True, eq=False)
class Race:
    """A case, and what only the judge knows: positions (m, 3) measured at the unseen readings.

    ``floor``: by how much the truth misses them, in mm; None where nobody knows it.
    """

    name: str
    title: str
    case: exchange.Case
    measured: Array
    floor: float | None = None


def posed(chain: Sequence[Joint], readings: Array, measured: Array, sigma: Array, unseen: Array) -> exchange.Case:
    points, directions, home = axes(chain)
    base, tool = guess(tips(chain, readings), measured)
    return exchange.Case(readings, measured, sigma, unseen, base, tool, points, directions, home)


def simulated(chain: Sequence[Joint]) -> Race:
    rng = np.random.default_rng(1)
    machine = deviating(chain, rng)
    zeros = rng.normal(scale=SPREAD_ZERO, size=6)
    base = pose(Rotation.from_rotvec(rng.uniform(-2.0, 2.0, 3)).as_matrix(), rng.uniform(-3.0, 3.0, 3))
    tool = np.array([0.05, 0.02, 0.15, 1.0])
    readings = rng.uniform(-np.pi, np.pi, (POSES + UNSEEN, 6))
    true = (base @ tips(machine, readings + zeros) @ tool)[:, :3]
    measured = true + rng.normal(scale=NOISE, size=true.shape)
    sigma = np.full((POSES, 3), NOISE)
    case = posed(chain, readings[:POSES], measured[:POSES], sigma, readings[POSES:])
    title = f"Simulated UR10, {POSES} positions, {UNSEEN} held out"
    return Race("simulated", title, case, measured[POSES:], held_out(true[POSES:], measured[POSES:]))


def real(chain: Sequence[Joint], dataset: Path) -> Race:
    columns = read(dataset)
    readings = np.column_stack([columns[name] for name in JOINTS])
    measured, sigma = (
        1e-3 * np.column_stack([columns[f"measurement_{kind}{a}"] for a in "xyz"]) for kind in ("", "std_")
    )
    order = np.random.default_rng(0).permutation(len(readings))
    test, seen = order[: len(order) // 3], order[len(order) // 3 :]
    case = posed(chain, readings[seen], measured[seen], sigma[seen], readings[test])
    title = f"Real UR10 and laser tracker, {len(seen)} positions, {len(test)} held out"
    return Race("real", title, case, measured[test])


# ---- the judge


def held_out(predicted: Array, measured: Array) -> float:
    """Return the 3D rms in mm between predicted and measured positions (m, 3) in m; inf where one is not a number."""
    if predicted.shape != measured.shape:
        raise ValueError(f"{predicted.shape} positions are predicted and {measured.shape} were measured")
    squares = np.sum((predicted - measured) ** 2, axis=1)
    return 1e3 * float(np.sqrt(np.mean(squares))) if np.all(np.isfinite(squares)) else float("inf")


@dataclass(frozen=True)
class Run:
    """One run: seconds, error in mm; or ``failure``."""

    wall: float = 0.0
    cpu: float = 0.0
    error: float = float("inf")
    parameters: int = 0
    converged: bool = False
    said: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    failure: str = ""


@dataclass(frozen=True)
class Line:
    """All runs of one entry in one case, as medians."""

    entry: Entry
    runs: tuple[Run, ...]

    @property
    def done(self) -> tuple[Run, ...]:
        return tuple(run for run in self.runs if not run.failure)

    @property
    def cpu(self) -> float:
        return median(run.cpu for run in self.done) if self.done else float("nan")

    @property
    def wall(self) -> float:
        return median(run.wall for run in self.done) if self.done else float("nan")

    @property
    def error(self) -> float:
        return median(run.error for run in self.done) if self.done else float("inf")


def reaches(line: Line, floor: float) -> bool:
    """Return whether a line's runs have converged, and as near to the floor (mm) as counts."""
    return bool(line.done) and all(run.converged for run in line.done) and line.error <= AT_THE_FLOOR * floor


def of_peers(lines: Sequence[Line]) -> tuple[Line, ...]:
    return tuple(line for line in lines if line.entry.program != OURS and line.done)


def ours_of(lines: Sequence[Line]) -> Line | None:
    """Return our line that takes part; the others are extra."""
    return next((line for line in lines if line.entry.program == OURS and not line.entry.extra and line.done), None)


def fastest_peer(lines: Sequence[Line], floor: float | None) -> Line | None:
    """Return the fastest peer that reaches the floor (mm), for which, where it is unknown, the best peer stands."""
    if floor is None:
        floor = min((line.error for line in of_peers(lines)), default=0.0)
    return min((line for line in of_peers(lines) if reaches(line, floor)), key=lambda line: line.cpu, default=None)


def ratio(line: Line, ours: Line) -> float:
    """Return how many times longer a line takes than ours, in process time: the median over pairs of runs, in turn."""
    return median(a.cpu / b.cpu for a, b in zip(line.done, ours.done, strict=False))


# ---- running

Known = dict[str, list[Run]]


def key(race: Race, entry: Entry) -> str:
    return f"{race.name}, {entry.program}, {entry.setting}"


def known_from(files: Sequence[Path]) -> Known:
    """Return the runs that files hold; one that is not there holds none."""
    found: Known = {}
    for file in files:
        if file.is_file():
            for name, runs in json.loads(file.read_text(encoding="utf-8")).items():
                found.setdefault(name, []).extend(Run(**one) for one in runs)
    return found


def keep(file: Path, known: Known) -> None:
    records = {name: [asdict(one) for one in runs] for name, runs in known.items() if runs}
    file.write_text(json.dumps(records, indent=1), encoding="utf-8")


def interpreter(program: str, environments: Path) -> Path:
    """Return the interpreter of a program's environment, which is made if it is not there."""
    if program == OURS:
        return Path(sys.executable)
    home, pins = environments / program, "\n".join(PINS[program])
    python, complete = home / "bin" / "python", home / "complete.txt"
    if not complete.is_file() or complete.read_text(encoding="utf-8") != pins:
        print(f"installing {', '.join(PINS[program])}", flush=True)
        venv.create(home, with_pip=True, clear=True)
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *PINS[program]], check=True)
        complete.write_text(pins, encoding="utf-8")
    return python


def run(entry: Entry, python: Path, folder: Path, race: Race, limit: float) -> Run:
    """Start one program once, in a process of its own, and judge what it predicts."""
    name = "ours" if entry.program == OURS else entry.program
    stem = folder / f"{entry.program}_{entry.setting.replace(' ', '_')}"
    command = [str(python), str(PEERS / f"run_{name}.py"), str(folder), entry.setting, str(stem)]
    environment = os.environ | ONE_THREAD | {"MPLBACKEND": "Agg"}
    if entry.program == OURS:
        environment["PYTHONPATH"] = str(ROOT)
    else:
        environment.pop("PYTHONPATH", None)
    ended = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, preexec_fn=lambda: hold(limit)
    )
    if -ended.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return Run(failure=f"stopped after {limit / 60.0:g} min of process time")
    if ended.returncode != 0:
        return Run(failure=f"ended with an error: {(ended.stderr.strip().splitlines() or ['no word'])[-1][:300]}")
    record = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    with np.load(stem.with_suffix(".npz")) as found:
        return Run(**record, error=held_out(found["predicted"], race.measured))


def hold(limit: float) -> None:
    """Let this process have no more than so many seconds on any core: a busy machine takes nothing from anybody."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))


def lines_of(
    race: Race, entries: Sequence[Entry], pythons: dict[str, Path], runs: int, limit: float, known: Known
) -> tuple[Line, ...]:
    """Run all entries of a case in turn, so that a busy machine slows all alike; what is ``known`` is not run again."""
    part = [entry for entry in entries if entry.simulated or race.name != "simulated"]
    found = {entry: known.setdefault(key(race, entry), []) for entry in part}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        exchange.save_case(folder, race.case)
        (folder / exchange.ROBOT).write_bytes(resolve(URDF).read_bytes())
        for k in range(runs):
            for entry, own in found.items():
                if k < len(own) or (own and (own[0].failure or own[0].cpu > ONCE)):
                    continue
                one = run(entry, pythons[entry.program], folder, race, limit)
                own.append(one)
                what = one.failure or f"{one.error:.4f} mm, {one.cpu:.3f} s of process, {one.wall:.3f} s of the clock"
                print(f"{race.name} {k + 1}/{runs}: {entry.program} {entry.setting}: {what}; {one.said}", flush=True)
    return tuple(Line(entry, tuple(own)) for entry, own in found.items())


# ---- the telling


PAGE = """# The race against the peers

Made by `python scripts/benchmarks/benchmark_peers.py --dataset <ur10_leica folder> --markdown docs/peers.md --figure
docs/figures/peers.svg` on {machine}; {runs} runs of each in turn, medians; what takes more than {once:g} s is run once.

Times are seconds of solving, measured inside each program's process, importing and reading excluded; every run in a
process just started, one BLAS thread for all. *Process* is processor time, and all ratios are of it; *clock* is what
passed meanwhile, whatever else the machine was doing. calib is timed with everything that `calib.identify` does: it
finds base and tool, the fit, its covariance, its rank, and what cannot be seen.

All are told the same rows, the same nominal robot, and the same guesses of base and tool, from a fit of the nominal
robot; calib and figaroh do not take them and are timed with finding their own. calib alone weighs rows by the
instrument's standard deviations, as no other program reads them. Errors are of rows held out, 3D rms in mm, computed
from predicted positions by one function of the script; no program is shown what was measured there. Bold: converged by
its own test and at the floor.
"""


def page(races: Sequence[tuple[Race, Sequence[Line]]], machine: str, runs: int, figure: str | None = None) -> str:
    """Return the page: a table for each case, what the ratio is, and what is to be said of each program."""
    parts = [PAGE.format(machine=machine, runs=runs, once=ONCE)]
    if figure is not None:
        parts.append(f"![Held-out error over solver time]({figure})\n")
    for race, lines in races:
        parts += [f"## {race.title}\n", preface(race), table(race, lines), verdict(race, lines), remarks(lines)]
    parts.append(versions([line for _, lines in races for line in lines]))
    return "\n".join(parts)


def preface(race: Race) -> str:
    if race.floor is None:
        return (
            "The rows of a random third are held out (`default_rng(0)`). What no model explains of a real robot is not "
            f"known: a peer counts when it is within {100 * (AT_THE_FLOOR - 1.0):.0f} % of the best of them. Many "
            "poses were visited twice, and the split parts some of these twins: that flatters models with many terms, "
            "not geometry.\n"
        )
    return (
        f"Every link of example-robot-data's UR10 is off by {1e3 * SPREAD_LENGTH:g} mm and {1e3 * SPREAD_ANGLE:g} mrad "
        f"in each direction, with joint offsets of {1e3 * SPREAD_ZERO:g} mrad (normal, seed 1), by forward kinematics "
        f"of the script's own; base and tool point unknown. Noise {1e3 * NOISE:g} mm a direction, on the rows held "
        f"out too: the truth itself misses them by {race.floor:.4f} mm. At the floor is who misses them by no more "
        f"than {AT_THE_FLOOR:g} times that.\n"
    )


def table(race: Race, lines: Sequence[Line]) -> str:
    heads = ("program", "setting", "held out, mm", "process, s", "clock, s", "times ours", "parameters", "runs")
    rows = [row(heads), "|---|---|" + "--:|" * 6, *(row(cells(line, ours_of(lines), race.floor)) for line in lines)]
    return "\n".join([*rows, ""])


def row(texts: Sequence[str]) -> str:
    return f"| {' | '.join(texts)} |"


def cells(line: Line, ours: Line | None, floor: float | None) -> tuple[str, ...]:
    head = (line.entry.program, line.entry.means)
    if not line.done:
        return (*head, line.runs[0].failure if line.runs else "not run", "", "", "", "", str(len(line.runs)))
    error = f"{line.error:.4f}"
    if floor is not None and reaches(line, floor):
        error = f"**{error}**"
    times = "" if ours is None or line is ours else f"{ratio(line, ours):.1f}"
    seconds = (f"{line.cpu:.3f}", f"{line.wall:.3f}")
    return (*head, error, *seconds, times, str(line.done[0].parameters), str(len(line.runs)))


def verdict(race: Race, lines: Sequence[Line]) -> str:
    ours, peer = ours_of(lines), fastest_peer(lines, race.floor)
    if ours is None:
        return ""
    if peer is None:
        return f"No peer reaches the floor; calib is at {ours.error:.4f} mm.\n"
    what = "that reaches the floor" if race.floor is not None else "that is as good as the best of them"
    return (
        f"**The fastest peer {what}, {peer.entry.program} ({peer.entry.means}), takes {ratio(peer, ours):.1f} times as "
        f"long as calib**, and misses by {peer.error:.4f} mm, calib by {ours.error:.4f} mm."
        f"{''.join(map(beside, lines))}\n"
    )


def beside(line: Line) -> str:
    """Return what an extra line of ours is good for."""
    if not line.entry.extra or not line.done:
        return ""
    return f" {line.entry.program} {line.entry.means}, misses by {line.error:.4f} mm, in {line.cpu:.3g} s."


def remarks(lines: Sequence[Line]) -> str:
    """Return what each program said of its own first run, or how it failed."""
    told = [
        f"- {line.entry.program}, {line.entry.setting}: "
        f"{one.failure or one.said + ('' if one.converged else '; by its own test not converged')}."
        for line in lines
        for one in line.runs[:1]
    ]
    return "\n".join([*told, ""])


LIMITS = """## What each cannot do here

- robotkinecal takes every axis of a URDF for a z axis, which those of a UR10 are not: it is given a URDF of the same
  axes, written for it; its other way in, a `PoERobot`, ends in an IndexError. It has no unknown base: what the guess
  leaves of it goes into the axes. Steps are not held back, and where the data lack a direction it leaves out the last
  parameters. That two steps would do is known only afterwards: stopped there, it says that it has not converged.
- figaroh wants a subclass with a cost function, a configuration file and a table of its own form. Its default method
  chooses parameters for the tip itself, without regard to the unknown tool point, and so too few where that is off the
  last axis. `map_cv` and `cv_subset` fit many times over by cross-validation and are not run.
- pybotics has modified DH numbers only, and no URDF. They cannot say that parallel axes lean, and three of a UR10's are
  parallel. Its own function of errors is a distance: no sign, and not smooth where it vanishes, which is where the
  solution is.
"""


def versions(lines: Sequence[Line]) -> str:
    found: dict[str, dict[str, str]] = {}
    for line in lines:
        for one in line.done[:1]:
            found.setdefault(line.entry.program, one.versions)
    said = [f"- {name}: {', '.join(f'{k} {v}' for k, v in known.items())}." for name, known in found.items()]
    return "\n".join([LIMITS, "## Versions\n", *said, ""])


def machine_name() -> str:
    return f"{os.cpu_count()} cores of {platform.machine()}, Python {platform.python_version()}"


def draw(races: Sequence[tuple[Race, Sequence[Line]]], path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - only where a figure is asked for
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.ticker import FormatStrFormatter  # noqa: PLC0415

    mpl.rcParams["svg.hashsalt"] = "peers"
    colours = dict(zip((OURS, *PINS), ("C0", "C2", "C1", "C3"), strict=True))
    figure = Figure(figsize=(4.4 * len(races), 4.2), layout="constrained")
    for panel, (race, lines) in zip(figure.subplots(1, len(races), squeeze=False)[0], races, strict=True):
        panel.set(xscale="log", yscale="log", xlabel="process time to solve, s", ylabel="held-out error, mm")
        panel.set_title(race.title.split(",")[0])
        for line in lines:
            if line.done:
                colour = colours[line.entry.program]
                panel.plot(line.cpu, line.error, "s" if line.entry.program == OURS else "o", color=colour)
                name = f"   {line.entry.program}: {line.entry.setting}"
                panel.text(line.cpu, line.error, name, rotation=60, rotation_mode="anchor", fontsize=7, color=colour)
        if race.floor is not None:
            panel.axhline(race.floor, color="0.6", linewidth=0.8, linestyle="--")
        errors = [line.error for line in lines if line.done]
        panel.set_ylim(0.8 * min(errors), 3.0 * max(errors))
        panel.margins(x=0.2)
        panel.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        panel.yaxis.set_minor_formatter(FormatStrFormatter("%g"))
    figure.savefig(path, metadata={"Date": None})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(tempfile.gettempdir()) / "calib-peers"
    parser.add_argument("--environments", type=Path, default=default, help=f"where the venvs are (default: {default})")
    parser.add_argument(
        "--dataset", type=Path, help="ur10_leica folder (default: in CALIB_DATASETS; else simulated only)"
    )
    parser.add_argument("--runs", type=int, default=3, help="of each (default: 3)")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds of process time for a run (default: 600)")
    parser.add_argument(
        "--results",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="runs in these files are not made again; all are kept in the first",
    )
    parser.add_argument("--only", nargs="+", choices=(OURS, *PINS), help="run these programs only")
    parser.add_argument("--cases", nargs="+", choices=("simulated", "real"), default=["simulated", "real"])
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw error over time into FILE, as svg")
    arguments = parser.parse_args()

    dataset = arguments.dataset
    if dataset is None and "CALIB_DATASETS" in os.environ:
        dataset = Path(os.environ["CALIB_DATASETS"]) / "ur10_leica"
    chain = chain_of(resolve(URDF).read_text(encoding="utf-8"), BASE_LINK, exchange.TIP)
    races = [simulated(chain)] if "simulated" in arguments.cases else []
    if "real" in arguments.cases and dataset is not None:
        try:
            races.append(real(chain, dataset))
        except NotTheDatasetError as problem:
            print(problem, file=sys.stderr)
            return 1
    programs = arguments.only or (OURS, *PINS)
    entries = [entry for entry in ENTRIES if entry.program in programs]
    pythons = {program: interpreter(program, arguments.environments) for program in programs}
    known, found = known_from(arguments.results or []), []
    for race in races:
        found.append((race, lines_of(race, entries, pythons, arguments.runs, arguments.limit, known)))
        if arguments.results:
            keep(arguments.results[0], known)
    for race, lines in found:
        print(f"\n{race.title}\n\n{table(race, lines)}\n{verdict(race, lines)}")
    if arguments.figure is not None:
        draw(found, arguments.figure)
    if arguments.markdown is not None:
        figure = None
        if arguments.figure is not None:
            figure = Path(os.path.relpath(arguments.figure, arguments.markdown.parent)).as_posix()
        arguments.markdown.write_text(page(found, machine_name(), arguments.runs, figure), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
