"""What nothing tells, or checks: set-ups and tools that several places explain, or of which no row is too many.

Three positions of a tool of its own in a set-up of its own are nine numbers for nine unknowns. Several bases and tools
explain them exactly, the search ends at one of them, and no residual tells that it is another one. In geodesy such rows
have redundancy numbers of zero (W. Baarda, *A testing procedure for use in geodetic networks*, 1968).
"""

from collections import Counter
from dataclasses import replace
from typing import Literal

import numpy as np

from calib.assessment.influence import Residue
from calib.foundations.units import MM
from calib.foundations.words import listed, noun
from calib.identification.fit import Fit
from calib.identification.machine import Layout
from calib.identification.rows import frame_numbers
from calib.identification.targets import shapes
from calib.machine.calibrated import CalibratedMachine
from calib.machine.of_fit import assembled
from calib.machine.tool_uncertainty import by_pair, tool_uncertainty
from calib.measurement.measurements import numbered

# Of more numbers some always check the others: a base and a tool have twelve unknowns at most.
_MOST_NUMBERS = 24
# With that probability a tool is where it is stated.
_SURELY = 0.9999
# Rows that check each other have a redundancy of one number or more.
_LEAST = 0.5


def doubt(residue: Residue) -> str:
    """Say what of bases and tools nothing tells, though they are found; empty where there is nothing to say."""
    if alone := unchecked(residue, "base"):
        return (
            f"In {noun(len(alone), 'set-up')} {listed(alone)} as many numbers were measured as there are unknowns: "
            "several bases and tools explain them exactly, and nothing tells which is right. Measure more poses there, "
            "or state the tool."
        )
    if twice := names_of_mirrored(residue.fit, "tool"):
        return (
            f"The rows put the {noun(len(twice), 'tool')} {listed(twice)} at two places alike, and nothing tells which "
            "is right. Measure more lengths, at other orientations of the tip, or take more photographs, from nearer "
            "or from another side; or state the tool."
        )
    if turned := names_of_mirrored(residue.fit, "base"):
        return (
            f"In {noun(len(turned), 'set-up')} {listed(turned)} photographs show the board alike if tilted to the "
            "other side, as perspective is too small to tell, and nothing tells which is right. Take photographs there "
            "from nearer, or from another side."
        )
    return ""


def placed_elsewhere(fit: Fit, machine: CalibratedMachine) -> str:
    """Say which tools are elsewhere by a machine that explains the rows as well; empty where it is as it is stated."""
    if fit.alike is None:
        return ""
    other, far = assembled(replace(fit, machine=fit.alike)), dict[str, float]()
    for data in fit.measurements:
        for setup, tool, rows in by_pair(data):
            readings, conditions = data.readings[rows], data.conditions.subset(rows)
            here, there = (
                one.at(setup).predict(readings, tool=tool, conditions=conditions)[:, :3, 3] for one in (machine, other)
            )
            told = tool_uncertainty(machine.at(setup), readings, tool, conditions=conditions)
            if not np.median(told.inside(there - here, _SURELY)):
                far[tool] = max(far.get(tool, 0.0), float(np.sqrt(np.mean(np.sum((there - here) ** 2, axis=1)))))
    if not far:
        return ""
    return (
        f"Lengths are the same with the {noun(len(far), 'tool')} {listed(tuple(far))} on the other side of their ends' "
        f"plane, {max(far.values()) / MM:.3g} mm away, and with other tilts of the axes: nothing tells which is "
        "right. Measure lengths from well outside that plane, or state the tool, or about where the base is."
    )


def names_of_mirrored(fit: Fit, what: Literal["base", "tool", "point", "frame"]) -> tuple[str, ...]:
    """Return the names of set-ups, tools, or targets of a shape, that two places explain alike."""
    layout, sets = Layout.of(fit.robot, fit.machine.frames), fit.measurements
    kind = what if what in ("base", "tool") else "target"
    own = dict.fromkeys(
        layout.frame_of(p)[0] for p, twice in zip(fit.parameters, fit.mirrored, strict=True) if twice and p.kind == kind
    )
    names = {"base": sets[0].setups, "tool": sets[0].tools, "target": sets[0].targets}[kind]
    found = shapes(sets) if own and kind == "target" else {}
    return tuple(names[k] for k in own if kind != "target" or found[names[k]] == what)


def unchecked(residue: Residue, kind: Literal["base", "tool"]) -> tuple[str, ...]:
    """Return the set-ups, or tools, of several, that are free and of which nothing checks the rows.

    One pose has one base that explains it: such a set-up is not looked at.
    """
    fit, sets = residue.fit, residue.fit.measurements
    layout, names = Layout.of(fit.robot, fit.machine.frames), sets[0].setups if kind == "base" else sets[0].tools
    numbers: Counter[int] = Counter()
    for data in sets:
        each = _MOST_NUMBERS if kind == "base" and data.kind == "pose" else data.sigma.shape[1]
        for number, same in numbered(frame_numbers(data, kind)):
            numbers[number] += each * len(same)
    free = {layout.frame_of(p)[0] for p in fit.parameters if p.kind == kind}
    few = {k for k, count in numbers.items() if count < _MOST_NUMBERS and k in free}
    if len(numbers) == 1 or not few:
        return ()
    left = dict.fromkeys(sorted(few), 0.0)
    for i, data in enumerate(sets):
        if few.isdisjoint(frame_numbers(data, kind).tolist()):
            continue
        for rows in residue.blocks(i):
            H = rows.J @ residue.covariance.of_rows(rows.J, rows.block)
            own = np.sum(1.0 - rows.w[:, None] * np.diagonal(H, axis1=1, axis2=2), axis=1)
            for k in few:
                left[k] += float(np.sum(own[frame_numbers(data, kind)[rows.rows] == k]))
    return tuple(names[k] for k, redundancy in left.items() if redundancy < _LEAST)
