"""How often do stated 95 % regions hold the truth, where the model leaves things out? Simulated sessions by cells.

    python scripts/studies/coverage.py --store coverage.jsonl [--sessions 200] [--cells TEXT] [--minutes 30]
    python scripts/studies/coverage.py --store coverage.jsonl --page docs/coverage.md

A cell is one robot, one number of poses, and one thing that the model does not know of. Every session is one line of
the store; what is there already is not simulated again, so that the script may be stopped at any time, and started with
more sessions. The page tells how many there are of every cell.

The machines are made without the toolkit's mathematics: UR5 and Panda by scripts/development/judge_machines.py, which
walks the joints of the URDF in numpy, the IRB2400 by scripts/simulate/irb2400.py. Sockets and pixels are the families
of scripts/development/judge_cases.py.
"""

import argparse
import sys
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.chance import bound
from calib.job.inputs import load
from calib.machine.calibrated import CalibratedMachine
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_errors, tool_uncertainty
from calib.machine.uncertainty import CAUSES
from scripts.development.judge_cases import (
    SOCKETS_PRIOR,
    Errors,
    case,
    free_placements,
    known_arm,
    reading_columns,
    sockets,
)
from scripts.development.judge_machines import Arm, Array, State, placed, predict
from scripts.simulate.irb2400 import Machine, noise, poses, truth_text
from scripts.studies.irb2400_levels import CASE, CRANK, grid_of, measured
from scripts.studies.store import simulate, stored

SIGMA = 0.05e-3
UNSEEN = 100
PROBABILITY = 0.95
# One standard deviation of what the model knows of: lengths, angles and zeros.
LENGTH, ANGLE, ZERO = 0.5e-3, 1e-3, 5e-3
COMPLIANCE = {"wind_up": (1e-6, 5e-6), "strong_wind_up": (1e-5, 1e-4)}
MASS = 3.0
# Of numbers drawn evenly in logarithm over a factor of three, with their middle at one: the stated sigma is their rms.
RMS_OF_THREEFOLD = np.sqrt((3.0 - 1.0 / 3.0) / (2.0 * np.log(3.0)))
GROSS = (0.02, 1e-3, 20e-3)
SETS = ("base_fit", "level1", "level2", "nodes", "test")
FEWEST, NORMAL = 20, 1.959964

LEFT_OUT = {
    "white": "nothing",
    "zeros": "nothing, of machines whose joint offsets alone are off, and alone are sought",
    "harmonics_0.05": "joint harmonics of 0.05 mrad, two orders a joint",
    "harmonics_0.15": "joint harmonics of 0.15 mrad, two orders a joint",
    "wind_up": "wind-up under gravity, 1 to 5 urad/Nm",
    "strong_wind_up": "wind-up under gravity, 10 to 100 urad/Nm",
    "threefold": "noise that varies threefold from row to row, stated by its rms",
    "gross": "outliers of 1 to 20 mm in 2 % of the rows, fitted with Huber's loss",
    "drift": "a drift of the instrument, a random walk to three sigmas; the base aligned to the truth",
}
ROBOTS = {"ur5": "UR5", "panda": "Panda"}
OTHERS = {
    "irb2400 grid": "IRB2400 with wind-up, harmonics and scatter, three levels and a grid",
    "panda sockets": "Panda, 20 to 30 touches of sockets, right priors stated; set-up aligned, nothing left out",
    "ur5 pixels": "UR5, 20 to 30 images of a board; set-up aligned, nothing left out",
}
SIZES = (20, 60, 200)


@dataclass(frozen=True)
class Told:
    """One session: ``inside`` of the regions, rms of true errors and of stated ones, in m; ``intervals`` that hold."""

    inside: float
    true: float
    stated: float
    causes: Mapping[str, float]
    intervals: Mapping[str, bool]


def cells() -> list[str]:
    """Names of all cells."""
    tracked = [f"{robot} {kind} {n}" for kind in LEFT_OUT for n in SIZES for robot in ROBOTS]
    return [*tracked, *OTHERS]


