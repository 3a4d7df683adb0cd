"""``uncertainty.json``: what a calibrated machine knows of its own doubts, beside ``model.json``."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import OutputError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.json_text import NotJsonError, validated
from calib.foundations.linear import triangle
from calib.identification.machine import Layout
from calib.machine.run import Sha256, refuse_other_run
from calib.machine.uncertainty import CAUSES, LeftOut, NoiseLevel, OwnNoise, Uncertainty, Waves, WindUp
from calib.robot.joint_terms import foreign
from calib.robot.robot import Robot
from calib.robot.terms import JointTerm

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

UNCERTAINTY_FILE = "uncertainty.json"


# In m and rad, as model.json has it: beyond any machine. Of a closure determinant, in products of these.
_LARGEST, _LARGEST_DETERMINANT = 1e6, 1e12
_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_Size = Annotated[float, Field(ge=0.0, le=_LARGEST)]
# More than results have. What is done with them takes memory with their square, or for each configuration.
_MANY_COLUMNS = 1000
# As much as rounding adds to the model's part of a noise that has no other.
_ROUNDING = 1e-9


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("the least is above the greatest")
    return ends


_Range = Annotated[tuple[_Number, _Number], AfterValidator(_ordered)]


class Strict(BaseModel):
    """What a file of a machine holds: nothing that is not known, and no number that is none."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True, defer_build=True)


class NoiseEntry(Strict):
    """A noise level; ``degrees_of_freedom`` is null where nothing was estimated.

    Else it is 1 or more: what is estimated from less is no noise, and any error would be within it.
    """

    model: _Size
    total: _Size
    degrees_of_freedom: Annotated[float, Field(ge=1.0, le=1e9)] | None

    @model_validator(mode="after")
    def _is_no_less_than_its_part(self) -> "NoiseEntry":
        if self.model > self.total * (1.0 + _ROUNDING):
            raise ValueError(f"its model part, {self.model:g}, is above its total, {self.total:g}")
        return self

    @property
    def level(self) -> NoiseLevel:
        """The noise level."""
        freedom = float("inf") if self.degrees_of_freedom is None else self.degrees_of_freedom
        return NoiseLevel(self.model, self.total, freedom)


def _level_of(entry: NoiseEntry | None) -> NoiseLevel | None:
    """Return the noise level of an entry; None where there is none."""
    return None if entry is None else entry.level


class WavesEntry(Strict):
    """Errors that follow the readings, as :class:`calib.machine.uncertainty.Waves` has them."""

    # Readings are at most 1e4; of much shorter periods nothing is left of the phase but rounding.
    period: dict[str, Annotated[float, Field(ge=1e-6, le=_LARGEST)]]
    width: dict[str, Annotated[tuple[_Size, ...], Field(min_length=1, max_length=100)]]


class WindUpEntry(Strict):
    """Wind-up of one reading by one mass, as :class:`calib.machine.uncertainty.WindUp` has it."""

    reading: str
    body: str
    width: _Size

    @property
    def term(self) -> JointTerm:
        """The term of the robot that it would be."""
        return JointTerm(self.reading, "moment", body=self.body)


class OwnNoiseEntry(Strict):
    """The noise of one set-up with one tool, as :class:`calib.machine.uncertainty.OwnNoise` has it."""

    setup: str
    tool: str
    position: NoiseEntry | None
    orientation: NoiseEntry | None

    @property
    def noise(self) -> OwnNoise:
        """The noise."""
        return OwnNoise(self.setup, self.tool, _level_of(self.position), _level_of(self.orientation))


