"""What contradicts itself in a job or its tables: refused with a sentence, or found doubtful."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.foundations.errors import JobError, naming, naming_rows
from calib.foundations.ranges import MOST_TARGETS, MOST_TOUCHED
from calib.foundations.words import counted, listed
from calib.identification.error_model import ErrorModel
from calib.identification.identify import matching
from calib.identification.initialisation.problem import initial_problem, refuse_unplaced
from calib.identification.observability import rank_findings
from calib.identification.relations import refuse_unrelated
from calib.identification.sanity import named
from calib.identification.targets import refuse_unmeasured, shapes
from calib.job.schema import Job, MeasurementsSection
from calib.job.tables import model_sigmas
from calib.machine.residual_model import joint_numbers
from calib.measurement.checks import Finding
from calib.measurement.conditions import refuse_lacking
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import ONLY_SETUP, Measurements
from calib.robot.joint_terms import weighed_at_zero
from calib.robot.robot import Robot

# Every level is a fit of its own rows, and another one of all rows, of base and tool, to judge it by. A table of few
# rows takes as long as one of a hundred, and so many joint terms as much again as all that is found without them.
_MOST_ROWS_OF_LEVELS, _MOST_TIMES, _FEWEST_OF_TABLE, _TERMS = 150_000, 20, 100, 50
# What to do about readings that count otherwise.
_AS_READ = "Correct the table, or take a URDF whose joints count as it does: calib init, with --zeros FILE, writes it."
# A closed loop is solved at every row, and one of several that move each other takes as long as all of them alone. So
# few as palletizers have may have any rows.
_MOST_ROWS_OF_LOOPS, _FEW_LOOPS = 30_000, 3


def refuse_levels(
    job: Job, model: ErrorModel, chosen: Sequence[Measurements], measured_nodes: Sequence[Measurements], path: Path
) -> None:
    """Refuse levels that name files which are not to be identified from, files that come twice, and what no level is.

    ``model``: what is free. ``chosen`` and ``measured_nodes``: the tables to identify from, and those of nodes.
    """
    files = [section.file for section in _identified(job)]
    nodes = [section.file for section in job.measurements if section.use == "nodes"]
    for i, level in enumerate(job.levels):
        residual = level.residual_model is not None
        if residual == bool(level.free) or (residual and i + 1 < len(job.levels)) or (residual and i == 0):
            raise JobError(
                f"{path}: levels[{i}]: needs either free parameters or, if it is the last of several levels, a "
                "residual_model."
            )
        named = level.measurements or ()
        for k, file in enumerate(named):
            if file in named[:k]:
                raise JobError(f"{path}: levels[{i}].measurements: {file!r} comes twice; its rows would count twice.")
            if file not in (nodes if residual else files):
                known = ", ".join(map(repr, nodes if residual else files)) or "none"
                kind = "nodes" if residual else "identify"
                # A Gaussian process needs no tables of its own, and takes those to identify from where it has none.
                gaussian = level.residual_model is not None and level.residual_model.kind == "gaussian_process"
                cure = "; leave the key out, and those to identify from are taken" if gaussian and not nodes else ""
                raise JobError(
                    f'{path}: levels[{i}].measurements: {file!r} has not use = "{kind}"; with it: {known}{cure}.'
                )
    rows = {section.file: len(data) for section, data in zip(_identified(job), chosen, strict=True)}
    own = [level.measurements or rows for level in job.levels if not level.residual_model]
    asked = sum(max(rows[file], _FEWEST_OF_TABLE) for files_of in own for file in (*files_of, *rows))
    bound = int(_MOST_ROWS_OF_LEVELS / (1.0 + len(model.terms) / _TERMS))
    if asked > (most := max(bound, _MOST_TIMES * sum(rows.values()))):
        beside = f" beside {counted(len(model.terms), 'joint term')}" if model.terms else ""
        raise JobError(
            f"{path}: levels: {counted(len(own), 'level')}, each with its judgement on {counted(len(rows), 'table')}, "
            f"take {asked} rows in all, where a table counts as {_FEWEST_OF_TABLE} at least; allowed are {most}"
            f"{beside}. Leave out levels, or put tables together."
        )
    if not nodes and any(level.residual_model and level.residual_model.kind == "grid" for level in job.levels):
        raise JobError(f'{path}: levels: no measurements have use = "nodes", and a residual grid is made of these.')
    if nodes and not any(level.residual_model for level in job.levels):
        raise JobError(f'{path}: measurements: {nodes[0]!r} has use = "nodes", and no level has a residual_model.')
    if job.levels and len(set(files)) < len(files):
        raise JobError(f"{path}: measurements: a file appears twice, so that levels cannot name one of the two.")
    if job.levels and job.solver.kind != "least_squares":
        raise JobError(f"{path}: solver.kind: {job.solver.kind!r} does not work in levels; leave one of them out.")
    _refuse_residual_model(job, model.robot, chosen, measured_nodes, path)


def _identified(job: Job) -> list[MeasurementsSection]:
    return [section for section in job.measurements if section.use == "identify"]


def refuse_unmatched(job: Job, model: ErrorModel, chosen: Sequence[Measurements], path: Path) -> None:
    """Refuse levels with a name or glob that matches no parameter, before any level is solved."""
    by_file = dict(zip((section.file for section in _identified(job)), chosen, strict=True))
    for i, level in enumerate(job.levels):
        if level.residual_model is None:
            sets = [by_file[file] for file in level.measurements or by_file]
            with naming(path, JobError):
                matching(initial_problem(model.within(sets), sets).parameters, level.free, f"levels[{i}].free")


def _refuse_residual_model(
    job: Job, robot: Robot, chosen: Sequence[Measurements], nodes: Sequence[Measurements], path: Path
) -> None:
    """Refuse a residual model of joints that are not read, of several tips, or of no positions."""
    section = job.levels[-1].residual_model if job.levels else None
    if section is None:
        return
    names = [reading.name for reading in robot.readings]
    where = f"{path}: levels[{len(job.levels) - 1}].residual_model"
    with naming(where, JobError):
        joint_numbers(names, names if section.joints is None else section.joints, section.frame)
    tips = sorted({data.tip or robot.tip for data in (*chosen, *nodes)})
    if len(tips) > 1:
        raise JobError(f"{where}: is of one tip, and the measurements are of several: {', '.join(map(repr, tips))}.")
    if not nodes and not with_positions(chosen):
        raise JobError(f"{where}: needs measurements of positions, and there are none.")


def with_positions(sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the tables from which a residual model learns where there are no nodes."""
    return tuple(data for data in sets if data.position is not None)