HEAD = (
    "| | sessions | coverage | below 0.75 | true [mm] | stated [mm] | ratio | median ratio | holds |",
    "|---|--:|--:|--:|--:|--:|--:|--:|---|",
)
LEAST_COVERAGE, BAD, MOST_BAD, RATIOS = 0.90, 0.75, 0.10, (0.8, 1.6)
PAGE = """# Do stated regions hold the truth, where the model leaves things out?

Made by `python scripts/studies/coverage.py`, whose first lines say how. There are
{total} simulated sessions in {cells} cells, {least} in the one with the fewest; the column `sessions` says how many
there are of each. {refused} were refused by the toolkit. The simulations share no mathematics with it.

In a session, a robot is measured at random poses by an instrument that states its noise, 0.05 mm a coordinate. The
robot has errors that the model knows of (0.5 mm, 1 mrad, joint offsets of 5 mrad: one standard deviation; all
placements and offsets are free, base and tool are anywhere). It also has errors that the model leaves out, one kind
in every table below. At 100 other poses the true position of the tool is compared with the stated 95 % region, an
ellipsoid (`calib.judging.tool_uncertainty`).

* `coverage`: share of true positions inside the region, mean over sessions; `below 0.75`: share of sessions with a
  coverage below that.
* `true` and `stated`: rms of the error of the position, and of its stated standard deviation, over poses and sessions;
  `ratio`: stated over true; `median ratio`: median of the ratios of single sessions.
* `holds`: coverage at least 0.90, at most one session in ten below 0.75, ratio from 0.8 to 1.6; for a drift there is no
  upper limit of the ratio.
"""
INTERVALS = """A few touches of sockets leave many directions to the stated priors, which are used as stated: the
machines are drawn with these standard deviations. For machines nearer to nominal than that, regions are wider than the
errors by as much. Images of one board leave many directions to the weak priors. Their widths are learned from what the
images do determine: these machines are off by 0 to 5 mm, 0 to 5 mrad and, in their joint offsets, by up to 6 deg.

On {n} IRB2400 with wind-up and harmonics that the model does not have, the 95 % interval of k1 by the
parameters' own sigmas holds the truth {k1} times, that of k2 {k2} times: such sigmas are conditional on the model, and
are labelled so wherever they are printed. By the covariance of the machine in `uncertainty.json`, which has the whole
budget, the interval of k1 holds the truth {k1_budget} times and that of k2 {k2_budget} times.
"""


class Figures(NamedTuple):
    """What is told of a cell: mean coverage, share of bad sessions, rms of true and stated errors, the median ratio."""

    inside: float
    bad: float
    true: float
    stated: float
    middle: float

    @property
    def ratio(self) -> float:
        """Stated over true."""
        return self.stated / self.true


# ---- what the model does not know of


def harmonics(rng: np.random.Generator, readings: Array, amplitude: float) -> Array:
    """What every reading is off by (N, k): a wave of the encoder, order 1 or 2, and one of its gears."""
    found = np.zeros_like(readings)
    for k in range(readings.shape[1]):
        for order in (rng.choice([1, 2]), rng.choice([2, 3, 5, 11])):
            found[:, k] += amplitude * np.cos(order * readings[:, k] + rng.uniform(0.0, 2.0 * np.pi))
    return found


def torques(found: Arm, readings: Array) -> Array:
    """What gravity makes every joint hold (N, k), Nm: each link weighs MASS, halfway to the next joint."""
    q = [
        np.zeros(len(readings)) if j.kind == "fixed" else readings[:, found.free.index(j.driver)] for j in found.joints
    ]
    frames = found._walk([joint.origin for joint in found.joints], [v[None] for v in q])
    frames = [np.broadcast_to(T, (1, len(readings), 4, 4))[0] for T in frames]
    links = [frames[j] for j in found.moving if found.joints[j].kind == "revolute"]
    ends = [*links[1:], frames[found.tip[0]] @ found.tip[1]]
    centres = [0.5 * (a + b)[:, :3, 3] for a, b in zip(links, ends, strict=True)]
    weight = np.array([0.0, 0.0, -9.81 * MASS])
    return np.stack(
        [
            sum(np.einsum("ni,ni->n", T[:, :3, 2], np.cross(c - T[:, :3, 3], weight)) for c in centres[k:])
            for k, T in enumerate(links)
        ],
        axis=1,
    )


