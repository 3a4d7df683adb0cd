"""Is the place of a machine that an arm touched where it is said to be? Simulated cells, each with its truth.

    python scripts/studies/touched_places.py --store places.jsonl [--sessions 60] [--cells TEXT] [--minutes 10]

An arm, badly made, is calibrated before a tracker. Its tool then touches marks on a second machine in its reach, as
badly made, which is calibrated with that arm as the instrument, by jobs as users write them. Where the second machine
stands in the base of the arm, by `calib.commands.calibrated_cell`, is compared with where it truly stands: by the numpy
of tests/support, which walks the joints of the URDFs itself. The arm has no errors that its model does not know of.
Prints the table of docs/two_arms.md, of all sessions in the store.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.compensation.cell import calibrated_cell
from calib.foundations.units import MM
from calib.job.inputs import load
from calib.machine.model_file import machine_files
from calib.machine.place import Place
from scripts.studies.store import simulate, stored
from tests.support import machines, standing
from tests.support.machines import Arm, Array, Machine, Rng

ROBOTS = Path(__file__).resolve().parents[2] / "robots" / "positioner"
UR10 = "example:ur_description/urdf/ur10_robot.urdf"
SCARA = machines.urdf(
    ("column", "revolute", "0 0 0.6", "0 0 0", "0 0 1"),
    ("elbow", "revolute", "0.6 0 0.05", "0 0 0", "0 0 1"),
    ("quill", "prismatic", "0.5 0 0", "0 0 0", "0 0 -1"),
    ("spin", "continuous", "0 0 -0.1", "0 0 0", "0 0 -1"),
    ("flange", "fixed", "0 0 0.02", "0 0 0", "0 0 0"),
)
TURNTABLE = machines.urdf(
    ("track", "prismatic", "0 0 0.1", "0 0 0", "1 0 0"),
    ("table", "continuous", "0 0 0.1", "0 0 0", "0 0 1"),
    ("plate", "fixed", "0 0 0", "0 0 0", "0 0 0"),
)
# Of a coordinate, in m: what the tracker sees, and how a touch sits.
TRACKED, SEAT = 0.05 * MM, 0.02 * MM
CONE = np.array([0.9, 0.5, 0.8])
NEAR = 1e-9
ROUNDS = 8


@dataclass(frozen=True)
class Kind:
    """What is done in a cell of this study. ``orientation``: of the arm's tip as it touches; ``tracked``: rows."""

    says: str
    tracked: int = 40
    touches: int = 20
    marks: int = 2
    one_orientation: bool = False
    upright: bool = False
    pivot: bool = False
    second: str = "positioner"
    first: str = "welder"
    height: float = 0.0


KINDS = {
    "rich": Kind("40 tracked poses; 2 marks of a positioner, 20 touches each, in any orientation"),
    "arm": Kind(
        "40 tracked poses; the flange of a UR10, 60 touches in any orientation", second="ur10", touches=60, marks=1
    ),
    "pivot": Kind("as the first, with a spike that was found by pivoting", pivot=True),
    "poor": Kind(
        "25 tracked poses; one mark, 8 touches in one orientation",
        tracked=25,
        touches=8,
        marks=1,
        one_orientation=True,
    ),
    "upright": Kind(
        "40 tracked poses, tool straight down; then 2 marks, 20 touches each, in any orientation", upright=True
    ),
    "height": Kind(
        "a SCARA, whose tool's height is not seen and as stated; 2 marks of a turntable",
        first="scara",
        second="turntable",
    ),
    "height off 20": Kind(
        "the same, and its tool is 20 mm longer than stated", first="scara", second="turntable", height=-0.02
    ),
    "height off 150": Kind(
        "the same, and its tool is 150 mm longer than stated", first="scara", second="turntable", height=-0.15
    ),
}


def urdf_of(name: str) -> tuple[str, str]:
    """The URDF, a file's name or its text, and the tip of a machine."""
    return {
        "welder": (str(ROBOTS / "welder.urdf"), "flange"),
        "positioner": (str(ROBOTS / "positioner.urdf"), "table"),
        "ur10": (UR10, "tool0"),
        "scara": (SCARA, "tip"),
        "turntable": (TURNTABLE, "tip"),
    }[name]


