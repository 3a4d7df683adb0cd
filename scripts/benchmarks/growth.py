"""How does the cost of identification grow with rows, joints, terms and tables? Each run in a process of its own.

    python scripts/benchmarks/growth.py [--markdown docs/growth.md] [--largest 1000000]

Seconds are the processor's, of `calib.identify` alone, since others may use the machine. The exponent of a row is that
of the power law through it and the row before: 1 is growth in proportion, 2 as the square. Of targets, see `scale.py`.
"""

import argparse
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from scripts.benchmarks.scale import SIGMA, columns, peak

PANDA, TIP = "example:panda_description/urdf/panda.urdf", "panda_link8"
OF_JOINTS, OF_TERMS, OF_TABLES = 2_000, 3_000, 10_000


@dataclass(frozen=True)
class Cost:
    """Of one run: processor seconds and evaluations; ``loaded`` is the peak in MiB before anything is identified."""

    size: int
    parameters: int
    seconds: float
    evaluations: int
    loaded: float
    peak: float

    @property
    def added(self) -> float:
        """MiB that identification takes on top of the data."""
        return self.peak - self.loaded


def of_rows(size: int) -> Cost:
    robot = calib.load_robot(PANDA, tip=TIP)
    return identified(size, robot, calib.error_model(robot, offsets="all", placements="all"), size)


def of_joints(size: int) -> Cost:
    robot = calib.load_robot(written(size), tip=f"link_{size}")
    return identified(size, robot, calib.error_model(robot, offsets="all", placements="all"), OF_JOINTS)


def of_terms(size: int) -> Cost:
    robot = calib.load_robot(PANDA, tip=TIP)
    orders = tuple(range(1, size // (2 * len(robot.readings)) + 1))
    terms = {"harmonics": "all", "harmonic_orders": orders}
    return identified(size, robot, calib.error_model(robot, offsets="all", placements="all", terms=terms), OF_TERMS)


def of_tables(size: int) -> Cost:
    robot = calib.load_robot(PANDA, tip=TIP)
    return identified(size, robot, calib.error_model(robot, offsets="all", placements="all"), OF_TABLES, tables=size)


def identified(size: int, robot: calib.Robot, model: calib.ErrorModel, rows: int, tables: int = 1) -> Cost:
    """What it costs to find a simulated machine from so many positions, in tables of equal lengths."""
    table = columns(robot, rows, "position")
    parts = [{name: part[k::tables] for name, part in table.items()} for k in range(tables)]
    del table
    data = [calib.read_measurements(part, robot, "position", sigma=SIGMA) for part in parts]
    del parts
    loaded, start = peak(), time.process_time()
    fit = calib.identify(model, data)
    seconds = time.process_time() - start
    if not fit.converged:
        raise SystemExit(f"{rows} rows in {tables} tables did not converge")
    return Cost(size, len(fit.parameters), seconds, fit.evaluations, loaded, peak())


def written(joints: int) -> str:
    """An arm of so many joints, each across the one before, 5 m long."""
    step = 5.0 / joints
    links = "".join(f'<link name="link_{k}"/>' for k in range(joints + 1))
    parts = "".join(
        f'<joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/><child link="link_{k}"/>'
        f'<origin xyz="{0.3 * step} 0.0 {step}" rpy="{math.pi / 2 * (-1) ** k} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>'
        for k in range(1, joints + 1)
    )
    path = Path(tempfile.mkdtemp()) / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{parts}</robot>', encoding="utf-8")
    return str(path)


@dataclass(frozen=True)
class Study:
    """What grows, over which sizes, and what stays."""

    what: str
    sizes: tuple[int, ...]
    of: Callable[[int], Cost]
    rest: str


STUDIES = {
    "rows": Study("rows", (10_000, 100_000, 1_000_000), of_rows, "a Panda"),
    "joints": Study("joints", (5, 10, 20, 40), of_joints, f"an arm of 5 m, {OF_JOINTS:,} rows"),
    "terms": Study("terms", (28, 126, 252, 504), of_terms, f"harmonics of a Panda, {OF_TERMS:,} rows"),
    "tables": Study("tables", (1, 10, 100), of_tables, f"a Panda, {OF_TABLES:,} rows in all"),
}

HEADINGS = ("what", "number", "parameters", "evaluations", "processor s", "exponent", "MiB added", "exponent")

PAGE = (
    "Made by `python scripts/benchmarks/growth.py --markdown docs/growth.md`, one BLAS thread, on {machine}, which "
    "others used at the same time: so seconds are the processor's, of `calib.identify` alone.",
    "One number grows at a time: {studies}. Of every arm all placements, offsets, base and tool are found from "
    "simulated positions, in a process of its own. MiB added: the peak of the whole process less what it was with the "
    "data in memory. The exponent is that of the power law through a row and the one before it: 0 is no growth, 1 "
    "growth in proportion, 2 as the square; less than 10 MiB have none. Evaluations are those of residual and "
    "Jacobian.",
    "So memory is not flat in rows: a million leave some numbers each, residuals among them, but no derivatives. "
    "Tables cost time each, however short. Targets are in [many targets](benchmark_targets.md), and whole commands in "
    "[many poses](benchmark_scale.md).",
)


def measured(study: str, size: int) -> Cost:
    """One cost, found in a process of its own."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    arguments = [sys.executable, __file__, "--one", study, str(size)]
    text = subprocess.run(arguments, env=environment, stdout=subprocess.PIPE, check=True, text=True).stdout
    return Cost(**json.loads(text.splitlines()[-1]))


def exponent(size: float, value: float, size_before: float, value_before: float) -> str:
    return f"{math.log(value / value_before) / math.log(size / size_before):.1f}"


def lines(study: Study, costs: list[Cost]) -> list[tuple[str, ...]]:
    found = list[tuple[str, ...]]()
    for k, cost in enumerate(costs):
        time_, memory = "", ""
        if k:
            before = costs[k - 1]
            time_ = exponent(cost.size, cost.seconds, before.size, before.seconds)
            if min(cost.added, before.added) > 0.0 and max(cost.added, before.added) >= 10.0:
                memory = exponent(cost.size, cost.added, before.size, before.added)
        numbers = f"{cost.size:,}", f"{cost.parameters}", f"{cost.evaluations}", f"{cost.seconds:,.1f}"
        found.append((study.what, *numbers, time_, f"{cost.added:,.0f}", memory))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to FILE")
    parser.add_argument("--largest", type=int, default=1_000_000, help="the most rows (default: 1000000)")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        study, size = arguments.one
        print(json.dumps(asdict(STUDIES[study].of(int(size)))))
        return 0
    rows = list[tuple[str, ...]]()
    for name, study in STUDIES.items():
        costs = [measured(name, size) for size in study.sizes if size <= arguments.largest]
        for line in (own := lines(study, costs)):
            print(" | ".join(line), flush=True)
        rows += own
    if arguments.markdown is not None:
        machine = f"{os.cpu_count()} cores of {platform.machine()}, Python {platform.python_version()}"
        studies = "; ".join(f"{study.what} ({study.rest})" for study in STUDIES.values())
        said = [
            textwrap.fill(part.format(machine=machine, studies=studies), 120, break_on_hyphens=False) for part in PAGE
        ]
        table = [HEADINGS, ("---", *["--:"] * (len(HEADINGS) - 1)), *rows]
        text = "\n".join(f"| {' | '.join(line)} |" for line in table)
        arguments.markdown.write_text("\n\n".join(["# Growth", *said, text + "\n"]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
