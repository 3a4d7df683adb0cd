"""One session, judged: what calib finds against the minimum that an independent search finds from the truth.

    judge(case(7, "ur5"))

Both costs are of the same sum of squares (:func:`stated`): residuals at the instrument's noise, or the noise that was
found where none is stated, and how far parameters are from where they are held.
"""

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

import calib
from scripts.development.judge_cases import Case
from scripts.development.judge_machines import Array, Cost, Distance, Layout, State, formal_rank, minimise, predict

Holding = Literal["stated", "weak"]
# Widths by which what has no prior is held at its start: a joint's zero; placements and joints that slide; the tool, as
# a share of the arm's reach. Nothing else is held.
ZERO, LENGTH, ANGLE, TOOL = 0.1, 0.01, 0.01, 1.0
# Where a solver chooses among equal fits in its own way, widths so much larger do not move what the data see.
WEAK = 1e3
# A cost is higher where it exceeds the other by this share of it, and of one measured number.
HIGHER, ALIKE = 1e-6, 1e-4
# The tool at new poses is worse where its error is larger by this share, and by this many metres, which are nothing.
WORSE, NOTHING = 0.05, 1e-8
# Found noise that is taken for the truth's, by how much larger it may be.
CREDIBLE = 3.0


@dataclass(frozen=True)
class Verdict:
    """What was found of one session. Costs in squared sigmas, errors in mm (3D rms at new poses).

    ``outcome``: "right", "refused" (rightly), or what is wrong: "refused wrongly", "failed", "cost", "tool", "cost and
    tool"; "other minimum" where the cost is lower than the independent one's and the tool is worse. ``polished``: how
    much of a higher cost an independent search from calib's answer takes away in 30 steps. ``data_cost`` and
    ``independent_data_cost``: without what is held. ``kinematics``: the largest difference in sigmas of calib's
    residuals from independent ones.
    """

    family: str
    seed: int
    outcome: str
    numbers: int
    unknowns: int
    rank: int
    calib_rank: int | None
    cost: float
    independent_cost: float
    data_cost: float
    independent_data_cost: float
    polished: float
    error: float
    independent_error: float
    kinematics: float
    converged: bool | None
    evaluations: int | None
    seconds: float
    independent_settled: bool
    said: str

    @property
    def right(self) -> bool:
        """Whether nothing is wrong."""
        return self.outcome in ("right", "refused")

    @property
    def stuck(self) -> bool:
        """Whether the answer is a minimum, and not the least one: an independent search does not leave it either."""
        return self.outcome.startswith("cost") and self.polished <= HIGHER * (1.0 + self.cost)


def judge(case: Case, holding: Holding = "stated") -> Verdict:
    """Let calib solve a session, and judge what it says."""
    began = time.perf_counter()
    fit, said, failed = None, "", False
    try:
        fit = calib.identify(case.model, case.data, **case.options)
    except calib.IdentificationError as e:
        said = str(e)
    except (calib.CalibError, ArithmeticError, ValueError, np.linalg.LinAlgError) as e:
        said, failed = f"{type(e).__name__}: {e}", True
    seconds = time.perf_counter() - began
    if fit is None:
        cost = stated(case, None, holding)
        # A rank is formal: it may not depend on where it is taken.
        rank = max(formal_rank(cost, case.truth), formal_rank(cost, case.layout.values(case.layout.at)))
        held = sum(case.priors is not None and robots(name) for name in case.layout.names)
        rightly = case.numbers + held <= min(rank + held, len(case.truth))
        outcome = "failed" if failed else "refused" if rightly else "refused wrongly"
        nan = float("nan")
        counts = case.numbers, len(case.truth), rank, None
        none = (nan,) * 8
        return Verdict(case.family, case.seed, outcome, *counts, *none, None, None, seconds, True, said)
    found = state_of(case.layout, fit)
    names = {parameter.name for parameter in fit.parameters}
    if names != set(case.layout.names):
        raise AssertionError(f"calib's parameters are others: {sorted(names ^ set(case.layout.names))}")
    cost = stated(case, fit, holding)
    if case.aligned == "similar":
        # A smaller arm has smaller residuals, and nothing measured says how large it is: costs are of one size.
        apart = found.targets[0, 1, :3, 3] - found.targets[0, 0, :3, 3]
        cost = replace(cost, distances=(Distance((0, 1), float(np.linalg.norm(apart)), 1e-5),))
    x = case.layout.values(found)
    data, held_cost = cost.of(x)
    independent = minimise(cost, case.truth)
    total = data + held_cost
    error, other = (miss(case, state) for state in (found, case.layout.state(independent.x[None])))
    # Errors of readings move the minimum for sockets, and what residuals see of size and turns is none of them: calib
    # does not end there, and costs are not quite alike.
    share = ALIKE if any(rows.kind == "socket" for rows in case.rows) else HIGHER
    higher = total > independent.total * (1.0 + share) + share
    worse = error > other * (1.0 + WORSE) + NOTHING
    lower = total < independent.total * (1.0 - HIGHER) - HIGHER
    outcome = {
        (False, False): "right",
        (True, False): "cost",
        (False, True): "other minimum" if lower else "tool",
        (True, True): "cost and tool",
    }[higher, worse]
    return Verdict(
        case.family,
        case.seed,
        outcome,
        case.numbers,
        len(case.truth),
        formal_rank(cost, case.truth),
        fit.rank,
        total,
        independent.total,
        data,
        independent.data,
        total - minimise(cost, x, 30).total if higher else 0.0,
        error * 1e3,
        other * 1e3,
        kinematics(case, fit, cost, x),
        fit.converged,
        fit.evaluations,
        seconds,
        independent.settled,
        said,
    )