def reached(arm: Arm, tool: Array, goal: Array, rng: Rng, *, turned: bool) -> Array:
    """Readings (N, k) within the ranges at which the tool is at goals (N, 4, 4): there, and turned so where asked.

    Rows of nan where it does not get there.
    """
    low, high = np.transpose(list(arm.ranges.values()))
    found = np.full((len(goal), len(low)), np.nan)

    def gap(q: Array, to: Array) -> Array:
        T = arm.tips(q) @ tool
        away = T[:, :3, 3] - to[:, :3, 3]
        if not turned:
            return away
        return np.hstack([away, Rotation.from_matrix(T[:, :3, :3] @ np.swapaxes(to[:, :3, :3], 1, 2)).as_rotvec()])

    steps = 1e-6 * np.vstack([np.zeros(len(low)), np.eye(len(low))])[:, None]
    for _ in range(ROUNDS):
        open_ = np.flatnonzero(np.isnan(found[:, 0]))
        if not open_.size:
            break
        q, to = rng.uniform(low, high, (len(open_), len(low))), goal[open_]
        for _ in range(25):
            near = gap((q + steps).reshape(-1, len(low)), np.tile(to, (len(steps), 1, 1))).reshape(
                len(steps), len(q), -1
            )
            g, J = near[0], np.moveaxis((near[1:] - near[0]) / 1e-6, 0, -1)
            step = -(np.linalg.pinv(J, rcond=1e-4) @ g[:, :, None])[:, :, 0]
            q = q + step / np.maximum(1.0, 2.0 * np.abs(step).max(axis=1, keepdims=True))
        there = (np.abs(gap(q, to)).max(axis=1) < NEAR) & np.all((q > low) & (q < high), axis=1)
        found[open_[there]] = q[there]
    return found


def csv(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    rows = zip(*columns.values(), strict=True)
    cells = [", ".join(value if isinstance(value, str) else repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join([", ".join(columns), *cells, ""]), encoding="utf-8")


def titles(arm: Arm, readings: Array) -> dict[str, Sequence[Any]]:
    """The columns of readings; units are those of the joints."""
    straight = {joint.name for joint in arm.joints if joint.type == "prismatic"}
    return {f"{name} [{'m' if name in straight else 'rad'}]": readings[:, k] for k, name in enumerate(arm.ranges)}


def session(name: str, seed: int) -> dict[str, Any]:
    """One cell: how far the place is off, and what is said of it."""
    kind, rng = KINDS[name], np.random.default_rng([seed, *name.encode()])
    with tempfile.TemporaryDirectory() as folder:
        return simulated(kind, rng, Path(folder))


def simulated(kind: Kind, rng: Rng, folder: Path) -> dict[str, Any]:
    """Make machines and tables, calibrate both, and compare."""
    for machine in (kind.first, kind.second):
        text = urdf_of(machine)[0]
        if text.startswith("<"):
            (folder / f"{machine}.urdf").write_text(text, encoding="utf-8")
    nominal, other = (machines.arm(*urdf_of(one)) for one in (kind.first, kind.second))
    spike = machines.pose((0.005, -0.004, 0.21) if kind.first == "welder" else (0.05, 0.02, kind.height))
    first = Machine(nominal.moved(rng), machines.anywhere(rng), {"tool": spike})
    place = place_of_second(kind, rng)
    second = Machine(other.moved(rng), first.base @ place, marks_of(kind))
    tracked = readings_tracked(kind, nominal, spike, rng)
    csv(
        folder / "tracked.csv",
        titles(nominal, tracked)
        | xyz(first.see(tracked)[:, :3, 3] + rng.normal(scale=TRACKED, size=(len(tracked), 3))),
    )
    tool = spike
    if kind.pivot:
        tool = machines.pose((-0.01, 0.006, 0.16))
        cone = np.tile(machines.pose(CONE), (16, 1, 1))
        leaning = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (16, 3))) * Rotation.from_euler("x", np.pi)
        cone[:, :3, :3] = leaning.as_matrix()
        cone[:, :3, 3] += rng.normal(scale=SEAT, size=(16, 3))
        turned = reached(first.arm, tool, cone, rng, turned=True)
        turned = turned[~np.isnan(turned[:, 0])]
        csv(folder / "pivot.csv", titles(nominal, turned) | {"target": ["cone"] * len(turned)})
    touches(kind, first, second, tool, place, rng, folder)
    write_jobs(kind, folder)
    for job in ("first", "second"):
        inputs = load(folder / f"{job}.toml")
        found = calib.machine_of(calib.identify(inputs.model, inputs.identify, losses=inputs.losses))
        (folder / job).mkdir()
        assert inputs.bases is not None, "its tables show where the base is"
        for file, text in machine_files(replace(found, placed=inputs.bases.placed())).items():
            (folder / job / file).write_bytes(text if isinstance(text, bytes) else text.encode())
    cell = calibrated_cell(folder / "first", folder / "second")
    return compared(first, second, folder, cell.place)


