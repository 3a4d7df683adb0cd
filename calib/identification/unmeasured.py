"""How the whole set-up moves unmeasured, as parameters imitate it, and rows that do not see it."""

from typing import NamedTuple

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.identification import identifiability

# Unit directions are dependent when a combination of them is shorter than this.
_DEPENDENT = 1e-3
# J sees a motion clearly when its direction lies in the row space by more than this share.
_CLEARLY = 0.1


class Unmeasured(NamedTuple):
    """Directions, scaled and of unit length, in which the whole set-up moves unmeasured, as p parameters imitate it.

    ``exact`` (p, k): turns, then growing, which is zero where nothing grows. ``strains`` (p, j): what is hardly told.
    ``holds`` (p,): how strongly priors hold each parameter.
    """

    exact: Array
    strains: Array
    holds: Array

    @classmethod
    def none(cls, p: int) -> "Unmeasured":
        """Return those where nothing moves."""
        return cls(np.zeros((p, 0)), np.zeros((p, 0)), np.zeros(p))

    @property
    def any(self) -> bool:
        """Whether there are any."""
        return bool(self.exact.size or self.strains.size)

    @property
    def exact_alone(self) -> "Unmeasured":
        """The same without strains."""
        return self._replace(strains=self.strains[:, :0])

    @property
    def strains_beside_exact(self) -> tuple[Array, Array]:
        """Directions A (p, j) of strains alone, and coordinates B (p, j) that tell them, as of :func:`taken_out`.

        Of all directions that differ by exact ones, these are those that priors hold least. Without priors coordinates
        are at right angles to others. By priors a tool's length, which hardly shows where joints are nearly parallel
        and may be anything, is no part of a strain, far as it may go with one.
        """
        told = self.holds if np.any(self.holds[:, None] * self.strains != 0.0) else np.ones(len(self.holds))
        held, exact = told[:, None] * self.strains, told[:, None] * self.exact
        follow = np.linalg.lstsq(exact, held, rcond=_DEPENDENT)[0]
        lengths = np.maximum(np.linalg.norm(held, axis=0), np.finfo(np.float64).tiny)
        _, sizes, V = linear.svd((held - exact @ follow) / lengths, full_matrices=False)
        combined = (V.T / lengths[:, None])[:, sizes > _DEPENDENT]
        A = (self.strains - self.exact @ follow) @ combined
        B = told[:, None] ** 2 * A
        return A, np.asarray(B @ np.linalg.pinv(A.T @ B))

    @property
    def told_by(self) -> Array:
        """Coordinates (p, k + j) which say how far the parameters have gone along each."""
        return np.concatenate([self.exact, self.strains_beside_exact[1]], axis=1)


def without(J: Array, unmeasured: Unmeasured) -> Array:
    """Return scaled rows J (q, p) that do not see what is ``unmeasured``."""
    A, B = taken_out(J, unmeasured)
    return np.asarray(J - (J @ A) @ B.T)


def taken_out(J: Array, unmeasured: Unmeasured) -> tuple[Array, Array]:
    """Return directions A (p, j) and coordinates B (p, j): J - J A B^T are scaled rows J (q, p) without the motions.

    They may depend on each other: where one socket alone is touched, turns and growing are shifts but for residuals.
    Far from a solution, where J sees an exact one clearly, only what J sees of it is taken out: what else is in the
    null space of J, such as a shift of the whole set-up, would be seen through it. Near a solution nothing is left to
    be told apart. Of strains, of which J sees a little, priors tell what else is in the null space.
    """
    U, sizes, _ = linear.svd(unmeasured.exact, full_matrices=False)
    U = U[:, sizes > _DEPENDENT]
    found = identifiability.singular_directions(J)
    seen = found.vectors[:, : found.rank]
    # Principal vectors of both spaces: columns of `seen @ A` and `U @ B.T` are at angles whose cosines are `shares`.
    A, shares, B = linear.svd(seen.T @ U, full_matrices=False)
    Q = np.linalg.qr(np.where(shares > _CLEARLY, seen @ A, U @ B.T))[0]
    strains, told_by = unmeasured.strains_beside_exact
    told_by = told_by - Q @ (Q.T @ told_by)
    told_by = told_by @ np.linalg.pinv(strains.T @ told_by)
    return np.concatenate([Q, strains], axis=1), np.concatenate([Q, told_by], axis=1)
