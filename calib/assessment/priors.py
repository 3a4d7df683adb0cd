"""Stated priors that the data contradict, and whether they hold the result back.

Were a prior right, what a fit finds under it, x, would have the covariance S - C: that of the prior less that of the
fit. So its sum of squares in those directions in which the data say something is a chi-square. Where data determine a
parameter, a prior that is too narrow does little harm. So it is made as wide as the data say, S f^2 for all its
parameters g, and counts where this moves what is predicted: by C_g (S / (1 - f^-2) - C_gg)^-1 x_g, as where the fit is
linear. Else it is only told, for how parameters share what the data do not tell apart is as sure as the prior.

Joint terms that are far larger than their typical size leave so much that they seem to be known no better than their
weak priors: they belong to the null space then, stay at zero, and go on leaving it. So it is asked what they would be
if nothing held them.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np

from calib.assessment.checks.of_arm import is_stated_scale
from calib.assessment.scores import asked
from calib.assessment.stretches import Stretch
from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.foundations.units import DEG, MM
from calib.identification.fit import Fit
from calib.identification.machine import Layout
from calib.identification.parameters import Parameter, scales
from calib.measurement.checks import Finding
from calib.robot.terms import kind_of

# Standard deviations of a stated prior by which what is found may be off. A scale is that of a board's print, which is
# stated to half a percent and mostly right to two tenths.
_OFF = 4.0
# Shares of a prior's variance that data have made smaller: below, they say next to nothing.
_SAID = 0.1
# Priors are stated roughly, and what a model leaves out is in the parameters, too.
_SURELY, _FARTHER = 1e-6, 1.5
# Standard deviations of what is predicted at the poses of the fit. With less, nine of ten regions hold the truth.
_PULL = 0.3
# Of weak priors, which nobody states, and many of which cannot be: with 0.4 to 0.7, 97 to 100 of 100 regions hold it.
_PULL_OF_WEAK = 1.0
# What terms in the null space would leave of the squares of the rows, at most: most of what is left is theirs.
_LEFT = 0.25
_CODE, HARMLESS = "prior-contradicted", "prior-too-narrow"
_OR_LEARNED = ', or write "learned"'
_HOW_LARGE = ". State how large they may be, by error_model.prior"
_MUCH = "; what the data do not tell is less certain than regions say."
_LITTLE = "; predictions hardly depend on it, but the values of single parameters do."


class _Wrong(NamedTuple):
    """``what`` has a wrong prior, by whose standard deviation its parameters are ``off``, and a sentence.

    ``pull``: by how many of their standard deviations predictions move without it. ``stated``: it is no weak one.
    """

    what: str
    off: float
    pull: float
    sentence: str
    stated: bool


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
    judged.append(_in_null_space(fit, among, parts))
    told = (one for one in judged if one is not None and (one.stated or one.pull >= _PULL_OF_WEAK))
    wrong = sorted(told, key=lambda one: -one.off)
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
    if of_lens:
        unit = f" {parameter.unit}" if parameter.unit == "px" else ""
        so, right, remedy = f"{off:+.2g} +- {sigma:.2g}{unit}", f"{prior:.2g}{unit}", "Leave out its lens_sigma"
    else:
        so, right = f"{100.0 * off:+.2g} +- {100.0 * sigma:.2g} %", f"{100.0 * prior:.2g} %"
        remedy = "Measure the squares of the board again"
    return (
        f"{parameter.name} is found {so} from what is stated, which is said to be right to {right}, and is held back "
        f"by that. {remedy}."
    )


def _stated_together(fit: Fit, among: AbstractSet[int]) -> Iterator[tuple[list[int], str]]:
    """Yield the numbers of the parameters of which something is stated alike, and what they are; only ``among`` these.

    Joint terms of which nothing is stated have a weak prior alike, but for those in the null space. Of very many
    set-ups some are looked at.
    """
    alike = defaultdict[tuple[str, str, bool, float | None], list[int]](list)
    for k, parameter in enumerate(fit.parameters):
        weak = _is_weak_term(parameter) and not fit.unidentifiable[k]
        if not (parameter.is_stated or weak) or parameter.nuisance or k not in among:
            continue
        base = "the base" if parameter.name.count(".") == 1 else parameter.name.rpartition(".")[0]
        of = {"base": base, "term": "joint terms"}.get(parameter.kind, "the arm")
        alike[of, parameter.unit, weak, parameter.weak_prior if weak else parameter.prior].append(k)
    for (of, unit, _, _), which in alike.items():
        yield which, _named(of, unit)


def _named(of: str, unit: str) -> str:
    return {"m": f"lengths of {of}", "rad": f"angles of {of}"}.get(unit, f"{of} in {unit}")


def _is_weak_term(parameter: Parameter) -> bool:
    return parameter.kind == "term" and parameter.prior is None and parameter.group is None


def _judged(fit: Fit, which: IntArray, what: str, parts: Sequence[Stretch]) -> _Wrong | None:
    """Return what is to be said of parameters with one prior; nothing where it is right."""
    parameters = [fit.parameters[k] for k in which]
    stated = parameters[0].prior is not None
    prior = float((parameters[0].prior if stated else parameters[0].weak_prior) or np.inf)
    off = np.array([_off(fit, int(k)) for k in which])
    C = fit.spread.of(which)
    said, directions = np.linalg.eigh(np.eye(len(which)) - C / prior**2)
    is_told = said > _SAID
    told = int(np.count_nonzero(is_told))
    # Weak priors weigh less where rows scatter less than is stated.
    if not told or (not stated and float(said[0]) <= 0.0):
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
    if stated:
        sentence = (
            f"The prior of {what} ({with_unit(prior, unit)}) is not what the data say: they show them "
            f"{farther:.2g} times as far from what is stated, {parameters[most].name} most, by "
            f"{with_unit(off[most], unit, '+')} and more, as the prior holds it back. State how far they may "
            f"really be{_OR_LEARNED if parameters[0].of_robot else ''}"
        )
    else:
        sentence = _held_by_weak(fit, which, what, off, farther)
    own, C = _scaled(fit, which, parts)
    step = C[:, own] @ (weight * scales(fit.parameters)[which])
    return _Wrong(what, float(np.abs(off[most])) / prior, _pull(step, C, parts), sentence, stated)


def _in_null_space(fit: Fit, among: AbstractSet[int], parts: Sequence[Stretch]) -> _Wrong | None:
    """Return what is to be said of joint terms that are not determined, if they explain what is left, and are large."""
    every = [k for k in sorted(among) if _is_weak_term(fit.parameters[k]) and fit.unidentifiable[k]]
    if not every:
        return None
    own, C = _scaled(fit, np.array(every), parts)
    # Beside them, all others are as free as without them.
    rest = np.setdiff1d(np.arange(len(C)), own)
    hold = np.array([fit.parameters[k].hold for k in parts[0].columns[rest]])
    known = np.sum([np.tensordot(part.J, part.J, ((0, 1), (0, 1))) for part in parts], axis=0)[np.ix_(rest, rest)]
    free = np.zeros_like(C)
    free[np.ix_(rest, rest)] = np.linalg.pinv(known + np.diag(hold**2), hermitian=True)
    ask = asked(parts, [part.J[:, :, own] for part in parts], free)
    off = ask.sizes * scales(fit.parameters)[every]
    priors = np.array([fit.parameters[k].weak_prior for k in every])
    most = fit.parameters[every[int(np.argmax(np.abs(off) / priors))]]
    alike = np.array(
        [(q.unit, q.weak_prior) == (most.unit, most.weak_prior) for q in (fit.parameters[k] for k in every)]
    )
    farther = float(np.sqrt(np.mean(off[alike] ** 2))) / most.weak_prior
    if farther < _FARTHER or ask.chance > _SURELY or ask.left > _LEFT:
        return None
    step = ask.follows.copy()
    step[own] += ask.sizes
    what = _named("joint terms", most.unit)
    sentence = _held_by_weak(fit, np.array(every)[alike], what, off[alike], farther)
    return _Wrong(what, float(np.max(np.abs(off) / priors)), _pull(step, C, parts), sentence, False)


def _held_by_weak(fit: Fit, which: IntArray, what: str, off: Array, farther: float) -> str:
    """Return what is said of joint terms that are off zero by ``off`` (k,), ``farther`` than their weak prior."""
    most = int(np.argmax(np.abs(off)))
    parameter = fit.parameters[which[most]]
    return (
        f"Nothing is stated of {what}, and they are expected to be {with_unit(parameter.weak_prior, parameter.unit)} "
        f"at most: the data show them {farther:.2g} times as far from zero, {parameter.name} most, by "
        f"{with_unit(off[most], parameter.unit, '+')} and more, as this holds it back"
        f"{_HOW_LARGE if _can_be_stated(fit, parameter) else ''}"
    )


def _can_be_stated(fit: Fit, parameter: Parameter) -> bool:
    """Return whether a job can state a prior of the coefficient of this joint term."""
    return any(kind_of(term).priors for term in fit.model.robot.terms if term.name == parameter.name)


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


def _scaled(fit: Fit, which: IntArray, parts: Sequence[Stretch]) -> tuple[IntArray, Array]:
    """Return the places (k,) of parameters among the columns of rows, and the covariance (c, c) of these, scaled."""
    columns = parts[0].columns
    units = scales(fit.parameters)[columns]
    return np.searchsorted(columns, which), fit.spread.of(columns) / np.outer(units, units)


def _pull(step: Array, C: Array, parts: Sequence[Stretch]) -> float:
    """Return by how many of their standard deviations what is predicted of the rows moves with ``step`` (c,), scaled.

    ``C`` (c, c): the covariance of the columns of the rows, scaled.
    """
    moved = sum(float(np.sum((part.J @ step) ** 2)) for part in parts)
    scatter = sum(float(np.einsum("ndk,kl,ndl->", part.J, C, part.J, optimize=True)) for part in parts)
    return float(np.sqrt(moved / scatter))


def with_unit(value: float, unit: str, sign: str = "") -> str:
    """Return a value of a parameter as a person reads it: in mm or deg where it is in m or rad."""
    if unit == "m":
        return f"{value / MM:{sign}.3g} mm"
    return f"{value / DEG:{sign}.3g} deg" if unit == "rad" else f"{value:{sign}.3g} {unit}"
