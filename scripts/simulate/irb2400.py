"""Make the measurements of robots/irb2400: an ABB IRB2400 with a parallelogram that is none, watched by a tracker.

    python scripts/simulate/irb2400.py [output folder] [--seed 7]

Its own mathematics, on purpose: whoever calibrates this robot cannot repeat a mistake made here. Lengths in mm, angles
in deg at the edges and rad inside. The same seed writes the same bytes; another seed is another robot.

    machine = Machine(seed)                    the robot: wrong links, springy drives, uneven gears, scatter
    machine.tcp(commands_deg)                  where its reflector really is, mm in the tracker's frame
    machine.measure(commands_deg, rng)         where the tracker says it is
    poses(seed)["test"]                        the commands of a set, deg
"""

import argparse
import itertools
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# The robot among the first ten whose start is most like the one the paper reports: 1.58 mm at most, 0.42 on average.
SEED = 7

# Nominal geometry, standard DH: Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta), beta = 0.
# theta = axis + THETA_DEG, but row 3 turns by the forearm's absolute angle less axis 2.
D = (615.0, 0.0, 0.0, 755.0, 0.0, 85.0)
A = (100.0, 705.0, 135.0, 0.0, 0.0, 0.0)
ALPHA_DEG = (-90.0, 0.0, -90.0, 90.0, -90.0, 0.0)
THETA_DEG = (0.0, -90.0, 0.0, 0.0, 0.0, 180.0)
LOWER_ARM, LEVER = A[1], 180.0

# Where the reflector is in the flange's frame, and where the robot's base is in the tracker's: three metres away.
REFLECTOR = (25.0, 0.0, 49.55)
BASE_TRANSLATION = (2790.0, -1060.0, -420.0)
BASE_ROTATION_DEG = (0.3, -0.5, 141.0)

# Sizes of the geometry's errors before they are scaled to the start the paper reports: one standard deviation each.
LENGTH_ERROR, ANGLE_ERROR = 0.12, 0.2e-3
# Links of the parallelogram, either sign: parallel ones are bored in pairs, so that what a pair has in common is larger
# than its difference, which alone is felt.
PAIR_ERRORS, PAIR_DIFFERENCES = (0.1, 0.25), (0.04, 0.12)
COAXIALITY_ERROR = 0.05
# What gravity twists the drives by, rad/Nm: what is left where a controller knows its robot's mass.
COMPLIANCES = np.array([0.0, 0.4e-6, 0.6e-6, 2e-6, 2e-6, 2e-6])
ORDERS = (1, 2, 5, 11)
HARMONICS = np.array([55e-6, 38e-6, 27e-6, 16e-6])
START_MEAN = 0.42

# ISO 9283 repeatability: one direction of approach, and both.
RP_ONE_SIDE, RP_BOTH_SIDES = 0.060, 0.157
# What the tracker's data sheet gives as two standard deviations: mm, and mm per mm of distance.
TRACKER, TRACKER_PER_MM = 0.015, 6e-6

# Masses [kg] and centres of mass [mm] in the URDF's link frames, plausible, as in the URDF. Base and turret do not
# matter: no axis lifts them. The reflector weighs nothing.
GRAVITY = 9.81
MASSES = {
    "lower_arm": (38.0, (0.0, 50.0, 340.0)),
    "crank": (12.0, (-70.0, -80.0, 0.0)),
    "rod": (7.0, (0.0, -80.0, 352.5)),
    "forearm": (62.0, (-100.0, 0.0, 130.0)),
    "rear_lever": (5.0, (-90.0, -80.0, 0.0)),
    "wrist_roll": (21.0, (400.0, 0.0, 0.0)),
    "wrist_bend": (5.0, (20.0, 0.0, 0.0)),
    "wrist_disc": (1.0, (75.0, 0.0, 0.0)),
}

