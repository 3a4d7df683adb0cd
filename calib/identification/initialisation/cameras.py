"""Start values of what cameras saw: tools, base and targets of pixels, for the nominal robot, in closed form.

Every image of a board gives the pose of board and camera to each other
(:mod:`calib.identification.initialisation.resection`); of the board's frame as an instrument's,
:func:`calib.identification.initialisation.base_and_tools.base_and_tools` finds base and tools, as for any tracker of
poses. A single mark that the robot carries past a camera, or the camera past the mark, has one common resection.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import MeasurementError
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools
from calib.identification.initialisation.carried import Carried
from calib.identification.initialisation.resection import (
    camera_pose,
    camera_pose_and_point,
    crossing,
    medians,
    misses,
    not_outlying,
    rays,
    resections,
)
from calib.identification.observations.pixels import marks_seen
from calib.measurement.instruments import Camera
from calib.measurement.measurements import Measurements
from calib.measurement.projection import LEAST_DEPTH, undistort

# So many images at a time, so many times: where a third is tilted to the wrong side, some draw has none of these. And
# how often all are asked again to which side they are.
_FEW, _STARTS, _MOST_TURNS = 4, 20, 5


class TargetRows(NamedTuple):
    """Rows of one set that concern one target: ``rows`` (n,) of ``data``, ``tips`` (n, 4, 4) in one frame."""

    data: Measurements
    camera: Camera
    rows: IntArray
    tips: Array

    @property
    def tool(self) -> IntArray:
        """Which tool is in each row."""
        return self.data.tool[self.rows]

    @property
    def places(self) -> Array:
        """Where the marks are on their boards (n, 3)."""
        return self.data.value[self.rows, 2:]

    @property
    def rays(self) -> Array:
        """Where the marks are seen: unit directions (n, 3) in the camera's frame."""
        return rays(undistort(self.camera.lens, self.data.value[self.rows, :2])[0])


def sights(
    sets: Sequence[Measurements], tips: Sequence[Array], target: int, setup: int | None = None
) -> list[TargetRows]:
    """Return what cameras have to say of one target, set by set; of one set-up alone where one is given."""
    return [
        TargetRows(data, data.camera, rows, T[rows])
        for data, T in zip(sets, tips, strict=True)
        if data.camera is not None
        and len(rows := np.flatnonzero((data.target == target) & (setup is None or data.setup == setup)))
    ]


def place_tools(
    model: ErrorModel,
    carried: Sequence[Carried],
    bases: Array,
    tools: Array,
    turned: BoolArray,
    pointed: BoolArray,
    stands: BoolArray,
) -> tuple[Array, Array, BoolArray]:
    """Return bases (b, 4, 4) and tools (k, 4, 4) as cameras saw them, and which tools they saw.

    Tools that are ``turned`` (k,) have their orientation from elsewhere and stay. Of those ``pointed`` (k,) the
    position is known, which is all that a camera beside the robot needs of a single mark. Bases that stand (b,) stay:
    they are known, or were measured in an instrument's frame. For others the targets that are known are that frame.

    Raises MeasurementError when there are too few marks or poses.
    """
    placed = turned | (model.tool == "fixed")
    seen = np.zeros_like(turned)
    bases, tools, stands = bases.copy(), tools.copy(), stands.copy()
    sets = [rows.data for rows in carried]
    names, everywhere = sets[0].targets, np.broadcast_to(np.eye(4), bases.shape)
    # In the base, or in the link that carries the target.
    tips = [rows.seen(everywhere) for rows in carried]
    # A target is seen from where most of its rows are; one that a link carries, from everywhere.
    everything = [
        (0, name, sights(sets, tips, t))
        if name in sets[0].target_links
        else max(((setup, name, sights(sets, tips, t, setup)) for setup in range(len(bases))), key=_many)
        for t, name in enumerate(names)
    ]
    # The target with the most rows is the best start; others follow from it.
    for setup, name, own in sorted(everything, key=_many, reverse=True):
        of_points = all(sight.camera.camera_on == "floor" and not sight.data.of_boards for sight in own)
        enough = placed | pointed if of_points else placed
        sought = {int(k) for sight in own for k in sight.tool} - set(np.flatnonzero(enough).tolist())
        known = model.targets.get(name)
        at_rest = stands[setup] or name in sets[0].target_links
        if not own or (not sought and (at_rest or known is None)):
            continue
        images = images_of(own)
        if images:
            base_in_target, found = _aligned(model, images, tools)
            for k in sought:
                tools[k] = found[k]
        else:
            base_in_target = _carried(own, name, tools, sought)
        placed[list(sought)] = seen[list(sought)] = True
        if known is not None and not at_rest:
            bases[setup], stands[setup] = known.pose @ base_in_target, True
    return bases, tools, seen


