"""Torsion: a link twists about its own direction under the torque about it. Basis: -tau, at nominal geometry."""

from collections.abc import Sequence

from calib.robot.flexures import Flexure, twisting
from calib.robot.skeleton import Segment
from calib.robot.terms.kind import Coefficient, Compliance
from calib.robot.terms.link import LinkKind
from calib.robot.terms.term import JointTerm


class Torsion(Compliance, LinkKind):
    """The turn of a link's end about the link: 100 Nm twist it by a milliradian."""

    names = ("torsion",)
    key = "torsion"
    coefficients = {"length": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    chosen_by_data = False

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return the turn about the link."""
        return twisting(segments, joint)
