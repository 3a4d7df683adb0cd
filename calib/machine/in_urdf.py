"""The best machine that a URDF can hold: geometry fitted without what it has no place for.

Geometry that was fitted together with joint terms or closed loops leans on them, and is worse without them than
geometry that was fitted alone.
"""

from collections.abc import Sequence
from dataclasses import replace
from glob import escape
from pathlib import Path

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.errors import OutputError
from calib.foundations.files import read_bytes, write_atomically
from calib.identification.error_model import ErrorModel, with_terms
from calib.identification.fit import Fit
from calib.identification.identify import identify
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.machine.calibrated import CalibratedMachine
from calib.machine.of_fit import assembled
from calib.machine.urdf import calibrated_urdf
from calib.measurement.measurements import Measurements
from calib.robot.load import robot_in_urdf
from calib.robot.robot import Robot


def machine_in_urdf(fit: Fit, whole: CalibratedMachine) -> CalibratedMachine:
    """Return the machine of what :func:`fit_in_urdf` has found; nothing is said of its uncertainty.

    Of set-ups and tools it has those of the ``whole`` machine: the tables of earlier levels may have others.
    """
    found = assembled(fit).at(whole.setup)
    return replace(
        found,
        tools={name: found.tools[name] for name in whole.tools},
        others={name: found.others[name] for name in whole.others},
        tool_tips={name: tip for name, tip in found.tool_tips.items() if name in whole.tools},
    )


def fit_in_urdf(fit: Fit, tables: Sequence[Measurements] | None = None) -> Fit | None:
    """Return the fit of what a URDF holds, by rows of ``tables`` or those of ``fit``; None where that is ``fit``.

    Free is what ``fit`` has moved, with base and tools; where that is nothing, it is the nominal arm. Joints that
    closed loops have placed follow their ``<mimic>``, with an offset each; where a reader of the URDF would take other
    readings, loops and couplings stay. Raises what :func:`calib.identify` raises.
    """
    robot = fit.robot
    looped = bool(robot.loops or robot.couplings)
    plain = robot_in_urdf(robot) if looped and fit.model.dh is None else None
    if plain is None and not robot.terms:
        return None
    own = fit.measurements if tables is None else tuple(tables)
    model = (with_terms(fit.model, ()) if plain is None else _moved_to(fit.model, plain)).within(own)
    problem = initial_problem(model, own)
    moved = _moved(fit)
    placed = {f"{robot.chain[robot.moving[j]].name}.offset" for j in robot.passive} if plain is not None else set()
    free = [
        parameter.name
        for parameter in problem.parameters
        if not parameter.of_robot or parameter.name in moved or parameter.name in placed
    ]
    targets, setups = fit.model.targets, fit.model.setups
    if not free:  # joint terms alone, of an arm whose base and tool are known: nothing of it has a place in a URDF
        machine = replace(problem, parameters=()).machine(np.empty(0))
        model = replace(model, targets=targets, setups=setups)
        return replace(fit, model=model, measurements=problem.measurements, machine=machine, nominal=machine)
    losses = {data.where: loss for data, loss in zip(fit.measurements, fit.losses, strict=True)}
    found = identify(
        model,
        own,
        free=[escape(name) for name in free],
        null_space="nearest" if fit.policy == "refuse" else fit.policy,
        losses=[losses.get(data.where, "linear") for data in own],
    )
    return replace(found, model=replace(found.model, targets=targets, setups=setups))


@checked
def write_urdf(fit: Fit, path: str | Path) -> None:
    """Write the calibrated URDF of a fit; never over the nominal one.

    A fit with joint terms or closed loops is repeated without them: a URDF has no place for them, and the geometry that
    was fitted with them would be worse without them than a geometry that was fitted alone.
    Raises OutputError when the file cannot be written or is the nominal URDF.
    """
    path, held = Path(path), fit_in_urdf(fit) or fit
    robot = held.robot
    try:
        there = read_bytes(path, OutputError, len(robot.urdf.source))
    except OutputError:  # nothing there, or another file; any other reason shows when it is written
        there = b""
    if there == robot.urdf.source:
        raise OutputError(f"{path}: holds the nominal URDF, which is never overwritten; choose another name.")
    write_atomically(path, calibrated_urdf(robot, held.deviations))


def _moved(fit: Fit) -> set[str]:
    """Return the names of parameters that a fit has found, or holds at what an earlier level has found."""
    known = fit.model.parameters(fit.measurements[0].tools, fit.measurements[0].setups)
    values = values_at(fit.model.robot, known, fit.machine.frames, fit.machine.deviations)
    earlier = {parameter.name for parameter, value in zip(known, values, strict=True) if value != 0.0}
    return earlier | {parameter.name for parameter in (*fit.parameters, *fit.held)}


def _moved_to(model: ErrorModel, plain: Robot) -> ErrorModel:
    """Return a model of the robot that its URDF alone makes, with as much freedom."""
    there = {joint.name for joint in plain.chain}
    passive = {model.robot.chain[model.robot.moving[j]].name for j in model.robot.passive}
    free = {*model.offsets, *(passive if model.offsets or model.placements else ())}
    return replace(
        model,
        robot=plain,
        offsets=tuple(plain.chain[i].name for i in plain.moving if plain.chain[i].name in free),
        placements=tuple(pair for pair in model.placements if pair[0] in there),
        terms=(),
    )
