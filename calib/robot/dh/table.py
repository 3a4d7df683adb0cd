"""A DH table and its two conventions.

With q_i the position of joint i, zero for a fixed row, and theta_i + q_i or d_i + q_i as the joint turns or slides:

    standard   T = base . prod_i [ Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i) ] . tool
    modified   T = base . prod_i [ Rx(alpha_i) Tx(a_i) Ry(beta_i) Rz(theta_i) Tz(d_i) ] . tool

so that row i of a modified table holds what Craig calls alpha_{i-1} and a_{i-1}. Both are one alternation of *along*
steps Rz Tz, which commute with the joint, and *across* steps Tx Rx Ry from one axis to the next; they differ in the row
that a step across is written in, and in nothing else.
"""

from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.choices import Convention
from calib.foundations.errors import RobotError
from calib.foundations.ranges import OF_DIMENSION
from calib.foundations.sealing import sealed
from calib.foundations.words import refuse_other

RowType = Literal["revolute", "prismatic", "fixed"]
NUMBERS = ("a", "d", "alpha", "theta", "beta")

_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class DhRow:
    """One row: ``a`` and ``d`` in m, ``alpha``, ``theta`` and Hayati's ``beta`` in rad, at joint position zero."""

    joint: str
    type: RowType
    a: float
    d: float
    alpha: float
    theta: float
    beta: float = 0.0

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.type, get_args(RowType), f"DH table: type of joint {self.joint!r}", RobotError)
        if not np.isfinite([getattr(self, number) for number in NUMBERS]).all():
            raise RobotError(f"DH table: joint {self.joint!r} has a number that is not finite.")
        for number in NUMBERS:
            unit, of = ("m", OF_DIMENSION["length"]) if number in "ad" else ("rad", OF_DIMENSION["angle"])
            if not of.holds(getattr(self, number)):
                raise RobotError(
                    f"DH table: joint {self.joint!r} has {number} {getattr(self, number):g} {unit}; allowed is {of}."
                )

    @property
    def along(self) -> Array:
        """The step (4, 4) along the row's own axis, Rz(theta) Tz(d)."""
        return step_along(self.theta, self.d)

    @property
    def across(self) -> Array:
        """The step (4, 4) between two axes, Tx(a) Rx(alpha) Ry(beta)."""
        return step_across(self.a, self.alpha, self.beta)


def step_along(theta: float, d: float) -> Array:
    """Return the step (4, 4) along an axis, Rz(theta) Tz(d)."""
    return rigid.placement(rigid.rotation_about(_Z, theta), d * _Z)


def step_across(a: float, alpha: float, beta: float) -> Array:
    """Return the step (4, 4) between two axes, Tx(a) Rx(alpha) Ry(beta)."""
    return rigid.placement(rigid.rotation_about(_X, alpha) @ rigid.rotation_about(_Y, beta), a * _X)


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class DhTable:
    """Rows from base to tip. ``base`` (4, 4): frame 0 in the base link; ``tool`` (4, 4): the tip in the last frame.

    Raises RobotError when a joint has two rows, no row moves, a number is beyond 1e4 m or rad, or a frame is no rigid
    placement.
    """

    __repr__ = brief

    convention: Convention
    rows: tuple[DhRow, ...]
    base: Array = field(default_factory=lambda: read_only(np.eye(4)))
    tool: Array = field(default_factory=lambda: read_only(np.eye(4)))

    def __post_init__(self) -> None:
        own_fields(self)
        check_convention(self.convention)
        names = [row.joint for row in self.rows]
        for row in self.rows:
            if names.count(row.joint) > 1:
                raise RobotError(f"DH table: joint {row.joint!r} has more than one row.")
        if all(row.type == "fixed" for row in self.rows):
            raise RobotError("DH table: no joint moves; a table needs a revolute or a prismatic row.")
        for name, T in (("base", self.base), ("tool", self.tool)):
            if T.shape != (4, 4) or not rigid.are_placements(T[None], 1e-9)[0]:
                raise RobotError(f"DH table: the {name} is not a rigid placement (4, 4).")

    def contents(self) -> dict[str, Any]:
        """Return the table as plain data, in m and rad."""
        return {
            "convention": self.convention,
            "rows": [asdict(row) for row in self.rows],
            "base": self.base.tolist(),
            "tool": self.tool.tolist(),
        }


def check_convention(convention: str) -> None:
    """Raise RobotError unless ``convention`` is one of the two."""
    refuse_other(convention, get_args(Convention), "DH convention", RobotError)
