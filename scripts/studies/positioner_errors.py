"""How far off a two-axis positioner's table points are predicted, from five touched points and from more.

    python scripts/studies/positioner_errors.py [--trials 1000] [--camera FOLDER] [--markdown FILE]

The touched points are made here with numpy alone, after the set-up of a published table of expected errors; only the
estimates come from the toolkit. With --camera, the folder of the public positioner_camera dataset, ten random
three-to-one splits of a real positioner's measurements are added.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import calib
from calib import positioner
from calib.identification.identify import residuals_of
from calib.robot.urdf import parse_urdf
from scripts.examples import positioner_camera_job as camera

Array = NDArray[np.float64]
Rng = np.random.Generator

NOISE = 0.1e-3
TABLE_POINTS = 20
EXTENT, HEIGHT = 0.5, 0.3
TILT, ROTARY = np.pi / 2, np.pi
SPLITS = 10

PAGE = """# Two-axis positioners: what to expect

Made by `python scripts/studies/positioner_errors.py --camera <positioner_camera> --markdown docs/positioner.md`.

A tilt-rotary positioner is calibrated by touching a mark on its table with a robot's tip. Five points give its two axes
in closed form (`calib.positioner.five_point`): one at zero, two turned about the rotary axis, two about the tilt axis.
Any number of points, of one mark or several, goes through the same engine as every other calibration; the angles then
count, and the noise averages out. [robots/positioner](../robots/positioner/README.md) is a case to run.

## Expected errors

Errors are of {points} points anywhere on a table of 1 m x 1 m x 0.3 m, the tilt axis within +-90 deg and the rotary
axis within +-180: where a point known at zero is predicted to be, minus the truth, as 3D rms over {trials} simulated
calibrations with {noise:g} mm of noise on each touched coordinate. The angles are exact. *Foretold* is what the fits
say themselves (`calib.positioner.table_error`), from their covariance. The mark is 300 mm from the rotary axis, unless
it is said otherwise. *Published* are the figures of an independent computation with the same set-up.

{expected}

So turn far, punch the mark far from the rotary axis, and touch more than five points: they also leave residuals, which
the closed form has none of. Turns below 60 deg and marks within 100 mm of an axis are told as findings, with the error
to be expected of the axis; and so are turns that differ from what the angles say by six standard deviations, as where a
point was touched wrongly.

## What touched points determine

The lines of the axes and the marks, no more: 4 numbers for a revolute axis, 2 (a direction) for a prismatic one, 3 for
a mark. Two revolute axes and one mark are 11 numbers. Where the frames' origins sit on the axes, and how they are
turned about them, is convention: the closed form lets the x axes point at the mark; the engine leaves them nearest to
the nominal URDF. No place of a table point depends on it. The parameters are named after the URDF's joints, and those
that the convention moves have no sigma; `null_space = "minimal"` frees exactly as many as the data determine.

Turntables, tracks, and positioners with three axes are the same: `calib.positioner.circle_point_analysis` finds every
axis from sweeps of one joint at a time, with radial and axial residuals as a check of each, and
`calib.positioner.axes_robot` makes a machine of them where no URDF is at hand.

## In one cell

What touched the marks may be an arm whose joint readings are the measurement (`kind = "arm"` in
[the job](formats.md)); the tip of its spike comes first, by pivoting (`calib.positioner.pivot`). The base that is found
is then the positioner's place in the arm's base, and `calib cell` writes one URDF of both. Two arms that touch the same
points stand to each other as `calib.positioner.relative_base` says, with covariance and residuals.
"""

REAL = """
## A real positioner

A part positioner before a fixed camera, 205 poses of a target (ROS-Industrial, industrial_calibration, Apache-2.0; job
by `scripts/examples/positioner_camera_job.py`). Base and tool alone, and with the placement of the second axis to the
first, are identified from three quarters of the poses; the errors are of the rest, over ten random splits.

{rows}

