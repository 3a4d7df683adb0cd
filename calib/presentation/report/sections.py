"""The parts of a report, each made by one function from what the rooms before have found.

A part that has nothing to say is None, or is left out by whoever lists them.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.assessment.advice import told_briefly
from calib.assessment.judged import Check, JudgedSet, Use
from calib.assessment.metrics import Metrics, error_norms
from calib.foundations.arrays import Array, IntArray, evenly_ranked
from calib.foundations.words import counted
from calib.identification.fit import Fit
from calib.identification.identifiability import NUMERICAL_TOLERANCE
from calib.identification.total_differential import Trace
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.machine.uncertainty import rms_by_cause
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.presentation import sheets
from calib.presentation.page_files import page_file
from calib.presentation.report import charts
from calib.presentation.report.document import Block, Picture, Prose, Row, Section, Sheet, Tile, Verdict
from calib.presentation.sheets import Level as LevelFigures

if TYPE_CHECKING:
    from calib.assessment.choice import Choice

_KEY = (("before", "before"), ("after", "after"))
# Few dots are drawn large, in px.
_FEW, _LARGE, _SMALL = 150, 5.0, 3.0
# More dots than this are a cloud in which nobody finds the worst; it is among those drawn.
_MOST_DOTS = 2000
_BINS = 24
_MOST_CORRELATED = 20
# Of so many poses the budget is told.
_MOST_POSES = 200
_ANGLES = ("rx", "ry", "rz")
# What the drawing of a deviation shows.
_DRAWN = (
    "joint_2.tx, ty and tz: how far the joint is from where the URDF places it, along its own axes; rx, ry and rz: how "
    "far it is turned about them. z is the joint's axis. Where that is z of the joint's URDF frame, x and y are those "
    "of the frame; where it is x, they are its y and z; where it is y, its z and x. offset: what is added to the "
    "joint's position, about z or along it."
)

# Kinds of parameters of which angles are those of a pose, and what these angles are counted from.
_FRAMES = ("base", "tool", "target")
_TURNED = (
    "rx, ry and rz of a base, a tool or a target turn it from where the search began, and are not its whole "
    "orientation: the poses are in result.json."
)


class _Errors(NamedTuple):
    """Error norms (N,) of one quantity over the tables ``sets`` that have it, in the unit ``shown``."""

    quantity: str
    sets: tuple[JudgedSet, ...]
    before: Array
    after: Array
    shown: str


def judged_use(sets: Sequence[JudgedSet]) -> Use:
    """Return by which data a calibration is judged: those held out, where there are any."""
    return "validation" if any(judged.use == "validation" for judged in sets) else "identification"


def verdict(
    figures: Mapping[str, Mapping[str, Mapping[str, Metrics]]],
    doubts: Sequence[str],
    warnings: Sequence[str],
    shown: Sequence[str] = (),
    suggested: Sequence[str] = (),
) -> Verdict:
    """Return the answer: how much better, on which data, to be trusted or not.

    ``shown``: for which range, and what would make it more certain. ``suggested``: what would make errors smaller.
    """
    held_out = "validation" in figures
    judged = figures["validation" if held_out else "identification"]
    said, tiles = [], []
    for quantity, after in judged["after"].items():
        before = judged["before"][quantity]
        rows = "held-out rows" if held_out else "fitted rows"
        names = (sheets.figure(before.rms, before.unit), sheets.figure(after.rms, after.unit))
        if after.rms < before.rms:
            # Data without noise leave rounding alone, and a ratio of it is no figure.
            ratio = before.rms / max(after.rms, 1e-6 * before.rms)
            times = f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.1f}"
            fall = f"the {quantity} error falls from {names[0]} to {names[1]} rms"
            said.append(f"{times} times better: on {after.n} {rows}, {fall}.")
            tiles.append(Tile(f"{quantity} error smaller by", f"{times} times"))
        else:
            said.append(f"No better: on {after.n} {rows}, the {quantity} error goes from {names[0]} to {names[1]} rms.")
        tiles += [Tile(f"{quantity}, before (rms)", names[0]), Tile(f"{quantity}, after (rms)", names[1])]
        tiles.append(Tile(f"{quantity}, after (largest)", sheets.figure(after.max, after.unit)))
    if doubts:
        # What a model leaves out may look like what is doubted, as joints that give way like a base that moved.
        reasons = (*(f"Not to be trusted: {doubt}" for doubt in doubts), *suggested)
    elif held_out:
        reasons = (
            " ".join(
                (
                    "To be trusted: all checks passed, and the figures are of data that took no part in the fit.",
                    *shown,
                    *suggested,
                )
            ),
        )
    else:
        care = (
            "To be trusted with care: all checks passed, but no data were held out; how well the robot predicts other "
            "poses is not shown."
        )
        reasons = (" ".join((care, *shown, *suggested)),)
    return Verdict(not doubts, " ".join(said), reasons, tuple(tiles), tuple(warnings))


def errors(
    figures: Mapping[str, Mapping[str, Mapping[str, Metrics]]],
    in_urdf: tuple[Mapping[str, Mapping[str, Metrics]], bool] | None = None,
) -> Section:
    """Return the before/after table, and what the calibrated URDF alone reaches where it cannot hold the machine.

    ``in_urdf``: its figures by use, none where it takes other readings, and whether its fit converged.
    """
    blocks: list[Block] = [sheets.error_sheet(figures)]
    if in_urdf is not None:
        blocks.append(Prose(sheets.in_urdf_sentences(figures, *in_urdf), brief=True))
    return Section("errors", "Before and after", tuple(blocks))


def checks(found: Sequence[Check]) -> Section | None:
    """Return all checks of the verdict, with what each has found and what it allows; None where there are none."""
    if not found:
        return None
    rows = [
        Row(
            (check.name, _number(check.statistic), _allowed(check), "yes" if check.passed else "NO", check.sentence),
            not check.passed,
        )
        for check in found
    ]
    columns = ("check", ">found", "allowed", "passed", "in words")
    idle = any(np.isnan(check.statistic) for check in found)
    note = "found -: nothing of the kind is seen, or there was nothing to judge" if idle else ""
    sheet = Sheet.of("Checks of the verdict", columns, rows, note, brief=True, told=True)
    return Section("checks", "What was checked", (sheet,))


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3g}"


def _allowed(check: Check) -> str:
    if np.isnan(check.threshold):
        return "-"
    return f"{'at least' if check.least else 'at most'} {check.threshold:.3g}"


def levels(found: Sequence[LevelFigures]) -> Section:
    """Return what each level brought."""
    blocks: list[Block] = [sheets.level_sheet(found)]
    for quantity, first in found[0][3].items():
        factor, unit = sheets.SHOWN[first.unit]
        rms = np.array([figures[quantity].rms for *_, figures in found]) * factor
        x = charts.Axis("level", -0.5, len(found) - 0.5, names=tuple(name[:14] for name, *_ in found))
        steps = np.arange(len(found), dtype=np.float64)
        marks: list[charts.Mark] = [charts.Curve("after", steps, rms), charts.Points("after", steps, rms, 9.0)]
        said = ", ".join(f"{name} {value:.4f}" for (name, *_), value in zip(found, rms, strict=True))
        drawn = charts.chart(x, charts.logarithmic(f"{quantity} error, rms [{unit}]", rms), marks)
        blocks.append(Picture(f"{quantity.capitalize()} error after each level", drawn, f"In {unit}: {said}."))
    return Section("levels", "Levels", tuple(blocks))


def trace(followed: Trace) -> Section:
    """Return every iteration of the total differential."""
    return Section("trace", "Iterations", (Prose(tuple(str(followed).splitlines()), "code", brief=True),))


def chosen(choice: "Choice") -> Section:
    """Return which joint terms were chosen, and what held-out data said of them."""
    return Section("terms", "Joint terms", (sheets.choice_sheet(choice),))


def distribution(sets: Sequence[JudgedSet]) -> Section:
    """Return how errors are distributed: histogram and cumulative curve."""
    use = judged_use(sets)
    pictures = [p for found in _errors(_of(sets, use)) for p in (_histogram(found, use), _cumulative(found, use))]
    return Section("distribution", "How errors are distributed", tuple(pictures))


def pose_section(sets: Sequence[JudgedSet]) -> Section:
    """Return the error of every pose, and of every axis."""
    blocks: list[Block] = []
    for quantity, having, before, after, shown in _errors(sets):
        rows, number = _drawn(after), np.arange(1.0, len(after) + 1.0)
        edge = sum(len(judged.data) for judged in having if judged.use == "identification")
        x = charts.linear("row", np.array([0.0, len(after)]))
        y = charts.logarithmic(f"error [{shown}]", np.concatenate([before, after]))
        marks: list[charts.Mark] = [
            charts.Points("before", number[rows], before[rows]),
            charts.Points("after", number[rows], after[rows]),
        ]
        held_out = ""
        if 0 < edge < len(after):
            marks.append(charts.Curve("soft", np.full(2, edge + 0.5), np.array([y.low, y.high])))
            held_out = f" Rows from {edge + 1} on, right of the line, were held out."
        worst = int(np.argmax(after))
        at = [f"{judged.file}, line {line}" for judged in having for line in judged.data.lines][worst]
        said = f"The largest one after calibration is {after[worst]:.4f} {shown}, from {at}.{held_out}"
        blocks.append(Picture(f"{quantity.capitalize()} error of every row", charts.chart(x, y, marks, _KEY), said))
    use = judged_use(sets)
    blocks += _per_axis(_of(sets, use), use)
    return Section("poses", "Error of every pose and axis", tuple(blocks))


def joints(fit: Fit, sets: Sequence[JudgedSet]) -> Section:
    """Return the error that is left over every joint's reading: a pattern is something not modelled."""
    error = _errors(_of(sets, judged_use(sets)))[0]
    readings = np.concatenate([judged.data.readings for judged in error.sets])
    pictures = []
    for reading, values in zip(fit.robot.readings, readings.T, strict=True):
        factor, unit = sheets.SHOWN["rad" if reading.dimension == "angle" else "m"]
        at, rows = values * factor, _drawn(error.after)
        centres, means = _running_mean(at, error.after)
        marks: list[charts.Mark] = [
            charts.Points("after", at[rows], error.after[rows], _size(rows)),
            charts.Curve("soft", centres, means),
        ]
        y = charts.linear(f"error [{error.shown}]", error.after, from_zero=True)
        said = (
            f"The mean over eighths of the rows is between {means.min():.4f} and {means.max():.4f} {error.shown}."
            if means.size
            else "There are too few rows for a mean."
        )
        key = (("after", "after"), ("soft", "mean"))
        drawn = charts.chart(charts.linear(f"{reading.name[:40]} [{unit}]", at), y, marks, key)
        pictures.append(Picture(f"Over {reading.name}", drawn, said))
    return Section("joints", "Error over joint readings", tuple(pictures))


