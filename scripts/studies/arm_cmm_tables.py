"""The tables of two papers on articulated arm CMMs, printed value beside computed value.

    python scripts/studies/arm_cmm_tables.py [--markdown docs/arm_cmm_papers.md] [--urdf FILE]

Without options the tables go to the terminal. `--markdown` writes the page of the documentation, and its figure into
the folder `figures` beside it; `--urdf` writes the machine of the first paper, robots/arm_cmm/papers/zero_offsets.urdf.
What is printed is read from robots/arm_cmm/papers.
"""

import argparse
import io
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

import calib
from calib.assessment.sensitivity import (
    Sensitivity,
    error_coefficients,
    exact_error,
    group_study,
    predicted_error,
    sensitivity,
)
from calib.foundations.files import write_atomically
from calib.identification.total_differential import Trace, total_differential
from calib.presentation.plots import sensitivity_figure

Array = NDArray[np.float64]

CASE = Path(__file__).resolve().parents[2] / "robots" / "arm_cmm"
FIGURE = Path("figures") / "arm_cmm_sensitivity.svg"
MM = 1e-3
AGREES = 0.0005  # mm: half of the last printed digit
RANDOM_SETS = 500
WIDTH, WIDEST = 120, 160  # of text and of tables


# ---- what is shown, on a terminal and on a page


@dataclass(frozen=True)
class Heading:
    level: int
    text: str


@dataclass(frozen=True)
class Points:
    """A list of sentences."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Picture:
    alt: str
    path: Path


@dataclass(frozen=True)
class Sheet:
    """A table of text; ``left``: the columns that are no numbers."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...] = (0,)

    def rich(self) -> Table:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for k, column in enumerate(self.columns):
            table.add_column(column, justify="left" if k in self.left else "right", no_wrap=True)
        for row in self.rows:
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        rule = ["---" if k in self.left else "---:" for k in range(len(self.columns))]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in (self.columns, rule, *self.rows))


Block = Heading | Points | Picture | Sheet | str  # a string is a paragraph


def filled(text: str, first: str = "") -> str:
    return textwrap.fill(
        " ".join(text.split()),
        WIDTH,
        initial_indent=first,
        subsequent_indent=" " * len(first),
        break_long_words=False,
        break_on_hyphens=False,
    )


def markdown(blocks: Iterable[Block]) -> str:
    def said(block: Block) -> str:
        match block:
            case Heading(level, text):
                return f"{'#' * level} {text}"
            case Points(items):
                return "\n".join(filled(item, "- ") for item in items)
            case Picture(alt, path):
                return f"![{alt}]({path.as_posix()})"
            case Sheet():
                return block.markdown()
            case str():
                return filled(block)

    return "\n\n".join(map(said, blocks)) + "\n"


def show(blocks: Iterable[Block]) -> None:
    console = Console(width=WIDEST, highlight=False, markup=False)
    for block in blocks:
        match block:
            case Heading(level, text):
                console.print(f"\n{text}", style="bold" if level < 3 else "italic")
            case Points(items):
                console.print("\n".join(filled(item, "- ") for item in items))
            case Sheet():
                console.print(block.rich())
            case str():
                console.print(f"\n{filled(block)}")


def number(value: float, decimals: int = 4, *, signed: bool = False) -> str:
    """A number; zero has no sign."""
    text = f"{value:{'+' if signed else ''}.{decimals}f}"
    return text if float(text) else f"{0.0:.{decimals}f}"


def numbers(values: Iterable[float], decimals: int = 4, *, signed: bool = False) -> str:
    return "  ".join(number(value, decimals, signed=signed) for value in values)


