"""``model.json``: the calibrated machine, whole, for programs that want more than a URDF can hold."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import CalibError, OutputError
from calib.foundations.files import read_bytes, recover_folder
from calib.identification.fit import Fit
from calib.robot.load import load_robot
from calib.robot.robot import Deviations, Robot
from calib.robot.urdf import parse_urdf

MODEL_FILE = "model.json"
NOMINAL_FILE = "nominal.urdf"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class PoseEntry(_Strict):
    """A pose: position in m, quaternion in the order w, x, y, z."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]

    @classmethod
    def of(cls, T: Array) -> "PoseEntry":
        """Return the entry of a placement (4, 4)."""
        x, y, z = map(float, T[:3, 3])
        qw, qx, qy, qz = map(float, rigid.quaternion_of(T[:3, :3]))
        return cls(position=(x, y, z), quaternion=(qw, qx, qy, qz))

    @property
    def placement(self) -> Array:
        """The placement (4, 4)."""
        return rigid.placement(rigid.rotation_of_quaternion(np.array(self.quaternion)), np.array(self.position))


class JointEntry(_Strict):
    """A joint of the chain: ``deviation`` (tx, ty, tz, rx, ry, rz) in m and rad, ``offset`` in rad or m if it moves."""

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    deviation: tuple[float, float, float, float, float, float]
    offset: float | None = None


class CouplingEntry(_Strict):
    """Position of a moving joint = sum of multiples of readings + constant + its share of the offsets."""

    joint: str
    readings: dict[str, float]
    constant: float
    offsets: dict[str, float]


class ModelFile(_Strict):
    """Schema 1 of ``model.json``. Lengths in m, angles in rad."""

    schema_: Literal[1] = Field(1, alias="schema")
    urdf: str
    base_link: str
    tip: str
    joints: tuple[JointEntry, ...]
    transmission: tuple[CouplingEntry, ...]
    base: PoseEntry
    tools: dict[str, PoseEntry]


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedModel:
    """A calibrated machine read back from its folder. Made by :func:`load_model`.

    ``base`` (4, 4): the robot's base in the instrument's frame; ``tools``: poses (4, 4) in the tip link, by name.
    """

    robot: Robot
    deviations: Deviations
    base: Array
    tools: Mapping[str, Array]

    def tips(self, readings: Array) -> Array:
        """Return the placements (N, 4, 4) of the tip link in the base link at readings (N, nr), in rad and m."""
        return self.robot.tips(readings, self.deviations)

    def predict(self, readings: Array, tool: str = "tool") -> Array:
        """Return the placements (N, 4, 4) of a tool in the instrument's frame. Raises KeyError for an unknown tool."""
        return np.asarray(self.base @ self.tips(readings) @ self.tools[tool])


def model_file(fit: Fit) -> ModelFile:
    """Return the contents of ``model.json`` for a fit."""
    robot, machine = fit.model.robot, fit.machine
    names = [robot.chain[i].name for i in robot.moving]
    offsets = dict(zip(names, map(float, machine.deviations.offsets), strict=True))
    joints = tuple(
        JointEntry(name=joint.name, type=joint.type, deviation=_six(d), offset=offsets.get(joint.name))
        for joint, d in zip(robot.chain, machine.deviations.placements, strict=True)
    )
    readings = [reading.name for reading in robot.readings]
    transmission = tuple(
        CouplingEntry(
            joint=name,
            readings=_nonzero(readings, robot.coupling[j]),
            constant=float(robot.coupling_offset[j]),
            offsets=_nonzero(names, robot.offset_coupling[j]),
        )
        for j, name in enumerate(names)
    )
    tools = dict(zip(fit.measurements[0].tools, map(PoseEntry.of, machine.frames.tools), strict=True))
    return ModelFile(
        schema=1,
        urdf=NOMINAL_FILE,
        base_link=robot.base,
        tip=robot.tip,
        joints=joints,
        transmission=transmission,
        base=PoseEntry.of(machine.frames.base),
        tools=tools,
    )


def load_model(folder: str | Path) -> CalibratedModel:
    """Read the calibrated machine from the folder that ``calib calibrate`` wrote.

    Raises OutputError when the folder holds no readable model.
    """
    folder = Path(folder)
    recover_folder(folder)
    source = read_bytes(folder / MODEL_FILE, OutputError)
    try:
        model = ModelFile.model_validate(json.loads(source))
    except (ValidationError, ValueError, RecursionError) as e:
        first = e.errors()[0]["msg"] if isinstance(e, ValidationError) else str(e)
        raise OutputError(f"{folder / MODEL_FILE}: is not a model of this toolkit ({first}).") from e
    path = folder / Path(model.urdf).name
    try:
        robot = load_robot(parse_urdf(read_bytes(path, OutputError), str(path)), model.tip, model.base_link)
    except CalibError as e:
        raise OutputError(f"{folder}: the model's URDF cannot be used: {e}") from e
    by_name = {joint.name: joint for joint in model.joints}
    if [joint.name for joint in robot.chain] != list(by_name):
        raise OutputError(f"{folder / MODEL_FILE}: its joints are not those of {model.urdf}.")
    deviations = Deviations(
        read_only([by_name[joint.name].deviation for joint in robot.chain]),
        read_only([by_name[robot.chain[i].name].offset or 0.0 for i in robot.moving]),
    )
    return CalibratedModel(
        robot,
        deviations,
        read_only(model.base.placement),
        {name: read_only(tool.placement) for name, tool in model.tools.items()},
    )


def _six(d: Array) -> tuple[float, float, float, float, float, float]:
    a, b, c, e, f, g = map(float, d)
    return a, b, c, e, f, g


def _nonzero(names: list[str], row: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, row, strict=True) if value != 0.0}


def model_json(fit: Fit) -> str:
    """Return ``model.json`` of a fit as text."""
    contents: dict[str, Any] = model_file(fit).model_dump(by_alias=True)
    return json.dumps(contents, indent=2) + "\n"
