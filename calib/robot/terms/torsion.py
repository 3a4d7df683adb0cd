"""Torsion: a link twists about its own direction under the torque about it. Basis: -tau, at nominal geometry."""

from collections.abc import Mapping, Sequence

from calib.robot.conditions import Conditions
from calib.robot.flexures import Flexure, twisting
from calib.robot.skeleton import Segment
from calib.robot.terms.kind import Basis, Coefficient, Parts, Shares
from calib.robot.terms.link import LinkKind
from calib.robot.terms.term import JointTerm


class Torsion(LinkKind):
    """The turn of a link's end about the link: 100 Nm twist it by a milliradian."""

    names = ("torsion",)
    key = "torsion"
    coefficients = {"length": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    masses = "stated"

    def basis(self, shares: Shares) -> Basis:
        """Return what the links' ends hold about the links, the other way round."""
        return lambda rows: -rows.held[:, shares.coordinate]

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return the turn about the link."""
        return twisting(segments, joint)

    def offered(
        self, parts: Parts, told: Conditions, options: Mapping[str, object]
    ) -> tuple[tuple[JointTerm, ...], ...]:
        """Return nothing: who frees it knows that the links are soft."""
        return ()
