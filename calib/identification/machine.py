"""The machine for given values of its parameters.

The state of a machine is one vector: six deviations of every chain joint, the joint offsets, the amounts of the joint
terms, six values for the pose of the base in the instrument's frame, six for the pose of every tool in the tip link.
Parameters are entries of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.parameters import Parameter, directions
from calib.robot import deviation
from calib.robot.robot import Deviations, Robot

POSE = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Base pose (4, 4) in the instrument's frame, and tool poses (k, 4, 4) in the tip link."""

    base: Array
    tools: Array


@dataclass(frozen=True, slots=True, eq=False)
class Machine:
    """A machine: the robot's deviations, and where its base and its tools are.

    ``base_twists`` (6, 6) and ``tool_twists`` (k, 6, 6) are the local twists of these frames for changes of their six
    values.
    """

    deviations: Deviations
    frames: Frames
    base_twists: Array
    tool_twists: Array


class Layout:
    """Where things stand in the state vector."""

    def __init__(self, robot: Robot) -> None:
        self.offsets = 6 * len(robot.chain)
        self.terms = self.offsets + len(robot.moving)
        self.base = self.terms + len(robot.terms)
        self.tools = self.base + 6


def machine(
    robot: Robot, parameters: Sequence[Parameter], reference: Frames, x: Array, held: Deviations | None = None
) -> Machine:
    """Return the machine at parameter values x (p,) in SI units; deviations that are not free are as ``held``, or zero.

    Base and tools: ``Trans(x, y, z) R Rx(rx) Ry(ry) Rz(rz)``, with R from ``reference``. Positions are thus absolute
    where they are free, and angles are small rotations of the reference, far from any gimbal lock.
    """
    layout = Layout(robot)
    state = _reference_state(layout, reference, held)
    S = directions(parameters, len(state))
    # Free entries are what the parameters say; the rest stay at the reference.
    state = np.where(np.any(S, axis=1), S @ x, state)
    references = np.concatenate([reference.base[None], reference.tools])
    values = state[layout.base :].reshape(-1, 6)
    rotations = references[:, :3, :3] @ rigid.rx_ry_rz(values[:, 3:])
    poses = rigid.placement(rotations, values[:, :3])
    twists = deviation.twists(values)
    twists[:, :3, :3] = np.swapaxes(rotations, -1, -2)
    placements = state[: layout.offsets].reshape(-1, 6)
    return Machine(
        Deviations(placements, state[layout.offsets : layout.terms], state[layout.terms : layout.base]),
        Frames(poses[0], poses[1:]),
        twists[0],
        twists[1:],
    )


def values_at(
    robot: Robot, parameters: Sequence[Parameter], reference: Frames, held: Deviations | None = None
) -> Array:
    """Return the parameter values (p,) of a robot, nominal or as ``held``, with base and tools at ``reference``."""
    state = _reference_state(Layout(robot), reference, held)
    return np.asarray(state @ directions(parameters, len(state)))


def _reference_state(layout: Layout, reference: Frames, held: Deviations | None) -> Array:
    state = np.zeros(layout.tools + 6 * len(reference.tools))
    if held is not None:
        state[: layout.base] = np.concatenate([held.placements.ravel(), held.offsets, held.terms])
    frames = state[layout.base :].reshape(-1, 6)
    frames[0, :3] = reference.base[:3, 3]
    frames[1:, :3] = reference.tools[:, :3, 3]
    return state
