"""Checks of the rows: what they say of each other, of the instrument, of clocks and of several machines."""

from collections.abc import Mapping, Sequence

import numpy as np

from calib.assessment.changes import LENGTHS, Drift, Step
from calib.assessment.checks.of_fit import OF_REACH, ROUNDING
from calib.assessment.effects import Effect
from calib.assessment.in_time import Timing
from calib.assessment.instrument_errors import Rounding, Strain
from calib.assessment.judged import NOTHING, Check, JudgedSet
from calib.assessment.metrics import error_norms
from calib.assessment.mixed_machines import MixedMachines
from calib.assessment.outliers import Outliers
from calib.assessment.own_base import OwnBase
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.chance import bound
from calib.foundations.units import MM, MRAD, MS
from calib.identification.fit import Fit
from calib.measurement.kinds import QUANTITIES
from calib.measurement.poses import ONE_POSE
from calib.robot.robot import Robot

# The chance below which an effect is no accident, and its least size in scatters of the residuals.
RARELY, SIZE = 1e-4, 3.0
# By this share of the reach the base may drift; so much longer is an arm that is a degree or two warmer.
WANDERED, WARMER = 5e-4, 2e-5
# Scatters of the residuals by which anything may drift, and lengths: where rows go along a joint, the gear of a poor
# arm wobbles with them, by up to 1.4 as a drift of joints or the base, and by less than 1 as one of lengths.
DRIFTED, GROWN = 2.0, 1.0
_WHY_IT_DRIFTS = {
    "base": "the instrument or the robot moved",
    "tool": "the tool, or what it carries, moved",
    LENGTHS: "let it warm up before it is measured",
}
# Rows between measurements and readings; the share by which a joint moves more; standard errors and least size of both.
LATE, GEAR, SURE, SEEN = 0.2, 0.01, 6.0, 1.0
# Of 27 sound sessions with times the largest was 0.17.
SEEN_IN_TIME = 0.3
# How far joints have still to go differs from pose to pose, and only what is alike is seen.
SEEN_AT_REST = 0.5
# The same of a joint of a stream that is behind its reading.
SEEN_BEHIND = 0.5
# The share by which one axis of an instrument may be longer than another.
STRAIN = 2e-3
# Rounding of a share of the reach that is this share of what remains.
COARSE, ROUNDED = 1e-3, 0.5
# A base of its own brings a table's error to less than one part in this.
OWN_BASE = 2.0
# Times the number of machines: parts of one that changes steadily leave as much less as they are many. Fewer rows than
# that share are outliers, which another check judges.
MACHINES, MANY = 1.5, 0.15
# The share of rows that may be farther than FAR standard deviations from the rest, also with a robust loss.
GROSS, GROSS_ROBUST, FAR = 0.05, MANY, 5.0
# The share of rows that may repeat the value before.
FROZEN = 0.02
# The least width of the cloud of points, as a share of its length.
LINE = 5e-3


def jump(found: Sequence[Step], outliers: Outliers) -> Check:
    """Whether base, tool, a joint or a target moved between two rows."""
    real = [step for step in found if step.chance < RARELY]
    worst = max(real, key=lambda step: step.size, default=None)
    size, said, parted = 0.0, "", ""
    if worst is not None:
        size, parted = worst.size, worst.parted
        said = f"{worst.file}:{worst.line}: after this row the {_thing(worst.what)}"
        if worst.photographed and worst.what == "base":
            said += ", or the board or camera that stands beside it,"
        said += f" seems to have changed, by {size:.2g} times the scatter of the residuals"
    for target in outliers.moved:
        n, m = target.rows
        moved = float(np.sqrt(target.gain * (n + m) / (n * m)))
        if moved > size:
            size, parted = moved, ""
            said = f"{target.file}:{target.line}: after this row {target.target!r} seems to have moved, by {moved:.2g}"
            said += " times the scatter of the residuals"
    if size <= SIZE:
        said = f"Between no two rows is there a jump above {SIZE:g} times the scatter of the residuals."
        return Check.of("jump", size or NOTHING, SIZE, True, said)
    said += ": identify the rows before it and after it separately"
    if parted:
        said += f"; or, as {parted} stood elsewhere before it than after it, the arm has errors there that the model"
        said += ' leaves out, which terms = "auto" may find'
    return Check.of("jump", size, SIZE, False, f"{said}.")


