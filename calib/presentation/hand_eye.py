"""Hand-eye as people use it: a matrix, a quaternion, a line for ROS 2, a joint of a URDF, and ``camera_info``."""

from collections.abc import Sequence
from html import escape
from math import isnan
from typing import TYPE_CHECKING

import numpy as np

from calib.assessment.blame import Blame
from calib.assessment.hand_eye import HandEye
from calib.foundations import rigid
from calib.foundations.units import MM, MRAD
from calib.measurement.lens import RATIONAL
from calib.presentation.report.document import Prose, Row, Section, Sheet

if TYPE_CHECKING:
    from calib.identification.optics_choice import OpticsChoice

# The frame of OpenCV's camera: z forward, x to the right.
_OPTICAL = "optical_frame"


def hand_eye_section(found: Sequence[HandEye]) -> Section | None:
    """Return the section of a report about where cameras are; None where there is none."""
    if not found:
        return None
    blocks = [block for one in found for block in _blocks(one)]
    return Section("hand-eye", "Where the camera is", tuple(blocks))


def optics_section(found: "Sequence[OpticsChoice]") -> Section | None:
    """Return what was compared to choose how many numbers lens and board have; None where nothing was."""
    sheets = []
    for one in found:
        rows = []
        for k, candidate in enumerate(one.candidates):
            what = f"{candidate.shape}, {candidate.distortion} of distortion"
            held_out = "-" if candidate.held_out is None else f"{candidate.held_out:.4f}"
            rows.append(Row((what, f"{candidate.rms:.4f}", held_out), strong=k == one.chosen))
        sheets.append(
            Sheet.of(
                f"{one.camera} and {one.board}, {one.photographs} photographs",
                ("board and lens", ">rms [px]", ">held out [px]"),
                rows,
                "photographs alone, each with a pose of its own; held out by whole photographs; strong: what was taken",
            )
        )
    return Section("optics", "How many numbers lens and board have", tuple(sheets)) if sheets else None


def blame_section(found: Blame) -> Section:
    """Return what lens, print, arm and corners explain of the photographs held out."""
    rows = []
    for cause in found.causes:
        shown = ("-" if value is None else f"{value:.3f}" for value in (cause.alone, cause.beside))
        tool = "held" if cause.tool is None else f"{cause.tool / MM:.3f}"
        rows.append(Row((_CAUSES[cause.name], *shown, tool), strong=cause.name == found.named))
    sheet = Sheet.of(
        "What each explains",
        ("cause", ">alone [px]", ">beside others [px]", ">tool's uncertainty [mm]"),
        rows,
        f"of {found.whole:.3f} px of photographs held out, of which {found.left:.3f} px are left; photographs by "
        f"themselves, without the arm, leave {found.corners:.3f} px. The tool's uncertainty is "
        f"{found.tool / MM:.3f} mm in all; beside a cause stands the part that would go if it were known. What is held "
        "has no part in it. A lens that nobody gave is no cause: it has a part in the uncertainty alone",
        brief=True,
    )
    return Section("blame", "Which is to blame", (Prose((found.sentence, found.advice), brief=True), sheet))


_CAUSES = {
    "lens": "lens",
    "scale": "size of the print",
    "shape": "shape of the print",
    "arm": "arm",
}


def _blocks(one: HandEye) -> tuple[Sheet | Prose, ...]:
    x, y, z = one.pose[:3, 3]
    w, i, j, k = rigid.quaternion_of(one.pose[:3, :3])
    along, about = one.pose_sigmas[:3] / MM, one.pose_sigmas[3:] / MRAD
    sure = [
        (f"{what}, +- one sigma", f"{', '.join(map(_or_unknown, sigmas))} {unit}")
        for what, sigmas, unit in (
            ("position x, y, z", along, "mm"),
            ("turn about the camera's x, y, z", about, "mrad"),
        )
        if sigmas.any()
    ]
    rows: list[Row | tuple[str, ...]] = [
        ("position x, y, z", f"{x / MM:.3f}, {y / MM:.3f}, {z / MM:.3f} mm"),
        ("quaternion x, y, z, w", f"{i:.7f}, {j:.7f}, {k:.7f}, {w:.7f}"),
        ("roll, pitch, yaw", ", ".join(f"{a:.7f}" for a in rigid.rpy_of(one.pose[:3, :3])) + " rad"),
        *sure,
        ("distance of the marks", f"{one.distance / MM:.0f} mm"),
        Row(("error in the image", f"{one.pixels:.3f} px rms"), strong=True),
        Row(("error where the marks are", f"{one.across / MM:.3f} mm rms, across the line of sight"), strong=True),
        *(
            (name, f"{value:.6g}" + (" as given" if sigma == 0.0 else f" +- {_or_unknown(sigma, '.2g')}"))
            for name, value, sigma in zip(one.lens._fields, one.lens, one.sigmas, strict=True)
            if value != 0.0 or sigma != 0.0
        ),
    ]
    told = "z of the camera looks forward, x to the right"
    told += "; the pose goes with the calibrated arm, not with the nominal one" if one.on_tip else ""
    return (
        Sheet.of(f"{one.camera} in {one.parent}", ("what", "value"), rows, told),
        Prose(("The same for others: a matrix, ROS 2, a URDF, and ROS's camera_info.",)),
        Prose(tuple(line for text in others(one) for line in text.split("\n")), "code"),
    )