# Joint space: axes 1-3 in cells of 20 deg, and how far crank and lower arm may be off the right angle at the corners.
STEP = 20.0
AXIS_1, AXIS_2, AXIS_3 = (-140.0, 140.0), (-60.0, 80.0), (-60.0, 60.0)
LARGEST_SHEAR = 60.0
WRIST_RANGES_DEG = np.array([150.0, 100.0, 170.0])
WRIST_REFERENCE_DEG = (0.0, 30.0, 0.0)
COUNTS = {"base_fit": 10, "level2": 60, "harmonics": 300, "test": 284}

COMMAND_DECIMALS, POSITION_DECIMALS = 3, 4
JOINTS = tuple(f"joint_{i} [deg]" for i in range(1, 7))
POSITION = ("x [mm]", "y [mm]", "z [mm]")


# ---- kinematics


def along(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """Translations (..., 4, 4)."""
    x, y, z = np.broadcast_arrays(x, y, z)
    matrix = np.zeros((*x.shape, 4, 4))
    matrix[..., range(4), range(4)] = 1.0
    matrix[..., 0, 3], matrix[..., 1, 3], matrix[..., 2, 3] = x, y, z
    return matrix


def about(axis: str, angle: ArrayLike) -> Array:
    """Rotations (..., 4, 4) about x, y or z."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    angle = np.asarray(angle, dtype=float)
    matrix = np.zeros((*angle.shape, 4, 4))
    matrix[..., range(4), range(4)] = 1.0
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -np.sin(angle)
    return matrix


def four_bar(
    phi2: ArrayLike, psi: ArrayLike, L2: float, b: float, c: float, e: float, dx: float = 0.0, dy: float = 0.0
) -> tuple[Array, Array]:
    """Angles of the rear lever and of the rod, phi and gamma, in the plane of joint 2 (x forward, y up).

    L2 u(phi2) + e u(phi) = (dx, dy) + b u(psi) + c u(gamma), u(t) = (cos t, sin t): lower arm at phi2, crank at psi,
    whose shaft is (dx, dy) off that of the lower arm. The branch is the one of the nominal parallelogram.
    """
    phi2, psi = np.asarray(phi2, dtype=float), np.asarray(psi, dtype=float)
    # From the elbow to the end of the crank, the base of a triangle whose other sides are rear lever and rod.
    across = dx + b * np.cos(psi) - L2 * np.cos(phi2)
    up = dy + b * np.sin(psi) - L2 * np.sin(phi2)
    s = np.hypot(across, up)
    at_elbow = np.arccos((s**2 + e**2 - c**2) / (2.0 * e * s))
    phi = np.arctan2(up, across) - np.sign(np.sin(psi - phi2)) * at_elbow
    # On the turn of the crank's angle.
    phi = psi + np.angle(np.exp(1j * (phi - psi)))
    gamma = np.arctan2(e * np.sin(phi) - up, e * np.cos(phi) - across)
    return phi, gamma


@dataclass(frozen=True)
class Truth:
    """What is wrong with a robot. Rows of six belong to the DH rows, or to the axes 1-6.

    ``da[1]`` is the lower arm's length, in the DH row and in the parallelogram alike.
    """

    da: Array
    dd: Array
    dalpha: Array
    dtheta: Array
    dbeta_2: float
    crank: float
    rod: float
    rear_lever: float
    coaxiality: Array
    compliances: Array
    cosines: Array
    sines: Array
    half_gaps: Array

    def scaled(self, factor: float) -> "Truth":
        """All errors of the geometry are larger by a factor; drives and gears stay as they are."""
        return replace(self, **{name: getattr(self, name) * factor for name in GEOMETRY})


GEOMETRY = ("da", "dd", "dalpha", "dtheta", "dbeta_2", "crank", "rod", "rear_lever", "coaxiality")


def perfect() -> Truth:
    six = np.zeros(6)
    return Truth(six, six, six, six, 0.0, 0.0, 0.0, 0.0, np.zeros(2), six, np.zeros((6, 4)), np.zeros((6, 4)), six)


def forearm_angle(truth: Truth, axis_2: Array, axis_3: Array) -> Array:
    """The forearm's absolute angle, rad, 0 horizontal and positive down, when lower arm and crank stand at these."""
    lengths = LOWER_ARM + truth.da[1], LEVER + truth.crank, LOWER_ARM + truth.rod, LEVER + truth.rear_lever
    phi, _ = four_bar(0.5 * np.pi - axis_2, np.pi - axis_3, *lengths, *truth.coaxiality)
    return np.asarray(np.pi - phi)


def flange(truth: Truth, axes: Array) -> Array:
    """The flange (N, 4, 4) in the base's frame, drives at ``axes`` (N, 6), rad: offsets and the mechanism follow."""
    axes = axes + truth.dtheta
    turns = axes + np.radians(THETA_DEG)
    turns[:, 2] = forearm_angle(truth, axes[:, 1], axes[:, 2]) - axes[:, 1]
    beta = (0.0, truth.dbeta_2, 0.0, 0.0, 0.0, 0.0)
    frame = np.broadcast_to(np.eye(4), (len(axes), 4, 4))
    for i in range(6):
        frame = frame @ about("z", turns[:, i]) @ along(A[i] + truth.da[i], 0.0, D[i] + truth.dd[i])
        frame = frame @ about("x", np.radians(ALPHA_DEG[i]) + truth.dalpha[i]) @ about("y", beta[i])
    return frame


def links(axes: Array) -> dict[str, Array]:
    """The links that gravity pulls at, (N, 4, 4) in the base's frame, of the nominal robot; axes (N, 6) in rad."""
    q1, q2, q3, q4, q5, q6 = axes.T
    shoulder = about("z", q1) @ along(100.0, 0.0, 615.0)
    lower_arm = shoulder @ about("y", q2)
    crank = shoulder @ about("y", q3)
    # All links of an ideal parallelogram keep the angle of the one they are parallel to.
    forearm = lower_arm @ along(0.0, 0.0, 705.0) @ about("y", q3 - q2)
    rod = crank @ along(-LEVER, 0.0, 0.0) @ about("y", q2 - q3)
    wrist_roll = forearm @ along(0.0, 0.0, 135.0) @ about("x", q4)
    wrist_bend = wrist_roll @ along(755.0, 0.0, 0.0) @ about("y", q5)
    return {
        "lower_arm": lower_arm,
        "crank": crank,
        "rod": rod,
        "forearm": forearm,
        "rear_lever": forearm,
        "wrist_roll": wrist_roll,
        "wrist_bend": wrist_bend,
        "wrist_disc": wrist_bend @ about("x", q6),
    }


def potential(axes: Array) -> Array:
    """Potential energy (N) of the nominal robot, Nm."""
    placed = links(axes)
    heights = [mass * (placed[name] @ (*centre, 1.0))[:, 2] for name, (mass, centre) in MASSES.items()]
    return np.asarray(GRAVITY * 1e-3 * np.sum(heights, axis=0))


def gravity_torques(axes: Array) -> Array:
    """What each axis must hold against gravity (N, 6), Nm: the slope of the potential energy."""
    # The energy is a sum of products of sines and cosines of the axes, each of order one at most: this is exact.
    half = 0.5 * np.pi * np.eye(6)
    return np.stack([0.5 * (potential(axes + step) - potential(axes - step)) for step in half], axis=1)


# ---- the machine


class Machine:
    """A simulated IRB2400 before a laser tracker. The seed decides its errors; effects can be switched off.

    Without wind-up and harmonics it is a truth that a geometric model with a closed loop can express.
    """

    def __init__(self, seed: int = SEED, *, wind_up: bool = True, harmonics: bool = True) -> None:
        truth = true_errors(seed)
        if not wind_up:
            truth = replace(truth, compliances=np.zeros(6))
        if not harmonics:
            truth = replace(truth, cosines=np.zeros((6, 4)), sines=np.zeros((6, 4)))
        self.seed = seed
        self.truth = truth

    def tcp(
        self, commands_deg: Array, rng: np.random.Generator | None = None, direction: ArrayLike | None = None
    ) -> Array:
        """Where the reflector really is (N, 3), mm in the tracker's frame; with scatter where ``rng`` is given.

        ``direction`` is +1 or -1, the side from which the axes reached their commands: one for all, per row (N, 1), or
        per axis (N, 6). Without it they all came from the side that the robot is calibrated for, +1.
        """
        positions = reflector(self.truth, commands_deg, direction)
        return positions if rng is None else positions + scatter_sigma() * rng.standard_normal(positions.shape)

    def measure(self, commands_deg: Array, rng: np.random.Generator, direction: ArrayLike | None = None) -> Array:
        """What the tracker reads (N, 3), mm: the scattered reflector and the tracker's own noise."""
        positions = self.tcp(commands_deg, rng, direction)
        return positions + tracker_sigma(positions)[:, None] * rng.standard_normal(positions.shape)


def reflector(truth: Truth, commands_deg: ArrayLike, direction: ArrayLike | None = None) -> Array:
    """Reflector positions (N, 3), mm in the tracker's frame, without scatter."""
    commands = np.radians(np.atleast_2d(commands_deg))
    axes = commands - truth.compliances * gravity_torques(commands)
    for order, cosines, sines in zip(ORDERS, truth.cosines.T, truth.sines.T, strict=True):
        axes = axes + cosines * np.cos(order * commands) + sines * np.sin(order * commands)
    if direction is not None:
        axes = axes + truth.half_gaps * (np.asarray(direction, dtype=float) - 1.0)
    return np.asarray((base() @ flange(truth, axes) @ (*REFLECTOR, 1.0))[:, :3])


def base() -> Array:
    """Where the robot stands in the tracker's frame (4, 4)."""
    x, y, z = np.radians(BASE_ROTATION_DEG)
    return along(*BASE_TRANSLATION) @ about("x", x) @ about("y", y) @ about("z", z)


def tracker_sigma(positions: Array) -> Array:
    """Standard deviation (N) of each coordinate: half of what the data sheet gives; the tracker is the origin."""
    return np.asarray(0.5 * (TRACKER + TRACKER_PER_MM * np.linalg.norm(positions, axis=1)))


# ---- repeatability


def repeatability(positions: Array) -> float:
    """RP of ISO 9283 of positions (N, 3) at one pose: the mean distance from their mean and three deviations of it."""
    distances = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    return float(distances.mean() + 3.0 * distances.std(ddof=1))


def scatter_sigma() -> float:
    """Standard deviation per coordinate that has RP_ONE_SIDE: distances of a unit normal cloud follow Maxwell's law."""
    mean = np.sqrt(8.0 / np.pi)
    return float(RP_ONE_SIDE / (mean + 3.0 * np.sqrt(3.0 - mean**2)))


def both_sides_repeatability(shifts: Array) -> Array:
    """RP (N) of a pose reached as often from either side, that shift the mean by +-``shifts`` (N), mm.

    The distance from the common mean has the mean square shift^2 + 3 sigma^2 and, by Gauss-Hermite over the coordinate
    along the shift and the exact mean over the two across, the mean here.
    """
    sigma = scatter_sigma()
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    radii, radius_weights = np.polynomial.laguerre.laggauss(24)
    lengthwise = (shifts[:, None] + sigma * nodes)[:, :, None]
    # Across, half the square of the distance in sigmas is exponentially distributed.
    distances = np.sqrt(lengthwise**2 + 2.0 * sigma**2 * radii)
    mean = np.einsum("nij,i,j->n", distances, weights / weights.sum(), radius_weights)
    return np.asarray(mean + 3.0 * np.sqrt(shifts**2 + 3.0 * sigma**2 - mean**2))


# ---- the truth


def true_errors(seed: int) -> Truth:
    """Draw the errors and scale the geometry's: the nominal robot misses the test poses by START_MEAN on average."""
    drawn = draw(np.random.default_rng([seed, 0]))
    test = poses(seed)["test"]
    factor, start = 1.0, 0.0
    # Nearly proportional: the geometry makes most of the error.
    while abs(start / START_MEAN - 1.0) > 1e-7:
        start = float(nominal_errors(drawn.scaled(factor), test).mean())
        factor *= START_MEAN / start
    scaled = rounded(drawn.scaled(factor))
    return replace(scaled, half_gaps=np.round(scaled.half_gaps * gap_factor(scaled, test), 9))


def draw(rng: np.random.Generator) -> Truth:
    lengths, angles = LENGTH_ERROR * rng.standard_normal((2, 6)), ANGLE_ERROR * rng.standard_normal((2, 6))
    (da, dd), (dalpha, dtheta) = lengths, angles
    # Joints 2 and 3 are parallel: Hayati's beta in place of d.
    dd[1] = 0.0
    common = rng.uniform(*PAIR_ERRORS, 2) * rng.choice((-1.0, 1.0), 2)
    half = 0.5 * rng.uniform(*PAIR_DIFFERENCES, 2) * rng.choice((-1.0, 1.0), 2)
    (da[1], lever), (rod, crank) = common + half, common - half
    sizes = HARMONICS * rng.uniform(0.5, 1.5, (6, 4))
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, 4))
    return Truth(
        da,
        dd,
        dalpha,
        dtheta,
        ANGLE_ERROR * float(rng.standard_normal()),
        float(crank),
        float(rod),
        float(lever),
        COAXIALITY_ERROR * rng.standard_normal(2),
        COMPLIANCES * rng.uniform(0.7, 1.3, 6),
        sizes * np.cos(phases),
        sizes * np.sin(phases),
        rng.uniform(0.5, 1.5, 6) * rng.choice((-1.0, 1.0), 6),
    )


