"""Wind-up: the drive gives way to what it holds against gravity, at nominal geometry. Basis: -tau."""

from calib.robot.terms.kind import Coefficient, Compliance, Dimension
from calib.robot.terms.term import JointTerm


class Elastic(Compliance):
    """A compliance: 100 Nm wind a drive up by a milliradian, 10 kN press a spindle in by a millimetre."""

    names = ("elastic",)
    key = "elastic"
    coefficients = {"angle": Coefficient("rad/Nm", 1e-5), "length": Coefficient("m/N", 1e-7)}
    shown = {"rad/Nm": "urad/Nm", "m/N": "um/N"}
    priors = {"angle": "elastic", "length": "elastic_sliding"}

    def group(self, term: JointTerm, dimension: Dimension) -> str:
        """Return the name of all compliances of one unit."""
        return "compliances" if dimension == "angle" else "compliances of joints that slide"
