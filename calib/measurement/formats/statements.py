"""Lines of logs and of controllers' programs in which numbers stand in brackets: what differs by lines is a column.

    CONST jointtarget p10:=[[0,-30,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    DECL E6AXIS XP1={A1 -15.2,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0}
    [INFO] pose 7: q=[0.1, -1.2, 0.3], x=0.31

No language is known here. A statement goes on until its brackets are closed; statements of one kind have the same marks
and words, and other numbers and names. Numbers are called as the words before them.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from itertools import accumulate, groupby
from types import MappingProxyType
from typing import NamedTuple

from calib.foundations.errors import MeasurementError
from calib.foundations.units import symbol_of
from calib.foundations.words import counted, shown
from calib.measurement.cells import Rows, whole_text
from calib.measurement.layout import is_number, of_list, refuse_long_name

# Words, numbers and signs take some hundred bytes each.
_LARGEST = 5_000_000
_LOOKED_AT = 100_000  # characters, of a text that may have lists
# A list has as many numbers as a point; fewer are a number of something, or a range.
_FEWEST = 3
# The sign of typesetters, which is none of a program.
_MINUS = "\u2212"
# What a decimal comma makes of one number.
_A_PAIR = 2
# Lists in one pair of brackets are rows, and not the parts of one, if they are as many.
_FEWEST_ROWS = 3
_DEEPEST = 16
_MOST_TOLD = 3
# What begins a comment in programs and logs: Python's, C's, MATLAB's, RAPID's and KRL's.
_COMMENTS = ("#", "//", "%", "!", ";")
# Of these, signs that begin one behind a statement as well; a semicolon may end it.
_ONE_SIGN = ("#", "%", "!")
_PAIRS = MappingProxyType({"]": "[", ")": "(", "}": "{"})
# What RAPID writes for an axis that is not there.
_NO_AXIS = 9e9
_NUMBER = r"(?<![\w.])[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.])"
# A minus that stands by itself before a number, where nothing is that it could be taken from.
_APART = re.compile(rf"([\[({{,;:=]\s*)-\s+(?={_NUMBER.replace('[+-]?', '', 1)})")
_TOKEN = re.compile(rf"""(?P<text>"[^"\n]*"|'[^'\n]*')|(?P<number>{_NUMBER})|(?P<word>\w+)|(?P<sign>[^\s\w])""")
# What words are made of.
_PART = re.compile(r"[^\W\d_]+")


class _Token(NamedTuple):
    kind: str  # "text", "number", "word" or "sign"
    text: str
    line: int
    glued: bool  # to what stands before it, without a blank


class _Statement(NamedTuple):
    tokens: tuple[_Token, ...]

    @property
    def is_long(self) -> bool:
        """Whether it goes over several lines."""
        return self.tokens[0].line < self.tokens[-1].line

    @property
    def has_list(self) -> bool:
        """Whether some brackets hold as many numbers as a point."""
        return _lists(self.tokens) > 0

    @property
    def words(self) -> list[str]:
        """Its words, and texts in quotes."""
        return [_plain(token.text) for token in self.tokens if token.kind in ("word", "text")]

    @property
    def parts(self) -> list[str]:
        """What its words are made of: ``Waypoint_1_q`` of ``Waypoint`` and ``q``."""
        return [part for word in self.words for part in _PART.findall(word)]

    @property
    def shape(self) -> tuple[str, ...]:
        """Its signs, and the kinds of all else."""
        return tuple(token.text if token.kind == "sign" else token.kind for token in self.tokens)


def are_in(data: bytes) -> bool:
    """Return whether a text begins with lists of numbers, two or more."""
    beginning = data[:_LOOKED_AT].decode("utf-8", errors="replace").replace('"', " ")  # a quoted cell may be a list
    return _lists(_tokens(beginning, 1)) > 1


def _lists(tokens: Iterable[_Token]) -> int:
    """Return how many brackets have as many numbers as a point, in them and not in others in them."""
    found, counts = 0, list[int]()
    for token in tokens:
        if token.text in _PAIRS.values():
            counts.append(0)
        elif token.text in _PAIRS and counts:
            found += counts.pop() >= _FEWEST
        elif token.kind == "number" and counts:
            counts[-1] += 1
    return found