# ---- sessions


def tracked(robot: str, kind: str, n: int, seed: int) -> Told:
    """A session of positions from an instrument that states its noise."""
    rng = np.random.default_rng([seed, n, *robot.encode(), *kind.encode()])
    found, arm = known_arm(robot)
    names = () if kind == "zeros" else free_placements(robot, found)
    components = ("tx", "ty", "tz", "rx", "ry", "rz")
    free = np.array([[f"{joint.name}.{c}" in names for c in components] for joint in found.joints])
    deviations = free * rng.normal(scale=np.repeat((LENGTH, ANGLE), 3), size=free.shape)
    offsets = rng.normal(scale=ZERO, size=len(found.ranges))
    base = placed(Rotation.random(rng=rng).as_matrix(), rng.uniform(-2.0, 2.0, 3))
    tool = placed(np.eye(3), np.array([0.05, 0.03, 0.12]) + rng.normal(scale=0.01, size=3))
    true = State(deviations[None], offsets[None], base[None], tool[None, None], np.zeros((1, 0, 4, 4)))
    q = found.draw(rng, n + UNSEEN)
    off = np.zeros_like(q)
    if kind.startswith("harmonics"):
        off = harmonics(rng, q, 1e-3 * float(kind.split("_")[1]))
    if kind in COMPLIANCE:
        revolute = [k for k, name in enumerate(found.ranges) if arm.readings[k].dimension == "angle"]
        off[:, revolute] = rng.uniform(*COMPLIANCE[kind], len(revolute)) * torques(found, q)
    position = predict(found, true, q + off, np.zeros(len(q), dtype=np.intp))[0, :, :3, 3]
    sigma = SIGMA * np.ones((n, 1))
    if kind == "threefold":
        sigma = SIGMA * np.exp(rng.uniform(-0.5, 0.5, (n, 1)) * np.log(3.0)) / RMS_OF_THREEFOLD
    seen = position[:n] + sigma * rng.standard_normal((n, 3))
    if kind == "drift":
        seen += np.cumsum(rng.standard_normal((n, 3)), axis=0) * 3.0 * SIGMA / np.sqrt(n)
    if kind == "gross":
        hit = rng.random(n) < GROSS[0]
        way = rng.standard_normal((n, 3))
        way *= (rng.uniform(*GROSS[1:], n) / np.linalg.norm(way, axis=1))[:, None]
        seen += hit[:, None] * way
    columns = reading_columns(found, q[:n]) | {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, arm, sigma=SIGMA)
    chosen = "none" if kind == "zeros" else "all"
    model = calib.error_model(arm, offsets="all", placements=chosen, base="pose", tool="position")
    fit = calib.identify(model, data, losses=["huber"] if kind == "gross" else None)
    return judged(machine_of(fit), q[n:], position[n:], "rigid" if kind == "drift" else "no")


def irb2400(seed: int) -> Told:
    """The job of robots/irb2400 on a machine of its own; the truth is where the reflector comes to rest."""
    job = load(CASE / "calibration.toml")
    truth, commands = Machine(seed), poses(seed)
    data = {n: measured(job.model.robot, commands[n], truth.measure(commands[n], noise(seed, n))) for n in SETS}
    fit = None
    for level in job.job.levels[:-1]:
        sets = [data[Path(file).stem] for file in level.measurements or ()]
        fit = calib.identify(job.model, sets, free=level.free, start=fit)
    assert fit is not None, "the job has levels"
    machine = machine_of(fit)
    grid = grid_of(fit, data["nodes"])
    q, rest = data["test"].readings, 1e-3 * truth.tcp(commands["test"], np.random.default_rng([seed, 9]))
    inside = np.array([not why for why in grid.outside(q)])
    told = judged(replace(machine, residual_model=grid), q[inside], rest[inside], "no")
    return replace(told, intervals=four_bar(truth, fit, machine))


