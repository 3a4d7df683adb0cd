"""The npz files of residual models: what grids and Gaussian processes alike have in them."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, TypeVar, cast

import numpy as np
import numpy.typing as npt

from calib.foundations.errors import OutputError
from calib.foundations.files import read_bytes
from calib.foundations.units import DISPLAY_OF
from calib.machine.npz import LARGEST_FILE, NotReadableError, arrays_of
from calib.machine.residual_model import FRAMES, Frame
from calib.machine.run import refuse_other_run
from calib.robot.robot import Reading

# What every file begins with; others are the model's own.
HEAD = ("schema", "frame", "joints", "dimensions")
_SCHEMA = 1
_RUN = "run"  # in files of results
_SETUPS, _TOOLS = "setups", "tools"


def named(setups: Sequence[str], tools: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Return what a file tells of the set-ups and the tools of a residual model: nothing where there is but one."""
    return {key: np.array(names) for key, names in ((_SETUPS, setups), (_TOOLS, tools)) if names}


def residual_bytes(
    frame: Frame,
    joints: Sequence[int],
    readings: Sequence[tuple[str, str]],
    arrays: Mapping[str, npt.NDArray[Any]],
    run: str | None,
) -> bytes:
    """Return a residual model as an npz file: the head that :func:`head_of` reads, then its own ``arrays``."""
    head: dict[str, Any] = {
        "schema": _SCHEMA,
        "frame": frame,
        "joints": np.array(joints, np.int64),
        "dimensions": readings,
        **({} if run is None else {_RUN: run}),
    }
    buffer = io.BytesIO()
    np.savez(buffer, **head, **dict[str, Any](arrays))
    return buffer.getvalue()


class _OfReadings(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def readings(self) -> tuple[tuple[str, Literal["angle", "length"]], ...]: ...


_Residuals = TypeVar("_Residuals", bound=_OfReadings)


def load_residuals(
    path: str | Path,
    keys: Sequence[str],
    made: Callable[[Mapping[str, npt.NDArray[Any]]], _Residuals],
    names: tuple[str, str],
    robot_readings: Sequence[Reading] | None,
) -> _Residuals:
    """Read a residual model of these ``keys``. ``names``: what it is, and what it is of a robot, for messages."""
    data = read_bytes(Path(path), OutputError, LARGEST_FILE)
    try:
        arrays = arrays_of(data, keys, (_RUN, _SETUPS, _TOOLS))
        run = _run_in(arrays.pop(_RUN, None))
        setups, tools = (_names_in(arrays.pop(key, None), key) for key in (_SETUPS, _TOOLS))
        known = replace(made(arrays), setups=setups, tools=tools)
    except NotReadableError as e:
        raise OutputError(f"{path}: is not {names[0]} of this toolkit: {e}.") from e
    if robot_readings is not None and known.readings != tuple((r.name, r.dimension) for r in robot_readings):
        theirs, ours = (", ".join(name for name, _ in known.readings), ", ".join(r.name for r in robot_readings))
        raise OutputError(f"{path}: is {names[1]} a robot with the joints {theirs}, and this one has {ours}.")
    refuse_other_run(Path(path), run)
    # What follows a joint the file does not say, and the robot does.
    return known if robot_readings is None else replace(known, turning=tuple(r.turns for r in robot_readings))


def _run_in(array: npt.NDArray[Any] | None) -> str | None:
    """Return the run that a residual model names, if it does. Raises NotReadableError for what is no name."""
    if array is not None and (array.shape != () or array.dtype.kind != "U"):
        raise NotReadableError(f"{_RUN} has a wrong type")
    return None if array is None else str(array)


def _names_in(array: npt.NDArray[Any] | None, key: str) -> tuple[str, ...]:
    """Return the set-ups or tools that a residual model names. Raises NotReadableError for what are no names."""
    if array is not None and (array.ndim != 1 or array.dtype.kind != "U"):
        raise NotReadableError(f"{key} has a wrong type")
    return () if array is None else tuple(str(name) for name in array)


def head_of(
    arrays: Mapping[str, npt.NDArray[Any]], kinds: Mapping[str, str]
) -> tuple[Frame, tuple[tuple[str, Literal["angle", "length"]], ...], tuple[int, ...]]:
    """Return what every file of a residual model begins with: its frame, and names and dimensions of all joints.

    ``kinds``: of arrays beside those of the head that are no floating-point numbers, as numpy's letters. Raises
    NotReadableError for an array of another type, another schema, and a head that is none.
    """
    kinds = {"schema": "i", "frame": "U", "joints": "i", "dimensions": "U", **kinds}
    for key, array in arrays.items():
        if array.dtype.kind != kinds.get(key, "f"):
            raise NotReadableError(f"{key} has a wrong type")
    if arrays["schema"].shape != () or int(arrays["schema"]) != _SCHEMA:
        raise NotReadableError(f"its schema is not {_SCHEMA}")
    if arrays["frame"].shape != () or str(arrays["frame"]) not in FRAMES:
        raise NotReadableError(f"its frame is not one of {', '.join(FRAMES)}")
    table = arrays["dimensions"]
    if table.ndim != 2 or table.shape[1] != 2 or not np.isin(table[:, 1], list(DISPLAY_OF)).all():
        raise NotReadableError("its joints have no names and dimensions")
    readings = tuple((str(name), cast(Literal["angle", "length"], str(dimension))) for name, dimension in table)
    joints = arrays["joints"]
    numbers = tuple(int(j) for j in joints.ravel())
    if joints.ndim != 1 or not numbers or len(set(numbers)) < len(numbers) or not {*numbers} <= {*range(len(readings))}:
        raise NotReadableError("its joints are not different ones of the robot's")
    return cast(Frame, str(arrays["frame"])), readings, numbers
