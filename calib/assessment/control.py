"""What nothing checks: set-ups of which as many numbers were measured as there are unknowns that these alone tell.

Three positions of a tool of its own in a set-up of its own are nine numbers for nine unknowns. Several bases and tools
explain them exactly, the search ends at one of them, and no residual tells that it is another one. In geodesy such rows
have redundancy numbers of zero (W. Baarda, *A testing procedure for use in geodetic networks*, 1968).
"""

from collections import Counter
from typing import Literal

import numpy as np

from calib.assessment.influence import Residue
from calib.identification.fit import Fit
from calib.identification.machine import Layout

# Of more numbers some always check the others: a base and a tool have twelve unknowns at most.
_MOST_NUMBERS = 24
# Rows that check each other have a redundancy of one number or more.
_LEAST = 0.5


def names_of_mirrored(fit: Fit, kind: Literal["tool", "target"]) -> tuple[str, ...]:
    """Return the names of tools, or targets, that lengths put at two places alike."""
    layout, data = Layout.of(fit.robot, fit.machine.frames), fit.measurements[0]
    names = data.tools if kind == "tool" else data.targets
    own = [p for p, twice in zip(fit.parameters, fit.mirrored, strict=True) if twice and p.kind == kind]
    return tuple(dict.fromkeys(names[layout.frame_of(p)[0]] for p in own))


def unchecked(residue: Residue) -> tuple[str, ...]:
    """Return the set-ups, of several, whose bases are free, and of which nothing checks the positions.

    One pose has one base that explains it, and is not looked at.
    """
    sets, layout = residue.fit.measurements, Layout.of(residue.fit.robot, residue.problem.reference)
    numbers: Counter[int] = Counter()
    for data in sets:
        for s, rows in zip(*np.unique(data.setup, return_counts=True), strict=True):
            numbers[int(s)] += int(rows) * (_MOST_NUMBERS if data.kind == "pose" else data.sigma.shape[1])
    free = {layout.frame_of(p)[0] for p in residue.fit.parameters if p.kind == "base"}
    few = {s for s, count in numbers.items() if count < _MOST_NUMBERS and s in free}
    if len(numbers) == 1 or not few:
        return ()
    left = dict.fromkeys(sorted(few), 0.0)
    for i, data in enumerate(sets):
        if few.isdisjoint(data.setup.tolist()):
            continue
        for rows in residue.blocks(i):
            H = rows.J @ residue.covariances(rows) @ np.swapaxes(rows.J, -1, -2)
            own = np.sum(1.0 - rows.w[:, None] * np.diagonal(H, axis1=1, axis2=2), axis=1)
            for s in few:
                left[s] += float(np.sum(own[data.setup[rows.rows] == s]))
    return tuple(sets[0].setups[s] for s, redundancy in left.items() if redundancy < _LEAST)
