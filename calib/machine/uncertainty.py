"""What is known of the uncertainty of a calibrated machine, and of its tool: plain data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.chance import bound
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.robot.terms import JointTerm

# The causes of doubt, as a budget lists them. The instrument: its noise and drift, as they reach the machine; unless it
# is stated, its noise cannot be told from the robot's, and counts as the model's. Parameters: what the data do not show
# of them, known by stated and by weak priors alone. The model: what it leaves out. The residual model: what that gets
# wrong.
CAUSES = ("instrument", "parameters", "model", "residual_model")


class Waves(NamedTuple):
    """Errors of the readings u that no parameter stands for: ``cos(2 pi k u / period)``, and sines, of orders 1 to K.

    ``period`` (nr,) in rad or m; ``width`` (nr, K): the sizes that their coefficients are multiples of, in rad or m.
    """

    period: Array
    width: Array

    @property
    def many(self) -> int:
        """How many waves there are: of every reading and order two."""
        return 2 * self.width.size

    def at(self, readings: Array, by_reading: Array) -> Array:
        """Return what every wave of its width does (N, d, many), from derivatives (N, d, nr) by the readings."""
        orders = np.arange(1, self.width.shape[1] + 1)
        phase = 2.0 * np.pi * (readings / self.period)[:, :, None] * orders
        waves = np.stack([np.cos(phase), np.sin(phase)], axis=3) * self.width[:, :, None]
        return (by_reading[:, :, :, None, None] * waves[:, None]).reshape(*by_reading.shape[:2], -1)


class WindUp(NamedTuple):
    """Wind-up of the readings under gravity that no parameter stands for: compliance times masses that nobody states.

    ``terms`` (k,): of kind "moment"; ``width`` (k,): the sizes that their coefficients are multiples of.
    """

    terms: tuple[JointTerm, ...]
    width: Array


class LeftOut(NamedTuple):
    """Errors of the readings that no parameter stands for: waves and wind-up.

    ``root`` (many, r): ``root @ root.T`` is the expected product of their coefficients, in widths, waves before
    wind-up: of all that the residuals say of them, their likeliest values as well, which nothing is corrected by.
    """

    waves: Waves
    wind_up: WindUp
    root: Array

    @property
    def columns(self) -> int:
        """How many columns the root has: r."""
        return int(self.root.shape[1])


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """Noise of one coordinate of a quantity, in m or rad: the model's part, and both parts together.

    The model's part is what it leaves out and looks random, beside :class:`LeftOut`; all of it where the instrument's
    is not stated. ``degrees_of_freedom`` of the estimate: infinite where nothing was estimated, as the instrument
    explains all.
    """

    model: float
    total: float
    degrees_of_freedom: float

    def of_rows(self, instrument: Array) -> Array:
        """Return the standard deviations of numbers, of which ``instrument`` has those that are stated, or 0."""
        return np.asarray(np.where(instrument > 0.0, np.hypot(instrument, self.model), self.total))


class OwnNoise(NamedTuple):
    """The noise of rows of one set-up and one tool: of lengths and of angles, None where none was measured."""

    setup: str
    tool: str
    position: NoiseLevel | None
    orientation: NoiseLevel | None


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Uncertainty:
    """How sure a calibrated machine is of itself; kept in the results' folder as ``uncertainty.json``.

    All is told in the state of the machine (:mod:`calib.identification.machine`), n numbers for the robot of the URDF,
    its base and its tools; angles of base and tools are small turns of where they are. ``factor`` (n, r): the
    covariance of the state is ``factor @ factor.T``; ``causes``: how many columns the first three of ``CAUSES`` have in
    it, in order. ``left_out``: errors of the readings that the model leaves out, whose columns are the last ones,
    as what they do to the state has to be set against what they do to the tool; None where that is not known.
    ``null_basis`` (n, k): changes of the state in the null space, each one parameter scale long. ``position`` and
    ``orientation``: the noise of lengths and of angles, None where none was measured. ``identified`` (nr, 2): least
    and greatest of every reading in the data. ``closure_determinant``: how near loops came to a dead centre there,
    where it is 0; None without loops, or where it is not known. ``own_noise``: of every pair of set-up and tool that
    was measured, where rows of one scatter more than those of the others, as under a load that nobody told.
    ``conditions``: least and greatest ``temperature``, in degC, and ``payload``, in kg, where terms follow them.
    """

    factor: Array
    causes: tuple[int, int, int]
    left_out: LeftOut | None
    null_basis: Array
    position: NoiseLevel | None
    orientation: NoiseLevel | None
    identified: Array
    closure_determinant: float | None = None
    own_noise: tuple[OwnNoise, ...] = ()
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @checked
    def noise(self, setup: str, tool: str) -> tuple[NoiseLevel | None, NoiseLevel | None]:
        """Return the noise of lengths and of angles in a set-up with a tool.

        Where the two were not measured together, the largest of what was measured with one of them.
        """
        alike = [one for one in self.own_noise if one.setup == setup or one.tool == tool]
        own = [one for one in alike if one.setup == setup and one.tool == tool] or alike
        return (
            _largest([one.position for one in own] or [self.position]),
            _largest([one.orientation for one in own] or [self.orientation]),
        )

    @property
    def shown(self) -> Array:
        """The columns of the factor (n, k) but those of parameters that the data do not show."""
        instrument, parameters, _ = self.causes
        return np.hstack([self.factor[:, :instrument], self.factor[:, instrument + parameters :]])

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the covariance: the fewest of what it was estimated from."""
        return _fewest((self.position, self.orientation))

    @checked
    def freedom(self, setup: str, tool: str) -> float:
        """Return the degrees of freedom of the covariance in a set-up with a tool, whose noise may be of few rows."""
        return min(self.degrees_of_freedom, _fewest(self.noise(setup, tool)))

    def __repr__(self) -> str:
        return (
            f"<Uncertainty of {len(self.factor)} numbers, {self.null_basis.shape[1]} directions not determined, "
            f"{self.degrees_of_freedom:.4g} degrees of freedom>"
        )


