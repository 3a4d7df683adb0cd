"""A plan of measurements: which poses, how good they will be, and how many it takes."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calib.assessment import design
from calib.assessment.candidates import PlannedMeasurement, random_candidates, rows, working_rows
from calib.assessment.design import Design, DesignRows, Space
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.choices import MOST_CHOSEN, Criterion
from calib.foundations.errors import JobError
from calib.foundations.linear import one_thread
from calib.foundations.ranges import refuse_beyond
from calib.foundations.sealing import sealed
from calib.identification.error_model import ErrorModel
from calib.identification.observability import indices
from calib.identification.parameters import Parameter, scales

_RANDOM_DESIGNS = 100
_MOST_POSES = 500


@dataclass(frozen=True, slots=True)
class Forecast:
    """The rms error in m of the tool at the working poses that remains with ``poses`` poses and more would remove.

    It comes from errors of the parameters, from noise and from what the model leaves out. What would remain even if all
    candidates were measured without noise (``floor`` of the plan) is not in it. ``random``: the median of random
    designs.
    """

    poses: int
    chosen: float
    random: float


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Plan:
    """Chosen poses. Made by :func:`plan`.

    ``readings`` (n, nr) in rad and m, one near the next; ``chosen``: which of the candidates these are. ``rank`` of
    ``parameters``: what all candidates together would determine. ``forecasts``: by number of poses. ``indices`` and
    ``random_indices``: O1 to O5 of the chosen and, as medians, of random poses. ``enough``: the fewest poses whose
    forecast keeps within a target; None where no target is given or nothing suffices. ``floor``: rms in m of what no
    number of poses removes: what the model leaves out, and what only priors tell, as the size of all that cameras see.
    """

    __repr__ = brief

    readings: Array
    chosen: tuple[int, ...]
    parameters: int
    rank: int
    forecasts: tuple[Forecast, ...]
    indices: dict[str, float]
    random_indices: dict[str, float]
    enough: int | None
    floor: float
    converged: bool

    def contents(self) -> dict[str, Any]:
        """Return what is to be said of the poses as plain data, lengths in m."""
        return {
            "rank": self.rank,
            "parameters": self.parameters,
            "forecasts": [asdict(forecast) for forecast in self.forecasts],
            "floor": self.floor,
            "enough": self.enough,
            "indices": {"chosen": self.indices, "random": self.random_indices},
        }


@checked
def plan(
    model: ErrorModel,
    count: int = 40,
    *,
    candidates: int | Array = 1000,
    measurement: PlannedMeasurement | None = None,
    criterion: Criterion = "I",
    measured: Array | None = None,
    target: float | None = None,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Plan:
    """Choose ``count`` poses to be measured next.

        planned = calib.plan(calib.error_model(robot, offsets="all", placements="all"), 40)
        planned.readings  # (40, nr) in rad and m

    ``candidates`` (N, nr) in rad and m, or how many to draw at random within the joints' limits; :mod:`calib.planning`
    makes candidates that a tracker sees and where the arm does not touch itself. ``measurement``: how poses are
    measured, and where the tool must be accurate; by default positions by a tracker to 0.05 mm, of an arm of which the
    model leaves nothing out. ``measured`` (M, nr): poses measured already, which the new ones complete. ``target`` in
    m: also find how many poses keep the forecast error below it. ``progress`` is told how many of how many designs are
    made: the sequence that they begin with, and one for every number of poses that is forecast.

    Raises JobError when ``count`` is not from 1 to 1000, when there are fewer candidates, or when they determine
    nothing; RobotError for candidates, measured or working poses that are no readings.
    """
    refuse_count(count)
    how = measurement or PlannedMeasurement()
    if isinstance(candidates, int):
        candidates = random_candidates(model.urdf_robot, how.frames, candidates).readings
    own = model.urdf_robot.own
    candidates = own(candidates)
    _refuse_few(count, candidates)
    working = candidates if how.working is None else own(how.working)
    done = None if measured is None or not measured.size else own(measured)
    with one_thread(of_scipy=False):
        return planned(
            candidates,
            rows(model, how, candidates),
            working_rows(model, how, working),
            None if done is None else rows(model, how, done),
            model.parameters(),
            count,
            criterion,
            target,
            progress,
        )


def refuse_count(count: int) -> None:
    """Raise JobError where a plan cannot be of so many poses."""
    if not 1 <= count <= MOST_CHOSEN:
        raise JobError(f"{count} poses cannot be chosen; allowed are 1 to {MOST_CHOSEN}.")


def _refuse_few(count: int, candidates: Array) -> None:
    if count > len(candidates):
        raise JobError(f"{count} poses cannot be chosen from {len(candidates)} candidates.")


def planned(
    candidates: Array,
    of_candidates: DesignRows,
    of_working: DesignRows,
    given: DesignRows | None,
    parameters: Sequence[Parameter],
    count: int,
    criterion: Criterion,
    target: float | None,
    progress: Callable[[int, int], None],
) -> Plan:
    """Return the plan of candidates (N, nr) whose rows, and those of what is measured already, are known.

    Raises JobError when ``count`` is not from 1 to 1000, when there are fewer candidates, or when they determine
    nothing.
    """
    refuse_count(count)
    if target is not None:
        refuse_beyond(target, "sigma", "target")
    _refuse_few(count, candidates)
    seed, prior = 0, _priors(parameters)
    judged = design.space(of_candidates, criterion, of_working, given, prior)
    by_error = judged if criterion == "I" else design.space(of_candidates, "I", of_working, given, prior)
    counts = _counts(count, len(candidates), 0 if given is not None else -(-judged.seen // 3) + 1)
    # The best sequence of many begins with that of few.
    progress(0, len(counts) + 1)
    order = design.sequence(judged, max(counts))
    designs = {}
    for done, n in enumerate(counts, start=1):
        progress(done, len(counts) + 1)
        designs[n] = design.choose(judged, n, order=order)
    progress(len(counts) + 1, len(counts) + 1)
    found = designs[count]
    floor = design.parts_of(by_error, range(len(candidates)))[1] + design.unseen(by_error)
    forecasts = tuple(_forecast(by_error, floor, n, designs[n], seed) for n in counts)
    random = [_indices(judged, some) for some in design.random_sets(judged, count, _RANDOM_DESIGNS, seed)]
    return Plan(
        read_only(candidates[list(_near_each_other(candidates, found.chosen))]),
        _near_each_other(candidates, found.chosen),
        len(parameters),
        judged.seen,
        forecasts,
        _indices(judged, found.chosen),
        {name: float(np.median([r[name] for r in random])) for name in random[0]},
        None if target is None else _enough(by_error, floor, target),
        _root(floor),
        found.converged,
    )


def _priors(parameters: Sequence[Parameter]) -> Array:
    """Return the standard deviations (p,) of priors in parameter scales: 1 where there is one, else infinite."""
    known = np.array([np.inf if parameter.prior is None else parameter.prior for parameter in parameters])
    return np.asarray(known / scales(parameters))


def _counts(count: int, most: int, least: int) -> list[int]:
    """Return numbers of poses around the one that is asked for."""
    wanted = {round(count * share) for share in (0.5, 0.75, 1.0, 1.5, 2.0)}
    return sorted(n for n in wanted if max(least, 1) <= n <= most or n == count)


def _forecast(by_error: Space, floor: float, n: int, found: Design, seed: int) -> Forecast:
    random = design.random_values(by_error, n, _RANDOM_DESIGNS, seed)
    values = design.value_of(by_error, found.chosen), float(np.median(random))
    return Forecast(n, *(_root(value - floor) for value in values))


def _enough(s: Space, floor: float, target: float) -> int | None:
    """Return the fewest poses, each the best after those before it, that keep the error within a target."""
    order = design.sequence(s, min(len(s.A), _MOST_POSES))

    def error(n: int) -> float:
        return _root(design.value_of(s, order[:n]) - floor)

    low, high = 0, len(order)
    if error(high) > target:
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if error(middle) <= target else (middle + 1, high)
    return low


def _indices(s: Space, chosen: Sequence[int]) -> dict[str, float]:
    """Return O1 to O5 of poses, in the directions that all candidates see; of whitened rows."""
    A = s.A[list(chosen)]
    values = np.linalg.svd(A.reshape(-1, A.shape[2]), compute_uv=False)[: s.seen]
    return indices(np.asarray(values, dtype=np.float64), len(chosen))


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))


def _near_each_other(candidates: Array, chosen: Sequence[int]) -> tuple[int, ...]:
    """Return the chosen poses in an order in which each is the nearest to the one before it: less travel."""
    left = list(chosen)
    order = [left.pop(int(np.argmin(np.sum(candidates[left] ** 2, axis=1))))]
    while left:
        distance = np.max(np.abs(candidates[left] - candidates[order[-1]]), axis=1)
        order.append(left.pop(int(np.argmin(distance))))
    return tuple(order)
