"""Text in XML, as the standard library's ``quoteattr`` has it, which loads a client of the web to be at hand."""

_ESCAPES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


def quoted(text: str) -> str:
    """Return text as the value of an attribute, with its quotes."""
    return f'"{text.translate(_ESCAPES)}"'
