"""What YAML may not hold, told by its events before anything is built: builders are recursive, and aliases multiply."""

from collections.abc import Callable, Iterable
from typing import Any

from calib.foundations.errors import CalibError
from calib.foundations.json_text import UnreadableError, unique_names
from calib.foundations.lazy import needed
from calib.foundations.words import shown

# Deeper than any file that we read; PyYAML's builder in C ends the process at some ten thousand.
_DEEPEST = 100


def read_yaml(text: str, where: str, error: type[CalibError], build: Callable[[Any, str, Any], Any]) -> Any:
    """Return what ``build`` makes of YAML, given the package pyyaml, the text and a loader.

    Raises ``error`` where the package is missing, the text is no YAML, or it holds what it may not.
    """
    with needed(error, f"{where}: YAML needs the package pyyaml", ": pip install 'urdf-calib[formats]'"):
        import yaml  # noqa: PLC0415 - an extra
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        if (wrong := trouble(yaml.parse(text, loader))) is None:
            return build(yaml, text, loader)
    except (yaml.YAMLError, RecursionError, ValueError, TypeError, KeyError, AttributeError) as e:
        twice = f": {e}" if isinstance(e, UnreadableError) else ""
        raise error(f"{where}: is no YAML that can be read{twice}.") from e
    raise error(f"{where}: {wrong}.")


def written(node: Any) -> Any:
    """Return what stands at a node of YAML, scalars as they are written: 017 is neither 15 nor a number of ours."""
    if node.id == "sequence":
        return [written(item) for item in node.value]
    if node.id == "mapping":
        return unique_names([(str(written(key)), written(value)) for key, value in node.value])
    kind = node.tag.rpartition(":")[2]
    if kind == "null":
        return None
    # YAML has a point in front of what is no number.
    return node.value.replace(".", "") if kind == "float" and node.value[-1:].isalpha() else node.value


def trouble(events: Iterable[Any], most: int | None = None) -> str | None:
    """Return what is wrong with YAML, given the events of its parser, as the end of a sentence; None for nothing.

    Wrong are aliases, nesting without end, names that are no scalars or come twice in one mapping, and more than
    ``most`` values. The events are those of PyYAML or of ruamel.yaml. Raises what their parser raises.
    """
    # Of every collection that is open: its names so far, None for a list; and whether a name comes next.
    names: list[set[str] | None] = []
    named: list[bool] = []
    for count, event in enumerate(events):
        kind = type(event).__name__
        if most is not None and count > most:
            return f"has more than {most} values"
        if kind == "AliasEvent":
            return "has anchors and aliases, which are not read"
        if kind in ("MappingEndEvent", "SequenceEndEvent"):
            names.pop()
            named.pop()
            continue
        if kind not in ("ScalarEvent", "MappingStartEvent", "SequenceStartEvent"):
            continue
        if names and (known := names[-1]) is not None:
            if named[-1]:
                if kind != "ScalarEvent":  # names of names of names double with each
                    return "has a list or a mapping as a name, which is not read"
                if event.value in known:
                    return f"is no YAML that can be read: it has {shown(event.value)} twice in one object"
                known.add(event.value)
            named[-1] = not named[-1]
        if kind != "ScalarEvent":
            names.append(set() if kind == "MappingStartEvent" else None)
            named.append(True)
            if len(names) > _DEEPEST:
                return "is nested too deep"
    return None
