"""A real ABB IRB 120 and a laser tracker: was the arm at rest when its joints were read?

    python scripts/studies/irb120.py REPOSITORY [output folder] [--markdown FILE]

REPOSITORY: a clone of https://github.com/icelinker/Robot-Calibration-LaserTracker (a folder, or its git directory). It
states no licence, so none of its data is here: this script converts it. At 982 poses a tracker measured three
reflectors on the flange. The joints are told twice: as they were commanded, and as the controller told them right after
the motion. Every fourth pose is held out, the same ones in all rows. Told are rms errors of these, by the nominal robot
with base and reflectors fitted, by geometry alone, and with terms chosen from the rows of the fit; what the verdict
says; and, of commanded joints, plain least squares over all six numbers of every joint's placement, with kinematics of
its own and SciPy.
"""

import argparse
import io
import sys
import textwrap
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from scripts.studies.repositories import stored, urdf_of

Array = NDArray[np.float64]

READ = "4-DataProcess/Output/processed_joints.txt"
COMMANDED = "3-Full Measurement/Input/generated_joints.txt"
REFLECTOR = "4-DataProcess/Output/processed_SMR_{}.txt"
# By its data sheet: where each axis is in the frame of the one before, in m, and its direction.
AXES = (
    ((0.0, 0.0, 0.290), (0, 0, 1)),
    ((0.0, 0.0, 0.0), (0, 1, 0)),
    ((0.0, 0.0, 0.270), (0, 1, 0)),
    ((0.134, 0.0, 0.070), (1, 0, 0)),
    ((0.168, 0.0, 0.0), (0, 1, 0)),
    ((0.072, 0.0, 0.0), (1, 0, 0)),
)
JOB = """schema = 1
[robot]
urdf = "irb120.urdf"
tip = "link_6"
[error_model]
offsets = "all"
placements = "all"
base = "pose"
tool = "position"
{terms}
[[measurements]]
file = "{rows}.csv"
observes = "position"
[[measurements]]
file = "{rows}_held_out.csv"
observes = "position"
use = "validate"
"""
PAGE = """# A real IRB 120: read before it stood

Made by `python scripts/studies/irb120.py REPOSITORY --markdown docs/irb120.md`, which says where the data are; they
have no licence, so that none of them is here. At {poses} poses a laser tracker measured three reflectors on the flange.
The distances of the reflectors scatter by {between:.0f} um (standard deviation), so much for the instrument.

The joints are told twice, as commanded and as the controller told them after the motion. The two differ by
{apart:.3f} deg rms, mostly against the motion from the pose before ({share:.0f} % of the joints): the controller was
asked while the arm braked. Every fourth pose is held out. Root mean square errors in mm of these, and what is said:

| joints | nominal | geometry | with chosen terms | the verdict |
|---|--:|--:|--:|---|
{table}

Plain least squares over all placements, with kinematics of their own, leave {plain:.4f} mm of the held-out rows, from
commanded joints.

The check "at rest" ([assessment](assessment.md)) was made after these data. What it says of joints as they were read:

{said}
"""


def table(q: Array, points: Array) -> str:
    """Rows of joints (N, 6) in deg and reflectors (3, N, 3) in mm: three for each pose."""
    head = [*(f"joint_{k + 1} [deg]" for k in range(6)), "x [mm]", "y [mm]", "z [mm]", "tool"]
    rows = [
        ",".join([*(f"{v:.8f}" for v in (*angles, *points[k, n])), f"reflector_{k + 1}"])
        for n, angles in enumerate(q)
        for k in range(3)
    ]
    return "\n".join([",".join(head), *rows, ""])