def workspace(fit: Fit, sets: Sequence[JudgedSet]) -> Section:
    """Return the position error that is left over where the tool is, in the robot's base frame."""
    error = _errors(_of(sets, judged_use(sets)))[0]
    tips = [judged.data.tips(fit.robot, fit.deviations) for judged in error.sets]
    points = np.concatenate(
        [(T @ fit.tools_of(judged.data))[:, :3, 3] for T, judged in zip(tips, error.sets, strict=True)]
    )
    far = np.argsort(np.linalg.norm(points[:, :2], axis=1))
    thirds = [part for part in np.array_split(error.after[far], 3) if part.size]
    means = ", ".join(f"{part.mean():.4f}" for part in thirds)
    said = f"Mean errors of the nearest, middle and farthest third from the base axis: {means} {error.shown}."
    rows = _drawn(error.after)
    pictures = [
        Picture(title, charts.map_of(points[rows][:, axes], (names[0], names[1]), error.after[rows], error.shown), said)
        for title, axes, names in (("From above", [0, 1], "xy"), ("From the side", [0, 2], "xz"))
    ]
    return Section("workspace", "Error over the workspace", tuple(pictures))


def budget(machine: CalibratedMachine, sets: Sequence[JudgedSet]) -> Section | None:
    """Return how sure the first tool's pose is, and what its errors come from; None where the machine does not say."""
    if machine.uncertainty is None:
        return None
    readings = np.concatenate([judged.data.readings for judged in sets])
    readings = readings[np.unique(np.linspace(0, len(readings) - 1, _MOST_POSES).astype(np.intp))]
    tool = next(iter(machine.tools))
    found = tool_uncertainty(machine, readings, tool)
    said = (
        f"Of {tool!r}, at poses that were measured. Parameters that the data do not determine have the "
        "standard deviation of their prior. If none is stated, it is learned from other parameters of their kind, or "
        "it is wide. What the model leaves out is estimated from what the residuals have in common."
    )
    return Section(
        "budget",
        "Uncertainty of the tool",
        (sheets.budget_sheet(rms_by_cause(found.budget), len(readings)), Prose((said,))),
    )


