"""What is known between targets: how far two points are apart, which angle two planes enclose, how far apart they are.

A gauge's length gives a calibration by sockets its scale; a datum cube's faces are planes at known angles.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond
from calib.foundations.words import refuse_other

RelationKind = Literal["distance", "angle", "offset"]
_TINY = 1e-12
# Planes at less of an angle, in rad, are parallel.
_PARALLEL = 1e-6


@dataclass(frozen=True, slots=True)
class Relation:
    """One number known of two targets, with its standard deviation, in m or rad.

    ``distance``: between two points. ``angle``: between the normals of two planes, from 0 to pi; a normal points to the
    side from which its plane was touched. ``offset``: how much higher the second plane is than the first, along the
    first one's normal and measured at the second one's middle.

    Raises JobError when a number cannot be used.
    """

    kind: RelationKind
    targets: tuple[str, str]
    value: float
    sigma: float

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.kind, get_args(RelationKind), "relation")
        if self.targets[0] == self.targets[1]:
            raise JobError(f"relation of {self.targets}: is one target; a relation is between two.")
        of_sigma = "relations.sigma of an angle" if self.kind == "angle" else "relations.sigma"
        refuse_beyond(self.sigma, of_sigma, f"relation of {self.targets}: sigma")
        refuse_beyond(self.value, f"relations.{self.kind}", f"relation of {self.targets}: the {self.kind}")


class _OfTwo(Protocol):
    @property
    def targets(self) -> tuple[str, str]: ...

    @property
    def kind(self) -> RelationKind: ...


def related_targets(relations: Iterable[_OfTwo]) -> set[str]:
    """Return the names of the targets between which something is known."""
    return {name for relation in relations for name in relation.targets}


def refuse_unrelated(relations: Iterable[_OfTwo], found: Mapping[str, str]) -> None:
    """Raise JobError for a relation of what is not ``found`` in measurements, or has another shape there."""
    for relation in relations:
        shape = "point" if relation.kind == "distance" else "plane"
        for name in relation.targets:
            if found.get(name) != shape:
                raise JobError(
                    f"relations: a known {relation.kind} is between two {shape}s, and {name!r} is "
                    f"{'a ' + found[name] if name in found else 'in no measurement'}."
                )


def relate(relations: Sequence[Relation], names: Sequence[str], targets: Array) -> tuple[Array, Array]:
    """Return derivatives (k, m, 6) of the relations by the local twist of each target, and residuals (k,), whitened.

    ``targets`` (m, 4, 4): the frames of the named targets. An angle of 0 or pi gives two rows, others one.
    """
    rows: list[tuple[Array, float]] = []
    for relation in relations:
        a, b = (names.index(name) for name in relation.targets)
        for by_a, by_b, residual in _rows(relation, targets[a], targets[b]):
            J = np.zeros((len(targets), 6))
            J[a], J[b] = by_a / relation.sigma, by_b / relation.sigma
            rows.append((J, residual / relation.sigma))
    return np.array([J for J, _ in rows]).reshape(len(rows), len(targets), 6), np.array([r for _, r in rows])


def _rows(relation: Relation, A: Array, B: Array) -> Iterator[tuple[Array, Array, float]]:
    """Yield the derivatives (6,) by the twists of both targets' frames, and the residual."""
    none = np.zeros(3)
    if relation.kind == "distance":
        apart = B[:3, 3] - A[:3, 3]
        distance = float(np.linalg.norm(apart))
        along = apart / max(distance, _TINY)
        yield (
            np.concatenate([A[:3, :3].T @ along, none]),
            np.concatenate([-B[:3, :3].T @ along, none]),
            relation.value - distance,
        )
    elif relation.kind == "offset":
        x, y, z = (rigid.inverse(A)[:3] @ B[:, 3]).tolist()
        yield (
            np.array([0.0, 0.0, 1.0, y, -x, 0.0]),
            np.concatenate([-B[:3, :3].T @ A[:3, 2], none]),
            relation.value - z,
        )
    elif np.pi - _PARALLEL > relation.value > _PARALLEL:
        axis = np.cross(A[:3, 2], B[:3, 2])
        sine = float(np.linalg.norm(axis))
        about = axis / max(sine, _TINY)
        yield (
            np.concatenate([none, A[:3, :3].T @ about]),
            np.concatenate([none, -B[:3, :3].T @ about]),
            relation.value - float(np.arctan2(sine, A[:3, 2] @ B[:3, 2])),
        )
    else:
        # Parallel planes: an angle has no derivative there, the two components of the normal have.
        for k in (0, 1):
            turn = np.cross(B[:3, 2], A[:3, k])
            yield (
                np.concatenate([none, A[:3, :3].T @ turn]),
                np.concatenate([none, -B[:3, :3].T @ turn]),
                -float(A[:3, k] @ B[:3, 2]),
            )
