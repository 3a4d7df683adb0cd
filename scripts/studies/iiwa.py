"""A real KUKA LBR iiwa 7 with three loads: do the torques that its joints measure tell how it gives way?

    python scripts/studies/iiwa.py REPOSITORY [output folder] [--markdown FILE]

REPOSITORY: a clone of https://github.com/Zhangzhongqiu/robot-calibration (a folder, or its git directory). It states no
licence, so none of its data is here: this script converts it. 198 poses of a marker frame on the flange, measured three
times: with nothing, with 1.25 kg and with 2.5 kg, each time with marks anew; with joints and torques as the controller
told them. The seventh joint rested. Every fourth pose is held out, of all three. Told are rms errors of these, by the
nominal robot with base and marker frames fitted, by geometry alone, by joints that give way under the torques that were
measured, and with terms chosen from the rows of the fit. What is identified with two loads is tested with the third.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from scripts.studies.repositories import stored, urdf_of

Array = NDArray[np.float64]

RUNS = {"0kg": "20161216_run1_0kg.csv", "1.25kg": "20161216_run2_1.25kg.csv", "2.5kg": "20161216_run3_2.5kg.csv"}
# By its data sheet: where each axis is in the frame of the one before, in m, and its direction.
AXES = (
    ((0.0, 0.0, 0.340), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (0, 1, 0)),
    ((0.0, 0.0, 0.400), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (0, -1, 0)),
    ((0.0, 0.0, 0.400), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (0, 1, 0)),
    ((0.0, 0.0, 0.126), (0, 0, 1)),
)
HEAD = """schema = 1
[robot]
urdf = "iiwa7.urdf"
tip = "link_7"
[error_model]
offsets = "all"
placements = "all"
base = "pose"
tool = "pose"
{terms}
"""
TABLE = """[[measurements]]
file = "{name}.csv"
observes = "pose"
tool = "marks at {load}"
orientation = "matrix"
use = "{use}"
"""
TERMS = {"geometry": "", "measured torques": 'torque = "all"', "with chosen terms": 'terms = "auto"'}
PAGE = """# A real iiwa with three loads: joints that give way

Made by `python scripts/studies/iiwa.py REPOSITORY --markdown docs/iiwa.md`, which says where the data are; they have no
licence, so that none of them is here. 198 poses of a KUKA LBR iiwa 7, measured with nothing on its flange, with 1.25 kg
and with 2.5 kg, each time with other marks. The controller told joints, and the torques that they measured. The seventh
joint rested. Every fourth pose is held out of all three tables. Root mean square errors of these, in mm and deg:

| | position | orientation |
|---|--:|--:|
{table}

Most of what the arm errs by is how it gives way under its own weight and its load, which no geometry has. `torque =
"all"` is one number for each joint, a compliance ([joint terms](joint_terms.md)).

With two loads identified, and the third one's marks found from its own rows, position errors of these in mm:

| load that was left out | geometry | measured torques |
|---|--:|--:|
{others}
"""


def text_of(rows: Array) -> str:
    """A table of the toolkit: joints, torques and poses."""
    numbers = range(1, 8)
    head = [*(f"joint_{k} [rad]" for k in numbers), *(f"tau_joint_{k} [Nm]" for k in numbers)]
    head += ["r11", "r12", "r13", "x [mm]", "r21", "r22", "r23", "y [mm]", "r31", "r32", "r33", "z [mm]"]
    return "\n".join([",".join(head), *(",".join(f"{v:.15g}" for v in row) for row in rows[:, 1:27]), ""])


def judged(folder: Path, name: str, terms: str, tables: str) -> calib.Calibration:
    """What is found from a job."""
    job = folder / f"{name}.toml"
    job.write_text(HEAD.format(terms=terms) + tables, encoding="utf-8")
    return calib.calibrate(job, job.with_suffix(""))


def main() -> None:
    """Convert, calibrate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("repository", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("iiwa"))
    parser.add_argument("--markdown", type=Path)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    (chosen.folder / "iiwa7.urdf").write_text(urdf_of("iiwa7", AXES), encoding="utf-8")
    for load, name in RUNS.items():
        rows = np.loadtxt(stored(chosen.repository, f"{load}/{name}").decode().splitlines()[1:], delimiter=",")
        held = np.arange(len(rows)) % 4 == 3
        for what, own in ((load, ~held), (f"{load} held out", held), (f"{load} whole", held | ~held)):
            (chosen.folder / f"{what}.csv").write_text(text_of(rows[own]), encoding="utf-8")
    both = (("", "identify"), (" held out", "validate"))
    tables = "".join(TABLE.format(name=f"{load}{part}", load=load, use=use) for part, use in both for load in RUNS)
    lines = []
    for what, terms in TERMS.items():
        found = judged(chosen.folder, what.replace(" ", "_"), terms, tables).judged_by
        for when, label in (("before", "nominal"), ("after", what)):
            if when == "after" or not lines:
                mm, deg = found[when]["position"].rms * 1e3, np.degrees(found[when]["orientation"].rms)
                lines.append(f"| {label} | {mm:.3f} | {deg:.3f} |")
                print(lines[-1], flush=True)
    others = []
    for left_out in RUNS:
        uses = [(load, "validate" if load == left_out else "identify") for load in RUNS]
        tables = "".join(TABLE.format(name=f"{load} whole", load=load, use=use) for load, use in uses)
        cells = [
            judged(chosen.folder, f"{what.replace(' ', '_')}_without_{left_out}", TERMS[what], tables).judged_by[
                "after"
            ]
            for what in ("geometry", "measured torques")
        ]
        others.append(f"| {left_out} | " + " | ".join(f"{one['position'].rms * 1e3:.3f}" for one in cells) + " |")
        print(others[-1], flush=True)
    if chosen.markdown is not None:
        page = PAGE.format(table="\n".join(lines), others="\n".join(others))
        chosen.markdown.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
