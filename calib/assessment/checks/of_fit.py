"""Checks of the fit itself: whether it ended, and what it leaves beside the stated noise."""

from collections.abc import Sequence

import numpy as np

from calib.assessment.judged import NOTHING, Check
from calib.foundations.chance import bound
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit
from calib.identification.noise import Noise
from calib.identification.observability import Observability
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.measurement.measurements import Measurements
from calib.measurement.poses import same_pose

# Degrees of freedom with which a scatter is told from a sigma.
ENOUGH = 10.0
FREEDOM = 10.0
# A scatter of a nanometre is rounding, of data without noise.
ROUNDING = 1e-9
# Times a stated sigma, or a share of the reach, that the residuals may scatter.
SIGMA, OF_REACH = 30.0, 5e-4
# A sigma is said to be too large from this factor.
TOO_LARGE = 3.0


def convergence(fit: Fit) -> Check:
    """Whether the search for the least squares ended."""
    said = (
        "The solver converged."
        if fit.converged
        else f"The solver did not converge: its last step was {fit.step:.2g} parameter scales."
    )
    return Check.of("convergence", fit.step, NOTHING, fit.converged, said)


def redundancy(fit: Fit, doubt: str = "") -> Check:
    """Whether more was measured than was sought. What is measured at one pose again tells of the noise alone.

    ``doubt``: of bases and tools that the rows do not tell, though they are many.
    """
    numbers = sum(r.size for r in fit.residuals)
    again = _numbers_again(fit.model, fit.measurements)
    free = sum(noise.degrees_of_freedom for noise in fit.noise_by_rows) - again
    said = f"{numbers} numbers were measured, {f'{again} of them at the same poses again, ' if again else ''}"
    said += f"and {max(free, 0.0):.0f} degrees of freedom are left to judge the fit"
    if free >= FREEDOM and doubt:
        return Check.of("redundancy", free, FREEDOM, False, doubt, least=True)
    return Check.judged("redundancy", free, FREEDOM, said, f"; at least {FREEDOM:g} are needed.", least=True)


def too_few(seen: Observability, model: ErrorModel, measurements: Sequence[Measurements]) -> str:
    """Return what :func:`redundancy` will say of such measurements where it cannot pass; empty where it may.

    Stated priors and known relations judge a fit as well, and are not counted: of these nothing is said.
    """
    if any(parameter.is_stated for parameter in seen.parameters) or model.relations:
        return ""
    numbers = seen.numbers - _numbers_again(model, measurements)
    left = numbers - seen.rank
    if left >= FREEDOM:
        return ""
    rest = f"{max(left, 0)} are left to judge a fit by, which is trusted from {FREEDOM:g} on"
    if seen.numbers <= seen.rank:
        rest = "none is left to judge a fit by: it is refused"
    return (
        f"{numbers} measured numbers of different poses determine {seen.rank} combinations of parameters, and {rest}. "
        "Measure more poses, or free fewer parameters."
    )


def _numbers_again(model: ErrorModel, measurements: Sequence[Measurements]) -> int:
    """Return how many numbers are of rows as :func:`told_before` counts them."""
    under_conditions = bool(model.robot.terms)
    return sum(data.sigma.shape[1] * told_before(data, under_conditions=under_conditions) for data in measurements)


def told_before(data: Measurements, *, under_conditions: bool) -> int:
    """Return how many rows are of a pose, and of the same thing measured there, that another row tells of already.

    ``under_conditions``: what joint terms depend on is a pose of its own. Rows in motion are not compared.
    """
    if data.stream is not None or not len(data):
        return 0
    others = [] if data.points is None else [data.points]
    if data.kind == "pixels":
        others.append(data.value[:, 2:])
    for end in data.ends if under_conditions else ():
        own = end.conditions
        states = (own.approach, own.temperature, own.torque, own.payload, own.gravity)
        others += [np.nan_to_num(state.reshape(len(data), -1)) for state in states if state is not None]
    return len(data) - 1 - int(same_pose(data, others, pieces=True).max())


def stated_sigma(fit: Fit) -> Check:
    """Whether what remains is near the instrument's noise, where that is stated."""
    worst, limit, said = NOTHING, SIGMA, "There is no stated sigma to compare the residuals with."
    for noise in fit.noise:
        if not noise.degrees_of_freedom >= ENOUGH or not noise.chi_square >= 0.0:
            continue
        times = noise.total / noise.instrument if noise.model > 0.0 else _scatter(fit, noise)
        allowed = max(SIGMA, small_sigma(fit, UNIT_OF[noise.quantity]) / noise.instrument)
        if not worst / limit >= times / allowed:
            worst, limit = times, allowed
            said = f"The {noise.quantity} residuals scatter {times:.2g} times as much as the stated sigma"
            if times > allowed and noise.quantity == "pixels" and not any(p.of_robot for p in fit.parameters):
                said += (
                    ": the arm is taken as it is stated, and corners of photographs are found so well that its own "
                    "errors show; where its joints and a URDF are known, they tell more."
                )
            elif times > allowed:
                said += ": the sigma is far too small, or an effect is missing from the model."
            else:
                said += "; the sigma seems too large." if times < 1.0 / TOO_LARGE else "."
    return Check.of("stated sigma", worst, limit, not worst > limit, said)


def _scatter(fit: Fit, noise: Noise) -> float:
    """Return how many times their stated sigma residuals scatter; of a robust loss, which passes over some, most rows.

    What the model leaves out has no part in either.
    """
    if fit.losses[noise.measurements] == "linear":
        return float(np.sqrt(noise.chi_square))
    data, residuals = fit.measurements[noise.measurements], fit.residuals[noise.measurements]
    own = next(one.columns for one in QUANTITIES[data.kind] if one.name == noise.quantity)
    squares = np.sum((residuals[:, own] / data.sigma[:, own]) ** 2, axis=1)
    return float(np.sqrt(np.median(squares) / bound(0.5, own.stop - own.start)))


def small_sigma(fit: Fit, unit: str) -> float:
    """Return a standard deviation that is small for an arm of its reach, in the unit."""
    if unit == "px":
        # As an angle is seen: the sigma of a sharp corner is far below what any arm repeats.
        return OF_REACH * max(
            (data.camera.lens.fx for data in fit.measurements if data.camera is not None), default=0.0
        )
    return OF_REACH * (fit.reach if unit == "m" else 1.0)
