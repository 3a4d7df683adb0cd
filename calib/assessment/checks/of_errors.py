"""Checks of the errors: whether they became smaller, and those of held-out rows are as predicted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from calib.assessment.checks.of_fit import ROUNDING, small_sigma
from calib.assessment.effects import memory
from calib.assessment.gain import Gain, gain
from calib.assessment.judged import NOTHING, Check, JudgedSet
from calib.foundations.arrays import Array, BoolArray, read_only
from calib.foundations.chance import bound, exceeded
from calib.foundations.errors import PoseError
from calib.foundations.linear import spread
from calib.identification.fit import Fit
from calib.identification.identify import residuals_of
from calib.identification.repeats import by_pose
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import common_errors, residual_errors, row_freedom, row_noise
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.measurement.measurements import End, Measurements
from calib.measurement.poses import ONE_POSE, both_ends, poses_of, tools_of
from calib.robot.sampling import joint_limits

# Of the spread of what was measured. Poor arms leave up to half of it; what does not belong together leaves all.
LEFT = 0.05
# One place that was touched has no spread; this share of the reach stands for it.
ONE_PLACE = 0.05
# Standard errors of an improvement: its probability, and from which an error has clearly grown.
SURELY, WORSE = 0.975, -4.0
# Errors that are so much larger have grown by more than another weighing of the same rows does.
GROWN = 1.25
# Of what is left, a change of what is predicted that is no more neither shows that the arm deviates nor spoils it.
HARDLY = 0.25
# Errors before calibration that are within this of the noise show no deviation of the arm.
AS_NOISE = 2.0
# Held-out errors as multiples of those predicted, which are themselves estimates: their chance.
PREDICTED, RARELY = 3.0, 1e-4
# The probability of regions, and the share of held-out positions that must be inside: fewer were in 2 of 560 sound
# sessions, of instruments that drift.
REGION, INSIDE = 0.95, 0.7
# The share of rows that a robust loss may pass over in a held-out table, too.
PASSED_OVER = 0.15
# Held-out poses that are needed, and the share of them that may be copies of those of the fit.
POSES, COPIES = 4, 0.5
# Rows whose errors by every cause are in memory at a time.
_BLOCK = 5000
# What a user wants to know whose arm is as its maker says.
_ALIKE = (
    " Nothing shows that the arm deviates from its URDF: a job with neither offsets nor placements keeps that, and "
    "finds the rest."
)


def explained(fit: Fit, judged: Sequence[JudgedSet]) -> Check:
    """Whether the machine explains what was measured at all."""
    worst, what = _left(fit, judged, [one.after for one in judged])
    said = f"After calibration the errors are {worst:.2g} times the spread of what was measured"
    cause = f" ({what}): the readings do not belong to the measurements, or not to this robot."
    return Check.judged("explained", worst, LEFT, said, cause)


def _left(fit: Fit, judged: Sequence[JudgedSet], residuals: Sequence[Array]) -> tuple[float, str]:
    """Return the largest rms of residuals as a share of the spread of what was measured, and of which quantity."""
    worst, what = 0.0, ""
    for one, r in zip(judged, residuals, strict=True):
        for quantity in QUANTITIES[one.data.kind]:
            rest = float(np.sqrt(np.mean(np.sum(r[:, quantity.columns] ** 2, axis=1))))
            whole = _spread(fit, [*fit.measurements, *(each.data for each in judged)], one.data, quantity.unit)
            share = rest / whole if whole > 0.0 else 0.0
            if share > worst:
                worst, what = share, quantity.name
    return worst, what


def _spread(fit: Fit, sets: Sequence[Measurements], data: Measurements, unit: str) -> float:
    """Return the rms distance from their mean of what was measured, or, where no places were, of the tool points."""
    if unit == "rad":
        return 1.0
    if unit == "px":
        return spread(data.value[:, :2])
    if data.position is not None:
        return max(spread(fit.places_of(data)), ONE_PLACE * fit.reach)
    ends = [_points(fit, own, end) for own in sets for end in own.ends]
    return max(spread(np.concatenate(ends)), ONE_PLACE * fit.reach)


def _points(fit: Fit, data: Measurements, end: End) -> Array:
    """Return the tool points (n, 3) of one end of rows; of tools that the fit does not have, none."""
    known = {name: k for k, name in enumerate(fit.measurements[0].tools)}
    number = np.array([known.get(name, -1) for name in data.tools], dtype=np.intp)[end.tool]
    T = fit.robot.with_tip(data.tip or fit.robot.tip).tips(end.readings, fit.deviations, end.conditions)[number >= 0]
    points = fit.machine.frames.tools[number[number >= 0], :3, 3]
    return np.asarray(T[:, :3, 3] + (T[:, :3, :3] @ points[:, :, None])[:, :, 0])


def improvement(fit: Fit, judged: Sequence[JudgedSet]) -> Check:
    """Whether errors are smaller than before, by more than chance makes them over different poses.

    Nothing is to be smaller where base and tools explain the rows, and what was found of the robot hardly changes it.
    """
    if not any(parameter.of_robot for parameter in fit.parameters):
        return _not_spoiled(judged)
    best, limit, worse, deviates, still = -np.inf, NOTHING, "", False, True
    passed_over = PASSED_OVER if any(loss != "linear" for loss in fit.losses) else 0.0
    for name in sorted({quantity.name for one in judged for quantity in QUANTITIES[one.data.kind]}, reverse=True):
        found = gain(judged, name, passed_over)
        if not found.freedom:
            continue
        if found.t > best:
            best, limit = found.t, found.needed(SURELY)
        clearly = _grown(found) or found.t > found.needed(SURELY)
        deviates |= clearly or not found.before <= AS_NOISE * _noise(fit, name)
        still &= found.changed <= HARDLY * found.after and found.before <= _small(fit, name)
        if _grown(found) or (name in ("position", "pixels") and found.after >= found.before):
            worse = name
    if not np.isfinite(best):
        return Check.idle("improvement", NOTHING, "There are too few rows to judge an improvement.", least=True)
    held_out = any(one.use == "validation" for one in judged)
    data = "held-out data" if held_out else "the fitted data"
    if best > limit and not worse:
        said = f"Errors are smaller than before calibration by {best:.2g} standard errors."
        return Check.of("improvement", best, limit, True, said, least=True)
    if still and _hardly_changed(fit):
        said = (
            "Base and tool alone explain the measurements: the deviations of the robot that were found change what is "
            "predicted in the range of the joints by less than a quarter of what is left."
        )
        return Check.idle("improvement", NOTHING, said, least=True)
    # Of what nothing explains, or of rows that belong together no more, nothing is known of the arm either.
    deviates |= _left(fit, judged, [one.before for one in judged])[0] > LEFT
    alike = "" if deviates else _ALIKE
    if worse:
        said = f"On {data} the {worse} error is no smaller than before calibration.{alike}"
        return Check.of("improvement", best, limit, False, said, least=True)
    said = f"Errors are smaller than before calibration by {best:.2g} standard errors, and {limit:.2g} are needed: "
    return Check.of("improvement", best, limit, False, f"{said}the improvement may be chance.{alike}", least=True)


def _hardly_changed(fit: Fit) -> bool:
    """Return whether predictions hardly change in the range of the joints either, where no rows are.

    A turntable is as its URDF says wherever it turns; of a line of points, which base and tool explain, an arm is not.
    """
    rng, (low, high) = np.random.default_rng(0), joint_limits(fit.robot).T
    tables = [
        replace(data.at_readings(), readings=read_only(rng.uniform(low, high, data.readings.shape)))
        for data in fit.measurements
    ]
    try:
        before, after = (residuals_of(fit, tables, machine) for machine in (fit.nominal, fit.machine))
    except PoseError:  # as where a loop does not close there
        return False
    for i, data in enumerate(tables):
        for noise in (noise for noise in fit.noise if noise.measurements == i):
            columns = next(q.columns for q in QUANTITIES[data.kind] if q.name == noise.quantity)
            if np.sqrt(np.mean((after[i] - before[i])[:, columns] ** 2)) > HARDLY * noise.total:
                return False
    return True


def _grown(found: Gain) -> bool:
    """Return whether errors have clearly grown."""
    return found.t < WORSE and found.after > GROWN * found.before


def _not_spoiled(judged: Sequence[JudgedSet]) -> Check:
    """Whether errors have not grown where nothing of the robot was free.

    Then before and after differ by how rows of a photograph were weighed alone: each by itself, and as they err
    together.
    """
    for name in sorted({quantity.name for one in judged for quantity in QUANTITIES[one.data.kind]}):
        found = gain(judged, name)
        if found.freedom and _grown(found):
            said = (
                f"No parameter of the robot was free, and the {name} error is {found.after / found.before:.2g} times "
                "as large as without what rows of a photograph have in common: they err together as no place of board "
                "and camera explains. Arm, lens or board is not as it is said to be."
            )
            return Check.of("improvement", found.t, WORSE, False, said, least=True)
    return Check.idle("improvement", NOTHING, "No parameter of the robot was free.", least=True)


def _noise(fit: Fit, name: str) -> float:
    """Return the rms of the errors of a quantity by the noise of the fit alone, zero where it has none."""
    same = [noise for noise in fit.noise if noise.quantity == name and noise.degrees_of_freedom >= 1.0]
    if not same:
        return 0.0
    columns = next(q.columns for q in QUANTITIES[fit.measurements[same[0].measurements].kind] if q.name == name)
    mean = np.average([n.total**2 for n in same], weights=[n.degrees_of_freedom for n in same])
    return float(np.sqrt((columns.stop - columns.start) * mean))


def _small(fit: Fit, name: str) -> float:
    """Return what errors (rms) of a quantity are small: as the instrument's noise, or for an arm of its reach."""
    kinds = [QUANTITIES[data.kind] for data in fit.measurements]
    columns = next((q.columns for of_kind in kinds for q in of_kind if q.name == name), slice(0, 3))
    sigmas = [noise.instrument for noise in fit.noise if noise.quantity == name]
    alone = max(small_sigma(fit, UNIT_OF[name]), AS_NOISE * min(sigmas, default=0.0))
    return float(np.sqrt(columns.stop - columns.start)) * alone


