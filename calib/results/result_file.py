"""What is read back of ``result.json``."""

import os
from codecs import BOM_UTF8
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.assessment.metrics import Metrics
from calib.foundations.errors import OutputError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.folders import reading_folder
from calib.foundations.json_text import NotJsonError, first_wrong, validated
from calib.foundations.words import shown
from calib.machine.run import Sha256, refuse_other_run
from calib.presentation.sheets import SHOWN

# Of rows and parameters, and of errors in m, rad or px: beyond all results.
_MOST, _LARGEST = 10**9, 1e9
# Of a parameter read back, in SI units.
_LARGEST_VALUE = 1e6
RESULT_FILE = "result.json"


def _possible(found: Metrics) -> Metrics:
    sizes = (found.mean, found.rms, found.p95, found.max)
    if found.unit not in SHOWN or not 0 <= found.n <= _MOST or not all(0.0 <= size <= _LARGEST for size in sizes):
        raise ValueError("no errors of rows")
    return found


_Count = Annotated[int, Field(ge=0, le=_MOST)]
_ByQuantity = dict[str, Annotated[Metrics, AfterValidator(_possible)]]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, defer_build=True)


class CheckEntry(_Part):
    """A check of the verdict."""

    name: str
    passed: bool


class ParameterEntry(_Part):
    """A parameter, in SI units."""

    name: str
    value: float


class OutlierEntry(_Part):
    """A row, jump or group; ``told``: it is no accident."""

    told: bool


class ResultFile(_Part):
    """Some of a result; all else that it holds is passed over. ``metrics``: by use, when and quantity."""

    trusted: bool
    doubts: tuple[str, ...]
    checks: tuple[CheckEntry, ...]
    metrics: dict[str, dict[str, _ByQuantity]]
    rank: _Count
    parameters: tuple[ParameterEntry, ...]
    outliers: dict[str, tuple[OutlierEntry, ...]]
    versions: dict[str, Any]
    inputs: dict[str, str]
    run: Sha256 | None = None

    @model_validator(mode="after")
    def _has_no_doubts_where_it_is_trusted(self) -> "ResultFile":
        if self.trusted and self.doubts:
            raise ValueError("it is trusted, and has doubts")
        return self


def read_result(folder: Path) -> ResultFile:
    """Return what ``result.json`` of a folder of results says. Raises OutputError when it holds no readable one."""
    path = folder / RESULT_FILE
    with reading_folder(folder):
        source = read_bytes(path, OutputError, LARGEST_JSON)
        try:
            found = validated(ResultFile, source.removeprefix(BOM_UTF8))
        except NotJsonError as e:
            raise OutputError(f"{path}: {e}.") from e
        except ValidationError as e:
            raise OutputError(f"{path}: is not a result of this toolkit: {first_wrong(e)}.") from e
        refuse_other_run(path, found.run)
    return found


def doubted(*folders: Path) -> list[Path]:
    """Return those folders whose result is not to be trusted; one without a result says nothing of it."""
    judged = [folder for folder in dict.fromkeys(folders) if os.path.lexists(folder / RESULT_FILE)]
    return [folder for folder in judged if not read_result(folder).trusted]


def not_trusted(folder: Path) -> str:
    """Return what is said wherever a result is used that is not to be trusted."""
    return f"{folder} is not trusted: see its own report."


def doubts_of(folder: Path) -> list[str]:
    """Return what is to be said of a folder whose results are used: one sentence where they are not to be trusted."""
    return list(map(not_trusted, doubted(folder)))


def robot_errors(folder: Path) -> dict[str, float]:
    """Return the identified parameters of a robot, in SI units, from a folder of results.

    Raises OutputError when the folder holds no readable result.
    """
    found = {entry.name: entry.value for entry in read_result(folder).parameters}
    if wrong := [name for name, value in found.items() if not abs(value) <= _LARGEST_VALUE]:
        raise OutputError(
            f"{folder / RESULT_FILE}: the parameter {shown(wrong[0])} is not a number up to {_LARGEST_VALUE:g}."
        )
    of_set_up = ("base", "tool", "target", "length", "lens", "board", "clock")
    return {name: value for name, value in found.items() if name.partition(".")[0] not in of_set_up}
