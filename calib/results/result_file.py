"""What is read back of ``result.json``."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from calib.assessment.metrics import Metrics
from calib.presentation.sheets import SHOWN

# Of rows and parameters, and of errors in m, rad or px: beyond all results.
_MOST, _LARGEST = 10**9, 1e9


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
    run: str | None = None

    @model_validator(mode="after")
    def _has_no_doubts_where_it_is_trusted(self) -> "ResultFile":
        if self.trusted and self.doubts:
            raise ValueError("it is trusted, and has doubts")
        return self
