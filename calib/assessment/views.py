"""Which photographs of a board to take next: views that show it, and what each would bring.

A few photographs, taken by hand, say roughly where camera and board are and what the lens is. From then on the plan is
that of any poses (:mod:`calib.assessment.planning`), with the derivatives of pixels by all that is unknown: arm,
camera, board and lens.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.assessment.candidates import Candidates, possible
from calib.assessment.design import DesignRows
from calib.assessment.hand_eye import lens_of, marks_before_camera
from calib.assessment.planning import Plan, planned
from calib.foundations import rigid
from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import drawing
from calib.foundations.choices import MOST_POSES, Criterion
from calib.foundations.errors import JobError
from calib.foundations.linear import one_thread
from calib.foundations.units import DEG
from calib.identification.fit import Fit
from calib.identification.machine import values_at
from calib.identification.parameters import directions, scales
from calib.identification.rows import photograph_numbers
from calib.identification.system import Problem, with_twists
from calib.identification.together import Together
from calib.machine.tool_motion import tool_jacobian, tool_poses
from calib.measurement.measurements import Measurements
from calib.measurement.projection import project
from calib.robot.collision import SelfCollision
from calib.robot.conditions import ordinary

# So many marks stand for all of a board, each for its share of them.
_MARKS = 6
# New views begin at one that is known, moved by so much in a joint, in rad or as a share of its way where it slides.
_AWAY = 0.35
# Farther from or nearer to the board than photographed by these factors, focus and light are others.
_NEARER, _FARTHER = 0.6, 1.6
# As a share of the image's width: so much of its border stays free, as where the board will be is known roughly.
_BORDER = 0.03
# Where so many tries have found none, more of them will not.
_MOST_ROUNDS, _ENOUGH_TRIES = 400, 2000


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Views of a board by a camera, as a ``fit`` of a few photographs knows them. ``most_tilt`` of the board, in rad.

    Raises JobError where the fit has no photographs of a board whose image size is known, or targets on links.
    """

    __repr__ = brief

    fit: Fit
    most_tilt: float = 55.0 * DEG

    def __post_init__(self) -> None:
        own_fields(self)
        if not 0.0 < self.most_tilt < 90.0 * DEG:
            raise JobError(f"most_tilt: {self.most_tilt!r} is not an angle in rad between 0 and pi/2.")
        data = self.photographed
        if data.target_links:
            raise JobError(f"{data.where}: views of boards or cameras on links of the robot are not planned.")

    @property
    def photographed(self) -> Measurements:
        """The first table of photographs."""
        own = (data for data in self.fit.measurements if data.board is not None and data.camera is not None)
        found = next((data for data in own if data.camera is not None and data.camera.size is not None), None)
        if found is None:
            raise JobError("views are planned from photographs of a board, by a camera with the size of its images.")
        return found

    @property
    def working_tool(self) -> int:
        """The number of the tool that is to be accurate."""
        return int(self.photographed.tool[0])

    @checked
    def rows(self, readings: Array) -> DesignRows:
        """Return what a photograph at each of N readings (N, nr) would bring."""
        data, count = self._at(readings)
        number = np.repeat(np.arange(len(readings)), count)
        J = self._whitened(data, self.photographed, number, np.sqrt(count / self._marks_on_board))
        return DesignRows.without_misfit(J.reshape(len(readings), 2 * count, -1))

    def measured_rows(self) -> DesignRows:
        """Return what the photographs of the fit have brought, mark by mark."""
        own = [data for data in self.fit.measurements if data.camera is not None]
        found = [self._whitened(data, data, photograph_numbers(data), 1.0) for data in own]
        return DesignRows.without_misfit(np.concatenate(found))

    @checked
    def working_rows(self, readings: Array) -> DesignRows:
        """Return the motions of the tool's position at N readings, in m, but for those of the whole arm on its base.

        Cameras do not see where the base is, so that no photograph would make that part less.
        """
        by_state = tool_jacobian(
            self.fit.model.robot, self.fit.machine, readings, ordinary(readings), self.working_tool
        )[:, :3]
        J = by_state @ (directions(self.fit.parameters, by_state.shape[2]) * scales(self.fit.parameters))
        points = tool_poses(self.fit.model.robot, self.fit.machine, readings, ordinary(readings), self.working_tool)[
            :, :3, 3
        ]
        turns = -rigid.skew(points - points.mean(axis=0))
        whole = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2).reshape(-1, 6)
        basis = np.linalg.qr(whole)[0]
        flat = J.reshape(len(whole), -1)
        return DesignRows.without_misfit((flat - basis @ (basis.T @ flat)).reshape(J.shape))

    @checked
    def refused(self, readings: Array) -> dict[str, BoolArray]:
        """Return which of N readings give no photograph that is of use, by the reason."""
        data, count = self._at(readings)
        turn, seen = marks_before_camera(self.fit, data)
        camera = data.camera
        assert camera is not None and camera.size is not None, "as photographed"
        own_turn, own = marks_before_camera(self.fit, self.photographed)
        known = np.linalg.norm(own, axis=1)
        distance = np.linalg.norm(seen, axis=1).reshape(-1, count)
        far = (distance.min(axis=1) < _NEARER * known.min()) | (distance.max(axis=1) > _FARTHER * known.max())
        before = (seen[:, 2] > 0.2 * np.linalg.norm(seen, axis=1)).reshape(-1, count).all(axis=1)
        pixels = project(lens_of(self.fit, camera)[0], np.where(seen[:, 2:] > 0.0, seen, [0.0, 0.0, 1.0])).pixels
        border = _BORDER * camera.size[0]
        inside = ((pixels > border) & (pixels < np.array(camera.size) - 1.0 - border)).all(axis=1)
        tilt = np.abs(np.sum(turn[:, :, 2] * seen, axis=1)) / np.linalg.norm(seen, axis=1)
        tilted = (tilt < np.cos(self.most_tilt)).reshape(-1, count).any(axis=1)
        # The side that is printed is the one that was photographed.
        front = np.sign(np.median(np.sum(own_turn[:, :, 2] * own, axis=1)))
        behind = (front * np.sum(turn[:, :, 2] * seen, axis=1) <= 0.0).reshape(-1, count).any(axis=1)
        shown = before & inside.reshape(-1, count).all(axis=1) & ~behind
        return {
            "board not in the image": ~shown,
            "board tilted too far": shown & tilted,
            "board too near or too far": shown & ~tilted & far,
        }

    def _at(self, readings: Array) -> tuple[Measurements, int]:
        """Return what would be measured at N readings: some marks each, and how many."""
        data = self.photographed
        places = np.unique(data.value[:, 2:], axis=0)
        chosen = _spread(places, min(_MARKS, len(places)))
        rows = [int(np.argmin(np.sum((data.value[:, 2:] - places[k]) ** 2, axis=1))) for k in chosen]
        some = data.subset(np.tile(rows, len(readings)))
        return replace(some, readings=read_only(np.repeat(readings, len(rows), axis=0))), len(rows)

    @property
    def _marks_on_board(self) -> int:
        return len(np.unique(self.photographed.value[:, 2:], axis=0))

    def _problem(self, data: Measurements) -> Problem:
        fit = self.fit
        return Problem(fit.model, fit.parameters, fit.machine.frames, (data,), held=fit.deviations)

    @property
    def _values(self) -> Array:
        fit = self.fit
        return values_at(fit.model.robot, fit.parameters, fit.machine.frames, fit.deviations)

    def _whitened(self, data: Measurements, like: Measurements, number: IntArray, share: float) -> Array:
        """Return J (N, 2, p) of rows over their sigmas, which are a ``share`` of those of a set of the fit.

        Where marks of one photograph err together there, they do here: more marks do not make an arm repeat better.
        """
        fit, problem = self.fit, self._problem(data)
        rows = with_twists(problem, problem.machine(self._values), data, scales(fit.parameters))
        k = next(i for i, own in enumerate(fit.measurements) if own is like)
        together = fit.together[k] if fit.together else None
        noise = next(noise for noise in fit.noise if noise.measurements == k)
        alone = noise.total if together is None else np.hypot(noise.instrument, np.sqrt(together.variance))
        sigma = np.full(data.sigma.shape, share * alone)
        J = np.asarray(rows.J / sigma[:, :, None])
        if together is None:
            return J
        here = Together.of(together.length, together.angle, together.variance, number, rows.by_twist, sigma)
        return here.less(J)


