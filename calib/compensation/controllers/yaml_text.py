"""Plain YAML as every reader understands it; nothing is written but mappings, lists, words and numbers.

Written by hand, and read back by the same rules before a file is handed out; tests read it by PyYAML as well.
"""

import ast
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

Node: TypeAlias = "str | int | float | Mapping[str, Node] | Sequence[Node]"
_KEY = re.compile(r"[A-Za-z0-9_]+:")


def yaml_text(contents: Mapping[str, Node]) -> str:
    """Return a mapping as YAML in block style; lists of numbers stand on one line.

    Every double reads back equal by YAML 1.1 too, which takes 1e-05 for a word and wants 1.0e-05. Keys are plain words.
    """
    return "\n".join(_block(contents, 0)) + "\n"


def _block(node: Mapping[str, Node] | Sequence[Node], indent: int) -> list[str]:
    pad, lines = " " * indent, list[str]()
    if isinstance(node, Mapping):
        for key, value in node.items():
            if _is_flat(value):
                lines.append(f"{pad}{key}: {_flat(value)}")
            else:
                lines += [f"{pad}{key}:", *_block(value, indent + 2)]  # type: ignore[arg-type]
        return lines
    for value in node:
        inner = [f"{pad}  {_flat(value)}"] if _is_flat(value) else _block(value, indent + 2)  # type: ignore[arg-type]
        lines += [f"{pad}- {inner[0][indent + 2 :]}", *inner[1:]]
    return lines


def _is_flat(node: Node) -> bool:
    if isinstance(node, str | int | float) or not node:
        return True
    return not isinstance(node, Mapping) and all(isinstance(value, int | float) for value in node)


def _flat(node: Node) -> str:
    if isinstance(node, str):
        return _word(node)
    if isinstance(node, int):
        return str(node)
    if isinstance(node, float):
        return _number(node)
    return "{}" if isinstance(node, Mapping) else f"[{', '.join(map(_flat, node))}]"


def _number(value: float) -> str:
    assert np.isfinite(value), "a calibrated machine has finite numbers"
    mantissa, e, exponent = repr(float(value) + 0.0).partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{e}{exponent}"


def _word(text: str) -> str:
    # Bare, some words are numbers or truths in YAML 1.1 (yes, off, 1e3).
    kept = (c if c.isascii() and c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return f'"{"".join(kept)}"'


def read_yaml(text: str) -> dict[str, Any]:
    """Return what :func:`yaml_text` was given, tuples as lists; comments may stand on lines of their own."""
    found: dict[str, Any] = _read([line for line in text.splitlines() if not line.startswith("#")], 0)
    return found


def _read(lines: Sequence[str], indent: int) -> Any:
    starts = [n for n, line in enumerate(lines) if line[indent] != " "]
    parts = [lines[a:b] for a, b in zip(starts, [*starts[1:], len(lines)], strict=True)]
    if lines[0][indent:].startswith("- "):
        return [_read([part[0].replace("- ", "  ", 1), *part[1:]], indent + 2) for part in parts]
    if len(lines) == 1 and _KEY.match(lines[0], indent) is None:
        return ast.literal_eval(lines[0][indent:])
    contents: dict[str, Any] = {}
    for part in parts:
        key, _, rest = part[0][indent:].partition(":")
        contents[key] = ast.literal_eval(rest[1:]) if rest else _read(part[1:], indent + 2)
    return contents
