"""Make the measurements of robots/arm_cmm: an arm CMM with known errors, watched by a tracker and put to the test.

    python scripts/simulate/arm_cmm.py [output folder] [--seed 1]

Its own mathematics, on purpose: whoever calibrates this arm cannot repeat a mistake made here. Lengths in mm, angles in
deg at the edges and rad inside. The same seed writes the same bytes.

Two arms of one geometry. The clean one has ideal encoders and makes the reference case. The realistic one has encoders
that sit off centre and count in steps, a probe ball and an operator, and makes all files of the acceptance tests.
"""

import argparse
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Nominal geometry: the 7 DH rows of the multi-joint CMM (a = 0); row 7 is the probe.
D = (100.0, 150.0, 450.0, 100.0, 350.0, 100.0, 150.0)
ALPHA_DEG = (-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)
# Zero offsets of the encoders: those of the articulated CMM whose offsets were identified from touched points.
OFFSETS_DEG = (2.4, -2.05, -1.5, 2.2, 1.2, -1.8)
# Sizes of the placement errors, per direction: those of the CMM's published error table.
LENGTH_ERRORS = (0.03, 0.14)
ANGLE_ERRORS_DEG = (0.06, 0.13)
# The reflector sits where the probe ball was, up to a few mm; the tracker stands three metres away, not quite upright.
TIP = (2.1, -1.4, 3.7)
BASE_TRANSLATION = (2860.0, -1240.0, -385.0)
BASE_ROTATION_DEG = (0.4, -0.7, 128.0)

SIGMA = 0.02
ENCODER_DECIMALS = 4
POSITION_DECIMALS = 4
IDENTIFICATION_ROWS, VALIDATION_ROWS = 60, 30
# Joints 1, 3, 5 swivel along the links, joints 2, 4, 6 are hinges.
RANGES_DEG = np.array([170.0, 110.0, 170.0, 140.0, 170.0, 120.0])

# The realistic arm. A grating of 20 mm radius that sits 0.5 to 1.5 um off centre errs by 25 to 75 urad, once a turn.
ECCENTRICITIES_DEG = (0.0014, 0.0043)
COUNTS_PER_TURN = 2**18
REALISTIC_ROWS = 100
COUNT_DECIMALS = 6
# Where the ball of the touch probe sits, off the nominal probe point; not where the reflector was.
BALL = (-0.83, 0.57, -1.24)
BALL_DIAMETER = 6.0
# How far the ball's centre strays at each touch, per axis: hand, seat and contact.
OPERATOR_SIGMA = 0.01

# Where things stand, in the arm's own frame.
PROBE_CONE = (430.0, -260.0, 150.0)
PROBE_TOUCHES = 20
CONES = {"near": (260.0, 90.0, 180.0), "middle": (120.0, 520.0, 120.0), "far": (-620.0, -430.0, 220.0)}
CONE_TOUCHES = 10
LENGTHS = (299.987, 600.012)
PLACES_PER_LENGTH = 10
SPHERE_DIAMETER = 24.9982
SPHERES = {"near": (340.0, 120.0, 260.0), "far": (-240.0, 600.0, 200.0)}
# Polar angle and number of the 25 points on the upper half.
PATTERN = ((0.0, 1), (22.5, 4), (45.0, 8), (67.5, 4), (90.0, 8))
# The shank's tilt from upright in the five articulations, and where it leans to.
ARTICULATIONS_DEG = ((0.0, 0.0), (45.0, 0.0), (45.0, 90.0), (45.0, 180.0), (45.0, 270.0))

SIZES = (f"{SPHERE_DIAMETER:.4f}", f"{BALL_DIAMETER:.4f}")
JOINTS = tuple(f"joint_{i} [deg]" for i in range(1, 7))
TRACKED = (*JOINTS, "x [mm]", "y [mm]", "z [mm]")


@dataclass(frozen=True)
class Placement:
    """What a frame is moved by, in its own axes: Trans(translation) Rx Ry Rz."""

    translation_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...]

    @cached_property
    def matrix(self) -> Array:
        rx, ry, rz = np.radians(self.rotation_deg)
        return translation(*self.translation_mm) @ rotation("x", rx) @ rotation("y", ry) @ rotation("z", rz)