def refuse_unusable_rows(robot: Robot, model: ErrorModel, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse rows of any use, also those that only judge, at which the machine of a job cannot be evaluated.

    Raises JobError for too many rows of many closed loops, PoseError where one cannot be closed, MeasurementError where
    a table has no column that a joint term needs.
    """
    if len(robot.loops) > _FEW_LOOPS:
        rows, together = sum(len(end.readings) for data in sets for end in data.ends), robot.loops_together
        if rows > (most := _MOST_ROWS_OF_LOOPS // sum(n * n for n in together)):
            moving = f", of which {max(together)} move each other," if max(together) > 1 else ""
            raise JobError(
                f"{path}: robot.loop: the tables have {rows} rows; allowed beside {len(robot.loops)} closed "
                f"loops{moving} are {most}. Leave out rows, or loops that move nothing that is measured."
            )
    for data in sets:
        for end in data.ends:
            refuse_lacking(model.robot, end.conditions, data.where)
            if robot.loops:
                with naming_rows(data.where, data.lines):
                    robot.joint_positions(end.readings)


def refuse_unknown_names(job: Job, model: ErrorModel, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse tools and set-ups that no row has, and such of rows that are missing where the others are given."""
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    setups = tuple(dict.fromkeys(setup for data in sets for setup in data.setups))
    for what, given, there in (("tools", job.tools, tools), ("setups", job.setups, setups)):
        for name in given:
            if name not in there:
                raise JobError(
                    f"{path}: {what}: {name!r} is in no measurement; the measurements have "
                    f"{', '.join(map(repr, there))}."
                )
    for tool in tools:
        if job.tools and tool not in job.tools:
            raise JobError(f"{path}: tools: the tool {tool!r} of the measurements is missing.")
    with naming(path, JobError):
        refuse_unplaced(model, setups)
    if job.base is not None and ONLY_SETUP not in setups:
        raise JobError(
            f"{path}: base: a pose is given, and every measurement has a named set-up: "
            f"{', '.join(map(repr, setups))}; give it in [setups.NAME]."
        )


def found_from_held_out(
    model: ErrorModel, chosen: Sequence[Measurements], held_out: Sequence[Measurements]
) -> Iterator[Finding]:
    """Yield the tools and set-ups that only rows held out have."""
    tools = {tool for data in chosen for tool in data.tools}
    setups = {setup for data in chosen for setup in data.setups}
    for data in held_out:
        names = [("tool", name) for name in data.tools if name not in tools and model.tool != "fixed"]
        for name in data.setups:
            known = model.known_base(name)
            if name not in setups and (known is None or not known.fixed):
                names.append(("set-up", name))
        for what, name in names:
            yield Finding.warning(
                "found-from-held-out",
                f"{data.where}: the {what} {name!r} is in no table to identify from, so it is found from these "
                "held-out rows; where they are few, their errors look too small.",
            )


def relations_left_out(whole: ErrorModel, model: ErrorModel, path: Path) -> Iterator[Finding]:
    """Yield the relations of the ``whole`` job that its ``model`` of what is identified lacks."""
    for relation in whole.relations:
        if relation not in model.relations:
            a, b = map(repr, relation.targets)
            yield Finding.warning(
                "relation-left-out",
                f"{path}: relations: the known {relation.kind} of {a} and {b} is not used, as not both are in a "
                "table to identify from.",
            )


def weights_not_known(model: ErrorModel, sets: Sequence[Measurements]) -> Iterator[Finding]:
    """Yield tables that tell joints on which something hangs whose weight matters, and which the arm does not know."""
    if model.robot.weights is None or not model.robot.weights.bodies:
        return
    at_zero = weighed_at_zero(model.urdf_robot)
    for data in sets:
        if names := [name for name in data.unused if name in at_zero]:
            yield Finding.warning(
                "weighed-at-zero",
                f"{data.where}: the weight behind joint {', '.join(map(repr, names))} is taken as if the joint were at "
                "zero, although the table has its readings; name a link behind it in robot.links.",
            )


def cameras_at_one_place(sets: Sequence[Measurements]) -> Iterator[Finding]:
    """Yield targets, of cameras on the floor, and tools, of those on the tip, at which there are several cameras."""
    at: dict[tuple[str, str], dict[str, str]] = {}
    for data in sets:
        if data.camera is not None:
            is_tool = data.camera.camera_on == "tip"
            what, names, own = ("tool", data.tools, data.tool) if is_tool else ("target", data.targets, data.target)
            for k in np.unique(own):
                at.setdefault((what, names[k]), {}).setdefault(data.camera.name, data.where)
    for (what, name), cameras in at.items():
        if len(cameras) > 1:
            last, where = list(cameras.items())[-1]
            key = f'tool = "{last}"' if what == "tool" else f'targets = {{ {name} = "{last}" }}'
            yield Finding.warning(
                "cameras-at-one-place",
                f"cameras {listed(cameras)} are at one place, the {what} {name!r}: each camera is a {what} of its own; "
                f"write {key} for {where}.",
            )


def refuse_wrong_targets(job: Job, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse a plane that is said to be at a point, a point with a normal, what was not measured, and too many."""
    # Marks in photographs take less.
    touched = {target for data in sets if data.kind != "pixels" for target in data.seen_targets}
    if len(touched) > MOST_TOUCHED:
        raise JobError(
            f"{path}: measurements: the tables have {len(touched)} targets that are touched; allowed in a job are "
            f"{MOST_TOUCHED}. Leave rows out, or call calib.identify from Python, which takes {MOST_TARGETS}."
        )
    found = shapes(sets)
    with naming(path, JobError):
        refuse_unmeasured(job.targets, found)
    for name, target in job.targets.items():
        if not target.says_where:
            continue
        said = "point" if target.normal is None else "plane"
        # Boards and cameras have a position as points have.
        if found[name] not in (said, "frame" if said == "point" else said):
            raise JobError(f"{path}: targets.{name}: is given as a {said}, and was measured as a {found[name]}.")
    with naming(path, JobError):
        refuse_unrelated(job.relations, found)


def refuse_no_noise(job: Job, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse a model part of zero beside an instrument whose noise nobody stated: infinite weights."""
    for i, (section, data) in enumerate(zip(job.measurements, sets, strict=True)):
        keys = ("model_sigma", "model_sigma_angle")
        for key, sigma, quantity in zip(keys, model_sigmas(section), QUANTITIES[data.kind], strict=False):
            if sigma == 0.0 and not np.all(data.sigma[:, quantity.columns] > 0.0):
                raise JobError(
                    f"{path}: measurements[{i}].{key}: is zero, and the noise of the instrument is not given; "
                    "give one of them."
                )


def not_held_out(job: Job, hashes: Mapping[str, str], path: Path) -> list[Finding]:
    """Find tables that the model is both fitted to and judged by."""
    fitted = {hashes[section.file]: section.file for section in job.measurements if section.use == "identify"}
    return [
        Finding.warning(
            "not-held-out",
            f"{path}: measurements[{i}].file: {section.file!r} is {fitted[hashes[section.file]]!r} again, from which "
            "the parameters are identified; a validation with the same rows proves nothing.",
        )
        for i, section in enumerate(job.measurements)
        if section.use == "validate" and section.hold_out is None and hashes[section.file] in fitted
    ]


def signatures_of(model: ErrorModel, chosen: Sequence[Measurements], path: Path) -> tuple[Finding, ...]:
    """Return the typical mistake that the data show, if any; raises JobError where rows do not fit the robot."""
    with naming(path, JobError):
        found = named(model, chosen)
    return tuple(
        replace(one.finding, sentence=f"{one.finding.sentence} {_AS_READ}") if one.zeros else one.finding
        for one in found
    )


def findings_of_rank(model: ErrorModel, chosen: Sequence[Measurements], path: Path) -> tuple[Finding, ...]:
    """Return what the data cannot show of the model; raises JobError where rows do not fit the robot."""
    with naming(path, JobError):
        return rank_findings(model, chosen)
