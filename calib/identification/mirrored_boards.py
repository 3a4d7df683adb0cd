"""Boards and cameras, on the floor or on the tip, and set-ups that few photographs tell: they may as well be turned.

A flat board that is small in its photograph looks the same tilted to either side: turned about the line of sight by a
half turn of its normal, its marks differ by perspective alone, which may be less than their noise (D. Oberkampf et al.,
Iterative pose estimation using coplanar feature points, 1996). The other place is where two mirrors put the board: the
plane of its marks, which they do not leave, and a plane across the line of sight.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.linear import svd, triangle
from calib.identification.machine import Layout, Machine
from calib.identification.observations import observe
from calib.identification.observations.seen import Moved, Seen
from calib.identification.parameters import ParameterKind, scales
from calib.identification.rows import frame_numbers, photograph_numbers, scalars_of
from calib.identification.set_ups import SetUp
from calib.identification.system import Problem
from calib.measurement.measurements import Measurements, numbered

# Of more photographs some are from other sides.
_MOST_PHOTOGRAPHS = 20


class _Rows(NamedTuple):
    """Rows (n) of one set, with their ``sigma`` (n, 2) in px, and of which ``photograph`` (n,) of the set each is."""

    seen: Seen
    sigma: Array
    photograph: IntArray

    @property
    def on_tip(self) -> bool:
        """Whether the camera is on the tip."""
        camera = self.seen.data.camera
        assert camera is not None, "pixels were seen by a camera"
        return camera.camera_on == "tip"

    def some(self, rows: IntArray) -> "_Rows":
        """Return some of the rows."""
        seen = self.seen
        return _Rows(
            seen._replace(data=seen.data.subset(rows), tools=seen.tools[rows], targets=seen.targets[rows]),
            self.sigma[rows],
            self.photograph[rows],
        )


class Photographed:
    """Few photographs that tell a frame alone: a board or a camera, beside the arm or on it, or the base of a set-up.

    ``here``: where it is (4, 4): a target or a base in the instrument's frame, a tool on its tip. ``expected``: where a
    base was stated to be, if it was.
    """

    def __init__(self, kind: ParameterKind, here: Array, rows: Sequence[_Rows], expected: SetUp | None) -> None:
        self._kind, self.here, self._rows, self._expected = kind, here, rows, expected

    @property
    def there(self) -> Array:
        """The pose (4, 4) at which the first photograph would look nearly the same."""
        rows = self._rows[0].some(np.flatnonzero(self._rows[0].photograph == self._rows[0].photograph[0]))
        tools, targets, places = rows.seen.tools, rows.seen.targets, rows.seen.data.value[:, 2:]
        camera, boards = (tools[0], targets) if rows.on_tip else (targets[0], tools)
        marks = (boards[:, :3, :3] @ places[:, :, None])[:, :, 0] + boards[:, :3, 3]
        middle = marks.mean(axis=0)
        sight = middle - camera[:3, 3]
        along = sight / max(float(np.linalg.norm(sight)), 1e-9)
        turn = mirror(along, middle) @ mirror(svd(triangle(marks - middle))[2][-1], middle)
        turn = turn if rows.on_tip == (self._kind == "target") else rigid.inverse(turn)
        if self._kind == "tool":
            return np.asarray(self.here @ rigid.inverse(tools[0]) @ turn @ tools[0])
        return np.asarray(turn @ self.here)

    def look(self, pose: Array) -> tuple[Array, Array]:
        """Return whitened residuals (k,) with the frame elsewhere, and their derivatives (k, 6) by its twist.

        They are those of all pixels, and six of where the frame was expected.
        """
        found = [self._look(rows, pose) for rows in self._rows]
        if self._expected is not None and self._expected.length is not None and self._expected.angle is not None:
            off = rigid.inverse(self._expected.pose) @ pose
            turn, sigma = rigid.log3(off[:3, :3]), np.repeat([self._expected.length, self._expected.angle], 3)
            J = np.zeros((6, 6))
            J[:3, :3], J[3:, 3:] = off[:3, :3], rigid.left_jacobian_inverse(-turn)
            found.append((np.append(off[:3, 3], turn) / sigma, J / sigma[:, None]))
        r, J = (np.concatenate(part) for part in zip(*found, strict=True))
        return r, J

    def _look(self, rows: _Rows, pose: Array) -> tuple[Array, Array]:
        seen = rows.seen
        if self._kind == "target":
            seen = seen._replace(targets=np.broadcast_to(pose, seen.targets.shape))
        elif self._kind == "tool":
            seen = seen._replace(tools=seen.tools @ (rigid.inverse(self.here) @ pose))
        else:
            seen = seen._replace(tools=(pose @ rigid.inverse(self.here)) @ seen.tools)
        found = observe("pixels", seen)
        if self._kind == "target":
            assert found.target is not None, "what is seen is a target"
            J = found.target
        else:
            J = np.concatenate([part @ seen.tools[:, :3, :3] for part in Moved(found.tool, seen.tools).by_motion], 2)
            if self._kind == "base":
                J = J @ rigid.adjoint(rigid.inverse(seen.tools) @ pose)
        return (found.residual / rows.sigma).ravel(), (J / rows.sigma[:, :, None]).reshape(-1, 6)


def photographed(
    problem: Problem, at: Machine, sigmas: Sequence[Array], kind: ParameterKind, asked: set[int]
) -> Iterator[tuple[int, Photographed]]:
    """Yield those of the targets, tools or bases ``asked`` for that few photographs tell alone, by number.

    ``sigmas`` (N, 2) in px of the rows of every set.
    """
    sets = problem.measurements
    boards = [data.of_boards and not data.target_links for data in sets]
    asked = asked - {
        number for data, own in zip(sets, boards, strict=True) if not own for number in frames_in(data, kind)
    }
    if not asked:
        return
    photographs = {i: photograph_numbers(data) for i, data in enumerate(sets) if boards[i]}
    count = dict.fromkeys(asked, 0)
    for i, photograph in photographs.items():
        for number, rows in numbered(frame_numbers(sets[i], kind)):
            if number in count:
                count[number] += len(np.unique(photograph[rows]))
    asked = {number for number, many in count.items() if 0 < many <= _MOST_PHOTOGRAPHS}
    alone = set[int]() if kind == "target" else _of_one(problem, kind)
    found: dict[int, list[_Rows]] = {}
    for i, photograph in photographs.items() if asked else ():
        whose = frame_numbers(sets[i], kind)
        few = np.flatnonzero(np.isin(whose, list(asked)) & ~np.isin(sets[i].target, list(alone)))
        if not len(few):
            continue
        own = sets[i].subset(few)
        blocks = problem.rates(at, scales(problem.parameters), problem.split).blocks(own)
        placed = np.concatenate([block.moved[0].placed for block in blocks])
        targets = at.frames.targets[own.target]
        seen = Seen(own, slice(None), placed, targets[:0], targets, scalars_of(own, at.frames))
        every = _Rows(seen, sigmas[i][few], photograph[few])
        for number, rows in numbered(whose[few]):
            found.setdefault(number, []).append(every.some(rows))
    places = {"base": at.frames.bases, "tool": at.frames.tools, "target": at.frames.targets}[kind]
    for number, parts in found.items():
        expected = problem.model.known_base(sets[0].setups[number]) if kind == "base" else None
        yield number, Photographed(kind, places[number], parts, expected)


def _of_one(problem: Problem, kind: ParameterKind) -> set[int]:
    """Return the free targets, by number, of which one set-up, or tool, alone tells: they move with it."""
    layout = Layout.of(problem.model.robot, problem.reference)
    whose: dict[int, set[int]] = {layout.frame_of(p)[0]: set() for p in problem.parameters if p.kind == "target"}
    for data in problem.measurements:
        for number, rows in numbered(data.target):
            if number in whose:
                whose[number] |= set(np.unique(frame_numbers(data, kind)[rows]).tolist())
    return {number for number, own in whose.items() if len(own) == 1}


def frames_in(data: Measurements, kind: ParameterKind) -> set[int]:
    """Return which bases, tools or targets rows are of, by number, those of other ends as well."""
    own = [end.tool for end in data.ends] if kind == "tool" else [frame_numbers(data, kind)]
    return {int(k) for numbers in own for k in np.unique(numbers)}


def mirror(normal: Array, point: Array) -> Array:
    """Return the mirror (4, 4) at a plane by its unit normal (3,) and a point of it."""
    return rigid.placement(np.eye(3) - 2.0 * np.outer(normal, normal), 2.0 * (normal @ point) * normal)
