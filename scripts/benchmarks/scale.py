"""What do many poses cost? Time and memory of identifications of a 7-joint arm, each in a process of its own.

    python scripts/benchmarks/scale.py [--check] [--markdown FILE] [--largest 1000000]
    python scripts/benchmarks/scale.py --targets [--check] [--markdown FILE]
    python scripts/benchmarks/scale.py --setups [--check] [--markdown FILE]

The second form is about lengths to many anchors in unknown places, the third about an arm that stands in many places,
and about a camera on it that sees many boards. Their times are the processor's, which others who use
the machine hardly change. Memory is the peak resident set of the whole process, libraries and data included. `--check`
exits with 1 when anything takes more than 2 GiB, or anchors more than two minutes.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import calib
from calib.foundations import rigid
from calib.identification.initialisation import problem as initialisation
from calib.measuring import Camera

SIZES = (1_000, 10_000, 100_000, 1_000_000)
# Anchors in unknown places, each with so many lengths.
ANCHORS, LENGTHS = (10, 100, 300, 1_000, 10_000), 8
# Set-ups, each with so many positions, and boards, each in so many photographs of so many marks.
SETUPS, POSITIONS = (10, 100, 300, 1_000), 9
BOARDS, PHOTOGRAPHS, MARKS, APART = (10, 30, 100, 300), 4, (4, 3), 0.04
# What every mark errs by itself, in px, and what an arm does not repeat in every photograph, in m and rad.
PIXEL, REPEATS = 0.1, (0.1e-3, 0.3e-3)
SIGMA = 0.05e-3
LIMIT_MIB, LIMIT_SECONDS = 2048.0, 120.0
# Lengths that nothing but noise disturbs scatter by less than so many times the noise that is stated.
EXPLAINED = 1.1
AT_ONCE = 10_000

JOB = """schema = 1
[robot]
urdf = "example:panda_description/urdf/panda.urdf"
tip = "panda_link8"
[error_model]
offsets = "all"
placements = "all"
base = "pose"
tool = "{tool}"
[[measurements]]
file = "poses.csv"
observes = "{observes}"
sigma = "0.05 mm"
"""


@dataclass(frozen=True)
class Cost:
    """Seconds and MiB of one run; ``loaded`` is the peak before anything is identified, the data in memory."""

    what: str
    poses: int
    seconds: float
    loaded: float
    peak: float


def peak() -> float:
    """Peak resident set of this process so far, in MiB."""
    found = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return found / (2**20 if sys.platform == "darwin" else 2**10)


def columns(robot: calib.Robot, poses: int, observes: str) -> dict[str, np.ndarray]:
    """A Panda of which every placement is off by 0.5 mm and 1 mrad and every zero by 5 mrad, seen by a tracker."""
    rng = np.random.default_rng(1)
    deviations = calib.Deviations(
        rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(len(robot.chain), 6)),
        rng.normal(scale=5e-3, size=len(robot.moving)),
    )
    tool = rigid.translation(np.array([0.05, 0.02, 0.15]))
    readings = np.stack([rng.uniform(r.lower or 0.0, r.upper or 0.0, poses) for r in robot.readings], axis=1)
    position, quaternion = np.empty((poses, 3)), np.empty((poses, 4))
    for start in range(0, poses, AT_ONCE):
        rows = slice(start, start + AT_ONCE)
        placed = robot.tips(readings[rows], deviations) @ tool
        turned = placed[:, :3, :3] @ rigid.exp3(rng.normal(scale=1e-4, size=(len(placed), 3)))
        position[rows], quaternion[rows] = placed[:, :3, 3], rigid.quaternion_of(turned)
    position += rng.normal(scale=SIGMA, size=position.shape)
    found = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    found |= {f"{axis} [m]": position[:, k] for k, axis in enumerate("xyz")}
    if observes == "pose":
        found |= dict(zip(("qw", "qx", "qy", "qz"), quaternion.T, strict=True))
    return found


def from_arrays(poses: int, observes: str) -> Cost:
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    pose = observes == "pose"
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose" if pose else "position")
    data = calib.read_measurements(
        columns(robot, poses, observes), robot, observes, sigma=(SIGMA, 1e-4 if pose else None)
    )
    loaded, start = peak(), time.perf_counter()
    fit = calib.identify(model, data)
    seconds = time.perf_counter() - start
    if not fit.converged:
        raise SystemExit(f"{poses} {observes}s did not converge")
    return Cost(f"identify {observes}s", poses, seconds, loaded, peak())


def from_anchors(anchors: int, _: str) -> Cost:
    """Lengths alone, from anchors of which nobody knows where they are: three unknowns each beside those of the arm."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    rng, target = np.random.default_rng(2), np.repeat(np.arange(anchors), LENGTHS)
    table = columns(robot, anchors * LENGTHS, "position")
    x = np.stack([table.pop(f"{axis} [m]") for axis in "xyz"], axis=1)
    places = rng.uniform(-2.0, 2.0, (anchors, 3))
    more = {"length [m]": np.linalg.norm(x - places[target], axis=1), "target": [f"anchor {t}" for t in target]}
    data = calib.read_measurements({**table, **more}, robot, "distance", sigma=SIGMA)
    loaded, start = peak(), time.process_time()
    fit = calib.identify(model, data)
    seconds = time.process_time() - start
    if not fit.converged:
        raise SystemExit(f"{anchors} anchors did not converge")
    if np.sqrt(np.mean(fit.residuals[0] ** 2)) > EXPLAINED * SIGMA:
        raise SystemExit(f"of {anchors} anchors some are in the wrong place")
    return Cost(f"{anchors:,} anchors", anchors * LENGTHS, seconds, loaded, peak())


