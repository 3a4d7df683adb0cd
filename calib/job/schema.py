"""The job file, schema 1: what a user may write, and one clear sentence for anything else."""

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.units import parse_quantity

_LARGEST_JOB = 1_000_000


def _length(text: str) -> str:
    parse_quantity(text, "length", "")
    return text


def _angle(text: str) -> str:
    parse_quantity(text, "angle", "")
    return text


Length = Annotated[str, AfterValidator(_length)]
Angle = Annotated[str, AfterValidator(_angle)]
Selection = Literal["all", "none"] | tuple[str, ...]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class RobotSection(_Section):
    """``[robot]``: the URDF, the links between which the arm is calibrated, and folders that hold its meshes."""

    urdf: str
    tip: str | None = None
    base: str | None = None
    mesh_roots: tuple[str, ...] = ()


class PriorSection(_Section):
    """``prior``: standard deviations that the robot's parameters are expected to have."""

    length: Length | None = None
    angle: Angle | None = None


class ErrorModelSection(_Section):
    """``[error_model]``: what is free."""

    offsets: Selection = "none"
    placements: Selection = "none"
    base: Literal["pose", "fixed"] = "pose"
    tool: Literal["pose", "position", "fixed"] = "position"
    prior: PriorSection = PriorSection()
    blind: Literal["nearest", "minimal", "refuse"] = "nearest"


class FrameSection(_Section):
    """``[base]`` or ``[tools.NAME]``: a known pose; the quaternion's order is w, x, y, z."""

    position: tuple[Length, Length, Length]
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


class InstrumentSection(_Section):
    """``[instruments.NAME]``: what measured. Sigmas are one standard deviation of each coordinate."""

    kind: Literal["laser_tracker"]
    sigma: Length
    sigma_per_metre: Length = "0 um"
    station: tuple[Length, Length, Length] = ("0 m", "0 m", "0 m")


class MeasurementsSection(_Section):
    """``[[measurements]]``: one table."""

    file: str
    observes: Literal["position", "pose"] = "position"
    sigma: Length | None = None
    sigma_angle: Angle | None = None
    instrument: str | None = None
    use: Literal["identify", "validate"] = "identify"
    model_sigma: Length | None = None
    model_sigma_angle: Angle | None = None
    columns: dict[str, str] = Field(default_factory=dict)


class Job(_Section):
    """A whole job."""

    schema_: Literal[1] = Field(alias="schema")
    robot: RobotSection
    error_model: ErrorModelSection = ErrorModelSection()
    base: FrameSection | None = None
    tools: dict[str, FrameSection] = Field(default_factory=dict)
    instruments: dict[str, InstrumentSection] = Field(default_factory=dict)
    measurements: tuple[MeasurementsSection, ...] = Field(min_length=1)


def read_job(path: Path) -> Job:
    """Read a job file. Raises JobError with the file, the key, the value and what is allowed."""
    source = read_bytes(path, JobError, _LARGEST_JOB)
    try:
        contents = tomllib.loads(source.decode("utf-8-sig"))
    except UnicodeDecodeError as e:
        raise JobError(f"{path}: is not UTF-8 text.") from e
    except (tomllib.TOMLDecodeError, RecursionError) as e:
        raise JobError(f"{path}: is not TOML: {e}.") from e
    return parse_job(contents, str(path))


def parse_job(contents: dict[str, Any], where: str) -> Job:
    """Return the job of a parsed TOML document. Raises JobError as :func:`read_job` does."""
    try:
        # TOML knows arrays; tuples are how a frozen job keeps them.
        job = Job.model_validate(_tuples(contents))
    except ValidationError as e:
        raise JobError(f"{where}: {_sentence(e, contents)}") from e
    for i, section in enumerate(job.measurements):
        if section.instrument is not None and section.instrument not in job.instruments:
            known = ", ".join(map(repr, job.instruments)) or "none"
            raise JobError(
                f"{where}: measurements[{i}].instrument: {section.instrument!r} is not declared; there are {known}."
            )
    if not any(section.use == "identify" for section in job.measurements):
        raise JobError(f'{where}: measurements: none has use = "identify"; there is nothing to identify from.')
    return job


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(v) for key, v in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _sentence(error: ValidationError, contents: dict[str, Any]) -> str:
    # Unknown keys first: they are the cause of most missing ones.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    # Pydantic names the branch of a union in the path; only the document's own keys mean something to its author.
    about_key = first["type"] in ("extra_forbidden", "missing")
    location = tuple(part for part in first["loc"] if about_key or _is_key(part, contents))
    name = _dotted(location)
    if first["type"] == "extra_forbidden":
        known = _fields(location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"allowed are {', '.join(known)}."
        return f"{name}: is not a known key; {hint}"
    if first["type"] == "missing":
        return f"{name}: is missing."
    expected = first.get("ctx", {}).get("expected")
    if expected is not None:
        return f"{name}: {first['input']!r} is not allowed; it must be {expected}."
    message = first["msg"].removeprefix("Value error, ").removeprefix(": ").rstrip(".")
    return f"{name}: {message[:1].lower()}{message[1:]}."


def _is_key(part: int | str, value: Any) -> bool:
    """Return whether ``part`` is an index or, somewhere in a document, a key."""
    if isinstance(part, int):
        return True
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return (isinstance(value, dict) and part in value) or any(_is_key(part, child) for child in children)


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _fields(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed in the section at a location."""
    section: type[BaseModel] = Job
    for part in location:
        if isinstance(part, int) or part not in section.model_fields:
            continue
        annotation = section.model_fields[part].annotation
        found = [a for a in (annotation, *get_args(annotation)) if isinstance(a, type) and issubclass(a, BaseModel)]
        section = found[0] if found else section
    return [field.alias or name for name, field in section.model_fields.items()]
