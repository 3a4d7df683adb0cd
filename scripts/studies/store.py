"""A store of simulated sessions, one line each: studies may be stopped at any time, and started with more sessions."""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.foundations.errors import CalibError


def stored(path: Path, cells: Iterable[str]) -> dict[str, list[dict[str, Any]]]:
    """The sessions of every cell that a store has; a seed counts once."""
    found: dict[str, dict[int, dict[str, Any]]] = {cell: {} for cell in cells}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        told = json.loads(line)
        if told["cell"] in found:
            found[told["cell"]].setdefault(told["seed"], told)
    return {cell: [by_seed[seed] for seed in sorted(by_seed)] for cell, by_seed in found.items()}


def simulate(
    path: Path, chosen: Sequence[str], sessions: int, until: float, session: Callable[[str, int], Mapping[str, Any]]
) -> None:
    """Add sessions to the store, a seed of all ``chosen`` cells after another, ``until`` a monotonic time in s."""
    done = {(cell, told["seed"]) for cell, all_told in stored(path, chosen).items() for told in all_told}
    for seed in range(sessions):
        for cell in chosen:
            if (cell, seed) in done:
                continue
            if time.monotonic() > until:
                return
            try:
                line = {"cell": cell, "seed": seed, **session(cell, seed)}
            except CalibError as e:
                line = {"cell": cell, "seed": seed, "refused": str(e)}
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
