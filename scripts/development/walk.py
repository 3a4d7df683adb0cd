"""The walk of one measured row through the house: which functions hand it on, in which files, in which order.

    python scripts/development/walk.py

One row of robots/arm_cmm gets a number that nothing else has. A function of calib that returns this number, as text, in
SI units or in an array, is a stop: it hands the row on. Functions that only look at it are listed as checks. Counted is
until the first fit is solved; a return is a step back to a file that the walk had left.
"""

import itertools
import shutil
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import calib
from calib.foundations.units import DEG
from calib.job.calibrate import calibrate

ROOT = Path(__file__).parents[2]
CASE = ROOT / "robots" / "arm_cmm"
HOUSE = str(Path(calib.__file__).parent)
TEXT, DEEPEST = "12.3456789", 4


class Walk:
    """Remembers which functions hand the row on and which look at it, each in the order of its first visit."""

    def __init__(self) -> None:
        self.stops: dict[tuple[str, str], None] = {}
        self.looks: dict[tuple[str, str], None] = {}
        self.over = False

    def __call__(self, frame: FrameType, event: str, value: Any) -> None:
        code = frame.f_code
        if self.over or event not in ("call", "return") or not code.co_filename.startswith(HOUSE):
            return
        file = code.co_filename[len(HOUSE) + 1 :]
        self.over = code.co_name == "solve_learning"
        if code.co_name[0] == "<" or file == "foundations/arguments.py":
            return
        if event == "return":
            if holds(value):
                self.stops.setdefault((file, code.co_qualname))
            return
        given = (frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])
        if any(holds(one) for one in given):
            self.looks.setdefault((file, code.co_qualname))

    @property
    def returns(self) -> int:
        """How often the walk comes back to a file that it had left."""
        way = [file for file, _ in itertools.groupby(file for file, _ in self.stops)]
        return len(way) - len(set(way))


def holds(value: Any, depth: int = 0) -> bool:
    """Return whether a value holds the number of the row."""
    if isinstance(value, str):
        return TEXT in value
    if isinstance(value, bytes):
        return TEXT.encode() in value
    if isinstance(value, float):
        return abs(value - float(TEXT) * DEG) < 1e-12
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and bool(np.any(np.abs(value - float(TEXT) * DEG) < 1e-12))
    if depth == DEEPEST:
        return False
    if is_dataclass(value) and not isinstance(value, type):
        return any(holds(getattr(value, field.name, None), depth + 1) for field in fields(value))
    if isinstance(value, Mapping):
        return any(holds(one, depth + 1) for one in value.values())
    return isinstance(value, tuple | list) and any(holds(one, depth + 1) for one in value)


def main() -> None:
    """Print the walk, and its count."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in CASE.iterdir():
            if path.suffix in (".csv", ".toml", ".urdf"):
                shutil.copy(path, folder)
        table = folder / "identification.csv"
        lines = table.read_text(encoding="utf-8").splitlines()
        row = next(n for n, line in enumerate(lines) if line and line[0] in "-0123456789")
        lines[row] = ",".join([TEXT, *lines[row].split(",")[1:]])
        table.write_text("\n".join(lines) + "\n", encoding="utf-8")
        walk = Walk()
        sys.setprofile(walk)
        try:
            calibrate(folder / "calibration.toml", folder / "out")
        finally:
            sys.setprofile(None)
    for file, function in walk.stops:
        print(f"{file}: {function}")
    files = len({file for file, _ in walk.stops})
    checks = len(walk.looks.keys() - walk.stops.keys())
    print(f"{len(walk.stops)} stops in {files} files, with {walk.returns} returns; {checks} functions only look at it.")


if __name__ == "__main__":
    main()