def from_statements(data: bytes, where: str, part: str | None = None) -> Rows | None:
    """Return titles, cells and remarks of the statements that have lists; None where there are none.

    ``part``: a word of those that are meant, where there are several kinds. Raises MeasurementError where it is not
    said, or a bracket is not closed.
    """
    text = whole_text(data, where)
    if len(text) > _LARGEST:
        raise MeasurementError(f"{where}: has {len(text)} characters with numbers in brackets; allowed are {_LARGEST}.")
    statements = list(_statements(text, where))
    with_lists = [one for one in statements if one.has_list]
    others = len(statements) - len(with_lists)
    if part is not None:
        with_lists = _with_word(with_lists, part)
        if not with_lists:
            raise MeasurementError(f"{where}: no line with numbers in brackets has the word {shown(part)}.")
    if not with_lists:
        return None
    every, kinds = _rows_and_kinds(with_lists, part)
    passed_over: list[str] = []
    if len(kinds) > 1 or len(every) == 1:
        bare, comments = _without_free_comments(with_lists)
        rows_of_bare, kinds_of_bare = _rows_and_kinds(bare, part)
        if len(kinds_of_bare) < len(kinds) or (len(kinds_of_bare) == 1 and len(rows_of_bare) > len(every)):
            every, kinds = rows_of_bare, kinds_of_bare
            many = counted(len(comments), "comment is passed over", "comments are passed over")
            passed_over = [f"{many}, the first one in line {comments[0].line}"]
    if len(kinds) > 1:
        told = "; ".join(
            f"{counted(len(kind), 'row')} as {_told(kind[0], _word_of(kind, every))}" for kind in kinds[:_MOST_TOLD]
        )
        more = f"; and {len(kinds) - _MOST_TOLD} more kinds" if len(kinds) > _MOST_TOLD else ""
        raise MeasurementError(
            f"{where}: has several kinds of lines with numbers in brackets: {told}{more}; say by topic which are "
            "meant, a word that the others do not have, or keep only these."
        )
    _refuse_decimal_commas(kinds[0], where)
    titles, rows = _table(kinds[0], where)
    said = [f"{counted(len(rows), 'row')} as {_told(kinds[0][0])}"]
    said += [counted(others, "other line is passed over", "other lines are passed over")] if others else []
    return titles, rows, (*said, *passed_over)


def _rows_and_kinds(
    statements: Sequence[_Statement], part: str | None
) -> tuple[list[_Statement], list[list[_Statement]]]:
    """Return the rows that statements are, and the kinds of these."""
    every = [row for one in statements for row in _rows_of(one, len(statements) == 1)]
    if part is not None:  # lists in a list have the word of what they are in, or none
        every = _with_word(every, part) or every
    return every, _kinds(every)


def _refuse_decimal_commas(kind: Sequence[_Statement], where: str) -> None:
    """Raise MeasurementError where commas part numbers two by two: ``A1 3,2173,A2 122,5959`` would lose its decimals.

    A pair in brackets of its own, as ``(320,240)``, is none.
    """
    tokens = kind[0].tokens
    runs = [run for run in _runs(tokens) if len(run) > 1]
    if len(runs) < _FEWEST or any(len(run) != _A_PAIR or _is_in_brackets(tokens, *run) for run in runs):
        return
    for statement in kind:
        for first, second in runs:
            whole, decimals = statement.tokens[first], statement.tokens[second]
            if not (decimals.glued and decimals.text.isdecimal() and whole.text.lstrip("+-").isdecimal()):
                return
    whole, decimals = (tokens[k] for k in runs[0])
    raise MeasurementError(
        f"{where}:{whole.line}: {shown(f'{whole.text},{decimals.text}')} seems to have a decimal comma; write a point, "
        "or a blank behind a comma that parts two numbers."
    )


def _is_in_brackets(tokens: Sequence[_Token], first: int, last: int) -> bool:
    """Return whether brackets hold these tokens and no others."""
    return (
        first > 0
        and tokens[first - 1].text in _PAIRS.values()
        and last + 1 < len(tokens)
        and tokens[last + 1].text in _PAIRS
    )


def _runs(tokens: Sequence[_Token]) -> Iterator[list[int]]:
    """Yield the numbers that commas without a blank join, by their places."""
    run: list[int] = []
    for k, token in enumerate(tokens):
        if token.kind != "number":
            continue
        if run and run[-1] == k - 2 and tokens[k - 1].text == "," and tokens[k - 1].glued and token.glued:
            run.append(k)
            continue
        if run:
            yield run
        run = [k]
    if run:
        yield run