@dataclass(frozen=True)
class Machine:
    """An arm before a tracker; ``placements[i]`` moves DH frame i, in which joint i + 1 (or the handle, i = 6) sits."""

    base: Placement
    placements: tuple[Placement, ...]
    offsets_deg: tuple[float, ...]
    tip: tuple[float, ...]


@dataclass(frozen=True)
class Encoders:
    """Encoders off centre that count: joint angle = reading + offset + cosine cos(reading) + sine sin(reading)."""

    cosine_deg: tuple[float, ...]
    sine_deg: tuple[float, ...]

    def readings_deg(self, turned_deg: Array) -> Array:
        """What they show when the joints have turned by so much from the encoders' zeros."""
        reading = turned_deg
        # A contraction by 1e-4 a round: four reach the last digit.
        for _ in range(6):
            u = np.radians(reading)
            reading = turned_deg - self.cosine_deg * np.cos(u) - self.sine_deg * np.sin(u)
        return np.asarray(np.round(reading * COUNTS_PER_TURN / 360.0) * 360.0 / COUNTS_PER_TURN)


def rotation(axis: str, angle: float) -> Array:
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j] = -matrix[j, i]
    return matrix


def translation(x: float, y: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def frames(machine: Machine, angles_deg: Array) -> list[Array]:
    """The DH frames 0..7 in the tracker's frame at the given encoder angles."""
    frame = machine.base.matrix @ machine.placements[0].matrix
    chain = [frame]
    turns = np.radians(np.append(angles_deg + machine.offsets_deg, 0.0))
    for turn, d, alpha, placement in zip(
        turns, D, np.radians(ALPHA_DEG), (*machine.placements[1:], NOWHERE), strict=True
    ):
        frame = frame @ rotation("z", turn) @ translation(0.0, 0.0, d) @ rotation("x", alpha) @ placement.matrix
        chain.append(frame)
    return chain


def tip_position(machine: Machine, angles_deg: Array) -> Array:
    """Where the reflector, or the probe ball's centre, is."""
    position: Array = (frames(machine, angles_deg)[7] @ np.append(machine.tip, 1.0))[:3]
    return position


NOWHERE = Placement((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
NOMINAL = Machine(NOWHERE, (NOWHERE,) * 7, (0.0,) * 6, (0.0,) * 3)


def true_machine(rng: np.random.Generator) -> Machine:
    """Draw the placement errors; every one is rounded to what the truth file shows."""

    def errors(sizes: tuple[float, float], decimals: int) -> list[float]:
        return [round(float(e), decimals) for e in rng.uniform(*sizes, 3) * rng.choice((-1.0, 1.0), 3)]

    # Joint 1 stands where the unknown base puts it; a rotation about a joint's own z is its offset.
    placements = [NOWHERE]
    for joint in range(2, 8):
        lengths, angles = errors(LENGTH_ERRORS, 4), errors(ANGLE_ERRORS_DEG, 5)
        placements.append(Placement(tuple(lengths), (*angles[:2], angles[2] if joint == 7 else 0.0)))
    return Machine(Placement(BASE_TRANSLATION, BASE_ROTATION_DEG), tuple(placements), OFFSETS_DEG, TIP)


def true_encoders(rng: np.random.Generator) -> Encoders:
    sizes, directions = rng.uniform(*ECCENTRICITIES_DEG, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    cosines, sines = sizes * np.cos(directions), sizes * np.sin(directions)
    return Encoders(tuple(round(float(c), 6) for c in cosines), tuple(round(float(s), 6) for s in sines))


def is_reachable(angles_deg: Array) -> bool:
    """Whether elbow, wrist and probe stay above the foot of the arm and the probe clear of its column."""
    chain = frames(NOMINAL, angles_deg)
    probe = chain[7][:3, 3]
    return all(chain[i][2, 3] > 0.0 for i in (3, 5, 7)) and bool(np.hypot(probe[0], probe[1]) > 200.0)


def reachable_poses(rng: np.random.Generator) -> Iterator[Array]:
    while True:
        angles = rng.uniform(-RANGES_DEG, RANGES_DEG)
        if is_reachable(angles):
            yield angles


def shown(values: Sequence[float] | Array, decimals: int) -> list[str]:
    return [f"{value:.{decimals}f}" for value in values]


# ---- watched by the tracker


def measure(machine: Machine, rows: int, rng: np.random.Generator) -> list[str]:
    """Table rows: encoder readings of random reachable poses and the noisy position of the reflector."""
    lines = []
    for angles in itertools.islice(reachable_poses(rng), rows):
        position = tip_position(machine, angles) + SIGMA * rng.standard_normal(3)
        lines.append(", ".join([*shown(angles, ENCODER_DECIMALS), *shown(position, POSITION_DECIMALS)]))
    return lines


def measure_realistic(machine: Machine, encoders: Encoders, rows: int, rng: np.random.Generator) -> list[str]:
    lines = []
    for turned in itertools.islice(reachable_poses(rng), rows):
        position = tip_position(machine, turned) + SIGMA * rng.standard_normal(3)
        readings = encoders.readings_deg(turned)
        lines.append(", ".join([*shown(readings, COUNT_DECIMALS), *shown(position, POSITION_DECIMALS)]))
    return lines


# ---- touched by hand


@dataclass(frozen=True)
class Touch:
    """Where the ball's centre shall be, and where its shank shall point to, give or take ``tilt_deg``."""

    point: Array
    shank: Array
    tilt_deg: float


@dataclass(frozen=True)
class Operator:
    """Who leads the ball of the realistic arm by hand; the arm's base is the world."""

    machine: Machine
    encoders: Encoders
    rng: np.random.Generator

    def lead(self, touches: Sequence[Touch]) -> list[list[str]]:
        """Readings of some touches in one articulation: each posture follows from the one before, the first is any."""
        for start in reachable_poses(self.rng):
            postures = [start]
            for touch in touches:
                reached = self._reach(postures[-1], touch)
                if reached is None:
                    break
                postures.append(reached)
            else:
                return [shown(self.encoders.readings_deg(turned), COUNT_DECIMALS) for turned in postures[1:]]
        raise AssertionError("the poses never end")

    def _reach(self, angles_deg: Array, touch: Touch) -> Array | None:
        """The joint angles at a touch, found by Gauss-Newton from a start; None where that leads out of reach."""
        point = touch.point + OPERATOR_SIGMA * self.rng.standard_normal(3)
        shank = touch.shank + np.radians(touch.tilt_deg) * self.rng.standard_normal(3)
        shank = shank / np.linalg.norm(shank)
        for _ in range(20):
            chain = frames(self.machine, angles_deg)
            ball, axis = (chain[7] @ np.append(self.machine.tip, 1.0))[:3], -chain[7][:3, 2]
            # A lever of 300 mm makes millimetres of the direction.
            error = np.concatenate([point - ball, 300.0 * (shank - axis)])
            if np.linalg.norm(error) < 1e-7:
                return angles_deg if is_reachable(angles_deg) and np.all(np.abs(angles_deg) < RANGES_DEG) else None
            joints = np.stack(chain[:6])
            z, o = joints[:, :3, 2], joints[:, :3, 3]
            J = np.hstack([np.cross(z, ball - o), 300.0 * np.cross(z, axis)])
            step = np.linalg.lstsq(J.T, error, rcond=1e-4)[0]
            angles_deg = angles_deg + np.degrees(step * min(1.0, 0.5 / float(np.linalg.norm(step))))
        return None


UP = np.array([0.0, 0.0, 1.0])


def cone_touches(operator: Operator, cones: Mapping[str, tuple[float, ...]], touches: int) -> list[str]:
    return [
        ", ".join([*readings, name])
        for name, centre in cones.items()
        for _ in range(touches)
        for readings in operator.lead([Touch(np.array(centre), UP, 25.0)])
    ]


def length_touches(operator: Operator) -> list[str]:
    """Both ends of two gauges, each in many places: about the arm, flat, leaning and upright."""
    lines = []
    for number in range(len(LENGTHS) * PLACES_PER_LENGTH):
        length = LENGTHS[number // PLACES_PER_LENGTH]
        for name, end in zip("AB", gauge(length, operator.rng), strict=True):
            (readings,) = operator.lead([Touch(end, UP, 25.0)])
            lines.append(", ".join([*readings, name, f"{number + 1}", f"{length:.3f}"]))
    return lines


def gauge(length: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """The two ends of a gauge, somewhere the arm reaches with its probe pointing down."""
    while True:
        along = rng.standard_normal(3)
        half = 0.5 * length * along / np.linalg.norm(along)
        middle = np.append(rng.uniform(-600.0, 600.0, 2), rng.uniform(80.0, 500.0))
        ends = middle - half, middle + half
        if all(end[2] > 50.0 and np.hypot(*end[:2]) > 250.0 and np.linalg.norm(end) < 750.0 for end in ends):
            return ends


def direction(polar_deg: float, azimuth_deg: float) -> Array:
    polar, azimuth = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def on_sphere(place: str, normal: Array, shank: Array, tilt_deg: float) -> Touch:
    return Touch(np.array(SPHERES[place]) + 0.5 * (SPHERE_DIAMETER + BALL_DIAMETER) * normal, shank, tilt_deg)


def sphere_touches(operator: Operator) -> list[str]:
    """25 points over the upper half in one articulation; the shank leans away from the sphere."""
    pattern = [(polar, 360.0 * k / number + polar) for polar, number in PATTERN for k in range(number)]
    return [
        ", ".join([*readings, place, *SIZES])
        for place in SPHERES
        for readings in operator.lead(
            [on_sphere(place, direction(*p), direction(0.5 * p[0], p[1]), 5.0) for p in pattern]
        )
    ]


def articulation_touches(operator: Operator) -> list[str]:
    """Five points in each of five articulations: one where the shank points to, four around it."""
    lines = []
    for place in SPHERES:
        for number, (tilt, towards) in enumerate(ARTICULATIONS_DEG, start=1):
            shank, side = direction(tilt, towards), direction(tilt + 90.0, towards)
            across = np.cross(shank, side)
            touches = [on_sphere(place, n, shank, 2.0) for n in (shank, side, across, -side, -across)]
            lines += [", ".join([*readings, place, f"{number}", *SIZES]) for readings in operator.lead(touches)]
    return lines


# ---- files


def table(header: Sequence[str], comments: Sequence[str], lines: list[str], seed: int) -> str:
    first = f"Simulated, not measured on a real machine: scripts/simulate/arm_cmm.py, seed {seed}."
    return "\n".join([*(f"# {comment}" for comment in (first, *comments)), ", ".join(header), *lines, ""])


def tracked(purpose: str, lines: list[str], seed: int, truth: str = "truth.toml", *encoders: str) -> str:
    comments = (
        f"{len(lines)} random poses {purpose}; the errors of the arm are in {truth}.",
        *encoders,
        "Encoder readings; centre of a reflector in place of the probe ball, in the laser tracker's frame,",
        f"noise {SIGMA} mm per axis (1 sigma).",
    )
    return table(TRACKED, comments, lines, seed)


def touched(what: str, columns: Sequence[str], lines: list[str], seed: int) -> str:
    comments = (
        what,
        "The realistic arm, led by hand; its errors are in truth.toml and truth_realistic.toml.",
        f"Operator {OPERATOR_SIGMA} mm per axis (1 sigma), encoders with {COUNTS_PER_TURN} counts a turn.",
    )
    return table((*JOINTS, *columns), comments, lines, seed)


def truth(machine: Machine, seed: int) -> str:
    def section(name: str, placement: Placement, *first: str) -> list[str]:
        entries = (
            f"translation_mm = {list(placement.translation_mm)}",
            f"rotation_deg = {list(placement.rotation_deg)}",
        )
        return ["", f"[{name}]", *first, *entries]

    lines = [
        f"# The errors of the simulated arm: scripts/simulate/arm_cmm.py, seed {seed}.",
        "# A joint's own frame is moved by Trans(translation) Rx Ry Rz before it turns by reading + offset.",
        "# Not all of this can be seen from positions alone: compare predicted positions, not single numbers.",
        f"seed = {seed}",
        f"sigma_mm = {SIGMA}",
        f"tip_in_probe_mm = {list(machine.tip)}",
        *section("base_in_tracker", machine.base),
    ]
    for i, offset in enumerate(machine.offsets_deg):
        lines += section(f"joint_{i + 1}", machine.placements[i], f"offset_deg = {offset}")
    lines += section("handle_mount", machine.placements[6])
    return "\n".join([*lines, ""])


def truth_realistic(encoders: Encoders, seed: int) -> str:
    def places(name: str, points: Mapping[str, tuple[float, ...]]) -> list[str]:
        return ["", f"[{name}]", *(f"{place} = {list(point)}" for place, point in points.items())]

    lines = [
        f"# What the realistic arm has beside the geometry in truth.toml: scripts/simulate/arm_cmm.py, seed {seed}.",
        "# Joint angle = reading + offset + cosine cos(reading) + sine sin(reading), before the reading is counted.",
        f"seed = {seed}",
        f"counts_per_turn = {COUNTS_PER_TURN}",
        f"cosine_deg = {list(encoders.cosine_deg)}",
        f"sine_deg = {list(encoders.sine_deg)}",
        f"operator_sigma_mm = {OPERATOR_SIGMA}",
        f"ball_in_probe_mm = {list(BALL)}",
        f"ball_diameter_mm = {BALL_DIAMETER}",
        f"sphere_diameter_mm = {SPHERE_DIAMETER}",
        "",
        "# Centres in the frame of the arm's base.",
        *places("probe_cone_mm", {"probe": PROBE_CONE})[1:],
        *places("cones_mm", CONES),
        *places("spheres_mm", SPHERES),
    ]
    return "\n".join([*lines, ""])


def clean_files(machine: Machine, rng: np.random.Generator, seed: int) -> dict[str, str]:
    return {
        "truth.toml": truth(machine, seed),
        "identification.csv": tracked("to identify the arm", measure(machine, IDENTIFICATION_ROWS, rng), seed),
        "validation.csv": tracked("held out to validate", measure(machine, VALIDATION_ROWS, rng), seed),
    }


def realistic_files(machine: Machine, seed: int) -> dict[str, str]:
    # A stream of their own: whatever is added here leaves the reference case as it is.
    rng = np.random.default_rng([seed, 1])
    encoders = true_encoders(rng)
    operator = Operator(replace(machine, base=NOWHERE, tip=BALL), encoders, rng)
    identification = tracked(
        "to identify the realistic arm",
        measure_realistic(machine, encoders, REALISTIC_ROWS, rng),
        seed,
        "truth.toml and truth_realistic.toml",
        f"Encoders sit off centre and have {COUNTS_PER_TURN} counts a turn.",
    )
    probe = touched(
        f"To find the probe: one cone, touched in {PROBE_TOUCHES} articulations.",
        ("target",),
        cone_touches(operator, {"probe": PROBE_CONE}, PROBE_TOUCHES),
        seed,
    )
    cone = touched(
        f"Single-point articulation: {len(CONES)} cones, each touched in {CONE_TOUCHES} articulations.",
        ("target",),
        cone_touches(operator, CONES, CONE_TOUCHES),
        seed,
    )
    lengths = touched(
        f"Lengths: the two ends, cones A and B, of calibrated gauges in {len(LENGTHS) * PLACES_PER_LENGTH} places.",
        ("target", "pair", "length [mm]"),
        length_touches(operator),
        seed,
    )
    sphere = touched(
        "Probing: a reference sphere in two places, 25 points each in one articulation.",
        ("target", "diameter [mm]", "ball [mm]"),
        sphere_touches(operator),
        seed,
    )
    articulations = touched(
        "Articulated location: a reference sphere in two places, five points in each of five articulations.",
        ("target", "group", "diameter [mm]", "ball [mm]"),
        articulation_touches(operator),
        seed,
    )
    return {
        "truth_realistic.toml": truth_realistic(encoders, seed),
        "identification_realistic.csv": identification,
        "probe.csv": probe,
        "cone.csv": cone,
        "lengths.csv": lengths,
        "sphere.csv": sphere,
        "articulations.csv": articulations,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    case = Path(__file__).resolve().parents[2] / "robots" / "arm_cmm"
    parser.add_argument("folder", nargs="?", type=Path, default=case, help="where to write (default: robots/arm_cmm)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()

    rng = np.random.default_rng(arguments.seed)
    machine = true_machine(rng)
    texts = clean_files(machine, rng, arguments.seed) | realistic_files(machine, arguments.seed)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (arguments.folder / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.folder / name)


if __name__ == "__main__":
    main()