def rounded(truth: Truth) -> Truth:
    """As the truth file shows it: lengths to 10 nm, angles to nrad; gaps come later."""
    digits = {"da": 5, "dd": 5, "crank": 5, "rod": 5, "rear_lever": 5, "coaxiality": 5, "compliances": 11}
    values = {
        f.name: np.round(getattr(truth, f.name), digits.get(f.name, 9)) for f in fields(truth) if f.name != "half_gaps"
    }
    return replace(truth, **values)


def gap_factor(truth: Truth, commands_deg: Array) -> float:
    """What to multiply the gaps by for the poses' repeatability from both sides to be RP_BOTH_SIDES on average."""
    unit = replace(truth, half_gaps=truth.half_gaps * 1e-6)
    apart = reflector(unit, commands_deg, 1.0) - reflector(unit, commands_deg, -1.0)
    shifts = 0.5e6 * np.linalg.norm(apart, axis=1)
    low, high = 0.0, 1e-3
    for _ in range(30):
        middle = 0.5 * (low + high)
        enough = float(both_sides_repeatability(shifts * middle).mean()) > RP_BOTH_SIDES
        low, high = (low, middle) if enough else (middle, high)
    return high


def nominal_errors(truth: Truth, commands_deg: Array) -> Array:
    """Distances (N), mm, of the nominal robot from the true one, once its base and its reflector are fitted."""
    target = reflector(truth, commands_deg)
    frames = flange(perfect(), np.radians(commands_deg))
    turn, origin, point = base()[:3, :3], base()[:3, 3], np.array(REFLECTOR)
    for _ in range(4):
        arms = (frames[:, :3, :3] @ point + frames[:, :3, 3]) @ turn.T
        rows = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -skew(arms), turn @ frames[:, :3, :3]], 2)
        misses = target - arms - origin
        step = np.linalg.lstsq(rows.reshape(-1, 9), misses.ravel(), rcond=None)[0]
        angle = float(np.linalg.norm(step[3:6]))
        axis = skew(step[None, 3:6] / max(angle, 1e-300))[0]
        turn = (np.eye(3) + np.sin(angle) * axis + (1.0 - np.cos(angle)) * axis @ axis) @ turn
        origin, point = origin + step[:3], point + step[6:]
    return np.asarray(np.linalg.norm(misses, axis=1))


