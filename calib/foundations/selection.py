"""Names that a user chooses: "all", "none", or names and globs of what there is."""

import fnmatch
from collections.abc import Collection, Sequence
from typing import Literal

from calib.foundations.arguments import elements, told
from calib.foundations.errors import JobError
from calib.foundations.words import near

Selection = Literal["all", "none"] | Collection[str]


def select(selection: object, names: Sequence[str], what: str, *words: str) -> list[str]:
    """Return the names that are chosen, in their own order. ``words``: what else than "all" and "none" would do.

    Raises JobError for what is no selection, and for a name or glob that matches nothing.
    """
    if isinstance(selection, str) and selection in ("all", "none"):
        return list(names) if selection == "all" else []
    chosen: set[str] = set()
    for pattern in listed_names(selection, what, *words):
        found = named(pattern, names)
        if not found:
            stem = pattern.removesuffix(".*")
            likest = near(stem, [*names, *(name.rpartition(".")[0] for name in names)], 1)
            hint = f"did you mean {likest[0]!r}?" if likest else f"there are {', '.join(names[:8])}, ..."
            raise JobError(f"{what}: {stem!r} matches no joint of the arm; {hint}")
        chosen.update(found)
    return [name for name in names if name in chosen]


def named(pattern: str, names: Sequence[str]) -> list[str]:
    """Return the names that a name or glob stands for.

    A name stands for itself first, whatever it would match as a glob; and where brackets match nothing as those of a
    glob, they are those of a name, as in ``finger[0].*``.
    """
    if pattern in names:
        return [pattern]
    return fnmatch.filter(names, pattern) or fnmatch.filter(names, pattern.replace("[", "[[]"))


def listed_names(selection: object, what: str, *words: str) -> list[str]:
    """Return a list of names as it is given. Raises JobError for anything else, with the words that would do."""
    names = elements(selection)
    if names is None or not all(isinstance(name, str) for name in names):
        allowed = ", ".join(f'"{word}"' for word in (*words, "all", "none"))
        raise JobError(f"{what}: {told(selection)} is not {allowed} or a list of names.")
    return names
