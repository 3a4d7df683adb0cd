"""What scripts/benchmarks/benchmark_peers.py and the programs that it races hand to each other: plain files.

A runner is started by its own interpreter as ``run_<program>.py <case folder> <setting> <stem>``. It reads case.npz and
robot.urdf, solves, and leaves ``<stem>.npz`` with the positions it predicts at poses it has not seen, and
``<stem>.json`` with its times and what it says of itself. It is never shown what was measured there. NumPy and the
standard library only: this runs in every environment.
"""

import gc
import json
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

Array = Any  # the environments have different versions of NumPy, and so of its types

CASE, ROBOT = "case.npz", "robot.urdf"
TIP = "tool0"


class Case(NamedTuple):
    """What every program is told, in m and rad, and all that it is told.

    ``readings`` (n, 6), ``measured`` (n, 3) in the instrument's frame, ``sigma`` (n, 3) of the instrument; ``unseen``
    (m, 6): readings to predict. ``base`` (4, 4) of the robot's base in the instrument's frame and ``tool`` (3,) in the
    tip link: guesses. ``points`` and ``directions`` (6, 3): the nominal axes at zero, in the base link; ``home``
    (4, 4): the nominal tip at zero.
    """

    readings: Array
    measured: Array
    sigma: Array
    unseen: Array
    base: Array
    tool: Array
    points: Array
    directions: Array
    home: Array


class Stopwatch:
    """Seconds of the clock, and of this process on all cores together.

    What importing has left in memory is set aside first, so that collecting it falls into nobody's time.
    """

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0

    def __enter__(self) -> "Stopwatch":
        gc.collect()
        gc.freeze()
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.wall, self.cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu


class Solved(NamedTuple):
    """What a runner found: positions (m, 3) at the unseen readings, in the instrument's frame; how long it took.

    ``parameters``: how many numbers were free in the end. ``converged``: by the program's own test. ``said``: what else
    there is to say, in its own words or in numbers of its own.
    """

    predicted: Array
    watch: Stopwatch
    parameters: int
    converged: bool
    said: str = ""


def save_case(folder: Path, case: Case) -> None:
    np.savez(folder / CASE, **case._asdict())


def load_case(folder: Path) -> Case:
    with np.load(folder / CASE) as found:
        return Case(**{name: found[name] for name in Case._fields})


def run(solve: Callable[[Case, Path, str], Solved], packages: Iterable[str]) -> None:
    """Be the main function of a runner: ``solve`` is given the case, the robot's file and the setting."""
    folder, setting, stem = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    solved = solve(load_case(folder), folder / ROBOT, setting)
    np.savez(stem.with_suffix(".npz"), predicted=solved.predicted)
    record = {
        "wall": solved.watch.wall,
        "cpu": solved.watch.cpu,
        "parameters": solved.parameters,
        "converged": solved.converged,
        "said": solved.said,
        "versions": {name: version(name) for name in packages},
    }
    stem.with_suffix(".json").write_text(json.dumps(record), encoding="utf-8")
