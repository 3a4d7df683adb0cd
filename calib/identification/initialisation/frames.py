"""Start values of all frames, in closed form, for the nominal robot.

Base and tools come from positions and poses, where there are any
(:mod:`calib.identification.initialisation.base_and_tools`), and from images
(:mod:`calib.identification.initialisation.cameras`); other tool points from turning in a socket or about a ball's
centre; targets from where the nominal robot puts the tool (:mod:`calib.identification.initialisation.target_poses`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation import cameras
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools
from calib.identification.initialisation.target_poses import NEGLIGIBLE, with_targets
from calib.identification.machine import Frames
from calib.measurement.measurements import Measurements

# More rows than these do not make a start better; of every tool and target at least a few are taken.
_ENOUGH, _FEW = 10_000, 100


class Initialisation(NamedTuple):
    """Frames to start from, and the tools (k,) of which some direction does not show in the nominal robot's poses."""

    frames: Frames
    unshown: BoolArray


def initialise(model: ErrorModel, sets: Sequence[Measurements]) -> Initialisation:
    """Return base, tools and targets that explain sets with common names best with the nominal robot.

    What is fixed or known stays as given.
    """
    given = model.given_frames(sets[0].tools)
    sets = [_thinned(data) for data in sets]
    tips = [data.tips(model.robot) for data in sets]
    base, tools, placed = given.base, given.tools, np.zeros(len(given.tools), dtype=np.bool_)
    unshown = np.zeros_like(placed)
    seen = [(data, T, data.position) for data, T in zip(sets, tips, strict=True) if data.position is not None]
    if seen:
        rows = TipObservations(
            np.concatenate([T for _, T, _ in seen]),
            np.concatenate([position for _, _, position in seen]),
            np.concatenate([_orientation(data) for data, _, _ in seen]),
            np.concatenate([data.tool for data, _, _ in seen]),
        )
        known = KnownFrames(
            given.base if model.base == "fixed" else None,
            given.tools[:, :3, 3] if model.tool == "fixed" else None,
            None if model.tool == "pose" else given.tools[:, :3, :3],
        )
        base, tools, shown = base_and_tools(rows, known, given.tools)
        placed[rows.tool] = True
        unshown = placed & ~shown
    if any(data.camera is not None for data in sets):
        base, tools, by_cameras = cameras.place_tools(model, sets, tips, base, tools, turned(sets, ("pose",)))
        placed |= by_cameras
    if model.tool != "fixed" and not placed.all():
        tools = _turned_in_sockets(model, sets, tips, base, tools, placed)
    return Initialisation(with_targets(model, sets, tips, Frames(base, tools)), unshown)


def initial_frames(model: ErrorModel, sets: Sequence[Measurements]) -> Frames:
    """Return the frames of :func:`initialise`."""
    return initialise(model, sets).frames


def is_fit(sets: Sequence[Measurements]) -> bool:
    """Return whether the start is the least-squares fit of the frames already: of positions that weigh alike it is."""
    data = sets[0]
    return len(sets) == 1 and data.kind == "position" and len(data) <= _ENOUGH and bool(np.ptp(data.sigma) == 0.0)


def _thinned(data: Measurements) -> Measurements:
    """Return as many rows as a start needs: some of every tool at every target, evenly from first to last."""
    step = -(-len(data) // _ENOUGH)
    if step == 1 or data.camera is not None:  # the marks of an image stay together
        return data
    order = np.lexsort((data.target, data.tool))
    tool, target = data.tool[order], data.target[order]
    first = np.concatenate([[True], (np.diff(tool) != 0) | (np.diff(target) != 0)])
    number = np.arange(len(order))
    number -= np.maximum.accumulate(np.where(first, number, 0))
    return data.subset(np.sort(order[(number % step == 0) | (number < _FEW)]))


def turned_by(data: Measurements) -> bool:
    """Return whether the rows show how tools are turned."""
    return data.kind == "pose" or (data.camera is not None and (data.of_boards or data.camera.camera_on == "tip"))


def turned(sets: Sequence[Measurements], kinds: Sequence[str] = ("pose", "pixels")) -> BoolArray:
    """Return the tools (k,) whose orientation shows in sets of some kinds with common names."""
    found = np.zeros(len(sets[0].tools), dtype=np.bool_)
    for data in sets:
        if data.kind in kinds and turned_by(data):
            found[data.tool] = True
    return found


def _orientation(data: Measurements) -> Array:
    return np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation


def _turned_in_sockets(
    model: ErrorModel, sets: Sequence[Measurements], tips: Sequence[Array], base: Array, tools: Array, placed: BoolArray
) -> Array:
    """Return the tools with those points that are not ``placed`` found by turning about points that stay.

    A point p that stays at c while the tip turns obeys R_n p + t_n = c: linear in both. A ball that is touched all
    around keeps its centre on average, which is near enough for a start.
    """
    rows, right = [], []
    k, m = len(tools), len(sets[0].targets)
    for data, T in zip(sets, tips, strict=True):
        if data.kind not in ("socket", "sphere"):
            continue
        in_world = base @ T
        A = np.zeros((len(data), 3, k + m, 3))
        b = -in_world[:, :3, 3].copy()
        n = np.arange(len(data))
        A[n, :, data.tool] = np.where(placed[data.tool, None, None], 0.0, in_world[:, :3, :3])
        b -= np.where(placed[data.tool, None], (in_world[:, :3, :3] @ tools[data.tool, :3, 3:])[:, :, 0], 0.0)
        for t, name in enumerate(data.targets):
            own = n[data.target == t]
            if name in model.targets:
                b[own] += model.targets[name].pose[:3, 3]
            else:
                A[own, :, k + t] = -np.eye(3)
        rows.append(A.reshape(3 * len(data), -1))
        right.append(b.ravel())
    if not rows:
        return tools
    # What turning does not show, such as the height on an axis that alone turns, stays as guessed.
    guess = np.concatenate([tools[:, :3, 3].ravel(), np.zeros(3 * m)])
    A, b = np.concatenate(rows), np.concatenate(right)
    change = np.linalg.lstsq(A, b - A @ guess, rcond=NEGLIGIBLE)[0]
    points = (guess + change)[: 3 * k].reshape(-1, 3)
    return np.asarray(rigid.placement(tools[:, :3, :3], np.where(placed[:, None], tools[:, :3, 3], points)))