def four_bar(truth: Machine, fit: calib.Fit, machine: CalibratedMachine) -> dict[str, bool]:
    """Whether the 95 % intervals of k1 and k2 hold the truth: of the fit's parameters, and with all of the budget."""
    chain = [joint.name for joint in fit.robot.chain]
    entries = {"elbow_cancel": 0, "rod_length": 2, "rear_lever_length": 0}
    places = {joint: 6 * chain.index(joint) + c for joint, c in entries.items()}
    names = [parameter.name for parameter in fit.parameters]
    own = {joint: names.index(f"{joint}.{('tx', 'ty', 'tz')[c]}") for joint, c in entries.items()}
    told = tomllib.loads(truth_text(truth))["four_bar"]
    factor, found = machine.known_uncertainty.factor, {}
    # Of the four lengths only two differences show. The rear lever points to -x, the crank is held at its length.
    for name, shares in (("k1", {"elbow_cancel": 1.0, "rod_length": -1.0}), ("k2", {"rear_lever_length": -1.0})):
        by_fit, by_state = np.zeros(len(names)), np.zeros(len(machine.known_uncertainty.factor))
        for joint, share in shares.items():
            by_fit[own[joint]] = by_state[places[joint]] = share / CRANK
        error = abs(by_fit @ fit.values - 1e-6 * told[f"{name}_urad"])
        found[name] = bool(error < NORMAL * np.sqrt(by_fit @ fit.covariance @ by_fit))
        found[f"{name} with the budget"] = bool(error < NORMAL * np.linalg.norm(by_state @ factor))
    return found


def other(family: str, seed: int) -> Told:
    """A session of another way to measure: the first of its thousand with twenty rows, and priors for sockets.

    These machines are as far from nominal as the priors say: evenly distributed, with the stated standard deviations.
    """
    length, angle = np.sqrt(3.0) * np.array(SOCKETS_PRIOR)
    for k in range(1000):
        number = 1000 * seed + k
        told = sockets(number, Errors(angle, length, angle)) if family == "sockets" else case(number, family)
        if told.label["rows"] >= FEWEST and told.label.get("prior", True):
            break
    machine = machine_of(calib.identify(told.model, told.data))
    return judged(machine, told.unseen, told.true_points, told.aligned)


def judged(machine: CalibratedMachine, readings: Array, true: Array, aligned: str) -> Told:
    """Hold what a machine says of itself against the truth (N, 3)."""
    tool = next(iter(machine.tools))
    said = tool_uncertainty(machine, readings, tool)
    errors = machine.predict(readings, tool=tool)[:, :3, 3] - true
    covariance = said.covariance[:, :3, :3]
    if aligned != "no":
        # Turns, shifts and, for "similar", growth: what no data of the kind see, neither in errors nor in doubts.
        about = true - true.mean(axis=0)
        moves = np.zeros((len(true), 3, 7))
        moves[:, :, :3] = np.eye(3)
        moves[:, :, 3:6] = np.stack([np.cross(axis, about) for axis in np.eye(3)], axis=2)
        moves[:, :, 6] = about
        B, _ = np.linalg.qr(moves[:, :, : 7 if aligned == "similar" else 6].reshape(errors.size, -1))
        factor = tool_errors(machine, readings, tool)[:, :3]
        scatter = covariance - factor @ np.swapaxes(factor, 1, 2)
        flat, e = factor.reshape(errors.size, -1), errors.ravel()
        factor = (flat - B @ (B.T @ flat)).reshape(factor.shape)
        errors = (e - B @ (B.T @ e)).reshape(errors.shape)
        covariance = factor @ np.swapaxes(factor, 1, 2) + scatter
    distance = np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[:, :, None])[..., 0])
    inside = distance <= bound(PROBABILITY, 3, said.degrees_of_freedom)
    return Told(
        float(np.mean(inside)),
        float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
        float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))),
        {cause: float(np.sqrt(np.mean(said.budget[cause][:, 0] ** 2))) for cause in CAUSES},
        {},
    )