def _told(statement: _Statement, word: str = "") -> str:
    how = f", topic {word}" if word else ""
    return f"{shown(' '.join(token.text for token in statement.tokens[:12]))} (line {statement.tokens[0].line}{how})"


def _with_word(statements: Sequence[_Statement], word: str) -> list[_Statement]:
    """Return the statements that have a word; where none has it, those of which a part of a word is that."""
    found = [one for one in statements if word in one.words]
    return found or [one for one in statements if word in one.parts]


def _word_of(kind: Sequence[_Statement], every: Sequence[_Statement]) -> str:
    """Return a word by which :func:`_with_word` finds the statements of a kind among all; nothing where none does."""
    lines = {id(one) for one in kind}
    others = [one for one in every if id(one) not in lines]
    known = {word for one in every for word in one.words}
    taken = {word for one in others for word in one.words}
    whole = set.intersection(*(set(one.words) for one in kind)) - taken
    parts = set.intersection(*(set(one.parts) for one in kind)) - known
    parts -= {part for one in others for part in one.parts}
    told = (word for word in (*kind[0].words, *kind[0].parts) if word in whole or word in parts)
    return next((word for word in told if word.isidentifier()), "")


def expanded(titles: Sequence[str], rows: Sequence[Sequence[str]], where: str, most: int) -> Rows:
    """Return a table with columns for cells that are lists of numbers, and empty ones where such a cell is empty.

    ``most``: how many values it may have. Raises MeasurementError where it has more, or lists have other lengths.
    """
    columns: list[tuple[str, Sequence[str]]] = []
    said, room = [], most // len(rows) - len(titles)
    for title, cells in zip(titles, zip(*rows, strict=True), strict=True):
        lists = [list_of(cell) for cell in cells]
        if any(found is None and cell for found, cell in zip(lists, cells, strict=True)) or not any(lists):
            columns.append((title, cells))
            continue
        count, _ = Counter(len(found) for found in lists if found).most_common(1)[0]
        for number, found in enumerate(lists, start=1):
            if found and len(found) != count:
                raise MeasurementError(
                    f"{where}: row {number} has {len(found)} numbers in {shown(title)}, and others have {count}."
                )
        refuse_long_name(title, where)
        room -= count - 1
        if room < 0:
            raise MeasurementError(
                f"{where}: as a table, with a column for each of {count} numbers in {shown(title)}, it has more than "
                f"{most} values."
            )
        filled = [found or [""] * count for found in lists]
        columns += zip(of_list(title, count), zip(*filled, strict=True), strict=True)
        said.append(f"{shown(title)} is a list of {count} numbers in each row")
    return [title for title, _ in columns], list(zip(*(cells for _, cells in columns), strict=True)), tuple(said)


def list_of(cell: str) -> list[str] | None:
    """Return the numbers of a cell that is a list in brackets, as written; None where it is none.

    >>> list_of("[0.1, -2, 3e-1]"), list_of("(1 2)"), list_of("1, 2"), list_of("[mm]")
    (['0.1', '-2', '3e-1'], ['1', '2'], None, None)
    """
    if not cell or cell[0] not in _PAIRS.values() or cell[-1] not in _PAIRS:
        return None
    found = re.split(r"[\s,;\[\](){}]+", cell.strip("[](){} \t"))
    return found if len(found) > 1 and all(is_number(one, ",") for one in found) else None


def opens_list(word: str) -> bool:
    """Return whether a cell begins a list of numbers in brackets that it does not end: a separator has torn it apart.

    >>> opens_list("j:{2.6"), opens_list("[ -1"), opens_list("[1 2]"), opens_list("1)"), opens_list("x [mm]")
    (True, True, False, False, False)
    """
    at = max(map(word.rfind, _PAIRS.values()))
    inside = word[at + 1 : at + 100].lstrip()
    return at > max(map(word.rfind, _PAIRS)) and (inside[:1].isdigit() or inside[:1] in ("-", "+", "."))


def are_torn(cells: Sequence[str]) -> bool:
    """Return whether the cells of a row are parts of a list in brackets, its numbers with words before them or not.

    >>> are_torn(["XP1={A1 1.5", "A2 -3", "A3 7}"]), are_torn(["1)", "(a", "2"]), are_torn(["[1 2 3]", "(x)"])
    (True, False, False)
    """
    unclosed = any(sum(map(cell.count, _PAIRS.values())) > sum(map(cell.count, _PAIRS)) for cell in cells)
    return unclosed and holds_list(", ".join(cells))


