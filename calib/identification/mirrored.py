"""What two places explain alike: anchors, balls and tools that lengths alone tell, boards and bases in photographs.

Lengths from points in a plane are the same on both of its sides, and three points always are in a plane: with a machine
that is known, three lengths put an anchor at either of two places, and a fit ends at one of them without a remainder.
Neither the rank nor a standard deviation says so, as both look at the surroundings of one place. A board that is small
in its photograph is alike: :mod:`calib.identification.mirrored_boards`.

Of an arm that moves in a plane all lengths are the same on both sides, to anchors that are known as well: tilts of its
axes have the other signs there. So the machine must follow, and a whole search begins behind the plane.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.linear import svd, triangle
from calib.identification.machine import Layout, Machine
from calib.identification.mirrored_boards import Photographed, frames_in, mirror, photographed
from calib.identification.parameters import ParameterKind, scales
from calib.identification.relations import related_targets
from calib.identification.system import Problem
from calib.measurement.kinds import Kind
from calib.measurement.measurements import numbered, reach_of

_LENGTHS: tuple[Kind, ...] = ("distance", "sphere")
# Both places are possible where the sums of squares differ by less than four standard deviations, squared; and they are
# two where what is told of one does not reach the other.
LIKELY, _APART = 16.0, 16.0
_STEPS, _NO_STEP = 20, 1e-9
# Ends are nearly in a plane where they are off it by that share of how they spread along it.
_FLAT = 0.1
# A tool is that far from its link, in m, or as far as the robot reaches, at most.
FAR_TOOL = 1.0
# Whitened residuals (n,) of a place, and their derivatives by it (n, k).
_Look = Callable[[Array], tuple[Array, Array]]


class _Lengths(NamedTuple):
    """Rows of lengths between a tool point and a target: where tool and target are (n, 4, 4), residual, sigma (n,).

    ``setup``, ``tool`` and ``target`` (n,): numbers of these.
    """

    setup: IntArray
    tool: IntArray
    target: IntArray
    tools: Array
    targets: Array
    residual: Array
    sigma: Array

    def ends(self, kind: ParameterKind) -> Array:
        """Return the other ends (n, 3) of the lengths from a target, in the frame where it stands, or from a tool."""
        return np.asarray((self.tools if kind == "target" else rigid.inverse(self.tools) @ self.targets)[:, :3, 3])


def mirrored(problem: Problem, at: Machine, sigmas: Sequence[Array]) -> BoolArray:
    """Return which parameters (p,) are of frames that two places explain, the others being as they are.

    ``sigmas`` (N, 1) of the rows of every set. Targets between which something is known, and what other rows than
    lengths tell of, or than photographs, are not looked at.
    """
    found, layout = np.zeros(len(problem.parameters), dtype=np.bool_), Layout.of(problem.model.robot, problem.reference)
    rows = _rows(problem, at, sigmas)
    kinds: tuple[ParameterKind, ...] = ("base", "tool", "target")
    for kind in kinds:
        free = {k: layout.frame_of(p)[0] for k, p in enumerate(problem.parameters) if p.kind == kind}
        asked = set(free.values()) - (_related(problem) if kind == "target" else set())
        twice = set[int]()
        if rows and kind != "base":
            twice |= _by_lengths(rows, kind, asked - _told_otherwise(problem, kind))
        twice |= {k for k, seen in photographed(problem, at, sigmas, kind, asked) if _turned_alike(seen)}
        found[[k for k, number in free.items() if number in twice]] = True
    return found


def behind(problem: Problem, x: Array) -> Array | None:
    """Return values (p,) with what lengths alone tell on the other side of the planes of their ends, else as x (p,).

    These are targets; where all of them are known, bases of arms that move in a plane; where these are known as well,
    tools. None where there are no such planes, or where a tool would be too far from its link to be one.
    """
    at, layout = problem.machine(x), Layout.of(problem.model.robot, problem.reference)
    rows = _rows(problem, at, [data.sigma for data in problem.measurements])
    if rows is None:
        return None
    kinds: tuple[ParameterKind, ...] = ("target", "base", "tool")
    for kind in kinds:
        free = [(k, *layout.frame_of(p)) for k, p in enumerate(problem.parameters) if p.kind == kind]
        asked = {number for _, number, _ in free} - _told_otherwise(problem, kind)
        asked -= _related(problem) if kind == "target" else set()
        there = {number: frame for number, frame in _reflected(rows, kind, at).items() if number in asked}
        if kind == "tool":
            far = max(FAR_TOOL, reach_of(problem.model.robot, problem.measurements))
            there = {number: frame for number, frame in there.items() if np.linalg.norm(frame[:3, 3]) <= far}
        found = x.copy()
        for k, number, component in free:
            if number not in there:
                continue
            if component < 3:
                found[k] = there[number][component, 3]
            elif kind == "base":
                found[k] = _turns(problem, number, there[number])[component - 3]
        if there:
            return found
    return None


def with_turns(problem: Problem, x: Array) -> Array:
    """Return values x (p,) with the angles of bases, which several triples tell alike, as those of one kind."""
    layout, bases, found = Layout.of(problem.model.robot, problem.reference), problem.machine(x).frames.bases, x.copy()
    for k, parameter in enumerate(problem.parameters):
        number, component = layout.frame_of(parameter) if parameter.kind == "base" else (0, 0)
        if component >= 3:
            found[k] = _turns(problem, number, bases[number])[component - 3]
    return found


def _turns(problem: Problem, number: int, base: Array) -> Array:
    """Return the three angles (3,) of a base at a pose (4, 4)."""
    return np.asarray(-rigid.rpy_of(base[:3, :3].T @ problem.reference.bases[number, :3, :3]))


def _reflected(rows: _Lengths, kind: ParameterKind, at: Machine) -> dict[int, Array]:
    """Return where bases, tools or targets (4, 4) are behind the planes of their lengths' ends, by number."""
    found = {}
    for number, own in numbered({"base": rows.setup, "tool": rows.tool, "target": rows.target}[kind]):
        if kind == "base":
            base = at.frames.bases[number]
            # Anchors that are in no plane tell the side; a search may have ended on the wrong one all the same.
            across = _plane(rows.targets[own, :3, 3], nearest=True)
            along = _plane((rigid.inverse(base) @ rows.tools[own])[:, :3, 3])
            if across is not None and along is not None:
                found[number] = across @ base @ along
        elif (across := _plane(rows.ends(kind)[own])) is not None:
            frame = rows.targets[own[0]] if kind == "target" else np.eye(4)
            place = rigid.translation((across @ frame)[:3, 3])
            found[number] = place if kind == "target" else at.frames.tools[number] @ place
    return found


