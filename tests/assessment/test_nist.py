"""NIST's nonlinear regressions with certified values, through the solver, the noise and the intervals of a calibration.

Values, standard errors and residual sigmas of the 27 datasets were computed by NIST in 500-bit arithmetic. A curve is
posed as a robot is: a problem of residuals and a triangle ``[J r]``, its noise not known beforehand.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.foundations.chance import bound
from calib.foundations.errors import PoseError
from calib.identification.arrow import Split
from calib.identification.parameters import Parameter
from calib.identification.solver import Solution, solve
from calib.identification.system import Component, Evaluation

DATA = json.loads((Path(__file__).parent / "nist" / "strd.json").read_text(encoding="utf-8"))
# Starts are off by more than themselves: the parameter scale is taken to be ten times as large.
TIMES = 10.0


def quotient(over: int) -> Callable[[Array, Array], Array]:
    """A polynomial over another whose constant is one."""

    def curve(b: Array, x: Array) -> Array:
        powers = [x**k for k in range(max(over, len(b) - over) + 1)]
        above = sum(v * p for v, p in zip(b[:over], powers, strict=False))
        return above / (1 + sum(v * p for v, p in zip(b[over:], powers[1:], strict=False)))

    return curve


def saturation(b: Array, x: Array) -> Array:
    return b[0] * (1 - np.exp(-b[1] * x))


def decay(b: Array, x: Array) -> Array:
    return np.exp(-b[0] * x) / (b[1] + b[2] * x)


def two_peaks(b: Array, x: Array) -> Array:
    peaks = b[2] * np.exp(-(((x - b[3]) / b[4]) ** 2)) + b[5] * np.exp(-(((x - b[6]) / b[7]) ** 2))
    return b[0] * np.exp(-b[1] * x) + peaks


def three_decays(b: Array, x: Array) -> Array:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def cycles(b: Array, x: Array) -> Array:
    found = b[0] + b[1] * np.cos(2 * np.pi * x / 12) + b[2] * np.sin(2 * np.pi * x / 12)
    for k in (3, 6):
        found = found + b[k + 1] * np.cos(2 * np.pi * x / b[k]) + b[k + 2] * np.sin(2 * np.pi * x / b[k])
    return found


CURVES: dict[str, Callable[..., Array]] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": saturation,
    "Chwirut1": decay,
    "Chwirut2": decay,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": cycles,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": two_peaks,
    "Gauss2": two_peaks,
    "Gauss3": two_peaks,
    "Hahn1": quotient(4),
    "Kirby2": quotient(3),
    "Lanczos1": three_decays,
    "Lanczos2": three_decays,
    "Lanczos3": three_decays,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": saturation,
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x, x2: b[0] - b[1] * x * np.exp(-b[2] * x2),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": quotient(4),
}


@dataclass(frozen=True)
class Rows:
    """Measured numbers (N, 1) whose noise nobody stated."""

    sigma: Array


class Curve:
    """A curve through points, posed as the solver asks for it."""

    components = (Component(0, "position", slice(0, 1)),)
    losses = ("linear",)
    spent = (0.0,)
    robust = False

    def __init__(self, name: str, start: Sequence[float]) -> None:
        self._curve, self._x = CURVES[name], [np.array(column) for column in DATA[name]["x"]]
        y = np.array(DATA[name]["y"])
        self._y = np.log(y) if name == "Nelson" else y
        self.measurements = (Rows(np.zeros((len(y), 1))),)
        self.parameters = tuple(
            Parameter(f"b{k + 1}", "1", "base", ((k, 1.0),), typical_size=TIMES * abs(v)) for k, v in enumerate(start)
        )

    def residuals(self, b: Array) -> tuple[Array, ...]:
        return ((self._y - self._curve(b, *self._x))[:, None],)

    def jacobian(self, b: Array) -> Array:
        """Derivatives (N, p) of the residuals by complex steps, exact to rounding."""
        steps = 1e-30 * np.abs(b)
        return -np.column_stack([self._curve(b + 1j * h, *self._x).imag / h.sum() for h in np.diag(steps)])

    @property
    def targets_apart(self) -> Split:
        return Split.none(len(self.parameters))

    def evaluate(self, sigmas: Sequence[Array], b: Array) -> Evaluation:
        J = self.jacobian(b) * [parameter.scale for parameter in self.parameters]
        (r,) = self.residuals(b)
        triangle = linear.triangle(np.hstack([J, r]) / sigmas[0])
        p = len(b)
        return Evaluation((r,), (triangle,), np.zeros((0, p + 1)))


def solved(name: str, start: int) -> Solution:
    begin = DATA[name]["starts"][start]
    return solve(Curve(name, begin), np.array(begin))


def digits(found: Array | float, certified: Array | float) -> float:
    """The fewest digits that agree, as NIST counts them: minus the logarithm of the relative error."""
    error = np.abs(np.asarray(found) - certified) / np.abs(certified)
    return float(np.min(-np.log10(np.maximum(error, 1e-11))))


@pytest.mark.parametrize("name", CURVES)
def test_values_sigmas_and_intervals_are_those_that_nist_certifies(name: str) -> None:
    certified, found = DATA[name], solved(name, start=1)
    sigmas = np.sqrt(np.diag(found.covariance))
    freedom = len(certified["y"]) - len(found.x)
    # Residuals of Lanczos1 are 1e-13 of a curve of 2.5: rounding leaves two digits of them, and so of the errors.
    least = 1.0 if name == "Lanczos1" else 4.0
    assert found.converged
    assert found.directions.numerical_rank == len(found.x)
    assert digits(found.x, np.array(certified["values"])) > 5.0
    assert found.redundancies[0] == pytest.approx(freedom, abs=1e-6)
    assert digits(np.sqrt(found.variances[0]), certified["residual_sigma"]) > least
    assert digits(sigmas, np.array(certified["sigmas"])) > least
    # Half the width of the interval of 95 %: Student's t of the degrees of freedom that the fit itself found.
    half = np.sqrt(bound(0.95, 1, found.redundancies[0])) * sigmas
    assert digits(half, stats.t.ppf(0.975, freedom) * np.array(certified["sigmas"])) > least


class Walled(Curve):
    """A curve that cannot be far from where it is right, as a loop that does not close there; counts the trials."""

    def __init__(self, name: str, start: Sequence[float], share: float) -> None:
        super().__init__(name, start)
        right = np.array(DATA[name]["values"])
        self._middle, self._most = right, share * np.abs(np.array(start) - right)
        self.refused = 0

    @property
    def targets_apart(self) -> Split:
        return Split.none(len(self.parameters))

    def evaluate(self, sigmas: Sequence[Array], b: Array) -> Evaluation:
        if np.any(np.abs(b - self._middle) > self._most):
            self.refused += 1
            raise PoseError(0, "a loop does not close")
        return super().evaluate(sigmas, b)


@pytest.mark.parametrize("name", ["Gauss1", "Misra1a", "Rat42", "Thurber"])
def test_steps_to_where_nothing_can_be_are_not_taken(name: str) -> None:
    begin = DATA[name]["starts"][0]
    problem = Walled(name, begin, 1.5)
    found = solve(problem, np.array(begin))
    assert problem.refused > 0
    assert found.converged
    assert digits(found.x, np.array(DATA[name]["values"])) > 5.0