def _spread(places: Array, count: int) -> list[int]:
    """Return which of places (n, 3) lie farthest from each other: each the farthest from those before it."""
    chosen = [int(np.argmax(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))]
    while len(chosen) < count:
        apart = np.min(np.sum((places[:, None] - places[chosen]) ** 2, axis=2), axis=1)
        chosen.append(int(np.argmax(apart)))
    return chosen


@checked
def view_candidates(
    views: Views, count: int = 600, collision: SelfCollision | None = None, *, seed: int = 0
) -> Candidates:
    """Return ``count`` readings at which the camera sees the whole board, within the joints' limits.

    They spread from the photographs: each is a step from one before it, so that wrists turn and arms move as far as the
    board stays in sight. Raises JobError where there are not so many; RobotError as :func:`possible`.
    """
    if not 1 <= count <= MOST_POSES:
        raise JobError(f"{count} views are asked for; allowed are 1 to {MOST_POSES}.")
    robot, rng = views.fit.robot, drawing(seed)
    known = np.unique(views.photographed.readings, axis=0)
    found, tried, rejected = np.zeros((0, known.shape[1])), 0, Counter[str]()
    for _ in range(_MOST_ROUNDS):
        if len(found) >= count:
            return Candidates(read_only(rng.permutation(found)[:count]), tried, rejected)
        if tried >= _ENOUGH_TRIES and not len(found):
            break
        begin = np.concatenate([known, found])
        drawn = begin[rng.integers(0, len(begin), count)]
        drawn = drawn + rng.normal(scale=_AWAY, size=drawn.shape) * rng.uniform(0.0, 1.0, (count, 1))
        some = possible(robot, views.fit.machine.frames, drawn, None, collision)
        rejected.update(some.rejected)
        kept = some.readings
        if len(kept):
            refused = views.refused(kept)
            rejected.update({reason: int(np.count_nonzero(mask)) for reason, mask in refused.items()})
            kept = kept[~np.any(list(refused.values()), axis=0)]
        found, tried = np.concatenate([found, kept]), tried + count
    reasons = ", ".join(f"{n} {reason}" for reason, n in rejected.most_common())
    raise JobError(f"only {len(found)} of {tried} views show the board, and {count} are asked for: {reasons}.")


@checked
def plan_views(
    views: Views,
    count: int = 12,
    *,
    candidates: Array,
    criterion: Criterion = "I",
    working: Array | None = None,
    target: float | None = None,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Plan:
    """Choose ``count`` photographs to be taken beside those of a fit.

        fit = calib.identify(model, photographs)
        views = calib.planning.Views(fit)
        planned = calib.planning.plan_views(views, 12, candidates=calib.planning.view_candidates(views).readings)

    ``candidates`` (N, nr); ``working`` (M, nr): where the camera, or the board, must be well placed; the candidates
    when None. ``target`` in m, as in :func:`calib.plan`. Raises JobError where ``count`` is not from 1
    to 1000, or candidates are fewer.
    """
    with one_thread():
        return planned(
            candidates,
            views.rows(candidates),
            views.working_rows(candidates if working is None else working),
            views.measured_rows(),
            views.fit.parameters,
            count,
            criterion,
            target,
            progress,
        )