def _plane(ends: Array, *, nearest: bool = False) -> Array | None:
    """Return the mirror (4, 4) at the plane of points (n, 3), or ``nearest`` to them; None where there is none."""
    middle = ends.mean(axis=0)
    if len(ends) < 3:
        return None
    _, sizes, Vt = svd(triangle(ends - middle))
    return mirror(Vt[-1], middle) if nearest or sizes[-1] <= _FLAT * sizes[-2] else None


def _by_lengths(rows: _Lengths, kind: ParameterKind, asked: set[int]) -> set[int]:
    """Return which of the tools, or targets, ``asked`` for are at two places."""
    ends, twice = rows.ends(kind), set()
    for number, own in numbered(rows.target if kind == "target" else rows.tool):
        here = rows.targets[own[0], :3, 3] if kind == "target" else np.zeros(3)
        if number in asked and _at_two_places(here, ends[own], rows.residual[own], rows.sigma[own]):
            twice.add(number)
    return twice


def _rows(problem: Problem, at: Machine, sigmas: Sequence[Array]) -> _Lengths | None:
    found, rates = [], None
    for data, sigma in zip(problem.measurements, sigmas, strict=True):
        if data.kind not in _LENGTHS:
            continue
        rates = rates or problem.rates(at, scales(problem.parameters), problem.split)
        for block in rates.blocks(data):
            target = data.target[block.rows]
            tools, r = block.moved[0].placed, block.observed.residual[:, 0]
            found.append(
                _Lengths(
                    data.setup[block.rows],
                    data.tool[block.rows],
                    target,
                    tools,
                    at.frames.targets[target],
                    r,
                    sigma[block.rows, 0],
                )
            )
    return _Lengths(*(np.concatenate(parts) for parts in zip(*found, strict=True))) if found else None


def _told_otherwise(problem: Problem, kind: ParameterKind) -> set[int]:
    """Return the tools, or targets, by number, of which more tells than lengths to one point."""
    return {t for data in problem.measurements if data.kind not in _LENGTHS for t in frames_in(data, kind)}


def _related(problem: Problem) -> set[int]:
    """Return the targets, by number, between which something is known."""
    names = problem.measurements[0].targets
    return {names.index(name) for name in related_targets(problem.relations)}


def _at_two_places(here: Array, ends: Array, residual: Array, sigma: Array) -> bool:
    """Return whether another place than ``here`` (3,) explains lengths from it to their ``ends`` (n, 3) as well.

    It is sought from behind the plane that is nearest to the ends.
    """
    if len(ends) < 3:
        return False
    lengths = np.linalg.norm(here - ends, axis=1) + residual

    def look(place: Array) -> tuple[Array, Array]:
        apart = place - ends
        reach = np.linalg.norm(apart, axis=1)
        return (lengths - reach) / sigma, -apart / (np.maximum(reach, _NO_STEP) * sigma)[:, None]

    middle = ends.mean(axis=0)
    normal = np.asarray(svd(triangle(ends - middle))[2][-1], dtype=np.float64)
    other = here - 2.0 * ((here - middle) @ normal) * normal
    near, there = (_least(look, place, lambda place, step: place + step) for place in (here, other))
    return _explains_as_well(look, near, there, there - near)


def _turned_alike(target: Photographed) -> bool:
    """Return whether a frame explains its photographs as well turned the other way."""
    near, there = (_least(target.look, pose, _twisted) for pose in (target.here, target.there))
    apart = rigid.inverse(near) @ there
    return _explains_as_well(target.look, near, there, np.append(apart[:3, 3], rigid.log3(apart[:3, :3])))


def _least(look: _Look, place: Array, moved: Callable[[Array, Array], Array]) -> Array:
    """Return the place with the least squares to which Gauss-Newton steps lead.

    From where the fit has it, they lead elsewhere if the fit weighs rows otherwise: by how those of a photograph err
    together, or by where a base was expected.
    """
    r, J = look(place)
    for _ in range(_STEPS):
        step = np.asarray(np.linalg.lstsq(J, -r, rcond=None)[0], dtype=np.float64)
        ahead = moved(place, step)
        new_r, new_J = look(ahead)
        if not new_r @ new_r < r @ r or np.linalg.norm(step) < _NO_STEP:
            break
        place, r, J = ahead, new_r, new_J
    return place


def _explains_as_well(look: _Look, here: Array, there: Array, apart: Array) -> bool:
    """Return whether what is seen allows a place there, ``apart`` from here by more than is told of here."""
    (r, J), (other, _) = look(here), look(there)
    told = J @ apart
    return bool(other @ other < r @ r + LIKELY and told @ told > _APART)


def _twisted(pose: Array, twist: Array) -> Array:
    return np.asarray(pose @ rigid.placement(rigid.exp3(twist[3:]), twist[:3]))