def from_setups(setups: int, _: str) -> Cost:
    """Positions from many set-ups: six unknowns each beside those of the arm."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    rng, setup = np.random.default_rng(3), np.repeat(np.arange(setups), POSITIONS)
    table: dict[str, object] = dict(columns(robot, len(setup), "position"))
    bases = rigid.placement(rigid.exp3(rng.normal(size=(setups, 3))), rng.uniform(-2.0, 2.0, (setups, 3)))
    x = np.stack([table.pop(f"{axis} [m]") for axis in "xyz"], axis=1)
    placed = np.einsum("nij,nj->ni", bases[setup, :3, :3], x) + bases[setup, :3, 3]
    table |= {f"{axis} [m]": placed[:, k] for k, axis in enumerate("xyz")}
    # Jobs have fewer set-ups, since what is said of each afterwards is not eliminated: here many tables have them.
    initialisation.MOST_SETUPS, initialisation.MOST_FRAMES = max(SETUPS), max(SETUPS) + 1
    data = [
        calib.read_measurements(
            {name: np.asarray(values)[rows] for name, values in table.items()}
            | {"setup": [f"s{k}" for k in setup[rows]]},
            robot,
            sigma=SIGMA,
        )
        for rows in np.array_split(np.arange(len(setup)), max(1, setups // 50))
    ]
    loaded, start = peak(), time.process_time()
    fit = calib.identify(model, data)
    seconds = time.process_time() - start
    if not fit.converged:
        raise SystemExit(f"{setups} set-ups did not converge")
    r = np.concatenate(fit.residuals)
    if np.sqrt(np.mean(r**2)) > EXPLAINED * SIGMA:
        raise SystemExit(f"of {setups} set-ups some are in the wrong place")
    return Cost(f"{setups:,} set-ups", len(setup), seconds, loaded, peak())


def from_boards(boards: int, _: str) -> Cost:
    """Photographs by a camera on the tip, of boards in unknown poses: six unknowns each beside those of the arm."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose")
    camera = Camera("tip", fx=1200.0, fy=1200.0, cx=640.0, cy=512.0, sigma=PIXEL)
    rng, board = np.random.default_rng(4), np.repeat(np.arange(boards), PHOTOGRAPHS)
    low, high = (np.array([getattr(r, end) or 0.0 for r in robot.readings]) for end in ("lower", "upper"))
    middle = rng.uniform(0.8 * low, 0.8 * high, (boards, len(low)))
    readings = middle[board] + rng.uniform(-0.1, 0.1, (len(board), len(low)))
    deviations = calib.Deviations(
        rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(len(robot.chain), 6)),
        rng.normal(scale=5e-3, size=len(robot.moving)),
    )
    tool = rigid.placement(rigid.exp3(np.array([0.05, -0.03, 0.8])), np.array([0.05, 0.02, 0.06]))
    marks = APART * np.array([(i - 1.5, j - 1.0, 0.0) for i in range(MARKS[0]) for j in range(MARKS[1])])
    ahead = rigid.placement(
        rigid.exp3(rng.normal(scale=0.3, size=(boards, 3))),
        rng.uniform((-0.1, -0.1, 0.5), (0.1, 0.1, 0.9), (boards, 3)),
    )
    places = (robot.tips(middle, deviations) @ tool @ ahead)[board]
    exact = rigid.inverse(robot.tips(readings, deviations) @ tool) @ places
    twists = rng.normal(size=(len(board), 6)) * np.repeat(REPEATS, 3)
    off = rigid.placement(rigid.exp3(twists[:, 3:]), twists[:, :3])

    def pictures(seen: np.ndarray) -> np.ndarray:
        points = np.einsum("nij,mj->nmi", seen[:, :3, :3], marks) + seen[:, None, :3, 3]
        return np.asarray(1200.0 * points[:, :, :2] / points[:, :, 2:] + np.array([640.0, 512.0]))

    pixels = pictures(rigid.inverse(off) @ exact)
    pixels += rng.normal(scale=PIXEL, size=pixels.shape)
    errs = float(np.sqrt(np.mean((pixels - pictures(exact)) ** 2)))
    many, n = np.repeat(readings, len(marks), axis=0), len(board)
    table: dict[str, object] = {f"{r.name} [rad]": many[:, k] for k, r in enumerate(robot.readings)}
    table |= {f"{name} [px]": pixels[:, :, k].ravel() for k, name in enumerate("uv")}
    table |= {f"board_{axis} [m]": np.tile(marks[:, k], n) for k, axis in enumerate("xyz")}
    table["target"] = [f"b{k}" for k in np.repeat(board, len(marks))]
    data = calib.read_measurements(table, robot, "pixels", instrument=camera)
    loaded, start = peak(), time.process_time()
    fit = calib.identify(model, data)
    seconds = time.process_time() - start
    if not fit.converged or np.sqrt(np.mean(fit.residuals[0] ** 2)) > EXPLAINED * errs:
        raise SystemExit(f"{boards} boards did not converge")
    if not fit.together or fit.together[0] is None:
        raise SystemExit(f"with {boards} boards nothing was said of what the arm does not repeat")
    return Cost(f"{boards:,} boards", n, seconds, loaded, peak())


