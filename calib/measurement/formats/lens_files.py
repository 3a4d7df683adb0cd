"""Lenses as others write them: OpenCV's FileStorage, ROS's camera_info, Kalibr's camchain, all of them YAML."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calib.foundations.csv_text import text_of
from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.units import NUMBER
from calib.foundations.words import refuse_other, shown
from calib.measurement.formats.yaml_events import read_yaml, written
from calib.measurement.lens import BENT, RATIONAL, Lens

_LARGEST = 1_000_000
# What OpenCV writes and YAML does not know: its own header, and the tag of its matrices.
_HEADER, _TAG = re.compile(r"\A%YAML[: ]1\.\d\s*"), re.compile(r"!!opencv-matrix")
_WHOLE = re.compile(r"\+?[0-9]{1,9}")
_MATRIX = ("camera_matrix", "cameraMatrix", "CameraMatrix", "K", "k")
_BENT = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "d")
_MODELS = {"plumb_bob": BENT, "rational_polynomial": (*BENT, *RATIONAL), "radtan": BENT[:4]}


def read_lens(path: Path) -> tuple[Lens, tuple[int, int] | None]:
    """Return the lens that a YAML file states, and the size (w, h) of its images where it does.

    Raises JobError where it holds no lens, or one of a model that is not ours.
    """
    found = _yaml(path)
    if isinstance(cam := found.get("cam0"), Mapping):  # Kalibr: camera_model, intrinsics fu fv pu pv, resolution
        if cam.get("camera_model") != "pinhole" or cam.get("distortion_model") not in ("radtan", "none", None):
            raise JobError(
                f"{path}: cam0 is of the models {cam.get('camera_model')!r} and {cam.get('distortion_model')!r}; read "
                "are 'pinhole' and 'radtan'."
            )
        focal = _numbers(path, "intrinsics", cam.get("intrinsics"))
        if len(focal) != 4:
            raise JobError(f"{path}: intrinsics has {len(focal)} numbers; four are fu, fv, pu, pv.")
        bent = _numbers(path, "distortion_coeffs", cam.get("distortion_coeffs") or [])
        return Lens(*focal, **_bent(path, bent, BENT[:4])), _resolution(path, cam.get("resolution"))
    matrix = next((found[key] for key in _MATRIX if key in found), None)
    if matrix is None:
        raise JobError(f"{path}: holds no lens: neither camera_matrix of OpenCV or ROS, nor cam0 of Kalibr.")
    K = _numbers(path, "the camera matrix", matrix)
    if len(K) != 9:
        raise JobError(f"{path}: the camera matrix has {len(K)} numbers; it has 9.")
    if any((K[1], K[3], K[6], K[7])) or K[8] != 1.0:
        raise JobError(
            f"{path}: the camera matrix is {', '.join(f'{k:g}' for k in K)}; "
            "read is fx, 0, cx, 0, fy, cy, 0, 0, 1, row by row."
        )
    model = found.get("distortion_model", "plumb_bob")
    refuse_other(model, _MODELS, f"{path}: distortion_model")
    bent = _numbers(path, "the distortion", next((found[key] for key in _BENT if key in found), []))
    size = _size(path, {name: found.get(name) for name in ("image_width", "image_height")})
    names = (*BENT, *RATIONAL)
    return Lens(K[0], K[4], K[2], K[5], **_bent(path, bent, names)), size


def _yaml(path: Path) -> Mapping[str, Any]:
    text = text_of(read_bytes(path, JobError, _LARGEST), str(path), JobError).replace("\r\n", "\n")
    text = _TAG.sub("", _HEADER.sub("", text))
    found = read_yaml(text, str(path), JobError, _document)
    if not isinstance(found, Mapping):
        raise JobError(f"{path}: holds no lens: it is no mapping of names.")
    return found


def _document(yaml: Any, text: str, loader: Any) -> Any:
    """Return the document with its scalars as they are written: to YAML 1.1, 0240 would be 160 and 10:00 600."""
    node = yaml.compose(text, loader)
    return None if node is None else written(node)


def _numbers(path: Path, what: str, value: Any) -> list[float]:
    """Return numbers of a list, of rows, or of a matrix with data."""
    data = value.get("data") if isinstance(value, Mapping) else value
    rows: list[Any] = data if isinstance(data, list) else [None]
    flat = [_number(one) for row in rows for one in (row if isinstance(row, list) else [row])]
    if not all(map(math.isfinite, flat)):
        raise JobError(f"{path}: {what} is not a list of numbers.")
    return flat


def _number(value: Any) -> float:
    """Return a number of YAML, NaN for what is none."""
    return float(value) if isinstance(value, str) and NUMBER.fullmatch(value) else math.nan


def _bent(path: Path, values: list[float], names: tuple[str, ...]) -> dict[str, float]:
    # OpenCV has up to fourteen: thin prisms and a tilted sensor beside these.
    if any(values[len(names) :]):
        raise JobError(f"{path}: the distortion has {len(values)} numbers; read are {', '.join(names)}.")
    return dict(zip(names, values, strict=False))


def _resolution(path: Path, value: Any) -> tuple[int, int] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise JobError(f"{path}: resolution is no list of two numbers; these are width and height in pixels.")
    return _size(path, dict(zip(("the width of resolution", "the height of resolution"), value, strict=True)))


def _size(path: Path, sides: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the size of images, by what its two sides are called; None where it is not stated."""
    if None in sides.values():
        return None
    for name, value in sides.items():
        if not isinstance(value, str) or not _WHOLE.fullmatch(value) or int(value) == 0:
            said = shown(value) if isinstance(value, str) else "no number"
            raise JobError(f"{path}: {name} is {said}; allowed are whole numbers of pixels from 1.")
    width, height = (int(value) for value in sides.values())
    return width, height
