"""Which convention makes an orientation turn with the arm."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, evenly_spread
from calib.foundations.errors import JobError
from calib.foundations.units import DEG, UNITS
from calib.identification.followed import FEWEST_ROWS, followed, turned_along
from calib.job.foreign.answers import AskedError, Trial, ask, of_dimension, off_arm, values_of
from calib.job.foreign.fits import FOLLOWS, TIMES, options
from calib.job.foreign.seen import SCALAR, Seen
from calib.measurement.orientations import EULER, MAKERS, rotations_of
from calib.measurement.raw import RawColumn
from calib.measurement.roles import Orientation
from calib.measurement.table import QUATERNION_COLUMNS

_FOLLOWS_ANGLE, _ALIKE_ANGLE = 0.2, 0.015
_SAME_ANGLE = 1e-6
# Poses that are tried the other way round, each in all conventions, and the rows that tell.
_MOST_INVERTED, _MOST_ROWS = 36, 40


class _Way(NamedTuple):
    """One reading of an orientation, and the rms angle in rad by which it does not turn with the arm."""

    angle: float
    convention: str | None
    columns: tuple[int, ...]
    unit: str
    rotation: Array
    of: Orientation

    def is_like(self, other: "_Way") -> bool:
        """Whether both give the same rotations in all rows."""
        between = np.swapaxes(self.rotation, 1, 2) @ other.rotation
        return bool(np.linalg.norm(rigid.log3(between), axis=-1).max() <= _SAME_ANGLE)


def orientation_of(seen: Seen, best: Trial) -> tuple[str | None, tuple[int, ...], str] | None:
    """Return convention, columns and unit of the orientation that turns with the arm; None where none does."""
    ways = []
    torn = False
    for one in best.pick.turned:
        own = [seen.raw.columns[k] for k in one.columns]
        numbers = np.column_stack([values_of(column) for column in own])[best.rows]
        if not np.isfinite(numbers).all():
            torn = True
            continue
        for convention, order, unit, rotation in _rotations(seen, one, own, numbers):
            angle = turned_along(best.tips, best.fit.base, rotation)
            ways.append(_Way(angle, convention, tuple(one.columns[k] for k in order), unit, rotation, one))
    if (scalar := seen.named.get(SCALAR)) is not None:
        ways = [way for way in ways if way.convention is None and way.columns[0] == seen.column(scalar)]
        if not ways:
            raise JobError(
                f"columns: {SCALAR} is to be {scalar!r}, which is no scalar of a quaternion in {seen.raw.where}."
            )
    if not ways or not np.isfinite(best.fit.share):
        return _only_written(seen, best, torn)
    ways.sort(key=lambda way: way.angle)
    way = ways[0]
    if way.angle > _FOLLOWS_ANGLE:
        seen.reasons.append(
            f"{seen.titles(way.of.columns)} are no orientation that turns with the arm (at best "
            f"{way.angle / DEG:.3g} deg are left): they are left out"
        )
        return None
    alike = [other for other in ways if other.angle < max(TIMES * way.angle, _ALIKE_ANGLE)]
    # Of which the columns' names say the convention.
    named = [other for other in alike if other.convention == other.of.convention]
    if all(other.is_like(way) for other in alike):
        # One rotation by several names: the one that the columns have, or the shortest.
        way = (named or alike)[0]
    elif any(other.convention is not None for other in named):
        way = next(other for other in named if other.convention is not None)
    else:
        raise _asked(seen, alike)
    seen.reasons.append(
        f"{seen.titles(way.columns)} are the orientation, {_called(way.convention)}"
        + ("" if way.convention in (None, "matrix") else f" in {way.unit}")
        + f": it turns with the arm within {way.angle / DEG:.2g} deg"
    )
    return way.convention, way.columns, way.unit


def inverse_question(seen: Seen, trials: Sequence[Trial]) -> AskedError | None:
    """Return a question where the arm follows the inverse of poses: of a board, say, as a camera on the arm sees it."""
    pairs = [(trial, one) for trial in trials for one in trial.pick.turned][:_MOST_INVERTED]
    found = [(*_inverse_fit(seen, trial, one), trial, one) for trial, one in pairs]
    if not found:
        return None
    share, miss, trial, turned = min(found, key=lambda one: one[0])
    if share >= FOLLOWS:
        return None
    return ask(
        "position",
        f"{seen.raw.where}: the poses {seen.titles(trial.point.columns)} with {seen.titles(turned.columns)} are "
        "inverse (of the instrument in the tool, as of a board that a camera on the arm sees): where each is turned "
        f"round, the points are {off_arm(miss, share)}",
        (),
        "a table in which R' and -R' t stand for each rotation R and position t",
    )


def _inverse_fit(seen: Seen, trial: Trial, one: Orientation) -> tuple[float, float]:
    """Return the share and the miss in m with which the arm follows inverse poses; infinite where none turn with it.

    By what angle rows turn against each other tells most conventions apart, whatever base and tool are.
    """
    own = [seen.raw.columns[k] for k in one.columns]
    few = evenly_spread(len(trial.rows), _MOST_ROWS)
    numbers = np.column_stack([values_of(column) for column in own])[trial.rows[few]]
    if len(few) < FEWEST_ROWS or not np.isfinite(numbers).all():
        return np.inf, np.inf
    tips, position = trial.tips[few], trial.position[few]
    by_arm = _between_rows(tips[:, :3, :3])
    fits = [
        followed(tips, -np.einsum("nji,nj->ni", R, position))
        for _, _, _, R in _rotations(seen, one, own, numbers)
        if np.sqrt(np.mean((_between_rows(R) - by_arm) ** 2)) < _FOLLOWS_ANGLE
    ]
    return min(((fit.share, fit.miss) for fit in fits), default=(np.inf, np.inf))


def _between_rows(R: Array) -> Array:
    """Return the angles (N - 1,) in rad between rotations (N, 3, 3) of neighbouring rows."""
    return np.asarray(np.linalg.norm(rigid.log3(np.swapaxes(R[:-1], 1, 2) @ R[1:]), axis=-1))


def _asked(seen: Seen, alike: Sequence[_Way]) -> AskedError:
    about = f"{seen.raw.where}: {seen.titles(alike[0].of.columns)} fit equally well"
    names = tuple(dict.fromkeys(way.convention for way in alike if way.convention is not None))
    if all(way.convention is not None for way in alike):
        return ask("orientation", f"{about} as {', '.join(names[:8])}", names)
    scalars = [seen.raw.columns[way.columns[0]].title for way in alike if way.convention is None]
    choices = [f"'{SCALAR}={title}'" for title in scalars]
    return ask("orientation", f"{about} as a quaternion with the scalar {' and '.join(scalars)}", choices, "--column")


def _only_written(seen: Seen, best: Trial, torn: bool) -> tuple[str | None, tuple[int, ...], str] | None:
    """Return an orientation whose columns have our names, where nothing can be tried; else it is left out.

    ``torn``: rows with a point lack some of its numbers.
    """
    for one in best.pick.turned:
        names = tuple(seen.raw.columns[k].name for k in one.columns)
        if names == QUATERNION_COLUMNS:
            return None, one.columns, ""
    if best.pick.turned:
        why = "cells of theirs are empty" if torn else "too few rows tell what orientation they are"
        seen.reasons.append(f"{seen.titles(best.pick.turned[0].columns)} are left out: {why}")
    return None


def _rotations(
    seen: Seen, one: Orientation, columns: Sequence[RawColumn], numbers: Array
) -> Iterable[tuple[str | None, Sequence[int], str, Array]]:
    given = seen.answers.orientation
    if one.form == "quaternion":
        size = np.linalg.norm(np.clip(numbers, -2.0, 2.0), axis=1)
        if given is not None or np.abs(size - 1.0).max() > 1e-2:
            return
        # Columns that are called x, y, z, w say their order; numbered ones have w first, or last.
        letters = {column.name.lower()[-1:] for column in columns}
        orders = [(0, 1, 2, 3)] if "w" in letters else [(0, 1, 2, 3), (3, 0, 1, 2)]
        for order in orders:
            yield None, order, "", rigid.rotation_of_quaternion(numbers[:, order])
    elif one.form == "matrix":
        if rigid.are_orthogonal(numbers.reshape(-1, 3, 3), 1e-2).all():
            yield "matrix", range(9), "", rotations_of(numbers, "matrix")
    elif of_dimension(columns, "angle"):
        names = [given] if given is not None else ["rotation_vector", *EULER]
        if one.convention in MAKERS and given is None:
            names = [one.convention, *(name for name in names if name != MAKERS[one.convention])]
        for unit in options(columns, seen.answers.angles, ("rad", "deg")):
            factors = [UNITS[column.symbol or unit].factor for column in columns]
            if np.abs(numbers * factors).max() > 1e3:
                continue
            for name in names:
                yield name, range(3), unit, rotations_of(numbers * factors, name)


def _called(orientation: str | None) -> str:
    if orientation is None:
        return "a quaternion"
    if orientation in ("matrix", "rotation_vector"):
        return f"a {orientation.replace('_', ' ')}"
    order = MAKERS.get(orientation, orientation)
    about = "the turned axes (intrinsic)" if order.isupper() else "fixed axes (extrinsic)"
    return f"{orientation}, turns about {', '.join(order.lower())}, {about},"