def prediction(fit: Fit, machine: CalibratedMachine, held_out: Sequence[JudgedSet]) -> Check:
    """Whether errors of rows held out are about as large as the fit says that they should be, or small."""
    robust = any(loss != "linear" for loss in fit.losses)
    # Parameters from rows that go together are that much less sure; of rows of a pose the uncertainty knows it.
    together = 1.0 + 2.0 * memory(_means_of_poses(fit))
    worst, limit, said = NOTHING, PREDICTED, "No rows were held out."
    for one in held_out:
        for quantity in QUANTITIES[one.data.kind]:
            same = [n for n in fit.noise if n.quantity == quantity.name and n.degrees_of_freedom >= 1.0]
            if not same or not len(one.data):
                continue
            own = np.average([n.total**2 for n in same], weights=[n.degrees_of_freedom for n in same])
            width = quantity.columns.stop - quantity.columns.start
            predicted = float(own) * width + together * _of_parameters(machine, one.data, quantity.columns)
            predicted = np.maximum(predicted, ROUNDING**2)
            squares = np.sum(one.after[:, quantity.columns] ** 2, axis=1)
            if robust:
                # Outliers that a robust loss passes over in one table are in others, too.
                kept = squares <= np.quantile(squares, 1.0 - PASSED_OVER)
                squares, predicted = squares[kept], predicted[kept]
            ratio = float(np.sqrt(np.mean(squares / predicted)))
            # What was predicted is itself an estimate, of few numbers a poor one.
            freedom = sum(n.degrees_of_freedom for n in same)
            allowed = PREDICTED * max(1.0, 0.5 * float(np.sqrt(bound(1.0 - RARELY, 3, freedom) / 3.0)))
            allowed = max(allowed, small_sigma(fit, quantity.unit) / float(np.sqrt(np.mean(predicted))))
            if not worst / limit >= ratio / allowed:
                worst, limit = ratio, allowed
                said = f"Held-out {quantity.name} errors are {ratio:.2g} times as large as predicted"
                said += "." if ratio <= allowed else ": something differs between the fitted and the held-out rows."
    return Check.of("prediction", worst, limit, not worst > limit, said)


