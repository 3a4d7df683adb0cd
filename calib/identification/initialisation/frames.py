"""Start values of all frames, in closed form, for the nominal robot.

Bases and tools come from positions and poses, where there are any
(:mod:`calib.identification.initialisation.base_and_tools`), and from images
(:mod:`calib.identification.initialisation.cameras`); other tool points from turning in a socket or about a ball's
centre; targets from where the nominal robot puts the tool (:mod:`calib.identification.initialisation.target_poses`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray, number_in_kind
from calib.foundations.errors import MeasurementError
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation import cameras
from calib.identification.initialisation.base_and_tools import (
    KnownFrames,
    TipObservations,
    base_and_tools,
    points_together,
)
from calib.identification.initialisation.carried import Carried
from calib.identification.initialisation.known_planes import base_by_planes, planes_seen, planes_show_all
from calib.identification.initialisation.lenses import with_found_lenses
from calib.identification.initialisation.target_poses import NEGLIGIBLE, centre, other_side, with_targets
from calib.identification.initialisation.touched_balls import touched_with
from calib.identification.machine import Frames, Machine
from calib.measurement.kinds import Kind
from calib.measurement.measurements import Measurements, numbered
from calib.measurement.scalars import Scalar
from calib.robot.robot import Deviations

# More rows than these do not make a start better; of every tool and target at least a few are taken.
_ENOUGH, _FEW = 10_000, 100
# Tools and bases are found in turns; a start need not be better.
_ROUNDS, _CLOSE = 10, 1e-4
# A base is shown by so many places of sockets, anchors or balls, and one of the last two by so many lengths.
_LEAST_PLACES, _LEAST_LENGTHS = 3, 6
# What the base as given weighs, in m^2 beside the spread of places: it stays where nothing else tells. It stays as a
# whole unless so few places are missed clearly less, in squares, with another one.
_GIVEN, _CLEARLY = 1e-6, 0.25


class Initialisation(NamedTuple):
    """Frames to start from, and the tools (k,) of which some direction does not show in the nominal robot's poses."""

    frames: Frames
    unshown: BoolArray


def initialise(model: ErrorModel, sets: Sequence[Measurements], begun: Machine | None = None) -> Initialisation:
    """Return bases, tools and targets that explain sets with common names best with the nominal robot.

    What is fixed or known stays as given, a base with a prior where the prior has it. ``begun``: a machine whose robot
    is taken in the place of the nominal one, and whose set-ups, tools and scalars, the first of the names, stay; but
    tools that balls or lengths alone tell may be clearly better elsewhere.

    Raises MeasurementError where nothing shows where the base of a set-up is.
    """
    known = None if begun is None else _values(sets[0].scalars, begun.frames.scalars)
    sets = [_thinned(data) for data in with_found_lenses(sets, known)]
    if begun is None and model.robot.terms:
        # Those of the nominal robot add nothing, and may be a thousand.
        model = replace(model, robot=replace(model.robot, terms=(), weights=None))
    carried = [_carried(model, data, None if begun is None else begun.deviations) for data in sets]
    tips = [rows.tips for rows in carried]
    at = _Placed.of(model, sets[0], None if begun is None else begun.frames)
    unshown = np.zeros(len(at.tools), dtype=np.bool_)
    seen = [
        (data, _at_points(T, data, at.tools), data.position)
        for data, T in zip(sets, tips, strict=True)
        if data.position is not None
    ]
    if seen:
        rows = TipObservations(
            np.concatenate([T for _, T, _ in seen]),
            np.concatenate([position for _, _, position in seen]),
            np.concatenate([_orientation(data) for data, _, _ in seen]),
            np.concatenate([data.tool for data, _, _ in seen]),
        )
        at, unshown = _by_positions(model, rows, np.concatenate([data.setup for data, _, _ in seen]), at)
    if any(data.camera is not None for data in sets):
        bases, tools, by_cameras = cameras.place_tools(
            model,
            carried,
            at.bases,
            at.tools,
            turned(sets, ("pose",)) | at.begun,
            at.placed & ~unshown,
            at.stands,
        )
        at = at._replace(bases=bases, tools=tools, placed=at.placed | by_cameras)
    if model.tool != "fixed" and not at.placed.all():
        at = at._replace(tools=_turned_in_sockets(model, carried, at))
    if model.tool != "fixed":
        at = at._replace(tools=_touched(model, carried, at))
    if not at.stands.all():
        at = _by_targets(model, carried, at)
    return Initialisation(with_targets(model, carried, Frames(at.bases, at.tools)), unshown)