def _thing(what: str) -> str:
    return what if what in ("base", "tool", LENGTHS) else f"offset of {what!r}"


def drift(found: Sequence[Drift], fit: Fit) -> Check:
    """Whether base, tool, a joint or the lengths of the arm wandered in the course of the rows.

    A base may, by some of its instrument's noise; what an arm is now, its calibration is to say.
    """
    reach = fit.reach
    told = [(one, _drift_limit(one, reach)) for one in found if one.chance < RARELY]
    if not told:
        return Check.idle("drift", WANDERED * reach, "Nothing seems to drift over the rows.")
    # What drifts moves others as well, in part: of those that move far, the likeliest is named.
    far = [(one, limit) for one, limit in told if one.size > limit]
    if far:
        worst, limit = max(far, key=lambda each: each[0].gain)
    else:
        worst, limit = max(told, key=lambda each: each[0].size / each[1])
    said = f"{worst.file}: over the rows the {_thing(worst.what)} seems to drift, which moves the tool by"
    why = _WHY_IT_DRIFTS.get(worst.what, "the joint or its encoder moved")
    return Check.judged("drift", worst.size, limit, f"{said} {worst.size / MM:.2g} mm", f": {why}.")


def _drift_limit(one: Drift, reach: float) -> float:
    if one.what == "base":
        return max(WANDERED * reach, DRIFTED * one.scatter)
    return max(WARMER * reach, (GROWN if one.what == LENGTHS else DRIFTED) * one.scatter)


def late(found: Effect, step: float = NOTHING) -> Check:
    """Whether what was measured is later, or earlier, than the readings beside it: in rows, or in s, ``step`` a row.

    In rows it must show in each of them: nobody knows that their order is that of time. Where times say so, an effect
    may be as much smaller as rows are many.
    """
    in_time = step > 0.0
    limit = LATE * step if in_time else LATE
    if not (abs(found.t) > SURE and found.size > (SEEN_IN_TIME if in_time else SEEN)):
        return Check.idle("delay", limit, "No delay between measurements and readings is seen.")
    value = abs(found.value)
    factor, unit = (1.0 / MS, "ms") if in_time else (1.0, "rows")
    how = "later" if found.value > 0.0 else "earlier"
    said = f"Measurements are {value * factor:.2g} +- {found.sigma * factor:.2g} {unit} {how} than their readings"
    cure = 'let a clock be found, clock = "free", or align the times of both' if in_time else "align the times of both"
    return Check.judged("delay", value, limit, said, f": {cure}.")


def at_rest(found: Effect) -> Check:
    """Whether the arm stood when it was read and measured: ``found``, how far its farthest joint had still to go."""
    if not (abs(found.t) > SURE and found.size > SEEN_AT_REST):
        return Check.idle("at rest", SEEN_AT_REST, "The arm seems to have stood still in every row.")
    when = (
        "readings were taken before the arm had come to rest"
        if found.value > 0.0
        else "poses were measured before the arm had come to rest where its readings say"
    )
    said = f"It seems that {when}: residuals are {found.size:.2g} times their scatter along the motion from row to row"
    cure = "wait before you read and measure, or take the commanded positions."
    return Check.of("at rest", found.size, SEEN_AT_REST, False, f"{said}: {cure}")


