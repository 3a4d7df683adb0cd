"""Forward kinematics and kinematic regressors of a tree of joints, by Pinocchio.

The only module that imports Pinocchio, which has no type stubs: what leaves it is plain arrays.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray, read_only

MovingType = Literal["revolute", "prismatic"]

# So many joints stand side by side for several rows; what Pinocchio keeps of more grows with their third power.
_SIDE_BY_SIDE = 30
# The columns of a placement that are the root's own, and the last row of any.
_ROOT = read_only(np.eye(4)[:, :3, None])
_LAST = read_only(np.eye(4)[3, :, None])


class Tree(NamedTuple):
    """Moving joints, parents before children.

    ``types`` (nj): each joint turns about, or slides along, the z axis of its own frame. ``parents`` (nj): number of
    the joint that carries it, -1 for the root. ``placements`` (nj, 4, 4): in the frame of that joint.
    """

    types: tuple[MovingType, ...]
    parents: tuple[int, ...]
    placements: Array


class Frame(NamedTuple):
    """A frame at ``placement`` (4, 4) in the frame of a joint; joint -1 is the root."""

    joint: int
    placement: Array


class Mass(NamedTuple):
    """A mass in kg whose centre (3,) is at rest, in m, in the frame of a joint; joint -1 is the root.

    ``inertia`` (3, 3): about the centre, along the axes of that frame, in kg m^2.
    """

    joint: int
    mass: float
    centre: Array
    inertia: Array


class Follow(NamedTuple):
    """How d numbers of N rows follow a frame that moves a little, in the axes of who tells them.

    ``shift`` (d, 3, N): by a shift of its origin; ``turn`` (d, 3, N): by a turn about its origin. None: not at all; (d,
    3, 1): all rows alike.
    """

    shift: Array | None
    turn: Array | None

    @property
    def size(self) -> int:
        """How many numbers there are: d."""
        rows = self.turn if self.shift is None else self.shift
        return 0 if rows is None else len(rows)

    def of(self, rows: IntArray) -> "Follow":
        """Return those of some rows."""
        return Follow(*(own if own is None or own.shape[2] == 1 else own[:, :, rows] for own in self))

    def negative(self) -> "Follow":
        """Return how numbers with the other sign follow."""
        return Follow(*(None if rows is None else -rows for rows in self))

    def seen_from(self, turned: Array) -> "Follow":
        """Return the same in other axes, which are ``turned`` (3, 3), or (N, 3, 3), in these."""
        if turned.ndim == 2:
            shift, turn = self
            return Follow(None if shift is None else turned.T @ shift, None if turn is None else turned.T @ turn)
        return Follow(*(None if rows is None else np.einsum("nik,din->dkn", turned, rows) for rows in self))


class Regressor(NamedTuple):
    """Placements of a frame over N configurations, and how they follow the placements of the joints.

    ``way``: the w joints that carry the frame, of ``joints`` in all; no other one moves it. ``carriers`` (4, w + 1, 3,
    N): x, y, z and origin, in the root's axes, of the root, then of every joint of the way after its own motion. The
    frame is at ``end`` (4, 4) in the last of them, and joint k of the way at ``placements[k]`` (w, 4, 4) in carrier k.
    Rows come last, so that what is done to all of them is done at once.
    """

    way: tuple[int, ...]
    joints: int
    carriers: Array
    placements: Array
    end: Array

    @property
    def placement(self) -> Array:
        """The frame (N, 4, 4) in the root."""
        return self.behind(self.end)

    def behind(self, placement: Array) -> Array:
        """Return a frame (N, 4, 4) in the root that is at a placement (4, 4) in the last carrier."""
        n = self.carriers.shape[3]
        # By column, and in these by row.
        found = np.empty((4, 4, n))
        found[:, 3] = _LAST
        np.matmul(placement.T, self.carriers[:, -1].reshape(4, 3 * n), out=found.reshape(4, 4 * n)[:, : 3 * n])
        return found.transpose(2, 1, 0)

    def through(self, rows: Follow, at: Array) -> Array:
        """Return how d numbers follow local twists of the carriers, (6, w + 1, d, N), or (3, w + 1, d, N) their turns.

        ``rows``: how they follow a frame that moves with this one, in the root's axes; turns alone are found where they
        do not follow its shifts. ``at`` (N, 3): the origin of that frame.
        """
        axes, origins = self.carriers[:3], self.carriers[3]
        _, s, _, n = axes.shape
        if rows.shift is None:
            assert rows.turn is not None, "what follows neither shifts nor turns follows nothing"
            return _along(rows.turn, axes, np.empty((3, s, rows.size, n)))
        # A shift of the frame by v and a turn by w, about its origin, change a number by a . v + b . w; a turn of
        # something at distance r from that origin by (r x a + b) . w. With y and z before x, y and z as well, r x a is
        # of three components in a row.
        arms, every = np.empty((5, s, 1, n)), np.empty((8, s, rows.size, n))
        np.einsum("scn,kscn->ksn", at.T - origins, axes, out=arms[2:, :, 0])
        _along(rows.shift, axes, every[2:5])
        arms[:2], every[:2] = arms[3:], every[3:5]
        found, turns = every[2:], every[5:]
        np.multiply(arms[:3], every[1:4], out=turns)
        turns -= arms[1:4] * every[:3]
        if rows.turn is not None:
            turns += _along(rows.turn, axes, np.empty_like(turns))
        return found

    def by_position(self, numbers: Array, types: Sequence[MovingType]) -> Array:
        """Return how numbers follow the positions of all joints (nj, d, N), from what :meth:`through` makes of them."""
        found = np.zeros((self.joints, *numbers.shape[2:]))
        turns_alone = len(numbers) == 3
        for k, j in enumerate(self.way):
            # A joint moves itself along, or about, its own z.
            if types[j] == "revolute":
                found[j] = numbers[-1, k + 1]
            elif not turns_alone:
                found[j] = numbers[2, k + 1]
        return found

    @property
    def local(self) -> tuple[Follow, Array]:
        """The six numbers of the frame's own local twist as they follow it, and where its origin is (N, 3)."""
        placement = self.placement
        axes, none = placement[:, :3, :3].transpose(2, 1, 0), np.zeros((3, 3, len(placement)))
        return Follow(np.concatenate([axes, none]), np.concatenate([none, axes])), placement[:, :3, 3]

    def by_joint(self, types: Sequence[MovingType], joints: Sequence[int]) -> Array:
        """Return the local twists (N, 6, k) of the frame for the positions of some joints.

        A joint's own motion commutes with a change of its position, so these are columns of the regressor: of them all
        that are along, or about, the z of a joint alone.
        """
        placement = self.placement
        axes, (z, origins) = placement[:, :3, :3].transpose(2, 1, 0), self.carriers[2:, 1:]
        arm = placement[:, :3, 3].T - origins
        along = np.array([types[j] == "prismatic" for j in self.way], dtype=np.bool_)
        shifts, turns = np.empty_like(z), np.where(along[:, None, None], 0.0, z)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(z[:, j], arm[:, k], out=shifts[:, i])
            shifts[:, i] -= z[:, k] * arm[:, j]
        shifts[along] = z[along]
        found = np.zeros((6, self.joints, z.shape[2]))
        for own, columns in ((found[:3], shifts), (found[3:], turns)):
            own[:, list(self.way)] = np.einsum("acn,wcn->awn", axes, columns)
        return found[:, list(joints)].transpose(2, 0, 1)

    @property
    def before(self) -> Array:
        """The placements (w, N, 4, 4) of the joints of the way in the root, before their own motion."""
        carriers = np.zeros((len(self.way), self.carriers.shape[3], 4, 4))
        carriers[:, :, 3, 3] = 1.0
        carriers[:, :, :3] = self.carriers[:, :-1].transpose(1, 3, 2, 0)
        return np.asarray(carriers @ self.placements[:, None])

    @property
    def matrix(self) -> Array:
        """The local twists (N, 6, 6 nj) of the frame for local twists of all joints' placements: Pinocchio's regressor.

        A placement is perturbed on the right, before the joint's own motion.
        """
        found = np.zeros((self.carriers.shape[3], 6, self.joints, 6))
        numbers = self.through(*self.local)[:, :-1].transpose(1, 3, 2, 0)
        found[:, :, list(self.way)] = (numbers @ rigid.adjoint(self.placements)[:, None]).transpose(1, 2, 0, 3)
        return found.reshape(len(found), 6, 6 * self.joints)


