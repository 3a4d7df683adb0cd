"""One sentence for what is wrong with a job: the first thing to mend, and where a key belongs."""

import json
import re
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from calib.foundations.words import near, shortened
from calib.job import schema
from calib.job.fields import as_toml

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)

# So alike are a word and its plural.
_NEARLY_SAME = 0.85

_HEADERS: dict[type[BaseModel], str] = {
    schema.Job: "",
    schema.AboutSection: "[about]",
    schema.RobotSection: "[robot]",
    schema.CouplingSection: "[[robot.coupling]]",
    schema.LoopSection: "[[robot.loop]]",
    schema.ErrorModelSection: "[error_model]",
    schema.PriorSection: "prior of [error_model]",
    schema.PayloadSection: "payload of [robot]",
    schema.FrameSection: "[base] or [tools.NAME]",
    schema.SolverSection: "[solver]",
    schema.SetupSection: "[setups.NAME]",
    schema.InstrumentSection: "[instruments.NAME]",
    schema.TargetSection: "[targets.NAME]",
    schema.RelationSection: "[[relations]]",
    schema.LevelSection: "[[levels]]",
    schema.MeasurementsSection: "[[measurements]]",
    schema.BoardSection: "a board.toml",
}


def validation_sentence(error: ValidationError, root: type[BaseModel] = schema.Job) -> str:
    """Return the first thing to mend: another schema explains all else, and unknown keys most missing ones."""

    def order(e: ErrorDetails) -> int:
        return 0 if e["loc"] == ("schema",) and e["type"] == "value_error" else 1 + (e["type"] != "extra_forbidden")

    first = min(error.errors(include_url=False), key=order)
    key, kind, value = dotted(first["loc"]), first["type"], first["input"]
    if kind == "extra_forbidden":
        *section, name = first["loc"]
        return f"{key}: is not a known key; {_hint(str(name), _section(section, root))}"
    if kind == "missing":
        return f"{key}: is missing."
    if kind == "value_error":
        return f"{key}: {first['ctx']['error']}"
    if kind == "literal_error":
        return f"{key}: {as_toml(value)} is not allowed; it must be {first['ctx']['expected']}."
    if kind == "too_short":
        return f"{key}: is empty."
    if kind == "tuple_type" and isinstance(value, dict):
        return f"{key}: is one section; write [[{key}]] with two brackets, once for each."
    if kind in ("model_type", "dict_type") and isinstance(value, tuple) and any(isinstance(v, dict) for v in value):
        return f"{key}: is a list of sections; write [{key}] with single brackets, once."
    expected = {
        "string_type": "a text",
        "float_type": "a number",
        "bool_type": "true or false",
        "finite_number": "a finite number",
        "tuple_type": "a list",
        "model_type": "a section with keys",
        "dict_type": "a section with keys",
    }
    return f"{key}: {as_toml(value)} is not {expected.get(kind, 'allowed')}."


def _hint(name: str, section: type[BaseModel]) -> str:
    """Return the end of the sentence about an unknown key: where it belongs, or which key is near."""
    known = _keys(section)
    homes = [header for other, header in _HEADERS.items() if name in _keys(other)]
    if homes:
        places = ["at the top of the file"] if "" in homes else []
        if sections := " or ".join(filter(None, homes)):
            places.append(f"in {sections}")
        likest = near(name, known, 1, _NEARLY_SAME)
        return f"it belongs {' or '.join(places)}" + (f", or did you mean {likest[0]!r}?" if likest else ".")
    if likest := near(name, known, 1):
        return f"did you mean {likest[0]!r}?"
    for other, header in _HEADERS.items():
        if likest := near(name, _keys(other), 1, 0.8):
            return f"did you mean {likest[0]!r} in {header}?" if header else f"did you mean {likest[0]!r}?"
    return f"allowed are {', '.join(known)}."


def _section(location: list[int | str], root: type[BaseModel]) -> type[BaseModel]:
    """Return the section at a location; indices and the user's own names stand between a field and its section."""
    section = root
    for part in location:
        field = section.model_fields.get(str(part))
        if field is not None:
            section = next(filter(_is_section, (field.annotation, *get_args(field.annotation))), section)
    return section


def _is_section(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _keys(section: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in section.model_fields.items()]


def dotted(location: tuple[int | str, ...]) -> str:
    """Return a location as a user writes it: ``measurements[0].sigma``, ``tools."left ball".position``."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = shortened(part) if _BARE_KEY.fullmatch(part) else json.dumps(shortened(part))
            text += f".{name}" if text else name
    return text