def timing(found: Timing, robot: Robot) -> Check:
    """Whether readings of a stream are of one time, and of that alone, and joints where they are read both ways."""
    limit = LATE * found.step
    told = [
        (abs(one.value), one, f"readings of {name!r} seem to be {abs(one.value) / MS:.2g} ms off those of the others")
        for name, one in found.by_joint.items()
    ]
    width = float(np.sqrt(2.0 * max(found.smoothed.value, 0.0)))
    told.append((width, found.smoothed, f"readings seem to be means over times, {width / MS:.2g} ms wide (rms)"))
    # Where one joint is late, others seem so with it: the one that explains most is named.
    sure = [one for one in told if abs(one[1].t) > SURE and one[1].size > SEEN_IN_TIME]
    most = max((one.size for _, one, _ in sure), default=SEEN_BEHIND)
    behind = {
        name: one
        for name, one in found.ahead.items()
        if abs(one.t) > max(SURE, np.sqrt(bound(1.0 - RARELY, 1, one.freedom))) and one.size > max(most, SEEN_BEHIND)
    }
    if behind:
        return _behind(behind, robot)
    if not sure:
        return Check.idle("timing", limit, "Readings seem to be of one time.")
    value, _, what = max(sure, key=lambda one: one[1].size)
    return Check.judged("timing", value, limit, f"In time, {what}", ": read all joints at once, and unfiltered.")


def _behind(found: Mapping[str, Effect], robot: Robot) -> Check:
    """Return that a joint is not where it is read, but behind on the way that it goes, or ahead."""
    name = max(found, key=lambda one: found[one].size)
    one = found[name]
    slides = any(reading.name == name and reading.dimension == "length" for reading in robot.readings)
    far = f"{abs(one.value) / MM:.2g} mm" if slides else f"{abs(one.value) / MRAD:.2g} mrad"
    said = (
        f"{name!r} seems to be {far} {'ahead of' if one.value > 0.0 else 'behind'} its reading on the way that it goes"
    )
    cure = f'as by backlash: free that, backlash = ["{name}"], with in_order = true, or take it out.'
    return Check.of("timing", one.size, SEEN_BEHIND, False, f"{said}, {cure}")


# Of a joint that moved in a row or two alone, an error of these looks like the size, or the sign, of its motion.
_FEWEST_TELLING = 3.0
_OR_ROWS = "or the few rows in which it moved are wrong"


def gear(found: Mapping[str, Effect], followers: Mapping[tuple[str, str], Effect], fit: Fit, turned: str = "") -> Check:
    """Whether a joint moves by more, or less, than it says; ``followers``: than what says how it follows another.

    ``turned``: the joint that moves the other way, if there is one.
    """
    if turned and _telling(fit, turned) < _FEWEST_TELLING:
        said = (
            f"{turned!r} seems to be read with the wrong sign, {_OR_ROWS}: with the other sign residuals are smaller."
        )
        return Check.of("gear", abs(found[turned].value), GEAR, False, said)
    if turned:
        said = (
            f"{turned!r} seems to be read with the wrong sign: with the other sign residuals are smaller. Where a "
            "joint moves little, a tool on the other side of its axis hides that."
        )
        return Check.of("gear", abs(found[turned].value), GEAR, False, said)
    sought = {parameter.name for parameter in fit.parameters}
    told = [
        (one, f"{name!r}", f"its reading says{_unless(fit, name)}: is its gear ratio right")
        for name, one in found.items()
        if f"{name}.gain" not in sought
    ]
    told += [
        (one, f"{name!r}", f"the multiple says by which it follows {driver!r}: is that right")
        for (name, driver), one in followers.items()
    ]
    sure = [each for each in told if abs(each[0].t) > SURE and each[0].size > SEEN]
    worst = max((abs(one.value) for one, *_ in sure), default=NOTHING)
    large = [each for each in sure if abs(each[0].value) > GEAR]
    if not large:
        said = f"No joint seems to move by over {100 * GEAR:g} % more or less than its reading says."
        return Check.of("gear", worst, GEAR, True, said)
    # What a wrong ratio of one does to all, others can in part: the one that explains most is named.
    one, name, what = max(large, key=lambda each: each[0].size)
    more = "more" if one.value > 0.0 else "less"
    said = f"{name} seems to move by {100.0 * abs(one.value):.2g} % {more} than {what}?"
    return Check.of("gear", abs(one.value), GEAR, False, said)


def _unless(fit: Fit, name: str) -> str:
    return f", {_OR_ROWS}" if _telling(fit, name) < _FEWEST_TELLING else ""


