"""Which convention makes an orientation turn with the arm."""

from collections.abc import Iterable, Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.units import DEG, UNITS
from calib.identification.followed import turned_along
from calib.job.foreign.answers import Trial, ask, of_dimension, values_of
from calib.job.foreign.fits import TIMES, Fits
from calib.measurement.orientations import EULER, MAKERS, rotations_of
from calib.measurement.raw import RawColumn
from calib.measurement.roles import (
    Orientation,
)
from calib.measurement.table import QUATERNION_COLUMNS

_FOLLOWS_ANGLE, _ALIKE_ANGLE = 0.2, 0.015
_SAME_ANGLE = 1e-6


class Turns(Fits):
    """Decides on the orientation that belongs to a point, or leaves it out."""

    def _orientation(self, best: Trial) -> tuple[str | None, tuple[int, ...], str] | None:
        """Return convention, columns and unit of the orientation that turns with the arm; None where none does."""
        ways = []
        for one in best.pick.turned:
            own = [self.raw.columns[k] for k in one.columns]
            numbers = np.column_stack([values_of(column) for column in own])[best.rows]
            if not np.isfinite(numbers).all():
                continue
            for orientation, order, unit, rotation in self._rotations(one, own, numbers):
                angle = turned_along(best.tips, best.fit.base, rotation)
                ways.append((angle, orientation, tuple(one.columns[k] for k in order), unit, rotation, one))
        if not ways or not np.isfinite(best.fit.share):
            return self._only_written(best)
        ways.sort(key=lambda way: way[0])
        angle, orientation, columns, unit, rotation, one = ways[0]
        if angle > _FOLLOWS_ANGLE:
            self.reasons.append(
                f"{self._titles(one.columns)} are no orientation that turns with the arm (at best "
                f"{angle / DEG:.3g} deg are left): they are left out"
            )
            return None
        alike = [way for way in ways if way[0] < max(TIMES * angle, _ALIKE_ANGLE)]
        others = [
            way
            for way in alike
            if np.linalg.norm(rigid.log3(np.swapaxes(way[4], 1, 2) @ rotation), axis=-1).max() > _SAME_ANGLE
        ]
        by_name = [way for way in alike if way[1] is not None and way[1] == way[5].convention]
        if others and by_name:
            angle, orientation, columns, unit, rotation, one = by_name[0]
        elif others:
            choices = tuple(dict.fromkeys(way[1] or "quaternion" for way in alike))
            if self.answers.observes is None:
                raise ask(
                    "orientation",
                    f"{self.raw.where}: {self._titles(one.columns)} fit as {', '.join(choices[:8])} alike",
                    choices,
                )
        else:
            # One rotation by several names: the one that the columns have, or the shortest.
            same = [way for way in alike if way[1] == way[5].convention] or alike[:1]
            angle, orientation, columns, unit, rotation, one = same[0]
        self.reasons.append(
            f"{self._titles(columns)} are the orientation, {_called(orientation)}"
            + ("" if orientation in (None, "matrix") else f" in {unit}")
            + f": it turns with the arm within {angle / DEG:.2g} deg"
        )
        return orientation, columns, unit

    def _only_written(self, best: Trial) -> tuple[str | None, tuple[int, ...], str] | None:
        """Return an orientation whose columns have our names, where nothing can be tried; else it is left out."""
        for one in best.pick.turned:
            names = tuple(self.raw.columns[k].name for k in one.columns)
            if names == QUATERNION_COLUMNS:
                return None, one.columns, ""
        if best.pick.turned:
            self.reasons.append(
                f"{self._titles(best.pick.turned[0].columns)} are left out: too few rows tell what orientation they are"
            )
        return None

    def _rotations(
        self, one: Orientation, columns: Sequence[RawColumn], numbers: Array
    ) -> Iterable[tuple[str | None, Sequence[int], str, Array]]:
        given = self.answers.orientation
        if one.form == "quaternion":
            size = np.linalg.norm(numbers, axis=1)
            if given is not None or np.abs(size - 1.0).max() > 1e-2:
                return
            # Columns that are called x, y, z, w say their order; numbered ones have w first, or last.
            letters = {column.name.lower()[-1:] for column in columns}
            orders = [(0, 1, 2, 3)] if "w" in letters else [(0, 1, 2, 3), (3, 0, 1, 2)]
            for order in orders:
                yield None, order, "", rigid.rotation_of_quaternion(numbers[:, order])
        elif one.form == "matrix":
            matrices = numbers.reshape(-1, 3, 3)
            if np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max() < 1e-2:
                yield "matrix", range(9), "", rotations_of(numbers, "matrix")
        elif of_dimension(columns, "angle"):
            names = [given] if given is not None else ["rotation_vector", *EULER]
            if one.convention in MAKERS and given is None:
                names = [one.convention, *(name for name in names if name != MAKERS[one.convention])]
            for unit in self._options(columns, self.answers.angles, ("rad", "deg")):
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
    about = "axes that turn along" if order.isupper() else "axes that stay"
    return f"{orientation}, turns about {', '.join(order.lower())}, {about},"
