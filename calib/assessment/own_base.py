"""Does a table ask for a base of its own? Robot or instrument may have been moved before it was measured.

A base that is one for all, where there were two, leaves what a rigid motion of the measured points explains. Where they
are far apart, that tells it from an arm that is not as it was modelled: what a model leaves is a rigid motion locally.
So is what a machine is not sure of at rows held out, elsewhere than those that it was fitted to: as far as the stated
uncertainty explains a motion, nothing is asked for.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.chance import exceeded
from calib.foundations.linear import spread
from calib.foundations.units import MM
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.frames import initial_frames
from calib.identification.initialisation.problem import with_common_names
from calib.identification.system import Problem
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import common_errors
from calib.measurement.measurements import Measurements, reach_of

# Sound tables, also of dense paths whose model error is common to neighbours, lose up to a third of their error when
# they are moved as a whole; where a base was moved, it was several times what is left.
_SMALLER = 0.5
# By chance in one of so many tables.
_HARDLY = 1e-6
# What nobody needs to correct, in m rms.
_FINE = 1e-6
_UNKNOWN = 6
# The nominal robot misses sound tables by less than this share of its reach (:mod:`calib.identification.sanity`), and
# those of another set-up by little if they have a base of their own; from so many rows on, which base and tool do not
# use up.
_FAR, _NEAR, _ENOUGH = 0.05, 0.2, 10
# Points of a table that are so far apart, as a share of the arm's reach, tell a moved base from an arm's own errors.
_FAR_APART = 0.1


class OwnBase(NamedTuple):
    """A table that asks for a base of its own: its position error as it is, and with one, in m rms.

    ``wide``: whether its points are so far apart that it is the base, and not the arm's own errors.
    """

    file: str
    error: float
    moved: float
    wide: bool

    @property
    def sentence(self) -> str:
        """What to do about it."""
        return (
            f"{self.file} fits better with a base of its own: its rms error would be {self.moved / MM:.4g} mm in the "
            f"place of {self.error / MM:.4g} mm. If robot or instrument was moved before this table was measured, "
            'name its set-up (setup = "second").'
        )


def tables_with_own_base(
    model: ErrorModel, machine: CalibratedMachine, sets: Sequence[JudgedSet]
) -> tuple[OwnBase, ...]:
    """Return the tables that ask for a base of their own, one entry for each."""
    placed = [one for one in sets if one.data.position is not None]
    reach = reach_of(model.robot, (one.data for one in placed))
    found = [
        *own_bases(((one.file, one.data.position, one.after[:, :3], _unsure(machine, one)) for one in placed), reach),
        *far_apart(model, ((one.file, one.data, one.before[:, :3]) for one in placed)),
    ]
    return tuple({one.file: one for one in found}.values())


def far_apart(model: ErrorModel, tables: Iterable[tuple[str, Measurements, Array]]) -> Iterator[OwnBase]:
    """Yield the tables that the nominal robot explains by themselves alone, of files, rows and its residuals (N, 3).

    These are left by a base that is the same for all; where it misses a table by far, a fit of all does not tell more.
    """
    for file, data, residuals in tables:
        error = float(np.sqrt(3.0 * np.mean(residuals**2)))
        if data.position is None or len(data) < _ENOUGH or error < _FAR * data.reach(model.robot):
            continue
        free = replace(model.within([data]), base="pose", setups={}, targets={}, relations=())
        (alone,) = with_common_names(free, [data.at_readings().with_own_names()])
        problem = Problem(free, (), initial_frames(free, [alone]), (alone,))
        moved = float(np.sqrt(3.0 * np.mean(problem.residuals(np.zeros(0))[0][:, :3] ** 2)))
        if moved < _NEAR * error:
            yield OwnBase(file, error, moved, _wide(data.position, data.reach(model.robot)))


def _unsure(machine: CalibratedMachine, one: JudgedSet) -> Callable[[Array], float]:
    """Return by which variance a machine is unsure of motions (N, 3) of the points of a table, in m^2.

    The rows of a fit are where it was drawn to.
    """
    known = machine.bases.keys() >= set(one.data.setups) and machine.tools.keys() >= set(one.data.tools)

    def along(motion: Array) -> float:
        if one.use == "identification" or not known:
            return 0.0
        errors = common_errors(machine, one.data)[:, :3]
        return float(np.sum(np.tensordot(motion, errors, 2) ** 2) / np.sum(motion**2))

    return along


def own_bases(
    tables: Iterable[tuple[str, Array | None, Array, Callable[[Array], float]]], reach: float
) -> Iterator[OwnBase]:
    """Yield the tables that ask for a base of their own, of files, measured positions (N, 3) and residuals (N, 3).

    Each with a function that tells by which variance its machine is unsure of motions (N, 3) of the points.
    """
    for file, measured, residuals, unsure in tables:
        if measured is None:
            continue
        freedom = measured.size - _UNKNOWN
        if freedom <= _UNKNOWN:
            continue
        predicted = measured - residuals
        left = predicted - _moved(measured, predicted)
        before, after = float(np.sum(residuals**2)), float(np.sum(left**2))
        error, moved = np.sqrt(3.0 * before / measured.size), np.sqrt(3.0 * after / freedom)
        if not (error > _FINE and moved < _SMALLER * error):
            continue
        # F-distributed times its freedom, where nothing was moved.
        variance = after / freedom + unsure(residuals - left)
        gained = (before - after) / max(variance, np.finfo(float).tiny)
        if float(exceeded(gained, _UNKNOWN, freedom)) < _HARDLY:
            yield OwnBase(file, float(error), float(moved), _wide(measured, reach))


def _wide(x: Array, reach: float) -> bool:
    """Return whether points (N, 3) are far apart: a rigid motion of theirs is then no error of the arm."""
    return spread(x) > _FAR_APART * reach


def _moved(x: Array, y: Array) -> Array:
    """Return points x (N, 3), moved as a whole to be nearest to y (N, 3)."""
    a, b = x - x.mean(axis=0), y - y.mean(axis=0)
    return np.asarray(a @ rigid.nearest_rotation(b.T @ a).T + y.mean(axis=0))
