"""Streams of badly made arms, as calib reads them; how they are recorded is that of scripts/simulate/streams.py."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import calib
from scripts.simulate.streams import UR10, Motion, Recorded, motion, record
from tests.support import machines
from tests.support.machines import Array

__all__ = ["UR10", "Streams", "read", "streams"]


@dataclass(frozen=True)
class Streams:
    """What controller and tracker wrote down: ``joints`` and ``seen`` are tables, the truth beside them."""

    robot: calib.Robot
    machine: machines.Machine
    motion: Motion
    recorded: Recorded
    joints: dict[str, Array]
    seen: dict[str, Array]


def streams(seed: int, *, arm: tuple[str, str] = UR10, swing: float = 0.35, moved: bool = True, **how: Any) -> Streams:
    """Streams of an arm, badly made where it is ``moved``; ``how`` they are recorded, as ``record`` has it."""
    rng = np.random.default_rng(seed)
    robot, nominal = machines.load(*arm), machines.arm(*arm)
    made = nominal.moved(rng) if moved else nominal
    machine = machines.Machine(made, machines.anywhere(rng), {"tool": machines.pose((0.02, 0.03, 0.1))})
    moving = motion(rng, list(nominal.ranges.values()), swing=swing)
    found = record(rng, moving, lambda q: machine.see(q)[:, :3, 3], **how)
    columns = machines.table(nominal, found.readings, np.tile(np.eye(4), (len(found.stamps), 1, 1)), "position")
    joints = {name: values for name, values in columns.items() if name[0] not in "xyz"}
    seen = {f"{axis} [m]": found.points[:, k] for k, axis in enumerate("xyz")}
    return Streams(
        robot, machine, moving, found, {"time [s]": found.stamps, **joints}, {"time [s]": found.times, **seen}
    )


def read(made: Streams, **options: Any) -> calib.Measurements:
    """The streams as calib reads them."""
    return calib.measuring.read_stream(made.seen, made.robot, made.joints, **options)
