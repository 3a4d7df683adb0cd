"""How fast is the core, measured against the least that any such program must do?

    python scripts/benchmarks/benchmark.py [--check] [--markdown FILE] [--rounds 7] [--largest 100000]

The yardstick is the bare Pinocchio loop: forward kinematics, frame placement and kinematic regressor of a UR10, once
per pose. All other times are told as multiples of it; every round measures all of them in turn, and the median of the
rounds' ratios counts, so that a busy machine slows both sides alike. `--check` exits with 1 when a limit is exceeded.
"""

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

import calib
from calib.foundations import rigid
from calib.foundations.linear import one_thread
from calib.identification import system
from calib.identification.machine import Machine, values_at
from calib.identification.parameters import scales
from calib.identification.system import Problem
from calib.robot.sources import resolve

Array = NDArray[np.float64]

URDF = "example:ur_description/urdf/ur10_robot.urdf"
TIP = "tool0"
POSES = 1000
SIGMA, SIGMA_ANGLE = 0.05e-3, 0.1e-3

# Multiples of the bare loop over as many poses: the limits that this project sets itself.
LIMIT_SYSTEM = 4.0
LIMIT_IDENTIFY = 80.0
LIMIT_EVALUATIONS = 6
# Time per pose of the largest problem over that of 1000 poses.
LIMIT_GROWTH = 1.5


@dataclass(frozen=True)
class Case:
    """One machine with known errors, seen by a tracker."""

    model: calib.ErrorModel
    data: calib.Measurements
    unseen: Array
    truth: Array

    def miss(self, machine: Machine) -> float:
        """3D rms in mm between predicted and true tool points at unseen poses."""
        return 1e3 * float(
            np.sqrt(np.mean(np.sum((tool_points(self.model.robot, self.unseen, machine) - self.truth) ** 2, axis=1)))
        )


@dataclass(frozen=True)
class Line:
    """A line of the table; ``limit`` None where nothing is promised."""

    what: str
    milliseconds: float
    value: float
    unit: str = "x bare"
    limit: float | None = None

    @property
    def good(self) -> bool:
        return self.limit is None or self.value <= self.limit


# ---- the work


def tool_points(robot: calib.Robot, readings: Array, machine: Machine) -> Array:
    return (machine.frames.base @ robot.tips(readings, machine.deviations) @ machine.frames.tools[0])[:, :3, 3]


def case(poses: int, observes: str) -> Case:
    """UR10, every placement off by 0.5 mm and 1 mrad, zeros by 5 mrad; base and tool unknown."""
    rng = np.random.default_rng(1)
    robot = calib.load_robot(URDF, tip=TIP)
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose" if observes == "pose" else "position")
    deviations = calib.Deviations(
        rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(len(robot.chain), 6)), rng.normal(scale=5e-3, size=6)
    )
    base = rigid.placement(rigid.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-3.0, 3.0, 3))
    tool = rigid.translation(np.array([0.05, 0.02, 0.15]))

    def seen(readings: Array) -> Array:
        return base @ robot.tips(readings, deviations) @ tool

    readings, unseen = (rng.uniform(-np.pi, np.pi, (n, 6)) for n in (poses, 500))
    truth = seen(readings)
    measured = truth[:, :3, 3] + rng.normal(scale=SIGMA, size=(poses, 3))
    columns: dict[str, Array] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": measured[:, k] for k, axis in enumerate("xyz")}
    if observes == "pose":
        turned = truth[:, :3, :3] @ rigid.exp3(rng.normal(scale=SIGMA_ANGLE, size=(poses, 3)))
        columns |= dict(zip(("qw", "qx", "qy", "qz"), rigid.quaternion_of(turned).T, strict=True))
    data = calib.read_measurements(columns, robot, observes, sigma=(SIGMA, SIGMA_ANGLE if observes == "pose" else None))
    return Case(model, data, unseen, seen(unseen)[:, :3, 3])