The placement is better in {better} of {splits} splits.
"""


# ---- the machine, made here ----------------------------------------------------------------------------------------


def rotation(w: list[float]) -> Array:
    """The rotation by a vector, in rad (Rodrigues)."""
    v = np.array(w)
    angle = float(np.linalg.norm(v))
    x, y, z = v / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def frame(R: Array, t: list[float]) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


Q = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
B_P = frame(rotation([0.02, -0.03, 0.4]) @ Q, [1.5, -0.2, 0.6])
L_R = frame(Q @ rotation([0.004, -0.003, 0.0]), [0.06, 0.0, 0.015])


def about_z(angle: Array) -> Array:
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, 0, 0] = T[:, 1, 1] = np.cos(angle)
    T[:, 1, 0] = np.sin(angle)
    T[:, 0, 1] = -T[:, 1, 0]
    return T


def places(q: Array, points: Array) -> Array:
    """Points (N, 3) of the table, in the robot's base, at readings (N, 2): tilt, rotary."""
    T = B_P @ about_z(q[:, 0]) @ L_R @ about_z(q[:, 1])
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], np.broadcast_to(points, (len(q), 3))) + T[:, :3, 3])


def five(tilt: float, rotary: float) -> Array:
    return np.radians([(0, 0), (0, rotary), (0, -rotary), (tilt, 0), (-tilt, 0)])


TWENTY = np.radians(
    [(0.0, r) for r in (0, 60, 120, 180, -120, -60)]
    + [(t, 0.0) for t in (90, 45, -45, -90)]
    + [(60, 90), (60, -90), (-60, 90), (-60, -90), (30, 180), (-30, 180), (90, 45), (-90, 45), (80, 150), (-80, -150)]
)


# ---- the study -----------------------------------------------------------------------------------------------------

Trial = Callable[[Array, Array, Array, Array], tuple[Array, float]]


@dataclass(frozen=True)
class Row:
    """One line of the table: what is touched, how it is evaluated, and what the published table says, in mm."""

    name: str
    readings: Array
    mark: tuple[float, float, float]
    evaluate: Trial
    published: float


def closed(_: Array, touched: Array, zero: Array, q: Array) -> tuple[Array, float]:
    """Predictions of the closed form; it foretells nothing."""
    return positioner.five_point(*touched).points(zero, q[:, 0], q[:, 1]), float("nan")


def fitted(readings: Array, touched: Array, zero: Array, q: Array) -> tuple[Array, float]:
    """Predictions of the least-squares fit, begun with the machine as designed, and the rms it foretells."""
    columns = {"tilt [rad]": readings[:, 0], "rotary [rad]": readings[:, 1]}
    columns |= {f"{axis} [m]": touched[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, DESIGNED, sigma=NOISE)
    fit = calib.identify(positioner.axes_model(DESIGNED), data, model_sigmas=[0.0])
    return positioner.table_points(fit, zero, q), positioner.table_error(fit, zero, q).rms


# As designed: axes that meet at right angles, nothing else known.
DESIGNED = calib.load_robot(
    parse_urdf(
        b'<robot name="positioner"><link name="base"/><link name="cradle"/><link name="table"/>'
        b'<joint name="tilt" type="continuous"><parent link="base"/><child link="cradle"/><axis xyz="0 0 1"/></joint>'
        b'<joint name="rotary" type="continuous"><parent link="cradle"/><child link="table"/>'
        b'<origin xyz="0 0 0" rpy="1.5707963267948966 0 1.5707963267948966"/><axis xyz="0 0 1"/></joint></robot>',
        "designed",
    ),
    "table",
)
MARK = (0.3, 0.0, 0.08)
NEAR = (0.03, 0.0, 0.08)
ROWS = (
    Row("five points, +-30 deg, closed form", five(30, 30), MARK, closed, 2.17),
    Row("five points, +-60 deg, closed form", five(60, 60), MARK, closed, 0.60),
    Row("five points, +-90 deg, closed form", five(90, 90), MARK, closed, 0.33),
    Row("five points, +-60 deg, closed form, mark 30 mm from the axis", five(60, 60), NEAR, closed, 3.9),
    Row("the same five points, +-30 deg, least squares", five(30, 30), MARK, fitted, 1.30),
    Row("the same five points, +-60 deg, least squares", five(60, 60), MARK, fitted, 0.41),
    Row("five points, tilt +-90, rotary +-120 deg, least squares", five(90, 120), MARK, fitted, 0.23),
    Row("20 mixed poses, least squares", TWENTY, MARK, fitted, 0.100),
)


def study(row: Row, trials: int, seed: int = 1) -> tuple[float, float]:
    """Return the rms error of a row in mm over so many calibrations, and the rms that they foretell."""
    rng = np.random.default_rng(seed)
    seen = places(row.readings, np.array(row.mark))
    squares, foretold = [], []
    for _ in range(trials):
        touched = seen + rng.normal(scale=NOISE, size=seen.shape)
        points = np.column_stack(
            [rng.uniform(-EXTENT, EXTENT, (TABLE_POINTS, 2)), rng.uniform(0.0, HEIGHT, TABLE_POINTS)]
        )
        q = np.column_stack([rng.uniform(-TILT, TILT, TABLE_POINTS), rng.uniform(-ROTARY, ROTARY, TABLE_POINTS)])
        predicted, told = row.evaluate(row.readings, touched, places(np.zeros_like(q), points), q)
        squares.append(np.mean(np.sum((predicted - places(q, points)) ** 2, axis=1)))
        foretold.append(told**2)
    return 1e3 * float(np.sqrt(np.mean(squares))), 1e3 * float(np.sqrt(np.mean(foretold)))


def splits(folder: Path) -> Array:
    """Held-out errors (10, 4) of a real positioner: rms in mm, mean in deg, without and with a free placement."""
    columns = camera.read(folder)
    robot = calib.load_robot(parse_urdf(camera.URDF.encode(), "positioner.urdf"), "target_mount")
    model = calib.error_model(robot, placements=["joint_2"], tool="pose")
    found = []
    for seed in range(SPLITS):
        identified, held_out = (
            calib.read_measurements({name: values[rows] for name, values in columns.items()}, robot, "pose")
            for rows in camera.split(len(columns["x [m]"]), seed)
        )
        fit = calib.identify(model, identified)
        row = []
        for machine in (fit.nominal, fit.machine):
            (r,) = residuals_of(fit, [held_out], machine)
            row += [1e3 * np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))]
            row += [float(np.degrees(np.mean(np.linalg.norm(r[:, 3:], axis=1))))]
        found.append(row)
    return np.array(found)


