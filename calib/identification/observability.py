"""What measurements would reveal, before anything is solved."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.units import DEG
from calib.identification import identifiability
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import NullDirection
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import Layout, values_at
from calib.identification.parameters import UNSHOWN_TOOL_WIDTH, Parameter
from calib.identification.system import Evaluation, Problem, evaluate
from calib.identification.unseen_strains import unseen_strains
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements

# By how much, rms, every direction of a tool moves at its tip link, of its length, where the link turns by tens of
# degrees about two directions.
_TURNED = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """What a set of poses determines of an error model, at the nominal robot.

    ``numbers``: measured numbers. ``rank`` of ``parameters``; ``undetermined``: what they do not determine.
    ``condition``: of the determined directions, in parameter scales; ``indices``: O1 to O5 (:func:`indices`) of the
    same.
    """

    __repr__ = brief

    parameters: tuple[Parameter, ...]
    numbers: int
    rank: int
    condition: float
    undetermined: tuple[NullDirection, ...]
    indices: Mapping[str, float]

    def contents(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "parameters": [parameter.name for parameter in self.parameters],
            "measured_numbers": self.numbers,
            "rank": self.rank,
            "condition": self.condition if self.rank else None,
            "indices": dict(self.indices),
            "undetermined": [str(direction) for direction in self.undetermined],
        }


def indices(singular_values: Array, poses: int) -> dict[str, float]:
    """Return the observability indices of ``poses`` poses from the singular values s_1 >= ... >= s_r, r the rank.

    O1 = (s_1 ... s_r)^(1/r) / sqrt(poses), O2 = s_r / s_1, O3 = s_r, O4 = s_r^2 / s_1, O5 = 1 / (1/s_1 + ... + 1/s_r):
    larger is better (Y. Sun, J. M. Hollerbach, *Observability index selection for robot calibration*, ICRA 2008).
    Empty where the rank is 0.
    """
    s = singular_values
    if not len(s):
        return {}
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


@checked
def observability(model: ErrorModel, measurements: Sequence[Measurements]) -> Observability:
    """Return what the measurements determine; raises MeasurementError when they are not of this robot."""
    problem = initial_problem(model, measurements)
    parameters, sets = problem.parameters, problem.measurements
    rows = _at_start(problem).rows.whole
    directions = identifiability.directions_of(rows.reduced(identifiability.RANK_TOLERANCE))
    rank = directions.rank
    _, undetermined = identifiability.told(rows, directions.common_rank(0.0), parameters)
    seen = identifiability.Spectrum(rows, problem.targets_apart).values[:rank]
    return Observability(
        parameters,
        sum(data.sigma.size for data in sets),
        rank,
        float(seen[0] / seen[-1]) if rank else float("nan"),
        undetermined,
        indices(seen, sum(map(len, sets))),
    )


def rank_findings(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return what no number of such measurements would determine, and which others would.

    Raises MeasurementError and JobError as :func:`calib.identification.initialisation.problem.initial_problem` does.
    """
    problem = initial_problem(model, measurements)
    found = []
    unseen = unseen_strains(problem)
    if unseen.size:
        found.append(
            Finding.warning(
                "size-unseen",
                "The measurements do not determine the size of the arm: an arm that is larger throughout touches the "
                "same targets in other places. The nominal size is kept. One known length determines it: "
                "the distance between two sockets or planes ([[relations]]), a gauge, a ball bar, a ball of known "
                "diameter, or positions from an instrument.",
            )
        )
    if unseen.proportions:
        found.append(
            Finding.warning(
                "proportions-unseen",
                "The measurements hardly determine how long the arm is along some of its axes: one that is longer or "
                "wider there touches nearly the same targets in other places. It is kept as it is nominally. One known "
                "length along these axes determines it: the distance between two sockets or planes ([[relations]]), a "
                "gauge, a ball bar, or positions from an instrument.",
            )
        )
    if len(problem.model.setups) > len(model.setups):
        found.append(
            Finding.warning(
                "base-unseen",
                "Nothing was measured in an instrument's frame, so that the base is not identifiable: base.x to "
                "base.rz are held as given. Positions from an instrument, or known places of three sockets "
                '([targets.NAME]), would determine it; base = "fixed" ends this warning.',
            )
        )
    return (*found, *_unturned(problem))


def _unturned(problem: Problem) -> Iterator[Finding]:
    """Yield what poses do not show of tool points, since the tip link hardly turns."""
    sets, tools = problem.measurements, problem.measurements[0].tools
    layout = Layout.of(problem.model.robot, problem.reference)
    held = {layout.frame_of(q)[0] for q in problem.parameters if q.weak_prior == UNSHOWN_TOOL_WIDTH}
    for k in sorted(held):
        tips = np.concatenate([problem.model.robot.tips(d.readings[d.tool == k])[:, :3, :3] for d in sets])
        setup = np.concatenate([d.setup[d.tool == k] for d in sets])
        if not len(tips):
            continue
        # How it turns from one set-up to another shows nothing, as each has a base of its own.
        parts = [tips[setup == one] for one in np.unique(setup)]
        # Where it turns as it should, what does not show the tool is that the arm does not follow: "unexplained".
        spread = np.concatenate([R - R.mean(axis=0) for R in parts]).reshape(-1, 3) / np.sqrt(len(tips))
        if np.linalg.svd(spread, compute_uv=False)[-1] > _TURNED:
            continue
        turned = max(float(np.linalg.norm(rigid.log3(np.swapaxes(R[:1], -1, -2) @ R), axis=1).max()) for R in parts)
        within = "" if len(parts) == 1 else " within a set-up"
        whose = "" if len(tools) == 1 else f" {tools[k]!r}"
        yield Finding.warning(
            "tool-unseen",
            f"With the tool{whose} the tip link turns by {turned / DEG:.3g} deg at most{within}, or about one "
            "direction only. The data then do not tell an error of the tool point from one of the base or of the "
            "joints, so the tool point is held near its start value unless they clearly ask for another. Positions at "
            "such orientations are predicted well, others are not. To determine the tool point, add poses that turn "
            'the tip link by tens of degrees about two directions, or give the tool (tool = "fixed").',
        )


def _at_start(problem: Problem) -> Evaluation:
    # One millimetre, milliradian or pixel of noise: only the shape of what is seen matters here.
    ones = [np.full(data.sigma.shape, 1e-3 if data.camera is None else 1.0) for data in problem.measurements]
    return evaluate(problem, ones, values_at(problem.model.robot, problem.parameters, problem.reference))