def parameters(fit: Fit) -> Section:
    """Return all parameters."""
    said = (
        "A parameter that is identifiable only in combination has no sigma: other values of it fit the data as well "
        "if other parameters change with it. Weakly determined ones have a sigma above half their parameter scale."
    )
    sentences = [said] if fit.unidentifiable.any() or fit.weakly_determined.any() else []
    if any(p.kind in _FRAMES and p.name.endswith(_ANGLES) for p in fit.parameters):
        sentences.insert(0, _TURNED)
    blocks: list[Block] = [sheets.parameter_sheet(fit)]
    if any(parameter.kind in ("placement", "offset") for parameter in fit.parameters):
        blocks.append(Picture("What the names mean", page_file("deviation.svg"), _DRAWN))
    return Section("parameters", "Parameters", (*blocks, *([Prose(tuple(sentences))] if sentences else [])))


def correlations(fit: Fit) -> Section | None:
    """Return how the errors of the identifiable parameters go together; None where there are fewer than two."""
    seen, r = sheets.correlation(fit)
    if len(seen) < 2:
        return None
    names = [fit.parameters[k].name for k in seen]
    pairs = sorted(((i, j) for i in range(len(seen)) for j in range(i)), key=lambda ij: (-abs(r[ij]), ij))
    strongest = pairs[:8]
    sheet = Sheet.of(
        "Strongest correlations",
        ("parameter", "and", ">correlation"),
        [(names[i], names[j], sheets.signed(r[i, j], 3)) for i, j in strongest],
        "of the uncertainties, not of the values; parameters identifiable only in combination are left out",
    )
    high = sum(abs(r[ij]) > 0.9 for ij in pairs)
    i, j = strongest[0]
    said = (
        f"Of {counted(len(pairs), 'pair')} {high} correlate by more than 0.9; the strongest is "
        f"{names[i]} with {names[j]}, {sheets.signed(r[i, j], 3)}. Blue is positive, orange negative."
    )
    # Of sixty parameters nobody reads a square each: those that correlate most, in the order of all.
    least = np.max(np.abs(r - np.eye(len(r))), axis=1)
    drawn = np.sort(np.argsort(-least, kind="stable")[:_MOST_CORRELATED])
    if len(drawn) < len(r):
        said += f" Drawn are the {len(drawn)} parameters that correlate most, of {len(r)}."
    svg = charts.matrix(r[np.ix_(drawn, drawn)], [names[k] for k in drawn])
    return Section("correlations", "Correlations", (Picture("Correlations", svg, said, wide=True), sheet))