def holds_list(text: str) -> bool:
    """Return whether a text has a list of numbers in brackets, whatever is beside it.

    >>> holds_list("P[1]{J1= 4.5 deg, J2= 3 deg, J3= 7 deg};"), holds_list("x [mm]")
    (True, False)
    """
    return _lists(_tokens(text, 1)) > 0


def are_alike(titles: Sequence[str], cells: Sequence[str]) -> bool:
    """Return whether a list was taken for the title of a column of such."""
    return any(holds_list(title) and holds_list(cell) for title, cell in zip(titles, cells, strict=True))


def begins_list(text: str) -> bool:
    """Return whether a cell, or a title, is a list of numbers in brackets, or the beginning of one."""
    return opens_list(text) or list_of(text) is not None


def _statements(text: str, where: str) -> Iterator[_Statement]:
    """Yield statements: a line, or as many as it takes to close its brackets."""
    tokens: list[_Token] = []
    open_: list[_Token] = []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.lstrip().startswith(_COMMENTS):
            continue
        for token in _code(list(_tokens(line, number)), len(open_)):
            tokens.append(token)
            if token.text in _PAIRS.values():
                open_.append(token)
                if len(open_) > _DEEPEST:
                    raise MeasurementError(f"{where}:{number}: has brackets in more than {_DEEPEST} others.")
            elif token.text in _PAIRS and open_:
                open_.pop()
        if tokens and not open_:
            yield _Statement(_without_comment(tokens))
            tokens = []
    if open_:
        raise MeasurementError(f"{where}:{open_[0].line}: a bracket {open_[0].text} is opened and not closed.")


def _code(tokens: Sequence[_Token], depth: int) -> Sequence[_Token]:
    """Return the tokens of a line without a comment whose brackets are no pairs: ``[1, 2]; ! left (of``.

    ``depth``: of the brackets in which the line begins. What may close one of them is no comment.
    """
    texts = [token.text for token in tokens]
    steps = [(text in _PAIRS.values()) - (text in _PAIRS) for text in texts]
    marks = (k for k, text in enumerate(texts) if text in _ONE_SIGN or texts[k : k + 2] == ["/", "/"])
    at = next(marks, len(texts))
    opened = sum(steps[at:])
    return tokens[:at] if opened > 0 or (opened < 0 and depth + sum(steps[:at]) <= 0) else tokens


def _without_free_comments(statements: Sequence[_Statement]) -> tuple[list[_Statement], list[_Token]]:
    """Return statements without the comments that stand behind their lines, and the first sign of each that is left.

    A word that comes again behind other lines, and not behind all with numbers, may tell kinds, as ``! target 1`` does:
    such a comment stays.
    """
    lines = [[list(line) for _, line in groupby(one.tokens, lambda token: token.line)] for one in statements]
    begins = [[_comment_in(line) for line in every] for every in lines]
    words = Counter(
        word
        for every, own in zip(lines, begins, strict=True)
        for line, at in zip(every, own, strict=True)
        for word in _words_of(line[at:])
    )
    of_all = sum(any(token.kind == "number" for token in line) for every in lines for line in every)
    found, first = [], []
    for every, own in zip(lines, begins, strict=True):
        tokens: list[_Token] = []
        for line, at in zip(every, own, strict=True):
            is_free = at < len(line) and all(words[word] in (1, of_all) for word in _words_of(line[at:]))
            tokens += line[:at] if is_free else line
            first += [line[at]] if is_free else []
        found.append(_Statement(tuple(tokens)))
    return found, first


def _words_of(tokens: Sequence[_Token]) -> set[str]:
    return {token.text for token in tokens if token.kind in ("word", "text")}


def _comment_in(tokens: Sequence[_Token]) -> int:
    """Return at which token of a line a comment begins, as many as there are where none does.

    It has words, and fewer numbers than a point, which may be what was measured; no bracket of what stands before it
    closes in it. ``100%`` begins none, and a semicolon only behind a bracket, where nothing is set to something.
    """
    texts = [token.text for token in tokens]
    is_mark = [text in _ONE_SIGN or texts[k : k + 2] == ["/", "/"] for k, text in enumerate(texts)]
    for k in range(1, len(tokens)):
        is_of_krl = texts[k] == ";" and texts[k - 1] in _PAIRS and "=" not in texts[k:] and not any(is_mark[k + 1 :])
        if not (is_mark[k] or is_of_krl) or (tokens[k].glued and tokens[k - 1].kind != "sign"):
            continue
        rest = tokens[k:]
        depths = list(accumulate((text in _PAIRS.values()) - (text in _PAIRS) for text in texts[k:]))
        is_point = sum(token.kind == "number" for token in rest) >= _FEWEST
        if min(depths) >= 0 and depths[-1] == 0 and _words_of(rest) and not is_point:
            return k
    return len(tokens)


