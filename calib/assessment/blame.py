"""Which is to blame: lens, print, arm or corners - what each explains on photographs held out, and what it leaves open.

First nothing is wrong but where camera and board are: the lens as it was given, the print as it was to be, the arm
nominal. Then one cause at a time is let free, also where the job holds it, and photographs held out are foretold better
by what it explains *alone*; and each is taken away while all others stay free, which shows what it explains *beside*
them. How well corners are found, photographs say by themselves: each has a pose of its own there, so that no arm takes
part. Where that is most, corners are named. Else it is the simplest cause that alone explains most of what is beyond
corners, as a print that is too large is likelier than an arm whose every link is: if it explains nearly all. Else the
only one without which all others together leave most of it, where all together do not. Where there is none such, none
is named; nor is any looked for where even all together leave what cannot be explained: readings that are not of these
photographs.

Of very many photographs only some are identified from here, which all tried causes share: which it is, more of them do
not tell better.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from calib.assessment.checks.of_errors import LEFT
from calib.assessment.hand_eye import lens_of
from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.linear import spread
from calib.identification.fit import Fit
from calib.identification.identify import Placed, identify_alike, residuals_of
from calib.identification.initialisation.lenses import legible, photographs_of
from calib.identification.photographs import Optics, poses_of
from calib.identification.photographs import fit as bundle
from calib.identification.rows import photograph_numbers
from calib.identification.together import Together
from calib.measurement.boards import can_be_bent
from calib.measurement.lens import BENT, CENTRE, FOCAL, Lens
from calib.measurement.measurements import Measurements
from calib.measurement.optics import SCALE, seen_by

CauseName = Literal["scale", "shape", "lens", "arm", "corners"]
# From the simplest on.
_CAUSES: tuple[CauseName, ...] = ("scale", "shape", "lens", "arm")
# As squares: what of all beyond corners one cause explains that is named, and of which share of all corners are most.
_NEARLY_ALL, _MOST = 0.9, 0.5
_Squares = Iterable[tuple[CauseName, float | None]]
# So many photographs of a set are identified from, at most.
_ENOUGH = 60
# What is free of a lens that was given.
_NUMBERS = (*FOCAL, *CENTRE, *BENT)

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
_MORE = "take more photographs: what is left is far more than how well corners are found"


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause: what it explains of photographs held out, ``alone`` and ``beside`` all others, in px.

    Two-dimensional rms; None where it cannot be free, or a fit failed. ``tool``: by how much less sure the tool's place
    is as the cause is not known, in quadrature, in m; None where the job holds it, so that no uncertainty counts it.
    """

    name: CauseName
    alone: float | None
    beside: float | None
    tool: float | None


@dataclass(frozen=True, slots=True)
class Blame:
    """What every cause explains of ``whole``, in px, what all leave, ``left``, and what ``corners`` have by themselves.

    ``tool``: standard deviation of the tool's place in m. ``named``: the simplest cause that alone explains nearly all,
    None where there is none. ``lens_held``: whether the job takes the lens as given.
    """

    causes: tuple[Cause, ...]
    whole: float
    left: float
    corners: float
    tool: float
    named: CauseName | None
    lens_held: bool

    @property
    def told(self) -> bool:
        """Whether anything can be said of causes: not where all together explain nothing."""
        return self.named is not None or any(one.alone is not None or one.beside is not None for one in self.causes)

    @property
    def sentence(self) -> str:
        """What is to be said of it."""
        if not self.told:
            return "Nothing that could be wrong with lens, print and arm explains the photographs held out."
        if self.named is None:
            return "No one cause explains by itself what photographs held out ask for."
        if self.named == "corners":
            return f"Most is {_WORDS['corners']}: photographs by themselves, without any arm, are foretold no better."
        return f"Most is explained by {_WORDS[self.named]}."

    @property
    def lens_is_wrong(self) -> bool:
        """Whether the lens is taken as given, and free it would at least halve the mean square of what is left."""
        lens = next(cause for cause in self.causes if cause.name == "lens")
        return self.lens_held and lens.beside is not None and lens.beside > self.left

    @property
    def advice(self) -> str:
        """What to do next."""
        if not self.told:
            return "See whether readings and photographs belong together, and robot and board are the right ones."
        told = max(self.causes, key=lambda cause: cause.tool or 0.0)
        if (told.tool or 0.0) > 0.5 * self.tool:
            return f"To be surer where the tool is, {_NEXT[told.name]}."
        # In squares: where corners are found far better than what is left, sharper ones tell nothing more.
        beyond = self.corners**2 < (1.0 - _MOST) * self.left**2
        return f"To be surer where the tool is, {_MORE if beyond else _NEXT['corners']}."