def place_of_second(kind: Kind, rng: Rng) -> Array:
    """Where the second machine stands in the base of the first."""
    turn = rng.uniform(-0.05, 0.05, 3)
    turn[2] += 0.4
    where = {"positioner": (1.5, -0.2, 0.0), "ur10": (1.4, 0.5, 0.1), "turntable": (0.45, 0.25, 0.2 + kind.height)}
    if kind.second == "turntable":
        turn[:2] *= 0.1
    return machines.pose(np.array(where[kind.second]) + rng.uniform(-0.02, 0.02, 3), turn)


def marks_of(kind: Kind) -> dict[str, Array]:
    """The marks on the second machine, by name."""
    if kind.second == "ur10":
        return {"A": machines.pose((0.05, 0.03, 0.1))}
    size = 0.3 if kind.second == "positioner" else 0.15
    there = {"A": (size, 0.0, 0.08), "B": (-0.6 * size, 0.87 * size, 0.05)}
    return {name: machines.pose(there[name]) for name in list(there)[: kind.marks]}


def readings_tracked(kind: Kind, nominal: Arm, spike: Array, rng: Rng) -> Array:
    """Readings of the first machine before the tracker."""
    if not kind.upright:
        return nominal.draw(rng, kind.tracked)
    goal = np.tile(machines.pose(rotvec=(np.pi, 0.0, 0.0)), (4 * kind.tracked, 1, 1))
    spin = np.zeros((len(goal), 3))
    spin[:, 2] = rng.uniform(-np.pi, np.pi, len(goal))
    goal = goal @ machines.pose(rotvec=spin)
    goal[:, :3, 3] = rng.uniform((0.7, -0.8, 0.2), (1.6, 0.8, 1.2), (len(goal), 3))
    found = reached(nominal, spike, goal, rng, turned=True)
    return found[~np.isnan(found[:, 0])][: kind.tracked]


def touches(kind: Kind, first: Machine, second: Machine, tool: Array, place: Array, rng: Rng, folder: Path) -> None:
    """Write what the first machine's tool touched on the second: readings of both."""
    columns: dict[str, list[Any]] = {}
    for mark in second.tools:
        q = second.arm.draw(rng, 4 * kind.touches)
        if kind.second == "positioner":
            q = rng.uniform((-1.5, -np.pi), (1.5, np.pi), (len(q), 2))
        goal = place @ second.arm.tips(q) @ second.tools[mark]
        goal[:, :3, 3] += rng.normal(scale=SEAT, size=(len(q), 3))
        goal[:, :3, :3] = machines.pose(rotvec=(np.pi, 0.0, 0.0))[:3, :3]
        at = reached(first.arm, tool, goal, rng, turned=kind.one_orientation)
        there = np.flatnonzero(~np.isnan(at[:, 0]))[: kind.touches]
        if len(there) < kind.touches:
            raise RuntimeError(f"only {len(there)} of {kind.touches} touches are within reach")
        own = titles(first.arm, at[there]) | titles(second.arm, q[there]) | {"tool": [mark] * len(there)}
        for title, values in own.items():
            columns.setdefault(title, []).extend(values)
    csv(folder / "touched.csv", columns)


