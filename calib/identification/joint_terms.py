"""Which joint terms a model frees, and how large they ordinarily are."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from calib.foundations.errors import JobError
from calib.robot.robot import Robot
from calib.robot.transmission import JointTerm, TermKind

HIGHEST_ORDER = 1000

# Amounts that surprise nobody, in SI units: a tenth of a per mille of scale, and 20'' of a harmonic.
ORDINARY: Mapping[TermKind, float] = MappingProxyType({"gain": 1e-3, "cos": 1e-4, "sin": 1e-4})


def harmonic(reading: str, order: int) -> tuple[JointTerm, JointTerm]:
    """Return cosine and sine of one order of one reading."""
    return JointTerm(reading, "cos", order), JointTerm(reading, "sin", order)


def terms_of(
    robot: Robot, gain: Sequence[str], harmonics: Sequence[str], orders: Sequence[int]
) -> tuple[JointTerm, ...]:
    """Return the terms of the named readings, reading by reading.

    Raises JobError for an order that is none, and for harmonics of a reading that is a length and never comes round.
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
    return tuple(found)
