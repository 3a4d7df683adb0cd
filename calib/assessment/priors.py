"""Stated priors that the data contradict: what a prior holds back, the other parameters take up.

Were a prior right, what a fit finds under it, x, would have the covariance S - C: that of the prior less that of the
fit. So its sum of squares in those directions in which the data say something is a chi-square.
"""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from calib.assessment.checks.of_arm import is_stated_scale
from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.foundations.units import DEG, MM
from calib.identification.fit import Fit
from calib.identification.machine import Layout
from calib.measurement.checks import Finding

# Standard deviations of a stated prior by which what is found may be off. A scale is that of a board's print, which is
# stated to half a percent and mostly right to two tenths.
_OFF = 4.0
# Shares of a prior's variance that data have made smaller: below, they say next to nothing.
_SAID = 0.1
# Priors are stated roughly, and what a model leaves out is in the parameters, too.
_SURELY, _FARTHER = 1e-6, 1.5
_CODE = "prior-contradicted"
_OR_LEARNED = ', or write "learned"'


def contradicted(fit: Fit) -> list[Finding]:
    """Return the stated priors of which that is no accident, in a sentence each; learned ones are right."""
    found = [
        Finding.warning(
            _CODE,
            f"{parameter.name} is found {100.0 * off:+.2g} +- {100.0 * sigma:.2g} % from what is stated, which "
            f"is said to be right to {100.0 * prior:.2g} %, and is held back by that. Measure the squares of the board "
            "again.",
        )
        for parameter, value, sigma in zip(fit.parameters, fit.values, fit.sigmas, strict=True)
        if is_stated_scale(parameter) and (prior := parameter.prior)
        if abs(off := value - (parameter.centre or 0.0)) > _OFF * prior
    ]
    off = _off(fit)
    judged = [(what, _judged(fit, np.array(which), off[which], what)) for which, what in _stated_together(fit)]
    told = sorted(((*one, what) for what, one in judged if one is not None), key=lambda one: -one[0])
    if not told:
        return found
    # What one wrong prior holds back is taken up by others, too: that of the parameter that is farthest off is first.
    (_, sentence, _), *others = told
    also = " and ".join(what for *_, what in others)
    more = f" The same seems true of {also}, perhaps by that alone." if others else ""
    return [*found, Finding.warning(_CODE, sentence + more)]


def _stated_together(fit: Fit) -> Iterator[tuple[list[int], str]]:
    """Yield the numbers of the parameters of which something is stated alike, and what they are."""
    alike = defaultdict[tuple[str, str, float], list[int]](list)
    for k, parameter in enumerate(fit.parameters):
        if parameter.prior is None or parameter.group is not None or parameter.nuisance:
            continue
        base = "the base" if parameter.name.count(".") == 1 else parameter.name.rpartition(".")[0]
        of = {"base": base, "term": "joint terms"}.get(parameter.kind, "the arm")
        alike[of, parameter.unit, parameter.prior].append(k)
    for (of, unit, _), which in alike.items():
        yield which, {"m": f"lengths of {of}", "rad": f"angles of {of}"}.get(unit, f"{of} in {unit}")


def _off(fit: Fit) -> Array:
    """Return how far (p,) parameters are from the centres of their priors, in SI units."""
    off = fit.values - np.array([parameter.centre or 0.0 for parameter in fit.parameters])
    frames, setups = fit.machine.frames, fit.measurements[0].setups
    layout = Layout.of(fit.model.robot, frames)
    for k, parameter in enumerate(fit.parameters):
        if parameter.kind == "base" and parameter.prior is not None:
            s, component = layout.frame_of(parameter)
            known = fit.model.known_base(setups[s])
            assert known is not None, "a prior is about a pose"
            base = frames.bases[s]
            moved = [base[:3, 3] - known.pose[:3, 3], rigid.log3(known.pose[:3, :3].T @ base[:3, :3])]
            off[k] = np.concatenate(moved)[component]
    return np.asarray(off)


def _judged(fit: Fit, which: IntArray, off: Array, what: str) -> tuple[float, str] | None:
    """Return by how many times their prior the farthest of parameters is ``off`` (k,), and what to say, if any."""
    parameters = [fit.parameters[k] for k in which]
    prior = float(parameters[0].prior or np.inf)
    said, directions = np.linalg.eigh(np.eye(len(which)) - fit.spread.of(which) / prior**2)
    is_told = said > _SAID
    told = int(np.count_nonzero(is_told))
    if not told:
        return None
    square = float(np.sum((directions.T @ off / prior)[is_told] ** 2 / said[is_told]))
    freedom = min(noise.degrees_of_freedom for noise in fit.noise)
    farther = float(np.sqrt(square / told))
    if farther < _FARTHER or freedom <= 0.0 or exceeded(square, told, freedom) > _SURELY:
        return None
    most = int(np.argmax(np.abs(off)))
    return float(np.abs(off[most])) / prior, (
        f"The prior of {what} ({_shown(prior, parameters[0].unit)}) is not what the data say: they show them "
        f"{farther:.2g} times as far from what is stated, {parameters[most].name} most, by "
        f"{_shown(off[most], parameters[most].unit, '+')} and more, as the prior holds it back. State how far they may "
        f"really be{_OR_LEARNED if parameters[0].of_robot else ''}; what the data do not tell is less certain than "
        "regions say."
    )


def _shown(value: float, unit: str, sign: str = "") -> str:
    if unit == "m":
        return f"{value / MM:{sign}.3g} mm"
    return f"{value / DEG:{sign}.3g} deg" if unit == "rad" else f"{value:{sign}.3g} {unit}"