def regions(machine: CalibratedMachine, held_out: Sequence[JudgedSet]) -> Check:
    """Whether positions held out are inside the regions that the machine states for them, with the noise of a row.

    Errors may be as large as predicted, and in directions in which they should be small.
    """
    told = []
    for one in held_out:
        inside = _inside(machine, one)
        if not len(inside):
            continue
        share, outside = float(np.mean(inside)), int(np.sum(~inside))
        said = f"{100.0 * share:.0f} % of the held-out positions are inside the 95 % regions"
        # Of so many rows: what a few do may be chance.
        if scipy.special.bdtrc(outside - 1, len(inside), 1.0 - REGION) > RARELY:
            share = max(share, INSIDE)
        told.append((share, said))
    if not told:
        return Check.idle("regions", INSIDE, "No positions were held out whose regions are known.", least=True)
    worst, said = min(told)
    more = ": something differs between the fitted and the held-out rows, or what is stated is too small."
    return Check.judged("regions", worst, INSIDE, said, more, least=True)


def _inside(machine: CalibratedMachine, one: JudgedSet) -> BoolArray:
    """Return which positions (N,) are inside their regions; none (0,) where these are not known."""
    data = one.data
    if machine.known_uncertainty.position is None or data.kind not in ("position", "pose") or not _known(machine, data):
        return np.zeros(0, dtype=np.bool_)
    freedom = row_freedom(machine, data)
    found = np.empty(len(data), dtype=np.bool_)
    for start in range(0, len(data), _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, len(data)))
        own = data.subset(rows)
        F = np.concatenate([of(machine, own)[:, :3] for of in (common_errors, residual_errors)], axis=2)
        noise = np.maximum(row_noise(machine, own)[:, :3], ROUNDING)
        C = F @ np.swapaxes(F, 1, 2) + noise[:, :, None] ** 2 * np.eye(3)
        r = one.after[rows, :3, None]
        square = (np.swapaxes(r, 1, 2) @ np.linalg.solve(C, r))[:, 0, 0]
        found[rows] = exceeded(square, 3, freedom[rows]) >= 1.0 - REGION
    return found


