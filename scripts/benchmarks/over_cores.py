"""Would it pay to spread the rows of one identification over cores? What its evaluations take, in one process and more.

    python scripts/benchmarks/over_cores.py [--jobs 2] [--largest 1000000] [--markdown docs/benchmark_cores.md]

An identification evaluates residual and Jacobian some times, and reduces them to a triangle; that is nearly all of its
time. Rows can be parted for that: every process reduces its own, and the triangles are put on top of each other. Each
process of joblib is given its rows once, in a file. Seconds are those of a clock: nobody else should use the machine.
"""

import argparse
import os
import pickle
import platform
import sys
import tempfile
import textwrap
import time
from functools import lru_cache
from pathlib import Path

import joblib
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.foundations import linear
from calib.identification.system import Problem
from scripts.benchmarks.benchmark import Case, case

Array = NDArray[np.float64]

SIZES = (10_000, 100_000, 1_000_000)
# Of an identification: those of the nominal machine with its base and tool, and those of the whole.
EVALUATIONS = 7

PAGE = (
    "Made by `python scripts/benchmarks/over_cores.py --markdown docs/benchmark_cores.md`, on {machine}, which nobody "
    "else used.",
    "One identification runs in one process. Its rows could be parted: every process evaluates residual and Jacobian "
    "of its own rows and reduces them to a triangle, and the triangles are put on top of each other. This page tells "
    "what that would bring to positions of a UR10 of which all is free: seconds of {evaluations} evaluations, as many "
    "as an identification needs, in one process, and by joblib in {jobs}, with one BLAS thread each. To start these, "
    "and to send them their rows once, is counted.",
    "So many rows are rare, and rows of a stream that are close in time tell little more than one of them "
    "([clocks](clocks.md)). The toolkit therefore leaves cores to jobs: [`calib fleet`](fleet.md) runs one in each.",
)
HEADINGS = ("rows", "one process s", "{jobs} processes s", "ratio")


@lru_cache(maxsize=1)
def held(file: str) -> Problem:
    """The part of a problem that a process was given."""
    with Path(file).open("rb") as stream:
        found: Problem = pickle.load(stream)
    return found


def reduced(problem: Problem, x: Array) -> Array:
    """Return ``[J r]`` of a problem's rows as a triangle."""
    with linear.one_thread():
        return problem.evaluate([data.sigma for data in problem.measurements], x).triangles[0]


def of_part(file: str, x: Array) -> Array:
    """Return :func:`reduced` of the rows in a file."""
    return reduced(held(file), x)


def in_one(problem: Problem, x: Array) -> Array:
    """Evaluate as often as an identification does."""
    for _ in range(EVALUATIONS):
        found = reduced(problem, x)
    return found


def in_several(problem: Problem, x: Array, jobs: int) -> Array:
    """Do it in processes that are started for that, each with every so manieth row."""
    # By the module's name: joblib sends what stands in a script by value, and then nothing is held between calls.
    from scripts.benchmarks.over_cores import of_part  # noqa: PLC0415

    (data,) = problem.measurements
    with tempfile.TemporaryDirectory() as folder, joblib.Parallel(n_jobs=jobs) as workers:
        files = [Path(folder, f"{k}.pickle") for k in range(jobs)]
        for k, file in enumerate(files):
            own = data.subset(np.arange(k, len(data), jobs))
            part = Problem(problem.model, problem.parameters, problem.reference, (own,))
            file.write_bytes(pickle.dumps(part, protocol=5))
        for _ in range(EVALUATIONS):
            parts = workers(joblib.delayed(of_part)(str(file), x) for file in files)
            found = linear.triangle(np.concatenate(parts))
    return found


def seconds(c: Case, jobs: int) -> tuple[float, float]:
    """Return what both take; that their answers are the same is held."""
    few = c.data.subset(np.arange(1000))
    fit = calib.identify(c.model, few)
    problem = Problem(c.model, fit.parameters, fit.nominal.frames, (c.data,))
    start = time.perf_counter()
    one = in_one(problem, fit.values)
    between = time.perf_counter()
    several = in_several(problem, fit.values, jobs)
    end = time.perf_counter()
    if not np.allclose(one.T @ one, several.T @ several, rtol=1e-9, atol=1e-9 * np.max(np.abs(one.T @ one))):
        raise SystemExit("rows that are parted give another triangle")
    return between - start, end - between


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="how many processes (default: 2)")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help=f"the most rows (default: {SIZES[-1]})")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to FILE")
    arguments = parser.parse_args()
    rows = list[tuple[str, ...]]()
    for size in (n for n in SIZES if n <= arguments.largest):
        one, several = seconds(case(size, "position"), arguments.jobs)
        # The next size starts its processes anew.
        joblib.externals.loky.get_reusable_executor().shutdown(wait=True)
        rows.append((f"{size:,}", f"{one:.1f}", f"{several:.1f}", f"{several / one:.2f}"))
        print(" | ".join(rows[-1]), flush=True)
    if arguments.markdown is not None:
        machine = f"{os.cpu_count()} cores of {platform.machine()}, Python {platform.python_version()}"
        numbers = {"machine": machine, "jobs": arguments.jobs, "evaluations": EVALUATIONS}
        said = [textwrap.fill(part.format(**numbers), 120, break_on_hyphens=False) for part in PAGE]
        headings = [heading.format(jobs=arguments.jobs) for heading in HEADINGS]
        table = [headings, ["--:"] * len(HEADINGS), *rows]
        text = "\n".join(f"| {' | '.join(line)} |" for line in table)
        page = "\n\n".join(["# Rows over cores", *said, text + "\n"])
        arguments.markdown.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
