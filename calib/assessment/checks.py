"""The checks of a verdict, one pure function each, and what was shown where all have passed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from calib.assessment.blame import Blame
from calib.assessment.effects import NO_EFFECT, Effect, Rounding, Step, Strain, Stretch, Timing, memory
from calib.assessment.gain import ONE_POSE, gain
from calib.assessment.judged import Check, JudgedSet
from calib.assessment.metrics import error_norms
from calib.assessment.mixed_machines import MixedMachines
from calib.assessment.outliers import Outliers
from calib.assessment.own_base import OwnBase
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.chance import bound
from calib.foundations.linear import triangle
from calib.foundations.units import DEG, MM, MS
from calib.identification.fit import Fit
from calib.identification.parameters import scales
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import common_errors
from calib.measurement.checks import Finding
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.measurement.measurements import Measurements

NOTHING = float("nan")
# Degrees of freedom with which a scatter is told from a sigma.
ENOUGH = 10.0
# A sigma is said to be too large from this factor.
TOO_LARGE = 3.0

# What a user wants to know whose arm is as its maker says.
_ALIKE = (
    " Nothing shows that the arm deviates from its URDF: a job with neither offsets nor placements keeps that, and "
    "finds the rest."
)
# Rows whose errors by every cause are in memory at a time.
_BLOCK = 5000
# A scatter of a nanometre is rounding, of data without noise.
ROUNDING = 1e-9

# The thresholds. Beside each: the largest of the sound sessions of docs/verdicts.md, where it says something.
# Poor arms leave up to half of it; what does not belong together leaves all.
LEFT = 0.05
# One place that was touched has no spread; this share of the reach stands for it.
ONE_PLACE = 0.05
SURELY = 0.975
WORSE = -4.0
# Errors before calibration that are within this of the noise show no deviation of the arm.
AS_NOISE = 2.0
PREDICTED = 3.0
RARELY = 1e-4
SIGMA, OF_REACH = 30.0, 5e-4
POSES = 4
COPIES = 0.5
FREEDOM = 10.0
SIZE = 3.0
WANDERED = 5e-4
LATE, GEAR, SURE, SEEN = 0.2, 0.01, 6.0, 1.0
# Of 27 sound sessions with times the largest was 0.17.
SEEN_IN_TIME = 0.3
STRAIN = 2e-3
# Rounding of a share of the reach that is this share of what remains.
COARSE, ROUNDED = 1e-3, 0.5
# Times the number of machines: parts of one that changes steadily leave as much less as they are many. Fewer rows than
# that share are outliers, which another check judges.
MACHINES, MANY = 1.5, 0.15
GROSS, GROSS_ROBUST, FAR = 0.05, MANY, 5.0
FROZEN = 0.02
OWN_BASE = 2.0
LINE = 5e-3
REST = 1e-4
SCALE, LINK, LINK_LENGTH = 0.04, 0.04, 0.025
FAR_TOOL, FAR_BASE = 1.0, 100.0
COUNTED = (
    "unexplained",
    "radians-as-degrees",
    "metres-as-millimetres",
    "not-held-out",
    "copied-rows",
)


def _check(
    name: str, statistic: float, threshold: float, passed: object, sentence: str, *, least: bool = False
) -> Check:
    """Return a check of plain numbers."""
    return Check(name, float(statistic), float(threshold), bool(passed), sentence, least)


def answered(check: Check) -> Check:
    """Return a check that the user has answered."""
    return replace(check, passed=True, sentence=f"{check.sentence} The job accepts this.")


# ---- the fit


def convergence(fit: Fit) -> Check:
    """Whether the search for the least squares ended."""
    said = (
        "The solver converged."
        if fit.converged
        else f"The solver did not converge: its last step was {fit.step:.2g} parameter scales."
    )
    return _check("convergence", fit.step, NOTHING, fit.converged, said)


def redundancy(fit: Fit) -> Check:
    """Whether more was measured than was sought."""
    free = sum(noise.degrees_of_freedom for noise in fit.noise)
    numbers = sum(r.size for r in fit.residuals)
    said = f"{numbers} numbers were measured, and {free:.0f} degrees of freedom are left to judge the fit"
    passed = free >= FREEDOM
    return _check(
        "redundancy",
        free,
        FREEDOM,
        passed,
        f"{said}." if passed else f"{said}; at least {FREEDOM:g} are needed.",
        least=True,
    )


def stated_sigma(fit: Fit) -> Check:
    """Whether what remains is near the instrument's noise, where that is stated."""
    worst, limit, said = NOTHING, SIGMA, "There is no stated sigma to compare the residuals with."
    for noise in fit.noise:
        if not noise.degrees_of_freedom >= ENOUGH or not noise.chi_square >= 0.0:
            continue
        # Of a robust loss the total leaves out what the loss does.
        times = noise.total / noise.instrument if noise.model > 0.0 else float(np.sqrt(noise.chi_square))
        allowed = max(SIGMA, _small(fit, UNIT_OF[noise.quantity]) / noise.instrument)
        if not worst / limit >= times / allowed:
            worst, limit = times, allowed
            said = f"The {noise.quantity} residuals scatter {times:.2g} times as much as the stated sigma"
            if times > allowed:
                said += ": the sigma is far too small, or an effect is missing from the model."
            else:
                said += "; the sigma seems too large." if times < 1.0 / TOO_LARGE else "."
    return _check("stated sigma", worst, limit, not worst > limit, said)