class _Known:
    """What is told of the null space at N configurations."""

    __slots__ = ()
    null_space_rms: Array
    budget: Mapping[str, Array]

    @property
    def known(self) -> BoolArray:
        """Whether (N, 2) position and orientation are known: the null space adds less than what was measured leaves."""
        measured = sum(sigmas**2 for cause, sigmas in self.budget.items() if cause != "parameters")
        return np.asarray(self.null_space_rms <= np.sqrt(measured))

    def known_shares(self) -> dict[str, float]:
        """Return at which share of the poses the position is known, and the orientation."""
        return {name: float(np.mean(self.known[:, k])) for k, name in enumerate(("position", "orientation"))}


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class ToolUncertainty(_Known):
    """How sure the tool's pose is at N configurations.

    ``covariance`` (N, 6, 6): of the position, in the axes of the instrument (of the base, where the base is left out),
    and of small turns about the tool's axes, in m and rad. ``null_space_rms`` (N, 2): rms of what one parameter scale
    along every direction of the null space would add to the position, in m, and to the orientation, in rad. ``budget``:
    of every one of ``CAUSES`` the standard deviations (N, 2) of position and orientation, whose squares add up.
    ``degrees_of_freedom``: as :meth:`Uncertainty.freedom` has them.
    """

    covariance: Array
    null_space_rms: Array
    budget: Mapping[str, Array]
    degrees_of_freedom: float

    @property
    def position(self) -> Array:
        """Standard deviations (N,) of the position, all three coordinates together, in m."""
        return _root_trace(self.covariance[:, :3, :3])

    @property
    def orientation(self) -> Array:
        """Standard deviations (N,) of the orientation, all three turns together, in rad."""
        return _root_trace(self.covariance[:, 3:, 3:])

    @checked
    def inside(self, errors: Array, probability: float = 0.95) -> BoolArray:
        """Return which position errors (N, 3) are inside the region (an ellipsoid) of the given probability.

        With estimated noise the bound follows F(3, degrees of freedom), else chi-square.
        """
        distance = np.einsum(
            "ni,ni->n", errors, np.linalg.solve(self.covariance[:, :3, :3], errors[:, :, None])[..., 0]
        )
        return np.asarray(distance <= bound(probability, 3, self.degrees_of_freedom))

    def __repr__(self) -> str:
        known = f"position {np.median(self.position) / MM:.4g} mm" if len(self.covariance) else "nothing"
        return f"<ToolUncertainty at {len(self.covariance)} configurations: {known} (median)>"


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class UncertaintyMap(_Known):
    """Standard deviations over the workspace, at N random configurations.

    ``readings`` (N, nr); ``positions`` (N, 3) of the tool in the base, in m; ``sigmas`` (N, 2) of position and
    orientation in m and rad; ``null_space_rms`` (N, 2) and ``budget`` as in :class:`ToolUncertainty`.
    """

    readings: Array
    positions: Array
    sigmas: Array
    null_space_rms: Array
    budget: Mapping[str, Array]

    def percentiles(self) -> dict[str, list[float]]:
        """Return percentiles of the standard deviations of position and orientation, in m and rad."""
        return {str(p): np.percentile(self.sigmas, p, axis=0).tolist() for p in (5, 50, 95, 100)}

    def __repr__(self) -> str:
        return f"<UncertaintyMap at {len(self.readings)} configurations>"


def rms_by_cause(budget: Mapping[str, Array]) -> dict[str, list[float]]:
    """Return the rms over the poses of what every cause of a budget adds to position and orientation, in m and rad."""
    return {cause: np.sqrt(np.mean(sigmas**2, axis=0)).tolist() for cause, sigmas in budget.items()}


def _largest(levels: Sequence[NoiseLevel | None]) -> NoiseLevel | None:
    return max((level for level in levels if level is not None), key=lambda level: level.total, default=None)


def _fewest(levels: Sequence[NoiseLevel | None]) -> float:
    return min((level.degrees_of_freedom for level in levels if level is not None), default=float("inf"))


def _root_trace(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))
