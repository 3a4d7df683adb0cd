"""Calibrate an arm by a ball in printed sockets with each place left out in turn, and test it there.

    python scripts/examples/sockets_leave_out.py <recordings> --robot panda [--wind-up]

Recordings as for sockets_job.py. At each place that took no part in a calibration: how far the predicted ball strays
from the mean of its socket, before and after, and by how much the predicted distance of the two sockets is off; in mm.
Where the rows of the calibration say that a socket has moved, that is told.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import calib
from calib.identification.relations import Relation
from scripts.examples.sockets_job import ARMS, ELASTIC_JOINTS, HOLES, NotRecordingsError, iiwa14, read, table

# As sockets_job.py writes them.
SIGMA, PRIOR_LENGTH, PRIOR_ANGLE = 0.5e-3, 1e-3, 5e-3
DISTANCE, SIGMA_OF_DISTANCE = 0.05, 1e-4
PRIOR_ELASTIC = 1e-4


@dataclass(frozen=True)
class Judged:
    """At held-out places, in m: mean distance of the rows from their socket's mean, averaged over sockets, before (the
    nominal robot, ball fitted) and after; and the mean difference of the sockets' distance from 50 mm.
    """

    before: float
    after: float
    distance: float


def load(recordings: Path, name: str) -> tuple[calib.Robot, dict[str, calib.Measurements]]:
    """The robot, and the rows of every place; their lines are those of the table that sockets_job.py writes."""
    arm = ARMS[name]
    with tempfile.TemporaryDirectory() as folder:
        urdf = arm.urdf
        if name == "iiwa14":
            urdf = str(Path(folder) / arm.urdf)
            Path(urdf).write_text(iiwa14(), encoding="utf-8")
        robot = calib.load_robot(urdf, arm.tip)
        sets = {}
        for place, holes in read(recordings).items():
            path = Path(folder) / f"{place}.csv"
            path.write_text(table(arm, place, holes), encoding="utf-8")
            sets[place] = replace(calib.read_measurements(path, robot, "socket", sigma=SIGMA), where=f"{place}.csv")
    return robot, sets


def error_model(robot: calib.Robot, places: Iterable[str], *, elastic: bool) -> calib.ErrorModel:
    return calib.error_model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        terms={"elastic": [robot.readings[k].name for k in ELASTIC_JOINTS] if elastic else "none"},
        priors=calib.Priors(PRIOR_LENGTH, PRIOR_ANGLE, elastic=PRIOR_ELASTIC),
        known=calib.Known(
            relations=[
                Relation("distance", (f"{place}/{HOLES[0]}", f"{place}/{HOLES[1]}"), DISTANCE, SIGMA_OF_DISTANCE)
                for place in places
            ]
        ),
    )


def fit(
    robot: calib.Robot, sets: dict[str, calib.Measurements], *, elastic: bool, split: bool = False, sigma: float = SIGMA
) -> tuple[calib.Fit, list[str]]:
    """The fit, and which targets were split at the rows where they seem to have moved: by these rows alone."""
    model = error_model(robot, sets, elastic=elastic)
    chosen = [replace(data, sigma=np.full_like(data.sigma, sigma)) for data in sets.values()]
    found = calib.identify(model, chosen)
    said: list[str] = []
    seen: set[str] = set()
    while split:
        # What is smaller than the noise that was stated does no harm, and a target that creeps has no end of splits.
        moved = [jump for jump in calib.judging.outliers(found).moved if float(np.linalg.norm(jump.shift)) > sigma]
        jump = next((jump for jump in moved if jump.target not in seen), None)
        if jump is None:
            break
        seen |= {jump.target, f"{jump.target}, moved"}
        chosen = [with_halves(data, jump.target, jump.rows) for data in chosen]
        said.append(f"{jump.target} after {jump.file}:{jump.line}")
        found = calib.identify(model, chosen)
    return found, said


def with_halves(data: calib.Measurements, target: str, rows: tuple[int, int]) -> calib.Measurements:
    """The rows with the smaller part of a target as a target of its own, of whose distance nothing is known."""
    if target not in data.targets:
        return data
    own = np.flatnonzero(data.target == data.targets.index(target))
    other = np.array(data.target)
    other[own[: rows[0]] if rows[0] < rows[1] else own[rows[0] :]] = len(data.targets)
    return replace(data, targets=(*data.targets, f"{target}, moved"), target=other)


def judged(found: calib.Fit, held_out: Iterable[calib.Measurements]) -> Judged:
    spreads: dict[str, list[float]] = {"before": [], "after": []}
    distances = []
    for data in held_out:
        for when, machine in (("before", found.nominal), ("after", found.machine)):
            tips = found.model.robot.tips(data.readings, machine.deviations) @ machine.frames.tools[0]
            by_hole = [tips[data.target == t, :3, 3] for t in range(len(data.targets))]
            means = [x.mean(axis=0) for x in by_hole]
            spreads[when] += [
                float(np.linalg.norm(x - mean, axis=1).mean()) for x, mean in zip(by_hole, means, strict=True)
            ]
        distances.append(abs(float(np.linalg.norm(means[1] - means[0])) - DISTANCE))
    return Judged(*(float(np.mean(values)) for values in (spreads["before"], spreads["after"], distances)))


def each_left_out(
    robot: calib.Robot,
    sets: dict[str, calib.Measurements],
    *,
    elastic: bool,
    split: bool = False,
    sigma: float = SIGMA,
) -> dict[str, tuple[Judged, list[str]]]:
    found = {}
    for place, held_out in sets.items():
        rest = {name: data for name, data in sets.items() if name != place}
        trained, said = fit(robot, rest, elastic=elastic, split=split, sigma=sigma)
        found[place] = (judged(trained, [held_out]), said)
    return found


def mean(found: dict[str, tuple[Judged, list[str]]]) -> Judged:
    every = np.array([(one.before, one.after, one.distance) for one, _ in found.values()])
    return Judged(*every.mean(axis=0).tolist())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder with <place>/hole_{0,1}.csv")
    parser.add_argument("--robot", choices=tuple(ARMS), required=True)
    parser.add_argument("--wind-up", action="store_true", help="joints 2 to 6 give way under gravity")
    arguments = parser.parse_args()
    try:
        robot, sets = load(arguments.recordings, arguments.robot)
        if len(sets) < 2:
            raise NotRecordingsError(f"{arguments.recordings} has one place; to leave one out takes two.")
    except NotRecordingsError as problem:
        print(problem, file=sys.stderr)
        return 1
    found = each_left_out(robot, sets, elastic=arguments.wind_up)
    every = {**{place: one for place, (one, _) in found.items()}, "mean": mean(found)}
    print(f"{'left out':12}{'before':>9}{'after':>9}{'distance off':>14}")
    for place, one in every.items():
        print(f"{place:12}{one.before * 1e3:9.3f}{one.after * 1e3:9.3f}{one.distance * 1e3:14.3f}")
    trained, _ = fit(robot, sets, elastic=arguments.wind_up)
    for jump in calib.judging.outliers(trained).moved:
        print(f"{jump.target} seems to have moved after {jump.file}:{jump.line}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
