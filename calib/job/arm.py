"""An instrument that is a calibrated arm, as a job describes it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, MeasurementError, naming_rows
from calib.foundations.units import MM
from calib.foundations.words import listed, not_calibrated
from calib.job.schema import InstrumentSection
from calib.machine.calibrated import CalibratedMachine
from calib.machine.model_file import NOMINAL_FILE, load_machine, residual_file
from calib.machine.place import Place
from calib.machine.run import MODEL_FILE
from calib.machine.standing import Pivoted, place_of_touched, with_tool_point
from calib.machine.touching import TouchingArm
from calib.measurement.checks import Finding
from calib.measurement.conditions import refuse_lacking
from calib.measurement.measurements import ONLY_TOOL
from calib.measurement.touches import read_touches
from calib.positioner.pivot import pivot
from calib.robot.conditions import Conditions
from calib.robot.load import load_robot
from calib.robot.sources import EXAMPLE, resolve

# Touches of a pivot scatter by the stated sigma; three times as much tells that something moved.
_SCATTER = 3.0


class ReadArm(NamedTuple):
    """A touching arm as a job describes it.

    ``files``: what it was read from, by the name that the job gives it. ``findings``: doubts about the pivoting.
    ``tool``: the name of the tool, where it is one of the arm's. ``scatter`` (3, 3): the covariance of a tool point
    that was pivoted, by the noise of its touches, in m^2; ``pivoted``: these.
    """

    arm: TouchingArm
    files: Mapping[str, Path]
    findings: tuple[Finding, ...] = ()
    tool: str | None = None
    scatter: Array | None = None
    pivoted: Pivoted | None = None

    def place(self, touches: Sequence[tuple[Array, Conditions]]) -> Place | None:
        """Return what the arm's errors do to the place of what it touched; None where they are not known.

        ``touches``: readings (M, nr) of the arm there, and conditions.
        """
        if self.arm.machine.uncertainty is None:
            return None
        if self.tool is not None:
            return place_of_touched(self.arm.machine, self.tool, touches)
        scatter = np.zeros((3, 3)) if self.scatter is None else self.scatter
        arm = with_tool_point(self.arm.machine, self.arm.point, scatter, self.pivoted)
        return place_of_touched(arm, ONLY_TOOL, touches)


def read_arm(name: str, section: InstrumentSection, folder: Path) -> ReadArm:
    """Return the arm that an instrument of the job is.

    Raises CalibError when it cannot be read, has no such tool or set-up, does not say where it stands if that matters,
    or its pivoting does not show the tool point.
    """
    files: dict[str, Path] = {}
    if section.model is not None:
        model = _standing(load_machine(folder / section.model), section.setup, f"instruments.{name}")
        beside = residual_file(model.residual_model)
        parts = [MODEL_FILE, NOMINAL_FILE] + ([] if beside is None else [beside])
        files |= {f"{section.model}/{part}": folder / section.model / part for part in parts}
    else:
        assert section.urdf is not None, "the schema asks for one of both"
        urdf = resolve(section.urdf) if section.urdf.startswith(EXAMPLE) else folder / section.urdf
        robot = load_robot(urdf, section.tip)
        model = CalibratedMachine(robot, robot.no_deviations(), read_only(np.eye(4)), {})
        files[section.urdf] = urdf
    assert section.sigma is not None, "the schema asks for it"
    sigma = section.sigma.si
    arm = TouchingArm(model, read_only(np.zeros(3)), sigma)
    if section.tool is not None:
        if section.tool not in model.tools:
            known = ", ".join(map(repr, model.tools)) or "none"
            raise JobError(f"instruments.{name}.tool: {section.tool!r} is not a tool of the arm; it has {known}.")
        held = replace(arm, machine=model.of(section.tool), point=read_only(model.tools[section.tool][:3, 3]))
        return ReadArm(held, files, tool=section.tool)
    if section.point is not None:
        point = read_only([length.si for length in section.point])
        return ReadArm(replace(arm, point=point), files)
    return ReadArm(arm, files) if section.pivot is None else _pivoted(arm, files, section.pivot, folder)


def _standing(model: CalibratedMachine, setup: str | None, at: str) -> CalibratedMachine:
    """Return the arm as it stands where it touches, with the load that it has there."""
    if setup is None and model.sags_by_set_up:
        raise JobError(
            f"{at}: the arm sags by its loads in its set-ups, {listed(model.bases)}; say by setup which it is."
        )
    if setup is not None and setup not in model.bases:
        raise JobError(f"{at}.setup: {not_calibrated('set-up', setup, model.bases)}.")
    return model.at(setup)


def _pivoted(arm: TouchingArm, files: Mapping[str, Path], file: str, folder: Path) -> ReadArm:
    touches = read_touches(folder / file, arm.machine.robot)
    if touches.kind != "cone":
        raise MeasurementError(
            f"{touches.where}: is a {touches.kind} test; a pivot is one point, touched in many orientations."
        )
    refuse_lacking(arm.machine.robot, touches.conditions, touches.where)
    with naming_rows(touches.where, touches.lines):
        placements = arm.machine.tips(touches.readings, touches.conditions)
    found = pivot(placements, touches.words["target"])
    if found.rank < 3:
        raise MeasurementError(
            f"{touches.where}: the orientations turn about {'one axis only' if found.rank else 'no axis'}, and do not "
            "show where the tool point is along it; touch the point with the tool tilted in several ways."
        )
    findings: list[Finding] = []
    if found.noise > _SCATTER * arm.sigma > 0.0:
        findings.append(
            Finding.warning(
                "pivot-scatters",
                f"{touches.where}: the touches scatter by {found.noise / MM:.3g} mm per coordinate, and sigma says "
                f"{arm.sigma / MM:.3g} mm.",
            )
        )
    scatter = found.covariance[:3, :3]
    return ReadArm(
        replace(arm, point=found.tool_point),
        {**files, file: folder / file},
        tuple(findings),
        scatter=scatter,
        pivoted=Pivoted(touches.readings, touches.conditions, touches.words["target"]),
    )