def _many(seen: tuple[int, str, list[TargetRows]]) -> int:
    return sum(len(sight.rows) for sight in seen[2])


def target_pose(name: str, own: Sequence[TargetRows], tools: Array) -> Array:
    """Return the pose (4, 4) of a target, in the frame of the tips, for known tools (k, 4, 4).

    Raises MeasurementError when there are too few marks.
    """
    floor = [sight for sight in own if sight.camera.camera_on == "floor"]
    if floor:
        marks = [(sight.tips @ tools[sight.tool] @ rigid.translation(sight.places))[:, :3, 3] for sight in floor]
        pose = camera_pose(np.concatenate(marks), np.concatenate([sight.rays for sight in floor]))
        if pose is None:
            raise _too_few(own, name)
        return pose
    cameras = [sight.tips @ tools[sight.tool] for sight in own]
    if not any(sight.data.of_boards for sight in own):
        directions = [(T[:, :3, :3] @ sight.rays[:, :, None])[:, :, 0] for T, sight in zip(cameras, own, strict=True)]
        return rigid.translation(crossing(np.concatenate(cameras)[:, :3, 3], np.concatenate(directions)))
    seen = [one.tip @ tools[one.tool] @ rigid.inverse(one.pose) for one in images_of(own)]
    if not seen:
        raise _too_few(own, name)
    # An image with outliers is far off, and the median hardly minds.
    poses = np.stack(seen)
    nearest = rigid.nearest_rotation(np.median(poses[:, :3, :3], axis=0))
    return rigid.placement(nearest, np.median(poses[:, :3, 3], axis=0))


def refuse_behind(own: Sequence[TargetRows], tools: Array, target: Array) -> None:
    """Raise MeasurementError for a mark that a camera saw, and that would be behind it."""
    for sight in own:
        placed, stays = sight.tips @ tools[sight.tool], np.broadcast_to(target, (len(sight.rows), 4, 4))
        cameras, boards = (placed, stays) if sight.camera.camera_on == "tip" else (stays, placed)
        marks = marks_seen(cameras, boards, sight.places)[1]
        behind = marks[:, 2] <= LEAST_DEPTH * np.linalg.norm(marks, axis=1)
        if behind.any():
            line = sight.data.lines[sight.rows[int(np.argmax(behind))]]
            raise MeasurementError(
                f"{sight.data.where}:{line}: the camera saw this mark, but with the nominal robot it is behind the "
                f'camera; are camera_on = "{sight.camera.camera_on}", the lens, the readings and the places on the '
                "board right?"
            )


class Image(NamedTuple):
    """An image of a board: its first row, and the camera's ``pose`` (4, 4) in the board.

    ``other``: the pose that explains it second best; it is ``sure`` where that is clearly worse.
    """

    sight: TargetRows
    row: int
    pose: Array
    other: Array
    sure: bool

    @property
    def row_of_data(self) -> int:
        """Its first row among all rows of its set; ``row`` counts those of its target."""
        return int(self.sight.rows[self.row])

    @property
    def tip(self) -> Array:
        """Where the tip link was (4, 4)."""
        return np.asarray(self.sight.tips[self.row])

    @property
    def tool(self) -> int:
        """Which tool was there."""
        return int(self.sight.tool[self.row])

    @property
    def of_tool(self) -> tuple[Array, Array]:
        """The tool's pose in the frame of the target (4, 4), and the one by the other pose."""
        if self.sight.camera.camera_on == "tip":
            return self.pose, self.other
        return rigid.inverse(self.pose), rigid.inverse(self.other)


def images_of(own: Sequence[TargetRows]) -> list[Image]:
    """Return the images of a board. Those that fit no pose by far as well as most of them are left out."""
    found, missed = every_image(own)
    kept = not_outlying(missed) if found else ()
    return [image for image, good in zip(found, kept, strict=True) if good]


def every_image(own: Sequence[TargetRows]) -> tuple[list[Image], Array]:
    """Return the images (n) of a board that tell a pose, as :func:`images_of`, and how far marks are off it (n,)."""
    found: list[Image] = []
    missed: list[float] = []
    for sight in own if any(sight.data.of_boards for sight in own) else ():
        # One image: the robot stood still, and one tool was there.
        at = np.column_stack([sight.data.readings[sight.rows], sight.tool])
        number = np.unique(at, axis=0, return_inverse=True)[1].ravel()
        order = np.argsort(number, kind="stable")
        image, ends = number[order], np.cumsum(np.bincount(number)).tolist()
        places, b = sight.places[order], sight.rays[order]
        poses, others, told, sure = resections(*(np.split(part, ends[:-1]) for part in (places, b)))
        off = medians(misses(poses[image], places, b), image, len(poses))
        first = order[np.flatnonzero(np.diff(image, prepend=-1))]
        found += [Image(sight, int(first[k]), poses[k], others[k], bool(sure[k])) for k in np.flatnonzero(told)]
        missed += off[told].tolist()
    return found, np.array(missed)