def _telling(fit: Fit, name: str) -> float:
    """Return how many rows tell how far a joint moves: about half of those spread anywhere, one if one stands apart."""
    k = [reading.name for reading in fit.model.robot.readings].index(name)
    reading = np.concatenate([data.readings[:, k] for data in fit.measurements])
    squares = (reading - np.median(reading)) ** 2
    return float(squares.sum() ** 2 / np.sum(squares**2)) if squares.any() else 0.0


def axes(found: Sequence[Strain], moved_more: Mapping[str, Effect]) -> Check:
    """Whether an instrument's axes are of one length and at right angles; ``moved_more``: joints, than they say.

    A joint that slides, and one that turns a SCARA, may look like an axis: what explains more is named.
    """
    told = [one for one in found if one.chance < RARELY and one.size > SEEN]
    worst = max(told, key=lambda one: one.share, default=None)
    if worst is None:
        return Check.idle("axes", STRAIN, "The instrument's axes seem to be equally long.")
    said = f"{worst.file}: one axis of the instrument seems {100.0 * worst.share:.2g} % longer than another"
    more = ", or not at right angles: is its scale right, are coordinates all of one kind?"
    better = [(one.size, name) for name, one in moved_more.items() if abs(one.t) > SURE and one.size > worst.size]
    if better:
        _, name = max(better)
        by = moved_more[name].value
        more = (
            f", but more is explained if {name!r} moves by {100.0 * abs(by):.2g} % {'more' if by > 0.0 else 'less'} "
            "than its reading says: is its gear ratio right, or else the scale of the instrument?"
        )
    return Check.judged("axes", worst.share, STRAIN, said, more)


def resolution(found: Sequence[Rounding], fit: Fit) -> Check:
    """Whether readings have enough digits: rounding neither moves the tool far, nor is it what remains."""
    limit = COARSE * fit.reach
    # Of what remains, far less is left where readings are exact, as where poses were commanded in whole degrees.
    told = [one for one in found if ROUNDED <= one.share <= 1.0 / ROUNDED]
    worst = max(told, key=lambda one: one.distance, default=None)
    if worst is None:
        return Check.idle("resolution", limit, "Readings do not seem to be rounded.")
    said = f"{worst.file}: rounded readings put the tool {worst.distance / MM:.2g} mm off (rms)"
    more = ", as much as remains: write more of their digits."
    return Check.judged("resolution", worst.distance, limit, said, more)


def groups(found: Outliers, sets: Sequence[Step], targets: Sequence[Step], fit: Fit) -> Check:
    """Whether groups or targets ask for another machine than the rest; ``sets``: files, for a base or tool of theirs.

    ``targets``: those that are stated to be somewhere, for another place.

    The noise of a file is its own: what it asks for otherwise is in that as well.
    """
    width = max(r.shape[1] for r in fit.residuals)
    told = [(step.size, f"{step.file}", f"a {step.what} of its own") for step in sets if step.chance < RARELY]
    told += [
        (step.size, f"{step.file}: the target {step.what!r}", "another place")
        for step in targets
        if step.chance < RARELY
    ]
    told += [
        (float(np.sqrt(group.gain / (group.rows * width))), f"The {group.kind} {group.name!r}", "other parameters")
        for group in found.disagreeing
        if group.kind != "file"
    ]
    size, name, asks = max(told, default=(0.0, "", ""))
    if size <= SIZE:
        said = f"No group of rows differs from the rest by more than {SIZE:g} times the scatter of the residuals."
        return Check.of("groups", size or NOTHING, SIZE, True, said)
    said = f"{name} differs from the rest by {size:.2g} times the scatter of the residuals; it fits better with {asks}."
    return Check.of("groups", size, SIZE, False, said)