def blame(fit: Fit, sets: Sequence[JudgedSet]) -> Blame | None:
    """Return what explains the photographs of boards that are held out, or all where none are; None without boards.

    None as well for a fit whose search has found no end: it explains nothing yet.
    """
    judged, free = _tried(fit, sets)
    if not free or not fit.converged:
        return None
    held, some = _held(fit, free), _Some.of(fit)
    alone_found = _corners(some, judged)
    if alone_found is None:
        return None
    corners, lenses = alone_found
    some = some._replace(lenses=lenses)
    whole, left = _left(some, judged, ()), _all_free(some, judged, free)
    if whole is None or left is None:
        return None
    pixels = np.concatenate([one.data.value[:, :2] for one in judged])
    if np.sqrt(min(left, _square([one.after for one in judged]))) > LEFT * spread(pixels):
        free = []
    several = len(free) > 1
    alone = {name: _left(some, judged, (name,)) if several else left for name in free}
    others = {name: [other for other in free if other != name] for name in free}
    beside = {name: _left(some, judged, others[name]) if several else whole for name in free}
    tool = np.array([p.kind == "tool" and p.unit == "m" for p in fit.parameters])
    parameters = {name: _of(fit, name) for name in _CAUSES}
    causes = tuple(
        Cause(
            name,
            _gain(whole, alone.get(name)),
            _gain(beside.get(name), left),
            _share(fit, tool, parameters[name]) if parameters[name].any() else None,
        )
        for name in _CAUSES
    )
    return Blame(
        causes,
        float(np.sqrt(whole)),
        float(np.sqrt(left)),
        float(np.sqrt(corners)),
        float(np.sqrt(np.trace(fit.covariance[np.ix_(tool, tool)]))),
        _named(whole, left, corners, alone.items(), beside.items()),
        "lens" in held,
    )


def _tried(fit: Fit, sets: Sequence[JudgedSet]) -> tuple[list[JudgedSet], list[CauseName]]:
    """Return photographs of boards to judge by, and the causes that may be free."""
    used = [one for one in sets if one.use == "validation"] or list(sets)
    judged = [one for one in used if one.data.board is not None]
    seen = [one.data for one in judged]
    return judged, [name for name in _CAUSES if judged and _can_be_free(fit, seen, name)]


def _can_be_free(fit: Fit, seen: Sequence[Measurements], name: CauseName) -> bool:
    """Return whether a cause can be what is wrong: an arm that is sought, a lens that somebody gave."""
    boards = [data.board for data in seen if data.board is not None]
    if name == "arm":
        return bool(_of(fit, name).any())
    if name == "lens":
        cameras = [data.camera for data in seen if data.camera is not None]
        return not all(camera.unknown or camera.found for camera in cameras)
    if name == "scale":
        return any(board.scale_sigma > 0.0 for board in boards)
    return all(board.shape != "flat" or can_be_bent(board.marks) for board in boards)


def _held(fit: Fit, free: Sequence[CauseName]) -> list[CauseName]:
    """Return the causes that the job holds although they could be free."""
    return [name for name in free if not _of(fit, name).any()]


class _Some(NamedTuple):
    """A fit, and the ``rows`` to identify from where causes are tried, with how those ``together`` err.

    ``all``: whether these are the fit's own. ``lenses``: of cameras, as photographs by themselves show them.
    """

    fit: Fit
    rows: tuple[Measurements, ...]
    together: tuple[Together | None, ...]
    all: bool
    lenses: Mapping[str, Lens] = MappingProxyType({})

    @classmethod
    def of(cls, fit: Fit) -> "_Some":
        """Return as many photographs of every set as are enough, evenly among all, and all other rows."""
        chosen = [_enough(data) for data in fit.measurements]
        rows = tuple(data.subset(rows) for data, rows in zip(fit.measurements, chosen, strict=True))
        together = tuple(
            own and own.drawn(rows, np.zeros(len(rows), dtype=np.intp))
            for own, rows in zip(fit.together, chosen, strict=False)
        )
        every = sum(map(len, rows)) == sum(map(len, fit.measurements))
        return cls(fit, fit.measurements, fit.together, all=True) if every else cls(fit, rows, together, all=False)