def expected_rows(trials: int) -> list[tuple[str, str, str, str]]:
    rows = []
    for row in ROWS:
        rms, foretold = study(row, trials)
        rows.append((row.name, f"{rms:.3f}", "" if np.isnan(foretold) else f"{foretold:.3f}", f"{row.published:g}"))
    return rows


def markdown(titles: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(titles)} |", f"|---|{'--:|' * (len(titles) - 1)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000, help="calibrations a row (default: 1000)")
    parser.add_argument("--camera", type=Path, metavar="FOLDER", help="the positioner_camera dataset")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the page to FILE")
    arguments = parser.parse_args()
    titles = ("touched, and how evaluated", "rms [mm]", "foretold [mm]", "published [mm]")
    rows: list[tuple[str, ...]] = [*expected_rows(arguments.trials)]
    tables = [(titles, rows)]
    page = PAGE.format(points=TABLE_POINTS, trials=arguments.trials, noise=1e3 * NOISE, expected=markdown(titles, rows))
    if arguments.camera is not None:
        try:
            found = splits(arguments.camera)
        except camera.NotTheDatasetError as problem:
            print(problem, file=sys.stderr)
            return 1
        titles = ("split", "position before [mm rms]", "after [mm rms]", "turn before [deg mean]", "after [deg mean]")
        order = found[:, [0, 2, 1, 3]]
        rows = [
            (name, *(f"{value:.3f}" for value in values))
            for name, values in [
                *((str(k + 1), values) for k, values in enumerate(order)),
                ("mean", order.mean(axis=0)),
            ]
        ]
        tables.append((titles, rows))
        better = int(np.count_nonzero(found[:, 2] < found[:, 0]))
        page += REAL.format(rows=markdown(titles, rows), better=better, splits=SPLITS)
    for titles, rows in tables:
        shown = Table()
        for k, title in enumerate(titles):
            shown.add_column(title, justify="right" if k else "left")
        for row in rows:
            shown.add_row(*row)
        Console().print(shown)
    if arguments.markdown is not None:
        arguments.markdown.write_text(page, encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