def set_ups(found: Sequence[OwnBase]) -> Check:
    """Whether a table asks for a base of its own, by points far apart: robot or instrument was moved before it."""
    wide = [one for one in found if one.wide]
    worst = max(wide, key=lambda one: one.error / one.moved, default=None)
    if worst is None:
        return Check.idle("set-ups", OWN_BASE, "No table fits much better with a base of its own.")
    times = worst.error / worst.moved
    return Check.of("set-ups", times, OWN_BASE, False, worst.sentence)


def one_machine(found: Sequence[MixedMachines], fit: Fit) -> Check:
    """Whether all rows are of one machine: told apart in several, they would leave hardly less, or be hardly apart."""
    limit = OF_REACH * fit.reach
    told = [one for one in found if one.share >= MANY and one.apart >= limit]
    if not told:
        return Check.idle("one machine", 2.0 * MACHINES, "The rows do not seem to come from several machines.")
    worst = max(told, key=lambda one: one.times / one.machines)
    said = f"Split between {worst.machines} machines, the rows scatter {worst.times:.2g} times less"
    what = (
        f": they differ by {worst.apart / MM:.2g} mm. Did something change between rows: a payload, backlash, the "
        "robot or the target?"
    )
    return Check.judged("one machine", worst.times, MACHINES * worst.machines, said, what)


def outliers(fit: Fit, own: Sequence[JudgedSet]) -> Check:
    """Whether many rows lie far from the rest."""
    worst, limit, passed, where = 0.0, GROSS, True, ""
    for i, (one, loss) in enumerate(zip(own, fit.losses, strict=False)):
        allowed = GROSS if loss == "linear" else GROSS_ROBUST
        for name, errors in error_norms(one.data.kind, one.after).items():
            d = next(q.columns.stop - q.columns.start for q in QUANTITIES[one.data.kind] if q.name == name)
            freedom = sum(n.degrees_of_freedom for n in fit.noise if (n.measurements, n.quantity) == (i, name))
            many = int(np.sum(far_off(errors, d, freedom)))
            share = many / len(errors) if many > 1 else 0.0
            if share / allowed > worst / limit:
                worst, limit, where = share, allowed, one.file
            passed = passed and share <= allowed
    said = f"{100.0 * worst:.2g} % of the rows are more than {FAR:g} standard deviations from the rest"
    # A joint that moves with another, and a model without that, look alike.
    why = "they are wrong, or the arm does there what the model leaves out; look at them before any is removed."
    said = f"{said}." if passed else f"{where}: {said}: {why}"
    return Check.of("outliers", worst, limit, passed, said)


def far_off(errors: Array, d: int, freedom: float = np.inf) -> BoolArray:
    """Return which rows, by the lengths (N,) of their errors of d numbers, lie farther off than others ever do.

    By more than five standard deviations, which the median tells; ``freedom``: how many numbers tell them.
    """
    scale = float(np.median(errors)) / np.sqrt(bound(0.5, d))
    return np.asarray((errors > FAR * _poorly_known(freedom) * scale) & (scale > ROUNDING))


def _poorly_known(freedom: float) -> float:
    """Return by how much farther off rows must be whose scatter few numbers tell: Student's t beside the normal one.

    Of a few touches of each ball, parameters leave next to nothing of most rows, and the others seem far from them.
    """
    return float(np.sqrt(bound(1.0 - RARELY, 1, max(freedom, 1.0)) / bound(1.0 - RARELY, 1)))


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
    more = ": the instrument had stopped."
    return Check.judged("frozen", share, FROZEN, said if share <= FROZEN else f"{where}: {said}", more)


def in_line(fit: Fit, own: Sequence[JudgedSet]) -> Check:
    """Whether points that were measured lie on one line, about which the whole robot may turn."""
    if not own or any(one.data.kind != "position" for one in own):
        return Check.idle("places", LINE, "Not only positions were measured.", least=True)
    x = np.concatenate([fit.places_of(one.data) for one in own])
    s = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) if len(x) > 2 else np.zeros(2)
    share = float(s[1] / s[0]) if s[0] > 0.0 else 0.0
    said = f"The cloud of measured points is {share:.2g} times as wide as it is long"
    return Check.judged("places", share, LINE, said, ": points on one line do not determine the base.", least=True)