def by_command(poses: int, observes: str) -> Cost:
    """The whole job, from the table on disk to report, scene and residuals."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table = columns(robot, poses, observes)
        with (folder / "poses.csv").open("w", encoding="utf-8") as file:
            file.write(",".join(table) + "\n")
            for start in range(0, poses, AT_ONCE):
                np.savetxt(file, np.column_stack([c[start : start + AT_ONCE] for c in table.values()]), "%.9f", ",")
        del table
        tool = "pose" if observes == "pose" else "position"
        (folder / "job.toml").write_text(JOB.format(tool=tool, observes=observes), encoding="utf-8")
        start = time.perf_counter()
        command = "import sys; from calib.cli import main; sys.exit(main())"
        arguments = ["calibrate", "job.toml", "-o", "out"]
        subprocess.run([sys.executable, "-c", command, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - start
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return Cost(
        "calib calibrate, all files", poses, seconds, np.nan, largest / (2**20 if sys.platform == "darwin" else 2**10)
    )


def measured(what: str, poses: int, observes: str) -> Cost:
    """One cost, found in a process of its own."""
    arguments = [sys.executable, __file__, "--one", what, str(poses), observes]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    text = subprocess.run(arguments, env=environment, capture_output=True, check=True, text=True).stdout
    return Cost(**json.loads(text.splitlines()[-1]))


def cells(cost: Cost) -> tuple[str, ...]:
    loaded = "" if np.isnan(cost.loaded) else f"{cost.loaded:,.0f}"
    return (cost.what, f"{cost.poses:,}", f"{cost.seconds:,.1f}", loaded, f"{cost.peak:,.0f}")


HEADINGS = ("what", "poses", "s", "MiB before", "MiB at most")

PAGE = """# Many poses

Made by `python scripts/benchmarks/scale.py --markdown docs/benchmark_scale.md`, one BLAS thread, on {machine}.

A Panda of 7 joints, all placements, offsets, base and tool free; each run in its own process. Memory is the peak of
the whole process: libraries, data and all; before: with the data in memory and nothing identified. Residuals and
Jacobians exist for a few hundred rows at a time and are reduced to a triangle by QR decompositions, so that what is
added grows with the numbers measured, not with poses times parameters. The whole command also reads the table from
disk, judges every row, and writes report, scene and residuals. [Many set-ups](benchmark_set_ups.md) and [many
targets](benchmark_targets.md) have pages of their own.

"""


TARGETS = """# Many targets

Made by `python scripts/benchmarks/scale.py --targets --markdown docs/benchmark_targets.md`, one BLAS thread, on
{machine}, which others used at the same time: so seconds are the processor's, of `calib.identify` alone.

A Panda of 7 joints, all placements, offsets and tool free. Nothing but the lengths to anchors in unknown places
is measured, {lengths} to each: three unknowns an anchor, and all of them found. Every run is in a process of its own,
and fails where residuals are not what the noise of the lengths explains. Targets are eliminated one by one
([theory](theory.md)), so that time and memory grow with their number: the last column is what one more target costs,
from the row before. A job may have 500 targets that are touched, because more is said of each there.