def bare_loop() -> Callable[[Array], None]:
    """What nobody can do without: once per pose, nothing kept."""
    model = pin.buildModelFromUrdf(str(resolve(URDF)))
    data, frame = model.createData(), model.getFrameId(TIP)
    forward, update, compute = pin.forwardKinematics, pin.updateFramePlacement, pin.computeFrameKinematicRegressor
    local = pin.ReferenceFrame.LOCAL

    def loop(readings: Array) -> None:
        for q in readings:
            forward(model, data, q)
            update(model, data, frame)
            compute(model, data, frame, local)

    return loop


def finite_differences(c: Case, problem: Problem, x0: Array) -> Array:
    """The same fit as anyone would write it first: residuals, and SciPy's 2-point differences of them.

    It gets what it would not have of itself: good start values, scaled parameters, and priors so wide that they matter
    only in the null space.
    """
    s, robot = scales(problem.parameters), c.model.robot

    def residual(z: Array) -> Array:
        (r,) = system.residuals(robot, (c.data,), problem.machine(z * s))
        return np.concatenate([(r / c.data.sigma).ravel(), 1e-3 * (z - x0 / s)])

    return np.asarray(least_squares(residual, x0 / s, method="trf", x_scale="jac", xtol=1e-8, ftol=1e-10).x * s)


# ---- the measuring


def timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def interleaved(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Seconds of every work in every round; one round before them is for warming up."""
    found: dict[str, list[float]] = {name: [] for name in works}
    for k in range(rounds + 1):
        for name, work in works.items():
            seconds = timed(work)
            if k > 0:
                found[name].append(seconds)
    return found


def lines_of(observes: str, rounds: int, bare: Callable[[Array], None]) -> list[Line]:
    """Cost of one residual and Jacobian, of an identification, and of one by finite differences."""
    c = case(POSES, observes)
    fit = calib.identify(c.model, c.data)
    problem = Problem(c.model, fit.parameters, fit.nominal.frames, fit.measurements)
    x0 = values_at(c.model.robot, fit.parameters, fit.nominal.frames)
    units = scales(problem.parameters)
    works = {
        "bare": lambda: bare(c.data.readings),
        "jacobian": lambda: [None for _ in system.blocks(problem, c.data, problem.machine(fit.values), units)],
        "evaluate": lambda: system.evaluate(problem, [c.data.sigma], fit.values),
        "identify": lambda: calib.identify(c.model, c.data),
    }
    seconds = interleaved(works, rounds)
    # Once is enough for what takes a hundred times longer.
    found: list[Array] = []
    plain = timed(lambda: found.append(finite_differences(c, problem, x0)))
    bare_median = median(seconds["bare"])

    def line(what: str, name: str, limit: float | None) -> Line:
        ratio = median(t / b for t, b in zip(seconds[name], seconds["bare"], strict=True))
        return Line(f"{observes}: {what}", 1e3 * median(seconds[name]), ratio, limit=limit)

    return [
        Line(f"{observes}: bare Pinocchio loop", 1e3 * bare_median, 1.0),
        line("residual and Jacobian, block by block", "jacobian", LIMIT_SYSTEM),
        line("the same, whitened and reduced to a triangle", "evaluate", None),
        line("identify, start included", "identify", LIMIT_IDENTIFY),
        Line(f"{observes}: evaluations of residual and Jacobian", np.nan, fit.evaluations, "", LIMIT_EVALUATIONS),
        Line(f"{observes}: error at unseen poses", np.nan, c.miss(fit.machine), "mm"),
        Line(f"{observes}: least_squares with 2-point differences", 1e3 * plain, plain / bare_median),
        Line(f"{observes}: its error at unseen poses", np.nan, c.miss(problem.machine(found[0])), "mm"),
    ]


def growth(largest: int, rounds: int, bare: Callable[[Array], None]) -> list[Line]:
    """Identification of more and more poses."""
    sizes = [n for n in (1_000, 10_000, 100_000) if n <= largest]
    per_pose: list[float] = []
    lines: list[Line] = []
    for n in sizes:
        c = case(n, "position")
        works = {"bare": lambda c=c: bare(c.data.readings), "identify": lambda c=c: calib.identify(c.model, c.data)}
        seconds = interleaved(works, rounds if n < 100_000 else 1)
        ratio = median(t / b for t, b in zip(seconds["identify"], seconds["bare"], strict=True))
        per_pose.append(ratio)
        lines.append(Line(f"identify {n:,} positions", 1e3 * median(seconds["identify"]), ratio, limit=LIMIT_IDENTIFY))
    worst = max(per_pose) / per_pose[0]
    return [*lines, Line("cost per pose, the dearest over 1,000 poses", np.nan, worst, "x", LIMIT_GROWTH)]


# ---- the telling


def show(lines: list[Line], console: Console) -> None:
    table = Table(title=f"UR10, {POSES} poses, every placement, zero, base and tool free")
    for heading, justify in (("what", "left"), ("ms", "right"), ("value", "right"), ("limit", "right")):
        table.add_column(heading, justify=justify)
    for line in lines:
        style = None if line.limit is None else "green" if line.good else "bold red"
        table.add_row(*cells(line), style=style)
    console.print(table)


def cells(line: Line) -> tuple[str, str, str, str]:
    milliseconds = "" if np.isnan(line.milliseconds) else f"{line.milliseconds:,.1f}"
    digits = ".4f" if line.unit == "mm" else ".0f" if line.unit == "" else ".2f" if line.value < 100 else ",.0f"
    return (
        line.what,
        milliseconds,
        f"{line.value:{digits}} {line.unit}".strip(),
        "" if line.limit is None else f"{line.limit:g}",
    )


PAGE = """# What it costs

Made by `python scripts/benchmarks/benchmark.py --markdown docs/benchmark.md`, one BLAS thread, on {machine}.

A UR10 of which every placement is off by 0.5 mm and 1 mrad and every zero by 5 mrad; all of them, base and tool are
identified from {poses} simulated positions or poses. The yardstick is the bare Pinocchio loop: forward kinematics,
frame placement and kinematic regressor once per pose, nothing kept. All ratios are medians over rounds in which every
work takes its turn. The least-squares fit by 2-point differences is what one would write first: it is given our start
values, scales and wide priors.

"""


def markdown(lines: list[Line]) -> str:
    rows = ["| what | ms | value | limit |", "|---|--:|--:|--:|"]
    libraries = ", ".join(f"{name} {version(name)}" for name in ("pin", "numpy", "scipy"))
    machine = f"{os.cpu_count()} cores of {platform.machine()}, Python {platform.python_version()}, {libraries}"
    table = "\n".join([*rows, *(f"| {' | '.join(cells(line))} |" for line in lines), ""])
    return PAGE.format(machine=machine, poses=POSES) + table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit with 1 when a limit is exceeded")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table to FILE")
    parser.add_argument("--rounds", type=int, default=7, help="how often each time is taken (default: 7)")
    parser.add_argument("--largest", type=int, default=100_000, help="the largest problem (default: 100000 poses)")
    arguments = parser.parse_args()

    bare = bare_loop()
    with one_thread():
        lines = [
            *lines_of("position", arguments.rounds, bare),
            *lines_of("pose", arguments.rounds, bare),
            *growth(arguments.largest, arguments.rounds, bare),
        ]
    show(lines, Console())
    if arguments.markdown is not None:
        arguments.markdown.write_text(markdown(lines), encoding="utf-8")
    exceeded = [line.what for line in lines if not line.good]
    if exceeded:
        print(f"Beyond the limit: {'; '.join(exceeded)}.", file=sys.stderr)
    return 1 if arguments.check and exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