def skew(vectors: Array) -> Array:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


# ---- poses


def nodes() -> Array:
    """The corners of all cells, deg (N, 6)."""
    axes = [np.arange(low, high + 1.0, STEP) for low, high in (AXIS_1, AXIS_2, AXIS_3)]
    corners = [q for q in itertools.product(*axes) if abs(q[2] - q[1]) <= LARGEST_SHEAR]
    return np.array([[*corner, *WRIST_REFERENCE_DEG] for corner in corners])


def plane_grid() -> Array:
    """Axes 2 and 3 in steps of half a cell, all others still: deg (N, 6)."""
    axes = [np.arange(low, high + 1.0, 0.5 * STEP) for low, high in (AXIS_2, AXIS_3)]
    corners = [q for q in itertools.product(*axes) if abs(q[1] - q[0]) <= LARGEST_SHEAR]
    return np.array([[0.0, *corner, *WRIST_REFERENCE_DEG] for corner in corners])


def in_a_cell(axis_2: float, axis_3: float) -> bool:
    """Whether all corners of the cell around are nodes."""
    column = (axis_2 - AXIS_2[0]) // STEP * STEP + AXIS_2[0]
    row = (axis_3 - AXIS_3[0]) // STEP * STEP + AXIS_3[0]
    return bool(abs(row - column) + STEP <= LARGEST_SHEAR)


