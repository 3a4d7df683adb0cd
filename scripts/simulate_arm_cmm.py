"""Make the measurements of robots/arm_cmm: an arm CMM with known errors, watched by a laser tracker.

    python scripts/simulate_arm_cmm.py [output folder] [--seed 1]

Its own mathematics, on purpose: whoever calibrates this arm cannot repeat a mistake made here. Lengths in mm, angles in
deg at the edges and rad inside. The same seed writes the same bytes.
"""

import argparse
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Placement:
    """What a frame is moved by, in its own axes: Trans(translation) Rx Ry Rz."""

    translation_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...]

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
    frame = machine.base.matrix() @ machine.placements[0].matrix()
    chain = [frame]
    turns = np.radians(np.append(angles_deg + machine.offsets_deg, 0.0))
    for turn, d, alpha, placement in zip(
        turns, D, np.radians(ALPHA_DEG), (*machine.placements[1:], NOWHERE), strict=True
    ):
        frame = frame @ rotation("z", turn) @ translation(0.0, 0.0, d) @ rotation("x", alpha) @ placement.matrix()
        chain.append(frame)
    return chain


def reflector(machine: Machine, angles_deg: Array) -> Array:
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


def is_reachable(angles_deg: Array) -> bool:
    """Whether elbow, wrist and probe stay above the foot of the arm and the probe clear of its column."""
    chain = frames(NOMINAL, angles_deg)
    probe = chain[7][:3, 3]
    return all(chain[i][2, 3] > 0.0 for i in (3, 5, 7)) and bool(np.hypot(probe[0], probe[1]) > 200.0)


def measure(machine: Machine, rows: int, rng: np.random.Generator) -> list[str]:
    """Table rows: encoder readings of random reachable poses and the noisy position of the reflector."""
    lines: list[str] = []
    while len(lines) < rows:
        angles = rng.uniform(-RANGES_DEG, RANGES_DEG)
        if not is_reachable(angles):
            continue
        position = reflector(machine, angles) + SIGMA * rng.standard_normal(3)
        readings = [f"{angle:.{ENCODER_DECIMALS}f}" for angle in angles]
        lines.append(", ".join([*readings, *(f"{x:.{POSITION_DECIMALS}f}" for x in position)]))
    return lines


def table(purpose: str, lines: list[str], seed: int) -> str:
    header = ", ".join([*(f"joint_{i} [deg]" for i in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"])
    return "\n".join(
        [
            f"# Simulated, not measured on a real machine: scripts/simulate_arm_cmm.py, seed {seed}.",
            f"# {len(lines)} random poses {purpose}; the errors of the arm are in truth.toml.",
            "# Encoder readings; centre of a reflector in place of the probe ball, in the laser tracker's frame,",
            f"# noise {SIGMA} mm per axis (1 sigma).",
            header,
            *lines,
            "",
        ]
    )


def truth(machine: Machine, seed: int) -> str:
    def section(name: str, placement: Placement, *first: str) -> list[str]:
        entries = (
            f"translation_mm = {list(placement.translation_mm)}",
            f"rotation_deg = {list(placement.rotation_deg)}",
        )
        return ["", f"[{name}]", *first, *entries]

    lines = [
        f"# The errors of the simulated arm: scripts/simulate_arm_cmm.py, seed {seed}.",
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    case = Path(__file__).resolve().parent.parent / "robots" / "arm_cmm"
    parser.add_argument("folder", nargs="?", type=Path, default=case, help="where to write (default: robots/arm_cmm)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()

    rng = np.random.default_rng(arguments.seed)
    machine = true_machine(rng)
    texts = {
        "truth.toml": truth(machine, arguments.seed),
        "identification.csv": table("to identify the arm", measure(machine, IDENTIFICATION_ROWS, rng), arguments.seed),
        "validation.csv": table("held out to validate", measure(machine, VALIDATION_ROWS, rng), arguments.seed),
    }
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (arguments.folder / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.folder / name)


if __name__ == "__main__":
    main()