def seen(fit: Fit) -> Section:
    """Return the ranks, and the null space in words."""
    values = fit.singular_values
    number = np.arange(1.0, len(values) + 1.0)
    weak = values < NUMERICAL_TOLERANCE
    y = charts.logarithmic("singular value", np.append(values, NUMERICAL_TOLERANCE))
    marks: list[charts.Mark] = [
        charts.Points("after", number[~weak], values[~weak], 6.0),
        charts.Points("before", number[weak], values[weak], 6.0),
        charts.Level(NUMERICAL_TOLERANCE, "numerical rank: above"),
    ]
    drawn = charts.chart(charts.linear("direction", np.append(number, 0.0)), y, marks)
    said = (
        f"Formal rank {fit.rank}, numerical rank {fit.numerical_rank}, of {len(values)} parameters. The inverse of a "
        "singular value is the standard deviation along its direction, in parameter scales (1 mm, 1 mrad or the "
        "prior). Dots on the lower edge stand for smaller values."
    )
    blocks: list[Block] = [Prose(sheets.rank_sentences(fit), brief=True), Picture("Singular values", drawn, said)]
    if fit.null_space:
        directions = tuple(map(str, fit.null_space))
        blocks.append(Prose(told_briefly(fit.model, fit.measurements, fit.null_space, directions), "list"))
    return Section("rank", "What the data determine", tuple(blocks))