class UncertaintyFile(Strict):
    """Schema 3 of ``uncertainty.json``: as :class:`calib.machine.uncertainty.Uncertainty`, in m and rad.

    Schema 2 had neither ``wind_up`` nor ``left_out``: its waves are as large as their widths, each by itself. Schema 1
    had neither ``causes`` nor ``waves``: all of its factor is put down to the instrument. Rows of ``factor`` and
    ``null_basis``: six deviations of every joint of model.json, the offsets of those that move, then x, y, z, rx, ry,
    rz of the base, of the base in every other set-up, and of every tool.
    """

    schema_: Literal[1, 2, 3] = Field(alias="schema")
    run: Sha256 | None = None
    identified: dict[str, _Range]
    position: NoiseEntry | None
    orientation: NoiseEntry | None
    own_noise: tuple[OwnNoiseEntry, ...] = ()
    conditions: dict[Literal["temperature", "payload"], _Range] = Field(default_factory=dict)
    causes: dict[Literal["instrument", "parameters", "model"], Annotated[int, Field(ge=0)]] | None = None
    waves: WavesEntry | None = None
    wind_up: tuple[WindUpEntry, ...] = ()
    left_out: tuple[tuple[_Number, ...], ...] | None = None
    closure_determinant: Annotated[float, Field(ge=-_LARGEST_DETERMINANT, le=_LARGEST_DETERMINANT)] | None = None
    factor: tuple[tuple[_Number, ...], ...]
    null_basis: tuple[tuple[_Number, ...], ...]


def uncertainty_json(uncertainty: Uncertainty, robot: Robot, run: str | None = None) -> str:
    """Return ``uncertainty.json`` of a run's results as text, one line for every row of the matrices."""
    names, left_out = [reading.name for reading in robot.readings], uncertainty.left_out
    ranges = [(float(low), float(high)) for low, high in uncertainty.identified]
    entries = {
        "schema": 3,
        **({} if run is None else {"run": run}),
        "identified": dict(zip(names, ranges, strict=True)),
        "position": _plain(uncertainty.position),
        "orientation": _plain(uncertainty.orientation),
        **({"own_noise": own} if (own := [_plain_own(one) for one in uncertainty.own_noise]) else {}),
        **({"conditions": dict(uncertainty.conditions)} if uncertainty.conditions else {}),
        "causes": dict(zip(CAUSES, uncertainty.causes, strict=False)),
        "waves": None if left_out is None else _plain_waves(left_out.waves, names),
        "wind_up": [] if left_out is None else _plain_wind_up(left_out.wind_up),
        **({} if uncertainty.closure_determinant is None else {"closure_determinant": uncertainty.closure_determinant}),
    }
    lines = [f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in entries.items()]
    matrices = {"factor": uncertainty.factor, "null_basis": uncertainty.null_basis}
    for key, matrix in (matrices if left_out is None else matrices | {"left_out": left_out.root}).items():
        rows = ",\n".join(f"    {json.dumps(row, allow_nan=False)}" for row in matrix.tolist())
        lines.append(f"  {json.dumps(key)}: [\n{rows}\n  ]")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _plain(level: NoiseLevel | None) -> dict[str, float | None] | None:
    if level is None:
        return None
    freedom = None if np.isinf(level.degrees_of_freedom) else level.degrees_of_freedom
    return {**asdict(level), "degrees_of_freedom": freedom}


def _plain_own(one: OwnNoise) -> dict[str, object]:
    return one._asdict() | {"position": _plain(one.position), "orientation": _plain(one.orientation)}


def _plain_waves(waves: Waves, names: Sequence[str]) -> dict[str, object]:
    period, width = (dict(zip(names, values.tolist(), strict=True)) for values in (waves.period, waves.width))
    return {"period": period, "width": width}


def _plain_wind_up(wind_up: WindUp) -> list[dict[str, object]]:
    every = zip(wind_up.terms, wind_up.width.tolist(), strict=True)
    return [{"reading": term.reading, "body": term.body, "width": width} for term, width in every]


def _counts(causes: Mapping[Any, int]) -> tuple[int, int, int]:
    instrument, parameters, model = (causes.get(cause, 0) for cause in CAUSES[:3])
    return instrument, parameters, model


def _left_out(found: UncertaintyFile, waves: WavesEntry, robot: Robot, columns: int) -> LeftOut | None:
    """Return what is left out along the readings; None where it is not of this robot.

    Where the file does not say how it goes together it takes a column of the factor for each, of which there are
    ``columns``: one too many is enough to tell that they are too few, of tens of thousands that nobody wrote.
    """
    names, width = [reading.name for reading in robot.readings], _matrix(tuple(waves.width.values()))
    terms = tuple(entry.term for entry in found.wind_up)
    if not list(waves.period) == list(waves.width) == names or width is None or foreign(robot, terms):
        return None
    many = 2 * width.size + len(terms)
    root = read_only(np.eye(many, min(many, columns + 1))) if found.left_out is None else _matrix(found.left_out)
    if root is None or len(root) != many:
        return None
    wind_up = WindUp(terms, read_only([entry.width for entry in found.wind_up]))
    return LeftOut(Waves(read_only(list(waves.period.values())), width), wind_up, root)


