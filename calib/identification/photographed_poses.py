"""What photographs of boards show as measured poses of the tool, in which mistakes are sought as in any other poses."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, read_only, read_only_view
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.base_and_tools import TipObservations, poses_off
from calib.identification.initialisation.cameras import every_image, sights
from calib.identification.initialisation.lenses import with_found_lenses
from calib.measurement.instruments import CameraPlace
from calib.measurement.measurements import Measurements, reach_of

# How many photographs at most may stray, as a share, and how many at least must agree.
_MOST_STRAY, _LEAST_AGREEING = 0.34, 6
# Trials, and the photographs of each, for every tool: where a third strays, one trial in eleven has none of them.
_TRIALS, _TRIED = 40, 6
# A stray photograph is farther off than so many times the median, and than so much of the reach.
_FARTHER, _FAR = 8.0, 0.02


class Strays(NamedTuple):
    """Photographs that the others contradict: by name, and how far off in m and rad."""

    names: tuple[str, ...]
    lengths: Array
    angles: Array


def poses_seen(
    model: ErrorModel, sets: Sequence[Measurements]
) -> tuple[ErrorModel, list[Measurements], CameraPlace | None]:
    """Return what sets saw of the board, or from the camera beside the robot, that most rows are about, as poses.

    These are poses of the tool in the frame of the board or of the camera that stands still, a row for each photograph,
    and in the model of them the base is free. Sets that show no such poses are left out. Last, where the camera is said
    to be; None where there are no photographs of boards.

    Raises MeasurementError where photographs do not tell a lens of which nothing is known.
    """
    boards = [data for data in sets if data.of_boards]
    rows = Counter[str]()
    for data in boards:
        rows.update({name: np.count_nonzero(data.target == t) for t, name in enumerate(data.targets)})
        rows = Counter({name: count for name, count in rows.items() if name not in data.target_links})
    if not rows:
        return model, [], None
    (target, _), *_ = rows.most_common(1)
    boards = [data for data in with_found_lenses(boards) if target in data.targets]
    found = [_poses(data, target).with_own_names() for data in boards]
    free = replace(
        model, base="pose", tool="fixed" if model.tool == "fixed" else "pose", setups={}, targets={}, relations=()
    )
    place = next(data.camera.camera_on for data in boards if data.camera is not None)
    return free, [data for data in found if len(data)], place


def _poses(data: Measurements, target: str) -> Measurements:
    """Return the poses of the tool that photographs of one set show, in the frame of a target."""
    nowhere = np.broadcast_to(np.eye(4), (len(data), 4, 4))
    images, _ = every_image(sights([data], [nowhere], data.targets.index(target)))
    found = data.subset(np.array([one.row_of_data for one in images], dtype=np.intp))
    T = np.array([one.of_tool[0] for one in images]).reshape(-1, 4, 4)
    n = len(images)
    return replace(
        found,
        kind="pose",
        position=read_only(T[:, :3, 3]),
        orientation=read_only(T[:, :3, :3]),
        value=read_only(np.zeros((n, 0))),
        sigma=read_only(np.zeros((n, 6))),
        targets=(),
        target=read_only_view(np.full(n, -1, dtype=np.intp)),
        scalars=(),
        uses={},
        camera=None,
        board=None,
        mark=None,
    )


def strays(model: ErrorModel, sets: Sequence[Measurements]) -> Strays | None:
    """Return the few photographs, of poses of sets with common names, that all others contradict; None where none are.

    Base and tools are found from few photographs at a time, and those taken that agree best with most of the others.
    """
    every = TipObservations(
        np.concatenate([data.tips(model.robot) for data in sets]),
        np.concatenate([data.position for data in sets if data.position is not None]),
        np.concatenate([data.orientation for data in sets if data.orientation is not None]),
        np.concatenate([data.tool for data in sets]),
    )
    n, tools = len(every.tips), len(sets[0].tools)
    if n < 2 * _LEAST_AGREEING:
        return None
    rng, reach = np.random.default_rng(0), reach_of(model.robot, sets)
    kept = min(
        (rng.permutation(n)[: _TRIED * tools] for _ in range(_TRIALS)),
        key=lambda rows: float(np.median(_far(*poses_off(every, rows, tools), reach))),
    )
    for _ in range(3):
        lengths, angles = poses_off(every, kept, tools)
        far = _far(lengths, angles, reach)
        good = far <= max(_FARTHER * float(np.median(far)), _FAR * reach)
        kept = np.flatnonzero(good)
    if good.all() or np.count_nonzero(~good) > _MOST_STRAY * n or np.count_nonzero(good) < _LEAST_AGREEING:
        return None
    names = [name for data in sets for name in (data.group or [f"{data.where}:{line}" for line in data.lines])]
    bad = np.flatnonzero(~good)
    return Strays(tuple(names[k] for k in bad), lengths[bad], angles[bad])


def _far(lengths: Array, angles: Array, reach: float) -> Array:
    return np.hypot(lengths, reach * angles)
