"""Lenses as others write them: OpenCV's FileStorage, ROS's camera_info, Kalibr's camchain, all YAML; NumPy's .npz."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calib.foundations.csv_text import text_of
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.units import NUMBER
from calib.foundations.words import refuse_other, shown
from calib.measurement.formats.arrays import held_in_npz
from calib.measurement.formats.yaml_events import read_yaml, written
from calib.measurement.lens import BENT, RATIONAL, Lens

_LARGEST = 1_000_000
# In bytes: no array of a lens is larger. A small archive unpacks to hundreds of millions of numbers, each to be a text.
_LARGEST_ARRAY = 10_000
# What OpenCV writes and YAML does not know: its own header, and the tag of its matrices.
_HEADER, _TAG = re.compile(r"\A%YAML[: ]1\.\d\s*"), re.compile(r"!!opencv-matrix")
# Keys that say how a lens is described, and models whose numbers would be taken for those of another.
_OF_A_MODEL = re.compile("(?i)model|type|projection")
_OTHER_MODEL = re.compile("(?i)fish.?eye|equidist|kannala|omni(?!.?vision)|double.?sphere|unified|scaramuzza")
_ARCHIVE = ".npz"
_WHOLE = re.compile(r"\+?[0-9]{1,9}")
_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K", "k", "mtx")
_BENT = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "dist_coeff",
    "distCoeffs",
    "D",
    "d",
    "dist",
)
# How many numbers of distortion OpenCV has; none where a lens has none.
_COUNTS = (0, 4, 5, 8, 12, 14)
# In the order of precedence: width and height of images.
_SIDES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_MODELS = {"plumb_bob": BENT, "rational_polynomial": (*BENT, *RATIONAL), "radtan": BENT[:4]}


def read_lens(path: Path) -> tuple[Lens, tuple[int, int] | None]:
    """Return the lens that a YAML file, or an .npz, states, and the size (w, h) of its images where it does.

    Raises JobError where it holds no lens, or one of a model that is not ours.
    """
    is_archive = path.suffix.lower() == _ARCHIVE
    found = _npz(path) if is_archive else _yaml(path)
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
        known = BENT[:4] if cam.get("distortion_model") == "radtan" else ()
        return Lens(*focal, **_bent(path, bent, known)), _resolution(path, cam.get("resolution"))
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
    _refuse_others(path, found)
    names: tuple[str, ...] = (*BENT, *RATIONAL)
    if (model := found.get("distortion_model")) is not None:
        refuse_other(str(model), _MODELS, f"{path}: distortion_model")
        names = _MODELS[model]
    # A lens without a distortion would be taken for one that has none.
    stated = next((key for key in _BENT if key in found), None)
    if stated is None:
        raise JobError(
            f"{path}: states no distortion; it is called {', '.join(_BENT)}: four zeros where the lens has none."
        )
    bent = _numbers(path, "the distortion", found[stated])
    if len(bent) not in _COUNTS:
        raise JobError(f"{path}: the distortion has {len(bent)} numbers; allowed are {', '.join(map(str, _COUNTS))}.")
    # cv2.calibrateCamera returns five or more to Python, and cv2.fisheye.calibrate four.
    if is_archive and model is None and len(bent) == len(BENT[:4]) and any(bent):
        raise JobError(
            f"{path}: the distortion has 4 numbers, as a fisheye's has, which is not read; if these are "
            f"{', '.join(BENT[:4])}, write a fifth one, 0, or distortion_model = 'plumb_bob' beside them."
        )
    sides = next((sides for sides in _SIDES if sides[0] in found), _SIDES[0])
    size = _size(path, {name: found.get(name) for name in sides})
    return Lens(K[0], K[4], K[2], K[5], **_bent(path, bent, names)), size


def _refuse_others(path: Path, found: Mapping[str, Any]) -> None:
    """Raise JobError for a lens of a fisheye, as OpenCV and others mark it, and where images are cut out or binned."""
    for key, value in found.items():
        # The model of a camera may also be what its maker calls it; of a distortion ours are known.
        of_model = key != "distortion_model" and _OF_A_MODEL.search(str(key))
        if of_model and isinstance(value, str) and _OTHER_MODEL.search(value):
            raise JobError(f"{path}: {shown(str(key))} is {shown(value)}, whose distortion is another and not read.")
    if found.get("fisheye_model", "0") not in ("0", "false"):
        raise JobError(f"{path}: fisheye_model: the lens is a fisheye, whose distortion is another and not read.")
    roi = found.get("roi")
    stated = [(name, found.get(name), ("0", "1")) for name in ("binning_x", "binning_y")]
    if isinstance(roi, Mapping):
        stated += [(f"roi.{name}", roi.get(name), ("0", "0")) for name in ("x_offset", "y_offset")]
    for name, value, whole in stated:
        if value is not None and value not in whole:
            raise JobError(
                f"{path}: {name} is {shown(str(value))}: the numbers are of the whole sensor, and images are of a part "
                "of it, or binned; allowed is 0. Write the lens as it is in the images."
            )


def _yaml(path: Path) -> Mapping[str, Any]:
    text = text_of(read_bytes(path, JobError, _LARGEST), str(path), JobError).replace("\r\n", "\n")
    text = _TAG.sub("", _HEADER.sub("", text))
    documents = read_yaml(text, str(path), JobError, _documents)
    if len(documents) > 1:  # rostopic echo ends a message with the line that would begin another one
        raise JobError(f"{path}: has {len(documents)} documents, with --- between them; keep one.")
    found = documents[0] if documents else None
    if not isinstance(found, Mapping):
        raise JobError(f"{path}: holds no lens: it is no mapping of names.")
    return found


def _npz(path: Path) -> Mapping[str, Any]:
    """Return the arrays of an archive by their names, in lists of numbers as they are written in YAML."""
    try:
        held = held_in_npz(read_bytes(path, JobError, _LARGEST), str(path))
    except MeasurementError as e:
        raise JobError(str(e)) from e
    return {
        name: _as_written(array.tolist())
        for name, array in held.items()
        if array is not None and array.ndim < 3 and array.nbytes <= _LARGEST_ARRAY
    }


def _as_written(value: Any) -> Any:
    return [_as_written(one) for one in value] if isinstance(value, list) else str(value)


def _documents(yaml: Any, text: str, loader: Any) -> list[Any]:
    """Return documents with their scalars as they are written: to YAML 1.1, 0240 would be 160 and 10:00 600."""
    every = [written(node) for node in yaml.compose_all(text, loader)]
    return [one for one in every if one is not None]


def _numbers(path: Path, what: str, value: Any) -> list[float]:
    """Return numbers of a list, of rows, or of a matrix with data."""
    data = value.get("data") if isinstance(value, Mapping) else value
    rows: list[Any] = data if isinstance(data, list) else [None]
    if len({len(row) if isinstance(row, list) else 0 for row in rows}) > 1:
        raise JobError(f"{path}: {what} has rows that are not equally long.")
    flat = [_number(one) for row in rows for one in (row if isinstance(row, list) else [row])]
    if not all(map(math.isfinite, flat)):
        raise JobError(f"{path}: {what} is not a list of numbers.")
    if isinstance(value, Mapping):
        sides = [str(value.get(name)) for name in ("rows", "cols")]
        if all(map(_WHOLE.fullmatch, sides)) and math.prod(map(int, sides)) != len(flat):
            raise JobError(f"{path}: {what} has {len(flat)} numbers, and says that it has {' x '.join(sides)}.")
    return flat


def _number(value: Any) -> float:
    """Return a number of YAML, NaN for what is none."""
    return float(value) if isinstance(value, str) and NUMBER.fullmatch(value) else math.nan


def _bent(path: Path, values: list[float], names: tuple[str, ...]) -> dict[str, float]:
    # OpenCV has up to fourteen: thin prisms and a tilted sensor beside these.
    if any(values[len(names) :]):
        raise JobError(f"{path}: the distortion has {len(values)} numbers; read are {', '.join(names) or 'none'}.")
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