def random_poses(count: int, rng: np.random.Generator) -> Array:
    """Commands anywhere in the cells and in the wrist's ranges, deg (count, 6)."""
    lows = np.array([AXIS_1[0], AXIS_2[0], AXIS_3[0], *-WRIST_RANGES_DEG])
    highs = np.array([AXIS_1[1], AXIS_2[1], AXIS_3[1], *WRIST_RANGES_DEG])
    drawn = (np.round(rng.uniform(lows, highs), COMMAND_DECIMALS) for _ in itertools.count())
    return np.array(list(itertools.islice((q for q in drawn if in_a_cell(q[1], q[2])), count)))


def poses(seed: int) -> dict[str, Array]:
    """The commands of every set, deg (N, 6)."""
    random = {
        name: random_poses(count, np.random.default_rng([seed, 1, i])) for i, (name, count) in enumerate(COUNTS.items())
    }
    return random | {"level1": plane_grid(), "nodes": nodes()}


def noise(seed: int, name: str) -> np.random.Generator:
    """The scatter and the tracker's noise of a set: a stream of its own, so that no set disturbs another."""
    return np.random.default_rng([seed, 2, *name.encode()])


# ---- files


def rows(commands_deg: Array, positions: Array, *words: tuple[str, ...]) -> list[str]:
    """Table rows: commands, positions, and any words after them."""
    texts = zip(*words, strict=True) if words else [()] * len(commands_deg)
    return [
        ", ".join([*(f"{q:.{COMMAND_DECIMALS}f}" for q in command), *(f"{x:.{POSITION_DECIMALS}f}" for x in p), *text])
        for command, p, text in zip(commands_deg, positions, texts, strict=True)
    ]


