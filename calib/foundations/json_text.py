"""JSON that anybody may have written: strict, and no two values under one name."""

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from calib.foundations.words import shortened, shown

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

_Model = TypeVar("_Model", bound="BaseModel")


class NotJsonError(ValueError):
    """What is wrong with a text: the end of a sentence."""


class UnreadableError(NotJsonError):
    """What is JSON, and cannot be read: a name twice in one object, a number too long. The end of a sentence."""


def document(contents: Mapping[str, Any]) -> str:
    """Return plain data as a JSON document of ours, schema 1: strict, which knows neither nan nor infinity."""
    return json.dumps({"schema": 1, **contents}, indent=2, allow_nan=False) + "\n"


def parse_json(source: bytes) -> Any:
    """Return the plain data of a JSON document in UTF-8.

    Raises NotJsonError for what is none: also for NaN and infinity, numbers beyond all doubles or of thousands of
    digits, a name that comes twice in one object, and endless nesting.
    """
    try:
        return json.loads(
            source.decode("utf-8-sig"),
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=whole_number,
            object_pairs_hook=unique_names,
        )
    except UnreadableError as e:
        raise NotJsonError(f"is not JSON that can be read: {e}") from e
    except NotJsonError:
        raise
    except RecursionError as e:
        raise NotJsonError("is not JSON that can be read: it is nested too deep") from e
    except ValueError as e:  # also of bytes that are no text
        raise NotJsonError("is not JSON, or is truncated") from e


def validated(model: type[_Model], source: bytes) -> _Model:
    """Return a JSON document as a model of pydantic, which by itself takes the last of two values under one name.

    Raises NotJsonError as :func:`parse_json`, and pydantic's ValidationError.
    """
    parse_json(source)
    return model.model_validate_json(source)


def first_wrong(error: "ValidationError") -> str:
    """Return where a document is not as its model has it, what stands there, and what is allowed: no whole sentence."""
    first = error.errors(include_url=False)[0]
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    place, value = place[1:101] or "its top level", first["input"]
    match first["type"]:
        case "json_invalid":
            return f"it is no JSON: {first['ctx']['error']}"
        case "missing":
            return f"{place} is missing"
        case "extra_forbidden":
            return f"{place} is not known"
        case "value_error":
            return f"{place}: {first['ctx']['error']}"
    allowed = first["msg"].replace("Input should", "it must")
    stands = "" if isinstance(value, dict | list | tuple) else f" is {shortened(json.dumps(value, default=str))};"
    return f"{place}{stands or ':'} {allowed[:1].lower()}{allowed[1:]}"


def _refuse_constant(name: str) -> NoReturn:
    raise NotJsonError(f"is not JSON, which has no {name}")


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise NotJsonError(f"is not JSON that can be read: {shown(number)} is not a finite number")
    return value


def whole_number(digits: str) -> int:
    """Return a whole number of JSON, as ``parse_int`` takes it. Raises UnreadableError."""
    try:
        return int(digits)
    except ValueError as e:  # Python converts some thousand digits, as the time grows with their square
        raise UnreadableError(f"it has a number of {len(digits)} digits") from e


def unique_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON, as ``object_pairs_hook`` takes it. Raises UnreadableError."""
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise UnreadableError(f"it has {shown(twice)} twice in one object")
    return found
