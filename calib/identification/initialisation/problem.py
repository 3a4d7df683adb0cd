"""From a model and measurements to a problem: common names, start values, what is unknown, and what cannot be."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import BoolArray, IntArray, read_only_view
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.ranges import (
    MOST_FRAMES,
    MOST_RELATED,
    MOST_RELATIONS,
    MOST_SETUPS,
    MOST_TARGETS,
    MOST_TOOLS,
)
from calib.foundations.words import counted, not_loaded
from calib.identification import targets
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.frames import initialise, turned, turned_by
from calib.identification.machine import Frames, Layout, Machine, values_at
from calib.identification.parameters import UNSHOWN_TOOL_WIDTH, UNSHOWN_TOOLS, Parameter, ParameterKind, Wider
from calib.identification.relations import refuse_unrelated, related_targets
from calib.identification.rows import frame_numbers
from calib.identification.set_ups import SetUp
from calib.identification.solver import solve
from calib.identification.system import Problem
from calib.measurement.conditions import refuse_lacking
from calib.measurement.kinds import IN_INSTRUMENT_FRAME
from calib.measurement.measurements import ONLY_SETUP, Measurements, as_sets, refuse_absent
from calib.robot.conditions import joined
from calib.robot.robot import Robot
from calib.robot.terms import kind_of
from calib.robot.torques import expected_torques


def initial_problem(model: ErrorModel, measurements: Sequence[Measurements]) -> Problem:
    """Return the problem of finding all that is free, with base, tools and targets where the nominal robot has them.

    Where nothing was measured in an instrument's frame, such as by sockets or cameras alone, the base's frame in the
    first set-up is taken for it: a camera or a board on the floor is then found in the base. Of a tool that nothing
    shows but as a point, beside others that boards and cameras show, the orientation is no unknown.

    Raises MeasurementError when there are none, when they are not of this robot, or a target is two things; JobError
    when a name means two things, a known or related target is in no measurement, or a tool needs its orientation free.
    """
    for data in as_sets(measurements):
        if not len(data):
            raise MeasurementError(f"{data.where}: has no rows to identify from.")
    sets = with_common_names(model, measurements)
    if any(end.conditions.torque_sigma is not None for data in sets for end in data.ends):
        sets = _with_expected_torques(model, sets)
    _refuse_unturned_tools(model, sets)
    _refuse_many_relations(model)
    _refuse_unknown_targets(model, sets)
    _refuse_unknown_setups(model, sets)
    if not any(data.kind in IN_INSTRUMENT_FRAME for data in sets) and not any(
        (
            *(target.height_is_known for target in model.targets.values()),
            *(model.known_base(setup) is not None for setup in sets[0].setups),
        )
    ):
        model = replace(model, setups={**model.setups, sets[0].setups[0]: SetUp(model.base_pose)})
    reference, unshown = initialise(model, sets)
    layout = Layout.of(model.robot, reference)
    of_model = _without_turns_of_points(model.parameters(sets[0].tools, sets[0].setups), sets, layout)
    of_model = _with_unshown_tools(of_model, unshown, layout)
    parameters = (*of_model, *targets.unknowns(sets, model.targets, layout))
    counts = Counter(parameter.name for parameter in parameters)
    if twice := sorted(name for name, count in counts.items() if count > 1):
        raise JobError(f"the parameter name {twice[0]!r} means two things; rename a joint, a target or a length.")
    return Problem(model, parameters, reference, sets, relations=model.relations)


def _with_expected_torques(model: ErrorModel, sets: tuple[Measurements, ...]) -> tuple[Measurements, ...]:
    """Return the sets with torques that are to be expected in the place of those that scatter by a stated sigma.

    Of joints that nobody read nothing is learned, and nothing is expected.
    """
    unread = [np.isin(data.reading_names, data.absent) for data in sets for _ in data.ends]
    rows = [(end.readings, end.conditions) for data in sets for end in data.ends]
    known = [
        (readings, told if told.torque is None else replace(told, torque=np.where(none, np.nan, told.torque)))
        for (readings, told), none in zip(rows, unread, strict=True)
    ]
    told = iter(
        own if own.torque is None else replace(own, torque=np.where(none, 0.0, own.torque))
        for own, none in zip(expected_torques(model.urdf_robot, known), unread, strict=True)
    )
    found = []
    for data in sets:
        own = replace(data, conditions=next(told))
        found.append(own if data.other is None else replace(own, other=replace(data.other, conditions=next(told))))
    return tuple(found)


def with_common_names(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with common lists of tools, set-ups, targets and scalars.

    Raises MeasurementError when they are not of this robot, or lack what a joint term needs.
    """
    names = tuple(reading.name for reading in model.robot.readings)
    for data in sets:
        if data.reading_names != names:
            raise MeasurementError(
                f"{data.where}: the readings {data.reading_names} are not those of the robot, {names}."
            )
        for end in data.ends:
            refuse_lacking(model.robot, end.conditions, data.where)
    sets = [replace(data.loaded(model.urdf_robot), tip=data.tip or model.robot.tip) for data in sets]
    _refuse_differing_payloads(model, sets)
    links = _common_links(sets)
    _refuse_other_optics(sets)
    for data in sets:
        _refuse_other_links(model.robot, data)
        refuse_absent(model.robot, data)
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    setups = tuple(dict.fromkeys(setup for data in sets for setup in data.setups))
    every = tuple(dict.fromkeys(target for data in sets for target in data.targets))
    scalars = tuple(dict.fromkeys(scalar for data in sets for scalar in data.scalars))
    for found, what, most in (
        (tools, "tools", MOST_TOOLS),
        (setups, "set-ups", MOST_SETUPS),
        (every, "targets", MOST_TARGETS),
    ):
        if len(found) > most:
            raise MeasurementError(f"the measurements have {len(found)} {what} together; allowed are {most}.")
    if len(tools) + len(setups) > MOST_FRAMES:
        raise MeasurementError(
            f"the measurements have {counted(len(setups), 'set-up')} and {counted(len(tools), 'tool')}; allowed are "
            f"{MOST_FRAMES} together."
        )

    def numbered(old: Sequence[str], new: Sequence[str], numbers: IntArray) -> IntArray:
        # -1 stays what it is: none.
        place = {name: k for k, name in enumerate(new)}
        return read_only_view(np.array([*(place[name] for name in old), -1], dtype=np.intp)[numbers])

    return tuple(
        replace(
            data,
            tools=tools,
            tool=numbered(data.tools, tools, data.tool),
            setups=setups,
            setup=numbered(data.setups, setups, data.setup),
            target_links=links,
            targets=every,
            target=numbered(data.targets, every, data.target),
            other=None
            if data.other is None
            else replace(data.other, tool=numbered(data.tools, tools, data.other.tool)),
            scalars=scalars,
            uses={role: scalars.index(data.scalars[k]) for role, k in data.uses.items()},
        )
        for data in sets
    )