def _at_points(tips: Array, data: Measurements, tools: Array) -> Array:
    """Return tips (N, 4, 4) moved by where the rows' points are beside the tool's own, tools turned as in ``tools``."""
    if data.points is None:
        return tips
    moved = tips.copy()
    moved[:, :3, 3:] += tips[:, :3, :3] @ tools[data.tool, :3, :3] @ data.points[:, :, None]
    return moved


def _values(scalars: Sequence[Scalar], values: Array) -> dict[str, float]:
    """Return values (s,) of the first of the scalars, by name."""
    return {one.name: float(value) for one, value in zip(scalars, values, strict=False)}


def _carried(model: ErrorModel, data: Measurements, deviations: Deviations | None) -> Carried:
    robot = model.robot
    seats: dict[str, Array] = {}
    for link in dict.fromkeys(data.target_links[name] for name in data.seen_targets if name in data.target_links):
        seats[link] = rigid.inverse(robot.with_tip(link).tips(data.readings, deviations, data.conditions))
    return Carried(data, data.tips(robot, deviations), seats)


class _Placed(NamedTuple):
    """Bases (b, 4, 4) and which of them stand (b,), tools (k, 4, 4) and which points of them are placed (k,).

    ``begun`` (k,): tools that another calibration has found.
    """

    bases: Array
    stands: BoolArray
    tools: Array
    placed: BoolArray
    begun: BoolArray

    @classmethod
    def of(cls, model: ErrorModel, names: Measurements, begun: Frames | None) -> "_Placed":
        """Return what is known before anything was looked at."""
        given = model.given_frames(names.tools, names.setups)
        bases, tools = given.bases.copy(), given.tools.copy()
        stands = np.array([model.known_base(setup) is not None for setup in names.setups])
        placed = np.zeros(len(tools), dtype=np.bool_)
        if begun is not None:
            bases[: len(begun.bases)], stands[: len(begun.bases)] = begun.bases, True
            tools[: len(begun.tools)], placed[: len(begun.tools)] = begun.tools, True
        return cls(bases, stands, tools, placed, placed.copy())


def _by_positions(model: ErrorModel, rows: TipObservations, setup: IntArray, at: _Placed) -> tuple[_Placed, BoolArray]:
    """Place bases and tools by positions and poses in the instrument's frame, the set-up of most rows first.

    Returned with it: tools (k,) of which some direction does not show.
    """
    bases, tools, stands, placed = at.bases.copy(), at.tools.copy(), at.stands.copy(), at.placed.copy()
    unshown = np.zeros_like(placed)
    for s in np.argsort(-np.bincount(setup, minlength=len(bases)), kind="stable"):
        own = rows.some(setup == s)
        used = np.unique(own.tool)
        if not len(used):
            continue
        held = model.tool == "fixed" or bool(placed[used].all())
        known = KnownFrames(
            bases[s] if stands[s] else None,
            tools[:, :3, 3] if held else None,
            None if model.tool == "pose" and not held else tools[:, :3, :3],
        )
        bases[s], points, shown = base_and_tools(own, known, tools)
        stands[s] = True
        new = used[~placed[used]]
        tools[new], unshown[new], placed[new] = points[new], ~shown[new], True
    found = at._replace(bases=bases, tools=tools, stands=stands, placed=placed)
    return _together(rows, setup, at.stands, found, unshown) if unshown.any() and len(bases) > 1 else (found, unshown)


