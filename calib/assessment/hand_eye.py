"""Hand-eye: where each camera is, how far its pixels are off where the marks are, and the lens that was found."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.sealing import sealed
from calib.identification.fit import Fit
from calib.identification.machine import POSE
from calib.identification.observations.pixels import marks_seen
from calib.measurement.instruments import Camera
from calib.measurement.lens import Lens
from calib.measurement.measurements import ONLY_TOOL, Measurements
from calib.measurement.optics import lens_at, lens_scalars
from calib.measurement.projection import project


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class HandEye:
    """Where a camera is: its pose (4, 4) in the link ``parent``, and how it sees.

    ``pose_sigmas`` (6,): standard deviations of its position along the axes of ``parent``, in m, and of its turn about
    its own, in rad; zero of what was given, nan of what is not identifiable, and where the base is free too.
    ``on_tip``: whether it is a tool; cameras on other links, and beside the arm, see boards that are. ``lens``: with
    ``sigmas`` (12,) of its numbers, zero of those that were given, nan of those that are not identifiable.
    ``distance``: of the marks, their median, in m.
    ``pixels``: two-dimensional rms of the residuals held out, or of those identified from, in px; ``across``: the same
    where the marks are, across the line of sight, in m.
    """

    camera: str
    parent: str
    pose: Array
    pose_sigmas: Array
    on_tip: bool
    lens: Lens
    sigmas: Array
    size: tuple[int, int] | None
    distance: float
    pixels: float
    across: float


def hand_eyes(fit: Fit, sets: Sequence[JudgedSet]) -> tuple[HandEye, ...]:
    """Return where the cameras are that the arm carries, or that stand beside it, judged by what is held out."""
    held_out = [one for one in sets if one.use == "validation"]
    by_camera: dict[tuple[str, str], list[JudgedSet]] = {}
    for one in held_out or sets:
        data = one.data
        if data.camera is not None:
            by_camera.setdefault((data.camera.name, _name(data)), []).append(one)
    return tuple(_hand_eye(fit, own) for own in by_camera.values())


def _name(data: Measurements) -> str:
    """Return the name of the first camera of a set: of a tool where the arm carries it, else of a target."""
    assert data.camera is not None, "asked of what cameras saw"
    on_tip = data.camera.camera_on == "tip"
    return str(data.tools[data.tool[0]] if on_tip else data.targets[data.target[0]])


def _hand_eye(fit: Fit, own: Sequence[JudgedSet]) -> HandEye:
    data = own[0].data
    camera = data.camera
    assert camera is not None, "asked of what cameras saw"
    on_tip, names = camera.camera_on == "tip", fit.measurements[0]
    frames = fit.machine.frames
    if on_tip:
        pose = frames.tools[names.tools.index(_name(data))] if _name(data) in names.tools else np.eye(4)
    else:
        at = names.targets.index(_name(data)) if _name(data) in names.targets else None
        pose = np.eye(4) if at is None else frames.targets[at]
    # On a link it is told in that, beside the arm in the instrument's frame.
    link = None if on_tip else data.link_of(int(data.target[0]))
    if not on_tip and link is None:
        pose = rigid.inverse(frames.base) @ pose
    lens, sigmas = lens_of(fit, camera)
    r2 = np.concatenate([np.sum(one.after**2, axis=1) for one in own])
    depth = np.concatenate([np.abs(marks_before_camera(fit, one.data)[1][:, 2]) for one in own])
    return HandEye(
        camera.name,
        (data.tip or fit.robot.tip) if on_tip else link or fit.robot.base,
        read_only(pose),
        read_only(_pose_sigmas(fit, _name(data), pose, on_tip=on_tip)),
        on_tip,
        lens,
        read_only(sigmas),
        camera.size,
        float(np.median(depth)),
        float(np.sqrt(np.mean(r2))),
        float(np.sqrt(np.mean(r2 * (depth / lens.fx) ** 2))),
    )


def _pose_sigmas(fit: Fit, name: str, pose: Array, *, on_tip: bool) -> Array:
    """Return standard deviations (6,) of a camera's pose: along the axes that it is told in, and about its own."""
    kind = "tool" if on_tip else "target"
    prefix = kind if on_tip and name == ONLY_TOOL else f"{kind}.{name}"
    names = {p.name: k for k, p in enumerate(fit.parameters) if p.kind == kind}
    free = [names.get(f"{prefix}.{component}") for component in POSE]
    found = [(i, k) for i, k in enumerate(free) if k is not None]
    if not found:
        return np.zeros(6)
    if not on_tip and any(p.kind == "base" for p in fit.parameters):
        return np.full(6, np.nan)
    covariance, (at, of) = np.zeros((6, 6)), np.transpose(found)
    covariance[np.ix_(at, at)] = fit.told_covariance(of)
    unknown = at[fit.unidentifiable[of]]
    covariance[unknown, unknown] = np.nan
    if not on_tip:  # a target's are along its own axes
        covariance[:3, :3] = pose[:3, :3] @ covariance[:3, :3] @ pose[:3, :3].T
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def lens_of(fit: Fit, camera: Camera) -> tuple[Lens, Array]:
    """Return the lens of a camera as a fit has it, and the sigmas (12,) of its numbers: zero where given."""
    scalars = {one.name: k for k, one in enumerate(fit.measurements[0].scalars)}
    names, sigma_of = lens_scalars(camera), dict(zip([p.name for p in fit.parameters], fit.sigmas, strict=True))
    values = {
        role: float(fit.machine.frames.scalars[scalars[one.name]]) for role, one in names.items() if one.name in scalars
    }
    sigmas = np.array([sigma_of.get(names[name].name, 0.0) if name in names else 0.0 for name in Lens._fields])
    return lens_at(camera, values), sigmas


def marks_before_camera(fit: Fit, data: Measurements) -> tuple[Array, Array]:
    """Return how boards are turned (N, 3, 3), and their marks (N, 3) in m, in the frames of the cameras."""
    return marks_seen(*_cameras_and_boards(fit, data), data.value[:, 2:])


def _cameras_and_boards(fit: Fit, data: Measurements) -> tuple[Array, Array]:
    """Return the poses (N, 4, 4) of cameras and of boards of rows, in the frame in which their targets are told."""
    camera = data.camera
    assert camera is not None, "asked of what cameras saw"
    tools = fit.tips_before_targets(data) @ fit.tools_of(data)
    known = {name: fit.machine.frames.targets[k] for k, name in enumerate(fit.measurements[0].targets)}
    targets = np.stack([known.get(name, np.eye(4)) for name in data.targets])[data.target]
    return (tools, targets) if camera.camera_on == "tip" else (targets, tools)


def marks_and_pixels(fit: Fit, data: Measurements) -> tuple[Array, Array]:
    """Return where marks (N, 3) of rows are, and what a pixel is there (N, 3, 2): m across the line of sight for 1 px.

    Both are in the frame in which the rows' targets are told; boards are as they were to be printed.
    """
    assert data.camera is not None, "asked of what cameras saw"
    cameras, boards = _cameras_and_boards(fit, data)
    seen = marks_seen(cameras, boards, data.value[:, 2:])[1]
    R = cameras[:, :3, :3]
    of_pixel = np.linalg.pinv(project(lens_of(fit, data.camera)[0], seen).by_point)
    return (R @ seen[:, :, None])[:, :, 0] + cameras[:, :3, 3], np.asarray(R @ of_pixel)
