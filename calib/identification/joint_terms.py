"""Which joint terms a model frees, and how large they ordinarily are."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from calib.foundations.errors import JobError
from calib.robot.flexures import length
from calib.robot.joint_terms import moments
from calib.robot.robot import Robot, segments
from calib.robot.transmission import JointTerm, TermKind, TermUnit

HIGHEST_ORDER = 1000

# Amounts that surprise nobody, in SI units: a per mille of scale, 20'' of a harmonic, 100 Nm that wind a drive up by a
# milliradian, 10 kN that press a spindle in by a millimetre, ten kilograms (or kilogram metres) on either, what 10 K do
# to a zero, steel.
_ORDINARY: Mapping[TermUnit, float] = MappingProxyType(
    {
        "1": 1e-3,
        "rad": 1e-4,
        "m": 1e-5,
        "rad/Nm": 1e-5,
        "m/N": 1e-7,
        "kg rad/Nm": 1e-4,
        "kg m rad/Nm": 1e-4,
        "kg m/N": 1e-6,
        "kg m2/N": 1e-6,
        "rad/K": 1e-5,
        "m/K": 1e-5,
        "1/K": 1e-5,
    }
)


def ordinary(unit: TermUnit) -> float:
    """Return the size of an amount that surprises nobody."""
    return _ORDINARY[unit]


def harmonic(reading: str, order: int) -> tuple[JointTerm, JointTerm]:
    """Return cosine and sine of one order of one reading."""
    return JointTerm(reading, "cos", order), JointTerm(reading, "sin", order)


def group_of(term: JointTerm, dimension: str) -> str:
    """Return the name of those harmonics, or compliances, that are like this one: they may share a prior."""
    if term.order:
        return f"harmonics of {term.reading}"
    return "compliances" if dimension == "angle" else "compliances of joints that slide"


def terms_of(
    robot: Robot,
    gain: Sequence[str],
    harmonics: Sequence[str],
    orders: Sequence[int],
    others: Mapping[TermKind, Sequence[str]],
) -> tuple[JointTerm, ...]:
    """Return the terms of the named readings, reading by reading; ``others``: readings by the kind of a single term.

    Raises JobError for an order that is none, and for harmonics or torques of a reading that is a length.
    """
    for order in orders:
        if type(order) is not int or not 1 <= order <= HIGHEST_ORDER:
            raise JobError(f"harmonic_orders: {order!r} is not a whole number from 1 to {HIGHEST_ORDER}.")
    found: list[JointTerm] = []
    for reading in robot.readings:
        if reading.name in gain:
            found.append(JointTerm(reading.name, "gain"))
        if reading.name in harmonics:
            if reading.dimension == "length":
                raise JobError(f"harmonics: {reading.name!r} slides, and harmonics are of angles.")
            found += [term for order in sorted(set(orders)) for term in harmonic(reading.name, order)]
        if reading.dimension == "length" and reading.name in others.get("torque", ()):
            raise JobError(f"torque: {reading.name!r} slides, and torques are of joints that turn.")
        found += [JointTerm(reading.name, kind) for kind, names in others.items() if reading.name in names]
    return tuple(found)


def moments_of(robot: Robot, readings: Sequence[str]) -> tuple[JointTerm, ...]:
    """Return the wind-up of the named readings by masses that nobody knows.

    Raises JobError when none of them would hold a mass anywhere against gravity.
    """
    found = tuple(term for term in moments(robot) if term.reading in readings) if readings else ()
    if readings and not found:
        raise JobError(f"moments: {readings[0]!r} holds no mass against gravity, wherever it is.")
    return found


def links(robot: Robot, *, moving: bool) -> list[str]:
    """Return the names of the joints before which there is a link with a length: of all, or of those that move."""
    chain = zip(segments(robot), robot.chain, strict=True)
    return [joint.name for s, joint in chain if length(s) and not (moving and joint.type == "fixed")]
