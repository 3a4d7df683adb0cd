"""Which is to blame: lens, print, arm or corners - what each explains on photographs held out, and what it leaves open.

First nothing is wrong but where camera and board are: the lens as it was given, the print as it was to be, the arm
nominal. Then one cause at a time is let free, and photographs held out are foretold better by what it explains *alone*;
and each is taken away while all others stay free, which shows what it explains *beside* them. What alone explains
nearly all, and beside the others nothing, they could explain as well: of such causes the simplest is named, as a print
that is too large is likelier than an arm whose every link is. Where none alone explains nearly all, none is named.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from typing import Literal

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import IdentificationError, MeasurementError
from calib.identification.fit import Fit
from calib.identification.identify import identify, residuals_of
from calib.measurement.measurements import Measurements
from calib.measurement.optics import SCALE, seen_by

CauseName = Literal["scale", "shape", "lens", "arm", "corners"]
# From the simplest on.
_CAUSES: tuple[CauseName, ...] = ("scale", "shape", "lens", "arm")
# Nearly all is explained by one cause: so much of what all explain together, as squares.
_NEARLY_ALL = 0.9
# What all causes explain is nothing to speak of below this share of what is left, as squares.
_LITTLE = 0.25

_WORDS: Mapping[CauseName, str] = {
    "lens": "the lens, which is not as it was given",
    "scale": "the size of the print",
    "shape": "the print, which is bent or not square",
    "arm": "the arm, which is not as its URDF says",
    "corners": "how well corners are found",
}
_NEXT: Mapping[CauseName, str] = {
    "lens": "photograph from nearer and from farther, and with the board in the corners of the image",
    "scale": "measure the ruler of the print and write its side and square_sigma, or move farther between photographs",
    "shape": "photograph the board tilted to all sides, or glue it to glass",
    "arm": "photograph with the wrist turned otherwise, and over more of the workspace",
    "corners": "photograph sharper, with more light, or with the board larger in the image",
}


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause: what it explains of photographs held out, ``alone`` and ``beside`` all others, in px.

    Two-dimensional rms; None where it was not free. ``tool``: by how much less sure the tool's place is as the cause
    is not known, in quadrature, in m.
    """

    name: CauseName
    alone: float | None
    beside: float | None
    tool: float


@dataclass(frozen=True, slots=True)
class Blame:
    """What every cause explains of ``whole``, in px, and what all leave, ``left``.

    ``tool``: standard deviation of the tool's place in m. ``named``: the simplest cause that alone explains nearly all,
    None where there is none.
    """

    causes: tuple[Cause, ...]
    whole: float
    left: float
    tool: float
    named: CauseName | None

    @property
    def sentence(self) -> str:
        """What is to be said of it."""
        if self.named is None:
            return "No one cause explains by itself what photographs held out ask for."
        if self.named == "corners":
            return f"What is left is {_WORDS['corners']}: nothing else explains much of the photographs held out."
        return f"Most is explained by {_WORDS[self.named]}."

    @property
    def advice(self) -> str:
        """What to photograph next."""
        worst = max(self.causes, key=lambda cause: cause.tool)
        name = worst.name if worst.tool > 0.5 * self.tool else "corners"
        return f"To be surer where the tool is, {_NEXT[name]}."


