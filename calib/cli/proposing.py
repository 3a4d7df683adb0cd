"""Options and steps of commands that look at files of others before there is a job."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.application import Telling
from calib.cli.options import option
from calib_start import loading

if TYPE_CHECKING:
    from calib.job.looking import Looked
    from calib.job.proposal import Proposal, Question
    from calib.measurement.table import Columns
    from calib.presentation.console import Shown

OrientationName = Annotated[
    str | None,
    typer.Option(
        "--orientation",
        help="What three angles are: rotation_vector, abc (KUKA), wpr (FANUC), rpy, or an order like ZYX or xyz.",
    ),
]
ColumnNames = Annotated[
    list[str] | None,
    typer.Option("--column", help="A column by our name: 'x=X2', 'joint_1 [deg]=A1'; repeatable."),
]


@dataclass(frozen=True, slots=True)
class Said:
    """What a person says beforehand of files of others, in options."""

    tip: Annotated[str | None, typer.Option("--tip", help="The link that carries the tool.")] = None
    angles: Annotated[str | None, typer.Option("--angles", help="Unit of angles that have none: deg, rad.")] = None
    lengths: Annotated[str | None, typer.Option("--lengths", help="Unit of lengths that have none: mm, m.")] = None
    orientation: OrientationName = None
    observes: Annotated[
        str | None, typer.Option("--observes", help="What was measured: position, pose, socket, distance.")
    ] = None
    column: ColumnNames = None

    def answers(self) -> dict[str, Any]:
        """Return it as :func:`calib.measuring.propose` takes it."""
        given = asdict(self)
        columns = renamed(given.pop("column"))
        return {name: said for name, said in {**given, "columns": columns or None}.items() if said is not None}


NOTHING_SAID = Said()


def renamed(column: Sequence[str] | None) -> dict[str, str]:
    """Return our names for columns of options like 'x=X2', by our name."""
    from calib.foundations.errors import JobError

    columns: dict[str, str] = {}
    for pair in column or ():
        ours, mark, theirs = (part.strip() for part in pair.partition("="))
        if not mark or not ours or not theirs:
            raise JobError(f"--column: {pair!r} is not like 'x=X2': our name, and the title in the file.")
        if columns.setdefault(ours, theirs) != theirs:
            raise JobError(f"--column: {ours!r} has two titles, {columns[ours]!r} and {theirs!r}; give it one.")
    return columns


@dataclass(frozen=True, slots=True)
class AsTitled:
    """What options say of the columns of one table."""

    orientation: OrientationName = None
    column: ColumnNames = None
    ignore: Annotated[list[str] | None, option("--ignore", "TITLE", "A column to pass over; repeatable.")] = None

    def columns(self) -> "Columns | None":
        """Return how the table is read; None where the options say nothing of it."""
        from calib.measurement.table import Columns

        said = self.column or self.ignore or self.orientation
        return Columns(renamed(self.column), tuple(self.ignore or ()), self.orientation) if said else None


AS_TITLED = AsTitled()


def proposed(
    urdf: str,
    files: Sequence[Path],
    given: Mapping[str, Any],
    *,
    ask: bool,
    as_read: Callable[["Proposal"], str] | None = None,
) -> "Proposal":
    """Return a proposal without open questions; ``ask``: a person at the terminal, else the first one is an error.

    ``as_read``: writes, once, the URDF of readings that have other zeros or signs, and returns where it is.
    """
    with loading():
        from calib.foundations.errors import JobError
        from calib.identification.zeros import told
        from calib.job.propose import propose
    given, of_zeros = dict(given), tuple[str, ...]()
    while True:
        found = propose(urdf, files, **given)
        if not found.questions:
            return replace(found, reasons=(*of_zeros, *found.reasons))
        if found.zeros and as_read is not None:
            counting, as_read = as_read(found), None
            of_zeros = (f"{counting} is {urdf} with the zeros and signs of the readings: there {told(found.zeros)}.",)
            urdf = counting
            continue
        question = found.questions[0]
        if not (ask and question.choices and sys.stdin.isatty()):
            raise JobError(question.sentence)
        given |= _answer(question, given)


def _answer(question: "Question", given: Mapping[str, Any]) -> dict[str, Any]:
    from calib.foundations.words import printable

    typer.echo(printable(f"{question.text}:"), err=True)
    for k, choice in enumerate(question.choices, start=1):
        typer.echo(printable(f"  {k}  {choice}"), err=True)
    number = 0
    while not 1 <= number <= len(question.choices):
        try:
            number = typer.prompt("Which", type=int, err=True)
        except typer.Abort as ended:
            if isinstance(ended.__context__, KeyboardInterrupt):  # and not the end of what is typed
                raise KeyboardInterrupt from None
            raise
    answer = question.answered(question.choices[number - 1])
    if "columns" in answer:
        return {"columns": {**given.get("columns", {}), **answer["columns"]}}
    return answer


def tell_check(
    telling: Telling, looked: "Looked", reasons: Iterable[str] = (), more: Mapping[str, Any] | None = None
) -> None:
    """Print what was looked at; before it the ``reasons`` of a proposal."""
    from calib.job.looking import NO_FINDINGS
    from calib.presentation.console import warning
    from calib.presentation.tables import null_space_lines

    findings, seen, why = looked.findings, looked.seen, list(reasons)

    def shown() -> "list[Shown]":
        return [
            *why,
            *(map(warning, findings) if findings else [NO_FINDINGS]),
            looked.sentence,
            *null_space_lines(looked.brief, directions=len(seen.undetermined)),
        ]

    telling.tell(lambda: looked.contents() | dict(more or {}) | ({"reasons": why} if why else {}), shown)
