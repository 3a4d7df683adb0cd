"""Calibrate three real arms by a ball in printed sockets, as figures for docs/sockets.md.

    python scripts/sockets_figures.py <sockets folder> [--markdown docs/sockets.md]

Every figure is of places that took no part in the calibration: identified at one place and tested at all others, and
with each place left out in turn. Data: Franzese et al., MUKCa, github.com/platonics-delft/kinematics_calibration.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sockets_job import ARMS, HOLES, iiwa14, read, table

import calib
from calib.identification.error_model import with_terms
from calib.identification.relations import Relation
from calib.robot.transmission import JointTerm

Array = NDArray[np.float64]

# Stated before any held-out row was looked at by this script: as the converter writes it, and as docs/sockets.md says.
SIGMA, PRIOR_LENGTH, PRIOR_ANGLE = 0.5e-3, 1e-3, 5e-3
DISTANCE, SIGMA_OF_DISTANCE = 0.05, 1e-4
# Wind-up of joints 2 to 6: 30 Nm turn a joint by 3 mrad at one standard deviation, either way.
ELASTIC_JOINTS, PRIOR_ELASTIC = (1, 2, 3, 4, 5), 1e-4
OTHER_SIGMAS = (0.2e-3, 0.3e-3, 1e-3)
MOST_SPLITS = 6


@dataclass(frozen=True)
class Case:
    """One robot of the data: its arm, the place to calibrate at, and what is asked for, in m."""

    name: str
    arm: str
    place: str
    one: float
    each: float | None


CASES = (
    Case("panda_1", "panda", "front", 0.64e-3, None),
    Case("panda_3", "panda", "frontcenter", 0.25e-3, 0.20e-3),
    Case("kuka_14", "iiwa14", "front", 0.26e-3, 0.24e-3),
)


@dataclass(frozen=True)
class Judged:
    """At held-out places: mean distance of the rows from their socket's mean, averaged over sockets; and the mean
    difference of the sockets' distance from 50 mm; in m. ``before``: the former for the nominal robot, ball fitted.
    """

    before: float
    after: float
    distance: float


def load(case: Case, dataset: Path) -> tuple[calib.Robot, dict[str, calib.Measurements]]:
    """The robot, and the rows of every place; their lines are those of one table for both holes, below its header."""
    arm = ARMS[case.arm]
    with tempfile.TemporaryDirectory() as folder:
        urdf = arm.urdf
        if case.arm == "iiwa14":
            urdf = str(Path(folder) / arm.urdf)
            Path(urdf).write_text(iiwa14(), encoding="utf-8")
        robot = calib.load_robot(urdf, arm.tip)
        sets = {}
        for place, holes in read(dataset / case.name).items():
            path = Path(folder) / f"{place}.csv"
            path.write_text(table(arm, place, holes), encoding="utf-8")
            sets[place] = replace(calib.read_measurements(path, robot, "socket", sigma=SIGMA), where=f"{place}.csv")
    return robot, sets


def error_model(robot: calib.Robot, places: Iterable[str], *, elastic: bool) -> calib.ErrorModel:
    model = calib.error_model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        prior_length=PRIOR_LENGTH,
        prior_angle=PRIOR_ANGLE,
        relations=[
            Relation("distance", (f"{place}/{HOLES[0]}", f"{place}/{HOLES[1]}"), DISTANCE, SIGMA_OF_DISTANCE)
            for place in places
        ],
    )
    if not elastic:
        return model
    terms = [JointTerm(robot.readings[k].name, "elastic") for k in ELASTIC_JOINTS]
    return with_terms(model, terms, {term.name: PRIOR_ELASTIC for term in terms})


def fit(
    robot: calib.Robot, sets: dict[str, calib.Measurements], *, elastic: bool, split: bool = False, sigma: float = SIGMA
) -> tuple[calib.Fit, list[str]]:
    """The fit, and which targets were split at the rows where they seem to have moved: by these rows alone."""
    model = error_model(robot, sets, elastic=elastic)
    chosen = [replace(data, sigma=np.full_like(data.sigma, sigma)) for data in sets.values()]
    found = calib.identify(model, chosen)
    said: list[str] = []
    while split and len(said) < MOST_SPLITS and (moved := calib.outliers(found).moved):
        jump = moved[0]
        chosen = [without_half(data, jump.target, jump.rows) for data in chosen]
        said.append(f"{jump.target} after {jump.file}:{jump.line}")
        found = calib.identify(model, chosen)
    return found, said


def without_half(data: calib.Measurements, target: str, rows: tuple[int, int]) -> calib.Measurements:
    """The rows with the smaller part of a target as a target of its own, of whose distance nothing is known."""
    if target not in data.targets:
        return data
    own = np.flatnonzero(data.target == data.targets.index(target))
    if len(own) != sum(rows):
        return data
    other = np.array(data.target)
    other[own[: rows[0]] if rows[0] < rows[1] else own[rows[0] :]] = len(data.targets)
    return replace(data, targets=(*data.targets, f"{target}, moved {len(data.targets)}"), target=other)


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


def at_one_place(
    case: Case, robot: calib.Robot, sets: dict[str, calib.Measurements], *, elastic: bool, sigma: float = SIGMA
) -> Judged:
    found, _ = fit(robot, {case.place: sets[case.place]}, elastic=elastic, sigma=sigma)
    return judged(found, [data for place, data in sets.items() if place != case.place])


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


# ---- the page


def mm(value: float | None) -> str:
    return "-" if value is None else f"{value * 1e3:.3f}"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|---" + "|--:" * (len(header) - 1) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def page(dataset: Path) -> str:
    loaded = {case.name: load(case, dataset) for case in CASES}
    lines = [HEAD]
    rows, each_rows, sigma_rows = [], [], []
    split_lines: list[str] = []
    for case in CASES:
        robot, sets = loaded[case.name]
        stiff, wound = (at_one_place(case, robot, sets, elastic=elastic) for elastic in (False, True))
        rows.append(
            (
                f"{case.name}, {case.place}",
                mm(case.one),
                mm(stiff.before),
                mm(stiff.after),
                mm(stiff.distance),
                mm(wound.after),
                mm(wound.distance),
            )
        )
        left_out = {elastic: each_left_out(robot, sets, elastic=elastic) for elastic in (False, True)}
        stiff, wound = mean(left_out[False]), mean(left_out[True])
        split = {elastic: each_left_out(robot, sets, elastic=elastic, split=True) for elastic in (False, True)}
        each_rows.append(
            (
                case.name,
                mm(case.each),
                mm(stiff.before),
                mm(stiff.after),
                mm(stiff.distance),
                mm(wound.after),
                mm(wound.distance),
                mm(mean(split[False]).after),
                mm(mean(split[True]).after),
            )
        )
        for place, (_, said) in split[True].items():
            split_lines.append(f"* {case.name} without {place}: {'; '.join(said) or 'none'}.")
        for sigma in sorted((SIGMA, *OTHER_SIGMAS)):
            one = [at_one_place(case, robot, sets, elastic=elastic, sigma=sigma).after for elastic in (False, True)]
            each = [mean(each_left_out(robot, sets, elastic=elastic, sigma=sigma)).after for elastic in (False, True)]
            sigma_rows.append(
                (f"{case.name}, {sigma * 1e3:.1f} mm", *(mm(v) for v in (one[0], each[0], one[1], each[1])))
            )
    wind_up = ("with wind-up", "distance off")
    lines += ["## Identified at one place, tested at all others", ""]
    lines += markdown(("robot, place", "asked", "nominal", "calibrated", "distance off", *wind_up), rows)
    lines += ["## Each place left out in turn, mean over places", ""]
    lines += markdown(
        ("robot", "asked", "nominal", "calibrated", "distance off", *wind_up, "split", "split, with wind-up"), each_rows
    )
    lines += [SPLIT, "", *split_lines, "", "## The choice of sigma", "", CHOICE, ""]
    header = ("robot, sigma", "one place", "left out", "one place, with wind-up", "left out, with wind-up")
    lines += markdown(header, sigma_rows)
    lines += ["## What moves in panda_1", "", MOVES, ""]
    robot, sets = loaded["panda_1"]
    for title, chosen, elastic in (
        ("all places", sets, False),
        ("all places, with wind-up", sets, True),
        ("front and right alone", {place: sets[place] for place in ("front", "right")}, False),
    ):
        lines += [f"### panda_1, {title}", "", *told(fit(robot, chosen, elastic=elastic)[0])]
    for case in CASES[1:]:
        robot, sets = loaded[case.name]
        lines += [f"### {case.name}, all places", "", *told(fit(robot, sets, elastic=False)[0])]
    return "\n".join(lines).rstrip() + "\n"


def told(found: calib.Fit) -> list[str]:
    """The outlier report of a fit, as tables."""
    report = calib.outliers(found)
    rms = float(np.sqrt(np.mean(np.concatenate(found.residuals) ** 2)))
    lines = [f"Scatter {mm(rms)} mm rms per axis.", ""]
    rows = [
        (
            f"{jump.target} after {jump.file}:{jump.line}",
            f"{jump.rows[0]}, {jump.rows[1]}",
            " ".join(f"{value * 1e3:+.2f}" for value in jump.shift),
            f"{jump.gain:.0f}",
            f"{jump.chance:.1g}",
            "moved" if jump in report.moved else "",
        )
        for jump in report.jumps[:4]
    ]
    lines += markdown(("likeliest jumps", "rows", "by [mm]", "chi-squared by 3", "chance", ""), rows)
    rows = [
        (
            f"{group.kind} {group.name}",
            f"{group.gain:.0f} by {group.freedom}",
            f"{group.scatter:.2f}",
            f"{group.differs} ({group.differs_gain:.0f})",
            "disagrees" if group in report.disagreeing else "",
        )
        for group in report.groups
        if group.kind == "file"
    ]
    lines += markdown(("places", "chi-squared", "scatter without", "best told by", ""), rows)
    rows = [
        (f"{row.file}:{row.line}", f"{row.studentised:.2f}", f"{row.leverage:.2f}", f"{row.chance:.1g}")
        for row in report.rows[:3]
    ]
    return [*lines, *markdown(("worst rows", "distance", "leverage", "chance"), rows)]


HEAD = """\
# Three real arms and two printed sockets

Made by `python scripts/sockets_figures.py <sockets folder> --markdown docs/sockets.md`.
"""
SPLIT = ""
CHOICE = ""
MOVES = ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder with panda_1, panda_3 and kuka_14")
    parser.add_argument("--markdown", type=Path, help="write the page here, not to the terminal")
    arguments = parser.parse_args()
    text = page(arguments.dataset)
    if arguments.markdown is None:
        print(text, end="")
    else:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