def plain(q: Array, points: Array, held: NDArray[np.bool_]) -> float:
    """Rms error in mm of rows held out, after a fit of every joint's placement, base and reflectors."""
    turns, x = np.radians(q), points * 1e-3

    def predicted(p: Array, angles: Array) -> Array:
        p = p * 0.01
        R = np.broadcast_to(Rotation.from_rotvec(p[3:6] * 100.0).as_matrix(), (len(angles), 3, 3))
        at = np.broadcast_to(p[:3] * 100.0, (len(angles), 3))
        for k, (origin, axis) in enumerate(AXES):
            own = p[6 + 6 * k : 12 + 6 * k]
            at = at + R @ (np.array(origin) + own[:3])
            turn = Rotation.from_rotvec(angles[:, k, None] * np.array(axis, dtype=float)).as_matrix()
            R = R @ Rotation.from_rotvec(own[3:]).as_matrix() @ turn
        return np.stack([at + R @ tool for tool in p[42:].reshape(3, 3) * 100.0])

    def residuals(p: Array) -> Array:
        return np.append((predicted(p, turns[~held]) - x[:, ~held]).ravel() * 1e3, 1e-3 * p[6:42])

    # The tracker stood somewhere: from several turns about the vertical base and reflectors are sought, then all.
    outside = [*range(6), *range(42, 51)]
    ends = []
    for turn in np.arange(0.0, 2.0 * np.pi, np.pi / 2):
        start = np.zeros(51)
        start[:3], start[5] = x.mean(axis=(0, 1)), turn

        def of_some(own: Array, start: Array = start) -> Array:
            p = start.copy()
            p[outside] = own
            return residuals(p)

        start[outside] = least_squares(of_some, start[outside], method="lm").x
        ends.append(start)
    nearest = min(ends, key=lambda p: float(np.sum(residuals(p) ** 2)))
    best = least_squares(residuals, nearest, method="lm")
    left = (predicted(best.x, turns[held]) - x[:, held]) * 1e3
    return float(np.sqrt(np.mean(np.sum(left**2, axis=2))))


def main() -> None:
    """Convert, calibrate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("repository", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("irb120"))
    parser.add_argument("--markdown", type=Path)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    (chosen.folder / "irb120.urdf").write_text(urdf_of("irb120", AXES), encoding="utf-8")

    def told(name: str) -> Array:
        return np.loadtxt(io.BytesIO(stored(chosen.repository, name)))

    points = np.stack([told(REFLECTOR.format(k)) for k in (1, 2, 3)])
    read, every = told(READ), told(COMMANDED)
    # Poses that the tracker did not see were left out of all tables but that of commands.
    commanded = every[[int(np.argmin(np.abs(every - row).sum(axis=1))) for row in read]]
    held = np.arange(len(read)) % 4 == 3
    lines, said = [], ""
    for rows, what, q in (("read", "as they were read", read), ("commanded", "as commanded", commanded)):
        # Rows that are held out stay in the table as comments, so that those that follow them are known to.
        for name, own in ((f"{rows}.csv", ~held), (f"{rows}_held_out.csv", held)):
            kept = table(q, points).splitlines()
            text = [kept[0], *(row if own[k // 3] else f"# {row}" for k, row in enumerate(kept[1:]))]
            (chosen.folder / name).write_text("\n".join(text) + "\n", encoding="utf-8")
        cells: list[str] = []
        verdict = ""
        for terms in ("", 'terms = "auto"'):
            job = chosen.folder / f"{rows}{'_terms' if terms else ''}.toml"
            job.write_text(JOB.format(rows=rows, terms=terms), encoding="utf-8")
            found = calib.calibrate(job, job.with_suffix(""))
            before, after = (found.judged_by[when]["position"].rms * 1e3 for when in ("before", "after"))
            cells += [f"{after:.4f}"] if cells else [f"{before:.4f}", f"{after:.4f}"]
            words = ", ".join(check.name for check in found.checks if not check.passed)
            verdict += ("; with terms " if terms else "") + (f"fails {words}" if words else "trusted")
            if not terms and rows == "read":
                said = " ".join(check.sentence for check in found.checks if check.name == "at rest")
        lines.append(f"| {what} | {' | '.join(cells)} | {verdict} |")
        print(lines[-1], flush=True)
    apart = float(np.sqrt(np.mean((read - commanded) ** 2)))
    behind = np.sign(commanded - read)[1:] == np.sign(np.diff(commanded, axis=0))
    between = float(np.linalg.norm(points[0] - points[1], axis=1).std() * 1e3)
    alone = plain(commanded, points, held)
    print(f"plain least squares: {alone:.4f} mm")
    if chosen.markdown is not None:
        quoted = textwrap.fill(said, 118, initial_indent="> ", subsequent_indent="> ")
        page = PAGE.format(
            poses=len(read),
            between=between,
            apart=apart,
            table="\n".join(lines),
            plain=alone,
            share=100.0 * behind.mean(),
            said=quoted,
        )
        chosen.markdown.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