def _without_comment(tokens: Sequence[_Token]) -> tuple[_Token, ...]:
    """Return tokens without the comment that a number in brackets may have, as FANUC's ``P[2:"above the part"]``."""
    texts = [token.text for token in tokens]
    left = set[int]()
    for k in range(4, len(tokens)):
        if tokens[k - 1].kind == "text" and (texts[k - 4], texts[k - 2], texts[k]) == ("[", ":", "]"):
            left |= {k - 2, k - 1}
    return tuple(token for k, token in enumerate(tokens) if k not in left)


def _plain(text: str) -> str:
    return text.strip("\"'")


def _tokens(text: str, line: int) -> Iterator[_Token]:
    end = -1
    if "-" in text or _MINUS in text:
        text = _APART.sub(r"\1-", text.replace(_MINUS, "-"))
    for match in _TOKEN.finditer(text):
        yield _Token(match.lastgroup or "", match.group(), line, match.start() == end)
        end = match.end()


def _rows_of(statement: _Statement, is_only: bool) -> list[_Statement]:
    """Return the lists in one pair of brackets that goes over several lines, each a row; else the statement itself.

    They keep the name of what they are in: ``joints = np.array([[...], [...]])``.
    """
    if not (is_only or statement.is_long):
        return [statement]
    tokens = statement.tokens
    inside: dict[int, list[tuple[int, int]]] = {}  # brackets by the one that they are in
    open_: list[int] = []
    depth: dict[int, int] = {}
    for k, token in enumerate(tokens):
        if token.text in _PAIRS.values():
            depth[k] = len(open_)
            open_.append(k)
        elif token.text in _PAIRS and open_:
            begin = open_.pop()
            inside.setdefault(open_[-1] if open_ else -1, []).append((begin, k + 1))
    found = {parent: rows for parent, rows in inside.items() if parent >= 0 and _are_rows(tokens, parent, rows)}
    if not found:
        return [statement]
    top = min(depth[parent] for parent in found)
    return [
        _Statement((*_name_before(tokens, parent), *tokens[begin:end]))
        for parent, rows in sorted(found.items())
        if depth[parent] == top
        for begin, end in rows
    ]


def _are_rows(tokens: Sequence[_Token], parent: int, rows: Sequence[tuple[int, int]]) -> bool:
    """Return whether brackets in others are alike, hold lists, and have nothing but commas between them."""
    ends = [parent + 1, *(end for _, end in rows)]
    between = [token.text for end, (begin, _) in zip(ends, rows, strict=False) for token in tokens[end:begin]]
    parts = [_Statement(tuple(tokens[begin:end])) for begin, end in rows]
    return (
        len(rows) >= _FEWEST_ROWS
        and set(between) <= {",", ";"}
        and len({part.shape for part in parts}) == 1
        and parts[0].has_list
    )


def _name_before(tokens: Sequence[_Token], at: int) -> tuple[_Token, ...]:
    """Return the name to which something is set: what stands before the last equals sign, or colon, before it."""
    for k in range(at - 1, 0, -1):
        if tokens[k].text in _PAIRS:
            break
        if tokens[k].text in ("=", ":") and tokens[k - 1].kind in ("word", "text"):
            return (tokens[k - 1],)
    return ()


def _kinds(every: Sequence[_Statement]) -> list[list[_Statement]]:
    """Return the statements of every kind: of the same shape, and with the same words where these are no names.

    What numbers are called by one by one, as ``X`` and ``A1`` in ``{X 1, Y 2, Z 3}`` and ``{A1 1, A2 2, A3 3}``, is no
    name either.
    """
    shapes: dict[tuple[str, ...], list[_Statement]] = {}
    for statement in every:
        shapes.setdefault(statement.shape, []).append(statement)
    kinds = []
    for shape, alike in shapes.items():
        labels = [
            k
            for k, kind in enumerate(shape)
            if kind in ("word", "text") and _is_label([s.tokens[k].text for s in alike])
        ]
        found: dict[tuple[str, ...], list[_Statement]] = {}
        for statement in alike:
            told = (*(statement.tokens[k].text for k in labels), *_calling(statement.tokens))
            found.setdefault(told, []).append(statement)
        kinds += list(found.values())
    return kinds


