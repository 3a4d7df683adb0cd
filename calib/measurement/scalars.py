"""Scalars: unknown numbers of instruments, boards and clocks, found with the machine that they measured.

The unknown part of a measured length is one. Poses are none: base, tools and targets have names of their own.
"""

import math
from dataclasses import dataclass
from typing import Literal

from calib.foundations.arguments import own_fields

ScalarUnit = Literal["m", "rad", "px", "s", "s/s", "1"]


@dataclass(frozen=True, slots=True)
class Scalar:
    """One unknown number, the same for all rows that name it.

    ``name``: that of its parameter, such as ``length.wire.offset``; in sets that are fitted together, one name is one
    number. ``start``: where the search begins, and what its prior is about, in ``unit``. ``size``: its parameter scale.
    ``prior``: the standard deviation of what is known of it, None where nothing is; ``weak_prior``: that of the weak
    prior which then takes its place, wide enough to be negligible wherever the data determine the number.

        Scalar("length.wire.offset", "m", size=1e-3, weak_prior=10.0)
    """

    name: str
    unit: ScalarUnit
    size: float
    start: float = 0.0
    prior: float | None = None
    weak_prior: float = math.inf

    def __post_init__(self) -> None:
        own_fields(self)