def _aligned(model: ErrorModel, images: Sequence[Image], tools: Array) -> tuple[Array, Array]:
    """Return the base in the target's frame, and the tools, from poses of the tool seen there.

    An image that may be of a board tilted to the other side is taken for what agrees with the others: with those of a
    few images, of some tried, that most agree with.
    """
    both = np.stack([one.of_tool for one in images], axis=1)
    tips, tool = np.stack([one.tip for one in images]), np.array([one.tool for one in images], dtype=np.intp)
    fixed = model.tool == "fixed"
    known = KnownFrames(None, tools[:, :3, 3] if fixed else None, tools[:, :3, :3] if fixed else None)

    def aligned(poses: Array, own: IntArray) -> tuple[Array, Array]:
        seen = TipObservations(tips[own], poses[own, :3, 3], poses[own, :3, :3], tool[own])
        found = base_and_tools(seen, known, tools)
        return found.base, found.tools

    def apart(start: tuple[Array, Array]) -> Array:
        """How far both poses of every image (2, n) are turned from where the tool is then."""
        base, found = start
        turned = np.swapaxes((base @ tips @ found[tool])[:, :3, :3], 1, 2) @ both[:, :, :3, :3]
        return np.asarray(np.linalg.norm(rigid.log3(turned), axis=2))

    every, sure = np.arange(len(images)), np.array([one.sure for one in images])
    poses, chosen = both[0], np.zeros(len(images), dtype=np.intp)
    start = aligned(poses, every)
    if not sure.all():
        few = [np.sort(own) for own in _subsets(len(images))] if len(np.unique(tool)) == 1 else []
        starts = [start, *(aligned(poses, own) for own in few)]
        start = min(starts, key=lambda one: float(np.median(apart(one).min(axis=0))))
        for _ in range(_MOST_TURNS):
            before, chosen = chosen, np.where(sure, 0, np.argmin(apart(start), axis=0))
            poses = both[chosen, every]
            start = aligned(poses, every)
            if np.array_equal(chosen, before):
                break
    base, found = start
    # An image that is read wrongly is by far off the others.
    T = rigid.inverse(base @ tips @ found[tool]) @ poses
    lengths, angles = rigid.lengths_and_angles(T)
    kept = not_outlying(model.robot.reach * angles) & not_outlying(lengths)
    return start if kept.all() else aligned(poses, np.flatnonzero(kept))


def _subsets(n: int) -> list[IntArray]:
    """Return some few of n images at a time, the same ones each time."""
    rng = np.random.default_rng(n)
    return [rng.choice(n, _FEW, replace=False) for _ in range(_STARTS)] if n > _FEW else []


def _carried(own: Sequence[TargetRows], name: str, tools: Array, sought: set[int]) -> Array:
    """Place the tools that are ``sought`` by single marks, and return the base in the target's frame."""
    base_in_target = np.eye(4)
    for k in sorted({int(k) for sight in own for k in sight.tool}):
        mine = [(sight, np.flatnonzero(sight.tool == k)) for sight in own]
        on_tip = any(sight.camera.camera_on == "tip" for sight in own)
        tips = np.concatenate([sight.tips[rows] for sight, rows in mine])
        if any(sight.data.of_boards for sight in own):
            raise _too_few(own, name)
        found = camera_pose_and_point(
            rigid.inverse(tips) if on_tip else tips, np.concatenate([sight.rays[rows] for sight, rows in mine])
        )
        if found is None:
            raise _too_few(own, name)
        camera, point = found
        base_in_target = rigid.translation(-point) if on_tip else rigid.inverse(camera)
        if k in sought:
            tools[k] = camera if on_tip else rigid.placement(tools[k, :3, :3], point)
    return base_in_target


def _too_few(own: Sequence[TargetRows], name: str) -> MeasurementError:
    needed = (
        "one image with four marks that are not on a line, or six that are not in a plane"
        if any(sight.data.of_boards for sight in own)
        else "six poses that are not on a line"
    )
    return MeasurementError(
        f"{own[0].data.where}: the camera saw too little to tell where the target {name!r} is; needed are {needed}."
    )