def angles(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def compared(printed: Sequence[float] | float, computed: Array | float) -> tuple[str, str, str]:
    """Printed value(s), computed value(s), and the difference."""
    p, c = np.atleast_1d(printed), np.atleast_1d(computed)
    return numbers(p, 3), numbers(c), numbers(c - p, signed=True)


def titles(what: str) -> tuple[str, str, str]:
    return f"{what} printed", "computed", "difference"


# ---- what was printed


def read(name: str) -> dict[str, Any]:
    return tomllib.loads((CASE / "papers" / name).read_text(encoding="utf-8"))


def mended(row: dict[str, Any]) -> dict[str, Any]:
    """A printed row without its misprints."""
    return row | row.get("corrected", {})


def starred(what: object, row: dict[str, Any]) -> str:
    return f"{what}*" if "remark" in row else str(what)


# ---- the paper on zero offsets


def urdf(machine: dict[str, Any]) -> str:
    """The machine of the first paper: the origin of joint i + 1 is the constant rest of its row i, with a = 0."""
    joints = [*(f"joint_{i}" for i in range(1, 7)), "handle_mount", "probe_mount"]
    links = ["base_link", *(f"link_{i}" for i in range(1, 7)), "handle", "probe"]
    lines = [
        '<?xml version="1.0"?>',
        "<!-- The articulated arm CMM whose joint zero offsets Ye Dong et al. identify: d and alpha of Table 1, a = 0.",
        "  Standard DH, as in ../arm_cmm.urdf; made by scripts/studies/arm_cmm_tables.py. -->",
        '<robot name="zero_offsets">',
        *(f'  <link name="{link}"/>' for link in links),
    ]
    rows = [(0.0, 0.0), *zip(machine["d"], machine["alpha"], strict=True)]
    for joint, parent, child, (d, alpha) in zip(joints, links, links[1:], rows, strict=False):
        moves = joint.startswith("joint")
        lines += [
            f'  <joint name="{joint}" type="{"continuous" if moves else "fixed"}">',
            f'    <parent link="{parent}"/><child link="{child}"/>',
            f'    <origin xyz="0 0 {round(d * MM, 9)!r}" rpy="{float(np.radians(alpha))!r} 0 0"/>',
            *(['    <axis xyz="0 0 1"/>'] if moves else []),
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


@dataclass(frozen=True)
class Arm:
    """The machine of the first paper: six unknown offsets, ``truth`` by name in rad."""

    robot: calib.Robot
    model: calib.ErrorModel
    truth: dict[str, float]

    def points(self, readings_deg: Array, errors: dict[str, float]) -> Array:
        """Touched points (N, 3) in mm of an arm with these errors in m and rad."""
        q = np.radians(readings_deg)
        return (self.robot.tips(q)[:, :3, 3] + exact_error(self.model, q, errors)) / MM

    def misses(self, readings_deg: Array, offsets: Iterable[float]) -> Array:
        """Position errors (N,) in mm that are left with these offsets in rad."""
        assumed = dict(zip(self.truth, offsets, strict=True))
        return np.linalg.norm(self.points(readings_deg, self.truth) - self.points(readings_deg, assumed), axis=1)

    def touched(self, readings_deg: Array, points_mm: Array) -> calib.Measurements:
        columns = {f"joint_{i + 1} [deg]": column for i, column in enumerate(readings_deg.T)}
        columns |= {f"{axis} [mm]": column for axis, column in zip("xyz", points_mm.T, strict=True)}
        return calib.read_measurements(columns, self.robot)


@dataclass(frozen=True)
class Simulation:
    """One of the three: as printed, and computed from points at full precision."""

    number: int
    printed: dict[str, Any]
    readings_deg: Array
    points: Array
    errors: Array
    rounded: Trace
    exact: Trace
    condition: float

    def steps(self) -> list[tuple[int, dict[str, Any], Array, Array]]:
        """Number, printed row, computed offsets in deg and errors in mm; a search that has ended stays where it is."""
        printed, last = self.printed["iteration"], len(self.rounded.iterations) - 1
        computed = (self.rounded.iterations[min(k, last)] for k in range(1, len(printed) + 1))
        return [
            (k, row, np.degrees(at.values), at.errors / MM)
            for k, (row, at) in enumerate(zip(printed, computed, strict=True), 1)
        ]


def arm(paper: dict[str, Any]) -> Arm:
    robot = calib.load_robot(CASE / "papers" / "zero_offsets.urdf")
    model = calib.error_model(robot, offsets="all", base="fixed", tool="fixed")
    names = [parameter.name for parameter in model.parameters()]
    return Arm(robot, model, dict(zip(names, map(float, np.radians(paper["machine"]["offset"])), strict=True)))


def simulations(paper: dict[str, Any], of: Arm) -> list[Simulation]:
    found = []
    for k, printed in enumerate(paper["simulation"], 1):
        q = np.array(printed["angles"], dtype=float)
        points = of.points(q, of.truth)
        data = of.touched(q, points)
        rounded = total_differential(of.model, data, stop=paper["stop"] * MM, rounding=paper["rounding"])
        exact = total_differential(of.model, data, stop=0.0)
        condition = float(np.linalg.cond(error_coefficients(of.model, np.radians(q)).matrix.reshape(-1, 6)))
        found.append(Simulation(k, printed, q, points, of.misses(q, np.zeros(6)), rounded, exact, condition))
    return found


def touched_sheet(found: Sequence[Simulation]) -> Sheet:
    rows = (
        (str(s.number), angles(q), *compared(position, point), *compared(printed, error))
        for s in found
        for q, position, point, printed, error in zip(
            s.readings_deg, s.printed["position"], s.points, s.printed["error"], s.errors, strict=True
        )
    )
    return Sheet(("no.", "readings [deg]", *titles("point"), *titles("error")), tuple(rows), (0, 1))


def step_sheet(found: Sequence[Simulation]) -> Sheet:
    rows: list[tuple[str, ...]] = []
    for s in found:
        for k, row, offsets, errors in s.steps():
            printed, computed = np.array([*row["offset"], *row["error"]]), np.concatenate([offsets, errors])
            rows += [
                (str(s.number), starred(k, row), "printed", *(number(v, 3) for v in printed)),
                ("", "", "computed", *map(number, computed)),
                ("", "", "difference", *(number(v, signed=True) for v in computed - printed)),
            ]
    columns = (*(f"theta_{i}" for i in range(1, 7)), *(f"error {i}" for i in range(1, 4)))
    return Sheet(("no.", "step", "", *columns), tuple(rows), (0, 1, 2))


def step_remarks(found: Sequence[Simulation]) -> Points:
    items = []
    for s in found:
        if "remark" in s.printed:
            items.append(f"Simulation {s.number}: {s.printed['remark']}")
        items += [f"Simulation {s.number}, step {k}: {row['remark']}" for k, row, *_ in s.steps() if "remark" in row]
        items.append(
            f"Simulation {s.number} as computed ends after step {len(s.rounded.iterations) - 1}: {s.rounded.reason}."
        )
    return Points(tuple(items))


def rounding_sheet(found: Sequence[Simulation], of: Arm, rounding: float) -> Sheet:
    """Which offsets the printed errors belong to."""
    rows = []
    for s in found:
        for k, row, *_ in s.steps():
            offsets = np.radians(row["offset"])
            whole = np.round(offsets / rounding) * rounding
            computed = (of.misses(s.readings_deg, x) for x in (whole, offsets))
            rows.append((str(s.number), str(k), numbers(row["error"], 3), *map(numbers, computed)))
    return Sheet(("no.", "step", "errors printed [mm]", "of whole mrad", "of offsets as printed"), tuple(rows), (0, 1))


def unrounded_sheet(found: Sequence[Simulation], truth_deg: Sequence[float]) -> Sheet:
    rows = (
        (
            str(s.number),
            str(k),
            number(at.largest / MM),
            number(np.max(np.abs(np.degrees(at.values) - truth_deg)), 6),
            number(s.condition, 1) if k == 0 else "",
        )
        for s in found
        for k, at in enumerate(s.exact.iterations[:5])
    )
    return Sheet(("no.", "step", "largest error [mm]", "largest offset error [deg]", "condition"), tuple(rows), (0, 1))


def effect_of_lengths(paper: dict[str, Any], of: Arm) -> tuple[float, float]:
    """Largest difference in mm to the printed coordinates with a = 0, and with the printed a_i."""
    names = [*(f"joint_{i}.tx" for i in range(2, 7)), "handle_mount.tx", "probe_mount.tx"]
    model = calib.error_model(of.robot, offsets="all", placements=names, base="fixed", tool="fixed")
    lengths = dict(zip(names, np.multiply(paper["machine"]["a"], MM), strict=True))
    q, printed = (np.concatenate([s[key] for s in paper["simulation"]]) for key in ("angles", "position"))
    longer = Arm(of.robot, model, of.truth | lengths)
    without, with_lengths = (float(np.max(np.abs(a.points(q, a.truth) - printed))) for a in (of, longer))
    return without, with_lengths


def converging(of: Arm) -> int:
    """How many random sets of three poses with random offsets lead from zero to the truth within 1e-9 deg."""
    rng = np.random.default_rng(0)
    good = 0
    for _ in range(RANDOM_SETS):
        q, offsets = rng.uniform(-180.0, 180.0, (3, 6)), rng.uniform(-3.0, 3.0, 6)
        points = of.robot.tips(np.radians(q + offsets))[:, :3, 3] / MM
        found = total_differential(of.model, of.touched(q, points), stop=0.0)
        good += bool(np.max(np.abs(np.degrees(found.values) - offsets)) < 1e-9)
    return good


def zero_offsets(paper: dict[str, Any]) -> list[Block]:
    of = arm(paper)
    found = simulations(paper, of)
    without, with_lengths = effect_of_lengths(paper, of)
    return [
        Heading(2, "Joint zero offsets of a 6-joint articulated CMM"),
        f"""Ye Dong et al. Three points of known position are touched, and the six zero offsets follow from
        Gauss-Newton by total differential, ddelta = (G^T G)^-1 G^T dQ, until the largest position error is below
        {paper["stop"]} mm. Here this is `calib.judging.total_differential`, and the machine is
        `robots/arm_cmm/papers/zero_offsets.urdf`.""",
        Heading(3, "Touched points, and errors before calibration [mm]"),
        touched_sheet(found),
        f"""All 27 coordinates and eight of nine errors agree; the ninth is cut. The a_i of its Table 1 were not
        used: with a = 0 the largest difference of a coordinate is {without:.4f} mm, with the printed a_i it is
        {with_lengths:.3f} mm.""",
        Heading(3, "The three simulations, step by step [deg, mm]"),
        """The paper does not say so, but its estimates were rounded to whole milliradians after every iteration.
        With `rounding=1e-3` Gauss-Newton follows it. A star marks what is misprinted, and what departs.""",
        step_sheet(found),
        step_remarks(found),
        """With the rounding, simulation 1 comes to rest at 0.406 mm, above the limit: the search must also end when
        the estimate repeats. That the estimates were whole milliradians is seen from the errors printed beside them.
        They are those of the offsets in whole milliradians, not those of the offsets as printed:""",
        rounding_sheet(found, of, paper["rounding"]),
        Heading(3, "Without rounding"),
        """From zero, with points at full precision, the true offsets are reached to the last digit. The condition is
        that of the 9 x 6 Jacobian at the start.""",
        unrounded_sheet(found, paper["machine"]["offset"]),
        f"""Of {RANDOM_SETS} random sets of three poses with random offsets within 3 deg, {converging(of)} lead from
        zero to the true offsets within 1e-9 deg.""",
    ]


# ---- the paper on the error model


def dh_names() -> dict[str, list[str]]:
    """The names of the paper's 25 parameters: a, alpha and theta of rows 1 to 6, d of all seven."""
    joints = [f"joint_{i}" for i in range(1, 7)]
    return {
        "a": [f"{joint}.a" for joint in joints],
        "d": [f"{joint}.d" for joint in [*joints, "handle_mount"]],
        "alpha": [f"{joint}.alpha" for joint in joints],
        "offset": [f"{joint}.offset" for joint in joints],
    }


def dh_model(robot: calib.Robot, **options: Any) -> calib.ErrorModel:
    names = dh_names()
    numbers = [*names["a"], *names["d"], *names["alpha"]]
    return calib.error_model(robot, offsets="all", placements=calib.dh.Free(numbers), **options)


def dh_errors(errors: dict[str, Any], alpha: Array, theta: Array) -> dict[str, float]:
    """The paper's parameter errors by name in m and rad; ``alpha`` and ``theta`` in rad."""
    values = {"a": np.multiply(errors["a"], MM), "d": np.multiply(errors["d"], MM), "alpha": alpha, "offset": theta}
    return {
        name: float(value)
        for group, names in dh_names().items()
        for name, value in zip(names, values[group], strict=False)  # row 7 has neither a nor alpha
    }


@dataclass(frozen=True)
class Study:
    """The second paper: as printed and as mended, the machine, and its two sets of parameter errors."""

    printed: list[dict[str, Any]]
    rows: list[dict[str, Any]]
    robot: calib.Robot
    model: calib.ErrorModel
    readings: Array
    sets: dict[str, dict[str, float]]
    radians: dict[str, float]

    def column(self, name: str) -> Array:
        return np.array([row[name] for row in self.rows])

    def by_set(self, values: Callable[[dict[str, float]], Array]) -> Array:
        """Values (..., N), those of every pose under its own set of errors."""
        return np.where(self.column("set") == "A", values(self.sets["A"]), values(self.sets["B"]))

    def nominal(self) -> Array:
        return self.robot.tips(self.readings)[:, :3, 3] / MM

    def true(self, errors: dict[str, float]) -> Array:
        return np.linalg.norm(exact_error(self.model, self.readings, errors), axis=1) / MM

    def linear(self, errors: dict[str, float]) -> Array:
        return np.linalg.norm(predicted_error(self.model, self.readings, errors), axis=1) / MM

    def linear_of_24(self, errors: dict[str, float]) -> Array:
        """The linear error as the paper has it: without the error of d_7."""
        return self.linear({name: value for name, value in errors.items() if name != dh_names()["d"][-1]})


def study(paper: dict[str, Any]) -> Study:
    robot, errors = calib.load_robot(CASE / "arm_cmm.urdf"), paper["errors"]
    rows = [mended(row) for row in paper["pose"]]
    return Study(
        paper["pose"],
        rows,
        robot,
        dh_model(robot, base="fixed", tool="fixed"),
        np.radians([row["angles"] for row in rows]),
        {s: dh_errors(errors, np.radians(errors[s]["alpha"]), np.radians(errors[s]["theta"])) for s in "AB"},
        dh_errors(errors, np.array(errors["alpha_rad"]), np.array(errors["theta_rad"])),
    )


def position_sheet(of: Study) -> Sheet:
    rows = (
        (starred(k, printed), angles(row["angles"]), *compared(printed["position"], point))
        for k, (printed, row, point) in enumerate(zip(of.printed, of.rows, of.nominal(), strict=True), 1)
    )
    return Sheet(("row", "readings [deg]", *titles("position")), tuple(rows), (0, 1))


def error_sheet(of: Study) -> Sheet:
    columns = (of.by_set(f) for f in (of.true, of.linear_of_24, of.linear))
    rows = (
        (starred(k, row), row["set"], *compared(row["error"], true), *compared(row["linear"], linear), number(full))
        for k, (row, true, linear, full) in enumerate(zip(of.printed, *columns, strict=True), 1)
    )
    return Sheet(("row", "set", *titles("true"), *titles("linear"), "with d_7"), tuple(rows), (0, 1))


def misprints(of: Study) -> Points:
    items = [f"Row {k}: {row['remark']}" for k, row in enumerate(of.printed, 1) if "remark" in row]
    actual = (of.nominal() + exact_error(of.model, of.readings, of.sets["B"]) / MM)[12]
    return Points((*items, f"The actual position of row 13 is computed as {numbers(actual, 3)}."))


def evidence_sheet(of: Study) -> Sheet:
    """What the printed columns were computed with: the other readings of the paper miss them."""
    error, linear = of.column("error"), of.column("linear")
    readings = (
        ("true", "angle errors as printed, in rad", of.true(of.radians) - error),
        ("true", "set A in every row", of.true(of.sets["A"]) - error),
        ("true", "set B in every row", of.true(of.sets["B"]) - error),
        ("true", "set A or B as listed", of.by_set(of.true) - error),
        ("linear", "A or B, all 25 terms", of.by_set(of.linear) - linear),
        ("linear", "A or B, 24 terms: the error of d_7 left out", of.by_set(of.linear_of_24) - linear),
    )
    rows = (
        (column, what, number(np.max(np.abs(d))), f"{np.sum(np.abs(d) < AGREES)} of {len(d)}")
        for column, what, d in readings
    )
    return Sheet(("column", "computed with", "largest difference [mm]", "rows that agree"), tuple(rows), (0, 1))


def sensitivity_sheet(found: Sensitivity) -> Sheet:
    rows = (
        (p.name, number(found.rms[k]), number(found.largest[k]), "mm/mm" if p.unit == "m" else "mm/mrad")
        for k in found.order
        for p in [found.parameters[k]]
    )
    return Sheet(("parameter", "rms", "max", "unit"), tuple(rows), (0, 3))


def group_sheet(of: Study) -> Sheet:
    plan = group_study(of.model, of.readings, of.sets["A"])
    changes = of.by_set(lambda errors: group_study(of.model, of.readings, errors).changes) / MM
    rows = (
        (
            "theta" if group == "offset" else group,
            f"{factor:g}",
            *(number(v, 2, signed=True) for v in (change.min(), change.mean(), change.max())),
        )
        for group, of_group in zip(plan.groups, changes, strict=True)
        for factor, change in zip(plan.factors, of_group, strict=True)
    )
    return Sheet(("group", "factor", "smallest [mm]", "mean [mm]", "largest [mm]"), tuple(rows))


def range_sheet(of: Study, printed: dict[str, list[float]]) -> Sheet:
    """The range that the text prints for each group, tenfold and a tenth together, beside the computed one."""
    plan = group_study(of.model, of.readings, of.sets["A"])
    changes = of.by_set(lambda errors: group_study(of.model, of.readings, errors).changes) / MM
    rows = []
    for group, change in zip(plan.groups, changes, strict=True):
        name = "theta" if group == "offset" else group
        ends = [*printed[name], float(change.min()), float(change.max())]
        rows.append((name, *(number(end, 2, signed=True) for end in ends)))
    heads = ("group", "printed from [mm]", "printed to [mm]", "computed from [mm]", "computed to [mm]")
    return Sheet(heads, tuple(rows))


def error_model(paper: dict[str, Any]) -> list[Block]:
    of = study(paper)
    apart = sensitivity(of.model, of.readings)
    in_place = sensitivity(dh_model(of.robot, base="pose", tool="position"), of.readings)
    computed = {"position": of.nominal(), "error": of.by_set(of.true), "linear": of.by_set(of.linear_of_24)}
    left = max(float(np.max(np.abs(values - of.column(name)))) for name, values in computed.items())
    beyond_linear = float(np.max(np.abs(of.by_set(of.linear) - of.by_set(of.true))))
    return [
        Heading(2, "Error model of a multi-joint CMM"),
        """Ye Dong, Huang Qingcheng, Che Rensheng. The error of the probe as a total differential, dP = J dx, in 25
        parameters: a, alpha and theta of six rows and d of seven. Here `calib.assessment.sensitivity` has J
        analytically (`error_coefficients`), the linear error (`predicted_error`) and the true one (`exact_error`); the
        machine is `robots/arm_cmm/arm_cmm.urdf`.""",
        Heading(3, "Nominal positions [mm]"),
        "A star marks a misprint, named below the next table. Row 9 is computed with theta_1 = 0.",
        position_sheet(of),
        Heading(3, "True errors |E| and linear errors |dP| [mm]"),
        error_sheet(of),
        "The misprints:",
        misprints(of),
        f"""With these mended all 20 positions, true errors and linear errors agree within {left:.4f} mm, under the
        parameter errors that follow.""",
        Heading(3, "Which errors the tables were computed with"),
        """The angle errors of its Table 1 are printed in rad, rounded; they were whole hundredths of a degree, .06 .08
        -.07 .10 .06 -.06 for alpha and .08 -.13 .10 .06 -.08 .06 for theta (set A). Rows 1 5 8 9 11 12 13 14 20 belong
        to a second set (set B: alpha_1 = .05, alpha_5 = .04, theta_6 = .04). One set cannot serve all rows: poses 3
        and 12 differ by half a turn of joint 1 alone, on which the length of an error does not depend, yet 4.029 and
        3.928 mm are printed. The linear column leaves out the error of d_7.""",
        evidence_sheet(of),
        f"""With all 25 terms the linear error is within {beyond_linear:.3f} mm of the true one in every row.""",
        Heading(3, "What positions tell apart"),
        f"""Over the 20 poses the 25 parameters have rank {apart.rank}; with the places of base and probe unknown, the
        rank is {in_place.rank} of {len(in_place.parameters)}. Of the 25:""",
        Points(tuple(map(str, apart.undetermined))),
        Heading(3, "Sensitivity"),
        """An error of length moves the probe by its own length wherever the arm stands, an error of angle by its lever.
        Motion of the probe over the 20 poses, per mm and per mrad:""",
        sensitivity_sheet(apart),
        Picture("Motion of the probe with each of the 25 parameters over the 20 poses", FIGURE),
        Heading(3, "Each group of errors times ten, and divided by ten"),
        """The paper's own study: the change of the true error |E| over the 20 poses when one group of errors is scaled,
        every row with its set:""",
        group_sheet(of),
        """Its text prints one range for each group, of both factors together. The lower ends for angles follow from its
        tables; the upper ends, and those for lengths, do not:""",
        range_sheet(of, paper["ranges"]),
        "Its conclusion holds: errors of angle are amplified by the links, errors of length are not.",
    ]


# ---- the page


def blocks() -> list[Block]:
    return [
        Heading(1, "Two papers on articulated arm CMMs, recomputed"),
        f"""How to calibrate an articulated arm CMM was published with numbers. Here what their tables print stands
        beside what is computed. Two numbers agree when the difference, computed less printed, is at most {AGREES} mm:
        half of the last printed digit. Both papers use standard DH, Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha)
        with theta = reading + offset, and the probe is the origin of frame 7. What is printed is kept in
        `robots/arm_cmm/papers/`, and `scripts/studies/arm_cmm_tables.py` makes this page.""",
        *zero_offsets(read("zero_offsets.toml")),
        *error_model(read("error_model.toml")),
    ]


def figure() -> bytes:
    """The bar chart of the second paper's 25 parameters, as SVG without a date or random names."""
    of = study(read("error_model.toml"))
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "arm_cmm"}):
        sensitivity_figure(sensitivity(of.model, of.readings)).savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page there")
    parser.add_argument("--urdf", type=Path, metavar="FILE", help="write the machine of the first paper there")
    arguments = parser.parse_args()
    if arguments.urdf:
        write_atomically(arguments.urdf, urdf(read("zero_offsets.toml")["machine"]))
    if arguments.markdown:
        write_atomically(arguments.markdown, markdown(blocks()))
        picture = arguments.markdown.parent / FIGURE
        picture.parent.mkdir(exist_ok=True)
        write_atomically(picture, figure())
    if not (arguments.urdf or arguments.markdown):
        show(blocks())


if __name__ == "__main__":
    main()
