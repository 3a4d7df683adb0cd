"""Lengths that are stated, and that no row checks: the radius of a ball, what all lengths of a table have in common.

Faces of a known block that are touched from one side each are as far from the tool as the ball's radius. If that is
wrong, the base moves by as much along every normal, no residual tells, and no region counts it: what is stated is taken
as exact. So the user is told what the tool rests on. Were such a number to be found as well, its standard deviation s
would be that of what the parameters do not take up of it, and the tool, which follows it by so much, would be less
certain. Where this is what most of its uncertainty would be, it is said.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.assessment.influence import Residue
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.units import MM
from calib.foundations.words import listed
from calib.identification.fit import Fit
from calib.identification.machine import machine, values_at
from calib.identification.parameters import scales
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import by_pair, tool_uncertainty
from calib.measurement.measurements import Measurements

# Kinds whose residuals are a length, all of which one number makes longer, and the unknown that they may have for it.
_OFFSETS = {"distance": "offset", "pair_distance": "offset"}
_TOUCHED = {"plane": "radius", "sphere": "radius"}
# In m: how far such a number may be off where nothing is known of it.
_WEAK = 10.0 * MM
# The tool is said to rest on it if it would be so many times less certain without.
_TIMES = 2.0
# In m: what users are told the effect of, and of central differences.
_TOLD, _STEP = 0.1 * MM, 1e-4
_MORE = "Measure the ball; more faces that look opposite ways, touches all around, or positions, would check it."
# So many rows of a set tell where tools are.
_ENOUGH = 200


class _Rows(NamedTuple):
    """Rows of a part whose lengths one number makes longer."""

    part: Stretch
    own: BoolArray


class _Stated(NamedTuple):
    """``what`` is stated, of which rows it is, and how rows may check it."""

    what: str
    rows: tuple[_Rows, ...]
    cure: str


def taken_as_stated(residue: Residue, parts: Sequence[Stretch], known: CalibratedMachine) -> tuple[str, ...]:
    """Return a sentence for every stated length that no row checks, and on which the place of the tool rests.

    ``parts``: the rows of ``residue``, as whose ``known`` is the calibrated machine.
    """
    return tuple(sentence for one in _stated(residue.fit, parts) if (sentence := _said(one, residue, parts, known)))


def _stated(fit: Fit, parts: Sequence[Stretch]) -> Iterator[_Stated]:
    """Yield what is stated of lengths: the ball of every tool that touched, and what is common to a table's lengths."""
    touched = [part for part in parts if part.data.kind in _TOUCHED]
    for number, tool in enumerate(fit.measurements[0].tools):
        every = [_Rows(part, own) for part in touched if (own := _by_ball(part, number)).any()]
        if not every or any("radius" in rows.part.data.uses for rows in every):
            continue
        names = dict.fromkeys(name for rows in every for name in _touched(rows))
        which = f" of the tool {tool!r}" if len(fit.measurements[0].tools) > 1 else ""
        what = f"The radius of the ball{which} that touched {listed(tuple(names))}"
        yield _Stated(what, tuple(every), _MORE)
    for part in parts:
        role = _OFFSETS.get(part.data.kind)
        if role is not None and role not in part.data.uses:
            what = f"The offset that all lengths of {part.data.where} may have in common, here 0,"
            every = [_Rows(part, np.ones(len(part.r), dtype=np.bool_))]
            yield _Stated(what, tuple(every), "Measure it; other lengths, or positions, would check it.")


def _by_ball(part: Stretch, tool: int) -> BoolArray:
    """Return which rows (n,) a tool touched, with a ball whose radius is stated."""
    data, rows = part.data, part.row.astype(np.intp)
    return np.asarray((data.tool[rows] == tool) & (data.value[rows, 0] > 0.0))


def _touched(rows: _Rows) -> list[str]:
    target = rows.part.data.target[rows.part.row.astype(np.intp)[rows.own]]
    return [rows.part.data.targets[k] for k in np.unique(target[target >= 0])]


def _said(stated: _Stated, residue: Residue, parts: Sequence[Stretch], known: CalibratedMachine) -> str:
    """Return what a user should know of a stated length; empty where rows check it, or where the tool hardly moves."""
    squares, along = 0.0, np.zeros(len(residue.C))
    for rows in stated.rows:
        i = next(k for k, data in enumerate(residue.fit.measurements) if data is rows.part.data)
        of = rows.part.row.astype(np.intp)
        longer = (rows.own * np.sqrt(residue.w[i][of]) / residue.sigma[i][of, 0])[:, None]
        squares += float(np.sum(longer**2))
        along += np.einsum("ndk,nd->k", rows.part.J, longer)
    follows = -residue.C @ along
    seen = max(squares + float(along @ follows), 0.0)
    variance = 1.0 / (seen + 1.0 / _WEAK**2)
    moves, certain = _moved(residue, parts, follows), _certain(parts, known)
    # In the direction in which the tool moves, which may be the only one that is known.
    more = variance * np.einsum("ni,ni->n", moves, np.linalg.solve(certain, moves[:, :, None])[:, :, 0])
    if np.median(more) < _TIMES**2 - 1.0:
        return ""
    far = float(np.sqrt(np.mean(np.sum(moves**2, axis=1))))
    return (
        f"{stated.what} is taken as stated, and no row checks it: if it is {_TOLD / MM:g} mm off, the tool is "
        f"{far * _TOLD / MM:.2g} mm elsewhere, which regions do not count. {stated.cure}"
    )


def _moved(residue: Residue, parts: Sequence[Stretch], follows: Array) -> Array:
    """Return how tools move (n, 3) at some rows of all parts, if parameters move along ``follows`` (k,), scaled."""
    fit = residue.fit
    step = np.zeros(len(fit.parameters))
    step[residue.judged] = _STEP * follows * scales(fit.parameters)[residue.judged]
    x = values_at(fit.model.robot, fit.parameters, fit.machine.frames, fit.machine.deviations)
    there = [
        replace(fit, machine=machine(fit.model.robot, fit.parameters, fit.machine.frames, y, fit.machine.deviations))
        for y in (x + step, x - step)
    ]
    ends = [np.concatenate([_tools(one, _some(part)) for part in parts]) for one in there]
    return np.asarray((ends[0] - ends[1]) / (2.0 * _STEP))


def _some(part: Stretch) -> Measurements:
    """Return rows of a part, of many some, that stand for all."""
    rows = part.row.astype(np.intp)
    return part.data.subset(rows[:: -(-len(rows) // _ENOUGH)])


def _tools(fit: Fit, data: Measurements) -> Array:
    """Return where the tools (n, 3) of rows are, in the instrument's frame."""
    return np.asarray((fit.bases_of(data) @ data.tips(fit.robot, fit.deviations) @ fit.tools_of(data))[:, :3, 3])


def _certain(parts: Sequence[Stretch], known: CalibratedMachine) -> Array:
    """Return the stated covariances (n, 3, 3) of the tool's position at the same rows, in m^2."""
    found = []
    for data in map(_some, parts):
        own = np.empty((len(data), 3, 3))
        for setup, tool, rows in by_pair(data):
            conditions = data.conditions.subset(rows)
            told = tool_uncertainty(known.at(setup), data.readings[rows], tool, conditions=conditions)
            own[rows] = told.covariance[:, :3, :3]
        found.append(own)
    return np.concatenate(found)
