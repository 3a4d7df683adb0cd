"""A residual model that looks once at every row, for whoever asks of the same rows again and again."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from calib.foundations.arrays import Array
from calib.machine.residual_model import Frame, Leaning, ResidualModel, axes_of

T = TypeVar("T")


class Remembered:
    """A residual model as another, whose answers at readings that were asked of before are not made again.

    A Gaussian process goes through all rows it was made of for each answer. To be let go with the rows.
    """

    def __init__(self, model: ResidualModel) -> None:
        self._model = model
        self._known: dict[tuple[object, ...], Any] = {}

    def _once(self, make: Callable[[], T], *key: object) -> T:
        if key not in self._known:
            self._known[key] = make()
        found: T = self._known[key]
        return found

    @property
    def frame(self) -> Frame:
        """As the model has it."""
        return self._model.frame

    @property
    def setups(self) -> tuple[str, ...]:
        """As the model has them."""
        return self._model.setups

    @property
    def tools(self) -> tuple[str, ...]:
        """As the model has them."""
        return self._model.tools

    @property
    def rows(self) -> int:
        """As the model has it."""
        return self._model.rows

    def at(self, readings: Array, *, clamp: bool = False) -> Array:
        """Return the model's vectors (N, 3)."""
        return self._once(lambda: self._model.at(readings, clamp=clamp), "at", clamp, readings.tobytes())

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return the model's shifts (N, 3): the same in its own axes, wherever base and tips are."""
        none = np.eye(4)
        own = self._once(
            lambda: self._model.shifts(none, np.tile(none, (len(readings), 1, 1)), readings),
            "shifts",
            readings.tobytes(),
        )
        return np.asarray((axes_of(self.frame, base, tips) @ own[:, :, None])[:, :, 0])

    def outside(self, readings: Array) -> tuple[str, ...]:
        """Return why the model does not know rows."""
        return self._once(lambda: self._model.outside(readings), "outside", readings.tobytes())

    def leaning(self, readings: Array) -> Leaning:
        """Return what the model takes its values from."""
        return self._once(lambda: self._model.leaning(readings), "leaning", readings.tobytes())

    def own_errors(self, readings: Array, noise: float) -> Array:
        """Return the model's factor (N, r)."""
        return self._once(lambda: self._model.own_errors(readings, noise), "own", noise, readings.tobytes())

    def scatter(self, noise: float) -> float:
        """Return what the model's rows scatter by."""
        return self._model.scatter(noise)

    @property
    def when_clamped(self) -> str:
        """As the model has it."""
        return self._model.when_clamped
