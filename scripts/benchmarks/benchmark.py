"""How fast is the core, measured against the least that any such program must do?

    python scripts/benchmarks/benchmark.py [--check] [--markdown FILE] [--rounds 7] [--largest 100000]
                                           [--eigen FOLDER] [--build FOLDER]

The yardstick of a residual and its Jacobian is a loop in C++ over Pinocchio that makes the same numbers; beside it are
plain NumPy over blocks of rows, and Pinocchio called from Python. It is built where g++ and the headers of Pinocchio's
wheel and of Eigen are found (`--eigen`: the folder that holds `Eigen/`); where not, the script says so. Whole
identifications are told as multiples of the bare loop in Python: forward kinematics, frame placement and kinematic
regressor of a UR10, once per pose.

Times are processor times; every round measures all of them in turn, and the median of the rounds' ratios counts, so
that a busy machine slows both sides alike. `--check` exits with 1 when a limit is exceeded.
"""

import argparse
import ctypes
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

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.foundations import rigid
from calib.foundations.linear import one_thread
from calib.identification import system
from calib.identification.machine import Machine, values_at
from calib.identification.parameters import scales
from calib.identification.system import Problem
from calib.robot.sources import resolve
from scripts.benchmarks import yardsticks

Array = NDArray[np.float64]

URDF = "example:ur_description/urdf/ur10_robot.urdf"
TIP = "tool0"
POSES = 1000
SIGMA, SIGMA_ANGLE = 0.05e-3, 0.1e-3

# Multiples of the loop in C++, and of the bare loop over as many poses: the limits that this project sets itself.
LIMIT_SYSTEM = 4.0
LIMIT_IDENTIFY = 80.0
LIMIT_EVALUATIONS = 6
# So few rows that calls cost more than numbers, and what is told of these.
FEW = 100
KNOWN = "ours, the machine being known"
# By line and rows, as multiples of the loop in C++.
LIMITS = {("ours", 10_000): 2.5, ("ours", FEW): 3.0}
PARTS = ("NumPy alone, frames being known", KNOWN, "ours, a single one of the rows")
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
    start = time.process_time()
    work()
    return time.process_time() - start


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
        "jacobian": lambda: [None for _ in problem.rates(problem.machine(fit.values), units).blocks(c.data)],
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


def kernels(largest: int, rounds: int, bare: Callable[[Array], None], library: ctypes.CDLL | None) -> list[Line]:
    """Residual and Jacobian of more and more rows, beside the same by others; multiples of C++ where there is one."""
    lines: list[Line] = []
    for observes in ("position", "pose"):
        for n in (n for n in (100, 1_000, 10_000, 100_000) if n <= largest):
            c = case(n, observes)
            fit = calib.identify(c.model, c.data)
            problem = Problem(c.model, fit.parameters, fit.nominal.frames, fit.measurements)
            units = scales(problem.parameters)

            def ours(p: Problem = problem, x: Array = fit.values, u: Array = units) -> None:
                for _ in p.rates(p.machine(x), u).blocks(p.measurements[0]):
                    pass

            plain = yardsticks.plain(problem, problem.measurements[0], problem.machine(fit.values), units)
            works: dict[str, Callable[[], object]] = {
                "ours": ours,
                "plain NumPy, in blocks": lambda p=plain: yardsticks.in_blocks(p),
                "bare Pinocchio loop in Python": lambda c=c: bare(c.data.readings),
            }
            unit = "bare Pinocchio loop in Python"
            if library is not None:
                loop, unit = yardsticks.Loop(library, plain), "loop in C++"
                works |= {unit: loop, "loop in C++, kinematics alone": loop.kinematics}
            refuse_other(works, plain, problem, fit.values, units)
            if n == FEW:
                works |= parts(problem, plain, fit.values, units)
            seconds = interleaved(works, max(rounds, 10_000 // n) if n < 100_000 else 3)
            for name in ("loop in C++, kinematics alone", "loop in C++", *list(works)[1:3], "ours", *PARTS):
                if name in works:
                    ratio = median(t / b for t, b in zip(seconds[name], seconds[unit], strict=True))
                    limit = LIMITS.get((name, n))
                    what = f"{observes}, {n:,} rows: {name}"
                    lines.append(Line(what, 1e3 * median(seconds[name]), ratio, f"x {unit.split()[-1]}", limit))
    return lines


def parts(problem: Problem, plain: yardsticks.Plain, x: Array, units: Array) -> dict[str, Callable[[], object]]:
    """What few rows cost: Pinocchio's calls, the fewest of NumPy, and what of ours does not depend on the rows."""
    data, there = problem.measurements[0], yardsticks.walked(plain)
    first = data.subset([0])

    def machine() -> None:
        # What no row is needed for is made with the first one.
        next(problem.rates(problem.machine(x), units).blocks(first))

    known = problem.rates(problem.machine(x), units)
    works = (lambda: yardsticks.from_frames(plain, there), lambda: list(known.blocks(data)), machine)
    return dict(zip(PARTS, works, strict=True))


def refuse_other(works: dict[str, Callable[[], object]], plain: object, problem: Problem, x: Array, u: Array) -> None:
    """Hold the yardsticks against our own answer: what does other work is none."""
    found = list(problem.rates(problem.machine(x), u).blocks(problem.measurements[0]))
    own = np.concatenate([b.observed.residual for b in found]), np.concatenate([b.J for b in found])
    answers = [lambda: yardsticks.batched(plain)] + [w for w in works.values() if isinstance(w, yardsticks.Loop)]
    if (worst := max(yardsticks.same(answer, own) for answer in answers)) > 1e-7:
        raise SystemExit(f"a yardstick differs from what it is to measure by {worst:.1e} of the largest number")


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
    table = Table(title=f"UR10, {POSES} poses, every placement, offset, base and tool free")
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

A UR10 with placements that are off by 0.5 mm and 1 mrad, and joint offsets of 5 mrad; all of them, base and tool are
identified from simulated positions or poses. Times are of the processor, ratios medians over rounds in which every work
takes its turn.

The first lines are of one residual and Jacobian at so many rows. The least that such a program must do is a loop in
C++ over Pinocchio's own functions that makes the same numbers: forward kinematics, frame placement and kinematic
regressor, then residual and derivatives by all unknowns. It, and plain NumPy that knows this one kind of machine alone,
are held against our answer before they are timed. Kinematics alone, in C++ and in Python, keep nothing of what they
find.

Of 100 rows calls cost more than numbers, so that some lines tell parts: what NumPy needs at least where Pinocchio has
left all frames; ours where the machine was made of its parameters before, which is the work that plain NumPy and the
loop in C++ do; and ours of a single row, for which every call is made that all rows need, with those of Pinocchio once.

The rest is of {poses} rows where nothing else is said, as multiples of the bare Pinocchio loop in Python. The
least-squares fit by 2-point differences is what one would write first: it is given our start values, scales and wide
priors.

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
    parser.add_argument("--eigen", type=Path, metavar="FOLDER", help="where Eigen's headers are")
    parser.add_argument("--build", type=Path, metavar="FOLDER", help="where the loop in C++ is built, and kept")
    arguments = parser.parse_args()

    bare, library = bare_loop(), yardsticks.compiled(arguments.eigen, arguments.build)
    if isinstance(library, str):
        print(f"{library}.", file=sys.stderr)
    with one_thread():
        lines = [
            *kernels(arguments.largest, arguments.rounds, bare, None if isinstance(library, str) else library),
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