def _calling(tokens: Sequence[_Token]) -> list[str]:
    """Return the words, without their numbers, that stand before each of the numbers in brackets, if all have one."""
    found: list[str] = []
    open_: list[list[str | None]] = []
    for k, token in enumerate(tokens):
        if token.text in _PAIRS.values():
            open_.append([])
        elif token.text in _PAIRS and open_:
            own = open_.pop()
            words = [word for word in own if word is not None]
            found += words if len(own) == len(words) >= _FEWEST else []
        elif token.kind == "number" and open_:
            before = tokens[k - 2 if tokens[k - 1].text in ("=", ":") else k - 1]
            open_[-1].append("".join(_PART.findall(before.text)) if before.kind == "word" else None)
    return found


def _is_label(words: Sequence[str]) -> bool:
    """Return whether words tell kinds, as ``actual`` and ``target`` do: they come again, and have no numbers."""
    return min(Counter(words).values()) > 1 and not any(c.isdigit() for word in set(words) for c in word)


def _table(kind: Sequence[_Statement], where: str) -> tuple[list[str], list[list[str]]]:
    """Return titles and cells of statements of one kind; raises MeasurementError for a list of a long name."""
    cells = {
        k: [statement.tokens[k].text for statement in kind]
        for k, token in enumerate(kind[0].tokens)
        if token.kind != "sign"
    }
    constant = {k for k, words in cells.items() if kind[0].tokens[k].kind != "number" and len(set(words)) == 1}
    titles = _titles(kind[0].tokens, constant, f"{where}:{kind[0].tokens[0].line}")
    columns = {k: cells[k] for k in titles if not all(map(_is_no_axis, cells[k]))}
    named = [titles[k] for k in columns]
    if not any(named):
        named = [f"column {n + 1}" for n in range(len(columns))]
    count = Counter[str]()
    for n, title in enumerate(named):
        own = title or f"column {n + 1}"
        count[own] += 1
        named[n] = own if count[own] == 1 else f"{own} {count[own]}"
    rows = zip(*columns.values(), strict=True)
    return named, [list(map(_plain, row)) for row in rows]


def _is_no_axis(cell: str) -> bool:
    return is_number(cell, ",") and float(cell) == _NO_AXIS


def _is_set_to_list(tokens: Sequence[_Token], closing: int) -> bool:
    """Return whether an equals sign and a bracket that opens come behind a bracket that closes."""
    behind = [token.text for token in tokens[closing + 1 : closing + 4]]
    behind = behind[1:] if behind[:2] == [":", "="] else behind
    return len(behind) > 1 and behind[0] == "=" and behind[1] in _PAIRS.values()


def _titles(tokens: Sequence[_Token], constant: AbstractSet[int], where: str) -> dict[int, str]:
    """Return the title of every number, and of every word that is not the same in all rows; "" where nothing says it.

    A word before a number is its title. One before brackets, or in them, is that of all numbers there that have no
    other; these are numbered.
    """
    titles: dict[int, str] = {}
    units: dict[int, str] = {}
    lists: list[tuple[str, list[int]]] = []
    base, at, depth = "", 0, 0  # the last word, the depth of brackets at which it stands, and that of here
    for k, token in enumerate(tokens):
        depth += (token.text in _PAIRS.values()) - (token.text in _PAIRS)
        if token.text in _PAIRS and depth <= at:
            if base and _is_set_to_list(tokens, k):  # the number of a list, which keeps its name: q[3] = {...}
                lists.append((base, []))
            else:
                base = ""
        if k in constant:
            word = _plain(token.text)
            unit = symbol_of(word) if titles.get(k - 1) else None
            if unit is not None:
                units[k - 1] = unit
            elif token.kind == "word" or word:
                base, at = word, depth
                lists.append((base, []))
        elif token.kind in ("word", "text"):
            titles[k] = "name"
        elif token.kind == "number":
            titles[k] = base
            if base and depth > 0:
                lists[-1][1].append(k)
            else:
                base = ""
    for word, own in lists:
        if len(own) > 1:
            refuse_long_name(word, where)
            titles.update(zip(own, of_list(word, len(own)), strict=True))
    return {k: f"{title} [{units[k]}]" if k in units else title for k, title in titles.items()}
