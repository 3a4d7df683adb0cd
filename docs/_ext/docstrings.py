"""Docstrings and signatures as the site shows them, and the source of both left as a reader of the code likes them."""

import re
from typing import Any

from numpy.typing import ArrayLike
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation

from calib.foundations import arrays

# Longest first: one may be a part of another.
SHORT = sorted(
    (
        (stringify_annotation(annotation, mode), name)
        for mode in ("smart", "fully-qualified-except-typing")
        for name, annotation in {
            "ArrayLike": ArrayLike,
            "Array": arrays.Array,
            "BoolArray": arrays.BoolArray,
            "IntArray": arrays.IntArray,
        }.items()
    ),
    key=lambda pair: -len(pair[0]),
)

# A line that begins with the name of an argument, or several, and says what it is.
ARGUMENT = re.compile(r"``\w+``")


def literal_blocks(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Show what is indented in a docstring as it stands, code and formulas; begin a paragraph for every argument."""
    found: list[str] = []
    inside = False
    for k, line in enumerate(lines):
        begins = line.startswith("    ") and not inside and k > 0 and not lines[k - 1].strip()
        if begins:
            found += ["::", ""]
        if k > 0 and ARGUMENT.match(line) and lines[k - 1].endswith("."):
            found.append("")
        inside = begins or (inside and (not line.strip() or line.startswith("    ")))
        found.append(line if inside else plain_bars(line))
    lines[:] = found


def plain_bars(line: str) -> str:
    """Keep bars that are amounts, as in ``|x - c|``, from being taken for substitutions."""
    parts = line.split("``")
    return "``".join(part.replace("|", r"\|") if k % 2 == 0 else part for k, part in enumerate(parts))


def short_types(
    _app: Sphinx, what: str, _name: str, obj: Any, _options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Call types of arrays by their short names; what a function makes shows no arguments of its own."""
    if what == "class" and "Made by" in (obj.__doc__ or ""):
        return "", None
    said = [signature, returns]
    for long, short in SHORT:
        said = [text and text.replace(long, short) for text in said]
    return said[0], said[1]


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to autodoc."""
    app.connect("autodoc-process-docstring", literal_blocks)
    app.connect("autodoc-process-signature", short_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