def followed(numbers: Array, by: Array, found: Array) -> None:
    """Write how numbers follow c unknowns (d, N, c), from what :meth:`Regressor.through` makes of them.

    ``by`` (6 (w + 1), c): how the local twists of the carriers do, component by component, turns last. ``found`` is in
    one piece, so that one product writes all of it.
    """
    each, s, d, n = numbers.shape
    assert found.flags.c_contiguous, "what is written to is not a copy"
    np.matmul(numbers.reshape(each * s, d * n).T, by[-each * s :], out=found.reshape(d * n, by.shape[1]))


def _along(rows: Array, axes: Array, found: Array) -> Array:
    """Write, and return, rows (d, 3, N), or (d, 3, 1) for all, in some axes (k, s, 3, N): (k, s, d, N)."""
    if rows.shape[2] == 1:
        return np.matmul(rows[:, :, 0], axes, out=found)
    return np.einsum("dcn,kscn->ksdn", rows, axes, out=found)


class Joints:
    """The joints of a tree, wherever they are placed. Not to be shared by threads: it holds scratch memory.

    ``types`` and ``parents`` (nj): as in :class:`Tree`.
    """

    def __init__(self, types: Sequence[MovingType], parents: Sequence[int]) -> None:
        nj = len(types)
        # Several trees side by side, each for a row of its own: half of what a call costs, it costs for any tree.
        self._rows = rows = max(1, _SIDE_BY_SIDE // nj)
        behind = tuple(parent if parent < 0 else parent + nj * k for k in range(rows) for parent in parents)
        self._model = _model(Tree(tuple(types) * rows, behind, np.tile(np.eye(4), (nj * rows, 1, 1))))
        self._data = self._model.createData()
        self._placements = _memory(self._model.jointPlacements).reshape(rows, nj, 4, 3)
        self._left = _memory(self._data.oMi).data
        self._placed_by: Array | None = None
        self._parents, self._ways = tuple(parents), dict[int, tuple[int, ...]]()

    def way(self, joint: int) -> tuple[int, ...]:
        """Return the joints from the root to one, itself included."""
        if joint not in self._ways:
            self._ways[joint] = way(self._parents, joint)
        return self._ways[joint]

    def carriers(self, placements: Array, q: Array) -> Array:
        """Return x, y, z and origins (4, nj + 1, 3, N) of the root, and of all joints after their own motion.

        ``placements`` (nj, 4, 4) of the joints are those of :class:`Tree`; at configurations q (N, nj) in rad or m.
        """
        if self._placed_by is not placements:
            self._placements[:] = placements[:, :3].transpose(0, 2, 1)
            self._placed_by = placements
        (n, nj), rows = q.shape, self._rows
        filled = np.zeros((-(-n // rows) * rows, nj))
        filled[:n] = q
        # One call leaves those of a few rows; this loop is most of the cost of large problems.
        model, data, walk = self._model, self._data, pin.forwardKinematics
        left, walked = self._left, bytearray()
        for q_n in filled.reshape(-1, rows * nj):
            walk(model, data, q_n)
            walked += left
        found = np.empty((4, nj + 1, 3, n))
        found[:, 0] = _ROOT
        found[:, 1:] = np.frombuffer(walked).reshape(-1, nj, 4, 3)[:n].transpose(2, 1, 3, 0)
        return found


class Kinematics:
    """Frames of a tree, evaluated at many configurations. Not to be shared by threads: it holds scratch memory.

    ``joints``: those of the tree, where they are made once for many placements.
    """

    def __init__(self, tree: Tree, frames: Sequence[Frame], joints: Joints | None = None) -> None:
        self._tree, self._frames = tree, tuple(frames)
        self._joints = Joints(tree.types, tree.parents) if joints is None else joints

    def regressors(self, q: Array) -> tuple[Regressor, ...]:
        """Return the regressor of every frame at N configurations q (N, nj) in rad or m."""
        carriers, joints = self._joints.carriers(self._tree.placements, q), len(self._tree.types)
        return tuple(
            Regressor(
                own,
                joints,
                # All of them are not copied.
                carriers if len(own) == joints else carriers[:, [0, *(j + 1 for j in own)]],
                self._tree.placements if len(own) == joints else self._tree.placements[list(own)],
                frame.placement,
            )
            for frame, own in ((frame, self._joints.way(frame.joint)) for frame in self._frames)
        )

    def jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return placements (N, 4, 4) of the first frame, and its local twists (N, 6, nj) for the joints' positions.

        At N configurations q (N, nj): columns of the regressor, without the others.
        """
        types, found = self._tree.types, self.regressors(q)[0]
        return found.placement, found.by_joint(types, range(len(types)))

    def placements(self, q: Array) -> tuple[Array, ...]:
        """Return the placements (N, 4, 4) of every frame at N configurations q (N, nj)."""
        return tuple(found.placement for found in self.regressors(q))


class Weighed:
    """Masses of a tree, at rest or in motion. Not to be shared by threads: it holds scratch memory."""

    def __init__(self, tree: Tree, masses: Sequence[Mass]) -> None:
        model = _model(tree)
        for body in masses:
            model.appendBodyToJoint(body.joint + 1, _inertia(body), pin.SE3.Identity())
        self._model, self._data = model, model.createData()

    def holding(self, q: Array, gravity: Array) -> Array:
        """Return what the joints hold (N, nj), in Nm and N, at configurations q (N, nj).

        In ``gravity`` (N, 3) in m/s^2: these are the slopes of the potential energy of the masses.
        """
        model, data, found = self._model, self._data, np.empty((len(q), self._model.nv))
        for n, (q_n, g) in enumerate(zip(np.ascontiguousarray(q), gravity, strict=True)):
            model.gravity.linear = g
            found[n] = pin.computeGeneralizedGravity(model, data, q_n)
        return found

    def driving(self, q: Array, rates: Array, accelerations: Array, gravity: Array) -> Array:
        """Return what the joints hold (N, nj) while they move, in Nm and N, by the recursive Newton-Euler algorithm.

        At configurations q (N, nj), ``rates`` and ``accelerations`` (N, nj) per s and s^2, in ``gravity`` (N, 3).
        """
        model, data, found = self._model, self._data, np.empty((len(q), self._model.nv))
        rows = zip(*map(np.ascontiguousarray, (q, rates, accelerations)), gravity, strict=True)
        for n, (q_n, v, a, g) in enumerate(rows):
            model.gravity.linear = g
            found[n] = pin.rnea(model, data, q_n, v, a)
        return found


def _inertia(body: Mass) -> pin.Inertia:
    """Return a mass as it is stated: many URDFs have inertias that no body has, which bear on nothing at rest.

    Pinocchio's constructor refuses these, also where a CAD program wrote -5e-20 for zero.
    """
    found = pin.Inertia.Zero()
    found.mass, found.lever, found.inertia = body.mass, body.centre, body.inertia
    return found


def _model(tree: Tree) -> pin.Model:
    model = pin.Model()
    for i, (kind, parent, T) in enumerate(zip(tree.types, tree.parents, tree.placements, strict=True)):
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        model.addJoint(parent + 1, joint, pin.SE3(T), f"joint_{i}")
    return model


def _memory(poses: Any) -> Array:
    """Return x, y, z and origins (n, 4, 3) of all poses but the root's, in Pinocchio's own memory: a std::vector.

    To read or to write them by calls of Pinocchio's, one by one, takes as long as to walk several rows.
    """
    root, first, last = poses[0], poses[1], poses[-1]
    found = np.lib.stride_tricks.as_strided(first.rotation.T, (len(poses) - 1, 4, 3), (96, 24, 8))
    for pose, own in ((root, found[0].ctypes.data - 96), (first, found[0].ctypes.data), (last, found[-1].ctypes.data)):
        at = [part.ctypes.data for part in (pose.rotation, pose.translation)]
        assert at == [own, own + 72], "a pose is twelve numbers in a row, column by column"
    return found


def way(parents: Sequence[int], joint: int) -> tuple[int, ...]:
    """Return the joints from the root to one, itself included."""
    found: list[int] = []
    while joint >= 0:
        found.append(joint)
        joint = parents[joint]
    return tuple(reversed(found))