def blame(fit: Fit, sets: Sequence[JudgedSet]) -> Blame | None:
    """Return what explains the photographs of boards that are held out, or all where none are; None without boards."""
    own = fit.measurements
    used = [one for one in sets if one.use == "validation"] or list(sets)
    judged = [one for one in used if one.data.board is not None]
    free = [name for name in _CAUSES if _of(fit, name).any() and not (name == "lens" and _found(own))]
    if not judged or not free:
        return None
    left = _square([one.after for one in judged])
    whole = _without(fit, judged, free)
    if whole is None:
        return None
    alone: dict[CauseName, float | None] = {}
    beside: dict[CauseName, float | None] = {}
    for name in free:
        alone[name] = _without(fit, judged, [other for other in free if other != name]) if len(free) > 1 else left
        beside[name] = _without(fit, judged, [name]) if len(free) > 1 else whole
    tool = np.array([p.kind == "tool" and p.unit == "m" for p in fit.parameters])
    causes = tuple(
        Cause(name, _gain(whole, alone.get(name)), _gain(beside.get(name), left), _share(fit, tool, _of(fit, name)))
        for name in _CAUSES
    )
    return Blame(
        causes,
        float(np.sqrt(whole)),
        float(np.sqrt(left)),
        float(np.sqrt(np.trace(fit.covariance[np.ix_(tool, tool)]))),
        _named(whole, left, alone),
    )


def _found(own: Sequence[Measurements]) -> bool:
    """Return whether nobody gave the numbers of the lens."""
    return all(data.camera is None or data.camera.unknown or data.camera.found for data in own)


def _without(fit: Fit, judged: Sequence[JudgedSet], held: Collection[CauseName]) -> float | None:
    """Return the mean square, in px^2, of photographs held out where some causes are held; None if that fails."""
    own = [_held(data, held) for data in fit.measurements]
    frames = [escape(p.name) for p in fit.parameters if not p.of_robot and not p.nuisance]
    named = [escape(p.name) for p in fit.parameters if p.of_robot and "arm" not in held]
    try:
        again = identify(fit.model, own, free=[*frames, *named], losses=fit.losses)
        return _square(residuals_of(again, [_held(one.data, held) for one in judged], again.machine))
    except (IdentificationError, MeasurementError):
        return None


def _held(data: Measurements, held: Collection[CauseName]) -> Measurements:
    """Return what a camera saw, with lens and board as they were given where these are held."""
    camera, board = data.camera, data.board
    if camera is None or board is None:
        return data
    if "lens" in held:
        camera = replace(camera, free=())
    if "scale" in held:
        board = replace(board, scale_sigma=0.0)
    if "shape" in held:
        board = replace(board, shape="flat")
    return seen_by(data, camera, board)


def _square(residuals: Sequence[Array]) -> float:
    return float(np.mean(np.concatenate([np.sum(r * r, axis=1) for r in residuals])))


def _gain(without: float | None, now: float | None) -> float | None:
    return None if without is None or now is None else float(np.sqrt(max(without - now, 0.0)))


def _named(whole: float, left: float, alone: Mapping[CauseName, float | None]) -> CauseName | None:
    """Return the simplest cause that alone explains nearly all; corners where there is little to explain."""
    if whole - left < _LITTLE * left:
        return "corners"
    for name, square in alone.items():
        if square is not None and whole - square > _NEARLY_ALL * (whole - left):
            return name
    return None


def _of(fit: Fit, name: CauseName) -> BoolArray:
    """Return which parameters (p,) a cause has."""
    patterns = {"scale": f"board*.{SCALE}", "shape": "board*", "lens": "lens*"}

    def of(parameter_name: str, *, of_robot: bool, instrument: bool) -> bool:
        if name == "arm":
            return of_robot
        of_scale = fnmatchcase(parameter_name, patterns["scale"])
        return instrument and fnmatchcase(parameter_name, patterns[name]) and (name == "scale" or not of_scale)

    found = [of(p.name, of_robot=p.of_robot, instrument=p.kind == "instrument") for p in fit.parameters]
    return np.array(found, dtype=np.bool_)


def _share(fit: Fit, tool: BoolArray, cause: BoolArray) -> float:
    """Return by how much less sure the tool's place is as the cause is not known, in quadrature, in m."""
    if not tool.any() or not cause.any():
        return 0.0
    cross = fit.covariance[np.ix_(tool, cause)]
    gone = cross @ np.linalg.pinv(fit.covariance[np.ix_(cause, cause)], rcond=1e-12, hermitian=True) @ cross.T
    return float(np.sqrt(max(np.trace(gone), 0.0)))
