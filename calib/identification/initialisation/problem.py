"""From a model and measurements to a problem: common names, start values, what is unknown, and what cannot be."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import BoolArray, IntArray
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.ranges import MOST_POINTS, MOST_TARGETS
from calib.identification import targets
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.frames import initialise, turned, turned_by
from calib.identification.initialisation.target_poses import with_targets
from calib.identification.machine import Layout, Machine, values_at
from calib.identification.parameters import UNSHOWN_TOOL_WIDTH, Parameter
from calib.identification.solver import solve
from calib.identification.system import Problem
from calib.measurement.kinds import IN_INSTRUMENT_FRAME
from calib.measurement.measurements import Measurements
from calib.robot.transmission import lacking


def initial_problem(model: ErrorModel, measurements: Sequence[Measurements]) -> Problem:
    """Return the problem of finding all that is free, with base, tools and targets where the nominal robot has them.

    Where nothing was measured in an instrument's frame, such as by sockets or cameras alone, the base's frame is taken
    for it: a camera or a board on the floor is then found in the base. Of a tool that nothing shows but as a point,
    beside others that boards and cameras show, the orientation is no unknown.

    Raises MeasurementError when there are none, when they are not of this robot, or a target is two things; JobError
    when a name means two things, a known or related target is in no measurement, or a tool needs its orientation free.
    """
    if not measurements:
        raise MeasurementError("there are no measurements to identify from.")
    for data in measurements:
        if not len(data):
            raise MeasurementError(f"{data.where}: has no rows to identify from.")
    sets = with_common_names(model, measurements)
    _refuse_unturned_tools(model, sets)
    _refuse_unknown_targets(model, sets)
    if not any(data.kind in IN_INSTRUMENT_FRAME for data in sets) and not any(
        target.height_is_known for target in model.targets.values()
    ):
        model = replace(model, base="fixed")
    reference, unshown = initialise(model, sets)
    layout = Layout.of(model.robot, reference)
    of_model = _without_turns_of_points(model.parameters(sets[0].tools), sets, layout)
    of_model = _with_unshown_tools(of_model, unshown, layout)
    parameters = (*of_model, *targets.unknowns(sets, model.targets, layout))
    names = [parameter.name for parameter in parameters]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise JobError(f"the parameter name {twice[0]!r} means two things; rename a joint, a target or a length.")
    return Problem(model, parameters, reference, sets, relations=model.relations)


def with_common_names(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with common lists of tools, targets and lengths.

    Raises MeasurementError when they are not of this robot, or lack what a joint term needs.
    """
    names = tuple(reading.name for reading in model.robot.readings)
    for data in sets:
        if data.reading_names != names:
            raise MeasurementError(
                f"{data.where}: the readings {data.reading_names} are not those of the robot, {names}."
            )
        for end in data.ends:
            if missing := lacking(model.robot.terms, names, end.conditions):
                raise MeasurementError(f"{data.where}: there is no column {missing[1]!r}, which {missing[0]} needs.")
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    every = tuple(dict.fromkeys(target for data in sets for target in data.targets))
    offsets = tuple(dict.fromkeys(offset for data in sets for offset in data.offsets))
    for found, what, most in ((tools, "points", MOST_POINTS), (every, "targets", MOST_TARGETS)):
        if len(found) > most:
            raise MeasurementError(f"the measurements have {len(found)} {what} together; allowed are {most}.")

    def numbered(old: Sequence[str], new: Sequence[str], numbers: IntArray) -> IntArray:
        # -1 stays what it is: none.
        return np.array([*(new.index(name) for name in old), -1], dtype=np.intp)[numbers]

    return tuple(
        replace(
            data,
            tools=tools,
            tool=numbered(data.tools, tools, data.tool),
            targets=every,
            target=numbered(data.targets, every, data.target),
            other=None
            if data.other is None
            else replace(data.other, tool=numbered(data.tools, tools, data.other.tool)),
            offsets=offsets,
            offset=offsets.index(data.offsets[data.offset]) if data.offset >= 0 else -1,
        )
        for data in sets
    )


def with_new_targets(model: ErrorModel, sets: Sequence[Measurements], machine: Machine) -> Machine:
    """Return a machine with the targets and lengths of sets with common names that it does not know yet.

    The sets' names are the machine's, then new ones. Raises IdentificationError when the measurements are too few.
    """
    frames = machine.frames
    known_targets, known_lengths = len(frames.targets), len(frames.lengths)
    if (known_targets, known_lengths) == (len(sets[0].targets), len(sets[0].offsets)):
        return machine
    tips = [data.tips(model.robot, machine.deviations) for data in sets]
    placed = with_targets(model, sets, tips, frames)
    placed = replace(
        placed,
        targets=np.concatenate([frames.targets, placed.targets[known_targets:]]),
        lengths=np.concatenate([frames.lengths, placed.lengths[known_lengths:]]),
    )
    layout = Layout.of(model.robot, placed)
    targets_end, lengths_end = layout.targets + 6 * known_targets, layout.lengths + known_lengths
    new = tuple(
        parameter
        for parameter in targets.unknowns(sets, model.targets, layout)
        if targets_end <= parameter.direction[0][0] < layout.lengths or parameter.direction[0][0] >= lengths_end
    )
    problem = Problem(model, new, placed, tuple(sets), machine.deviations)
    x0 = values_at(model.robot, new, placed, machine.deviations)
    # The mean of a socket's rows is the answer already; other targets are near it.
    others = [data for data in sets if data.kind in targets.SHAPES and data.kind != "socket"]
    return problem.machine(solve(problem, x0).x if others and new else x0)


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
        tool, component = divmod(parameter.direction[0][0] - layout.tools, 6)
        return parameter.kind == "tool" and component > 2 and not turning[tool]

    return tuple(parameter for parameter in parameters if not of_point(parameter))


def _with_unshown_tools(parameters: tuple[Parameter, ...], unshown: BoolArray, layout: Layout) -> tuple[Parameter, ...]:
    """Return the parameters with points of tools held where they start, if poses do not show all their directions.

    Wide priors would let errors of the model move such a tool far along curved valleys, to no one's use.
    """

    def held(parameter: Parameter) -> bool:
        tool, component = divmod(parameter.direction[0][0] - layout.tools, 6)
        return parameter.kind == "tool" and component < 3 and bool(unshown[tool])

    return tuple(replace(q, weak=UNSHOWN_TOOL_WIDTH) if held(q) else q for q in parameters)


def _refuse_unknown_targets(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse what is known of targets that nobody measured, and relations of the wrong things."""
    found = targets.shapes(sets)
    for name in model.targets:
        if name not in found:
            there = ", ".join(found) or "no targets"
            raise JobError(f"targets: {name!r} does not appear in the measurements; they have {there}.")
        if found[name] == "frame" and not model.targets[name].height_is_known:
            raise JobError(f"targets: {name!r} is a board or camera: give its position and quaternion, not a normal.")
    for relation in model.relations:
        shape = "point" if relation.kind == "distance" else "plane"
        for name in relation.targets:
            if found.get(name) != shape:
                raise JobError(
                    f"relations: a known {relation.kind} is between two {shape}s, and {name!r} is "
                    f"{'a ' + found[name] if name in found else 'in no measurement'}."
                )
