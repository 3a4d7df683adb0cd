"""Named parameters: what may deviate, in which unit, and how far one expects it to."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond
from calib.robot.terms import JointTerm, kind_of
from calib.robot.terms.kind import Dimension

ParameterKind = Literal["offset", "placement", "term", "base", "tool", "target", "instrument"]
# Standard deviation of a prior, in SI units, or one that the data are to teach.
Prior = float | Literal["learned"]

_RANGES = {
    "length": "prior.length",
    "angle": "prior.angle",
    "harmonics": "prior.harmonics",
    "elastic": "prior.elastic",
    "elastic_sliding": "prior.elastic of readings that slide",
}
# The parameter scale where no prior gives one: it makes millimetres and milliradians comparable.
DEFAULT_SIGMA = 1e-3
# Standard deviations of the weak priors of parameters that were given none, in m and rad: of joint offsets and of link
# placements; of a tool point it is the arm's reach, or what is stated here where the poses do not show the point. Base,
# targets and the tool's orientation have such wide ones that what could be in the robot as well as in a frame of the
# set-up is in the frame. Terms: so many parameter scales.
OFFSET_WIDTH = 0.1
PLACEMENT_WIDTH = 0.01
UNSHOWN_TOOL_WIDTH = 0.03
FRAME_WIDTH = 10.0
TERM_WIDTH = 10.0
# Weak priors of terms that the data clearly ask to be larger than those of industrial arms: so many times as wide.
WIDER_TERM = 100.0
# How improbable it must be that they are not larger than their priors let them be; what is left, at least.
_SURELY, _NO_COST = 1e-4, 1e-12
# The group of tools whose points poses do not show.
UNSHOWN_TOOLS = "tools"
# An ordinary distance of a tool point from its link, in m.
TOOL = 0.3


@dataclass(frozen=True, slots=True)
class Priors:
    """Priors: the standard deviations, about zero, that parameters are expected to have; None for no prior.

    ``length`` (m) and ``angle`` (rad): of every offset and placement. Of the coefficients of joint terms: ``harmonics``
    in rad; ``elastic``, compliances under gravity of readings that turn, in rad/Nm, and ``elastic_sliding`` of those
    that slide, in m/N. Any of them may be "learned": parameters that are alike - all link translations, all link
    rotations, all joint offsets, the harmonics of one reading, all compliances - then share one standard deviation, the
    most likely one.

    Raises JobError for what is neither a standard deviation within its range nor "learned".
    """

    length: Prior | None = None
    angle: Prior | None = None
    harmonics: Prior | None = None
    elastic: Prior | None = None
    elastic_sliding: Prior | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        for name, key in _RANGES.items():
            value, what = getattr(self, name), f"prior {name.replace('_', ' ')}"
            if isinstance(value, str):
                if value != "learned":
                    raise JobError(f'{what}: {value!r} is neither a positive number nor "learned".')
            elif value is not None:
                if not value > 0.0:
                    raise JobError(f"{what}: {value!r} is not a positive number; leave it out for no prior.")
                refuse_beyond(value, key, what)

    @checked
    def of_term(self, term: JointTerm, dimension: Dimension) -> Prior | None:
        """Return the prior of the coefficient of a term, for a reading of this dimension."""
        name = kind_of(term).priors.get(dimension)
        prior: Prior | None = None if name is None else getattr(self, name)
        return prior


class Wider(NamedTuple):
    """The standard deviation of a wider weak prior, which all parameters of a ``group`` get together."""

    prior: float
    group: str


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown of the machine.

    ``name`` never changes between code, reports and files: ``joint_3.rx``, ``joint_2.offset``, ``base.z``, ``tool.x``.
    ``entries``: the entries of the state that it moves, and by how much each for one unit of the parameter.
    ``prior`` is the standard deviation of a prior about the nominal value, in ``unit``, or None; ``typical_size``
    is its scale where no prior is stated. Where a prior's width is learned, ``group`` names those that share it, and
    the prior is None until then. ``weak_prior``: the standard deviation of the weak prior that takes its place where
    there is none, about nominal, or about the start of what has no nominal value; wide enough to be negligible wherever
    the data determine the parameter. ``wider``: the one that it gets where the data clearly ask for a value
    farther off; joint terms get a scale that is as many times larger. ``centre``: about which value the prior is, where
    that is neither nominal nor the start.
    """

    name: str
    unit: str
    kind: ParameterKind
    entries: tuple[tuple[int, float], ...]
    prior: float | None = None
    typical_size: float = DEFAULT_SIGMA
    group: str | None = None
    weak_prior: float = math.inf
    wider: Wider | None = None
    centre: float | None = None

    @property
    def of_robot(self) -> bool:
        """Whether the parameter belongs to the robot itself rather than to a frame of the set-up."""
        return self.kind in ("offset", "placement", "term")

    @property
    def nuisance(self) -> bool:
        """Whether nobody knows it and it is of no use elsewhere: a target, or a number of an instrument."""
        return self.kind in ("target", "instrument")

    @property
    def is_stated(self) -> bool:
        """Whether its prior is stated, and not learned."""
        return self.prior is not None and self.group is None

    def widened(self, groups: Collection[str]) -> "Parameter":
        """Return the parameter with its wider weak prior, where it is of these groups."""
        if self.wider is None or self.wider.group not in groups:
            return self
        wider = self.wider.prior
        size = self.typical_size * (wider / self.weak_prior if self.kind == "term" else 1.0)
        return replace(self, weak_prior=wider, wider=None, typical_size=size)

    @property
    def scale(self) -> float:
        """The parameter scale, in ``unit``: the prior's standard deviation where one is stated."""
        return self.typical_size if self.prior is None or self.group is not None else self.prior

    @property
    def width(self) -> float:
        """How far from the centre of its prior it may be, as a standard deviation: stated, or weak.

        A tool point that poses do not show is held narrowly for the sake of the search alone, and may be as far as
        tools are.
        """
        own = self.weak_prior if self.prior is None else self.prior
        return max(own, TOOL) if self.kind == "tool" and self.wider is not None else own

    @property
    def hold(self) -> float:
        """How strongly the prior, stated or weak, holds: 1 over its standard deviation in units of the scale."""
        return self.scale / (self.weak_prior if self.prior is None else self.prior)


