"""Boards and cameras on the floor, and set-ups, that few photographs tell: they may as well be turned the other way.

A flat board that is small in its photograph looks the same tilted to either side: turned about the line of sight by a
half turn of its normal, its marks differ by perspective alone, which may be less than their noise (D. Oberkampf et al.,
Iterative pose estimation using coplanar feature points, 1996). The other place is where two mirrors put the board: the
plane of its marks, which they do not leave, and a plane across the line of sight.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.linear import svd, triangle
from calib.identification.machine import Machine
from calib.identification.observations import observe
from calib.identification.observations.seen import Seen
from calib.identification.parameters import ParameterKind, scales
from calib.identification.rows import photograph_numbers, scalars_of
from calib.identification.system import Problem
from calib.measurement.measurements import Measurements, numbered

# Of more photographs some are from other sides.
_MOST_PHOTOGRAPHS = 20


class Photographed:
    """Rows (n) of one target in few photographs: a board, or a camera beside the arm, in a place that they tell alone.

    ``seen``: its rows at the machine, of which the target's pose is moved; ``sigma`` (n, 2) in px. Where it is the base
    that they tell, the arm moves instead, which looks the same.
    """

    def __init__(self, seen: Seen, sigma: Array) -> None:
        self._seen, self._sigma = seen, sigma

    @property
    def here(self) -> Array:
        """The pose (4, 4) of the target."""
        return np.asarray(self._seen.targets[0])

    @property
    def there(self) -> Array:
        """The pose (4, 4) at which it would look nearly the same."""
        data, other = self._seen.data, self._seen.tools[0]
        assert data.camera is not None, "pixels were seen by a camera"
        on_tip = data.camera.camera_on == "tip"
        seen = rigid.inverse(other) @ self.here if on_tip else rigid.inverse(self.here) @ other
        marks = data.value[:, 2:]
        middle = marks.mean(axis=0)
        sight = seen[:3, :3] @ middle + seen[:3, 3]
        along = sight / max(float(np.linalg.norm(sight)), 1e-9)
        turned = _mirror(along, sight) @ seen @ _mirror(svd(triangle(marks - middle))[2][-1], middle)
        return np.asarray(other @ turned if on_tip else other @ rigid.inverse(turned))

    def look(self, pose: Array) -> tuple[Array, Array]:
        """Return whitened residuals (2 n,) with the target elsewhere, and their derivatives (2 n, 6) by its twist."""
        found = observe("pixels", self._seen._replace(targets=np.broadcast_to(pose, self._seen.targets.shape)))
        assert found.target is not None, "what is seen is a target"
        return (found.residual / self._sigma).ravel(), (found.target / self._sigma[:, :, None]).reshape(-1, 6)


def photographed(
    problem: Problem, at: Machine, sigmas: Sequence[Array], kind: ParameterKind, asked: set[int]
) -> Iterator[tuple[int, Photographed]]:
    """Yield those of the targets, or bases, ``asked`` for that few photographs of one target tell alone, by number.

    ``sigmas`` (N, 2) in px of the rows of every set.
    """
    sets = problem.measurements
    for data, sigma in zip(sets, sigmas, strict=True):
        if not data.of_boards or data.target_links:
            continue
        others = {number for other in sets if other is not data for number in np.unique(_whose(other, kind)).tolist()}
        photograph = photograph_numbers(data)
        for number, rows in numbered(_whose(data, kind)):
            many = len(np.unique(photograph[rows])) > _MOST_PHOTOGRAPHS or np.ptp(data.target[rows]) > 0
            if number not in asked - others or many:
                continue
            own = data.subset(rows)
            blocks = problem.rates(at, scales(problem.parameters), problem.split).blocks(own)
            placed = np.concatenate([block.moved[0].placed for block in blocks])
            targets = at.frames.targets[own.target]
            seen = Seen(own, slice(None), placed, targets[:0], targets, scalars_of(own, at.frames))
            yield number, Photographed(seen, sigma[rows])


def _whose(data: Measurements, kind: ParameterKind) -> IntArray:
    return data.setup if kind == "base" else data.target


def _mirror(normal: Array, point: Array) -> Array:
    """Return the mirror (4, 4) at a plane by its unit normal (3,) and a point of it."""
    return rigid.placement(np.eye(3) - 2.0 * np.outer(normal, normal), 2.0 * (normal @ point) * normal)
