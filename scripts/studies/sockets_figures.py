"""Calibrate three real arms by a ball in printed sockets, as figures for docs/sockets.md.

    python scripts/studies/sockets_figures.py <sockets folder> [--markdown docs/sockets.md]

Every figure is of places that took no part in the calibration: identified at one place and tested at all others, and
with each place left out in turn. Data: Franzese et al., MUKCa, github.com/platonics-delft/kinematics_calibration.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import calib
from scripts.examples.sockets_leave_out import SIGMA, Judged, each_left_out, fit, judged, load, mean

OTHER_SIGMAS = (0.2e-3, 0.3e-3, 1e-3)


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


def at_one_place(
    case: Case, robot: calib.Robot, sets: dict[str, calib.Measurements], *, elastic: bool, sigma: float = SIGMA
) -> Judged:
    found, _ = fit(robot, {case.place: sets[case.place]}, elastic=elastic, sigma=sigma)
    return judged(found, [data for place, data in sets.items() if place != case.place])


# ---- the page


def mm(value: float | None) -> str:
    return "-" if value is None else f"{value * 1e3:.3f}"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|---" + "|--:" * (len(header) - 1) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def page(dataset: Path) -> str:
    loaded = {case.name: load(dataset / case.name, case.arm) for case in CASES}
    kinds = (False, True)
    wound = ["with wind-up" if elastic else "" for elastic in kinds]
    lines = [HEAD]
    one_rows, each_rows, sigma_rows, split_lines = [], [], [], []
    for case in CASES:
        robot, sets = loaded[case.name]
        one = [at_one_place(case, robot, sets, elastic=elastic) for elastic in kinds]
        figures = [mm(v) for j in one for v in (j.after, j.distance)]
        one_rows.append((f"{case.name}, {case.place}", mm(case.one), mm(one[0].before), *figures))
        each = [mean(each_left_out(robot, sets, elastic=elastic)) for elastic in kinds]
        split = [each_left_out(robot, sets, elastic=elastic, split=True) for elastic in kinds]
        figures = [mm(v) for j, s in zip(each, split, strict=True) for v in (j.after, j.distance, mean(s).after)]
        each_rows.append((case.name, mm(case.each), mm(each[0].before), *figures))
        for place, (_, said) in split[-1].items():
            split_lines.append(f"* {case.name} without {place}: {'; '.join(said) or 'none'}.")
        for sigma in sorted((SIGMA, *OTHER_SIGMAS)):
            found = [
                figure
                for elastic in kinds
                for figure in (
                    at_one_place(case, robot, sets, elastic=elastic, sigma=sigma),
                    mean(each_left_out(robot, sets, elastic=elastic, sigma=sigma)),
                )
            ]
            sigma_rows.append((f"{case.name}, {sigma * 1e3:.1f} mm", *(mm(j.after) for j in found)))
    lines += ["## Identified at one place, tested at all others", ""]
    header = [f"{title} {how}".strip() for how in wound for title in ("calibrated", "distance off")]
    lines += markdown(("robot, place", "asked", "nominal", *header), one_rows)
    lines += ["## Each place left out in turn, mean over places", ""]
    header = [f"{title} {how}".strip() for how in wound for title in ("calibrated", "distance off", "split")]
    lines += markdown(("robot", "asked", "nominal", *header), each_rows)
    lines += [SPLIT, "", *split_lines, "", "## The choice of sigma", "", CHOICE, ""]
    header = [f"{title} {how}".strip() for how in wound for title in ("one place", "left out")]
    lines += markdown(("robot, sigma", *header), sigma_rows)
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
    report = calib.judging.outliers(found)
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
    lines += markdown(("most significant jumps", "rows", "by [mm]", "chi-squared by 3", "chance", ""), rows)
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
    lines += markdown(("places", "chi-squared", "scatter without it", "best explained by", ""), rows)
    rows = [
        (f"{row.file}:{row.line}", f"{row.studentised:.2f}", f"{row.leverage:.2f}", f"{row.chance:.1g}")
        for row in report.rows[:3]
    ]
    return [*lines, *markdown(("worst rows", "distance", "leverage", "chance"), rows)]


HEAD = """\
# Three real arms and two printed sockets

Made by `python scripts/studies/sockets_figures.py <sockets folder> --markdown docs/sockets.md`.

The data are of two Franka Pandas and a KUKA iiwa 14. Each had a ball on its tool, which sat in one of two printed
sockets 50 mm apart, in several places of the workspace. Only joint readings were recorded (Franzese et al., MUKCa,
github.com/platonics-delft/kinematics_calibration). `scripts/examples/sockets_job.py` makes a job of such recordings,
and [the tutorial](tutorial_sockets.md) goes through one.

All placements and offsets of the seven joints are free, with priors of 1 mm and 5 mrad; so are the ball on the tool
and every socket. Rows have a stated sigma of 0.5 mm per axis, and the distance of the two sockets of a place has one
of 0.1 mm. Every figure is in mm, of places that took no part in the calibration: the mean distance of the predicted
ball from the mean of its socket, averaged over sockets. A smaller arm would pass that test too. So "distance off"
says by how much the predicted distance of the two sockets differs from 50 mm, on average. "Nominal" is the robot of
the URDF with the ball fitted. "Asked" is the error to be reached at most.

"Wind-up" adds one compliance under gravity for each of the joints 2 to 6, with a prior of 0.1 mrad/Nm: the arm bends
under its own weight, and by different amounts at different places.
"""
SPLIT = """\
"Split": if the rows of the calibration themselves show that a socket has moved by more than the stated sigma, the
smaller part of its rows is treated as another socket, whose distance from the others is not known. The places that
test are not split. What was split in the last column:"""
CHOICE = """\
The sigma of 0.5 mm is the same for all three arms. It is a likely value for a printed ball in a printed socket and an
arm that is guided by hand; the job states it. When it was chosen, the figures of other choices, at the places that
test, were already known. So differences of 0.02 mm (0.05 mm for panda_1) mean nothing:"""
MOVES = """\
Two things disagree, and neither is the grip of the ball. First, the place back-high fits better with other parameters
than the rest: it lies behind the robot and 0.87 m up, where the joints carry another load than over the table. With
wind-up in the model, no place disagrees any more. Second, in right/hole_1 something moved by almost a millimetre.
This jump is found with back-high and without, with wind-up and without. No model can predict a socket that moved, so
the rows of that file have large errors where they test. Other jumps come and go with the model: there the postures
change, not the socket. Not everything is explained: where panda_1 is tested, the distance of the sockets is off by
half a millimetre, with wind-up and without.

"Chance" is an upper limit of the probability of such a value in data without errors. Lines are those of the table of a
place that the converter writes: one header, then all rows of hole_0, then those of hole_1."""


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
