"""What stands in a field of a job. Each kind says itself what is wrong: pydantic's own words are for programmers."""

import json
import math
from collections.abc import Callable
from datetime import date
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, PlainValidator

from calib.foundations.errors import JobError
from calib.foundations.ranges import COUNTS, MOST_NAMES, RANGES
from calib.foundations.units import Dimension, example_of, parse_quantity, symbols
from calib.foundations.words import on_one_line, shortened
from calib.measurement.lens import NAMES
from calib.measurement.orientations import ORIENTATIONS
from calib.robot.terms.kind import Option

# Six digits of each component are enough; half a quaternion or another order of magnitude is not.
_NORM_TOLERANCE = 1e-3
_MOST_ITERATIONS = 1000
_SHORTEST_NORMAL = 1e-6
_MOST_WORDS = 500


class Quantity(str):
    """A quantity as it stands in a job, ``"0.02 mm"``, with its value ``si`` in SI units and its dimension."""

    si: float
    dimension: Dimension

    @classmethod
    def made(cls, text: str, si: float, dimension: Dimension) -> "Quantity":
        """Return the text with what it says."""
        found = cls(text)
        found.si, found.dimension = si, dimension
        return found

    def of(self, dimension: Dimension, where: str) -> float:
        """Return the value in SI units. Raises JobError where it is of another dimension."""
        return self.si if self.dimension == dimension else parse_quantity(self, dimension, where)


# The width of a prior, or what the data are to teach.
Prior = Quantity | Literal["learned"]


def quantity(name: str) -> Callable[[object], Quantity]:
    """Return a validator of text like ``"0.02 mm"``; its dimension, sign and size are those of ``RANGES``."""
    allowed = RANGES[name]
    dimension = allowed.dimension

    def checked(text: object) -> Quantity:
        if not isinstance(text, str):
            raise ValueError(f"{as_toml(text)} is not a text with a number and a unit, like {example_of(dimension)!r}.")
        try:
            value = parse_quantity(text, dimension, "")
        except JobError as e:
            raise ValueError(str(e).removeprefix(": ")) from e
        if value <= 0.0 and allowed.low > 0.0 and not allowed.zero and not name.startswith("relations"):
            raise ValueError(f"{text!r} is not above 0; leave the key out where it is not known.")
        if not allowed.holds(value):
            raise ValueError(f"{text!r} is out of range; allowed is {allowed}.")
        return Quantity.made(text, value, dimension)

    return checked


def number(name: str) -> Callable[[float], float]:
    """Return a validator of a number without unit, of the size that ``RANGES`` says."""

    def checked(value: float) -> float:
        if not RANGES[name].holds(value):
            raise ValueError(f"{value:g} is out of range; allowed is {RANGES[name]}.")
        return value

    return checked


def at_most(count: int) -> Callable[[object], object]:
    """Return a validator of a list or a section with no more than so many entries."""

    def checked(value: object) -> object:
        if isinstance(value, tuple | dict) and len(value) > count:
            raise ValueError(f"has {len(value)} entries; allowed are {count}.")
        return value

    return checked


def being(what: str, holds: Callable[[Any], bool]) -> Callable[[object], object]:
    """Return a validator of a value that ``holds`` accepts; ``what`` that is, for the sentence about another one."""

    def checked(value: object) -> object:
        if not holds(value):
            raise ValueError(f"{as_toml(value)} is not {what}.")
        return value

    return checked


def list_of(count: int, what: str) -> Callable[[object], object]:
    """Return a validator of a list of so many; ``what`` they are."""
    return being(f"a list of {what}", lambda value: isinstance(value, tuple) and len(value) == count)


