"""XML in, by one reader with one set of guards, and text in XML out.

The reader is expat; what a robot or a mesh has no need of and an attacker has (document types with their entities,
exotic encodings, endless nesting) is refused before anything is made of it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NoReturn
from xml.parsers import expat

from calib.foundations.words import shortened, shown

DEEPEST = 100
NOT_EXPANDED = "is not expanded; run xacro first and use the URDF that it prints, or let calib init --xacro run it."
# cp1252 reaches expat through Python, the others are its own; all of them are ASCII in tags and numbers.
_ENCODINGS = ("UTF-8", "UTF8", "UTF-16", "ISO-8859-1", "US-ASCII", "ASCII", "WINDOWS-1252")
# As the standard library's ``quoteattr``, which loads a client of the web to be at hand.
_ESCAPES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


class NotXmlError(ValueError):
    """Bytes that are no XML, or XML that is not read. ``line``: where; the text is a sentence about it."""

    def __init__(self, line: int, what: str) -> None:
        super().__init__(what)
        self.line = line


@dataclass(frozen=True, slots=True)
class Element:
    """An XML element with the line and the byte where its start tag begins.

    ``end`` is the byte after its start tag when it is empty (``<a/>``), else the byte where its end tag begins.
    ``text``: what stands in it outside its children, where texts are read.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int
    end: int
    children: tuple["Element", ...]
    text: str = ""

    def all(self, tag: str) -> list["Element"]:
        """Return the children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def descendants(self) -> Iterator["Element"]:
        """Yield the element and all below it, in the order of the document."""
        yield self
        for child in self.children:
            yield from child.descendants()


def read_xml(source: bytes, generations: int = DEEPEST, *, texts: bool = False) -> Element:
    """Return the outermost element of an XML document with so many ``generations`` below it.

    ``texts``: with the text in the elements. Raises NotXmlError for what is not XML, and for document types, other
    encodings than the usual ones, nesting beyond 100 and unexpanded xacro.
    """
    builder = _Builder(generations)
    if texts:
        builder.parser.CharacterDataHandler = builder.text
    try:
        builder.parser.Parse(source, True)
    except expat.ExpatError as e:
        raise NotXmlError(e.lineno, f"is not well-formed XML ({expat.ErrorString(e.code)}).") from e
    return builder.root


class _Builder:
    """Expat's handlers: a stack of open elements, closed into frozen ones."""

    def __init__(self, generations: int) -> None:
        self.deepest = generations + 1
        self.root: Element
        self.depth = 0
        self.xacro = {"xacro"}  # prefixes of xacro's elements: a document may choose another
        self.open: list[tuple[str, dict[str, str], int, int, list[Element], list[str]]] = []
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.XmlDeclHandler = self.declaration
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end

    def refuse(self, what: str) -> NoReturn:
        raise NotXmlError(self.parser.CurrentLineNumber, what)

    def declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        # Any other would be looked up among Python's codecs, which are more than character sets.
        if encoding is not None and encoding.upper() not in _ENCODINGS:
            self.refuse(f"the encoding {shown(encoding)} is not one that is read; save the file as UTF-8.")

    def doctype(self, *_: object) -> None:
        # Without a document type there are no entities, hence no bombs and nothing external.
        self.refuse("a DOCTYPE is not allowed; remove it.")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            self.refuse(f"elements are nested more than {DEEPEST} deep.")
        for name, value in attributes.items():
            if name.startswith("xmlns:") and value.endswith("/xacro"):
                self.xacro.add(name.removeprefix("xmlns:"))
        if ":" in tag and tag.partition(":")[0] in self.xacro:
            self.refuse(f"<{shortened(tag)}> {NOT_EXPANDED}")
        if self.depth <= self.deepest:
            place = self.parser.CurrentLineNumber, self.parser.CurrentByteIndex
            self.open.append((tag, attributes, *place, [], []))

    def text(self, text: str) -> None:
        if self.depth <= self.deepest:
            self.open[-1][-1].append(text)

    def end(self, _tag: str) -> None:
        self.depth -= 1
        if self.depth >= self.deepest:
            return
        tag, attributes, line, start, children, texts = self.open.pop()
        end = self.parser.CurrentByteIndex
        element = Element(tag, attributes, line, start, end, tuple(children), "".join(texts))
        if self.open:
            self.open[-1][-2].append(element)
        else:
            self.root = element


def quoted(text: str) -> str:
    """Return text as the value of an attribute, with its quotes."""
    return f'"{text.translate(_ESCAPES)}"'
