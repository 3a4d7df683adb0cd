"""The machine for given values of its parameters.

The state of a machine is one vector: six deviations of every chain joint, the joint offsets, the coefficients of the
joint terms, six values for the pose of the base in the instrument's frame at every set-up, six for the pose of every
tool in the tip link, six for every target in the instrument's frame, one for every scalar. Parameters are entries of
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import RobotError
from calib.foundations.sealing import sealed
from calib.identification.parameters import Entries, Parameter
from calib.robot.deviation import Motions
from calib.robot.robot import Deviations, Robot

POSE = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Frames:
    """Base poses (b, 4, 4) in the instrument's frame, one for every set-up, and tool poses (k, 4, 4) in the tip link.

    ``targets`` (m, 4, 4): poses in the instrument's frame of what was touched or seen: a point has its position, a
    plane lies in its frame's x and y. ``scalars`` (s,): unknown numbers of instruments, such as the offset of
    lengths, each in its own unit.
    """

    bases: Array
    tools: Array
    targets: Array = field(default_factory=lambda: read_only(np.zeros((0, 4, 4))))
    scalars: Array = field(default_factory=lambda: read_only(np.zeros(0)))

    @property
    def base(self) -> Array:
        """The base pose (4, 4) of the first set-up."""
        return np.asarray(self.bases[0])


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Machine:
    """A machine: the robot's deviations, and where its base, its tools and the targets are.

    ``base_twists`` (b, 6, 6), ``tool_twists`` (k, 6, 6) and ``target_twists`` (m, 6, 6) are the local twists of these
    frames for changes of their six values. ``motions``: of the deviations of the joints' placements, where they are
    made already.
    """

    deviations: Deviations
    frames: Frames
    base_twists: Array
    tool_twists: Array
    target_twists: Array
    motions: Motions | None = None


class Layout:
    """Where things stand in the state vector: ``base`` of the first of the set-ups, behind these the ``tools``, ...

    ``size``: of the whole vector.
    """

    def __init__(self, robot: Robot, setups: int = 1, tools: int = 0, targets: int = 0, scalars: int = 0) -> None:
        self.offsets = 6 * len(robot.chain)
        self.terms = self.offsets + len(robot.moving)
        self.base = self.terms + len(robot.terms)
        self.tools = self.base + 6 * setups
        self.targets = self.tools + 6 * tools
        self.scalars = self.targets + 6 * targets
        self.size = self.scalars + scalars

    @classmethod
    def of(cls, robot: Robot, frames: Frames) -> "Layout":
        """Return the layout of a machine with such frames."""
        return cls(robot, len(frames.bases), len(frames.tools), len(frames.targets), len(frames.scalars))

    def frame_of(self, parameter: Parameter) -> tuple[int, int]:
        """Return the number of the base, tool or target that a parameter is of, and which of its six values it is."""
        first = {"base": self.base, "tool": self.tools, "target": self.targets}[parameter.kind]
        return divmod(parameter.entries[0][0] - first, 6)


class States:
    """How a machine follows the values of its parameters: what is the same for all values, made once.

    ``layout``: of the state; ``entries``: which of it the parameters move. Deviations that are not free are as
    ``held``, or zero.
    """

    def __init__(
        self, robot: Robot, parameters: Sequence[Parameter], reference: Frames, held: Deviations | None = None
    ) -> None:
        self.layout, self.entries = Layout.of(robot, reference), Entries.of(parameters)
        self._at_rest = _reference_state(self.layout, reference, held)
        # Free entries are what the parameters say; the rest stay at the reference.
        self._at_rest[self.entries.entry] = 0.0
        self._bases, self._tools = len(reference.bases), len(reference.tools)
        placed = [slice(0, self.layout.offsets), slice(self.layout.base, self.layout.scalars)]
        self._placed = np.r_[*placed].reshape(-1, 6)
        self._turns = _turns(np.concatenate([reference.bases, reference.tools, reference.targets]))

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,) in SI units.

        Bases and tools: ``Trans(x, y, z) R Rx(rx) Ry(ry) Rz(rz)``, with R from the reference. Positions are thus
        absolute where they are free, and angles are small rotations of the reference, far from any gimbal lock.
        Targets: ``R Trans(x, y, z) Rx(rx) Ry(ry) Rz(rz)``, so that z is a plane's height and the plane turns about its
        middle.
        """
        layout, (entry, own, share) = self.layout, self.entries
        state = self._at_rest + np.bincount(entry, share * x[own], layout.size)
        if not np.isfinite(state[: layout.base]).all():
            raise RobotError("the deviations of the machine have numbers that are not finite.")
        values, n, b = state[self._placed], layout.offsets // 6, self._bases
        state.setflags(write=False)
        values.setflags(write=False)
        # In one go: of few rows, half of the time is that of calls.
        E, W = Motions.of(values)
        poses, twists, t = self._turns @ E[n:], W[n:], b + self._tools
        poses[:t, :3, 3], twists[:t, :3, :3] = values[n : n + t, :3], poses[:t, :3, :3].transpose(0, 2, 1)
        return Machine(
            Deviations.trusted(values[:n], state[layout.offsets : layout.terms], state[layout.terms : layout.base]),
            Frames(poses[:b], poses[b:t], poses[t:], state[layout.scalars :]),
            twists[:b],
            twists[b:t],
            twists[t:],
            Motions(E[:n], W[:n]),
        )


def machine(
    robot: Robot, parameters: Sequence[Parameter], reference: Frames, x: Array, held: Deviations | None = None
) -> Machine:
    """Return the machine at parameter values x (p,): that of :class:`States`."""
    return States(robot, parameters, reference, held).machine(x)


def values_at(
    robot: Robot, parameters: Sequence[Parameter], reference: Frames, held: Deviations | None = None
) -> Array:
    """Return the parameter values (p,) of a robot, nominal or as ``held``, with all frames at ``reference``."""
    state = _reference_state(Layout.of(robot, reference), reference, held)
    entry, own, share = Entries.of(parameters)
    found = np.zeros(len(parameters))
    np.add.at(found, own, share * state[entry])
    return found


def _reference_state(layout: Layout, reference: Frames, held: Deviations | None) -> Array:
    state = np.zeros(layout.size)
    if held is not None:
        state[: layout.base] = np.concatenate([held.placements.ravel(), held.offsets, held.terms])
    frames = state[layout.base : layout.targets].reshape(-1, 6)
    frames[:, :3] = np.concatenate([reference.bases, reference.tools])[:, :3, 3]
    targets = state[layout.targets : layout.scalars].reshape(-1, 6)
    targets[:, :3] = (rigid.inverse(_turns(reference.targets)) @ reference.targets)[:, :3, 3]
    state[layout.scalars :] = reference.scalars
    return state


def _turns(poses: Array) -> Array:
    """Return the rotations of poses (m, 4, 4) as placements at the origin."""
    return rigid.placement(poses[:, :3, :3], np.zeros((len(poses), 3)))
