"""Rows that do not belong together: measured from several places, or on several tools."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import BoolArray
from calib.identification.followed import FEWEST_ROWS, followed
from calib.job.foreign.answers import AskedError, Trial, ask
from calib.job.foreign.seen import Seen

# A base and a tool of their own explain a few rows of anything better than many.
_FEWEST = FEWEST_ROWS + 4
_MOST_PARTS = 12
# What the arm follows as well as this, in every part, is no chance.
_FOLLOWS = 0.1
_LOOKED_AT = 12


def parts_question(seen: Seen, trials: Sequence[Trial]) -> AskedError | None:
    """Return a question where parts of the rows are followed each alone, and not together; None where they are not."""
    where = seen.raw.where
    for k, column in enumerate(seen.raw.columns):
        kinds = sorted(set(column.words))
        if 1 < len(kinds) <= _MOST_PARTS:
            for trial in trials:
                own = np.array(column.words)[trial.rows]
                is_beside = k not in (*trial.pick.joints.columns, *trial.point.columns)
                if is_beside and _are_followed(trial, [own == kind for kind in kinds]):
                    return ask(
                        "setup",
                        f"{where}: the rows of each {column.title!r} fit the arm, all rows together do not; is it the "
                        "place of the robot or the instrument, or the tool?",
                        [f"'{name}={column.title}'" for name in ("setup", "tool")],
                        "--column",
                    )
    for trial in trials:
        first = _best_split(trial)
        if first is not None and _are_followed(trial, [first, ~first]):
            return ask(
                "setup",
                f"{where}: {seen.first_rows(int(trial.rows[first].max()))} and the rows after them fit the arm "
                "separately, but not together; was the robot, the instrument or the tool moved there?",
                (),
                "a column setup, or tool, that says which rows belong together",
            )
    return None


def _are_followed(trial: Trial, parts: Sequence[BoolArray]) -> bool:
    return all(
        part.sum() >= _FEWEST and followed(trial.tips[part], trial.position[part]).share < _FOLLOWS for part in parts
    )


def _best_split(trial: Trial) -> BoolArray | None:
    """Return the first rows (N) of the split after which the arm follows best; None where there are too few rows."""
    n = len(trial.rows)
    if n < 2 * _FEWEST:
        return None
    count = np.arange(n)

    def left(k: int) -> float:
        halves = (count < k, count >= k)
        return float(sum(h.sum() * followed(trial.tips[h], trial.position[h]).miss ** 2 for h in halves))

    coarse = np.unique(np.linspace(_FEWEST, n - _FEWEST, _LOOKED_AT).astype(int)).tolist()
    best = min(range(len(coarse)), key=lambda i: left(coarse[i]))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)]
    return count < min(range(low, high + 1), key=left)
