"""What streams show over time: how fast the tool moved, what remains, and for how long that is remembered."""

from collections.abc import Sequence

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array
from calib.foundations.units import DISPLAY_OF, MM, MS
from calib.identification.fit import Fit
from calib.identification.memory import Memory
from calib.measurement.measurements import Measurements
from calib.presentation.report.charts import Curve, Points, chart, linear
from calib.presentation.report.document import Block, Picture, Prose, Section, Sheet

# Parts of the time that are drawn, each by its mean; and lags, in s.
_PARTS, _LONGEST = 240, 3.0


def in_time(fit: Fit, sets: Sequence[JudgedSet]) -> Section | None:
    """Return the pictures of streams, None where no table is one."""
    blocks: list[Block] = []
    streams = [judged for judged in sets if judged.data.stream is not None and judged.data.position is not None]
    for file in dict.fromkeys(judged.file for judged in streams):
        # Rows held out are stretches of the same motion.
        blocks += _over_time(file, [judged for judged in streams if judged.file == file])
    files = {judged.data.where: judged.file for judged in streams}
    for memory in fit.memories:
        data, r = fit.measurements[memory.measurements], fit.residuals[memory.measurements]
        if data.stream is not None:
            blocks += _remembered(files.get(data.where, data.where), r[:, :3], memory)
    return Section("time", "Over time", tuple(blocks)) if blocks else None


def _over_time(file: str, parts: Sequence[JudgedSet]) -> list[Block]:
    times = np.concatenate([one.data.times for one in parts if one.data.times is not None])
    order = np.argsort(times, kind="stable")
    t = times[order] - times[order[0]]
    measured = np.concatenate([one.data.position for one in parts if one.data.position is not None])[order]
    r_before, r_after = (
        np.concatenate([r[:, :3] for r in some])[order]
        for some in ([one.before for one in parts], [one.after for one in parts])
    )
    predicted = measured - r_after
    steps = np.maximum(np.diff(t, prepend=-1.0), 1e-9)
    speed = np.linalg.norm(np.diff(predicted, axis=0, prepend=predicted[:1]), axis=1) / steps
    before, after = (np.linalg.norm(r, axis=1) / MM for r in (r_before, r_after))
    at, fast, worse, better = _means(t, speed, before, after)
    time = linear("time [s]", at, from_zero=True)
    fastest = f"The tool moved at {np.sqrt(np.mean(speed**2)):.3g} m/s rms, {fast.max():.3g} m/s at the fastest."
    remain = f"Position errors are {np.mean(before):.4f} mm before and {np.mean(after):.4f} mm after, in the mean."
    if any(one.use == "validation" for one in parts):
        remain += " Rows that were held out are among them."
    return [
        Picture(
            f"Speed of the tool, {file}",
            chart(time, linear("speed [m/s]", fast, from_zero=True), [Curve("soft", at, fast)]),
            fastest,
            wide=True,
        ),
        Picture(
            f"Error over time, {file}",
            chart(
                time,
                linear("error [mm]", np.concatenate([worse, better]), from_zero=True),
                [Curve("before", at, worse), Curve("after", at, better)],
                (("before", "before"), ("after", "after")),
            ),
            remain,
            wide=True,
        ),
        *_following(parts[0].data),
    ]


def _following(data: Measurements) -> list[Block]:
    """Return how joints followed what they were commanded to do, where a stream says it."""
    assert data.stream is not None, "rows of a stream"
    joints = data.stream.joints
    if not joints.following:
        return []
    rows = []
    for one in joints.following:
        factor, unit = DISPLAY_OF[one.dimension]
        rms, largest, left = (f"{factor * x:.4f} {unit}" for x in (one.rms, one.largest, one.left))
        rows.append((one.joint, rms, largest, f"{one.late / MS:.2f}", left))
    names = ("joint", ">rms", ">largest", ">late [ms]", ">rms without it")
    said = (
        "Where joints were, less where they were commanded to be. Readings are where they were: nothing of it is lost."
    )
    return [Sheet.of(f"Following error, {joints.where}", names, rows, said)]


def _means(t: Array, *values: Array) -> tuple[Array, ...]:
    """Return means over equal parts of the rows, first that of the times."""
    parts = [part for part in np.array_split(np.arange(len(t)), min(_PARTS, len(t))) if part.size]
    return tuple(np.array([x[part].mean() for part in parts]) for x in (t, *values))


def _remembered(where: str, r: Array, memory: Memory) -> list[Block]:
    lags = np.unique(np.geomspace(1, max(min(_LONGEST / memory.step, len(r) / 4), 2), 40).astype(np.intp))
    power = float(np.mean(r * r))
    seen = np.array([float(np.mean(r[lag:] * r[:-lag])) for lag in lags]) / power
    whole = memory.alone + float(np.sum(memory.weights))
    model = np.exp(-lags[:, None] * memory.step / memory.times) @ memory.weights / whole
    said = (
        f"Rows of {where} err together: {memory.rows:d} rows say as much as {memory.rows / memory.rows_as_one:.0f} "
        "that err alone; the sigmas know it."
    )
    apart = np.asarray(lags * memory.step, dtype=np.float64)
    drawn = chart(
        linear("rows apart [s]", apart, from_zero=True),
        linear("correlation", np.concatenate([seen, model, [0.0]])),
        [Points("after", apart, seen), Curve("soft", apart, model)],
        (("after", "residuals"), ("soft", "noise of several times")),
    )
    return [Prose((said,)), Picture(f"Autocorrelation of the residuals, {where}", drawn, said)]
