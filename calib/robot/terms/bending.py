"""Bending: a link is a beam that gives way to what it carries and weighs. Basis: the beam's motions."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.flexures import Flexure, beam, bending
from calib.robot.skeleton import Segment
from calib.robot.terms.kind import Basis, Coefficient, Rows, Shares
from calib.robot.terms.link import LinkKind
from calib.robot.terms.term import JointTerm


class Bending(LinkKind):
    """The turn of a link's end for a moment there: 100 Nm bend it by a milliradian."""

    names = ("bending",)
    key = "bending"
    coefficients = {"length": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    masses = "stated"

    def basis(self, shares: Shares) -> Basis:
        """Return the four motions of every link's end under what its end holds."""
        ends = shares.coordinate.reshape(-1, 4)
        beams = np.array([beam(length) for length in shares.length[::4]])

        def found(rows: Rows) -> Array:
            moved = np.einsum("nbi,bij->nbj", -rows.held[:, ends], beams)
            return np.asarray(moved.reshape(len(moved), ends.size))

        return found

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return the motions across the link, and about the directions across it."""
        return bending(segments, joint)
