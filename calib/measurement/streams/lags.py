"""By how much two clocks differ, from the speeds that they saw, without a guess.

The arm moves now faster and now slower, and does so by both clocks. In windows of about a minute the measured speed is
correlated with that of the nominal tip, and with that of what it carries; each window has the lag where the correlation
is largest, and a line through the lags has the offset and the skew of the clocks. Where several lags correlate alike,
as of an arm that goes and stops in turn, positions decide. One correlation over an hour would fail: at a skew of 1e-3
its ends are 3.6 s apart.

From there starts within a second are tried, and the best is refined. A measured point p follows from the nominal tip
(R, x) by ``p = A x + B vec(R) + c`` whatever base and tool are: linear in 13 numbers a coordinate, so that each start
costs one small linear least-squares problem.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import MeasurementError
from calib.foundations.units import MM

# Speeds are taken over twice as much, in s, on a grid of such steps: noise of 0.1 mm is then 1 mm/s.
_HALF, _STEP = 0.05, 0.02
# Time and memory of the search grow with the whole of it, also with what is not known between; in s.
_LONGEST = 1e4
# Windows, in s; shorter streams have shorter ones. So many of them, evenly spread, are enough.
_WINDOW, _SHARE, _MOST_WINDOWS = 60.0, 0.6, 24
# No two clocks differ by more; quartz keeps 1e-4.
MOST_SKEW = 5e-3
# Lags of windows are on a line within such a time, in s.
_ON_LINE = 0.05
# Speeds that go together correlate so much at least; another lag that correlates nearly as well makes both doubtful.
_TOGETHER, _AS_WELL, _APART = 0.5, 0.9, 1.0
# How far a tool may be beside its tip, in m.
_BESIDE = 0.1
# What is slower, in m/s, is at rest.
_SLOWEST = 2e-3
# Of a window so much must be known by both clocks. Stretches between pauses that are shorter, in s, follow any motion
# by chance; they are passed over where others are longer.
_KNOWN, _SHORT = 0.7, 5.0
# Starts about the line, in s, and rows by which they are judged.
_STARTS, _ROWS, _ROUNDS = np.linspace(-1.0, 1.0, 41), 500, 12
# Of a change of the clock, so little left by 13 numbers is rounding; units of offset and skew.
_HIDDEN, _UNITS = 1e-4, np.array([1.0, 1e-3])
# Of the spread of points, a share that no wrong lag comes down to; and what is rounding, in m.
_EXPLAINED, _ROUNDING = 0.1, 1e-5
# A lag that knows less than half of the rows that another knows, which leaves at most twice as much, is chance: its 13
# numbers for a coordinate follow a short motion well.
_FEWER, _MORE_LEFT = 0.5, 2.0
# Lags that a window may have.
_MOST_PEAKS = 6


class Lag(NamedTuple):
    """What the other clock shows when this one shows ``middle``, less that, and how much more it goes in a second.

    ``u = t - offset + skew (t - middle)``.
    """

    offset: float
    skew: float


Tips = Callable[[Array], Array]


class Seen(NamedTuple):
    """Measured points (N, 3) in m at times (N,) in s by the instrument's clock; ``where`` they are from.

    ``groups`` (N,): numbers from 0; rows of one number have one base and one tool.
    """

    times: Array
    points: Array
    where: str
    groups: IntArray


class Moved(NamedTuple):
    """Nominal tips: ``tips`` returns them (n, 4, 4) at times (n,) by the controller's clock, from ``start`` to ``end``.

    ``known``: at which times the readings are known; ``where`` they are from.
    """

    tips: Tips
    known: Callable[[Array], BoolArray]
    start: float
    end: float
    where: str


class _Speeds(NamedTuple):
    """Speeds (n,) in m/s on a grid that begins at ``start``, and where they are known (n,)."""

    start: float
    values: Array
    known: BoolArray


def clock_lag(seen: Seen, moved: Moved, middle: float, gap: float) -> Lag:
    """Return how the instrument's clock lags behind the controller's, by the motion that both saw.

    ``middle``: where the offset is told, in s; measured points that are ``gap`` s apart or more are not joined.
    Raises MeasurementError when nothing moved enough, when speeds do not go together, and when two lags fit alike.
    """
    for where, span in ((seen.where, seen.times[-1] - seen.times[0]), (moved.where, moved.end - moved.start)):
        if span > _LONGEST:
            raise MeasurementError(
                f"{where}: its times span {span:.4g} s, and a free clock is searched in {_LONGEST:g} s at the most; "
                "give a part of the rows, or correct the unit of 'time'."
            )
    measured = _speeds(seen, gap)
    step = float(np.median(np.diff(seen.times)))
    # Equal steps differ in their last digits.
    apart = step > (1.0 - 1e-6) * gap
    if not apart and np.ptp(seen.groups) and not measured.known.any():
        raise MeasurementError(
            f"{seen.where}: tool or set-up change from row to row, which shows no speed; give each a table of its own."
        )
    if apart or not measured.known.any():
        raise MeasurementError(
            f"{seen.where}: its rows are {step:.4g} s apart, and gaps from {gap:.4g} s on are not bridged; allow "
            "longer gaps, or measure more often."
        )
    fastest = _fastest(measured)
    if fastest < _SLOWEST:
        raise _hardly_moves(seen.where, "what was measured", fastest)
    starts = _starts(measured, seen.where, moved, middle)
    # Recordings of two different motions fit best at the largest skew that is allowed.
    fitted = [refined(seen, moved, middle, start) for start in starts]
    found = _by_what_they_leave([one for one in fitted if abs(one.lag.skew) < MOST_SKEW])
    if not found:
        raise MeasurementError(
            f"{seen.where}: its points move as the nominal tip of {moved.where} only if one clock gains {MOST_SKEW:g} "
            "s in a second on the other, and no real clock does; do the two recordings overlap, and are they of this "
            "robot?"
        )
    best, others = found[0], [one for one in found[1:] if abs(one.lag.offset - found[0].lag.offset) > _APART]
    spread = float(np.sqrt(np.mean((seen.points - seen.points.mean(axis=0)) ** 2)))
    if best.left > _EXPLAINED * spread:
        raise MeasurementError(
            f"{seen.where}: its points do not move as the nominal tip does at any time of {moved.where} "
            f"({best.left / MM:.3g} of {spread / MM:.3g} mm remain); do the two recordings overlap, and are they of "
            "this robot?"
        )
    if others and others[0].left < max(best.left, _ROUNDING) / _AS_WELL:
        raise MeasurementError(
            f"{seen.where}: its motion fits that of {moved.where} equally well at two lags, {best.lag.offset:.2f} and "
            f"{others[0].lag.offset:.2f} s; record a motion that does not repeat itself."
        )
    return best.lag


def _starts(measured: _Speeds, where: str, moved: Moved, middle: float) -> list[Lag]:
    """Return lags at which speeds go together: with that of the nominal tip, and with that of what is beside it.

    A tip on the axis of its joint stands still where the tool that it carries does not.
    """
    grid = np.arange(moved.start, moved.end, _STEP)
    known = moved.known(grid)
    tips = np.zeros((len(grid), 4, 4))
    tips[known] = moved.tips(grid[known])
    found: list[Lag] = []
    refused: MeasurementError | None = None
    for beside in (0.0, _BESIDE):
        # The mean square of the speeds of points all around, at that distance.
        places = np.concatenate([tips[:, :3, 3], beside / np.sqrt(3.0) * tips[:, :3, :3].reshape(-1, 9)], axis=1)
        nominal = _speeds_of_grid(moved.start, places, known)
        try:
            if _fastest(nominal) < _SLOWEST:
                raise _hardly_moves(moved.where, "the nominal tip", _fastest(nominal))
            peaks = _peaks(measured, nominal, where, moved.where)
            found += _lines(peaks._replace(times=peaks.times - middle), where)
        except MeasurementError as e:
            refused = refused or e
    if not found and refused is not None:
        raise refused
    return found


def _fastest(speeds: _Speeds) -> float:
    return float(np.quantile(speeds.values[speeds.known], 0.95)) if speeds.known.any() else 0.0


def _hardly_moves(where: str, what: str, fastest: float) -> MeasurementError:
    return MeasurementError(
        f"{where}: {what} hardly moves, at {fastest / MM:.2g} mm/s; a free clock is found from motion, and "
        f"{_SLOWEST / MM:g} mm/s or more are needed."
    )


def _speeds(seen: Seen, gap: float) -> _Speeds:
    times, points = seen.times, seen.points
    grid = np.arange(times[0], times[-1], _STEP)
    places = np.column_stack([np.interp(grid, times, points[:, k]) for k in range(3)])
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    # From one base or tool to another is no motion of the arm.
    joined = (times[after] - times[after - 1] < gap) & (seen.groups[after] == seen.groups[after - 1])
    return _speeds_of_grid(float(times[0]), places, joined)


def _speeds_of_grid(start: float, places: Array, known: BoolArray) -> _Speeds:
    n, k = len(places), max(round(_HALF / _STEP), 1)
    values, all_known = np.zeros(n), np.zeros(n, dtype=np.bool_)
    if n > 2 * k:
        values[k : n - k] = np.linalg.norm(places[2 * k :] - places[: n - 2 * k], axis=1) / (2 * k * _STEP)
        unknown = np.concatenate([[0], np.cumsum(~known)])
        all_known[k : n - k] = unknown[2 * k + 1 :] == unknown[: n - 2 * k]
    return _Speeds(start, np.where(all_known, values, 0.0), all_known)


class _Peaks(NamedTuple):
    """Lags (n,) in s at which windows (n,) with the middles ``times`` (n,) correlate, and how much (n,)."""

    window: IntArray
    times: Array
    lags: Array
    heights: Array


def _peaks(measured: _Speeds, nominal: _Speeds, where: str, other: str) -> _Peaks:
    """Return the best lags of every window whose speeds go together. Raises as :func:`clock_lag` does."""
    apart, highest, found = max(round(_APART / _STEP), 1), 0.0, []
    for w, window in enumerate(_windows(measured.known, len(nominal.values))):
        start, length = window.start, window.stop - window.start
        correlation = _correlation(measured.values[window], measured.known[window], nominal)
        left = correlation.copy()
        highest = max(highest, float(left.max(initial=0.0)))
        for _ in range(_MOST_PEAKS):
            k = int(np.argmax(left))
            if left[k] < max(_TOGETHER, _AS_WELL * float(correlation.max())):
                break
            t = measured.start + _STEP * (start + 0.5 * length)
            u = nominal.start + _STEP * (k - (length - 1) + _top(correlation, k) + 0.5 * length)
            found.append((w, t, t - u, correlation[k]))
            left[max(k - apart, 0) : k + apart + 1] = 0.0
    if not found:
        raise MeasurementError(
            f"{where}: its speed does not follow that of the nominal tip by {other} (correlation {highest:.2g}, "
            f"{_TOGETHER:g} is needed): do the two recordings overlap, and are they of this robot?"
        )
    window, times, lags, heights = np.array(found).T
    return _Peaks(window.astype(np.intp), times, lags, heights)


def _windows(known: BoolArray, other: int) -> list[slice]:
    """Return windows of a grid (n,) that is correlated with one of ``other`` steps: some in every stretch of it.

    Stretches have pauses between them, which no window bridges.
    """
    length = _length(len(known), other)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(np.int8)))
    pauses = [(a, b) for a, b in edges.reshape(-1, 2) if b - a > (1.0 - _KNOWN) * length]
    ends = np.array([0, *(end for pause in pauses for end in pause), len(known)]).reshape(-1, 2)
    least = min(_SHORT / _STEP, max(b - a for a, b in ends))
    stretches = [(a, b) for a, b in ends if b - a >= max(least, 1)]
    # Each stretch has two windows or more.
    some = np.unique(np.linspace(0, len(stretches) - 1, _MOST_WINDOWS // 2).astype(np.intp))
    most = max(_MOST_WINDOWS // len(some), 2)
    found = []
    for a, b in (stretches[k] for k in some):
        n, length = b - a, _length(b - a, other)
        count = int(np.clip(2 * (n // max(length, 1)), 2, most))
        found += [slice(a + start, a + start + length) for start in np.linspace(0, n - length, count).astype(np.intp)]
    return found


def _length(steps: int, other: int) -> int:
    return int(min(_WINDOW / _STEP, _SHARE * steps, _SHARE * other))


def _correlation(a: Array, known: BoolArray, other: _Speeds) -> Array:
    """Return the correlation of a window (n,) with every stretch of another grid (m,), shifted from -(n - 1) to m - 1.

    Only what both know counts (D. Padfield, Masked object registration in the Fourier domain, 2012); 0 where that is
    too little, or does not vary.
    """
    n, size = len(a), len(a) + len(other.values) - 1
    fft = 1 << (size - 1).bit_length()

    def spectrum(x: Array) -> np.ndarray:
        return np.fft.rfft(x, fft)

    def shifted(x: np.ndarray, y: np.ndarray) -> Array:
        return np.fft.irfft(np.conj(x) * y, fft)

    weights, x, b = known.astype(np.float64), np.where(known, a, 0.0), other.values
    of_a = [spectrum(np.pad(v, 0)) for v in (weights, x, x * x)]
    of_b = [spectrum(v) for v in (other.known.astype(np.float64), b, b * b)]
    both = np.maximum(shifted(of_a[0], of_b[0]), 1.0)
    mean_a, mean_b = shifted(of_a[1], of_b[0]) / both, shifted(of_a[0], of_b[1]) / both
    var_a = shifted(of_a[2], of_b[0]) / both - mean_a**2
    var_b = shifted(of_a[0], of_b[2]) / both - mean_b**2
    cov = shifted(of_a[1], of_b[1]) / both - mean_a * mean_b
    usual = float(np.var(a[known])) if known.any() else 0.0
    enough = (both >= _KNOWN * n) & (var_a > 0.05 * usual) & (var_b > 0.05 * usual)
    found = np.where(enough, cov / np.sqrt(np.where(enough, var_a * var_b, 1.0)), 0.0)
    # Negative shifts are at the end of a transform.
    return np.concatenate([found[fft - (n - 1) :], found[: len(b)]]) if n > 1 else found[: len(b)]


def _top(values: Array, k: int) -> float:
    """Return where, beside k, the parabola through three values is highest."""
    if not 0 < k < len(values) - 1:
        return 0.0
    before, at, after = values[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def _lines(peaks: _Peaks, where: str) -> list[Lag]:
    """Return lines through the peaks of most windows, and such that pass through nearly as many, 1 s apart."""
    n, windows = len(peaks.times), len(np.unique(peaks.window))
    found: list[tuple[float, Lag]] = []
    for i in range(n):
        for j in range(i, n):
            between = peaks.times[j] - peaks.times[i]
            slope = (peaks.lags[j] - peaks.lags[i]) / between if between > 0.0 else 0.0
            if abs(slope) > MOST_SKEW or (i != j and between <= 0.0):
                continue
            near = np.abs(peaks.lags - peaks.lags[i] - slope * (peaks.times - peaks.times[i])) <= _ON_LINE
            if len(np.unique(peaks.window[near])) >= 0.5 * windows:
                found.append((float(np.sum(peaks.heights[near])), _through(peaks.times[near], peaks.lags[near])))
    if not found:
        spread = ", ".join(f"{lag:.2f}" for lag in peaks.lags[:5])
        raise MeasurementError(
            f"{where}: by its speed, the clocks are {spread} s apart, one after the other, and real clocks do not "
            "jump; was one of the recordings interrupted?"
        )
    found.sort(key=lambda one: -one[0])
    lines: list[Lag] = []
    for height, line in found:
        if height >= _AS_WELL * found[0][0] and all(abs(line.offset - other.offset) > _APART for other in lines):
            lines.append(line)
    return lines[:_MOST_PEAKS]


def _through(t: Array, lags: Array) -> Lag:
    """Return the line through lags (w,) at times t (w,) from the middle."""
    slope = float(np.polyfit(t, lags, 1)[0]) if np.ptp(t) > 0.0 else 0.0
    slope = float(np.clip(slope, -MOST_SKEW, MOST_SKEW))
    return Lag(float(np.median(lags - slope * t)), -slope)


class Refined(NamedTuple):
    """A lag, and the rms in m of what it leaves of the ``rows`` that both clocks know."""

    lag: Lag
    left: float
    rows: int


def _by_what_they_leave(fitted: list[Refined]) -> list[Refined]:
    """Return lags, that which leaves least first, without such as explain a few rows by chance."""

    def by_chance(one: Refined) -> bool:
        return any(
            one.rows < _FEWER * other.rows and other.left <= _MORE_LEFT * max(one.left, _ROUNDING) for other in fitted
        )

    return sorted((one for one in fitted if not by_chance(one)), key=lambda one: one.left)


def refined(seen: Seen, moved: Moved, middle: float, near: Lag) -> Refined:
    """Return the lag that explains positions best, of starts within a second of one that is nearly right.

    Raises MeasurementError where the clocks do not overlap.
    """
    rows = np.unique(np.linspace(0, len(seen.times) - 1, _ROWS).astype(np.intp))
    t, p, groups = seen.times[rows], seen.points[rows], seen.groups[rows]

    def system(lag: Lag, at: Array) -> tuple[Array, Array, BoolArray]:
        u = at - lag.offset + lag.skew * (at - middle)
        known = moved.known(u - 2.0 * _STEP) & moved.known(u + 2.0 * _STEP)
        return _columns(moved.tips(u[known]), groups[known]), u[known], known

    def left(lag: Lag) -> float:
        F, _, known = system(lag, t)
        if known.sum() < 0.2 * len(t) or known.sum() < 3 * F.shape[1]:
            return np.inf
        theta = np.linalg.lstsq(F, p[known], rcond=1e-10)[0]
        return float(np.sqrt(np.mean((p[known] - F @ theta) ** 2)))

    best = min((near._replace(offset=near.offset + s) for s in _STARTS), key=left)
    if not np.isfinite(left(best)):
        raise MeasurementError(
            f"{seen.where}: its clock and that of {moved.where} do not overlap; the rows of both must be of one time."
        )
    for _ in range(_ROUNDS):
        F, u, known = system(best, t)
        F_after, F_before = (_columns(moved.tips(u + h), groups[known]) for h in (1e-3, -1e-3))
        theta = np.linalg.lstsq(F, p[known], rcond=1e-10)[0]
        v = ((F_after - F_before) @ theta) / 2e-3
        # Of what the columns leave, a change of the clock takes what they leave of the velocity.
        Q = np.linalg.qr(F)[0]
        D = np.stack([-v, v * (t[known] - middle)[:, None]], axis=2)
        whole = np.linalg.norm(D.reshape(-1, 2), axis=0)
        D = (D - np.einsum("nk,kij->nij", Q, np.einsum("nk,nij->kij", Q, D))).reshape(-1, 2)
        # A constant velocity is a motion of the base, and shows no clock.
        D[:, np.linalg.norm(D, axis=0) < _HIDDEN * whole] = 0.0
        step = np.linalg.lstsq(D / _UNITS, (p[known] - F @ theta).ravel(), rcond=1e-6)[0] / _UNITS
        step *= min(1.0, 0.25 / max(abs(step[0]), 1e-12))
        skew = float(np.clip(best.skew + step[1], -MOST_SKEW, MOST_SKEW))
        best = Lag(best.offset + float(step[0]), skew)
        if abs(step[0]) < 1e-6:
            break
    return Refined(best, left(best), int(system(best, t)[2].sum()))


def _columns(tips: Array, groups: IntArray) -> Array:
    """Return what points are linear in (n, 13 g), whatever base and tool of each of g groups are."""
    own = np.concatenate([tips[:, :3, 3], tips[:, :3, :3].reshape(-1, 9), np.ones((len(tips), 1))], axis=1)
    return np.concatenate([own[:, :0], *(own * (groups == k)[:, None] for k in np.unique(groups))], axis=1)
