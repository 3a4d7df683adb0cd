"""Named parameters: what may deviate, in which unit, and how far one expects it to."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.transmission import TermUnit

ParameterKind = Literal["offset", "placement", "term", "base", "tool", "target"]
ParameterUnit = Literal["m", "rad"] | TermUnit
# Standard deviation of a prior, in SI units, or one that the data are to teach.
Prior = float | Literal["learned"]

# What counts as an ordinary deviation when nobody says otherwise: it makes millimetres and milliradians comparable.
DEFAULT_SIGMA = 1e-3


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown of the machine.

    ``name`` never changes between code, reports and files: ``joint_3.rx``, ``joint_2.offset``, ``base.z``, ``tool.x``.
    ``direction``: the entries of the state that it moves, and by how much each for one unit of the parameter.
    ``prior`` is the standard deviation of a prior about the nominal value, in ``unit``, or None; ``ordinary`` the size
    of a deviation that surprises nobody. Where the width of the prior is learned, ``group`` names those that share it,
    and the prior is None until then.
    """

    name: str
    unit: ParameterUnit
    kind: ParameterKind
    direction: tuple[tuple[int, float], ...]
    prior: float | None = None
    ordinary: float = DEFAULT_SIGMA
    group: str | None = None

    @property
    def of_robot(self) -> bool:
        """Whether the parameter belongs to the robot itself rather than to a frame of the set-up."""
        return self.kind in ("offset", "placement", "term")

    @property
    def scale(self) -> float:
        """Size of an ordinary deviation, in ``unit``: the prior's where one is stated."""
        return self.ordinary if self.prior is None or self.group is not None else self.prior

    @property
    def hold(self) -> float:
        """How strongly the prior holds: ordinary deviations in one of its standard deviations, inverted; 0: none."""
        return 0.0 if self.prior is None else self.scale / self.prior


def scales(parameters: Sequence[Parameter]) -> Array:
    """Return the scales (p,) of the parameters."""
    return np.array([parameter.scale for parameter in parameters])


def directions(parameters: Sequence[Parameter], size: int) -> Array:
    """Return the matrix (size, p) that maps parameter values to entries of a state of that size."""
    S = np.zeros((size, len(parameters)))
    for k, parameter in enumerate(parameters):
        for entry, share in parameter.direction:
            S[entry, k] = share
    return S