def _or_unknown(sigma: float, digits: str = ".3f") -> str:
    return "not identifiable" if isnan(sigma) else format(sigma, digits)


def others(one: HandEye) -> tuple[str, ...]:
    """Return hand-eye and lens in the words of others: a matrix, a command of ROS 2, a URDF joint, camera_info."""
    return matrix(one), static_transform(one), urdf_joint(one), camera_info(one)


def matrix(one: HandEye) -> str:
    """Return the pose as four lines of a matrix, in m."""
    return "\n".join(" ".join(f"{_zero(v):13.9f}" for v in row) for row in one.pose)


def static_transform(one: HandEye) -> str:
    """Return the command of ROS 2 that publishes the pose."""
    x, y, z = (f"{_zero(v):.7f}" for v in one.pose[:3, 3])
    w, i, j, k = (f"{_zero(v):.9f}" for v in rigid.quaternion_of(one.pose[:3, :3]))
    return (
        f"ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {i} --qy {j} --qz {k} --qw {w} "
        f"--frame-id {one.parent} --child-frame-id {one.camera}_{_OPTICAL}"
    )


def urdf_joint(one: HandEye) -> str:
    """Return link and joint of a URDF."""
    child = escape(f"{one.camera}_{_OPTICAL}", quote=True)
    xyz = " ".join(f"{_zero(v):.9g}" for v in one.pose[:3, 3])
    rpy = " ".join(f"{_zero(v):.9g}" for v in rigid.rpy_of(one.pose[:3, :3]))
    return (
        f'<link name="{child}"/>\n<joint name="{escape(one.camera, quote=True)}_joint" type="fixed">\n'
        f'  <parent link="{escape(one.parent, quote=True)}"/>\n  <child link="{child}"/>\n'
        f'  <origin xyz="{xyz}" rpy="{rpy}"/>\n</joint>'
    )


def camera_info(one: HandEye) -> str:
    """Return the lens as ROS's camera calibration files have it."""
    lens, rational = one.lens, any(getattr(one.lens, name) for name in RATIONAL)
    bent = lens[4:] if rational else lens[4:9]
    size = [] if one.size is None else [f"image_width: {one.size[0]}", f"image_height: {one.size[1]}"]
    K = (lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0)
    P = (lens.fx, 0.0, lens.cx, 0.0, 0.0, lens.fy, lens.cy, 0.0, 0.0, 0.0, 1.0, 0.0)
    R = np.eye(3).ravel().tolist()
    lines = [
        *size,
        f"camera_name: {one.camera}",
        *_matrix("camera_matrix", 3, K),
        f"distortion_model: {'rational_polynomial' if rational else 'plumb_bob'}",
        *_matrix("distortion_coefficients", 1, bent),
        *_matrix("rectification_matrix", 3, R),
        *_matrix("projection_matrix", 3, P),
    ]
    return "\n".join(lines)


def _matrix(name: str, rows: int, values: Sequence[float]) -> list[str]:
    data = ", ".join(f"{v:.9g}" for v in values)
    return [f"{name}:", f"  rows: {rows}", f"  cols: {len(values) // rows}", f"  data: [{data}]"]


def _zero(value: float) -> float:
    """Return a number without the sign of a zero."""
    return float(value) + 0.0 if abs(value) > 1e-15 else 0.0