def _together(
    rows: TipObservations, setup: IntArray, given: BoolArray, at: _Placed, sought: BoolArray
) -> tuple[_Placed, BoolArray]:
    """Place tools (k,) that no set-up shows by itself where all set-ups that share them show them.

    Returned with it: tools (k,) of which some direction does not show; if there are any, nothing has changed.
    ``given`` (b,): bases that stay.
    """
    bases, tools, shown = at.bases.copy(), at.tools.copy(), ~sought
    for _ in range(_ROUNDS):
        points, shown = points_together(rows, setup, bases, given, tools[:, :3, 3], sought)
        moved = np.abs(points - tools[:, :3, 3]).max()
        tools[:, :3, 3] = points
        for s in np.unique(setup[~given[setup]]):
            known = KnownFrames(None, tools[:, :3, 3], tools[:, :3, :3])
            bases[s] = base_and_tools(rows.some(setup == s), known, tools).base
        if moved < _CLOSE:
            break
    return (at._replace(bases=bases, tools=tools), ~shown) if shown.all() else (at, sought)


def _touched(model: ErrorModel, carried: Sequence[Carried], at: _Placed) -> Array:
    """Return the tools with those that touches of balls, or lengths, alone tell where these put them."""
    sets = [one.data for one in carried]
    tips = [_at_points(one.seen(at.bases), one.data, at.tools) for one in carried]
    known: list[list[Array | None]] = []
    for one in carried:
        names = [one.data.targets[t] if t >= 0 else "" for t in one.data.target]
        told = at.stands[one.data.setup] | one.on_links
        known.append(
            [
                model.targets[name].pose[:3, 3] if there and name in model.targets else None
                for name, there in zip(names, told, strict=True)
            ]
        )
    return touched_with(sets, tips, at.tools, np.flatnonzero(~at.placed | at.begun), known)


def _by_targets(model: ErrorModel, carried: Sequence[Carried], at: _Placed) -> _Placed:
    """Place bases that nothing in an instrument's frame shows, by what is touched or seen from others, or is known."""
    names = carried[0].data
    # What a link carries says nothing of a base.
    links = np.array([*(name in names.target_links for name in names.targets), False])
    there = [rows.some(at.stands[rows.data.setup] & ~links[rows.data.target]) for rows in carried]
    frames = with_targets(model, there, Frames(at.bases, at.tools))
    told = {name for rows in there for name in rows.data.seen_targets} | set(model.targets)
    shown = np.array([name in told and name not in names.target_links for name in names.targets], dtype=np.bool_)
    bases, stands = at.bases.copy(), at.stands.copy()
    for s in np.flatnonzero(~stands):
        found = [
            _as_positions(rows, frames, (rows.data.setup == s) & shown[rows.data.target])
            for rows in carried
            if rows.data.kind in ("socket", "pixels")
        ]
        # Lengths of an arm that moves in a plane put anchors on either side of it.
        sides = [
            TipObservations(*(np.concatenate(parts) for parts in zip(*found, centres, strict=True)))
            for centres in _centres(carried, frames, shown, int(s))
        ]
        every = sides[0]
        if not len(every.tips) or (np.isnan(every.orientation).any() and _places(every) < _LEAST_PLACES):
            touched = [rows.some(rows.data.setup == s) for rows in carried]
            planes, placed = planes_seen(model, touched, at.tools), len(every.tips) > 0
            if not stands.any() or not _needs_base(carried, int(s)) or planes_show_all(planes, placed=placed):
                # Where too little is known to place any base, it begins as given but for what a place or two, and
                # known planes, tell of it, and the null space says so.
                near = _by_places(model, touched, sides, at.tools, bases[s])
                bases[s] = base_by_planes(planes, near)
                stands[s] = True
                continue
            tables = dict.fromkeys(rows.data.where for rows in carried if np.any(rows.data.setup == s))
            raise MeasurementError(
                f"{', '.join(tables)}: nothing shows where the base is in the set-up {names.setups[s]!r}: measure "
                "positions there, or three sockets whose places are known or found from another set-up, or planes of "
                "known heights in three directions, or give its pose."
            )
        known = KnownFrames(None, at.tools[:, :3, 3], at.tools[:, :3, :3])
        tried = [base_and_tools(some, known, at.tools).base for some in sides]
        bases[s] = tried[
            int(np.argmin([_missed(some, base, at.tools) for some, base in zip(sides, tried, strict=True)]))
        ]
        stands[s] = True
    return at._replace(bases=bases, stands=stands)