def session(cell: str, seed: int) -> Told:
    """The session of a seed in a cell."""
    robot, kind, *size = cell.split()
    if size:
        return tracked(robot, kind, int(size[0]), seed)
    return irb2400(seed) if robot == "irb2400" else other(kind, seed)


def figures(cell: str, seed: int) -> dict[str, Any]:
    """The session of a seed in a cell, as a store has it."""
    return vars(session(cell, seed))


# ---- the store and the page


def wanting(figures: Figures, capped: bool) -> str:
    """What a cell lacks of what is asked, or "yes"."""
    lacks = [
        *(["coverage"] if figures.inside < LEAST_COVERAGE else []),
        *(["bad sessions"] if figures.bad > MOST_BAD else []),
        *(["too narrow"] if figures.ratio < RATIOS[0] else []),
        *(["too wide"] if capped and figures.ratio > RATIOS[1] else []),
    ]
    return "no: " + ", ".join(lacks) if lacks else "yes"


def figures_of(told: list[dict[str, Any]]) -> Figures:
    """The figures of a cell with a session or more."""
    inside, true, stated = (np.array([t[name] for t in told]) for name in ("inside", "true", "stated"))
    rms = [float(np.sqrt(np.mean(x**2))) for x in (true, stated)]
    bad = float(np.mean(inside < BAD))
    return Figures(float(inside.mean()), bad, rms[0], rms[1], float(np.median(stated / true)))


def row(title: str, told: list[dict[str, Any]], *, capped: bool = True) -> str:
    """A line of a table of the page."""
    counted = [t for t in told if "refused" not in t]
    if not counted:
        return f"| {title} | 0 | | | | | | | not run |"
    f = figures_of(counted)
    return (
        f"| {title} | {len(counted)} | {f.inside:.3f} | {100.0 * f.bad:.1f} % | {1e3 * f.true:.3f} | "
        f"{1e3 * f.stated:.3f} | {f.ratio:.2f} | {f.middle:.2f} | {wanting(f, capped)} |"
    )


def page(told: Mapping[str, list[dict[str, Any]]]) -> str:
    """The page of what the store has."""
    counts = [sum("refused" not in t for t in sessions) for sessions in told.values()]
    refused = sum("refused" in t for sessions in told.values() for t in sessions)
    lines = [PAGE.format(total=sum(counts), cells=len(counts), least=min(counts), refused=refused)]
    for kind, title in LEFT_OUT.items():
        lines += [f"## Left out: {title}", "", *HEAD]
        for robot, name in ROBOTS.items():
            sizes = [(f"{name}, {n} poses", told[f"{robot} {kind} {n}"]) for n in SIZES]
            lines += [row(size, sessions, capped=kind != "drift") for size, sessions in sizes]
        lines.append("")
    lines += ["## Other ways to measure", "", *HEAD, *(row(title, told[cell]) for cell, title in OTHERS.items()), ""]
    arms = [t["intervals"] for t in told["irb2400 grid"] if "refused" not in t]
    if arms:
        held = {name: sum(arm[name] for arm in arms) for name in arms[0]}
        lines += [
            INTERVALS.format(
                n=len(arms),
                k1=held["k1"],
                k2=held["k2"],
                k1_budget=held["k1 with the budget"],
                k2_budget=held["k2 with the budget"],
            )
        ]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--cells", default="", help="only those whose name has this")
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    if arguments.page is None:
        chosen = [cell for cell in cells() if arguments.cells in cell]
        until = time.monotonic() + 60.0 * arguments.minutes
        simulate(arguments.store, chosen, arguments.sessions, until, figures)
    text = page(stored(arguments.store, cells()))
    if arguments.page is not None:
        arguments.page.write_text(text, encoding="utf-8", newline="\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
