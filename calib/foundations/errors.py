"""The errors a user can cause.

Every message is one clear sentence: what is wrong, where (file and line, joint, row), the value, what is allowed.
The command line prints it and exits with 1; anything else that escapes is a bug and shows its traceback.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # whoever only names an error, such as a command's help, loads no numpy
    import numpy as np
    import numpy.typing as npt


LITTLE_MEMORY = "The memory that this process may use does not suffice; see ulimit -v."
# What a library says for which there is no room, and Python where it lost the MemoryError on its way.
_LACKING_MEMORY = ("failed to map segment", "without setting an exception")
_LONGEST_WORD, _LONGEST = 400, 2000
_LONG_WORD = re.compile(rf"\S{{{_LONGEST_WORD},}}")


def lacks_memory(error: Exception) -> bool:
    """Tell whether an error is of memory that does not suffice."""
    return isinstance(error, MemoryError) or any(words in str(error) for words in _LACKING_MEMORY)


def _shortened(text: str, most: int = _LONGEST) -> str:
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"


class CalibError(Exception):
    """Base of every error that a user's input can cause. What it says is shortened where a name in it is very long."""

    def __str__(self) -> str:
        """Return the sentence, with the beginning and the end of such words, and of itself."""
        return _shortened(_LONG_WORD.sub(lambda word: _shortened(word[0], _LONGEST_WORD), super().__str__()))


class RobotError(CalibError, ValueError):
    """The robot description cannot be used."""


class PoseError(RobotError):
    """The arm cannot take a pose. ``row``: which of the readings, from 0; ``reason``: why, without the row.

    ``rows``: all for which the same was found at once, this one among them; there may be others still. ``where``: file
    and line of the row, where it has them.
    """

    def __init__(self, row: int, reason: str, rows: Sequence[int] = (), where: str = "") -> None:
        super().__init__(f"{where or f'row {row}'}: {reason}.")
        self.row = row
        self.rows = tuple(rows) or (row,)
        self.reason = reason


@contextmanager
def naming_rows(where: str, lines: "Sequence[int] | npt.NDArray[np.intp]") -> Iterator[None]:
    """Let a PoseError of the block name the file ``where`` and, of the ``lines`` of all its rows, that of its row."""
    try:
        yield
    except PoseError as e:
        raise PoseError(e.row, e.reason, e.rows, f"{where}:{lines[e.row]}") from e


@contextmanager
def naming(where: object, *kinds: type[CalibError]) -> Iterator[None]:
    """Let errors of some kinds in the block begin with ``where``: a file, or a file and a key of it."""
    try:
        yield
    except kinds as e:
        raise type(e)(f"{where}: {e}") from e


class MeasurementError(CalibError, ValueError):
    """The measurements cannot be used."""


class JobError(CalibError, ValueError):
    """The job, or an option given to the library, cannot be used."""


class IdentificationError(CalibError, ValueError):
    """The parameters cannot be identified from these measurements."""


class OutputError(CalibError, OSError):
    """The results cannot be written or read back."""


class KeptError(OutputError):
    """Another run keeps a folder for now."""
