"""Other people's words in messages: quoted, cut, and the known ones that are near."""

import difflib
from collections.abc import Collection, Iterable, Sequence
from unicodedata import is_normalized, normalize

from calib.foundations.errors import CalibError, JobError

LONGEST_SHOWN = 60
# Characters that turn round what follows them, numbers as well: embeddings, overrides and isolates of directions.
_TURNING = {code: f"\\u{code:04x}" for code in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))}
# Controls, but for tabs and line ends: a terminal obeys those that begin with ESC or CSI.
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\t\n"}
_COMMANDING = _TURNING | _CONTROLS
_LINE_ENDS = {9: "\\t", 10: "\\n", 0x2028: "\\u2028", 0x2029: "\\u2029"}
# Likeness takes time with the square of the length, and is asked of every known word.
_LONGEST_COMPARED = 100
_MOST_COMPARED = 1000


def shortened(text: str) -> str:
    """Return ``text``, cut after 60 characters, so that a message stays one line."""
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."


def shown(text: str) -> str:
    """Return a user's text as a message quotes it."""
    return repr(shortened(text))


def counted(count: int, one: str, several: str = "") -> str:
    """Return how many there are: "1 row", "2 rows". ``several``: where it is not ``one`` with s."""
    return f"{count} {noun(count, one, several)}"


def noun(count: int, one: str, several: str = "") -> str:
    """Return the word for so many, as :func:`counted` has it behind the number."""
    return one if count == 1 else several or one + "s"


def first_of(texts: Sequence[str], most: int = 12, more: str = "{} more") -> list[str]:
    """Return the first texts, and last how many ``more`` there are."""
    left = len(texts) - most
    return list(texts) if left <= 0 else [*texts[:most], more.format(left)]


def listed(names: Collection[str], most: int = 12) -> str:
    """Return the first names, quoted, and how many more there are."""
    first = list(names)[:most]
    more = f" and {len(names) - len(first)} more" if len(names) > len(first) else ""
    return ", ".join(map(shown, first)) + more


def not_calibrated(what: str, name: str, calibrated: Collection[str]) -> str:
    """Return the sentence, without its full stop, about a tool or set-up that is not one of those calibrated."""
    known = f"the calibrated {noun(len(calibrated), 'one is', 'ones are')} {listed(calibrated)}"
    return f"there is no {what} {shown(name)}; {known if calibrated else 'none was calibrated'}"


def not_loaded(link: str, links: Collection[str]) -> str:
    """Return the sentence, without its full stop, about a link that is not one of those of a robot."""
    return f"{shown(link)} is not one of the links that the robot was loaded with: {listed(links)}"


def refuse_other(word: str, allowed: Collection[str], where: str, error: type[CalibError] = JobError) -> None:
    """Raise ``error`` for a word that is not one of those allowed."""
    if word not in allowed:
        raise error(f"{where}: {shown(word)} is not one of {', '.join(allowed)}.")


def near(name: str, known: Iterable[str], most: int = 3, likeness: float = 0.6) -> list[str]:
    """Return the known words that are like ``name``, the likest first; of very many or very long ones, of the first."""
    short = [word for word in known if len(word) <= _LONGEST_COMPARED][:_MOST_COMPARED]
    return difflib.get_close_matches(name[:_LONGEST_COMPARED], short, most, likeness)


def printable(text: str) -> str:
    """Return a sentence with an escape for every character that does not print: line ends, controls, halves.

    Names in it can then neither break the line nor command the terminal.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def apart(text: str) -> str:
    """Return a sentence in which names differ that look alike, as one has its accents as characters of their own (NFD).

    These, and what else Unicode writes in another way, are escapes, as TOML has them as well.
    """
    if is_normalized("NFC", text):
        return text
    before = (" ", *text)
    return "".join(
        c.encode("unicode_escape").decode() if normalize("NFC", c) != c or len(normalize("NFC", b + c)) == 1 else c
        for b, c in zip(before, text, strict=False)
    )


def harmless(text: str) -> str:
    """Return text to be looked at with an escape for what turns round the words after it, or commands a terminal."""
    return text.translate(_COMMANDING)


def on_one_line(text: str) -> str:
    """Return text as :func:`harmless`, with an escape for what ends a line, too, and for tabs.

    Wide spaces, and the joiners of Persian words and of emoji, stay: they do not print, but belong to names.
    """
    return harmless(text).translate(_LINE_ENDS)