def _means_of_poses(fit: Fit) -> list[Array]:
    """Return the residuals (n, d) of every set; means of poses, as these follow each other, where rows err together."""
    again = {one.measurements for one in fit.repeats}

    def means(data: Measurements, r: Array) -> Array:
        pose = poses_of(data)
        sums, many = by_pose(r, pose)
        return np.asarray((sums / many[:, None])[np.argsort(np.unique(pose, return_index=True)[1])])

    sets = enumerate(zip(fit.measurements, fit.residuals, strict=True))
    return [means(data, r) if i in again else r for i, (data, r) in sets]


def _of_parameters(machine: CalibratedMachine, data: Measurements, columns: slice) -> Array:
    """Return the variance (N,) that the parameters bring to positions or turns; nothing for what is not known of."""
    if data.position is None or not _known(machine, data):
        return np.zeros(len(data))
    found = np.empty(len(data))
    for start in range(0, len(data), _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, len(data)))
        found[rows] = np.sum(common_errors(machine, data.subset(rows))[:, columns] ** 2, axis=(1, 2))
    return found


def _known(machine: CalibratedMachine, data: Measurements) -> bool:
    """Return whether the machine has the tools and the set-ups of all rows."""
    return machine.bases.keys() >= set(data.setups) and machine.tools.keys() >= set(data.tools)


def independent_rows(own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> Check:
    """Whether enough poses were held out, where any were."""
    if not held_out:
        said = "No rows were held out: nothing shows how well the machine predicts other poses."
        return Check.idle("held-out poses", POSES, said, least=True)
    cells = [np.round(both_ends(one.data)[~_copied(own, one)] / ONE_POSE) for one in held_out]
    n = len(np.unique(np.concatenate(cells), axis=0))
    said = f"{n} held-out {'pose is' if n == 1 else 'poses are'} different from those of the fit"
    return Check.judged("held-out poses", n, POSES, said, f", and {POSES} are needed.", least=True)


def copies(own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> Check:
    """Whether rows held out are the rows of the fit once more, also shuffled or rounded."""
    total = sum(len(one.data) for one in held_out)
    if not total:
        return Check.idle("copies", COPIES, "No rows were held out.")
    share = sum(int(_copied(own, one).sum()) for one in held_out) / total
    said = f"{100.0 * share:.0f} % of the held-out rows are at poses of the fit"
    return Check.judged("copies", share, COPIES, said, ": they prove nothing about other poses.")


def _copied(own: Sequence[JudgedSet], one: JudgedSet) -> BoolArray:
    """Return which rows (N,) are at a pose of the fit, with the same tool and target."""
    found: BoolArray = np.zeros(len(one.data), dtype=np.bool_)
    names: dict[str, int] = {}
    wanted = _apart(one.data, names)
    for other in own:
        if other.data.kind == one.data.kind and len(other.data) and len(one.data):
            distance, _ = scipy.spatial.cKDTree(_apart(other.data, names)).query(
                wanted, p=np.inf, distance_upper_bound=ONE_POSE
            )
            found |= np.isfinite(distance)
    return found


def _apart(data: Measurements, names: dict[str, int]) -> Array:
    """Return the readings, and beside them numbers by which rows of other tools and targets are far away."""

    def numbers(of: Sequence[str]) -> Array:
        return np.array([names.setdefault(name, len(names)) for name in of] or [0], dtype=np.float64)

    tools, target = numbers(data.tools)[tools_of(data)], numbers(data.targets)[np.maximum(data.target, 0)]
    return np.column_stack([both_ends(data), tools, target])
