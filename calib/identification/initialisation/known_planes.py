"""Where a base is by known planes that were touched from it, and by indicators of known directions.

The tool point x of a row, in the base, is at the height ``n (R x + t)`` along the normal n of its plane, with base
R, t. So along ``a = R^T n`` it goes with the values of the rows: a is a slope of theirs or, where they are all alike,
the normal of the plane through the points. Directions of planes, in the base and known, give R, and heights then t.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.linear import svd
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.carried import Carried
from calib.identification.initialisation.target_poses import NEGLIGIBLE, arm_beside, plane_through

# A plane is told by three points, an indicator with an unknown zero by four.
_FEWEST = 4
# Points that spread by less than that across, in m, tell no direction.
_NARROW = 1e-3
# What the base as given weighs, in m beside the spread of points: it stays where nothing else tells.
_GIVEN = 1e-6
# Unit normals that span less than that in a direction tell nothing along it.
_APART = 0.1
# Sides of so many planes are tried, and the arm's parts beside a plane are not believed where others miss by a half.
_TURNED, _CLEARLY = 6, 0.25


class SeenPlane(NamedTuple):
    """A target as it is seen from the base: its ``direction`` (3,) there, and by how widely spread points, in m.

    ``normal`` (3,) is the known one. ``points`` (n, 3) are at ``heights`` (n,) along it, which lack a constant where
    the target's own is not known. ``side``: whether the direction might be the opposite one.
    """

    direction: Array
    spread: float
    normal: Array
    points: Array
    heights: Array
    height_is_known: bool
    side: bool


def planes_seen(model: ErrorModel, carried: Sequence[Carried], tools: Array) -> list[SeenPlane]:
    """Return the known planes and indicators of all rows as a base sees them, touched from it with ``tools``.

    ``carried``: rows of one set-up.
    """
    return [
        target
        for one in carried
        if one.data.kind in ("plane", "indicator")
        for t in np.unique(one.data.target)
        if one.data.link_of(int(t)) is None and one.data.targets[t] in model.targets
        for target in _seen(model, one.some(one.data.target == t), tools)
    ]


def base_by_planes(seen: Sequence[SeenPlane], base: Array) -> Array:
    """Return the ``base`` (4, 4) with what known planes and indicators tell of it.

    The side from which a plane was touched is the one on which the arm is, unless these planes fit clearly better from
    other sides.
    """
    if not seen:
        return base
    sides = [k for k in np.argsort([-target.spread for target in seen], kind="stable") if seen[k].side][:_TURNED]
    best, least = base, np.inf
    for turned in sorted(itertools.product((1.0, -1.0), repeat=len(sides)), key=lambda signs: -sum(signs)):
        signs = np.ones(len(seen))
        signs[sides] = turned
        found = _base(seen, signs, base)
        if (missed := _missed(seen, found)) < _CLEARLY * least:
            best, least = found, missed
    return best


def planes_show_all(seen: Sequence[SeenPlane], *, placed: bool) -> bool:
    """Return whether known planes and indicators show all of a base; ``placed``: where a known place is as well."""
    turned = np.array([target.normal for target in seen]).reshape(-1, 3)
    lifted = np.array([target.normal for target in seen if target.height_is_known]).reshape(-1, 3)
    return _rank(turned) > 1 and (placed or _rank(lifted) > 2)


def _rank(normals: Array) -> int:
    """Return how many directions normals (n, 3) have that are not nearly those of others."""
    return int(np.sum(svd(normals, full_matrices=False)[1] > _APART)) if len(normals) else 0


def _seen(model: ErrorModel, rows: Carried, tools: Array) -> list[SeenPlane]:
    """Return the one target of the rows as the base sees it, or nothing where they do not tell its direction."""
    data = rows.data
    x, value = (rows.tips @ data.placed_by(tools))[:, :3, 3], data.value[:, 0]
    if len(x) < _FEWEST:
        return []
    t = int(data.target[0])
    middle, sizes = x.mean(axis=0), svd(x - x.mean(axis=0), full_matrices=False)[1] / np.sqrt(len(x))
    known = model.targets[data.targets[t]]
    normal = known.pose[:3, 2]
    if data.kind == "plane":
        spread = float(sizes[1])
        direction = plane_through(x, arm_beside(model, data, rows.tips, x, [t]).mean(axis=0))[:3, 2]
    else:
        spread = float(sizes[2])
        slope = np.linalg.lstsq(x - middle, value - value.mean(), rcond=NEGLIGIBLE)[0]
        direction = slope / max(float(np.linalg.norm(slope)), NEGLIGIBLE)
    if spread < _NARROW:
        return []
    heights = value + known.pose[:3, 3] @ normal
    return [SeenPlane(direction, spread, normal, x, heights, known.height_is_known, data.kind == "plane")]


def _base(seen: Sequence[SeenPlane], signs: Array, base: Array) -> Array:
    """Return the base (4, 4) that turns directions, times ``signs`` (k,), to known normals, and points into planes."""
    normals, directions = (np.stack([target[which] for target in seen]) for which in (2, 0))
    weight = signs * [target.spread for target in seen]
    R = rigid.nearest_rotation((weight[:, None] * normals).T @ directions + _GIVEN * base[:3, :3])
    at = rigid.placement(R, base[:3, 3])
    told = [k for k, target in enumerate(seen) if target.height_is_known]
    missed = np.array([_off(seen[k], at).mean() for k in told])
    return rigid.placement(R, base[:3, 3] - np.linalg.lstsq(normals[told], missed, rcond=_GIVEN)[0])


def _off(target: SeenPlane, base: Array) -> Array:
    """Return how much higher than they should the points (n,) of a target are."""
    return np.asarray((target.points @ base[:3, :3].T + base[:3, 3]) @ target.normal - target.heights)


def _missed(seen: Sequence[SeenPlane], base: Array) -> float:
    """Return the sum of squares by which points miss their planes."""
    off = [(_off(target, base), target.height_is_known) for target in seen]
    return sum(float(np.sum(np.square(one if known else one - one.mean()))) for one, known in off)