def _enough(data: Measurements) -> IntArray:
    if data.board is None:
        return np.arange(len(data))
    number = photograph_numbers(data)
    return np.flatnonzero(number % -(-(int(number.max(initial=0)) + 1) // _ENOUGH) == 0)


def _all_free(some: _Some, judged: Sequence[JudgedSet], free: Sequence[CauseName]) -> float | None:
    """Return the mean square, in px^2, of photographs held out where all causes are free, as in most jobs."""
    if some.all and not _held(some.fit, free):
        return _square([one.after for one in judged])
    return _left(some, judged, free)


def _left(some: _Some, judged: Sequence[JudgedSet], freed: Collection[CauseName]) -> float | None:
    """Return the mean square, in px^2, of photographs held out where some causes alone are free; None if that fails."""
    fit, own = some.fit, [_with(data, freed, some.lenses) for data in some.rows]
    frames = [escape(p.name) for p in fit.parameters if not p.of_robot and not p.nuisance]
    named = [escape(p.name) for p in fit.parameters if p.of_robot and "arm" in freed]
    try:
        # Where a lens that was given is another one, the job's fit has camera and board elsewhere.
        placed: Placed = "begun" if "lens" in freed else "fitted"
        again = identify_alike(fit, own, [*frames, *named], together=some.together, placed=placed)
        seen = [_with(one.data, freed, some.lenses) for one in judged]
        return _square(residuals_of(again, seen, again.machine))
    except (IdentificationError, MeasurementError):
        return None


def _with(
    data: Measurements, freed: Collection[CauseName], lenses: Mapping[str, Lens] = MappingProxyType({})
) -> Measurements:
    """Return what a camera saw, with lens and board as they were given but for what is free.

    ``lenses``: where the search begins for one that was given, by the camera's name.
    """
    camera, board = data.camera, data.board
    if camera is None or board is None:
        return data
    if "lens" in freed:
        begun = {} if camera.free or camera.name not in lenses else lenses[camera.name]._asdict()
        camera = replace(camera, free=camera.free or _NUMBERS, **begun)
    elif not (camera.unknown or camera.found):
        camera = replace(camera, free=(), lens_sigma={})
    if "scale" not in freed:
        board = replace(board, scale_sigma=0.0)
    if "shape" not in freed:
        board = replace(board, shape="flat")
    elif board.shape == "flat" and can_be_bent(board.marks):
        board = replace(board, shape="quadratic")
    return seen_by(data, camera, board)


def _corners(some: _Some, judged: Sequence[JudgedSet]) -> tuple[float, Mapping[str, Lens]] | None:
    """Return the mean square, in px^2, that lens, board and a pose of its own leave of each photograph, and the lenses.

    Robots take no part in it: it is how well corners are found. It allows for what was fitted. None where photographs
    are too few for that.
    """
    lenses: dict[str, Lens] = {}
    sets, squares, rows = [*some.rows, *(one.data for one in judged)], 0.0, 0
    for name in dict.fromkeys(_pair(data) for data in sets if data.board is not None):
        same = [_with(data, ("lens", "shape")) for data in sets if data.board is not None and _pair(data) == name]
        camera = same[0].camera
        assert camera is not None, "pixels were seen by a camera"
        lens = lens_of(some.fit, camera)[0]
        photographs = legible([one for data in same for one in photographs_of(data)], lens)
        if not photographs:
            return None
        optics = Optics(lens, np.zeros(photographs[0].modes.shape[2]))
        found = bundle(photographs, camera.free, optics, poses_of(photographs, optics)[0])
        count = sum(len(r) for r in found.residuals)
        freedom = 2 * count - 6 * len(photographs) - len(camera.free) - len(optics.shape)
        if freedom <= 0:
            return None
        if found.converged:
            with suppress(JobError):  # a lens that cannot be is none to begin with
                lenses[camera.name] = replace(camera, **found.optics.lens._asdict()).lens
        squares += count * 2.0 * sum(float(np.sum(r * r)) for r in found.residuals) / freedom
        rows += count
    return (squares / rows, lenses) if rows else None


def _pair(data: Measurements) -> tuple[str, str]:
    assert data.camera is not None and data.board is not None, "asked of photographs of boards"
    return data.camera.name, data.board.name


def _square(residuals: Sequence[Array]) -> float:
    return float(np.mean(np.concatenate([np.sum(r * r, axis=1) for r in residuals])))


def _gain(without: float | None, now: float | None) -> float | None:
    return None if without is None or now is None else float(np.sqrt(max(without - now, 0.0)))


def _named(whole: float, left: float, corners: float, alone: _Squares, beside: _Squares) -> CauseName | None:
    """Return the cause that is to be named, by mean squares in px^2: see the module's first lines.

    ``alone``: what each leaves by itself, from the simplest on; ``beside``: what all others leave.
    """
    if corners > _MOST * whole:
        return "corners"
    beyond = whole - corners
    for name, square in alone:
        # Less than nearly all, and yet most: a richer cause that explains more may only imitate it.
        share = 0.0 if square is None else (whole - square) / beyond
        if share > _NEARLY_ALL:
            return name
        if share > _MOST:
            break
    if whole - left < _MOST * beyond:
        # Where all together leave most, what one is needed beside the others only undoes what these did wrong.
        return None
    needed = [name for name, square in beside if square is not None and square - left > _MOST * beyond]
    return needed[0] if len(needed) == 1 else None


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
