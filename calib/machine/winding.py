"""Errors of the readings that no parameter stands for, and what they do: waves, and wind-up under gravity."""

from itertools import groupby, islice

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.machine.uncertainty import Waves, WindUp
from calib.robot.conditions import Conditions
from calib.robot.gravity import Holding
from calib.robot.joint_terms import moments, with_joint_terms
from calib.robot.robot import Robot

# A kilogram at a metre winds a drive up by 0.03 mrad, and there are some ten of these: about as much as waves.
_USUAL = 3e-6
# What slides is pressed in by so many metres for a radian of what turns, as usual coefficients of such terms are.
_SLIDES = 1e-2
# What all of them take grows with the cube of how many there are, and they are half the square of the joints.
_MOST = 120


def usual_wind_up(robot: Robot) -> WindUp:
    """Return wind-up of a usual size; ``robot`` is in the frames of its URDF.

    What gravity makes a joint hold is linear in the first moments of mass of all links beyond it, so that these say it
    whatever the masses are, and whichever joints it depends on. Of long chains of joints only the nearest links count.
    """
    terms = moments(robot)
    if len(terms) > _MOST:
        each = max(_MOST // len(robot.readings), 1)
        terms = tuple(term for _, own in groupby(terms, lambda term: term.reading) for term in islice(own, each))
    slides = {reading.name for reading in robot.readings if reading.dimension == "length"}
    return WindUp(terms, read_only([_USUAL * (_SLIDES if term.reading in slides else 1.0) for term in terms]))


class ReadingErrors:
    """Evaluates waves and wind-up. Not to be shared by threads: it holds scratch memory."""

    def __init__(self, robot: Robot, waves: Waves, wind_up: WindUp) -> None:
        self._waves, self._width, self._holding = waves, wind_up.width, None
        names = [reading.name for reading in robot.readings]
        self._reading = np.array([names.index(term.reading) for term in wind_up.terms], dtype=np.intp)
        weights = with_joint_terms(robot, wind_up.terms).weights
        if weights is not None:
            self._holding = Holding(weights)
            units = self._holding.units
            self._unit = np.array([units[term.body] for term in wind_up.terms], dtype=np.intp)

    @property
    def many(self) -> int:
        """How many there are."""
        return self._waves.many + len(self._width)

    def at(self, readings: Array, conditions: Conditions, by_reading: Array) -> Array:
        """Return what each of its width does (N, d, many), from derivatives (N, d, nr) by the readings (N, nr)."""
        waves = self._waves.at(readings, by_reading)
        if self._holding is None:
            return waves
        held = self._holding.of_units(readings, conditions)[self._unit, :, self._reading].T
        return np.concatenate([waves, -by_reading[:, :, self._reading] * (held * self._width)[:, None]], axis=2)
