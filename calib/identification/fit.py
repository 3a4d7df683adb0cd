"""The result of an identification, with its own doubts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import JobError
from calib.foundations.linear import ROUNDING, svd
from calib.foundations.sealing import sealed
from calib.foundations.showing import shower
from calib.foundations.words import listed, near, noun, shown
from calib.identification.arrow import Covariance
from calib.identification.earlier import Earlier, Errors
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import NullDirection, Spectrum
from calib.identification.learned import LearnedPrior
from calib.identification.losses import Loss
from calib.identification.machine import Machine
from calib.identification.memory import Memory
from calib.identification.noise import Noise
from calib.identification.not_seen import AlongNullSpace
from calib.identification.parameters import Parameter, scales
from calib.identification.repeats import Repeats
from calib.identification.together import Together, variances_of
from calib.measurement.measurements import Measurements, reach_of
from calib.robot.robot import Deviations, Robot

# Of more parameters a matrix tells nobody anything.
_MOST_CORRELATED = 500

NullSpacePolicy = Literal["nearest", "minimal", "refuse"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
@sealed
class Fit:
    """Identified parameters and what is known about them. Made by :func:`calib.identify`; printed as a table.

    ``values`` (p,) and :attr:`covariance` (p, p) in SI units of ``parameters``; ``spread``: that by parts. In the null
    space, the values are a choice among equal fits (``policy``), the covariance is that of the chosen frame, and
    :attr:`sigmas` are nan.
    ``rank``: the formal rank, of all parameter combinations that the data determine, priors left out;
    ``numerical_rank``: of those, the ones known to ten parameter scales or better. ``spectrum``: its
    :attr:`singular_values`; ``null_space``: what lies beyond the numerical rank. ``held``: parameters that policy
    "minimal" kept at their nominal values. ``null_basis`` (p, k): a basis of the null space of these other parameters,
    orthonormal in their scales, with the targets that follow, priors counted as data. ``along_null_space``: how far the
    truth may be from the values along it.
    ``mirrored`` (p,): which of the unidentifiable ones two places explain alike, as of frames that lengths tell;
    ``alike``: the machine on the other side of these lengths' plane, where it explains them as well.
    ``machine``: the calibrated machine; ``nominal``: the nominal robot with base and tool fitted, the fair "before".
    ``residuals`` and ``nominal_residuals``: measured minus predicted (N, 3 or 6) of every set, in m and rad.
    ``noise``: of one row; where rows of a pose err together, poses are counted. ``noise_by_rows``: by which rows were
    weighed, as if all of them erred alone.
    ``losses``: of every set. ``learned``: the learned priors, which the parameters also have as their own.
    ``step``: the last step, in parameter scales; ``evaluations``: how often residuals and Jacobian were computed.
    ``narrowed``: by which factor the weak priors were narrower than usual; 1 if the search did not need it.
    ``memories`` and ``repeats``: how rows with times, and rows of one pose, err together, which the covariance
    includes; ``covariance_alone`` (p, p): what it would be if all rows erred independently. ``together``: of every set,
    how rows of a photograph err together, by which they are weighed; empty where none do.
    ``earlier``: what the errors of an earlier fit do that began this one, if what that has found is held here.
    ``spent``: degrees of freedom of every component that a choice of the model by the same rows has spent.
    ``off`` (p,): by how much values that were found in another way are off the least-squares solution, in SI units; the
    covariance includes it.
    """

    model: ErrorModel
    measurements: tuple[Measurements, ...]
    parameters: tuple[Parameter, ...]
    values: Array
    spread: Covariance
    spread_alone: Covariance
    rank: int
    numerical_rank: int
    spectrum: Spectrum
    null_space: tuple[NullDirection, ...]
    unidentifiable: BoolArray
    null_basis: Array
    along_null_space: AlongNullSpace
    mirrored: BoolArray
    policy: NullSpacePolicy
    held: tuple[Parameter, ...]
    noise: tuple[Noise, ...]
    noise_by_rows: tuple[Noise, ...]
    losses: tuple[Loss, ...]
    machine: Machine
    nominal: Machine
    residuals: tuple[Array, ...]
    nominal_residuals: tuple[Array, ...]
    evaluations: int
    step: float
    converged: bool
    learned: tuple[LearnedPrior, ...] = ()
    narrowed: float = 1.0
    memories: tuple[Memory, ...] = ()
    repeats: tuple[Repeats, ...] = ()
    together: tuple[Together | None, ...] = ()
    spent: tuple[float, ...] = ()
    off: Array | None = None
    earlier: Earlier | None = None
    alike: Machine | None = None

    @property
    def singular_values(self) -> Array:
        """Singular values (p,), descending, of the whitened, scaled Jacobian.

        Of what every target's own rows say of it, and of all other parameters, with targets where they follow best.
        """
        return self.spectrum.values

    @property
    def variances(self) -> list[float]:
        """Of every component, the variance of a row by itself beyond the instrument's, in m^2, rad^2 or px^2."""
        return variances_of(
            [noise.model for noise in self.noise_by_rows],
            [noise.measurements for noise in self.noise_by_rows],
            self.together,
        )

    @property
    def robot(self) -> Robot:
        """The robot in the frames of its URDF; with :attr:`deviations` it is the calibrated one."""
        return self.model.urdf_robot

    @property
    def reach(self) -> float:
        """Upper bound in m of how far the tip was from the base in what was measured."""
        return reach_of(self.model.robot, self.measurements)

    @property
    def deviations(self) -> Deviations:
        """Deviations of :attr:`robot`. Those of ``machine`` may be in other frames, where DH parameters are named."""
        return self.model.urdf_deviations(self.machine.deviations)

    @property
    def covariance(self) -> Array:
        """The covariance (p, p) in SI units; of many targets that is large, and ``spread`` tells any part of it."""
        return self.spread.of()

    @property
    def covariance_alone(self) -> Array:
        """What the covariance (p, p) would be if rows with times, and rows of one pose, erred alone."""
        return self.spread_alone.of()

    @property
    def sigmas(self) -> Array:
        """Standard deviations (p,) in SI units; nan for what no data and no prior determine."""
        moved = self._beside_noise
        variances = np.maximum(self.spread.variances, 0.0) + np.sum(moved**2, axis=1)
        return np.where(self.unidentifiable, np.nan, np.sqrt(variances))

    @property
    def by_null_space(self) -> Array:
        """A factor (p, k), in SI units, of what identifiable parameters may be off by along the null space.

        No direction of it moves them much; but along some, as a tool's height that is not seen, the truth is far.
        """
        return np.where(self.unidentifiable[:, None], 0.0, self.along_null_space.factor)

    @property
    def by_earlier(self) -> Array:
        """A factor (p, r), in SI units, of what parameters may be off by as what is held of an earlier fit is."""
        p = len(self.parameters)
        return np.zeros((p, 0)) if self.earlier is None else np.hstack(self.earlier.errors[:2])[:p]

    @property
    def _beside_noise(self) -> Array:
        return np.hstack([self.by_null_space, self.by_earlier])

    @property
    def correlated(self) -> IntArray:
        """Those of :attr:`told_together` that are identifiable."""
        own = self.told_together
        return own[~self.unidentifiable[own] & (self.spread.variances[own] > 0.0)]

    @property
    def told_together(self) -> IntArray:
        """The parameters whose covariances are told, by number: all, or of very many as many kinds as are not too many.

        Targets are left out first, then set-ups and tools.
        """
        own = list(range(len(self.parameters)))
        for kinds in (("target",), ("target", "base", "tool")):
            if len(own) > _MOST_CORRELATED:
                own = [k for k, parameter in enumerate(self.parameters) if parameter.kind not in kinds]
        return np.array(own, dtype=np.intp)

    @property
    def weakly_determined(self) -> BoolArray:
        """Parameters (p,) that are determined, but not better than half their parameter scale."""
        return np.asarray(self.sigmas > 0.5 * scales(self.parameters))

    @checked
    def told_covariance(self, parameters: IntArray) -> Array:
        """Return the covariance (k, k) of some parameters, by number (k,), as :attr:`sigmas` tell it.

        Of parameters that are not identifiable it is that of the chosen frame. Raises JobError for other numbers.
        """
        count = len(self.parameters)
        if parameters.ndim != 1 or np.any((parameters < -count) | (parameters >= count)):
            raise JobError(f"told_covariance: parameters is no array of numbers from 0 to {count - 1}.")
        moved = self._beside_noise[parameters]
        return np.asarray(self.spread.of(parameters) + moved @ moved.T)

    @checked
    def errors_of(self, names: Sequence[str]) -> Errors:
        """Return the errors of parameters that are free here or held from earlier; zeros of those that are neither."""
        number = {parameter.name: k for k, parameter in enumerate(self.parameters)}
        units, noise = scales(self.parameters), np.zeros((len(self.parameters), 0))
        if own := [k for k, parameter in enumerate(self.parameters) if not parameter.nuisance]:
            U, s, _ = svd(self.spread.of(own))
            moved, N = U * np.sqrt(s) / units[own, None], self.null_basis[own]
            # The covariance is that of a free network. Values are where weak priors hold them along the null space.
            hold = np.array([self.parameters[k].hold for k in own])[:, None]
            moved = moved - N @ np.linalg.lstsq(hold * N, hold * moved, rcond=ROUNDING)[0]
            noise = np.zeros((len(self.parameters), len(own)))
            noise[own] = units[own, None] * moved
        null_basis = units[:, None] * self.null_basis
        found = Errors(noise, self.along_null_space.factor, null_basis).of([number.get(name, -1) for name in names])
        return found if self.earlier is None else found.beside(self.earlier.of(names))

    @checked
    def tools_of(self, data: Measurements) -> Array:
        """Return the poses (N, 4, 4) of the tools of rows in the tip link: the tip's own where one is not known.

        They are at the rows' points where a table says these.
        """
        return data.placed_by(_by_name(self.measurements[0].tools, self.machine.frames.tools, data.tools, np.eye(4)))

    @checked
    def bases_of(self, data: Measurements) -> Array:
        """Return the poses (N, 4, 4) of the base in the set-ups of rows: the first one where one is not known."""
        bases = self.machine.frames.bases
        return _by_name(self.measurements[0].setups, bases, data.setups, bases[0])[data.setup]

    @checked
    def places_of(self, data: Measurements) -> Array:
        """Return the measured points (N, 3) as the first set-up would see them: those of set-ups have no one frame."""
        assert data.position is not None, "positions and poses have one"
        moved = self.machine.frames.bases[0] @ rigid.inverse(self.bases_of(data))
        return np.asarray((moved[:, :3, :3] @ data.position[:, :, None])[..., 0] + moved[:, :3, 3])

    @checked
    def tips_before_targets(self, data: Measurements) -> Array:
        """Return the tips (N, 4, 4) of rows in the frame in which their targets are told: a link's, where one is."""
        tips = self.bases_of(data) @ data.tips(self.robot, self.deviations)
        for link in dict.fromkeys(data.target_links.values()):
            rows = np.array([data.link_of(int(t)) == link for t in data.target])
            seat = self.robot.with_tip(link).tips(data.readings[rows], self.deviations, data.conditions.subset(rows))
            tips[rows] = rigid.inverse(self.bases_of(data)[rows] @ seat) @ tips[rows]
        return tips

    @property
    def tool_tips(self) -> dict[str, str]:
        """The links that carry tools, by the tools' names, of those that are not on the robot's tip."""
        tips = {data.tools[k]: data.tip for data in self.measurements for k in np.unique(data.tool)}
        return {tool: tip for tool, tip in tips.items() if tip not in ("", self.robot.tip)}

    @checked
    def knows(self, data: Measurements) -> bool:
        """Return whether the rows are of tools and set-ups that the fit knows."""
        own = self.measurements[0]
        return set(data.tools) <= set(own.tools) and set(data.setups) <= set(own.setups)

    @checked
    def value(self, name: str) -> float:
        """Return the value of a parameter in SI units. Raises JobError for a name that no parameter of the fit has."""
        names = [parameter.name for parameter in self.parameters]
        if name not in names:
            like = near(name, names) or names
            raise JobError(
                f"the fit has no parameter {shown(name)}; there {noun(len(like), 'is', 'are')} {listed(like)}."
            )
        return float(self.values[names.index(name)])

    def records(self) -> list[dict[str, object]]:
        """Return a plain record for every parameter: name, value, unit, sigma (None where not identifiable), flags."""
        return [
            {
                "name": parameter.name,
                "value": float(value),
                "unit": parameter.unit,
                "sigma": None if unidentifiable else float(sigma),
                "prior": parameter.prior,
                "identifiable": not unidentifiable,
                "weakly_determined": bool(weak),
            }
            for parameter, value, sigma, unidentifiable, weak in zip(
                self.parameters, self.values, self.sigmas, self.unidentifiable, self.weakly_determined, strict=True
            )
        ]

    def __str__(self) -> str:
        return str(shower().table(self))

    def _repr_html_(self) -> str:
        return str(shower().html(self))

    def __repr__(self) -> str:
        rows = sum(len(data) for data in self.measurements)
        size = len(self.null_space)
        said = {0: "no null space", 1: "null space of 1 direction"}.get(size, f"null space of {size} directions")
        return f"<Fit of {len(self.parameters)} parameters to {rows} rows: formal rank {self.rank}, {said}>"


def _by_name(known: Sequence[str], poses: Array, names: Sequence[str], other: Array) -> Array:
    """Return the poses (k, 4, 4) of names, ``other`` (4, 4) for those that are not known."""
    by_name = dict(zip(known, poses, strict=True))
    return np.stack([by_name.get(name, other) for name in names])
