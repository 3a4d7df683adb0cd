"""What is in these files? The one answer, for commands, jobs and Python: columns, units, conventions and roles.

Names list candidates; the nominal arm, base and tool put where they explain most, decides between them: readings that
are right it follows, wrong ones it does not. Where two readings fit alike, that is asked, never guessed.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from calib.assessment.checks.of_errors import POSES
from calib.assessment.checks.of_fit import FREEDOM, told_before
from calib.foundations.arguments import checked
from calib.foundations.errors import CalibError, JobError, MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.units import symbols
from calib.foundations.words import counted, listed, refuse_other, shown
from calib.identification.error_model import error_model
from calib.identification.sanity import apart
from calib.job.chains import Chain, chains
from calib.job.foreign.answers import Answers, AskedError, ask, run_of
from calib.job.foreign.reader import read
from calib.job.proposal import Proposal, ProposedTable, table_lines
from calib.measurement.columns import refuse_joints_like_columns
from calib.measurement.kinds import Kind
from calib.measurement.measurements import ONLY_SETUP, ONLY_TOOL, Measurements
from calib.measurement.orientations import ORIENTATIONS
from calib.measurement.raw import raw_table
from calib.measurement.read import read_measurements
from calib.measurement.roles import Roles, numbered_columns, roles
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf

_HELD_OUT, _MOST_HELD_OUT = 0.25, 0.5
# More rows are not few, at however few poses; to compare the poses of 100,000 takes seconds.
_FEW_ROWS = 10_000
# Kinds that columns tell; other kinds need what only a job says.
_TOLD_APART: tuple[Kind, ...] = ("position", "pose", "socket", "distance")
# What tables have whose tools and set-ups nobody names.
_UNNAMED = ((ONLY_TOOL,), (ONLY_SETUP,))
_VALIDATION = re.compile(r"valid|verif|test|check|held|control", re.IGNORECASE)


@checked
def propose(
    urdf: str | Path,
    files: Sequence[str | Path],
    *,
    tip: str | None = None,
    angles: str | None = None,
    lengths: str | None = None,
    orientation: str | None = None,
    observes: Kind | None = None,
    columns: Mapping[str, str] | None = None,
) -> Proposal:
    """Return how files of other programs are read as measurements of an arm, with reasons and questions.

        found = calib.measuring.propose("arm.urdf", ["measured.csv"])
        print(found.job())

    The arguments answer questions beforehand, for all files: ``angles`` and ``lengths``, units such as ``"deg"`` and
    ``"mm"``; ``orientation``, the meaning of three angles (``"abc"``, ``"wpr"``, ``"rpy"``, ``"rotation_vector"``,
    ``"ZYX"``...); ``observes``, the kind of measurement; ``columns``, our names for columns: ``{"x": "X2"}``.

    Raises CalibError with one sentence where a file has nothing of the arm, or an answer cannot be used.
    """
    answers = Answers(tip, angles, lengths, orientation, observes, columns)
    _refuse_answers(answers)
    document = read_urdf(urdf)
    if tip is not None and tip not in document.links:
        raise JobError(f"tip: {tip!r} is not a link of {urdf}; its links are {listed(document.links)}.")
    reasons: list[str] = []
    tables: list[ProposedTable] = []
    robot: Robot | None = None
    try:
        if len(files) == 0:
            raise _tip_question(document, chains(document, tip))
        for file in files:
            raw = raw_table(read_bytes(Path(file), MeasurementError), str(file))
            found = read(document, raw, answers, robot)
            robot = found.robot
            reasons += [f"{file}: {reason}." for reason in (*raw.remarks, *found.reasons)]
            tables.append(ProposedTable(str(file), found.observes, found.columns, "identify", None, raw.count))
    except AskedError as asked:
        arm = robot or _some_robot(document, tip)
        # No answer leads to a job of such an arm.
        refuse_joints_like_columns((reading.name for reading in arm.readings), document.where)
        return Proposal(str(urdf), arm, tuple(tables), tuple(reasons), (asked.question,), zeros=asked.zeros)
    assert robot is not None, "there are files"
    refuse_joints_like_columns((reading.name for reading in robot.readings), document.where)
    if orientation is not None and all(table.columns.orientation is None for table in tables):
        raise JobError(
            f"orientation: {shown(orientation)} says what three angles or a matrix are, and no table has them; leave "
            "it out."
        )
    # One large table alone is neither few rows nor apart from others.
    read_too = [len(tables) > 1 or table.rows <= _FEW_ROWS for table in tables]
    data = [_measured(robot, table) if too else None for table, too in zip(tables, read_too, strict=True)]
    poses = [_poses(one, table.rows) for one, table in zip(data, tables, strict=True)]
    shared, said = _shared_out(tables, poses)
    named, why = _named_apart(robot, shared, data)
    offsets_alone = _too_few_for_placements(robot, named, poses)
    return Proposal(str(urdf), robot, named, (*reasons, *said, *why, *offsets_alone), (), not offsets_alone)


def _refuse_answers(answers: Answers) -> None:
    for name, given, allowed in (
        ("angles", answers.angles, symbols("angle")),
        ("lengths", answers.lengths, symbols("length")),
        ("orientation", answers.orientation, ORIENTATIONS),
        ("observes", answers.observes, _TOLD_APART),
    ):
        if given is not None:
            refuse_other(given, allowed, name)


def _some_robot(document: Urdf, tip: str | None) -> Robot:
    arms = chains(document, tip)
    if not arms:
        return load_robot(document, tip)
    return load_robot(document, arms[0].tip, arms[0].base)


def _tip_question(document: Urdf, arms: Sequence[Chain]) -> AskedError:
    if not arms:
        raise MeasurementError(f"{document.where}: no joint moves; there is nothing to calibrate.")
    ways = "; ".join(f"{arm.tip} at the end of {run_of(arm.joints)}" for arm in arms[:4])
    return ask("observes", f"{document.where}: there are no measurements yet; tips are {ways}", (), "a table")


def _measured(robot: Robot, table: ProposedTable) -> Measurements | None:
    """Return the measurements of a table; None where something is wrong with rows, which the job says."""
    try:
        return read_measurements(table.file, robot, table.observes, columns=table.columns)
    except CalibError:
        return None


def _poses(data: Measurements | None, rows: int) -> int:
    """Return how many of the ``rows`` of a table are of different poses; all, where its measurements are not known."""
    return rows if data is None or rows > _FEW_ROWS else len(data) - told_before(data, under_conditions=False)


def _shared_out(tables: Sequence[ProposedTable], poses: Sequence[int]) -> tuple[tuple[ProposedTable, ...], list[str]]:
    """Give the tables their roles: by their names, else a share of the poses of every table is held out."""
    judged = [bool(_VALIDATION.search(Path(table.file).stem)) for table in tables]
    if any(judged) and not all(judged):
        said = [
            f"{table.file}: {'judges the result, by its name' if judge else 'is identified from'}."
            for table, judge in zip(tables, judged, strict=True)
        ]
        return tuple(
            replace(table, use="validate" if judge else "identify") for table, judge in zip(tables, judged, strict=True)
        ), said
    shared = tuple(replace(table, hold_out=_share(table, sum(poses))) for table in tables)
    return shared, [
        f"{table.file}: {_shares(table, n)} to judge the rest." for table, n in zip(shared, poses, strict=True)
    ]


def _named_apart(
    robot: Robot, tables: Sequence[ProposedTable], measured: Sequence[Measurements | None]
) -> tuple[tuple[ProposedTable, ...], list[str]]:
    """Name tools, set-ups, or both by their files where each table has one of its own."""
    own = [table for table in tables if table.use == "identify"]
    data = [one for one, table in zip(measured, tables, strict=True) if one is not None and table.use == "identify"]
    if not 1 < len(own) == len(data) or not all(table.observes in ("position", "pose") for table in own):
        return tuple(tables), []
    model = error_model(robot, tool="pose" if any(table.observes == "pose" for table in own) else "position")
    try:
        found = apart(model, data)
    except CalibError:  # what is wrong with rows, the job says
        return tuple(tables), []
    if found is None:
        return tuple(tables), []
    # Where a column names them row by row, no name of the whole table may stand beside it.
    here = {"tool": [each.tools for each in data], "setup": [each.setups for each in data]}
    if any(names not in _UNNAMED for what in found.what for names in here[what]):
        return tuple(tables), []
    stems = [Path(table.file).stem for table in own]
    name = {table.file: stem if stems.count(stem) == 1 else table.file for table, stem in zip(own, stems, strict=True)}
    named = tuple(
        replace(
            table,
            tool=name[table.file] if "tool" in found.what else table.tool,
            setup=name[table.file] if "setup" in found.what else table.setup,
        )
        if table.use == "identify"
        else table
        for table in tables
    )
    return named, [f"{', '.join(name)}: {found.sentence}."]


def _share(table: ProposedTable, poses: int) -> float:
    """Return the share to hold out: of few ``poses`` of all tables as many as judge a fit, and at most half of them."""
    if table.observes == "socket" or not poses:
        return _HELD_OUT
    return round(min(max(_HELD_OUT, POSES / poses), _MOST_HELD_OUT), 2)


def _shares(table: ProposedTable, poses: int) -> str:
    if table.observes == "socket":
        return "a quarter of its sockets, at least one, is held out with all its rows"
    what = f"{table.rows} rows" if poses == table.rows else f"{poses} poses"
    if table.hold_out and table.hold_out > _HELD_OUT:
        return f"{_held_out(table, poses)} of its {what} are held out"
    return f"a quarter of its {what} is held out"


def _held_out(table: ProposedTable, poses: int) -> int:
    """Return how many poses are held out, as :func:`calib.assessment.validation.hold_out` does."""
    return max(round(table.hold_out * poses), 1) if table.hold_out else 0


def _too_few_for_placements(robot: Robot, tables: Sequence[ProposedTable], poses: Sequence[int]) -> list[str]:
    """Return why joint offsets alone are free, where the rows leave too little to judge link placements by."""
    own = [(table, n) for table, n in zip(tables, poses, strict=True) if table.use == "identify"]
    if not own or not all(table.observes in ("position", "pose") for table, _ in own):
        return []
    of_tool = 6 if any(table.observes == "pose" for table, _ in own) else 3
    tools, setups = ({getattr(table, what) for table, _ in own} for what in ("tool", "setup"))
    # What poses determine of an arm with its base and its tool: L. J. Everett, M. Driels, B. W. Mooring, Kinematic
    # modelling for robot calibration, ICRA 1987. Positions do not determine the orientation of the tool.
    slides = robot.moving_types.count("prismatic")
    determined = 4 * (len(robot.moving_types) - slides) + 2 * slides + 6 * (len(setups) - 1) + of_tool * len(tools)
    of_row = [6 if table.observes == "pose" else 3 for table, _ in own]
    numbers = sum(each * (n - _held_out(table, n)) for each, (table, n) in zip(of_row, own, strict=True))
    needed = determined + FREEDOM
    if numbers >= needed:
        return []
    rows, there = sum(table.rows for table, _ in own), sum(n for _, n in own)
    enough = needed / min(of_row)
    if own[0][0].hold_out:  # a quarter of them, and as many as judge a fit
        enough = max(enough / (1.0 - _HELD_OUT), enough + POSES)
    said = counted(rows, "row") if there == rows else f"{counted(rows, 'row')} of {counted(there, 'pose')}"
    return [
        f"{said} {'is' if rows == 1 else 'are'} too few to find link placements, which need about "
        f"{max(math.ceil(enough), there + 1)}: joint offsets alone are free."
    ]


def reading_that_fits(file: Path, robot: Robot, observes: Kind) -> str:
    """Return how a job would say that a table is read, for the end of a sentence; empty where that is not clear."""
    try:
        raw = raw_table(read_bytes(file, MeasurementError), str(file))
        found = read(robot.urdf, raw, Answers(observes=observes), robot)
    except (AskedError, CalibError):
        return ""
    return ", ".join(table_lines(found.columns))


def told(file: str | Path) -> tuple[str, ...]:
    """Return what the header of a table says without an arm; one sentence each."""
    raw = raw_table(read_bytes(Path(file), MeasurementError), str(file))
    known = roles(raw) if raw.named else Roles((), (), (), (), None, frozenset())

    def named(columns: Iterable[int]) -> str:
        return run_of([raw.columns[k].title for k in columns])

    said = [*raw.remarks, f"{counted(raw.count, 'row')} of {counted(len(raw.columns), 'column')}"]
    said += [f"{named(point.columns)} may be a point" for point in known.points]
    said += [f"{named(one.columns)} may be an orientation" for one in known.orientations]
    said += [f"{size} columns are numbered" for size in numbered_columns(raw) if size > 2]
    unitless = [c.title for c in raw.columns if c.numbers is not None and c.symbol is None]
    if unitless:
        said.append(f"without a unit: {listed(unitless, most=20)}")
    return tuple(f"{file}: {one}." for one in said)