"""


def of_targets(costs: list[Cost]) -> str:
    """The page on many targets."""
    lines = ["| what | lengths | processor s | MiB before | MiB at most | ms a target more |", "|---|" + "--:|" * 5]
    for before, cost in zip([None, *costs], costs, strict=False):
        more = ""
        if before is not None:
            more = f"{1e3 * LENGTHS * (cost.seconds - before.seconds) / (cost.poses - before.poses):.1f}"
        lines.append(f"| {' | '.join((*cells(cost), more))} |")
    return TARGETS.format(machine=machine_name(), lengths=LENGTHS) + "\n".join([*lines, ""])


SET_UPS = """# Many set-ups and boards

Made by `python scripts/benchmarks/scale.py --setups --markdown docs/benchmark_set_ups.md`, one BLAS thread, on
{machine}, which others used at the same time: so seconds are the processor's, of `calib.identify` alone.

A Panda of 7 joints, all placements, offsets and tool free. It stands in many places, in each of which {positions}
positions are measured; or a camera on its tip takes {photographs} photographs of each of many boards, of {marks} marks.
Every set-up and board has six unknowns, and all of them are found. Every run is in a process of its own, and fails
where residuals are not what the noise explains. What only some rows are about is eliminated block by block
([theory](theory.md)). The last column is the exponent with which seconds grow, from the row before: 1 is linear.

The camera's arm does not repeat: in every photograph it is off by {length:g} mm and {angle:g} mrad, standard
deviations in every direction. How large that is, is found too, and every photograph is weighed by it. A job may have
100 set-ups: this limit is lifted here, because it is one of the whole run. What is said of the machine's uncertainty
afterwards, and what `uncertainty.json` holds of it, grow with the square of their number and more.

"""


def of_setups(costs: list[Cost]) -> str:
    """The page on many set-ups and boards."""
    lines = ["| what | rows or photographs | processor s | MiB before | MiB at most | exponent |", "|---|" + "--:|" * 5]
    for before, cost in zip([None, *costs], costs, strict=False):
        more = ""
        if before is not None and before.what.split()[-1] == cost.what.split()[-1]:
            more = f"{np.log(cost.seconds / before.seconds) / np.log(cost.poses / before.poses):.2f}"
        lines.append(f"| {' | '.join((*cells(cost), more))} |")
    page = SET_UPS.format(
        machine=machine_name(),
        positions=POSITIONS,
        photographs=PHOTOGRAPHS,
        marks=MARKS[0] * MARKS[1],
        length=1e3 * REPEATS[0],
        angle=1e3 * REPEATS[1],
    )
    return page + "\n".join([*lines, ""])


def machine_name() -> str:
    return f"{os.cpu_count()} cores of {platform.machine()}, Python {platform.python_version()}"


def markdown(costs: list[Cost]) -> str:
    rows = [f"| {' | '.join(HEADINGS)} |", "|---|--:|--:|--:|--:|", *(f"| {' | '.join(cells(c))} |" for c in costs)]
    return PAGE.format(machine=machine_name()) + "\n".join([*rows, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit with 1 when a limit is exceeded")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table to FILE")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="the largest problem (default: 1000000 poses)")
    parser.add_argument("--targets", action="store_true", help="anchors in the place of poses")
    parser.add_argument("--setups", action="store_true", help="set-ups and boards in the place of poses")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        what, poses, observes = arguments.one
        print(
            json.dumps(
                asdict(
                    {
                        "identify": from_arrays,
                        "anchors": from_anchors,
                        "command": by_command,
                        "setups": from_setups,
                        "boards": from_boards,
                    }[what](int(poses), observes)
                )
            )
        )
        return 0
    costs: list[Cost] = []
    table = Table(title="Panda, every placement, offset, base and tool free")
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading == "what" else "right")
    of_poses = (("identify", "position"), ("identify", "pose"), ("command", "position"))
    tasks = [(what, size, observes) for what, observes in of_poses for size in SIZES if size <= arguments.largest]
    if arguments.targets:
        tasks = [("anchors", n, "distance") for n in ANCHORS]
    elif arguments.setups:
        tasks = [("setups", n, "position") for n in SETUPS] + [("boards", n, "pixels") for n in BOARDS]
    for task in tasks:
        costs.append(measured(*task))
        table.add_row(*cells(costs[-1]))
        print(", ".join(cells(costs[-1])), file=sys.stderr)
    Console().print(table)
    if arguments.markdown is not None:
        page = (of_targets if arguments.targets else of_setups if arguments.setups else markdown)(costs)
        arguments.markdown.write_text(page, encoding="utf-8")
    slow = LIMIT_SECONDS if arguments.targets or arguments.setups else np.inf
    exceeded = [cost for cost in costs if cost.peak > LIMIT_MIB or cost.seconds > slow]
    for cost in exceeded:
        print(f"Beyond {LIMIT_MIB:,.0f} MiB, or {slow:g} s: {', '.join(cells(cost))}.", file=sys.stderr)
    return 1 if arguments.check and exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