def table(seed: int, comments: tuple[str, ...], lines: list[str], *columns: str) -> str:
    first = f"Simulated, not measured on a real machine: scripts/simulate/irb2400.py, seed {seed}. Errors: truth.toml."
    header = ", ".join([*JOINTS, *POSITION, *columns])
    return "\n".join([*(f"# {comment}" for comment in (first, *comments)), header, *lines, ""])


PURPOSES = {
    "base_fit": "{} poses to find the base in the tracker's frame.",
    "level1": "{} poses over axes 2 and 3, all other axes still: the joint level.",
    "level2": "{} random poses: the kinematic level.",
    "harmonics": "{} random poses: the kinematic level with joint harmonics.",
    "nodes": "{} corners of sector cells of 20 deg over axes 1-3, the wrist at its reference: the residual level.",
    "test": "{} random test poses.",
}
COLUMNS = "Commanded axes (axis 3 is the forearm's absolute angle); reflector in the laser tracker's frame."


def files(seed: int) -> dict[str, str]:
    machine, sets = Machine(seed), poses(seed)
    one_side = "All axes approached from the same side."
    texts = {"truth.toml": truth_text(machine)}
    for name, purpose in PURPOSES.items():
        measured = machine.measure(sets[name], noise(seed, name))
        comments = purpose.format(len(measured)), COLUMNS, one_side
        texts[f"{name}.csv"] = table(seed, comments, rows(sets[name], measured))

    test = sets["test"]
    rng = noise(seed, "test_both_sides")
    direction = rng.choice((-1.0, 1.0), (len(test), 1))
    measured = machine.measure(test, rng, direction)
    comments = "The test poses again, approached from either side.", COLUMNS, "direction: + the usual side of all axes."
    sides = tuple("+" if d > 0.0 else "-" for d in direction[:, 0])
    texts["test_both_sides.csv"] = table(seed, comments, rows(test, measured, sides), "direction")
    comments = "Where the reflector really is at the test poses: no scatter, no tracker.", COLUMNS, one_side
    texts["test_truth.csv"] = table(seed, comments, rows(test, machine.tcp(test)))
    return texts