def robots(name: str) -> bool:
    """Whether a parameter is one of the robot itself."""
    return not name.startswith(("base.", "tool.", "target."))


def stated(case: Case, fit: calib.Fit | None, holding: Holding) -> Cost:
    """The sum of squares that calib says it minimises: change it here where calib says something else.

    Noise that is not stated is the one that the fit has found, unless it is beyond all belief; then the truth's. Tool
    points are held where the search began.
    """
    layout = case.layout
    sigmas = list(case.sigmas)
    if fit is not None and not case.stated:
        for k, noise in enumerate(fit.noise):
            if noise.total <= CREDIBLE * case.sigmas[k]:
                sigmas[k] = max(noise.total, 1e-3 * case.sigmas[k])
    factor = 1.0 if holding == "stated" else WEAK
    origin, widths = np.zeros(len(layout.names)), np.full(len(layout.names), np.inf)
    begun = layout.values(layout.at if fit is None else _frames(layout, fit, nominal=True))
    for k, name in enumerate(layout.names):
        if robots(name):
            if case.priors is not None:
                widths[k] = case.priors[1 if layout.is_angle(name) else 0]
            elif name.endswith(".offset"):
                widths[k] = factor * (ZERO if layout.is_angle(name) else LENGTH)
            else:
                widths[k] = factor * (ANGLE if layout.is_angle(name) else LENGTH)
        elif name.startswith("tool.") and not layout.is_angle(name):
            origin[k], widths[k] = begun[k], factor * TOOL * layout.arm.reach
        else:
            # A trace of a hold, so that what nothing sees has a place.
            origin[k], widths[k] = begun[k], WEAK * layout.arm.reach
    return Cost(layout, case.rows, tuple(sigmas), case.distances, origin, widths)


def _frames(layout: Layout, fit: calib.Fit, *, nominal: bool = False) -> State:
    machine = fit.nominal if nominal else fit.machine
    at = layout.at
    known = dict(zip(fit.measurements[0].tools, machine.frames.tools, strict=True))
    tools = np.stack([known[name] for name in layout.tool_names])
    targets = at.targets
    if layout.target_names:
        seen = dict(zip(fit.measurements[0].targets, machine.frames.targets, strict=True))
        targets = np.stack([seen[name] for name in layout.target_names])[None]
    return State(at.deviations, at.offsets, machine.frames.base[None], tools[None], targets)


def state_of(layout: Layout, fit: calib.Fit) -> State:
    """The machine that calib found, by the names of its parameters and by its frames."""
    frames = _frames(layout, fit)
    d, o = frames.deviations.copy(), frames.offsets.copy()
    values = {parameter.name: float(v) for parameter, v in zip(fit.parameters, fit.values, strict=True)}
    for j, joint in enumerate(layout.arm.joints):
        for c, component in enumerate(("tx", "ty", "tz", "rx", "ry", "rz")):
            d[0, j, c] = values.get(f"{joint.name}.{component}", 0.0)
    for k, name in enumerate(layout.arm.ranges):
        o[0, k] = values.get(f"{name}.offset", 0.0)
    return State(d, o, frames.base, frames.tools, frames.targets)


def kinematics(case: Case, fit: calib.Fit, cost: Cost, x: Array) -> float:
    """How far calib's residuals are from independent ones of the same machine, in sigmas: rounding, or a mistake."""
    data = cost.whitened(x[None])[0][0]
    own = []
    for k, residual in enumerate(fit.residuals):
        if case.rows[k].kind == "pose":
            own += [residual[:, :3].ravel() / cost.sigmas[0], residual[:, 3:].ravel() / cost.sigmas[1]]
        else:
            own.append(residual.ravel() / cost.sigmas[k])
    every = np.concatenate(own)
    return float(np.max(np.abs(every - data[: len(every)])))


def miss(case: Case, state: State) -> float:
    """3D rms in m of the tool at new poses, beside what no data of the kind can see."""
    points = predict(case.layout.arm, state, case.unseen, case.unseen_tool)[0, :, :3, 3]
    true = case.true_points
    if case.aligned != "no":
        a, b = points - points.mean(axis=0), true - true.mean(axis=0)
        U, s, Vt = np.linalg.svd(a.T @ b)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        size = float(np.sum(s * sign) / np.sum(a * a)) if case.aligned == "similar" else 1.0
        points, true = size * a @ (U * sign) @ Vt, b
    return float(np.sqrt(np.mean(np.sum((points - true) ** 2, axis=1))))