def _refuse_other_optics(sets: Sequence[Measurements]) -> None:
    """Refuse cameras of one name with other numbers, and boards of one name with other marks."""
    cameras: dict[str, Measurements] = {}
    boards: dict[str, Measurements] = {}
    for data in sets:
        if data.camera is not None and data.camera.free:
            first = cameras.setdefault(data.camera.name, data)
            if first.camera != data.camera:
                raise MeasurementError(
                    f"{data.where}: the camera {data.camera.name!r} is not the one of that name in {first.where}; give "
                    "one of them another name."
                )
        if data.board is not None:
            first = boards.setdefault(data.board.name, data)
            if not data.board.same_as(first.board):
                raise MeasurementError(
                    f"{data.where}: the board {data.board.name!r} is not the one of that name in {first.where}; give "
                    "one of them another name."
                )


def _common_links(sets: Sequence[Measurements]) -> dict[str, str]:
    """Return the links of the targets of sets, by name.

    Raises MeasurementError when a tool is on two tips, or a target on two links, or on one and on the floor.
    """
    tips: dict[str, str] = {}
    stands: dict[str, str | None] = {}
    for data in sets:
        for tool in (data.tools[k] for k in np.unique(np.concatenate([end.tool for end in data.ends]))):
            if tips.setdefault(tool, data.tip) != data.tip:
                raise MeasurementError(
                    f"{data.where}: the tool {tool!r} is on {data.tip!r} here and on {tips[tool]!r} in another table; "
                    "give one of them another name."
                )
        for target in data.seen_targets:
            link = data.target_links.get(target)
            if stands.setdefault(target, link) != link:
                here, there = (link or "the floor", stands[target] or "the floor")
                raise MeasurementError(
                    f"{data.where}: the target {target!r} is on {here} here and on {there} in another table; give one "
                    "of them another name."
                )
    return {target: link for target, link in stands.items() if link is not None}


