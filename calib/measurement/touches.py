"""Tables of touches, as acceptance tests of articulated arms take them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.brief import brief
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import Dimension
from calib.foundations.words import listed
from calib.measurement.columns import numbers, refuse_others, stacked
from calib.measurement.conditions import conditions
from calib.measurement.table import APPROACH, TORQUE, Table, read_table
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.robot import Reading, Robot

TestKind = Literal["cone", "length", "sphere", "articulations"]

# What a table needs beside the joints, words first, and what it may have; its kind follows from what is there.
_WORDS: Mapping[TestKind, tuple[str, ...]] = {
    "cone": ("target",),
    "length": ("target", "pair"),
    "sphere": ("target",),
    "articulations": ("target", "group"),
}
_SIZES: Mapping[TestKind, tuple[str, ...]] = {
    "cone": (),
    "length": ("length",),
    "sphere": ("diameter", "ball"),
    "articulations": ("diameter", "ball"),
}
# Of cones and spheres: a test takes three or so, and all are sought at once.
_MOST_PLACES = 100
_PASSED_OVER = frozenset({"time", "temperature", "sigma_tau", "tool", "setup", "sigma"})


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Touches:
    """N touches of one test. Made by :func:`touches` and :func:`read_touches`.

    ``readings`` (N, nr) in rad and m; ``words``: the columns target, pair, group, each N words, as far as ``kind`` has
    them; ``sizes``: the columns length, diameter, ball, each (N,) in m. ``lines`` (N): where a row stands in ``where``.
    ``conditions``: what joint terms need to be told.
    """

    __repr__ = brief

    kind: TestKind
    readings: Array
    words: Mapping[str, tuple[str, ...]]
    sizes: Mapping[str, Array]
    where: str
    lines: IntArray
    conditions: Conditions = NO_CONDITIONS


@checked
def read_touches(path: str | Path, robot: Robot) -> Touches:
    """Read the touches of one test from a CSV file. Raises MeasurementError as :func:`touches` does."""
    return touches(read_table(path), robot.readings)


def touches(table: Table, readings: Sequence[Reading]) -> Touches:
    """Return what a table says of one test; which test it is, its columns say.

    With ``length``: the two ends (``target``) of a known length in many places (``pair``). With ``diameter``: a sphere
    in one or several places (``target``), touched with a probe whose ball has the diameter ``ball``; with ``group``,
    in several articulations. With neither: cones (``target``), each touched in many articulations.

    Raises MeasurementError when a column is missing, not known, or in a unit of another dimension, for several tools,
    and for very many targets.
    """
    columns = table.columns
    kind: TestKind = "cone"
    if "length" in columns:
        kind = "length"
    elif "diameter" in columns:
        kind = "articulations" if "group" in columns else "sphere"
    words, sizes = _WORDS[kind], _SIZES[kind]
    joints: dict[str, Dimension] = {reading.name: reading.dimension for reading in readings}
    if missing := [name for name in (*joints, *sizes, *words) if name not in columns]:
        lacking, there = (", ".join(map(repr, some)) for some in (missing, columns))
        raise MeasurementError(
            f"{table.where}: there is no column {lacking} of a {kind} test; the columns are {there}."
        )
    known = {*joints, *sizes, *words, "group", "direction"} | _PASSED_OVER
    known |= {f"{what}{reading.name}" for what in (APPROACH, TORQUE) for reading in readings}
    refuse_others(table, known, f"a {kind} test")
    if "tool" in columns and len(tools := dict.fromkeys(map(str, columns["tool"].values))) > 1:
        raise MeasurementError(f"{table.where}: column 'tool' has {listed(tools)}; a test is of one probe.")
    of_shapes = {name: numbers(table, name, "length") for name in sizes}
    for name, values in of_shapes.items():
        table.refuse(values <= 0.0, lambda _: f"column {name!r} is not positive.")  # noqa: B023 - called at once
    said = {name: cast(tuple[str, ...], columns[name].values) for name in words}
    # What belongs to a name is sought: the place of a cone, a sphere. Lengths are only counted.
    for name in ("target", "group") if kind != "length" else ():
        if (count := len(set(said.get(name, ())))) > _MOST_PLACES:
            raise MeasurementError(f"{table.where}: column {name!r} has {count} names; allowed are {_MOST_PLACES}.")
    return Touches(
        kind,
        stacked(table, joints),
        said,
        of_shapes,
        table.where,
        table.lines,
        conditions(table, readings),
    )
