"""What two checkouts read from many files: every number to its last digit, and every sentence.

    python scripts/development/compare_readers.py OLD NEW [FOLDER ...] [--made 2000]

Each checkout answers in a process of its own (``all_readers.py``), file by file. A file may be of the arms of the URDFs
in its folder, or of those of ``--urdf``. ``--made``: as many tables beside, made at random with known numbers; those
that NEW reads with other numbers than were written are told as well. OLD may be an unpacked ``git archive``.
"""

import argparse
import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from scripts.development.all_readers import NAMES
from scripts.development.made_tables import URDF, Made, made

_WORKER = Path(__file__).with_name("all_readers.py")
_SHOWN = 300  # characters of what differs
_TOLERANCE = 1e-9

Outcomes = dict[str, tuple[str, str]]


class Worker:
    """A checkout that answers what its readers make of files; begun anew where it does not answer."""

    def __init__(self, tree: Path, readers: Sequence[str], seconds: int) -> None:
        self._arguments = [sys.executable, "-B", str(_WORKER), str(tree), ",".join(readers), str(seconds)]
        # What one checkout has kept is not to answer for the other one.
        self._environment = {**os.environ, "PYTHONPATH": str(tree), "CALIB_CACHE": "off", "PYTHONHASHSEED": "0"}
        self._longest = 60 + 4 * seconds * len(readers)
        self._process: subprocess.Popen[str] | None = None

    def ask(self, file: Path, arms: Sequence[str]) -> None:
        """Ask about one file."""
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                self._arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=self._environment
            )
        assert self._process.stdin is not None, "a pipe"
        self._process.stdin.write(json.dumps({"file": str(file), "arms": list(arms)}) + "\n")
        self._process.stdin.flush()

    def answer(self) -> Outcomes:
        """Return the answer: of each reader how it ended and what it says; one alone where the process ended."""
        assert self._process is not None and self._process.stdout is not None, "it was asked"
        if not select.select([self._process.stdout], [], [], self._longest)[0]:
            self.end()
            return {"all": ("broken", f"no answer in {self._longest} s")}
        line = self._process.stdout.readline()
        if not line:
            return {"all": ("broken", f"the process ended with {self._process.wait()}")}
        return {name: (how, said) for name, (how, said) in json.loads(line).items()}

    def end(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


class Difference(NamedTuple):
    """What one reader makes of a file, in the old checkout and in the new one."""

    file: Path
    reader: str
    old: tuple[str, str]
    new: tuple[str, str]

    @property
    def kind(self) -> str:
        """Of which differences this is one."""
        return f"{self.reader}: {self.old[0]}, and now {self.new[0]}"

    def lines(self) -> Iterator[str]:
        """Yield the file, and both outcomes about the first place at which they differ."""
        yield f"  {self.file}"
        old, new = self.old[1], self.new[1]
        at = next((k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
        begin = 0 if self.old[0] != self.new[0] else max(0, at - _SHOWN // 3)
        for said, text in (("old", old), ("new", new)):
            yield f"    {said}: {'...' if begin else ''}{text[begin : begin + _SHOWN]}"


def differences(file: Path, old: Outcomes, new: Outcomes) -> Iterator[Difference]:
    """Yield the readers of which the outcomes differ; one that a checkout has not made no outcome."""
    for reader in dict.fromkeys((*old, *new)):
        nothing = ("broken", "no outcome")
        if old.get(reader, nothing) != new.get(reader, nothing):
            yield Difference(file, reader, old.get(reader, nothing), new.get(reader, nothing))


def files_of(folders: Iterable[Path]) -> list[Path]:
    """Return every file below folders, or a file itself, but for hidden ones."""
    found = []
    for folder in folders:
        if not folder.exists():
            raise SystemExit(f"{folder}: is not there.")
        below = sorted(folder.rglob("*")) if folder.is_dir() else [folder]
        found += [
            path
            for path in below
            if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        ]
    return found


def other_numbers(one: Made, outcome: tuple[str, str]) -> str | None:
    """Return what the reader of sheets made of a table that is not what was written; None where it is, or is refused.

    Columns beside those are no fault, and what is left as words is no number.
    """
    how, said = outcome
    if how != "read":
        return None
    rows: list[list[str]] = json.loads(said)["rows"]
    columns = [np.array([_number(cell) for cell in column]) for column in zip(*rows, strict=True)]
    # The first column may be of names and times.
    words = (cell for row in rows for cell in row[1:] if np.isnan(_number(cell)))
    if any(letter.isdigit() for cell in words for letter in cell):
        return None
    if sum(bool(np.isfinite(column).mean() > 0.5) for column in columns) < one.numbers.shape[1]:
        return None
    if len(rows) != len(one.numbers):
        return f"{len(rows)} rows, and {len(one.numbers)} were written; the last one is {rows[-1]}"
    for k, wanted in enumerate(one.numbers.T):
        if not any(np.allclose(column, wanted, rtol=_TOLERANCE, atol=_TOLERANCE, equal_nan=True) for column in columns):
            return f"no column holds the numbers of column {k + 1}, {wanted[:3].tolist()}; row 1 is {rows[0]}"
    return None


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def compared(
    trees: tuple[Path, Path],
    asked: Iterable[tuple[Path, Sequence[str]]],
    readers: Sequence[str] = NAMES,
    seconds: int = 20,
) -> Iterator[tuple[Path, Outcomes, Outcomes]]:
    """Yield what both checkouts make of files, each with the URDFs of the arms that it may be of."""
    workers = [Worker(tree.resolve(), readers, seconds) for tree in trees]
    try:
        for file, arms in asked:
            for worker in workers:
                worker.ask(file, arms)
            old, new = (worker.answer() for worker in workers)
            yield file, old, new
    finally:
        for worker in workers:
            worker.end()


def _asked(files: Sequence[Path], arms: Sequence[str]) -> Iterator[tuple[Path, Sequence[str]]]:
    beside: dict[Path, list[str]] = {}
    for file in files:
        own = beside.setdefault(file.parent, [str(path) for path in sorted(file.parent.glob("*.urdf"))[:1]])
        yield file, arms or own


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare, print, and return how many readings differ."""
    said = _parsed(arguments)
    readers = NAMES if said.only is None else said.only.split(",")
    differing: dict[str, list[Difference]] = {}
    counts: Counter[tuple[str, str]] = Counter()
    wrong: list[str] = []
    broken: dict[tuple[str, str], Path] = {}
    with tempfile.TemporaryDirectory(prefix="calib-made-") as folder, contextlib.ExitStack() as stack:
        tables = _written(Path(folder), said.seed, said.made)
        files = [*files_of(said.folders), *tables]
        log = None if said.outcomes is None else stack.enter_context(said.outcomes.open("w", encoding="utf-8"))
        for number, (file, old, new) in enumerate(
            compared((said.old, said.new), _asked(files, said.urdf), readers, said.seconds), start=1
        ):
            counts.update((reader, how) for reader, (how, _) in new.items())
            for reader, (how, text) in new.items():
                if how == "broken":
                    broken.setdefault((reader, text), file)
            if log:
                log.write(json.dumps({"file": str(file), **new}) + "\n")
            for one in differences(file, old, new):
                differing.setdefault(one.kind, []).append(one)
            if file in tables and (why := other_numbers(tables[file], new.get("sheet", ("", "")))):
                wrong.append(f"  {file.name}: {why[:_SHOWN]}")
            if number % 500 == 0:
                print(f"{number} of {len(files)} files", file=sys.stderr, flush=True)
    for kind, every in sorted(differing.items()):
        print(f"{kind}: {len(every)}")
        for one in every[: said.most]:
            print(*one.lines(), sep="\n")
    for (reader, text), file in broken.items():
        print(f"{reader} breaks in the new checkout: {file}: {text[:_SHOWN]}")
    if wrong:
        print(f"made tables that the new checkout reads otherwise than written: {len(wrong)}")
        print(*wrong[: said.most], sep="\n")
    for reader in readers:
        told = ", ".join(f"{how} {times}" for (of, how), times in sorted(counts.items()) if of == reader)
        print(f"{reader:>14}: {told or 'no file'}")
    print(f"{len(files)} files; {sum(map(len, differing.values()))} outcomes differ")
    return sum(map(len, differing.values()))


def _written(folder: Path, seed: int, count: int) -> Mapping[Path, Made]:
    """Write tables beside the URDF of their arm, and return them by their places."""
    (folder / "made.urdf").write_text(URDF)
    found = {}
    for k in range(seed, seed + count):
        one = made(k)
        path = folder / one.name
        path.write_bytes(one.data)
        found[path] = one
    return found


def _parsed(arguments: Sequence[str] | None) -> Any:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="a checkout")
    parser.add_argument("new", type=Path, help="another one, or the same")
    parser.add_argument("folders", type=Path, nargs="*", help="folders of files, or files")
    parser.add_argument("--made", type=int, default=0, help="how many tables to make beside")
    parser.add_argument("--seed", type=int, default=0, help="of the first of these")
    parser.add_argument("--urdf", action="append", default=[], help="an arm that all files may be of; repeatable")
    parser.add_argument("--only", help=f"readers, of {','.join(NAMES)}")
    parser.add_argument("--seconds", type=int, default=20, help="of processor time, for one reader and file")
    parser.add_argument("--most", type=int, default=5, help="how many of alike differences are shown")
    parser.add_argument("--outcomes", type=Path, help="a file for all outcomes of the new checkout, as lines of JSON")
    return parser.parse_intermixed_args(arguments)


if __name__ == "__main__":
    sys.exit(1 if main() else 0)
