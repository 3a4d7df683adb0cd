"""Expansion: links grow as the machine warms up. Basis: length times (T - 20 degC)."""

from collections.abc import Sequence

from calib.robot.flexures import Flexure, expanding
from calib.robot.skeleton import Segment
from calib.robot.terms.kind import TEMPERATURE, Basis, Coefficient, Shares
from calib.robot.terms.link import LinkKind
from calib.robot.terms.term import WHOLE_ARM, JointTerm
from calib.robot.terms.thermal import warmth


class Expansion(LinkKind):
    """A coefficient of expansion, of one link or of all: steel has 12 ppm/K."""

    names = ("expansion",)
    key = "expansion"
    words = (WHOLE_ARM,)
    coefficients = {"length": Coefficient("1/K", 1e-5)}
    shown = {"1/K": "ppm/K"}
    needs = (TEMPERATURE,)

    def basis(self, shares: Shares) -> Basis:
        """Return what every link grows by."""
        return lambda rows: warmth(rows) * shares.length

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return the motion along the link."""
        return expanding(segments, joint)
