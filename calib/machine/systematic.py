"""What residuals show to be systematic: errors of the joints' readings that follow the reading, and a drift over rows.

A model leaves out what it has no parameters for, and what it leaves out repeats. Least squares takes residuals for
noise, which would average out. So three families of errors that no parameter stands for are laid over the fit:

* every reading is off by a smooth function of itself: waves ``cos(k t)``, ``sin(k t)`` with ``t = 2 pi u / period`` and
  standard deviations ``w / k``;
* every reading is off by wind-up under gravity, which follows several readings at once (:mod:`calib.machine.winding`);
* every measured number drifts over the rows of its set as a random walk does: its first eigenfunctions
  ``sqrt(2) sin(f t) / f`` with ``f = (j - 1/2) pi``, ``t`` from 0 to 1, of standard deviation ``d`` sigmas.

Nothing is corrected by their coefficients. Their sizes are the likeliest ones for the residuals
(:mod:`calib.identification.widths`), together with the size of the noise; and what is not solved for is carried to the
result by the sensitivity of the solution to it, as "consider parameters" are in the determination of orbits (B. D.
Tapley, B. E. Schutz, G. H. Born, *Statistical orbit determination*, 2004, chapter 6).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray, read_only
from calib.identification.arrow import Split
from calib.identification.machine import Machine
from calib.identification.rates import Block
from calib.identification.system import Problem
from calib.machine.uncertainty import Waves
from calib.machine.winding import ReadingErrors
from calib.measurement.measurements import Measurements
from calib.robot.conditions import Conditions
from calib.robot.robot import Robot, TipModel

# Eccentric encoders have orders 1 and 2, and what is left of gravity is as smooth. Higher orders look like noise.
_ORDERS = 6
# Of an encoder 20 arc seconds are usual, of a slide a tenth of a millimetre; what slides has no shorter period, in m.
_USUAL, _SHORTEST = 1e-4, 0.1
# A random walk has hardly more eigenfunctions than that; each takes so many rows. Of many sets each has fewer, as all
# are learned together: the first one alone has four fifths of a walk's variance.
_DRIFTS, _ROWS_FOR_ONE, _MOST_DRIFTS = 5, 10, 100


def usual_waves(robot: Robot, identified: Array) -> Waves:
    """Return waves of a usual width; ``identified`` (nr, 2): least and greatest readings in the data.

    The first order has a turn for its period, or twice the range that was measured of what slides.
    """
    turns = np.array([reading.dimension == "angle" for reading in robot.readings])
    period = np.where(turns, 2.0 * np.pi, np.maximum(2.0 * np.ptp(identified, axis=1), _SHORTEST))
    return Waves(read_only(period), read_only(_USUAL / np.arange(1, _ORDERS + 1) * np.ones((len(period), 1))))


class SystematicRows(NamedTuple):
    """Whitened rows (n, d, c + m + 1) of one component: ``[J B r]``, r as measured less predicted.

    ``own`` (n, d, a) and ``block`` (n,): by the parameters of the row's own target, where targets are told apart.
    """

    component: int
    rows: Array
    own: Array | None
    block: IntArray | None


class Systematic:
    """The columns B of a problem for errors of the readings, ``of_readings``, then drifts of one sigma.

    ``split``: that of J.
    """

    def __init__(
        self,
        problem: Problem,
        at: Machine,
        sigmas: Sequence[Array],
        of_readings: ReadingErrors,
        units: Array,
        split: Split,
    ) -> None:
        self._problem, self._at, self._sigmas, self._of_readings = problem, at, sigmas, of_readings
        self.rates = problem.rates(at, units, split)
        self._tips: dict[str, TipModel] = {}
        most = min(max(_MOST_DRIFTS // max(len(problem.measurements), 1), 1), _DRIFTS)
        self._drifts = [min(most, len(data) // _ROWS_FOR_ONE) for data in problem.measurements]
        self._many = [data.sigma.shape[1] * n for data, n in zip(problem.measurements, self._drifts, strict=True)]

    @property
    def columns(self) -> int:
        """How many columns B has: m."""
        return self._of_readings.many + int(sum(self._many))

    def rows(self) -> Iterator[SystematicRows]:
        """Yield the rows of every component, block by block, in the order of the sets."""
        problem = self._problem
        components = list(enumerate(problem.components))
        for i, (data, sigma) in enumerate(zip(problem.measurements, self._sigmas, strict=True)):
            own = [(c, component.columns) for c, component in components if component.measurements == i]
            for block in self.rates.blocks(data):
                B = np.concatenate([self._misread(data, block), self._drifted(i, block.rows)], axis=2)
                B[:, :, : self._of_readings.many] /= sigma[block.rows, :, None]
                whole = np.concatenate([block.J, block.observed.residual[:, :, None]], axis=2)
                whole /= sigma[block.rows, :, None]
                whole = np.concatenate([whole[:, :, :-1], B, whole[:, :, -1:]], axis=2)
                whole = problem.whitened(i, block.rows, whole)
                by_own = None
                if block.own is not None:
                    by_own = problem.whitened(i, block.rows, block.own / sigma[block.rows, :, None])
                for c, columns in own:
                    yield SystematicRows(
                        c, whole[:, columns], by_own if by_own is None else by_own[:, columns], block.block
                    )

    def _misread(self, data: Measurements, block: Block) -> Array:
        frames, rows = self._at.frames, block.rows
        found = np.zeros((len(block.J), data.sigma.shape[1], self._of_readings.many))
        for end, moved in zip(data.ends, block.moved, strict=True):
            readings, told, tools = end.readings[rows], end.conditions.subset(rows), frames.tools[end.tool[rows]]
            if end.points is not None:
                tools = tools @ rigid.translation(end.points[rows])
            by_reading = driven(self._tip(data.tip), tools, readings, told)
            for link, own in block.grounds:
                if link is not None:
                    # The observer moves as well: what is seen from it moves the other way.
                    _, seat = self._tip(link).driven(readings[own], told.subset(own))
                    by_reading[own] -= rigid.adjoint(rigid.inverse(moved.placed[own])) @ seat
            by_shift, by_turn = (rows @ moved.placed[:, :3, :3] for rows in moved.by_motion)
            by_reading = by_shift @ by_reading[:, :3] + by_turn @ by_reading[:, 3:]
            found += self._of_readings.at(readings, told, by_reading)
        return found

    def _tip(self, link: str) -> TipModel:
        """Return the model of a link's motion; "" is the robot's tip."""
        if link not in self._tips:
            robot = self._problem.model.robot
            self._tips[link] = TipModel(robot.with_tip(link or robot.tip), self._at.deviations)
        return self._tips[link]

    def _drifted(self, i: int, rows: slice) -> Array:
        N, d = self._problem.measurements[i].sigma.shape
        t = (np.arange(N)[rows] + 0.5) / N
        f = (np.arange(self._drifts[i]) + 0.5) * np.pi
        walk = np.sqrt(2.0) * np.sin(t[:, None] * f) / f
        found = np.zeros((len(t), d, sum(self._many)))
        start = sum(self._many[:i])
        for c in range(d):
            found[:, c, start + c * len(f) : start + (c + 1) * len(f)] = walk
        return found


def driven(tip: TipModel, tools: Array, readings: Array, conditions: Conditions) -> Array:
    """Return the local twists (N, 6, nr) of tools (4, 4), or (N, 4, 4), per change of the readings (N, nr)."""
    _, by_reading = tip.driven(readings, conditions)
    return np.asarray(rigid.adjoint(rigid.inverse(tools)) @ by_reading)