def priors(fit: Fit) -> Section | None:
    """Return the priors whose width was learned, and what taught them; None where all are stated."""
    said = sheets.prior_sentences(fit)
    return Section("priors", "Learned priors", (Prose(said, brief=True),)) if said else None


def noise(fit: Fit) -> Section:
    """Return the noise of every set."""
    return Section("noise", "Noise", (Prose(sheets.noise_sentences(fit), brief=True),))


def provenance(command: str, versions: Mapping[str, str | None], inputs: Mapping[str, str]) -> Section:
    """Return what made this: the command, the versions and the inputs' SHA-256; without a command, the versions."""
    files = Sheet.of("Inputs", ("file", "SHA-256"), inputs.items())
    known = ((name, version or "unknown") for name, version in versions.items())
    libraries = Sheet.of("Versions", ("library", "version"), known)
    if not command:
        return Section("provenance", "What made this", (Prose(("Made from Python.",)), libraries))
    where = Prose(("In the folder of the job:",))
    return Section("provenance", "How to reproduce this", (where, Prose((command,), "code"), files, libraries))


def _of(sets: Sequence[JudgedSet], use: Use) -> list[JudgedSet]:
    return [judged for judged in sets if judged.use == use]


def _errors(sets: Sequence[JudgedSet]) -> list[_Errors]:
    """Return the errors of every quantity over the tables that have it."""
    having: dict[str, list[JudgedSet]] = {}
    for judged in sets:
        for quantity in QUANTITIES[judged.data.kind]:
            having.setdefault(quantity.name, []).append(judged)
    out = []
    for name, own in having.items():
        factor, unit = sheets.SHOWN[UNIT_OF[name]]
        before, after = (
            np.concatenate([error_norms(judged.data.kind, r)[name] for judged, r in pairs]) * factor
            for pairs in ([(judged, judged.before) for judged in own], [(judged, judged.after) for judged in own])
        )
        out.append(_Errors(name, tuple(own), before, after, unit))
    return out


def _drawn(values: Array) -> IntArray:
    return evenly_ranked(values, _MOST_DOTS)


def _size(rows: IntArray) -> float:
    return _LARGE if len(rows) < _FEW else _SMALL


def _histogram(found: _Errors, use: Use) -> Picture:
    x = charts.logarithmic(f"error [{found.shown}]", np.concatenate([found.before, found.after]))
    edges = np.geomspace(x.low, x.high, _BINS + 1)
    bars = [
        charts.Bars(name, edges, np.histogram(np.clip(values, x.low, x.high), edges)[0].astype(np.float64))
        for name, values in (("before", found.before), ("after", found.after))
    ]
    y = charts.linear("rows", np.concatenate([bar.heights for bar in bars]), from_zero=True)
    said = (
        f"Half of the errors of the {use} data are below {np.median(found.before):.4f} {found.shown} before "
        f"calibration and below {np.median(found.after):.4f} {found.shown} after it."
    )
    return Picture(f"Histogram, {found.quantity}", charts.chart(x, y, bars, _KEY), said)


