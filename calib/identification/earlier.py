"""A fit that begins at an earlier one holds what that has found, and is no surer than that was.

What is held errs as the earlier rows let it err, and what is free now follows: the least-squares solution of the new
rows moves by ``-pinv(J_free) J_held`` times what is held. Earlier rows that are among the new ones are counted as if
they were others. Where the earlier rows do not tell, errors are those of the frame that the earlier fit has chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.linear import ROUNDING, svd
from calib.foundations.sealing import sealed
from calib.identification.parameters import Parameter, scales
from calib.identification.system import Problem, evaluate


class Errors(NamedTuple):
    """What p parameters may be off by, in SI units: by ``noise`` (p, r), and ``along`` (p, q) the null space.

    Both are factors of covariances. ``null_basis`` (p, k): the null space, one parameter scale along each direction.
    """

    noise: Array
    along: Array
    null_basis: Array

    def of(self, rows: Sequence[int] | IntArray) -> "Errors":
        """Return those of some parameters, by number; zeros where that is -1."""
        which = np.array(rows, dtype=np.intp)
        return Errors(*(np.vstack([part, np.zeros(part.shape[1])])[which] for part in self))

    def beside(self, other: "Errors") -> "Errors":
        """Return both, independent of each other."""
        return Errors(*map(np.hstack, zip(self, other, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Earlier:
    """Errors of an earlier fit, as what is held of it has them, and as what is free follows: of ``parameters`` (p,).

    Those of the fit that holds what the earlier one has found come first, in its order; then what is held.
    """

    __repr__ = brief

    parameters: tuple[Parameter, ...]
    errors: Errors

    def of(self, names: Sequence[str]) -> Errors:
        """Return the errors of parameters by their names; zeros where one is not known."""
        number = {parameter.name: k for k, parameter in enumerate(self.parameters)}
        return self.errors.of([number.get(name, -1) for name in names])


def following(problem: Problem, x: Array, sigmas: Sequence[Array], free: int, errors: Errors) -> Earlier:
    """Return what ``errors`` of the last parameters of a problem do to the ``free`` first ones.

    ``x`` (p,): where the search has ended; ``sigmas`` (N, d) of every set.
    """
    parameters, given = problem.parameters, np.hstack(errors)
    units = scales(parameters)
    hold = np.array([parameter.hold if k < free else 0.0 for k, parameter in enumerate(parameters)])
    rows = evaluate(problem, sigmas, x, problem.targets_apart).rows.whole.held(hold, np.zeros(len(hold)))
    reduced, split = rows.reduced(ROUNDING), rows.split
    J, own = reduced.rest[:, :-1], split.common < free
    moved = np.zeros((len(split.common), given.shape[1]))
    moved[~own] = (given / units[free:, None])[split.common[~own] - free]
    U, s, Vt = svd(J[:, own], full_matrices=False)
    moved[own] = -(Vt.T / np.maximum(s, ROUNDING * s.max(initial=0.0))) @ (U.T @ (J[:, ~own] @ moved[~own]))
    found = units[:, None] * split.whole(moved, reduced.follow @ moved)
    ends = np.cumsum([part.shape[1] for part in errors])[:-1]
    return Earlier(parameters, Errors(*map(read_only, np.split(found, ends, axis=1))))
