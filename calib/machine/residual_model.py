"""What a machine adds to the positions of its kinematics, where its errors were measured: a grid, or a process."""

from typing import Protocol, runtime_checkable

import numpy as np

from calib.foundations.arrays import Array
from calib.machine.grid import Frame, Leaning


@runtime_checkable
class ResidualModel(Protocol):
    """Errors of positions over joint space that no model of the arm explains."""

    @property
    def frame(self) -> Frame:
        """Whose axes the vectors have: those of the base or of the tip link."""

    @property
    def setups(self) -> tuple[str, ...]:
        """Of a machine with several, the names of the set-ups in which the errors were measured."""

    @property
    def tools(self) -> tuple[str, ...]:
        """Of a machine with several, the names of the tools with which the errors were measured."""

    @property
    def rows(self) -> int:
        """How many measured rows are gone through for every vector."""

    def at(self, readings: Array, *, clamp: bool = False) -> Array:
        """Return vectors (N, 3) in m to add to predicted positions at readings (N, nr), finite where it clamps."""

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return vectors (N, 3) in the instrument's axes, finite; ``base`` (4, 4) is there, ``tips`` in the base."""

    def outside(self, readings: Array) -> tuple[str, ...]:
        """Return for every row why the model does not know it, or an empty text."""

    def leaning(self, readings: Array) -> Leaning:
        """Return what it takes its values from at readings (N, nr)."""

    def own_errors(self, readings: Array, noise: float) -> Array:
        """Return a factor (N, r) of the covariance that a component of its own errors has at readings (N, nr), in m.

        What it gets wrong is common to neighbours. ``noise``: standard deviation of what it was made of, in m.
        """

    def scatter(self, noise: float) -> float:
        """Return the standard deviation in m of what a component errs by from pose to pose, whatever neighbours do.

        It is in what the model was made of, beside ``noise``, in m: errors that follow other joints than the model's.
        """

    @property
    def when_clamped(self) -> str:
        """What is added in such rows where it clamps."""


def shifted(known: ResidualModel | None, tips: Array, readings: Array) -> Array:
    """Return the tips (N, 4, 4) in the base link, from those without them, with what a residual model adds."""
    if known is None:
        return tips
    found = np.array(tips)
    found[:, :3, 3] += known.shifts(np.eye(4), tips, readings)
    return found