def load_uncertainty(path: Path, robot: Robot, setups: int, tools: int) -> Uncertainty:
    """Read the uncertainty of the machine of ``model.json``, which has so many set-ups and tools.

    Raises OutputError when the file does not belong to it.
    """
    try:
        found = validated(UncertaintyFile, read_bytes(path, OutputError, LARGEST_JSON))
    except NotJsonError as e:
        raise OutputError(f"{path}: {e}.") from e
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))[:100] or "its start"
        raise OutputError(f"{path}: is not a file of this toolkit, or is damaged, at {place}{_why(first)}.") from e
    refuse_other_run(path, found.run)
    # Without it every wave would count as large as its width, as in a file of schema 2.
    if found.schema_ == 3 and found.waves is not None and found.left_out is None:
        raise OutputError(f"{path}: is not a file of this toolkit, or is damaged, at left_out.")
    size = Layout(robot, setups, tools).size
    names = [reading.name for reading in robot.readings]
    factor, null_basis = (_matrix(rows) for rows in (found.factor, found.null_basis))
    columns = 0 if factor is None else factor.shape[1]
    left_out = None if found.waves is None else _left_out(found, found.waves, robot, columns)
    if (
        list(found.identified) != names
        or (found.waves is not None and left_out is None)
        or factor is None
        or null_basis is None
        or not len(factor) == len(null_basis) == size
    ):
        raise OutputError(f"{path}: is not of the machine in model.json.")
    causes = (columns, 0, 0) if found.causes is None else _counts(found.causes)
    if sum(causes) != columns or (left_out is not None and left_out.columns > causes[2]):
        raise OutputError(f"{path}: is not a file of this toolkit, or is damaged, at causes.")
    return Uncertainty(
        *_narrowed(factor, causes, left_out),
        read_only(_narrow(null_basis)),
        _level_of(found.position),
        _level_of(found.orientation),
        read_only([found.identified[name] for name in names]),
        found.closure_determinant,
        tuple(entry.noise for entry in found.own_noise),
        {str(name): ends for name, ends in found.conditions.items()},
    )


def _narrowed(
    factor: Array, causes: tuple[int, int, int], left_out: LeftOut | None
) -> tuple[Array, tuple[int, int, int], LeftOut | None]:
    """Return the same covariances, of each cause by itself, in no more columns than they need where these are many."""
    if factor.shape[1] <= _MANY_COLUMNS:
        return factor, causes, left_out
    alone = factor.shape[1] - (0 if left_out is None else left_out.columns)
    *parts, own = np.split(factor, [causes[0], causes[0] + causes[1], alone], axis=1)
    parts = list(map(_narrow, parts))
    if left_out is not None:  # its columns and those of its root belong together
        both = _narrow(np.vstack([own, left_out.root]))
        own, left_out = both[: len(own)], left_out._replace(root=read_only(both[len(own) :]))
    instrument, parameters, model = (part.shape[1] for part in parts)
    return read_only(np.hstack([*parts, own])), (instrument, parameters, model + own.shape[1]), left_out


def _narrow(M: Array) -> Array:
    """Return a matrix with the same product with its own transpose; of very many columns as many as it has rows."""
    return M if M.shape[1] <= max(len(M), _MANY_COLUMNS) else triangle(M.T).T


def _why(error: "ErrorDetails") -> str:
    """Return what is wrong with a number, where it is one: the end of a sentence."""
    match error["type"]:
        case "greater_than_equal":
            return f": {error['input']:g} is below {error['ctx']['ge']:g}"
        case "less_than_equal":
            return f": {error['input']:g} is above {error['ctx']['le']:g}"
        case "value_error":
            return f": {error['ctx']['error']}"
    return ""


def _matrix(rows: tuple[tuple[float, ...], ...]) -> Array | None:
    """Return the rows as a matrix, or None when they are not equally long."""
    widths = {len(row) for row in rows}
    return read_only(np.array(rows, dtype=np.float64).reshape(len(rows), -1)) if len(widths) == 1 else None
