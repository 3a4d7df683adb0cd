"""Anchors, balls and probes that a search has put in a wrong place: where their own rows put them, by the machine."""

from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.initialisation.frames import initialise
from calib.identification.machine import Layout
from calib.identification.system import Problem, residuals

# Rows fit clearly better with a sum of squares below this share; where a search is at the least, they never do.
_CLEARLY = 0.5


def anchors_anew(problem: Problem, x: Array) -> Array | None:
    """Return parameter values x (p,) with those centres elsewhere that fit clearly better there; None if none does.

    Lengths fit an anchor, and touches on one side a ball, at two places, one of them a minimum that is not the least.
    From which side a search came that began with a tool or a robot that was off, chance decided: a ball's radius is
    hardly more than what an arm is off by. The machine that it found knows better, as most centres, or other targets,
    are where they should be. A tool that balls alone tell goes with them.
    """
    lengths = [data for data in problem.measurements if data.kind in ("distance", "sphere")]
    if not lengths:
        return None
    machine, layout = problem.machine(x), Layout.of(problem.model.robot, problem.reference)
    anew = initialise(problem.model, problem.measurements, begun=machine).frames
    there = replace(machine, frames=replace(machine.frames, tools=anew.tools, targets=anew.targets))
    count, tools = len(anew.targets), np.any(anew.tools != machine.frames.tools, axis=(1, 2))
    target, tool = (np.concatenate([getattr(data, what) for data in lengths]) for what in ("target", "tool"))
    before, after = (
        np.bincount(target, np.concatenate(residuals(problem.model.robot, lengths, at))[:, 0] ** 2, count)
        for at in (machine, there)
    )
    moved = np.asarray(after < _CLEARLY * before)
    # A tool that is elsewhere is so with all that it touched, and where it may move.
    free = [layout.frame_of(parameter)[0] for parameter in problem.parameters if parameter.kind == "tool"]
    touched = [np.unique(target[tool == k]) for k in range(len(tools))]
    better = np.array([k in free and bool(moved[own].all()) for k, own in enumerate(touched)])
    for worse in np.flatnonzero(tools & ~better):
        moved[touched[worse]] = False
    found = x.copy()
    for k, parameter in enumerate(problem.parameters):
        if parameter.kind not in ("target", "tool"):
            continue
        number, component = layout.frame_of(parameter)
        if component < 3 and parameter.kind == "target" and moved[number]:
            found[k] = anew.targets[number, component, 3]
        elif component < 3 and parameter.kind == "tool" and tools[number] and better[number]:
            found[k] = anew.tools[number, component, 3]
    return None if np.array_equal(found, x) else found
