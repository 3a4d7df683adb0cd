"""Does calib find the right machine? Random sessions of known truth, judged by an independent search from the truth.

    python scripts/development/judge_solver.py [--cases 1000] [--seed 0] [--only ur5] [--jobs 2]
        [--out judged.csv] [--hold weak]

A session is right where its cost is no higher than the independent one's by more than 1e-6 of it (of sockets 1e-4),
and the tool at 200 new poses no farther from the truth by more than 5 %; or where it is refused and its numbers are
no more than the formal rank. ``--hold``: "stated" judges the sum of squares in which what has no prior is held by a
stated width; "weak" judges that of the data, for solvers that choose among equal fits in another way. One row a
session goes to ``--out``, a summary in Markdown to the standard output. Cases are numbered: number 17 of a family is
the same session in every run with the seed, so that ``--cases 1 --first 17 --only ur5`` repeats it.
"""

import argparse
import csv
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

# Two threads make such small systems many times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from scripts.development.judge_cases import FAMILIES, case
from scripts.development.judge_verdict import Holding, Verdict, judge

# A machine is far from the truth where its error is so many times the one that is to be had.
FAR = 1.5


def one(task: tuple[int, str, Holding]) -> tuple[Verdict, dict[str, object]]:
    """Judge the session of a seed."""
    seed, family, holding = task
    session = case(seed, family)
    return judge(session, holding), dict(session.label)


def every(tasks: Sequence[tuple[int, str, Holding]], jobs: int) -> Iterator[tuple[Verdict, dict[str, object]]]:
    """Judge all sessions, in order."""
    if jobs == 1:
        yield from map(one, tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(one, tasks, chunksize=1)


def summary(verdicts: Sequence[Verdict]) -> str:
    """A table of families in Markdown."""
    kinds = ("cost", "tool", "cost and tool", "other minimum", "refused wrongly", "failed")
    heads = (
        *("family", "cases", "right", "refused rightly", *kinds, "of these at a minimum", "far", "not converged"),
        *("evaluations: median, 90 %, most", "cost over independent: most", "error over independent: median, most"),
    )
    lines = [f"| {' | '.join(heads)} |", "|---|" + "--:|" * (len(heads) - 1)]
    names = list(dict.fromkeys(v.family for v in verdicts))
    for name in [*names, *(["all"] if len(names) > 1 else [])]:
        own = [v for v in verdicts if name in (v.family, "all")]
        solved = [v for v in own if v.evaluations is not None]
        evaluations = np.array([v.evaluations for v in solved] or [0])
        ratios = np.array([v.error / v.independent_error for v in solved] or [np.nan])
        costs = np.array([(v.cost - v.independent_cost) / max(v.independent_cost, 1.0) for v in solved] or [np.nan])
        cells = (
            *(name, len(own), sum(v.outcome == "right" for v in own), sum(v.outcome == "refused" for v in own)),
            *(sum(v.outcome == kind for v in own) for kind in kinds),
            *(sum(v.stuck for v in own), int(np.sum(ratios > FAR)), sum(not v.converged for v in solved)),
            f"{np.median(evaluations):.0f}, {np.quantile(evaluations, 0.9):.0f}, {evaluations.max()}",
            f"{costs.max():+.1e}",
            f"{np.median(ratios):.3f}, {ratios.max():.3g}",
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="of all families together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of every family")
    parser.add_argument("--only", action="append", choices=list(FAMILIES))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--hold", choices=("stated", "weak"), default="stated")
    parser.add_argument("--out", type=Path, default=Path("judged.csv"))
    arguments = parser.parse_args()
    families = arguments.only or list(FAMILIES)
    tasks = [
        (arguments.seed * 1_000_000 + arguments.first + k // len(families), families[k % len(families)], arguments.hold)
        for k in range(arguments.cases)
    ]
    found: list[Verdict] = []
    with arguments.out.open("w", encoding="utf-8", newline="") as file:
        writer: csv.DictWriter[str] | None = None
        for n, (verdict, label) in enumerate(every(tasks, arguments.jobs), 1):
            row = asdict(verdict) | {"label": "; ".join(f"{key} {value}" for key, value in label.items())}
            if writer is None:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            found.append(verdict)
            if not verdict.right:
                print(
                    f"\r{verdict.family} {verdict.seed}: {verdict.outcome}; cost {verdict.cost:.6g} against "
                    f"{verdict.independent_cost:.6g}, error {verdict.error:.4g} against "
                    f"{verdict.independent_error:.4g} mm, converged {verdict.converged}, {row['label']} {verdict.said}",
                    file=sys.stderr,
                )
            wrong = sum(not v.right for v in found)
            print(f"\r{n} of {len(tasks)}: {wrong} wrong ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(summary(found))
    return int(any(not v.right for v in found))


if __name__ == "__main__":
    sys.exit(main())
