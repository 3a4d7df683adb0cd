"""Kill the real command line at random moments, fill its disk and close its folders; look at what is left.

    python scripts/development/kill_runs.py --runs 50 --markdown docs/crashes.md

Every run calibrates anew into a folder that holds whole results of another job, so that old and new can be told apart,
until as many as asked for were killed before they ended.
It is killed (SIGKILL) at a random moment: of the whole run, or, every second time, of the moments in which it writes.
Then the folder is looked at as it stands, read by ``calib.load_machine``, which puts right what there is to be put
right, and written by a run that nobody disturbs. A run passes when the folder was the old one or the new one, whole,
inputs were untouched, and nothing is left beside it in the end. Full disks and read-only folders need root: they are
small mounts. Exit code 1 when anything does not pass.

Commands that write one file, or a folder of their own, are killed as often: at a random moment, in forks of this
process, which has loaded what they need. A file of somebody else with the name of a part stands beside. A kill passes
when the file is whole or not there, and the command, given again, writes it, or says that it is there already; then
nothing is beside it.
"""

import argparse
import collections
import contextlib
import hashlib
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import calib
from calib.cli import main as main_of_calib
from calib.foundations.files import write_atomically

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "arm_cmm"
FILES = ("calibration.toml", "arm_cmm.urdf", "identification.csv", "validation.csv")
BEGIN, END = "<!-- scripts/development/kill_runs.py -->", "<!-- end -->"
COMMAND = (sys.executable, "-c", "from calib.cli import main; main()")


