"""Stated priors that the data contradict, and whether they hold the result back.

Were a prior right, what a fit finds under it, x, would have the covariance S - C: that of the prior less that of the
fit. So its sum of squares in those directions in which the data say something is a chi-square. Where data determine a
parameter, a prior that is too narrow does little harm. So it is made as wide as the data say, S f^2 for all its
parameters g, and counts where this moves what is predicted: by C_g (S / (1 - f^-2) - C_gg)^-1 x_g, as where the fit is
linear. Else it is only told, for how parameters share what the data do not tell apart is as sure as the prior.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np

from calib.assessment.checks.of_arm import is_stated_scale
from calib.assessment.stretches import Stretch
from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.foundations.units import DEG, MM
from calib.identification.fit import Fit
from calib.identification.machine import Layout
from calib.identification.parameters import Parameter, scales
from calib.measurement.checks import Finding

# Standard deviations of a stated prior by which what is found may be off. A scale is that of a board's print, which is
# stated to half a percent and mostly right to two tenths.
_OFF = 4.0
# Shares of a prior's variance that data have made smaller: below, they say next to nothing.
_SAID = 0.1
# Priors are stated roughly, and what a model leaves out is in the parameters, too.
_SURELY, _FARTHER = 1e-6, 1.5
# Standard deviations of what is predicted at the poses of the fit. With less, nine of ten regions hold the truth.
_PULL = 0.3
_CODE, HARMLESS = "prior-contradicted", "prior-too-narrow"
_OR_LEARNED = ', or write "learned"'
_MUCH = "; what the data do not tell is less certain than regions say."
_LITTLE = "; predictions hardly depend on it, but the values of single parameters do."


class _Wrong(NamedTuple):
    """``what`` has a wrong prior, by whose standard deviation its parameters are ``off``, and a sentence.

    ``pull``: by how many of their standard deviations predictions move without it.
    """

    what: str
    off: float
    pull: float
    sentence: str


def contradicted(fit: Fit, parts: Sequence[Stretch]) -> list[Finding]:
    """Return sentences for scales of boards and numbers of lenses far from what is stated, and of too narrow priors.

    ``parts``: its rows, where it ended. Learned priors are as wide as the data say.
    """
    found = [
        Finding.warning(_CODE, sentence)
        for parameter, value, sigma in zip(fit.parameters, fit.values, fit.sigmas, strict=True)
        if (sentence := _of_camera(parameter, float(value), float(sigma)))
    ]
    among = set(parts[0].columns.tolist()) if parts else set()
    judged = [_judged(fit, np.array(which), what, parts) for which, what in _stated_together(fit, among)]
    wrong = sorted((one for one in judged if one is not None), key=lambda one: -one.off)
    if not wrong:
        return found
    # What one wrong prior holds back is taken up by others, too: that of the parameter that is farthest off is first.
    also = " and ".join(one.what for one in wrong[1:])
    more = f" The same seems true of {also}, perhaps by that alone." if also else ""
    harms = max(one.pull for one in wrong) >= _PULL
    said = _MUCH if harms else _LITTLE
    return [*found, Finding.warning(_CODE if harms else HARMLESS, wrong[0].sentence + said + more)]


def _of_camera(parameter: Parameter, value: float, sigma: float) -> str | None:
    """Return what is to be said of a number of a board or a lens that is far from what is stated; None of others."""
    off, prior = value - (parameter.centre or 0.0), parameter.prior
    of_lens = parameter.kind == "instrument" and parameter.name.startswith("lens.")
    if prior is None or not (of_lens or is_stated_scale(parameter)) or abs(off) <= _OFF * prior:
        return None
    # What other numbers of camera and board can take the place of has no sigma.
    if of_lens:
        unit = f" {parameter.unit}" if parameter.unit == "px" else ""
        sure = "" if np.isnan(sigma) else f" +- {sigma:.2g}"
        so, right, remedy = f"{off:+.2g}{sure}{unit}", f"{prior:.2g}{unit}", "Leave out its lens_sigma"
    else:
        sure = "" if np.isnan(sigma) else f" +- {100.0 * sigma:.2g}"
        so, right = f"{100.0 * off:+.2g}{sure} %", f"{100.0 * prior:.2g} %"
        remedy = "Measure the squares of the board again"
    return (
        f"{parameter.name} is found {so} from what is stated, which is said to be right to {right}, and is held back "
        f"by that. {remedy}."
    )


def _stated_together(fit: Fit, among: AbstractSet[int]) -> Iterator[tuple[list[int], str]]:
    """Yield the numbers of the parameters of which something is stated alike, and what they are; only ``among`` these.

    Of very many set-ups some are looked at.
    """
    alike = defaultdict[tuple[str, str, float | None], list[int]](list)
    for k, parameter in enumerate(fit.parameters):
        if not parameter.is_stated or parameter.nuisance or k not in among:
            continue
        base = "the base" if parameter.name.count(".") == 1 else parameter.name.rpartition(".")[0]
        of = {"base": base, "term": "joint terms"}.get(parameter.kind, "the arm")
        alike[of, parameter.unit, parameter.prior].append(k)
    for (of, unit, _), which in alike.items():
        yield which, {"m": f"lengths of {of}", "rad": f"angles of {of}"}.get(unit, f"{of} in {unit}")


def _judged(fit: Fit, which: IntArray, what: str, parts: Sequence[Stretch]) -> _Wrong | None:
    """Return what is to be said of parameters with one prior; nothing where it is right."""
    parameters = [fit.parameters[k] for k in which]
    prior = float(parameters[0].prior or np.inf)
    off = np.array([_off(fit, int(k)) for k in which])
    C = fit.spread.of(which)
    said, directions = np.linalg.eigh(np.eye(len(which)) - C / prior**2)
    is_told = said > _SAID
    told = int(np.count_nonzero(is_told))
    if not told:
        return None
    square = float(np.sum((directions.T @ off / prior)[is_told] ** 2 / said[is_told]))
    # As far as it is noise that makes them scatter, and not the prior, it is known by so many numbers (Satterthwaite).
    noisy = float(np.mean(1.0 - said[is_told]))
    freedom = min(noise.degrees_of_freedom for noise in fit.noise) / max(noisy, 1e-3) ** 2
    farther = float(np.sqrt(square / told))
    if farther < _FARTHER or freedom <= 0.0 or exceeded(square, told, freedom) > _SURELY:
        return None
    weight = np.linalg.solve(np.eye(len(which)) * prior**2 / (1.0 - farther**-2) - C, off)
    most, unit = int(np.argmax(np.abs(off))), parameters[0].unit
    sentence = (
        f"The prior of {what} ({with_unit(prior, unit)}) is not what the data say: they show them "
        f"{farther:.2g} times as far from what is stated, {parameters[most].name} most, by "
        f"{with_unit(off[most], unit, '+')} and more, as the prior holds it back. State how far they may "
        f"really be{_OR_LEARNED if parameters[0].of_robot else ''}"
    )
    return _Wrong(what, float(np.abs(off[most])) / prior, _pull(fit, which, weight, parts), sentence)


def _off(fit: Fit, k: int) -> float:
    """Return how far a parameter is from the centre of its prior, in SI units."""
    parameter = fit.parameters[k]
    if parameter.kind != "base":
        return float(fit.values[k]) - (parameter.centre or 0.0)
    frames = fit.machine.frames
    s, component = Layout.of(fit.model.robot, frames).frame_of(parameter)
    known, base = fit.model.known_base(fit.measurements[0].setups[s]), frames.bases[s]
    assert known is not None, "a prior is about a pose"
    moved = [base[:3, 3] - known.pose[:3, 3], rigid.log3(known.pose[:3, :3].T @ base[:3, :3])]
    return float(np.concatenate(moved)[component])


def _pull(fit: Fit, which: IntArray, weight: Array, parts: Sequence[Stretch]) -> float:
    """Return by how many of their standard deviations what is predicted of the rows moves with C_g ``weight`` (k,)."""
    columns = parts[0].columns
    units = scales(fit.parameters)[columns]
    C = fit.spread.of(columns) / np.outer(units, units)
    own = np.searchsorted(columns, which)
    step = C[:, own] @ (weight * units[own])
    moved = sum(float(np.sum((part.J @ step) ** 2)) for part in parts)
    scatter = sum(float(np.einsum("ndk,kl,ndl->", part.J, C, part.J, optimize=True)) for part in parts)
    return float(np.sqrt(moved / scatter))


def with_unit(value: float, unit: str, sign: str = "") -> str:
    """Return a value of a parameter as a person reads it: in mm or deg where it is in m or rad."""
    if unit == "m":
        return f"{value / MM:{sign}.3g} mm"
    return f"{value / DEG:{sign}.3g} deg" if unit == "rad" else f"{value:{sign}.3g} {unit}"
