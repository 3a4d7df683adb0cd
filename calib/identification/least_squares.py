"""What the solver asks of a least-squares problem: nothing in it is about robots."""

from collections.abc import Sequence
from typing import Protocol

from calib.foundations.arrays import Array
from calib.identification.arrow import Split
from calib.identification.losses import Loss
from calib.identification.parameters import Parameter
from calib.identification.system import Component, Evaluation


class MeasuredSet(Protocol):
    """A set of measured rows, with the standard deviations (N, d) of the instrument; zero where nobody knows them."""

    @property
    def sigma(self) -> Array:  # noqa: D102
        ...


class LeastSquares(Protocol):
    """Residuals to be made small, as :class:`calib.identification.system.Problem` has them of a robot."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns."""

    @property
    def measurements(self) -> Sequence[MeasuredSet]:
        """The sets of rows."""

    @property
    def components(self) -> Sequence[Component]:
        """The groups of residuals that share a noise model."""

    @property
    def spent(self) -> Sequence[float]:
        """Degrees of freedom of every component that a choice of the model by the same rows has spent."""

    @property
    def losses(self) -> Sequence[Loss]:
        """The loss of every set."""

    @property
    def robust(self) -> bool:
        """Whether rows that lie off weigh less."""

    @property
    def targets_apart(self) -> Split:
        """The unknowns of every target by itself, apart from all others."""

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set at parameter values x (p,)."""

    def evaluate(self, sigmas: Sequence[Array], x: Array) -> Evaluation:
        """Return residuals and reduced Jacobians at x (p,), whitened by ``sigmas``, an (N, d) array for each set."""