def _small(fit: Fit, unit: str) -> float:
    """Return a standard deviation that is small for an arm of its reach, in the unit."""
    if unit == "px":
        # As an angle is seen: the sigma of a sharp corner is far below what any arm repeats.
        return OF_REACH * max(
            (data.camera.lens.fx for data in fit.measurements if data.camera is not None), default=0.0
        )
    return OF_REACH * (fit.model.robot.reach if unit == "m" else 1.0)


# ---- what was shown


def explained(fit: Fit, judged: Sequence[JudgedSet]) -> Check:
    """Whether the machine explains what was measured at all."""
    worst, what = _left(fit, judged, [one.after for one in judged])
    said = f"After calibration the errors are {worst:.2g} times the spread of what was measured"
    passed = worst <= LEFT
    cause = ": the readings do not belong to the measurements, or not to this robot."
    return _check("explained", worst, LEFT, passed, f"{said}." if passed else f"{said} ({what}){cause}")


def _left(fit: Fit, judged: Sequence[JudgedSet], residuals: Sequence[Array]) -> tuple[float, str]:
    """Return the largest rms of residuals as a share of the spread of what was measured, and of which quantity."""
    worst, what = 0.0, ""
    for one, r in zip(judged, residuals, strict=True):
        for quantity in QUANTITIES[one.data.kind]:
            rest = float(np.sqrt(np.mean(np.sum(r[:, quantity.columns] ** 2, axis=1))))
            spread = _spread(fit, [*fit.measurements, *(each.data for each in judged)], one.data, quantity.unit)
            share = rest / spread if spread > 0.0 else 0.0
            if share > worst:
                worst, what = share, quantity.name
    return worst, what


def _spread(fit: Fit, sets: Sequence[Measurements], data: Measurements, unit: str) -> float:
    """Return the rms distance from their mean of what was measured, or, where no places were, of the tool points."""
    if unit == "rad":
        return 1.0
    if unit == "px":
        return _rms(data.value[:, :2])
    if data.position is not None:
        return max(_rms(data.position), ONE_PLACE * fit.model.robot.reach)
    ends = [_tips(fit, end.readings, end.tool, one, k) for one in sets for k, end in enumerate(one.ends)]
    return max(_rms(np.concatenate(ends)), ONE_PLACE * fit.model.robot.reach)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1))))


def _tips(fit: Fit, readings: Array, tool: IntArray, data: Measurements, end: int) -> Array:
    conditions = data.ends[end].conditions
    T = fit.robot.tips(readings, fit.deviations, conditions)
    known = fit.measurements[0].tools
    number = np.array([known.index(name) for name in data.tools], dtype=np.intp)
    points = fit.machine.frames.tools[number[tool], :3, 3]
    return np.asarray(T[:, :3, 3] + (T[:, :3, :3] @ points[:, :, None])[:, :, 0])


