"""Where do users wait? Processor time of whole commands, before and after a change of the program.

    python scripts/benchmarks/commands.py [--before FOLDER] [--only NAME ...] [--repeats 3] [--markdown FILE]

The commands are run with this project, and in turn with another checkout of it, for example ``git worktree add FOLDER
COMMIT``; the table tells where both do not print the same. Jobs are the shipped IRB2400 with every second row, and a
simulated UR10. The table has medians of the repeats. Modules are compiled beforehand.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.benchmarks.start import CALIB, JOB, URDF, simulated

HERE = Path(__file__).resolve().parents[2]
PAGE = """# Where users wait

Made by `python scripts/benchmarks/commands.py{arguments} --markdown docs/benchmark_commands.md`, one BLAS thread, on a
machine that others used at the same time. Seconds are the processor's, of whole processes: of each the median of so
many runs: {repeats}.{before}

The last two lines are what they need before they begin, and no less would do: what is loaded of NumPy and Pinocchio by
those that look at a robot or a result, and of SciPy, too, by those that fit.

"""
BEFORE = """ Before: a checkout of {date}. Where a command of both does not print the same, what it chooses or
tells has changed since then."""
LOADED = "import numpy, pinocchio"
LOADED_TO_FIT = "import numpy, scipy.linalg, scipy.special, pinocchio"
SAID = {
    "models": "`calib models`, an IRB2400 with a closed loop, 102 rows",
    "uncertainty": "`calib uncertainty` of its result",
    "sensitivity": "`calib sensitivity` of its job",
    "plan 1000": "`calib plan`, 40 of 1000 poses of a UR10, collisions too",
    "plan 10000": "`calib plan`, 40 of 10,000",
    "auto": '`calib calibrate`, `terms = "auto"`, 3000 rows of a UR10',
    "loaded": f"`{LOADED}`",
    "loaded to fit": f"`{LOADED_TO_FIT}`",
}


def halved(folder: Path) -> Path:
    """Write the shipped job with every second of its rows, and return it."""
    shipped = HERE / "robots" / "irb2400"
    for file in (*shipped.glob("*.csv"), shipped / "calibration.toml", shipped / "irb2400.urdf"):
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        if file.name in ("level1.csv", "level2.csv"):
            comments = [line for line in lines if line.startswith("#")]
            heading, *rows = [line for line in lines if not line.startswith("#")]
            lines = [*comments, heading, *rows[::2]]
        (folder / file.name).write_text("".join(lines), encoding="utf-8")
    return folder / "calibration.toml"


def run(compiled: Path, tree: Path, code: str, *arguments: str) -> tuple[float, str]:
    """Return the processor time of a process and its children, and what it printed; modules are ``compiled`` there."""
    settings = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(tree),
        "PYTHONPYCACHEPREFIX": str(compiled),
        # Else libraries, of which nothing is there yet, are compiled anew by every process.
        "PYTHONDONTWRITEBYTECODE": "",
    }
    before = os.times()
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=settings, cwd=tree, capture_output=True, text=True, check=False
    )
    after = os.times()
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments) or code} failed: {done.stderr.strip()}")
    return after.children_user + after.children_system - before.children_user - before.children_system, done.stdout


def compile_modules(compiled: Path, tree: Path) -> None:
    """Compile the modules of a tree once, as an installation does."""
    settings = {**os.environ, "PYTHONPYCACHEPREFIX": str(compiled)}
    modules = [str(tree / "calib"), str(tree / "calib_start")]
    subprocess.run([sys.executable, "-m", "compileall", "-q", *modules], env=settings, check=True)


def works(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the code of every process, with its arguments; files are in a folder."""
    (folder / "irb2400").mkdir()
    job = str(halved(folder / "irb2400"))
    run(folder / "compiled", HERE, CALIB, "calibrate", job, "-o", str(folder / "result"))
    (folder / "identification.csv").write_text(simulated(3000), encoding="utf-8")
    auto = folder / "auto.toml"
    auto.write_text(JOB.replace('tool = "position"\n', 'tool = "position"\nterms = "auto"\n'), encoding="utf-8")
    plan = (CALIB, "plan", URDF, "--tip", "tool0", "-o", str(folder / "out" / "plan.csv"))
    return {
        "models": (CALIB, "models", job),
        "uncertainty": (CALIB, "uncertainty", str(folder / "result")),
        "sensitivity": (CALIB, "sensitivity", job),
        "plan 1000": plan,
        "plan 10000": (*plan, "--candidates", "10000"),
        "auto": (CALIB, "calibrate", str(auto), "-o", str(folder / "out")),
        "loaded": (LOADED,),
        "loaded to fit": (LOADED_TO_FIT,),
    }


def date_of(tree: Path) -> str:
    """Return the date of what is checked out in a tree."""
    told = ["git", "-C", str(tree), "log", "-1", "--format=%cd", "--date=short"]
    return subprocess.run(told, capture_output=True, text=True, check=True).stdout.strip()


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, metavar="FOLDER", help="another checkout of the project")
    parser.add_argument("--only", nargs="+", choices=SAID, metavar="NAME", help=f"some of {', '.join(SAID)}")
    parser.add_argument("--repeats", type=int, default=3, help="how often each command is run (default: 3)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table to FILE")
    given = parser.parse_args()
    trees = [*([given.before.resolve()] if given.before else []), HERE]
    rows = []
    with tempfile.TemporaryDirectory() as name:
        for tree in trees:
            compile_modules(Path(name) / "compiled", tree)
        for what, arguments in works(Path(name)).items():
            if given.only and what not in given.only:
                continue
            times: list[list[float]] = [[] for _ in trees]
            for _ in range(given.repeats):
                printed = []
                for tree, found in zip(trees, times, strict=True):
                    shutil.rmtree(Path(name) / "out", ignore_errors=True)
                    (Path(name) / "out").mkdir()
                    seconds, text = run(Path(name) / "compiled", tree, *arguments)
                    found.append(seconds)
                    printed.append(text)
            medians = [statistics.median(found) for found in times]
            cells = [f"{median:.1f}" for median in medians]
            if len(trees) > 1:
                cells += [f"{medians[-1] / medians[0]:.2f}", "yes" if len(set(printed)) == 1 else "no"]
            rows.append(f"| {SAID[what]} | {' | '.join(cells)} |")
            print(rows[-1], flush=True)
    if given.markdown is not None:
        heading = ["before [s]", "now [s]", "now / before", "prints the same"] if len(trees) > 1 else ["s"]
        lines = [f"| command | {' | '.join(heading)} |", f"| --- |{' --: |' * len(heading)}", *rows, ""]
        arguments = " --before FOLDER" if given.before else ""
        before = BEFORE.format(date=date_of(given.before)) if given.before else ""
        page = PAGE.format(arguments=arguments, repeats=given.repeats, before=before) + "\n".join(lines)
        given.markdown.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