def _moved_onto(rows: TipObservations, base: Array, tools: Array) -> tuple[float, Array]:
    """Return the base (4, 4) moved by no more than takes tools to their positions, and how these are missed then."""
    if not len(rows.tips):
        return 0.0, base
    x, y = (rows.tips @ tools[rows.tool])[:, :3, 3], rows.position
    R = rigid.nearest_rotation((y - y.mean(axis=0)).T @ (x - x.mean(axis=0)) + _GIVEN * base[:3, :3])
    found = rigid.placement(R, y.mean(axis=0) - R @ x.mean(axis=0))
    return _missed(rows, found, tools), found


def _by_places(
    model: ErrorModel, carried: Sequence[Carried], sides: Sequence[TipObservations], tools: Array, base: Array
) -> Array:
    """Return the base (4, 4) as the few places that are known, on some of ``sides``, have it, or as given.

    With a tool that is unknown yet, and by the nominal arm, lengths show places within some cm alone: a base that was
    given better than that stays. ``carried``: rows of its set-up.
    """
    found = min((_moved_onto(some, base, tools) for some in sides), key=lambda each: each[0])[1]
    given, moved = (sum(_off_places(model, rows, tools, at) for rows in carried) for at in (base, found))
    return found if moved < _CLEARLY * given else base


def _off_places(model: ErrorModel, carried: Carried, tools: Array, base: Array) -> float:
    """Return the sum of squares by which rows miss known sockets, and lengths to other known places."""
    data = carried.data
    if data.kind not in ("socket", "distance", "sphere"):
        return 0.0
    known = np.array([data.link_of(t) is None and name in model.targets for t, name in enumerate(data.targets)])
    own = known[data.target]
    places = np.array([model.targets[data.targets[t]].pose[:3, 3] for t in data.target[own]]).reshape(-1, 3)
    points = (base @ carried.tips @ data.placed_by(tools))[own, :3, 3]
    lengths = 0.0 if data.kind == "socket" else data.value[own, 0]
    return float(np.sum((np.linalg.norm(points - places, axis=1) - lengths) ** 2))


def _missed(rows: TipObservations, base: Array, tools: Array) -> float:
    """Return the sum of squares by which positions are missed with a base."""
    return float(np.sum(((base @ rows.tips @ tools[rows.tool])[:, :3, 3] - rows.position) ** 2))


def _needs_base(carried: Sequence[Carried], setup: int) -> bool:
    """Return whether some row of a set-up is about what stands on the floor."""
    return any(
        data.link_of(int(t)) is None and data.kind != "pair_distance"
        for data in (rows.data for rows in carried)
        for t in np.unique(data.target[data.setup == setup])
    )


def _places(rows: TipObservations) -> int:
    return len(np.unique(rows.position, axis=0))


