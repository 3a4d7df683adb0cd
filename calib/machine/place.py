"""How sure it is where a calibrated machine stands, as plain data, and in words."""

from dataclasses import dataclass, replace

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.chance import bound
from calib.foundations.choices import PlacedIn
from calib.foundations.linear import svd
from calib.foundations.sealing import sealed
from calib.foundations.units import MM

# Sine of an angle between two motions below which one cannot be told from the other.
SAME = 0.05
# Cosine of an angle below which a direction is told by numbers, and not as that of an axis.
_ALONG = 0.999
_AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Place:
    """How sure a place is: of twists (v, w) at its origin, in the axes of the frame it is told in, in m and rad.

    ``factor`` (6, r): of the covariance, ``factor @ factor.T``, in directions that are determined; ``undetermined``
    (6, k): twists in the directions that are not. ``freedom``: degrees of freedom of the covariance.
    """

    __repr__ = brief

    factor: Array
    undetermined: Array
    freedom: float

    def at(self, origin: Array) -> "Place":
        """Return the same, told at another ``origin`` (3,), which is given from the one that it has."""
        carried = np.eye(6)
        carried[:3, 3:] = -rigid.skew(origin)
        return replace(self, factor=carried @ self.factor, undetermined=carried @ self.undetermined)

    def turned(self, R: Array) -> "Place":
        """Return the same in other axes: those that ``R`` (3, 3) takes the axes of now to."""
        both = np.kron(np.eye(2), R)
        return replace(self, factor=both @ self.factor, undetermined=both @ self.undetermined)

    def beside(self, other: "Place") -> "Place":
        """Return how sure the one is seen from the other, told at one origin in one frame, with errors of their own."""
        factor, undetermined = (
            np.hstack(parts) for parts in ((self.factor, other.factor), (self.undetermined, other.undetermined))
        )
        return Place(factor, undetermined, min(self.freedom, other.freedom))

    @property
    def undetermined_basis(self) -> Array:
        """An orthonormal basis (6, m) of what is not determined, a radian being as long as a metre."""
        if not self.undetermined.size:
            return np.zeros((6, 0))
        U, sizes, _ = svd(self.undetermined, full_matrices=False)
        return np.asarray(U[:, sizes > SAME * sizes[0]]) if sizes[0] > 0.0 else np.zeros((6, 0))

    @property
    def covariance(self) -> Array:
        """The covariance (6, 6) in directions across those that are not determined."""
        basis = self.undetermined_basis
        told = self.factor - basis @ (basis.T @ self.factor)
        return np.asarray(told @ told.T)

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations of the position in m and of the orientation in rad, all three numbers together."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))

    def contents(self) -> dict[str, object]:
        """Return it as plain data, in m and rad."""
        position, orientation = self.sigmas
        return {
            "sigma_position": position,
            "sigma_orientation": orientation,
            "covariance": self.covariance.tolist(),
            "degrees_of_freedom": None if np.isinf(self.freedom) else self.freedom,
            "undetermined": [
                {"direction": said, "twist": twist.tolist()} for said, twist in undetermined_in_words(self)
            ],
        }

    def inside(self, twist: Array, probability: float = 0.95) -> bool:
        """Tell whether an error (6,) is inside the region of the given probability, across what is not determined."""
        basis = self.undetermined_basis
        across = svd(np.eye(6) - basis @ basis.T)[0][:, : 6 - basis.shape[1]]
        if not across.size:
            return True
        x, C = across.T @ twist, across.T @ self.covariance @ across
        return bool(x @ np.linalg.solve(C, x) <= bound(probability, len(x), self.freedom))


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """In whose frame a machine's bases were found: of the ``arm`` that touched it, or of the ``instrument``.

    ``by_arm``: what errors of that arm do to the place, in its base at its origin; None where they are not known.
    """

    __repr__ = brief

    within: PlacedIn
    by_arm: Place | None = None


def undetermined_in_words(place: Place) -> tuple[tuple[str, Array], ...]:
    """Return directions in which a place is not determined, with their twists (6,): shifts first, then turns.

    In the axes of the place, and from its origin. A line through it is that of a turn about it.
    """
    basis = place.undetermined_basis
    if not basis.size:
        return ()
    _, sizes, Vt = svd(basis[3:])
    count = int(np.count_nonzero(sizes > SAME))
    shifts, turning = basis[:3] @ Vt[count:].T, basis @ Vt[:count].T
    said = [(f"along {_named(k)}", np.concatenate([k, np.zeros(3)])) for k in _directions(shifts)]
    for k in _directions(turning[3:]):
        v = turning[:3] @ np.linalg.lstsq(turning[3:], k, rcond=None)[0]
        v = v - shifts @ (np.linalg.pinv(shifts) @ v)
        point = np.cross(k, v)
        through = ""
        if np.linalg.norm(point) > MM:
            through = " through ({:.0f}, {:.0f}, {:.0f}) mm from its base".format(*point / MM)
        said.append((f"turning about {_named(k)}{through}", np.concatenate([v, k])))
    return tuple(said)


def _directions(basis: Array) -> list[Array]:
    """Return unit vectors (3,) that span a basis (3, k): axes of the frame as far as these lie in it."""
    if not basis.size:
        return []
    U, sizes, _ = svd(basis, full_matrices=False)
    U = U[:, sizes > SAME * sizes[0]]
    axes = [e for e in np.eye(3) if np.linalg.norm(U.T @ e) > _ALONG]
    across = np.eye(3) - sum((np.outer(e, e) for e in axes), np.zeros((3, 3)))
    rest = svd(across @ U, full_matrices=False)[0][:, : U.shape[1] - len(axes)]
    # Either sense is meant.
    return [*axes, *(k * np.sign(k[np.argmax(np.abs(k))]) for k in rest.T)]


def _named(k: Array) -> str:
    largest = int(np.argmax(np.abs(k)))
    return _AXES[largest] if abs(k[largest]) > _ALONG else "({:.3f}, {:.3f}, {:.3f})".format(*k)