def tree(folder: Path) -> dict[str, str]:
    """Return the hash of every file of a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False)


def calibrate(job: Path, out: Path) -> float:
    """Calibrate, and return how long it took in s."""
    start = time.monotonic()
    done = run("calibrate", job, "-o", out, "-q")
    if done.returncode:
        raise SystemExit(done.stderr)
    return time.monotonic() - start


def case(folder: Path) -> tuple[Path, Path]:
    """Make a case with two jobs of different results, and return them."""
    folder.mkdir()
    for name in FILES:
        shutil.copyfile(CASE / name, folder / name)
    text = (folder / FILES[0]).read_text(encoding="utf-8")
    other = folder / "other.toml"
    other.write_text(text.replace('offsets = "all"', 'offsets = ["joint_2", "joint_3"]'), encoding="utf-8")
    return folder / FILES[0], other


def half_written(out: Path) -> bool:
    return any(out.parent.glob(f".{out.name}.*.calib"))


def writing_takes(job: Path, out: Path) -> float:
    """Calibrate, and return how long the results were being written in s."""
    started = subprocess.Popen([*COMMAND, "calibrate", str(job), "-o", str(out), "-q"])
    while not half_written(out):
        time.sleep(0.0002)
    begun = time.monotonic()
    while half_written(out):
        time.sleep(0.0002)
    ended = time.monotonic()
    started.wait()
    return ended - begun


def kill(job: Path, out: Path, delay: float, *, as_it_writes: bool) -> bool:
    """Start a calibration and kill it after ``delay`` s, counted from when it begins to write or from its start."""
    started = subprocess.Popen(
        [*COMMAND, "calibrate", str(job), "-o", str(out), "-q"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while as_it_writes and started.poll() is None and not half_written(out):
        time.sleep(0.0002)
    until = time.monotonic() + delay
    while started.poll() is None and time.monotonic() < until:
        time.sleep(min(0.0005, delay))
    started.send_signal(signal.SIGKILL)
    return started.wait() == -signal.SIGKILL


def kills(folder: Path, runs: int, seed: int) -> tuple[list[tuple[str, ...]], int]:
    """Return the rows of the table, and how many runs passed."""
    job, other = case(folder / "case")
    place = folder / "results"
    out, first, second = (place / name for name in ("out", "first", "second"))
    took = max(calibrate(other, first), calibrate(job, second))
    old, new = tree(first), tree(second)
    longest = 1.2 * max(writing_takes(job, second) for _ in range(3))
    inputs = tree(folder / "case")
    for spare in (first, second):
        shutil.move(spare, folder / spare.name)
    rng = random.Random(seed)
    counted: collections.Counter[tuple[str, str, str, str]] = collections.Counter()
    passed = done = 0
    while done < runs:
        as_it_writes = done % 2 == 1
        shutil.rmtree(place)
        shutil.copytree(folder / "first", out)
        if not kill(job, out, rng.uniform(0.0, longest if as_it_writes else took), as_it_writes=as_it_writes):
            continue  # it had ended
        stood = {str(old): "old", str(new): "new", str({}): "aside"}.get(
            str(tree(out)) if out.exists() else "{}", "BROKEN"
        )
        beside = "yes" if any(entry != out for entry in place.iterdir()) else "no"
        calib.load_machine(out)
        whole = tree(out) in (old, new)
        calibrate(job, out)
        clean = tree(out) == new and list(place.iterdir()) == [out] and tree(folder / "case") == inputs
        passed += whole and clean and stood != "BROKEN"
        moment = "while writing" if as_it_writes else "of the whole run"
        done += 1
        counted[moment, stood, beside, "whole" if whole and clean else "BROKEN"] += 1
        print(f"\r{done} of {runs} kills, {passed} passed", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return [(*key, str(n)) for key, n in sorted(counted.items())], passed


def commands(case: Path, results: Path) -> dict[str, tuple[str, ...]]:
    """Return commands that write what is called ``x`` in their folder."""
    urdf, table, candidates = (str(case / name) for name in ("arm_cmm.urdf", "identification.csv", "positions.csv"))
    rows = Path(table).read_text(encoding="utf-8").splitlines()
    Path(candidates).write_text("x [mm],y [mm],z [mm]\n300,100,300\n250,150,350\n", encoding="utf-8")
    (case / "short.csv").write_text("\n".join(rows[:12]) + "\n", encoding="utf-8")
    return {
        "export": ("export", str(results), "--to", "ros", "-o", "x.yaml"),
        "compensate": ("compensate", str(results), candidates, "-o", "x.csv"),
        "init": ("init", urdf, table, "--tip", "probe", "-y", "-o", "x.toml"),
        "import": ("import", str(case / "short.csv"), "-o", "x.csv"),
        "dh": ("dh", urdf, "--tip", "probe", "-o", "x.csv"),
        "plan": ("plan", urdf, "--tip", "probe", "-n", "6", "--candidates", "40", "-o", "x.csv"),
        "board": ("board", "-o", "x"),
    }


def forked(command: Sequence[str], folder: Path) -> int:
    """Run a command in a fork of this process, within a folder; return the number of the process."""
    pid = os.fork()
    if pid == 0:
        os.chdir(folder)
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        code = 1
        try:
            code = called(command)
        finally:
            os._exit(code)
    return pid


def called(command: Sequence[str]) -> int:
    """Run a command in this process; return its exit code."""
    sys.argv = ["calib", *command]
    try:
        main_of_calib()
    except SystemExit as e:
        return e.code if isinstance(e.code, int) else 1
    return 0


def ended(pid: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def killed_commands(folder: Path, runs: int, seed: int) -> tuple[list[tuple[str, ...]], int]:
    """Return the rows of the table, and how many kills passed."""
    rng = random.Random(seed)
    job, _ = case(folder / "commands")
    results = folder / "results_of_commands"
    calibrate(job, results)
    counted: collections.Counter[tuple[str, str, str, str]] = collections.Counter()
    passed = 0
    for what, command in commands(folder / "commands", results).items():
        place = folder / what
        place.mkdir()
        with contextlib.chdir(place), contextlib.redirect_stdout(io.StringIO()):
            if (code := called(command)) != 0:  # here, so that all is loaded that the forks need
                raise SystemExit(f"{what} ended with {code}.")
        wanted = set(tree(place))
        shutil.rmtree(place)
        place.mkdir()
        start = time.monotonic()
        ended(forked(command, place))
        took = time.monotonic() - start
        theirs = f".{min(wanted).partition('/')[0]}.01234567.part"
        done = 0
        while done < runs:
            shutil.rmtree(place)
            place.mkdir()
            (place / theirs).write_text("theirs", encoding="utf-8")
            pid = forked(command, place)
            # As often while it ends, which is when it writes, as at any moment.
            time.sleep(took * (rng.uniform(0.0, 1.0) if done % 2 else rng.uniform(0.8, 1.1)))
            os.kill(pid, signal.SIGKILL)
            if ended(pid) != -signal.SIGKILL:
                took *= 0.95  # it had ended: the machine was busier when it was timed
                continue
            done += 1
            hidden = set(map(str, place.glob(".*"))) - {str(place / theirs)}
            shown = {name for name in tree(place) if not name.startswith(".")}
            stood = "whole" if shown == wanted else "not there" if not shown else "BROKEN"
            again = ended(forked(command, place))
            good = (
                stood != "BROKEN"
                and again in ((0, 1) if stood == "whole" else (0,))
                and set(tree(place)) == {*wanted, theirs}
                and set(place.glob(".*")) == {place / theirs}
                and (place / theirs).read_text(encoding="utf-8") == "theirs"
            )
            passed += good
            counted[what, stood, "yes" if hidden else "no", "whole" if good else "BROKEN"] += 1
        print(f"{what}: {took:.2f} s, {done} kills", file=sys.stderr)
    return [(*key, str(n)) for key, n in sorted(counted.items())], passed


def mounted(folder: Path, options: str) -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)


def disks(folder: Path) -> list[tuple[str, str, str]]:
    """Return what is said on a full disk and in read-only folders, and whether the old results outlived it."""
    job, other = case(folder / "disks")
    place = folder / "mounted"
    place.mkdir()
    out, rows = place / "out", []
    mounted(place, "size=8m")
    try:
        calibrate(other, out)
        old = tree(out)
        (place / "filler").write_bytes(b"0" * (shutil.disk_usage(place).free - 500_000))
        for what, options in (("full disk", None), ("read-only disk", "remount,ro")):
            if options:
                subprocess.run(["mount", "-o", options, str(place)], check=True)
            for name, target in (("old results", out), ("a new folder", place / "deep" / "new")):
                done = run("calibrate", job, "-o", target, "-q")
                said = done.stderr.strip().replace(str(place), "...")
                good = (
                    done.returncode == 1
                    and done.stderr.count("\n") == 1
                    and tree(out) == old
                    and {entry.name for entry in place.iterdir()} == {"out", "filler"}
                )
                rows.append((f"{what}, {name}", said, "whole" if good else "BROKEN"))
    finally:
        subprocess.run(["umount", str(place)], check=True)
    return rows


def table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, ("---",) * len(header), *rows))


def put(page: Path, lines: list[str]) -> None:
    """Put lines between the marks of a page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{page} has no {BEGIN} and {END} around a table.")
    write_atomically(page, "\n".join([f"{before}{BEGIN}", "", *lines, "", f"{END}{after}"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables into this page")
    arguments = parser.parse_args()
    page = None if arguments.markdown is None else arguments.markdown.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows, passed = kills(folder, arguments.runs, arguments.seed)
        head = ("killed", "folder as it stood", "left beside it", "read, then written anew", "kills")
        lines = [table(head, rows), "", f"{passed} of {arguments.runs} kills passed.", ""]
        good = passed == arguments.runs
        rows, passed = killed_commands(folder, arguments.runs, arguments.seed)
        number = sum(int(row[-1]) for row in rows)
        head = ("command", "what it writes, as it stood", "left beside it", "given again", "kills")
        lines += [table(head, rows), "", f"{passed} of {number} kills passed.", ""]
        good = good and passed == number
        if os.geteuid() == 0:
            found = disks(folder)
            lines.append(table(("disk", "what is said", "old results"), found))
            good = good and all(state == "whole" for *_, state in found)
        else:
            lines.append("Full and read-only disks are mounts, and need root: not tried.")
    print("\n".join(lines))
    if page is not None:
        put(page, lines)
    raise SystemExit(0 if good else 1)


if __name__ == "__main__":
    main()