def _as_positions(carried: Carried, frames: Frames, rows: BoolArray) -> TipObservations:
    """Return rows (N,) at targets that are known as positions of the tool, and images of boards as poses."""
    data, tips = carried.data, carried.tips
    if data.kind == "socket":
        n = np.flatnonzero(rows)
        turned = np.full((len(n), 3, 3), np.nan)
        return TipObservations(tips[n], frames.targets[data.target[n], :3, 3], turned, data.tool[n])
    camera = data.camera
    assert camera is not None, "pixels were seen by a camera"
    images = (
        cameras.images_of([cameras.TargetRows(data, camera, np.flatnonzero(rows), tips[rows])]) if rows.any() else []
    )
    n = np.array([one.row_of_data for one in images], dtype=np.intp)
    poses = [one.of_tool[0] for one in images]
    placed = frames.targets[data.target[n]] @ np.array(poses).reshape(-1, 4, 4)
    return TipObservations(tips[n], placed[:, :3, 3], placed[:, :3, :3], data.tool[n])


def _centres(carried: Sequence[Carried], frames: Frames, shown: BoolArray, setup: int) -> list[TipObservations]:
    """Return anchors and balls that are ``shown`` (t,) as positions of a tool, put in the base by their lengths.

    Where these fit on either side of a plane, on sides as apart as is known, and all on the other side as well.
    """
    places, others, positions, tools = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), list[int]()
    for t in np.flatnonzero(shown):
        own = [
            rows.some((rows.data.target == t) & (rows.data.setup == setup))
            for rows in carried
            if rows.data.kind in ("distance", "sphere")
        ]
        own = [rows for rows in own if len(rows.tips)]
        if sum(len(rows.tips) for rows in own) < _LEAST_LENGTHS:
            continue
        about = [
            (rows.data, (rows.tips @ rows.data.placed_by(frames.tools))[:, :3, 3], rows.data.value) for rows in own
        ]
        place = centre(about)
        places, others = np.vstack([places, place]), np.vstack([others, other_side(about, place)])
        positions = np.vstack([positions, frames.targets[t, :3, 3]])
        tools.append(int(own[0].data.tool[0]))
    number, turned = np.array(tools, dtype=np.intp), np.full((len(tools), 3, 3), np.nan)
    return [
        TipObservations(rigid.translation(x - frames.tools[number, :3, 3]), positions, turned, number)
        for x in _on_sides(places, others, positions)
    ]


def _on_sides(places: Array, others: Array, positions: Array) -> tuple[Array, ...]:
    """Return places, or the ``others`` (n, 3) of them, that are as far apart as positions are; and all the others."""
    taken, done = np.zeros(len(places), dtype=np.bool_), list[int]()
    found = places.copy()
    for k in np.argsort(-np.linalg.norm(places - others, axis=1), kind="stable"):
        apart = np.linalg.norm(positions[done] - positions[k], axis=1)
        here, there = (np.sum((np.linalg.norm(found[done] - x[k], axis=1) - apart) ** 2) for x in (places, others))
        taken[k] = there < here
        found[k] = others[k] if taken[k] else places[k]
        done.append(int(k))
    if np.array_equal(places, others):
        return (found,)
    return found, np.where(taken[:, None], places, others)


def initial_frames(model: ErrorModel, sets: Sequence[Measurements]) -> Frames:
    """Return the frames of :func:`initialise`."""
    return initialise(model, sets).frames


def is_fit(sets: Sequence[Measurements]) -> bool:
    """Return whether the start is the least-squares fit of the frames already: of positions that weigh alike it is."""
    data = sets[0]
    # A clock's start is no least-squares fit, nor is that of a tool whose turn only points beside it show.
    alone = len(sets) == len(data.setups) == 1 and not data.uses and data.points is None
    return alone and data.kind == "position" and len(data) <= _ENOUGH and bool(np.ptp(data.sigma) == 0.0)