def _cumulative(found: _Errors, use: Use) -> Picture:
    x = charts.logarithmic(f"error [{found.shown}]", np.concatenate([found.before, found.after]))
    lines = []
    for name, values in (("before", found.before), ("after", found.after)):
        ranked = np.sort(values)[_drawn(np.sort(values))]
        share = 100.0 * np.linspace(1.0 / len(values), 1.0, len(ranked))
        # A staircase: each error adds its row where it lies.
        lines.append(
            charts.Curve(name, np.repeat(ranked, 2), np.column_stack([np.append(0.0, share[:-1]), share]).ravel())
        )
    level = charts.Level(95.0, "95 %")
    said = (
        f"95 % of the {use} rows are within {np.percentile(found.before, 95.0):.4f} {found.shown} before calibration "
        f"and within {np.percentile(found.after, 95.0):.4f} {found.shown} after it."
    )
    y = charts.Axis("rows within it [%]", 0.0, 100.0)
    return Picture(f"Cumulative curve, {found.quantity}", charts.chart(x, y, [*lines, level], _KEY), said)


def _per_axis(sets: Sequence[JudgedSet], use: Use) -> list[Block]:
    """Return mean, spread and largest error along every axis, and the errors left as dots."""
    rows, pictures = [], []
    for first, axes, unit in ((0, ("x", "y", "z"), "m"), (3, _ANGLES, "rad")):
        chosen = [judged for judged in sets if judged.after.shape[1] >= first + len(axes)]
        if not chosen:
            continue
        factor, shown = sheets.SHOWN[unit]
        before, after = (
            np.concatenate([r[:, first : first + 3] for r in rs]) * factor
            for rs in ([judged.before for judged in chosen], [judged.after for judged in chosen])
        )
        for when, values in (("before", before), ("after", after)):
            for k, axis in enumerate(axes):
                v = values[:, k]
                cells = (axis, when, sheets.signed(v.mean(), 4), f"{v.std():.4f}", f"{np.abs(v).max():.4f}", shown)
                rows.append(Row(cells, strong=when == "after", ends_group=k == 2))
        y = charts.Axis("axis", -0.6, len(axes) - 0.4, names=axes)
        drawn = _drawn(np.linalg.norm(after, axis=1))
        # Dots of one axis are spread over its lane by the golden ratio, which never repeats nor clusters.
        lane = np.asarray(0.6 * ((drawn * 0.6180339887) % 1.0 - 0.5), dtype=np.float64)
        marks: list[charts.Mark] = [
            charts.Points("after", after[drawn, k], float(k) + lane, _size(drawn)) for k in range(len(axes))
        ]
        biases = ", ".join(
            f"{axis} {sheets.signed(mean, 4)}" for axis, mean in zip(axes, after.mean(axis=0), strict=True)
        )
        title = f"Errors left along {', '.join(axes)}"
        picture = charts.chart(charts.linear(f"measured minus predicted [{shown}]", after), y, marks)
        pictures.append(Picture(title, picture, f"Means in {shown}: {biases}."))
    if not rows:  # of pixels and lengths there are no axes
        return []
    columns = ("axis", "robot", ">mean", ">spread", ">largest", "unit")
    caption = f"{use} data, in the instrument's frame; spread: one standard deviation"
    return [*pictures, Sheet.of("Errors along the axes", columns, rows, caption)]


def _running_mean(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the means of x and y over eight parts of the rows in the order of x; nothing of less than 16 rows."""
    if len(x) < 16:
        return np.zeros(0), np.zeros(0)
    parts = np.array_split(np.argsort(x, kind="stable"), 8)
    return np.array([x[part].mean() for part in parts]), np.array([y[part].mean() for part in parts])
