"""What a job file that is written here says: texts, and paths as they are seen from its folder."""

import json
import os
from pathlib import Path

from calib.foundations.errors import JobError
from calib.foundations.words import on_one_line, shown
from calib.robot.sources import EXAMPLE


def toml_text(text: str) -> str:
    """Return a text as a TOML string, whole: it is read again. JSON's has no escapes for some characters.

    Raises JobError for what is no text, as the bytes of a file's name may be.
    """
    try:
        text.encode()
    except UnicodeEncodeError as e:
        raise JobError(f"{shown(text)}: is not UTF-8 text, and no job can name it; rename it.") from e
    whole = json.dumps(text, ensure_ascii=False)
    return "".join(c if on_one_line(c) == c else f"\\u{ord(c):04x}" for c in whole)


def seen_from(folder: Path, path: str | Path) -> str:
    """Return a path as a file in ``folder`` names it: relative, and also behind links the same file."""
    if str(path).startswith(EXAMPLE):
        return str(path)
    found, there, own = os.path.relpath(path, folder), Path(path), folder.resolve()
    # Behind a link ``..`` leads to another folder than the text says.
    if (own / found).resolve() != there.resolve():
        found = os.path.relpath(there.parent.resolve() / there.name, own)
    return f"./{found}" if found.startswith(EXAMPLE) else found