def _thinned(data: Measurements) -> Measurements:
    """Return as many rows as a start needs: some of every tool at every target, evenly from first to last."""
    step = -(-len(data) // _ENOUGH)
    if step == 1 or data.camera is not None:  # the marks of an image stay together
        return data
    number = number_in_kind(data.tool, data.target)
    return data.subset((number % step == 0) | (number < _FEW))


def turned_by(data: Measurements) -> bool:
    """Return whether the rows show how tools are turned."""
    if data.points is not None and np.any(data.points != 0.0):
        return True
    return data.kind == "pose" or (data.camera is not None and (data.of_boards or data.camera.camera_on == "tip"))


def turned(sets: Sequence[Measurements], kinds: Sequence[str] = get_args(Kind)) -> BoolArray:
    """Return the tools (k,) whose orientation shows in sets of some kinds with common names."""
    found = np.zeros(len(sets[0].tools), dtype=np.bool_)
    for data in sets:
        if data.kind in kinds and turned_by(data):
            found[data.tool] = True
    return found


def _orientation(data: Measurements) -> Array:
    return np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation


def _turned_in_sockets(model: ErrorModel, carried: Sequence[Carried], at: _Placed) -> Array:
    """Return the tools with those points that are not ``placed`` found by turning about points that stay.

    A point p that stays at c while the tip turns obeys R_n p + t_n = c: linear in both. A ball that is touched all
    around keeps its centre on average, which is near enough for a start. What stays is known only where the base is:
    elsewhere it is another unknown in the base of every set-up.
    """
    rows, right, stays = [], [], []
    tools, placed = at.tools, at.placed
    k, m = len(tools), len(carried[0].data.targets)
    # Of tools in whose frame points differ from row to row, the rotation is sought as well, as a free matrix.
    turning = ~placed & turned([one.data for one in carried], ("socket", "sphere")) & (model.tool == "pose")
    for one in carried:
        data = one.data
        if data.kind not in ("socket", "sphere"):
            continue
        in_world = one.seen(at.bases)
        n, R = np.arange(len(data)), in_world[:, :3, :3]
        A = np.zeros((len(data), 3, 4 * k, 3))
        b = -in_world[:, :3, 3].copy()
        A[n, :, data.tool] = np.where(placed[data.tool, None, None], 0.0, R)
        b -= np.where(placed[data.tool, None], (R @ tools[data.tool, :3, 3:])[:, :, 0], 0.0)
        if data.points is not None:
            sought = turning[data.tool]
            for axis in range(3):
                A[n, :, k + 3 * data.tool + axis] = np.where(sought, data.points[:, axis], 0.0)[:, None, None] * R
            b -= np.where(sought[:, None], 0.0, (R @ tools[data.tool, :3, :3] @ data.points[:, :, None])[:, :, 0])
        stands = at.stands[data.setup] | one.on_links
        known = np.array([name in model.targets for name in data.targets], dtype=np.bool_)[data.target] & stands
        for t in np.unique(data.target[known]):
            b[known & (data.target == t)] += model.targets[data.targets[t]].pose[:3, 3]
        rows.append(A.reshape(len(data), 3, -1))
        right.append(b)
        stays.append(np.where(known, -1, np.where(stands, 0, m * (1 + data.setup)) + data.target))
    if not rows:
        return tools
    every, values = np.concatenate(rows), np.concatenate(right)
    # What stays is anywhere: it takes up the mean of the rows about it.
    for which, own in numbered(np.concatenate(stays)):
        if which >= 0:
            every[own] -= every[own].mean(axis=0)
            values[own] -= values[own].mean(axis=0)
    # What turning does not show, such as the height on an axis that alone turns, stays as guessed.
    guess = np.concatenate([tools[:, :3, 3].ravel(), np.zeros(9 * k)])
    equations = every.reshape(-1, every.shape[2])
    change = np.linalg.lstsq(equations, values.ravel() - equations @ guess, rcond=NEGLIGIBLE)[0]
    points = (guess + change)[: 3 * k].reshape(-1, 3)
    # Columns of the matrix stand one after the other; a scanner sees two of them, and these tell the third.
    matrices = np.swapaxes(change[3 * k : 12 * k].reshape(-1, 3, 3), -1, -2)
    rotations = np.where(turning[:, None, None], rigid.nearest_rotation(matrices), tools[:, :3, :3])
    return np.asarray(rigid.placement(rotations, np.where(placed[:, None], tools[:, :3, 3], points)))
