"""What a URDF alone reaches: geometry of the whole machine without its terms and loops, against geometry fitted alone.

    python scripts/studies/urdf_alone.py [--dataset <ur10_leica folder>] [--markdown FILE]

The shipped jobs of the IRB2400, and a real UR10 whose terms the tool chooses (scripts/examples/ur10_leica_job.py says
where the data are), a random third of it held out. Errors are of rows held out, base and tool fitted to the others.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import calib
from calib.assessment.choice import choose_terms
from calib.job.inputs import load
from calib.job.run import run
from calib.machine.urdf import calibrated_urdf
from calib.results.calibration import Calibration
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf
from scripts.examples.ur10_leica_job import NotTheDatasetError, read, table_columns

ROOT = Path(__file__).resolve().parents[2]
JOBS = {"IRB2400, closed loop": "calibration.toml", "IRB2400, closed loop and harmonics": "calibration_harmonics.toml"}
HEADER = (
    "| machine | before [mm] | geometry without its terms [mm] | geometry fitted alone [mm] | whole machine [mm] |",
    "|---|--:|--:|--:|--:|",
)


class Row(NamedTuple):
    """Rms (mm) of rows held out."""

    machine: str
    before: float
    without: float
    alone: float
    whole: float


def without_terms(found: Calibration) -> float:
    """Rms (mm) on rows held out of the geometry of the whole machine as a URDF, base and tool fitted anew."""
    robot, own = found.fit.robot, [judged.data for judged in found.sets if judged.use == "identification"]
    document = parse_urdf(calibrated_urdf(robot, found.fit.deviations), "the whole machine's")
    again = calib.assess(
        calib.identify(calib.error_model(load_robot(document, robot.tip, robot.base)), own),
        [judged.data for judged in found.sets if judged.use == "validation"],
    )
    return 1e3 * again.judged_by["after"]["position"].rms


def row(machine: str, found: Calibration) -> Row:
    if found.in_urdf is None:
        raise TypeError("each of these machines is more than a URDF holds")
    before, after = (found.judged_by[when]["position"].rms for when in ("before", "after"))
    alone = found.in_urdf.metrics["validation"]["position"].rms
    return Row(machine, 1e3 * before, without_terms(found), 1e3 * alone, 1e3 * after)


def rows(dataset: Path | None) -> Iterator[Row]:
    """Yield a row for every machine; the real one only where its data are given."""
    for machine, job in JOBS.items():
        yield row(machine, run(load(ROOT / "robots" / "irb2400" / job)))
    if dataset is not None:
        robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
        data = calib.read_measurements(table_columns(read(dataset), "position"), robot)
        order = np.random.default_rng(0).permutation(len(data))
        test, seen = data.subset(order[: len(order) // 3]), data.subset(order[len(order) // 3 :])
        model = calib.error_model(robot, offsets="all", placements="all")
        yield row(
            "a real UR10, terms chosen", calib.assess(calib.identify(choose_terms(model, seen).model, seen), test)
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, help="folder of the UR10's measurements")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table")
    arguments = parser.parse_args()
    lines = list(HEADER)
    try:
        for found in rows(arguments.dataset):
            lines.append(f"| {found.machine} | {' | '.join(f'{value:.3f}' for value in found[1:])} |")
            print(lines[-1], flush=True)
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    if arguments.markdown is not None:
        arguments.markdown.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