def asked_for(gain: float, left: float, count: int, freedom: float) -> bool:
    """Return whether rows ask for wider priors of ``count`` parameters, by F.

    ``gain``: by how much these lower the sum of squares of rows and priors, to what is ``left`` of it; ``freedom``:
    degrees of freedom of the noise.
    """
    return gain > 0.0 and bool(exceeded(gain * freedom / max(left, _NO_COST), count, freedom) < _SURELY)


def width(kind: ParameterKind, unit: str, reach: float = 0.0) -> float:
    """Return the standard deviation of the weak prior of a length or an angle; ``reach`` of the arm, in m."""
    if kind == "offset":
        return OFFSET_WIDTH
    if kind == "placement":
        return PLACEMENT_WIDTH
    return max(reach, TOOL) if kind == "tool" and unit == "m" else FRAME_WIDTH


def refuse_none_free(parameters: Sequence[Parameter]) -> None:
    """Raise JobError where no parameter is free."""
    if not parameters:
        raise JobError("no parameter is free: free joint offsets, placements, the base or the tool.")


def scales(parameters: Sequence[Parameter]) -> Array:
    """Return the scales (p,) of the parameters."""
    return np.array([parameter.scale for parameter in parameters])


class Entries(NamedTuple):
    """What parameters move: ``entry`` (n,) of the state by ``share`` (n,) of the ``parameter`` (n,), by number."""

    entry: IntArray
    parameter: IntArray
    share: Array

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> "Entries":
        """Return those of parameters."""
        found = [(entry, k, share) for k, own in enumerate(parameters) for entry, share in own.entries]
        entry, parameter, share = zip(*found, strict=True) if found else ((), (), ())
        return cls(
            np.array(entry, dtype=np.intp), np.array(parameter, dtype=np.intp), np.array(share, dtype=np.float64)
        )


def directions(parameters: Sequence[Parameter], size: int) -> Array:
    """Return the matrix (size, p) that maps parameter values to entries of a state of that size."""
    S = np.zeros((size, len(parameters)))
    entry, parameter, share = Entries.of(parameters)
    S[entry, parameter] = share
    return S
