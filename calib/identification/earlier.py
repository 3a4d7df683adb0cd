"""A fit that begins at an earlier one holds what that has found, and is no surer than that was.

What is held errs as the earlier rows let it err, and what is free now follows: the least-squares solution of the new
rows moves by ``-pinv(J_free) J_held`` times what is held. Earlier rows that are among the new ones are counted as if
they were others. Where the earlier rows do not tell, errors are those of the frame that the earlier fit has chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.linear import svd
from calib.identification.parameters import Parameter, scales
from calib.identification.system import Problem, evaluate

# Singular values below this share of the largest are rounding.
_SINGULAR = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class Earlier:
    """Errors of an earlier fit: ``factor`` (p, r), in SI units, of what they do to ``parameters`` (p,).

    Those of the fit that holds what the earlier one has found come first, in its order; then what is held.
    """

    __repr__ = brief

    parameters: tuple[Parameter, ...]
    factor: Array

    def of(self, names: Sequence[str]) -> Array:
        """Return the rows (k, r) of parameters by their names; zeros where one is not known."""
        rows = {parameter.name: row for parameter, row in zip(self.parameters, self.factor, strict=True)}
        return np.array([rows.get(name, np.zeros(self.factor.shape[1])) for name in names]).reshape(len(names), -1)


def following(problem: Problem, x: Array, sigmas: Sequence[Array], free: int, errors: Array) -> Earlier:
    """Return what ``errors`` (k, r), in SI units, of the last parameters of a problem do to the ``free`` first ones.

    ``x`` (free + k,): where the search has ended; ``sigmas`` (N, d) of every set.
    """
    parameters = problem.parameters
    units = scales(parameters)
    hold = np.array([parameter.hold if k < free else 0.0 for k, parameter in enumerate(parameters)])
    rows = evaluate(problem, sigmas, x, problem.targets_apart).rows.whole.held(hold, np.zeros(len(hold)))
    reduced, split = rows.reduced(_SINGULAR), rows.split
    J, own = reduced.rest[:, :-1], split.common < free
    moved = np.zeros((len(split.common), errors.shape[1]))
    moved[~own] = (errors / units[free:, None])[split.common[~own] - free]
    U, s, Vt = svd(J[:, own], full_matrices=False)
    moved[own] = -(Vt.T / np.maximum(s, _SINGULAR * s.max(initial=0.0))) @ (U.T @ (J[:, ~own] @ moved[~own]))
    return Earlier(parameters, read_only(units[:, None] * split.whole(moved, reduced.follow @ moved)))
