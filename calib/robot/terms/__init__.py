"""What lies between a motor and its joint, and between two joints: one class in one file for each kind of joint terms.

A new kind is a file here, its entry in ``KINDS``, and a line of docs/joint_terms.md: jobs, files of machines, the
choice of terms and the reports ask the registry.
"""

from collections.abc import Mapping
from types import MappingProxyType

from calib.robot.terms.backlash import Backlash
from calib.robot.terms.bending import Bending
from calib.robot.terms.elastic import Elastic
from calib.robot.terms.expansion import Expansion
from calib.robot.terms.gain import Gain
from calib.robot.terms.harmonic import Harmonic
from calib.robot.terms.hysteresis import Hysteresis
from calib.robot.terms.kind import Kind
from calib.robot.terms.lateral import Lateral, LateralMoment
from calib.robot.terms.moment import Moment
from calib.robot.terms.term import JointTerm
from calib.robot.terms.thermal import Thermal
from calib.robot.terms.torque import Torque
from calib.robot.terms.torsion import Torsion
from calib.robot.terms.warming import Warming

# Terms of one reading have this order among parameters. A link expands before it bends and twists; then bearings tilt.
KINDS: tuple[Kind, ...] = (
    Gain(),
    Harmonic(),
    Elastic(),
    Moment(),
    Torque(),
    Backlash(),
    Hysteresis(),
    Thermal(),
    Warming(),
    Expansion(),
    Bending(),
    Torsion(),
    Lateral(),
    LateralMoment(),
)
NAMED: Mapping[str, Kind] = MappingProxyType({name: kind for kind in KINDS for name in kind.names})


def kind_of(term: JointTerm) -> Kind:
    """Return the kind of a term."""
    return NAMED[term.kind]


__all__ = ["KINDS", "NAMED", "JointTerm", "Kind", "kind_of"]