def improvement(fit: Fit, judged: Sequence[JudgedSet]) -> Check:
    """Whether errors are smaller than before, by more than chance makes them over different poses."""
    if not any(parameter.of_robot for parameter in fit.parameters):
        return _check("improvement", NOTHING, NOTHING, True, "No parameter of the robot was free.", least=True)
    best, limit, worse, deviates = -np.inf, NOTHING, "", False
    for name in sorted({quantity.name for one in judged for quantity in QUANTITIES[one.data.kind]}, reverse=True):
        found = gain(judged, name)
        if not found.freedom:
            continue
        if found.t > best:
            best, limit = found.t, found.needed(SURELY)
        clearly = found.t < WORSE or found.t > found.needed(SURELY)
        deviates |= clearly or not found.before <= AS_NOISE * _noise(fit, name)
        if found.t < WORSE or (name in ("position", "pixels") and found.after >= found.before):
            worse = name
    if not np.isfinite(best):
        return _check(
            "improvement", NOTHING, NOTHING, True, "There are too few rows to judge an improvement.", least=True
        )
    held_out = any(one.use == "validation" for one in judged)
    data = "held-out data" if held_out else "the fitted data"
    # Of what nothing explains, or of rows that belong together no more, nothing is known of the arm either.
    deviates |= _left(fit, judged, [one.before for one in judged])[0] > LEFT
    alike = "" if deviates else _ALIKE
    if worse:
        said = f"On {data} the {worse} error is no smaller than before calibration.{alike}"
        return _check("improvement", best, limit, False, said, least=True)
    passed = best > limit
    said = f"Errors are smaller than before calibration by {best:.2g} standard errors"
    more = "." if passed else f", and {limit:.2g} are needed: the improvement may be chance.{alike}"
    return _check("improvement", best, limit, passed, said + more, least=True)


def _noise(fit: Fit, name: str) -> float:
    """Return the rms of the errors of a quantity by the noise of the fit alone, zero where it has none."""
    same = [noise for noise in fit.noise if noise.quantity == name and noise.degrees_of_freedom >= 1.0]
    if not same:
        return 0.0
    columns = next(q.columns for q in QUANTITIES[fit.measurements[same[0].measurements].kind] if q.name == name)
    mean = np.average([n.total**2 for n in same], weights=[n.degrees_of_freedom for n in same])
    return float(np.sqrt((columns.stop - columns.start) * mean))


def _readings(data: Measurements) -> Array:
    return np.hstack([data.ends[0].readings, data.ends[-1].readings])


def prediction(fit: Fit, machine: CalibratedMachine, held_out: Sequence[JudgedSet]) -> Check:
    """Whether errors of rows held out are about as large as the fit says that they should be, or small."""
    robust = any(loss != "linear" for loss in fit.losses)
    # Parameters from rows that go together are that much less sure.
    together = 1.0 + 2.0 * memory(fit.residuals)
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
                kept = squares <= np.quantile(squares, 1.0 - GROSS_ROBUST)
                squares, predicted = squares[kept], predicted[kept]
            ratio = float(np.sqrt(np.mean(squares / predicted)))
            # What was predicted is itself an estimate, of few numbers a poor one.
            freedom = sum(n.degrees_of_freedom for n in same)
            allowed = PREDICTED * max(1.0, 0.5 * float(np.sqrt(bound(1.0 - RARELY, 3, freedom) / 3.0)))
            allowed = max(allowed, _small(fit, quantity.unit) / float(np.sqrt(np.mean(predicted))))
            if not worst / limit >= ratio / allowed:
                worst, limit = ratio, allowed
                said = f"Held-out {quantity.name} errors are {ratio:.2g} times as large as predicted"
                said += "." if ratio <= allowed else ": something differs between the fitted and the held-out rows."
    return _check("prediction", worst, limit, not worst > limit, said)


def _of_parameters(machine: CalibratedMachine, data: Measurements, columns: slice) -> Array:
    """Return the variance (N,) that the parameters bring to positions or turns; nothing for what is not known of."""
    known = machine.bases.keys() >= set(data.setups) and machine.tools.keys() >= set(data.tools)
    if data.position is None or not known:
        return np.zeros(len(data))
    found = np.empty(len(data))
    for start in range(0, len(data), _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, len(data)))
        found[rows] = np.sum(common_errors(machine, data.subset(rows))[:, columns] ** 2, axis=(1, 2))
    return found


