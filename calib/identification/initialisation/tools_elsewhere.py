"""Tools elsewhere along what the tips' orientations do not show of them, from which a search may find a better minimum.

Where the tip link turns about one direction only, positions of the nominal robot do not tell how long the tool is along
it. Those of a machine with tilted axes do: the tip is moved by tilts times that length. Such a product has a minimum on
either side of the length where it vanishes, the other one with tilts of the wrong signs, and a search from a tool that
is stated wrongly by decimetres, or not at all, may end there.
"""

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.identification.machine import Layout
from calib.identification.parameters import TOOL
from calib.identification.system import Problem

# A tip link turns if its axes differ by more than that from their mean, as a root of mean squares.
_TURNS = 0.1


def tools_elsewhere(problem: Problem, x0: Array) -> tuple[Array, ...]:
    """Return values (p,) to begin with, which have tools on either side of where x0 (p,) has them.

    Base translations make up for that, so that the nominal robot predicts the same. There are none where poses show all
    tools, or where a tip link hardly turns at all.
    """
    robot, sets, layout = problem.model.robot, problem.measurements, Layout.of(problem.model.robot, problem.reference)
    held = sorted({layout.frame_of(p)[0] for p in problem.parameters if p.kind == "tool" and p.wider is not None})
    if not held:
        return ()
    tips, bases = [data.tips(robot, problem.held) for data in sets], problem.reference.bases[:, :3, :3]
    change, common = np.zeros(layout.size), np.zeros(3)
    for k in held:
        R = np.concatenate([T[data.tool == k, :3, :3] for data, T in zip(sets, tips, strict=True)])
        mean = R.mean(axis=0)
        _, sizes, Vt = linear.svd(linear.triangle((R - mean).reshape(-1, 3)))
        if sizes[1] < _TURNS * np.sqrt(len(R)):
            continue
        along = mean @ Vt[2]
        # A base that several tools share can make up for them only if all go the same way.
        along *= -1.0 if along @ common < 0.0 else 1.0
        common += along
        change[layout.tools + 6 * k :][:3] = mean.T @ along
        for s in {int(s) for data in sets for s in data.setup[data.tool == k]}:
            change[layout.base + 6 * s :][:3] = -bases[s] @ along
    step = np.array([change[p.entries[0][0]] if p.kind in ("base", "tool") else 0.0 for p in problem.parameters])
    return (x0 + TOOL * step, x0 - TOOL * step) if step.any() else ()
