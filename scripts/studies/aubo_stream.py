"""An AUBO i5 calibrated from 82 s of motion, by two streams with clocks of their own, and judged where it stood still.

    python scripts/studies/aubo_stream.py <DataProcessed folder> [--job FOLDER] [--markdown FILE]

Data: J. Ferguson, github.com/fergujm2/ContinuousRobotCalibration, Experiments/20200915_FullTest/DataProcessed, with the
DH table of AuboI5Kinematics/GetDhTable.m. The repository states no licence: the data are read, and not passed on. Joint
readings come at about 149 Hz, a motion-capture tracker at 60 Hz; both wrote down times of their own.

ContinuousEvaluation is one motion: the fit sees nothing else. DiscreteEvaluation is a series of stops: where joints
rest for a second and more, readings and points are averaged, and these judge. Base and tool are those of the fit.
``--job`` also writes the motion as a job for calib calibrate.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

import calib
from calib.foundations.units import MM, MS
from calib.identification.identify import residuals_of
from calib.measuring import at_rest
from calib.robot.urdf import parse_urdf
from scripts.simulate.streams import write_table

Array = NDArray[np.float64]
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
# Theta, d, a, alpha of the standard convention, in degrees and metres.
DH = (
    (0.0, 0.0985, 0.0, 90.0),
    (90.0, 0.1405, 0.4080, 180.0),
    (0.0, 0.1215, 0.3760, 180.0),
    (90.0, 0.1025, 0.0, 90.0),
    (0.0, 0.1025, 0.0, -90.0),
    (180.0, 0.0940, 0.0, 0.0),
)
# Nobody states the tracker's noise. A dozen rows in the middle of the first half lie off by up to 5 mm.
LOSS = "huber"
JOB = """schema = 1

[robot]
urdf = "aubo_i5.urdf"

[error_model]
offsets = "all"
placements = "all"

[[measurements]]
file = "tracker.csv"
readings = "joints.csv"
clock = "free"
loss = "huber"
hold_out = 0.25
"""


class Recording(NamedTuple):
    """Times (n,) and readings (n, 6) of the joints; times (m,) and points (m, 3), in s, rad and m."""

    joint_times: Array
    readings: Array
    times: Array
    points: Array

    def measured(self, robot: calib.Robot) -> calib.Measurements:
        """The rows of both streams by a clock that is found."""
        joints = {"time [s]": self.joint_times} | {f"{n} [rad]": self.readings[:, k] for k, n in enumerate(JOINTS)}
        seen = {"time [s]": self.times} | {f"{axis} [m]": self.points[:, k] for k, axis in enumerate("xyz")}
        return calib.measuring.read_stream(seen, robot, joints, clock="free")


def read(folder: Path, joints: str, tracker: str, unit: float) -> Recording:
    """Read two files; the points of one are in millimetres, of the other in metres."""
    a, b = loadmat(folder / f"{joints}.mat"), loadmat(folder / f"{tracker}.mat")
    return Recording(a["tRobot"].ravel(), a["q"], b["t"].ravel(), unit * b["p"])


def robot_text() -> bytes:
    """The arm as a URDF."""
    lines = ["convention, standard", "joint, type, a [m], d [m], alpha [deg], theta [deg]"]
    numbers = zip(JOINTS, DH, strict=True)
    lines += [f"{name}, revolute, {a}, {d}, {alpha}, {theta}" for name, (theta, d, a, alpha) in numbers]
    return calib.dh.dh_to_urdf(calib.dh.parse_dh("\n".join(lines).encode(), "GetDhTable.m"), "aubo_i5")


def write_job(folder: Path, moving: Recording) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "aubo_i5.urdf").write_bytes(robot_text())
    (folder / "calibration.toml").write_text(JOB, encoding="utf-8", newline="\n")
    titles = ("time [s]", *(f"{joint} [rad]" for joint in JOINTS))
    write_table(folder / "joints.csv", titles, moving.joint_times, moving.readings)
    write_table(folder / "tracker.csv", ("time [s]", "x [m]", "y [m]", "z [m]"), moving.times, moving.points)


def errors(r: Array) -> str:
    e = np.linalg.norm(r[:, :3], axis=1) / MM
    return f"{np.sqrt(np.mean(e**2)):.3f} | {np.median(e):.3f} | {e.max():.2f}"


def row(title: str, fit: calib.Fit, machine: object, rests: calib.Measurements) -> str:
    (r,) = residuals_of(fit, [rests], machine)
    return f"| {title} | {len(fit.residuals[0])} | {errors(r)} |"


def clock(fit: calib.Fit) -> str:
    """What the fit says of its clock."""
    names = [parameter.name for parameter in fit.parameters]
    offset, skew = (names.index(f"clock.{name}") for name in ("offset", "skew"))
    as_one = fit.memories[0].rows_as_one if fit.memories else 1.0
    alone = np.sqrt(fit.covariance_alone[offset, offset])
    return (
        f"{len(fit.residuals[0])} rows | {fit.values[offset] / MS:.3f} +- {fit.sigmas[offset] / MS:.3f} ms "
        f"| +- {alone / MS:.3f} ms | {1e6 * fit.values[skew]:.1f} +- {1e6 * fit.sigmas[skew]:.1f} us/s | {as_one:.0f} |"
    )


def table(moving: Recording, stopping: Recording) -> str:
    robot = calib.load_robot(parse_urdf(robot_text(), "aubo_i5.urdf"))
    model = calib.error_model(robot, offsets="all", placements="all")
    data, rests = moving.measured(robot), at_rest(stopping.measured(robot), least=1.0)
    half = len(data) // 2
    whole, first, second = (
        calib.identify(model, data.subset(rows), losses=[LOSS])
        for rows in (np.arange(len(data)), np.arange(half), np.arange(half, len(data)))
    )
    plain = calib.identify(model, data)
    own, others = calib.hold_out(rests, 0.5)
    at_stops = calib.identify(model, own)
    lines = [
        f"Errors at {len(rests)} stops that no fit in motion saw [mm]:",
        "",
        "| fitted to | rows | rms | median | largest |",
        "|---|---|---|---|---|",
        row("base and tool alone, nominal arm, the whole motion", whole, whole.nominal, rests),
        row("the whole motion", whole, whole.machine, rests),
        row("the whole motion, least squares without a loss", plain, plain.machine, rests),
        row("its first half", first, first.machine, rests),
        row("its second half", second, second.machine, rests),
        row(f"half of the stops, judged at the other {len(others)}", at_stops, at_stops.machine, others),
        "",
        "| clock | offset in the middle | sigma as if rows erred alone | skew | rows that count as one |",
        "|---|---|---|---|---|",
        *(
            f"| {name}: {clock(fit)}"
            for name, fit in (("whole", whole), ("first half", first), ("second half", second))
        ),
    ]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--job", type=Path)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args(arguments)
    moving = read(given.folder, "ContinuousEvaluation", "ContinuousEvalutionTracker", MM)
    if given.job is not None:
        write_job(given.job, moving)
    text = table(moving, read(given.folder, "DiscreteEvaluation", "DiscreteEvaluationTracker", 1.0))
    if given.markdown is not None:
        given.markdown.write_text(text, encoding="utf-8", newline="\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
