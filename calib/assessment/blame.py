"""Which is to blame: lens, print, arm or corners - what each explains on photographs held out, and what it leaves open.

A cause is taken away - the lens held as it was given, the print as it was to be, the arm nominal - and everything else
is fitted anew: by how much photographs held out are then foretold worse is what the cause explains, and nothing else
can. What several could explain as well, such as a print that is too large and an arm that is, no one of them explains.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import IdentificationError, MeasurementError
from calib.identification.fit import Fit
from calib.identification.identify import identify, residuals_of
from calib.measurement.measurements import Measurements
from calib.measurement.optics import seen_by

CauseName = Literal["lens", "scale", "shape", "arm", "corners"]
# The one to blame explains so many times more than any other.
_STANDS_OUT = 2.0
# What is explained, in units of what is left, and in px, below which nobody would call it an explanation.
_LITTLE, _LEAST = 0.3, 0.01

_WORDS = {
    "lens": "the lens, as it was given",
    "scale": "the size of the print",
    "shape": "the print, which is bent or not square",
    "arm": "the arm, which is not as its URDF says",
    "corners": "the corners, which are found no better",
}
_NEXT = {
    "lens": "photograph from nearer and from farther, and with the board in the corners of the image",
    "scale": "measure the ruler of the print and write its side and square_sigma, or move farther between photographs",
    "shape": "photograph the board tilted to all sides, or glue it to glass",
    "arm": "photograph with the wrist turned otherwise, and over more of the workspace",
    "corners": "photograph sharper, with more light, or with the board larger in the image",
}


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause: what it ``explains`` of photographs held out, in px (two-dimensional rms), None where it was not free.

    ``tool``: by how much, in m, the tool's place would be surer if the cause were known, in quadrature.
    """

    name: CauseName
    explains: float | None
    tool: float


@dataclass(frozen=True, slots=True)
class Blame:
    """What every cause explains, ``left`` in px that none does, and ``tool``, the standard deviation of the tool in m.

    ``named``: the cause that explains clearly more than all others, None where no one does.
    """

    causes: tuple[Cause, ...]
    left: float
    tool: float
    named: CauseName | None

    @property
    def sentence(self) -> str:
        """What is to be said of it."""
        if self.named is None:
            return "No one cause explains clearly more of the photographs held out than the others."
        return f"Most is explained by {_WORDS[self.named]}."

    @property
    def advice(self) -> str:
        """What to photograph next."""
        worst = max((cause for cause in self.causes if cause.name != "corners"), key=lambda one: one.tool, default=None)
        name = "corners" if worst is None or worst.tool <= self.tool * 0.5 else worst.name
        return f"To be surer where the tool is, {_NEXT[name]}."


def blame(fit: Fit, sets: Sequence[JudgedSet]) -> Blame | None:
    """Return what explains the photographs of boards that are held out, or all where none are; None without boards."""
    own = fit.measurements
    if not any(data.board is not None for data in own):
        return None
    used = [one for one in sets if one.use == "validation"] or list(sets)
    judged = [one for one in used if one.data.board is not None]
    if not judged:
        return None
    now = _square([one.after for one in judged])
    explains: dict[CauseName, float | None] = {}
    for name, change in _CHANGES.items():
        some = [change(data) for data in own]
        explains[name] = None
        if any(a is not b for a, b in zip(some, own, strict=True)):
            explains[name] = _explained(fit, some, [change(one.data) for one in judged], now)
    of_robot = any(parameter.of_robot for parameter in fit.parameters)
    explains["arm"] = _gain(_square([one.before for one in judged]), now) if of_robot else None
    left = float(np.sqrt(now))
    explains["corners"] = left
    tool = np.array([p.kind == "tool" and p.unit == "m" for p in fit.parameters])
    causes = tuple(Cause(name, value, _share(fit, tool, _of(fit, name))) for name, value in explains.items())
    total = (
        float(np.sqrt(np.trace(fit.covariance[np.ix_(tool, tool)]) / max(tool.sum() // 3, 1))) if tool.any() else 0.0
    )
    return Blame(causes, left, total, _named(explains, left))


def _explained(fit: Fit, own: Sequence[Measurements], judged: Sequence[Measurements], now: float) -> float | None:
    """Return what goes with a cause that is taken away, None where nothing can be found without it."""
    try:
        again = identify(fit.model, own, losses=fit.losses)
        left = residuals_of(again, judged, again.machine)
    except (IdentificationError, MeasurementError):
        return None
    return _gain(_square(left), now)


def _given_lens(data: Measurements) -> Measurements:
    camera = data.camera
    if camera is None or not camera.free or camera.unknown or camera.found:
        return data
    return seen_by(data, replace(camera, free=()), data.board)


def _known_scale(data: Measurements) -> Measurements:
    if data.camera is None or data.board is None or data.board.scale_sigma == 0.0:
        return data
    return seen_by(data, data.camera, replace(data.board, scale_sigma=0.0))


def _flat(data: Measurements) -> Measurements:
    if data.camera is None or data.board is None or data.board.shape == "flat":
        return data
    return seen_by(data, data.camera, replace(data.board, shape="flat"))


_CHANGES: dict[CauseName, Callable[[Measurements], Measurements]] = {
    "lens": _given_lens,
    "scale": _known_scale,
    "shape": _flat,
}


def _square(residuals: Sequence[Array]) -> float:
    return float(np.mean(np.concatenate([np.sum(r * r, axis=1) for r in residuals])))


def _gain(without: float, now: float) -> float:
    return float(np.sqrt(max(without - now, 0.0)))


def _named(explains: dict[CauseName, float | None], left: float) -> CauseName | None:
    """Return the cause that stands out; what is left counts where nothing explains more than a part of it."""
    found = sorted(((value or 0.0, name) for name, value in explains.items() if name != "corners"), reverse=True)
    (most, name), second = found[0], found[1][0]
    if most < max(_LITTLE * left, _LEAST):
        return "corners"
    return name if most > _STANDS_OUT * max(second, 0.5 * left) else None


def _of(fit: Fit, name: CauseName) -> BoolArray:
    """Return which parameters (p,) a cause has."""
    if name == "arm":
        return np.array([parameter.of_robot for parameter in fit.parameters])
    first = {"lens": "lens", "scale": "board", "shape": "board"}.get(name)
    found = [
        parameter.name.partition(".")[0] == first and ((name == "scale") == parameter.name.endswith(".scale"))
        for parameter in fit.parameters
    ]
    if name == "lens":
        found = [parameter.name.partition(".")[0] == first for parameter in fit.parameters]
    return np.array(found, dtype=np.bool_)


def _share(fit: Fit, tool: BoolArray, cause: BoolArray) -> float:
    """Return by how much the tool's place depends on a cause: its standard deviation with, less that without, squared."""
    if not tool.any() or not cause.any():
        return 0.0
    cross = fit.covariance[np.ix_(tool, cause)]
    gone = cross @ np.linalg.pinv(fit.covariance[np.ix_(cause, cause)], rcond=1e-12, hermitian=True) @ cross.T
    return float(np.sqrt(max(np.trace(gone), 0.0)))