def _refuse_other_links(robot: Robot, data: Measurements) -> None:
    """Refuse rows about links that the robot does not have."""
    for link in sorted(data.links_about(robot) - set(robot.links)):
        raise MeasurementError(f"{data.where}: {not_loaded(link, robot.links)}.")


def _refuse_differing_payloads(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse payloads that differ from row to row where a term takes all masses for the same and unknown."""
    blind = next((kind_of(term) for term in model.robot.terms if kind_of(term).masses == "unknown"), None)
    if blind is None:
        return
    told = joined([(len(data), end.conditions) for data in sets for end in data.ends]).payload
    if told is not None and not np.array_equal(told, np.broadcast_to(told[0], told.shape), equal_nan=True):
        raise JobError(
            f"{blind.key}: the payload is not the same in all rows, and terms of unknown masses need one payload; give "
            "every <link> of the URDF an <inertial>, and free terms of stated masses, such as elastic."
        )


def with_new_frames(model: ErrorModel, sets: Sequence[Measurements], machine: Machine) -> Machine:
    """Return a machine with the set-ups, tools, targets and scalars of sets with common names that it does not know.

    The sets' names are the machine's, then new ones. Raises IdentificationError when the measurements are too few.
    """
    frames, names = machine.frames, sets[0]
    known = (len(frames.bases), len(frames.tools), len(frames.targets), len(frames.scalars))
    if known == (len(names.setups), len(names.tools), len(names.targets), len(names.scalars)):
        return machine
    refuse_unplaced(model, names.setups)
    placed = initialise(model, sets, machine).frames
    placed = Frames(
        *(
            np.concatenate([old, new[len(old) :]])
            for old, new in (
                (frames.bases, placed.bases),
                (frames.tools, placed.tools),
                (frames.targets, placed.targets),
                (frames.scalars, placed.scalars),
            )
        )
    )
    layout = Layout.of(model.robot, placed)
    starts = (layout.base, layout.tools, layout.targets, layout.scalars)
    ends = (*starts[1:], layout.size)
    new = tuple(
        parameter
        for parameter in (
            *_without_turns_of_points(model.parameters(names.tools, names.setups), sets, layout),
            *targets.unknowns(sets, model.targets, layout),
        )
        for start, count, end, size in zip(starts, known, ends, (6, 6, 6, 1), strict=True)
        if start + size * count <= parameter.entries[0][0] < end
    )
    _refuse_too_few(new, layout, sets)
    problem = Problem(model, new, placed, tuple(sets), machine.deviations)
    x0 = values_at(model.robot, new, placed, machine.deviations)
    # The mean of a socket's rows is the answer already; other targets are near it.
    others = [data for data in sets if data.stream or (data.kind in targets.SHAPES and data.kind != "socket")]
    of_setup = any(not parameter.nuisance for parameter in new)
    return problem.machine(solve(problem, x0).x if new and (others or of_setup) else x0)


def _refuse_too_few(new: Sequence[Parameter], layout: Layout, sets: Sequence[Measurements]) -> None:
    """Refuse rows that new tools and bases would use up: nothing would be left to judge."""
    kinds: tuple[ParameterKind, ...] = ("base", "tool")
    for kind in kinds:
        entries = [layout.frame_of(q)[0] for q in new if q.kind == kind]
        for k in dict.fromkeys(entries):
            own = [frame_numbers(data, kind) == k for data in sets]
            numbers = sum(int(rows.sum()) * data.sigma.shape[1] for data, rows in zip(sets, own, strict=True))
            if numbers <= entries.count(k):
                what, names = ("set-up", sets[0].setups) if kind == "base" else ("tool", sets[0].tools)
                where = next(data.where for data, rows in zip(sets, own, strict=True) if rows.any())
                raise MeasurementError(
                    f"{where}: the {what} {names[k]!r} was not identified, and its {numbers} measured numbers are too "
                    f"few to find its {entries.count(k)} unknowns and to judge."
                )


def _refuse_unknown_setups(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse set-ups that are known and in no measurement, and as :func:`refuse_unplaced`."""
    names = sets[0].setups
    for name in model.setups:
        if name not in names:
            raise JobError(
                f"setups: {name!r} is in no measurement; the measurements have {', '.join(map(repr, names))}."
            )
    refuse_unplaced(model, names)


def refuse_unplaced(model: ErrorModel, setups: Sequence[str]) -> None:
    """Raise JobError for a set-up without a pose where the base is fixed."""
    for name in setups:
        if model.base == "fixed" and name not in (ONLY_SETUP, *model.setups):
            raise JobError(f"setups: the pose of the base in {name!r} is missing, and the base is fixed.")


def _refuse_unturned_tools(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse boards and cameras on the tip whose orientation is neither known nor free."""
    for data in sets:
        if data.camera is not None and model.tool == "position" and turned_by(data):
            what = "camera" if data.camera.camera_on == "tip" else "board"
            raise JobError(
                f'tool: is "position", and the orientation of the {what} on the tip in {data.where} is not known; '
                'write "pose".'
            )


def _without_turns_of_points(
    parameters: tuple[Parameter, ...], sets: Sequence[Measurements], layout: Layout
) -> tuple[Parameter, ...]:
    """Return the parameters without the orientations of tools that are seen as points, where cameras see others."""
    if not any(data.camera is not None for data in sets):
        return parameters
    turning = turned(sets)

    def of_point(parameter: Parameter) -> bool:
        if parameter.kind != "tool":
            return False
        tool, component = layout.frame_of(parameter)
        return component > 2 and not turning[tool]

    return tuple(parameter for parameter in parameters if not of_point(parameter))


def _with_unshown_tools(parameters: tuple[Parameter, ...], unshown: BoolArray, layout: Layout) -> tuple[Parameter, ...]:
    """Return the parameters with points of tools held where they start, if poses do not show all their directions.

    Wide priors would let errors of the model move such a tool far along curved valleys, to no one's use; they get them
    back where the data clearly ask for another place.
    """

    def held(parameter: Parameter) -> bool:
        if parameter.kind != "tool":
            return False
        tool, component = layout.frame_of(parameter)
        return component < 3 and bool(unshown[tool])

    def narrowed(q: Parameter) -> Parameter:
        return replace(q, weak_prior=UNSHOWN_TOOL_WIDTH, wider=Wider(q.weak_prior, UNSHOWN_TOOLS))

    return tuple(narrowed(q) if held(q) else q for q in parameters)


def _refuse_many_relations(model: ErrorModel) -> None:
    for count, what, most in (
        (len(model.relations), "relations", MOST_RELATIONS),
        (len(related_targets(model.relations)), "targets that relations join", MOST_RELATED),
    ):
        if count > most:
            raise JobError(f"relations: there are {count} {what}; allowed are {most}.")


def _refuse_unknown_targets(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse what is known of targets that nobody measured, and relations of the wrong things."""
    found = targets.shapes(sets)
    targets.refuse_unmeasured(model.targets, found)
    for name in model.targets:
        if found[name] == "frame" and not model.targets[name].height_is_known:
            raise JobError(f"targets: {name!r} is a board or camera: give its position and quaternion, not a normal.")
    for relation in model.relations:
        a, b = (sets[0].target_links.get(name, "the floor") for name in relation.targets)
        if a != b:
            raise JobError(
                f"relations: {relation.targets[0]!r} is on {a} and {relation.targets[1]!r} on {b}; a relation is "
                "between targets that do not move relative to each other."
            )
    refuse_unrelated(model.relations, found)