def independent_rows(own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> Check:
    """Whether enough poses were held out, where any were."""
    if not held_out:
        said = "No rows were held out: nothing shows how well the machine predicts other poses."
        return _check("held-out poses", NOTHING, POSES, True, said, least=True)
    cells = [np.round(_readings(one.data)[~_copied(own, one)] / ONE_POSE) for one in held_out]
    n = len(np.unique(np.concatenate(cells), axis=0))
    said = f"{n} held-out {'pose is' if n == 1 else 'poses are'} different from those of the fit"
    return _check(
        "held-out poses",
        n,
        POSES,
        n >= POSES,
        f"{said}{'.' if n >= POSES else f', and {POSES} are needed.'}",
        least=True,
    )


def copies(own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> Check:
    """Whether rows held out are the rows of the fit once more, also shuffled or rounded."""
    total = sum(len(one.data) for one in held_out)
    if not total:
        return _check("copies", NOTHING, COPIES, True, "No rows were held out.")
    share = sum(int(_copied(own, one).sum()) for one in held_out) / total
    said = f"{100.0 * share:.0f} % of the held-out rows are at poses of the fit"
    passed = share <= COPIES
    more = "." if passed else ": they prove nothing about other poses."
    return _check("copies", share, COPIES, passed, said + more)


def _copied(own: Sequence[JudgedSet], one: JudgedSet) -> BoolArray:
    """Return which rows (N,) are at a pose of the fit, with the same tool and target."""
    found: BoolArray = np.zeros(len(one.data), dtype=np.bool_)
    names: dict[str, int] = {}
    wanted = _apart(one.data, names)
    for other in own:
        if other.data.kind == one.data.kind and len(other.data) and len(one.data):
            distance, _ = cKDTree(_apart(other.data, names)).query(wanted, p=np.inf, distance_upper_bound=ONE_POSE)
            found |= np.isfinite(distance)
    return found


def _apart(data: Measurements, names: dict[str, int]) -> Array:
    """Return the readings, and beside them numbers by which rows of other tools and targets are far away."""

    def numbers(of: Sequence[str]) -> Array:
        return np.array([names.setdefault(name, len(names)) for name in of] or [0], dtype=np.float64)

    tool, target = numbers(data.tools)[data.tool], numbers(data.targets)[np.maximum(data.target, 0)]
    return np.column_stack([_readings(data), tool, target])


# ---- what the rows say of themselves


def jump(found: Sequence[Step], outliers: Outliers) -> Check:
    """Whether base, tool, a joint or a target moved between two rows."""
    real = [step for step in found if step.chance < RARELY]
    worst = max(real, key=lambda step: step.size, default=None)
    size, said = 0.0, ""
    if worst is not None:
        size = worst.size
        said = f"{worst.file}:{worst.line}: after this row the {_thing(worst.what)} seems to have changed"
        said += f", by {size:.2g} times the scatter of the residuals"
    for target in outliers.moved:
        n, m = target.rows
        moved = float(np.sqrt(target.gain * (n + m) / (n * m)))
        if moved > size:
            size = moved
            said = f"{target.file}:{target.line}: after this row {target.target!r} seems to have moved, by {moved:.2g}"
            said += " times the scatter of the residuals"
    passed = size <= SIZE
    if passed:
        return _check(
            "jump",
            size or NOTHING,
            SIZE,
            True,
            f"Between no two rows is there a jump above {SIZE:g} times the scatter of the residuals.",
        )
    return _check("jump", size, SIZE, False, f"{said}: identify the rows before it and after it separately.")


def _thing(what: str) -> str:
    return what if what in ("base", "tool") else f"offset of {what!r}"


def drift(wandered: tuple[float, float], fit: Fit) -> Check:
    """Whether the base wandered in the course of the rows."""
    size, chance = wandered
    limit = WANDERED * fit.model.robot.reach
    if chance >= RARELY:
        return _check("drift", NOTHING, limit, True, "No drift of the base over the rows is seen.")
    passed = size <= limit
    said = f"Over the rows the base drifts by {size / MM:.2g} mm"
    return _check("drift", size, limit, passed, f"{said}." if passed else f"{said}: the instrument or the robot moved.")


def late(found: Effect, step: float = NOTHING) -> Check:
    """Whether what was measured is later, or earlier, than the readings beside it: in rows, or in s, ``step`` a row.

    In rows it must show in each of them: nobody knows that their order is that of time. Where times say so, an effect
    may be as much smaller as rows are many.
    """
    in_time = step > 0.0
    limit = LATE * step if in_time else LATE
    if not (abs(found.t) > SURE and found.size > (SEEN_IN_TIME if in_time else SEEN)):
        return _check("delay", NOTHING, limit, True, "No delay between measurements and readings is seen.")
    value = abs(found.value)
    passed = value <= limit
    factor, unit = (1.0 / MS, "ms") if in_time else (1.0, "rows")
    how = "later" if found.value > 0.0 else "earlier"
    said = f"Measurements are {value * factor:.2g} +- {found.sigma * factor:.2g} {unit} {how} than their readings"
    cure = 'let a clock be found, clock = "free", or align the times of both' if in_time else "align the times of both"
    return _check("delay", value, limit, passed, f"{said}." if passed else f"{said}: {cure}.")


def timing(found: Timing) -> Check:
    """Whether readings of a stream are of one time, and of that time alone."""
    limit = LATE * found.step
    told = [
        (abs(one.value), one, f"readings of {name!r} seem to be {abs(one.value) / MS:.2g} ms off those of the others")
        for name, one in found.by_joint.items()
    ]
    width = float(np.sqrt(2.0 * max(found.smoothed.value, 0.0)))
    told.append((width, found.smoothed, f"readings seem to be means over times, {width / MS:.2g} ms wide (rms)"))
    # Where one joint is late, others seem so with it: the one that explains most is named.
    sure = [one for one in told if abs(one[1].t) > SURE and one[1].size > SEEN_IN_TIME]
    value, _, what = max(sure, key=lambda one: one[1].size, default=(NOTHING, NO_EFFECT, ""))
    if not sure:
        return _check("timing", NOTHING, limit, True, "Readings seem to be of one time.")
    passed = value <= limit
    more = "." if passed else ": read all joints at once, and unfiltered."
    return _check("timing", value, limit, passed, f"In time, {what}{more}")


def gear(found: Mapping[str, Effect], fit: Fit) -> Check:
    """Whether a joint moves by more, or less, than it says."""
    sought = {parameter.name for parameter in fit.parameters}
    told = {name: one for name, one in found.items() if f"{name}.gain" not in sought and abs(one.value) >= 0.0}
    sure = {name: one for name, one in told.items() if abs(one.t) > SURE and one.size > SEEN}
    name = max(sure, key=lambda name: abs(sure[name].value), default="")
    value = abs(sure[name].value) if name else 0.0
    passed = value <= GEAR
    said = (
        f"No joint seems to move by over {100 * GEAR:g} % more or less than its reading says."
        if passed
        else f"{name!r} seems to move by {100.0 * value:.2g} % {'more' if sure[name].value > 0.0 else 'less'} than its "
        "reading says: is its gear ratio right?"
    )
    return _check("gear", value or NOTHING, GEAR, passed, said)


def axes(found: Sequence[Strain]) -> Check:
    """Whether an instrument's axes are of one length and at right angles."""
    told = [one for one in found if one.chance < RARELY and one.size > SEEN]
    worst = max(told, key=lambda one: one.share, default=None)
    if worst is None:
        return _check("axes", NOTHING, STRAIN, True, "The instrument's axes seem to be equally long.")
    passed = worst.share <= STRAIN
    said = f"{worst.file}: one axis of the instrument seems {100.0 * worst.share:.2g} % longer than another"
    more = "." if passed else ", or not at right angles: is its scale right, are coordinates all of one kind?"
    return _check("axes", worst.share, STRAIN, passed, said + more)


def resolution(found: Sequence[Rounding], fit: Fit) -> Check:
    """Whether readings have enough digits: rounding neither moves the tool far, nor is it what remains."""
    limit = COARSE * fit.model.robot.reach
    # Of what remains, far less is left where readings are exact, as where poses were commanded in whole degrees.
    told = [one for one in found if ROUNDED <= one.share <= 1.0 / ROUNDED]
    worst = max(told, key=lambda one: one.distance, default=None)
    if worst is None:
        return _check("resolution", NOTHING, limit, True, "Readings do not seem to be rounded.")
    passed = worst.distance <= limit
    said = f"{worst.file}: rounded readings put the tool {worst.distance / MM:.2g} mm off (rms)"
    more = "." if passed else ", as much as remains: write more of their digits."
    return _check("resolution", worst.distance, limit, passed, said + more)


def groups(found: Outliers, sets: Sequence[Step], fit: Fit) -> Check:
    """Whether groups or targets ask for another machine than the rest; ``sets``: files, for a base or tool of theirs.

    The noise of a file is its own: what it asks for otherwise is in that as well.
    """
    width = max(r.shape[1] for r in fit.residuals)
    told = [(step.size, f"{step.file}", f"a {step.what} of its own") for step in sets if step.chance < RARELY]
    told += [
        (float(np.sqrt(group.gain / (group.rows * width))), f"The {group.kind} {group.name!r}", "other parameters")
        for group in found.disagreeing
        if group.kind != "file"
    ]
    size, name, asks = max(told, default=(0.0, "", ""))
    if size <= SIZE:
        said = f"No group of rows differs from the rest by more than {SIZE:g} times the scatter of the residuals."
        return _check("groups", size or NOTHING, SIZE, True, said)
    said = f"{name} differs from the rest by {size:.2g} times the scatter of the residuals; it fits better with {asks}."
    return _check("groups", size, SIZE, False, said)


def set_ups(found: Sequence[OwnBase]) -> Check:
    """Whether a table asks for a base of its own, by points far apart: robot or instrument was moved before it."""
    wide = [one for one in found if one.wide]
    worst = max(wide, key=lambda one: one.error / one.moved, default=None)
    if worst is None:
        return _check("set-ups", NOTHING, OWN_BASE, True, "No table fits much better with a base of its own.")
    times = worst.error / worst.moved
    return _check("set-ups", times, OWN_BASE, False, worst.sentence)


def one_machine(found: Sequence[MixedMachines], fit: Fit) -> Check:
    """Whether all rows are of one machine: told apart in several, they would leave hardly less, or be hardly apart."""
    limit = OF_REACH * fit.model.robot.reach
    told = [one for one in found if one.share >= MANY and one.apart >= limit]
    if not told:
        said = "The rows do not seem to come from several machines."
        return _check("one machine", NOTHING, 2.0 * MACHINES, True, said)
    worst = max(told, key=lambda one: one.times / one.machines)
    allowed = MACHINES * worst.machines
    passed = worst.times <= allowed
    said = f"Split between {worst.machines} machines, the rows scatter {worst.times:.2g} times less"
    what = (
        f": they differ by {worst.apart / MM:.2g} mm. Did something change between rows: a payload, backlash, the "
        "robot or the target?"
    )
    return _check("one machine", worst.times, allowed, passed, f"{said}{'.' if passed else what}")


def outliers(fit: Fit, own: Sequence[JudgedSet]) -> Check:
    """Whether many rows lie far from the rest."""
    worst, limit, passed, where = 0.0, GROSS, True, ""
    for one, loss in zip(own, fit.losses, strict=False):
        allowed = GROSS if loss == "linear" else GROSS_ROBUST
        for name, errors in error_norms(one.data.kind, one.after).items():
            d = next(q.columns.stop - q.columns.start for q in QUANTITIES[one.data.kind] if q.name == name)
            scale = float(np.median(errors)) / np.sqrt(bound(0.5, d))
            many = int(np.sum(errors > FAR * scale)) if scale > ROUNDING else 0
            share = many / len(errors) if many > 1 else 0.0
            if share / allowed > worst / limit:
                worst, limit, where = share, allowed, one.file
            passed = passed and share <= allowed
    said = f"{100.0 * worst:.2g} % of the rows are more than {FAR:g} standard deviations from the rest"
    said = f"{said}." if passed else f"{where}: {said}; correct or remove them."
    return _check("outliers", worst, limit, passed, said)


def frozen(own: Sequence[JudgedSet]) -> Check:
    """Whether the instrument repeated a value while the robot moved."""
    share, where = 0.0, ""
    for one in own:
        data = one.data
        if data.position is None or len(data) < 3:
            continue
        predicted = data.position - one.after[:, :3]
        moved = np.linalg.norm(np.diff(predicted, axis=0), axis=1)
        noise = float(np.median(np.linalg.norm(one.after[:, :3], axis=1)))
        turned = np.abs(np.diff(data.readings, axis=0)).max(axis=1) > ONE_POSE
        stuck = np.all(np.diff(data.position, axis=0) == 0.0, axis=1) & turned & (moved > min(noise, 1e-4))
        if int(stuck.sum()) > 2 and float(np.mean(stuck)) > share:
            share, where = float(np.mean(stuck)), one.file
    said = f"In {100.0 * share:.2g} % of the rows joints moved, but the measured position is that of the row before"
    passed = share <= FROZEN
    return _check(
        "frozen", share, FROZEN, passed, f"{said}." if passed else f"{where}: {said}: the instrument had stopped."
    )


def in_line(own: Sequence[JudgedSet]) -> Check:
    """Whether points that were measured lie on one line, about which the whole robot may turn."""
    if not own or any(one.data.kind != "position" for one in own):
        return _check("places", NOTHING, LINE, True, "Not only positions were measured.", least=True)
    x = np.concatenate([one.data.position for one in own if one.data.position is not None])
    s = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) if len(x) > 2 else np.zeros(2)
    share = float(s[1] / s[0]) if s[0] > 0.0 else 0.0
    passed = share >= LINE
    said = f"The cloud of measured points is {share:.2g} times as wide as it is long"
    return _check(
        "places",
        share,
        LINE,
        passed,
        f"{said}." if passed else f"{said}: points on one line do not determine the base.",
        least=True,
    )


# ---- what is plausible


def joints(fit: Fit, own: Sequence[JudgedSet]) -> Check:
    """Whether every joint moved."""
    values = np.concatenate([end.readings for one in own for end in one.data.ends])
    moved = np.ptp(values, axis=0)
    # Joints of other arms that no table needs are no part of what was measured.
    absent = set.intersection(*(set(one.data.absent) for one in own)) if own else set()
    told = [
        (reading.name, by) for reading, by in zip(fit.robot.readings, moved, strict=True) if reading.name not in absent
    ]
    still = [name for name, by in told if by <= REST]
    least = min((float(by) for _, by in told), default=np.inf)
    said = "Every joint moved." if not still else f"Never moved, or never read: {', '.join(map(repr, still))}."
    return _check("joints", least, REST, not still, said, least=True)


def lengths(fit: Fit, parts: Sequence[Stretch]) -> Check:
    """Whether the links are about as long as the URDF says, all together and each by itself.

    A common scale is sought in what the deviations do to the tool, other parameters taking up what they can: where
    neighbouring joints move the tool alike, it says nothing how a length is shared between them.
    """
    numbers = {joint.name: k for k, joint in enumerate(fit.robot.chain)}
    scaled = np.zeros(len(fit.parameters))
    moved = np.zeros(len(fit.parameters), dtype=np.bool_)
    for p, parameter in enumerate(fit.parameters):
        joint, _, component = parameter.name.rpartition(".")
        if parameter.kind == "placement" and component in ("tx", "ty", "tz") and joint in numbers:
            T = np.asarray(fit.robot.chain[numbers[joint]].placement)
            # A deviation is in the joint's own frame.
            scaled[p] = (T[:3, :3].T @ T[:3, 3])["xyz".index(component[1])]
            moved[p] = True
    worst, link = 0.0, ""
    for k in sorted(
        {
            numbers[parameter.name.rpartition(".")[0]]
            for parameter, is_ in zip(fit.parameters, moved, strict=True)
            if is_
        }
    ):
        T, own = np.asarray(fit.robot.chain[k].placement), fit.deviations.placements[k, :3]
        length = float(np.linalg.norm(T[:3, 3]))
        by = float(T[:3, 3] @ T[:3, :3] @ own) / length if length > 0.0 else float(np.linalg.norm(own))
        if abs(by) > worst * max(LINK * length, LINK_LENGTH):
            worst = abs(by) / max(LINK * length, LINK_LENGTH)
            link = f"{fit.robot.chain[k].name!r} differs by {by / MM:+.0f} mm"
    scale, sigma = _common_scale(fit, parts, scaled, moved)
    if abs(scale) > SCALE and abs(scale) > SURE * sigma:
        said = f"All links seem {100.0 * scale:+.2g} % longer than in the URDF: is it the URDF of this robot?"
        return _check("lengths", abs(scale), SCALE, False, said)
    if worst > 1.0:
        said = f"The distance to joint {link} from the URDF: is it the URDF of this robot?"
        return _check("lengths", worst * LINK, LINK, False, said)
    if not moved.any():
        said = "No lengths were free."
    elif np.isnan(scale):
        said = "Nothing tells whether all links are longer than in the URDF."
    else:
        said = f"Links seem {100.0 * scale:+.2g} % longer than in the URDF."
    return _check("lengths", abs(scale), SCALE, True, said)


def _common_scale(fit: Fit, parts: Sequence[Stretch], scaled: Array, moved: BoolArray) -> tuple[float, float]:
    """Return by which share all links are longer, and its standard error; nan where nothing shows it."""
    if not moved.any() or not parts:
        return NOTHING, NOTHING
    own = parts[0].columns
    R = triangle(np.concatenate([part.J.reshape(-1, len(own)) for part in parts]))
    values, units, moved = np.column_stack([fit.values, scaled])[own], scales(fit.parameters)[own], moved[own]
    x = R[:, moved] @ (values[moved] / units[moved, None])
    others = R[:, ~moved]
    left = x - others @ np.linalg.lstsq(others, x, rcond=1e-9)[0]
    square = float(left[:, 1] @ left[:, 1])
    if square <= 1e-6 * float(x[:, 1] @ x[:, 1]):
        return NOTHING, NOTHING
    return float(left[:, 0] @ left[:, 1]) / square, 1.0 / float(np.sqrt(square))


def tool_and_base(fit: Fit) -> Check:
    """Whether tools are within reach of their link, and the base within sight."""
    free = {parameter.kind for parameter in fit.parameters}
    reach = max(fit.model.robot.reach, FAR_TOOL)
    found = []
    if "tool" in free:
        far = float(np.linalg.norm(fit.machine.frames.tools[:, :3, 3], axis=1).max(initial=0.0))
        found.append((far / reach, f"A tool point is {far:.2g} m from its link"))
    if "base" in free:
        far = float(np.linalg.norm(fit.machine.frames.bases[:, :3, 3], axis=1).max())
        found.append((far / FAR_BASE, f"The base is {far:.2g} m from the instrument"))
    share, said = max(found, default=(NOTHING, "Base and tool were given"))
    passed = not share > 1.0
    return _check("tool and base", share, 1.0, passed, f"{said}." if passed else f"{said}, farther than is plausible.")


def lens(fit: Fit) -> Check:
    """Whether the lens is an unknown where the arm's placements are, so that they do not pay for its errors.

    Pixels held out do not tell: on photographs of a real arm a lens that was given a little wrong foretold them better
    and left the arm worse.
    """
    if not any(parameter.kind == "placement" for parameter in fit.parameters):
        return _check("lens", NOTHING, 0.0, True, "No placement is sought.")
    given = [data.camera.name for data in fit.measurements if data.camera is not None and not data.camera.free]
    if not given:
        return _check("lens", NOTHING, 0.0, True, "No lens is taken as given.")
    said = (
        f"The lens of {given[0]!r} is taken as given and placements are free: an error of the lens is then taken for "
        'one of the arm, and no uncertainty counts it. Write lens = "free", and the size of the images; or, where the '
        'lens was calibrated for this, accept = ["lens"].'
    )
    return _check("lens", len(given), 0.0, False, said)


def wrong_lens(blame: Blame) -> Check:
    """Whether photographs held out contradict a lens that is taken as given; no answer of a user makes it right."""
    lens = next(cause for cause in blame.causes if cause.name == "lens")
    without = float(np.hypot(blame.left, lens.beside or 0.0))
    said = (
        f"A lens is taken as given, and is another one: with it {without:.2g} px of photographs held out are left, and "
        f'{blame.left:.2g} px with the lens free. Write lens = "free", and the size of the images.'
    )
    return _check("lens", without / blame.left, float(np.sqrt(2.0)), not blame.lens_is_wrong, said)


def warnings(findings: Sequence[Finding]) -> Check:
    """Whether what looked wrong in the input was set right."""
    open_ = [f for f in findings if f.severity == "error" or f.code in COUNTED]
    said = "No warning about the input is open." if not open_ else open_[0].sentence
    return _check("input", len(open_), 0.0, not open_, said)


# ---- what a reader takes home


def shown(fit: Fit, own: Sequence[JudgedSet], held_out: Sequence[JudgedSet]) -> tuple[str, ...]:
    """Return for which range it was shown, and what would make it more certain."""
    judged = held_out or own
    data = [one.data for one in judged]
    said = []
    places = [d.position for d in data if d.position is not None and len(d)]
    whole = [one.data.position for one in own if one.data.position is not None]
    readings = np.concatenate([end.readings for d in data for end in d.ends])
    if places:
        box = np.ptp(np.concatenate(places), axis=0)
        said.append("Shown for the measured range: " + " x ".join(f"{side:.2g}" for side in box) + " m")
    else:
        said.append("Shown for the measured range")
    # A table of one arm of several says nothing of the joints of the others.
    moved = {
        reading.name: np.ptp(np.concatenate(told))
        for k, reading in enumerate(fit.robot.readings)
        if reading.dimension == "angle"
        if (told := [end.readings[:, k] for d in data if reading.name not in d.absent for end in d.ends])
    }
    few = [f"{name} over {by / DEG:.0f} deg" for name, by in moved.items() if by < 30.0 * DEG]
    if few:
        said[0] += f", and for {', '.join(few[:3])}{' and others' if len(few) > 3 else ''} only"
    said[0] += "."
    poses = len(np.unique(np.round(readings / ONE_POSE), axis=0))
    if not held_out:
        said.append("Held-out rows would show how well the machine predicts other poses.")
    elif poses < 20:
        said.append("More than 20 held-out poses would make the verdict more certain.")
    elif whole and places and _volume(places) < 0.1 * _volume(whole):
        said.append("Held-out rows in the whole measured volume would make the verdict more certain.")
    elif few:
        said.append("Rows with larger motions of these joints would widen the range.")
    elif all(noise.instrument == 0.0 for noise in fit.noise):
        said.append("A stated sigma of the instrument would separate its noise from what the model leaves out.")
    return tuple(said)


def _volume(places: Sequence[Array]) -> float:
    return float(np.prod(np.maximum(np.std(np.concatenate(places), axis=0), 1e-6)))
