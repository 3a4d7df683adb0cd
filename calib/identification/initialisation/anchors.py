"""Anchors and balls that a search has put in a wrong place: where their own rows put them, the machine being known."""

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
    are where they should be.
    """
    lengths = [data for data in problem.measurements if data.kind in ("distance", "sphere")]
    if not lengths:
        return None
    machine = problem.machine(x)
    anew = initialise(problem.model, problem.measurements, begun=machine).frames.targets
    there = replace(machine, frames=replace(machine.frames, targets=anew))
    count = len(anew)
    target = np.concatenate([data.target for data in lengths])
    before, after = (
        np.bincount(target, np.concatenate(residuals(problem.model.robot, lengths, at))[:, 0] ** 2, count)
        for at in (machine, there)
    )
    moved = np.asarray(after < _CLEARLY * before)
    found, layout = x.copy(), Layout.of(problem.model.robot, problem.reference)
    for k, parameter in enumerate(problem.parameters):
        if parameter.kind == "target":
            t, component = layout.frame_of(parameter)
            if moved[t] and component < 3:
                found[k] = anew[t, component, 3]
    return None if np.array_equal(found, x) else found
