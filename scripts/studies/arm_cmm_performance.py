"""Calibrate the realistic arm of robots/arm_cmm and print its acceptance figures before and after.

    python scripts/studies/arm_cmm_performance.py [--markdown]

With --markdown there is a third column: the calibrated arm if its encoders' eccentricity were known, which the truth
file tells, taken out of all readings before calibration and test.
"""

import argparse
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.assessment.performance import Performance, before_and_after
from calib.foundations.arrays import Array
from calib.identification.identify import identify
from calib.job.inputs import load
from calib.machine.of_fit import machine_of
from calib.measurement.touches import read_touches
from calib.presentation.command_tables import performance_sheet
from calib.presentation.tables import plain, sheet_table

CASE = Path(__file__).resolve().parents[2] / "robots" / "arm_cmm"
JOB = CASE / "calibration_realistic.toml"
TESTS = ("cone.csv", "lengths.csv", "sphere.csv", "articulations.csv")


def figures(cosine: Array, sine: Array) -> tuple[Performance, Performance]:
    """Before and after, with this first harmonic (6,) in rad added to all readings."""

    def corrected(u: Array) -> Array:
        return u + cosine * np.cos(u) + sine * np.sin(u)

    job = load(JOB)
    data = [replace(data, readings=corrected(data.readings)) for data in job.identify]
    touched = [read_touches(CASE / name, job.robot) for name in ("probe.csv", *TESTS)]
    probe, *tests = (replace(touches, readings=corrected(touches.readings)) for touches in touched)
    return before_and_after(machine_of(identify(job.model, data)), tests, probe)


def markdown() -> str:
    truth = tomllib.loads((CASE / "truth_realistic.toml").read_text(encoding="utf-8"))
    before, after = figures(np.zeros(6), np.zeros(6))
    _, known = figures(np.radians(truth["cosine_deg"]), np.radians(truth["sine_deg"]))
    sheet = performance_sheet({"before": before, "after": after, "eccentricity known": known})
    ruler = ["--:" if name in sheet.numbers else "---" for name in sheet.columns]
    return "".join(f"| {' | '.join(row)} |\n" for row in (sheet.columns, ruler, *(row.cells for row in sheet.rows)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", action="store_true", help="the table of docs/arm_cmm_performance.md")
    if parser.parse_args().markdown:
        print(markdown(), end="")
    else:
        before, after = figures(np.zeros(6), np.zeros(6))
        print(plain(sheet_table(performance_sheet({"before": before, "after": after}))), end="")


if __name__ == "__main__":
    main()