def _unit_quaternion(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.hypot(*value)  # unlike NumPy's norm it does not overflow
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        raise ValueError(f"{as_toml(value)} has the norm {norm:.6g}, and must have 1; the order is w, x, y, z.")
    return value


def _some_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not _SHORTEST_NORMAL <= math.hypot(*value) < math.inf:
        raise ValueError(f"{as_toml(value)} has no direction.")
    return value


def selection(*words: str) -> Callable[[object], object]:
    """Return a validator of names, or of one of these words in their place."""
    named = being(
        f"{', '.join(json.dumps(word) for word in words)} or a list of names",
        lambda value: value in words or (isinstance(value, tuple) and all(isinstance(name, str) for name in value)),
    )
    few = at_most(MOST_NAMES)
    return lambda value: named(few(value))


def _not_empty(text: str) -> str:
    if not text.strip():
        raise ValueError("is empty.")
    return text


def _is_place(value: Any) -> bool:
    """Return whether a value is one of the words floor and tip, or a section that names a link."""
    of_link = isinstance(value, dict) and list(value) == ["link"] and isinstance(value["link"], str) and value["link"]
    return value in ("floor", "tip") or bool(of_link)


camera_place = being('"floor", "tip" or a link, like { link = "head" }', _is_place)


def free_of_lens(value: object) -> object:
    """Accept the words given and free, or names of numbers of a lens."""
    if value in ("given", "free"):
        return value
    if not isinstance(value, tuple) or not value or not all(name in NAMES for name in value):
        raise ValueError(f'{as_toml(value)} is not "given", "free" or a list of {", ".join(NAMES)}.')
    if len(set(value)) < len(value):
        raise ValueError(f"{as_toml(value)} names a number twice.")
    return value


iterations = being(
    f"a whole number from 1 to {_MOST_ITERATIONS}", lambda value: type(value) is int and 1 <= value <= _MOST_ITERATIONS
)
# What three angles, or nine numbers, of an orientation are.
orientation_name = being(
    f"one of {', '.join(ORIENTATIONS[:5])}, nor the order of three turns, like "
    '"ZYX" about the turned axes (intrinsic) or "xyz" about fixed axes (extrinsic)',
    lambda value: value is None or value in ORIENTATIONS,
)
# As Python has it, 1 == 1.0 == True.
this_schema = being("a schema that this version reads; it must be 1", lambda value: type(value) is int and value == 1)


def term_option(name: str, option: Option) -> Callable[[object], object]:
    """Return a validator of a key beside that of a kind of joint terms."""
    usable = being(option.what, lambda value: value != () and option.holds(value))
    few = at_most(COUNTS.get(f"error_model.{name}", MOST_NAMES))
    return lambda value: few(usable(value))


def either(usual: str, other: str) -> Callable[[object], Quantity]:
    """Return a validator of a quantity of one of two dimensions; another key decides which one it must be."""
    others = symbols(RANGES[other].dimension)
    return lambda text: quantity(other if str(text).rstrip().endswith(others) else usual)(text)


def _or_learned(check: Callable[[object], Quantity]) -> Callable[[object], Prior]:
    """Return a validator of the width of a prior: what ``check`` accepts, or the word for what the data teach."""

    def checked(text: object) -> Prior:
        if text == "learned":
            return "learned"
        if isinstance(text, str) and text.isalpha():
            raise ValueError(f'{as_toml(text)} is neither a number with a unit nor "learned".')
        return check(text)

    return checked


def _are_counts(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(type(n) is int and n > 0 for n in value)


def _is_share(value: object) -> bool:
    return isinstance(value, float) and 0.0 < value < 1.0


def _is_one_line(text: object) -> bool:
    return isinstance(text, str) and bool(text.strip()) and on_one_line(text) == text and len(text) <= _MOST_WORDS


def _date(day: object) -> str:
    """Return a date as ISO 8601 has it; TOML has dates of its own."""
    try:
        return (day if type(day) is date else date.fromisoformat(str(day))).isoformat()
    except ValueError:
        raise ValueError(f"{as_toml(str(day))} is not a date like 2025-03-31.") from None


AboutWords = Annotated[
    str, BeforeValidator(being(f"one line of text of at most {_MOST_WORDS} characters", _is_one_line))
]
AboutDate = Annotated[str, BeforeValidator(_date)]
Name = Annotated[str, AfterValidator(_not_empty)]
Names = Annotated[tuple[Name, ...], BeforeValidator(at_most(MOST_NAMES))]
# What is read: a file, or a folder of them. Nothing else in a job is a path.
READ = "is read"
FileName = Annotated[Name, READ]
Place = Annotated[Quantity, PlainValidator(quantity("position, station, point"))]
Position = Annotated[tuple[Place, Place, Place], BeforeValidator(list_of(3, "three lengths x, y, z"))]
Acceleration = Annotated[Quantity, PlainValidator(quantity("gravity"))]
Gravity = Annotated[
    tuple[Acceleration, Acceleration, Acceleration],
    BeforeValidator(list_of(3, 'three accelerations, like ["0 m/s2", "0 m/s2", "-9.81 m/s2"]')),
]
LengthPrior = Annotated[Prior, PlainValidator(_or_learned(quantity("prior.length")))]
AnglePrior = Annotated[Prior, PlainValidator(_or_learned(quantity("prior.angle")))]
HarmonicsPrior = Annotated[Prior, PlainValidator(_or_learned(quantity("prior.harmonics")))]
CompliancePrior = Annotated[
    Prior, PlainValidator(_or_learned(either("prior.elastic", "prior.elastic of readings that slide")))
]
PrintedLength = Annotated[Quantity, PlainValidator(quantity("square, marker"))]
PrintedShare = Annotated[float, AfterValidator(number("square_sigma"))]
Counts = Annotated[tuple[int, int], BeforeValidator(being("a list of two whole numbers, like [7, 5]", _are_counts))]
# That of pixels is the camera's, which is said where it is known what is observed.
Sigma = Annotated[Quantity, PlainValidator(either("sigma", "instruments.sigma of a camera"))]
SigmaAngle = Annotated[Quantity, PlainValidator(quantity("sigma_angle"))]
InstrumentSigma = Annotated[Quantity, PlainValidator(either("instruments.sigma", "instruments.sigma of a camera"))]
ModelSigma = Annotated[Quantity, PlainValidator(either("model_sigma", "model_sigma of pixels"))]
FocalLength = Annotated[Quantity, PlainValidator(quantity("fx, fy"))]
PrincipalPoint = Annotated[Quantity, PlainValidator(quantity("cx, cy"))]
LensSigma = Annotated[Quantity, PlainValidator(quantity("lens_sigma"))]
DistortionSigma = Annotated[float, AfterValidator(number("lens_sigma of distortion"))]
Distortion = Annotated[float, AfterValidator(number("k1, k2, p1, p2, k3, k4, k5, k6"))]
CouplingOffset = Annotated[Quantity, PlainValidator(either("coupling.offset", "coupling.offset of what slides"))]
RelationSigma = Annotated[Quantity, PlainValidator(either("relations.sigma", "relations.sigma of an angle"))]
Multiple = Annotated[float, AfterValidator(number("coupling.drivers"))]
Quaternion = Annotated[
    tuple[float, float, float, float],
    BeforeValidator(list_of(4, "four numbers w, x, y, z")),
    AfterValidator(_unit_quaternion),
]
Component = Annotated[float, AfterValidator(number("normal"))]
Direction = Annotated[
    tuple[Component, Component, Component],
    BeforeValidator(list_of(3, "three numbers x, y, z")),
    AfterValidator(_some_length),
]
Share = Annotated[float, BeforeValidator(being("a share between 0 and 1, like 0.25", _is_share))]
Selection = Annotated[Literal["all", "none"] | tuple[str, ...], BeforeValidator(selection("all", "none"))]


def as_toml(value: object) -> str:
    """Return a value as TOML has it, short enough for a sentence."""
    if isinstance(value, dict):
        return "a section with keys"
    if isinstance(value, tuple):
        return f"[{', '.join(map(as_toml, value[:5]))}{', ...' if len(value) > 5 else ''}]"
    if isinstance(value, bool):
        return str(value).lower()
    text = shortened(str(value))
    return repr(text) if isinstance(value, str) else text