def xyz(points: Array) -> dict[str, Sequence[Any]]:
    return {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}


def write_jobs(kind: Kind, folder: Path) -> None:
    """Write both jobs."""

    def robot(name: str) -> str:
        urdf, tip = urdf_of(name)
        file = f"{name}.urdf" if urdf.startswith("<") else urdf
        return f'schema = 1\n[robot]\nurdf = "{file}"\ntip = "{tip}"\n'

    model = '[error_model]\noffsets = "all"\nplacements = "all"\nbase = "pose"\ntool = "position"\n'
    (folder / "first.toml").write_text(
        robot(kind.first) + model + f'[[measurements]]\nfile = "tracked.csv"\nsigma = "{TRACKED / MM} mm"\n',
        encoding="utf-8",
    )
    with_what = 'pivot = "pivot.csv"' if kind.pivot else 'tool = "tool"'
    (folder / "second.toml").write_text(
        robot(kind.second)
        + model
        + f'[instruments.arm]\nkind = "arm"\nmodel = "first"\n{with_what}\nsigma = "{SEAT / MM} mm"\n'
        + '[[measurements]]\nfile = "touched.csv"\ninstrument = "arm"\n',
        encoding="utf-8",
    )


def compared(first: Machine, second: Machine, folder: Path, place: Place | None) -> dict[str, Any]:
    """How far the second machine truly is from where it was found, both as they stand before the tracker."""
    assert place is not None
    one, two = (calib.load_machine(folder / name) for name in ("first", "second"))
    R, at_base = one.base[:3, :3], one.base @ two.base
    of_first = shift(one, np.eye(4), first)
    of_second = shift(two, one.base, second)
    off = of_second - standing.at(of_first, at_base[:3, 3] - one.base[:3, 3])
    off = standing.turned(off, R.T)
    across = np.eye(6) - place.undetermined_basis @ place.undetermined_basis.T
    left = across @ off
    return {
        "inside": place.inside(off),
        "left": [float(np.linalg.norm(left[:3])), float(np.linalg.norm(left[3:]))],
        "sigmas": place.sigmas,
        "open": place.undetermined_basis.shape[1],
    }


def shift(found: calib.CalibratedMachine, carried: Array, true: Machine) -> Array:
    """The twist in the tracker's frame, at its base, that takes a found machine to where it truly is."""
    low, high = found.known_uncertainty.identified.T
    q = np.random.default_rng(0).uniform(low, high, (200, len(low)))
    tool = next(iter(found.tools))
    links = carried @ found.predict(q, tool=tool)
    return standing.shift_of_all(links, true.base @ true.arm.tips(q) @ found.tools[tool], (carried @ found.base)[:3, 3])


def table(told: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """The rows of the table of a page."""
    rows = [
        "| session | sessions | inside | true [mm] | stated [mm] | true [mrad] | stated [mrad] |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, lines in told.items():
        found = [line for line in lines if "refused" not in line]
        if not found:
            continue
        left, sigmas = (
            np.sqrt(np.mean(np.array([line[key] for line in found]) ** 2, axis=0)) for key in ("left", "sigmas")
        )
        inside = np.mean([line["inside"] for line in found])
        rows.append(
            f"| {KINDS[name].says} | {len(found)} | {inside:.2f} | {left[0] / MM:.3f} | {sigmas[0] / MM:.3f} | "
            f"{left[1] / MM:.3f} | {sigmas[1] / MM:.3f} |"
        )
    return rows


def main() -> None:
    """Simulate sessions that are not in the store, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--sessions", type=int, default=60)
    parser.add_argument("--cells", default="", help="those whose name has this text")
    parser.add_argument("--minutes", type=float, default=10.0)
    chosen = parser.parse_args()
    names = [name for name in KINDS if chosen.cells in name]
    simulate(chosen.store, names, chosen.sessions, time.monotonic() + 60.0 * chosen.minutes, session)
    print("\n".join(table(stored(chosen.store, names))))


if __name__ == "__main__":
    main()
