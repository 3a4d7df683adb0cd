"""The error model: which parameters of a robot and its set-up are unknown."""

import difflib
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError
from calib.identification.machine import POSE, Frames, Layout
from calib.identification.parameters import Parameter, ParameterKind
from calib.robot import deviation
from calib.robot.robot import Robot

Selection = Literal["all", "none"] | Sequence[str]
BaseFreedom = Literal["pose", "fixed"]
ToolFreedom = Literal["pose", "position", "fixed"]


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """What is unknown about a robot and its set-up. Made by :func:`error_model`.

    ``offsets``: names of the moving joints whose zero offset is free. ``placements``: pairs (chain joint, component)
    that are free. ``base_pose`` (4, 4) and ``tool_poses`` are the values where base and tools are fixed.
    """

    robot: Robot
    offsets: tuple[str, ...]
    placements: tuple[tuple[str, str], ...]
    base: BaseFreedom
    tool: ToolFreedom
    prior_length: float | None = None
    prior_angle: float | None = None
    base_pose: Array = field(default_factory=lambda: read_only(np.eye(4)))
    tool_poses: Mapping[str, Array] = field(default_factory=dict)

    def parameters(self, tools: Sequence[str] = ("tool",)) -> tuple[Parameter, ...]:
        """Return the free parameters for measurements made with the named tools, in the order of the state."""
        layout = Layout(self.robot)
        number = {joint.name: i for i, joint in enumerate(self.robot.chain)}
        found: list[Parameter] = []

        def free(name: str, kind: ParameterKind, entry: int, *, length: bool) -> None:
            prior = (self.prior_length if length else self.prior_angle) if kind in ("offset", "placement") else None
            found.append(Parameter(name, "m" if length else "rad", kind, ((entry, 1.0),), prior))

        for joint, component in self.placements:
            entry = 6 * number[joint] + deviation.COMPONENTS.index(component)
            free(f"{joint}.{component}", "placement", entry, length=component.startswith("t"))
        for j, i in enumerate(self.robot.moving):
            moving = self.robot.chain[i]
            if moving.name in self.offsets:
                free(f"{moving.name}.offset", "offset", layout.offsets + j, length=moving.type == "prismatic")
        if self.base == "pose":
            for k, component in enumerate(POSE):
                free(f"base.{component}", "base", layout.base + k, length=k < 3)
        for t, tool in enumerate(tools):
            prefix = "tool" if tool == "tool" else f"tool.{tool}"
            for k, component in enumerate(POSE[: {"fixed": 0, "position": 3, "pose": 6}[self.tool]]):
                free(f"{prefix}.{component}", "tool", layout.tools + 6 * t + k, length=k < 3)
        names = [parameter.name for parameter in found]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise JobError(f"the parameter name {twice[0]!r} means two things: a joint may not be called base or tool.")
        return tuple(found)

    def given_frames(self, tools: Sequence[str]) -> Frames:
        """Return the frames as given: known where fixed, zero or the user's guess where free."""
        return Frames(self.base_pose, np.stack([self.tool_poses.get(tool, np.eye(4)) for tool in tools]))


def error_model(
    robot: Robot,
    *,
    offsets: Selection = "none",
    placements: Selection = "none",
    base: BaseFreedom = "pose",
    tool: ToolFreedom = "position",
    prior_length: float | None = None,
    prior_angle: float | None = None,
    base_pose: npt.ArrayLike | None = None,
    tool_poses: Mapping[str, npt.ArrayLike] | None = None,
) -> ErrorModel:
    """Say which parameters of ``robot`` are unknown.

    ``offsets``: "all" moving joints, "none", or names and globs of moving joints.
    ``placements``: "all" (every component of every moving joint), "none", or names and globs of joints, moving or
    fixed (``"wrist_*"``), or of single components (``"joint_3.rx"``, ``"*.tz"``). The motion along a joint's own axis
    is its offset and never also a placement.
    ``base``: pose of the base in the instrument's frame, free ("pose") or "fixed" at ``base_pose`` (4, 4).
    ``tool``: pose or point of each tool in the tip link, free or "fixed" at ``tool_poses[name]`` ((4, 4), or (3,) for
    a point); the only tool is called "tool". No start value is needed for what is free.
    ``prior_length`` (m) and ``prior_angle`` (rad): standard deviations of a prior on every parameter of the robot.

    Raises JobError when a name or glob matches nothing, or a value is not of its kind.
    """
    moving = [robot.chain[i] for i in robot.moving]
    chosen_offsets = _select(offsets, [joint.name for joint in moving], "offsets")
    every = [
        (joint.name, component)
        for joint in robot.chain
        for component in deviation.COMPONENTS
        if component != {"revolute": "rz", "prismatic": "tz", "fixed": None}[joint.type]
    ]
    names = [f"{joint}.{component}" for joint, component in every]
    if isinstance(placements, str):
        movers = {joint.name for joint in moving}
        chosen = {"all": [f"{j}.{c}" for j, c in every if j in movers], "none": []}.get(placements)
        if chosen is None:
            raise JobError(f'placements: {placements!r} is not "all", "none" or a list of joint names.')
    else:
        joints = {joint for joint, _ in every}
        # A joint's own name stands for its components; a joint name may itself hold dots.
        patterns = [p if fnmatch.filter(names, p) and p not in joints else f"{p}.*" for p in placements]
        chosen = _select(patterns, names, "placements")
    for name, value in (("prior length", prior_length), ("prior angle", prior_angle)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise JobError(f"{name}: {value!r} is not a positive number; leave it out for no prior.")
    for name, value_, allowed in (("base", base, ("pose", "fixed")), ("tool", tool, ("pose", "position", "fixed"))):
        if value_ not in allowed:
            raise JobError(f"{name}: {value_!r} is not one of {', '.join(allowed)}.")
    return ErrorModel(
        robot,
        tuple(chosen_offsets),
        tuple(pair for pair, name in zip(every, names, strict=True) if name in set(chosen)),
        base,
        tool,
        prior_length,
        prior_angle,
        read_only(np.eye(4)) if base_pose is None else _given_pose(base_pose, "base_pose"),
        {name: _given_pose(value, f"tool {name!r}") for name, value in (tool_poses or {}).items()},
    )


def _select(selection: Selection, names: Sequence[str], what: str) -> list[str]:
    if isinstance(selection, str):
        if selection not in ("all", "none"):
            raise JobError(f'{what}: {selection!r} is not "all", "none" or a list of names.')
        return list(names) if selection == "all" else []
    chosen: set[str] = set()
    for pattern in selection:
        found = fnmatch.filter(names, pattern)
        if not found:
            stem = pattern.removesuffix(".*")
            near = difflib.get_close_matches(stem, [*names, *(n.rpartition(".")[0] for n in names)], 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(names[:8])}, ..."
            raise JobError(f"{what}: {stem!r} matches no joint of the arm; {hint}")
        chosen.update(found)
    return [name for name in names if name in chosen]


def _given_pose(value: npt.ArrayLike, where: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape == (3,) and np.all(np.isfinite(array)):
        return read_only(rigid.translation(array))
    R = array[:3, :3] if array.shape == (4, 4) else None
    if R is None or not np.all(np.isfinite(array)) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
        raise JobError(f"{where}: needs a point (3,) in m or a rigid placement (4, 4).")
    return read_only(array)