def truth_text(machine: Machine) -> str:
    truth = machine.truth

    def shown(values: ArrayLike, digits: int) -> str:
        # Adding nothing makes 0.0 of -0.0.
        return str((np.round(np.asarray(values, dtype=float), digits) + 0.0).tolist())

    def micro(values: ArrayLike) -> str:
        return shown(np.asarray(values) * 1e6, 5)

    lines = [
        f"# The errors of the simulated IRB2400: scripts/simulate/irb2400.py, seed {machine.seed}.",
        "# Not all of this can be seen from positions alone: compare predicted positions, not single numbers.",
        f"seed = {machine.seed}",
        f"base_translation_mm = {list(BASE_TRANSLATION)}",
        "# Trans(translation) Rx Ry Rz, in the tracker's frame.",
        f"base_rotation_deg = {list(BASE_ROTATION_DEG)}",
        f"reflector_in_flange_mm = {list(REFLECTOR)}",
        "",
        "# Standard DH: Rot(z, theta + dtheta) Trans(z, d + dd) Trans(x, a + da) Rot(x, alpha + dalpha) Rot(y, beta).",
        "[dh]",
        f"da_mm = {shown(truth.da, 5)}",
        f"dd_mm = {shown(truth.dd, 5)}",
        f"dalpha_urad = {micro(truth.dalpha)}",
        f"dtheta_urad = {micro(truth.dtheta)}",
        f"beta_2_urad = {micro(truth.dbeta_2)}",
        "",
        "# The lower arm is the fourth link: its error is da_mm of row 2. dtheta of row 3 turns the crank.",
        "[four_bar]",
        f"crank_mm = {shown(truth.crank, 5)}",
        f"rod_mm = {shown(truth.rod, 5)}",
        f"rear_lever_mm = {shown(truth.rear_lever, 5)}",
        "# Where the crank's shaft is off that of the lower arm: forward, up.",
        f"coaxiality_mm = {shown(truth.coaxiality, 5)}",
        "# All that can be seen of the links, to first order: (lower arm - rod) and (rear lever - crank) by the lever.",
        f"k1_urad = {micro((truth.da[1] - truth.rod) / LEVER)}",
        f"k2_urad = {micro((truth.rear_lever - truth.crank) / LEVER)}",
        "",
        "# An axis stands at command - compliance * torque against gravity.",
        "[wind_up]",
        f"compliance_urad_per_Nm = {micro(truth.compliances)}",
        "",
        "# ... + cosine cos(order * command) + sine sin(order * command); a row per axis.",
        "[harmonics]",
        f"orders = {list(ORDERS)}",
        "cosines_urad = [",
        *(f"    {micro(row)}," for row in truth.cosines),
        "]",
        "sines_urad = [",
        *(f"    {micro(row)}," for row in truth.sines),
        "]",
        "",
        "# ... and, approached from the other side, - 2 half_gap.",
        "[scatter]",
        f"sigma_mm = {scatter_sigma():.6f}",
        f"half_gaps_urad = {micro(truth.half_gaps)}",
        f"tracker_sigma_mm = {0.5 * TRACKER}",
        f"tracker_sigma_um_per_m = {0.5e6 * TRACKER_PER_MM:.1f}",
    ]
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    case = Path(__file__).resolve().parents[2] / "robots" / "irb2400"
    parser.add_argument("folder", nargs="?", type=Path, default=case, help="where to write (default: robots/irb2400)")
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()

    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, text in files(arguments.seed).items():
        (arguments.folder / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.folder / name)


if __name__ == "__main__":
    main()
