"""What a killed run leaves, and somebody who swaps folders for links while another works in them."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib.foundations import folders

OURS = ("model.json", "result.json", "report.html")
_OPERATIONS = (
    "fsync",
    "link",
    "listdir",
    "lstat",
    "mkdir",
    "open",
    "rename",
    "replace",
    "rmdir",
    "scandir",
    "stat",
    "unlink",
)


def fill(folder: Path, contents: dict[str, str]) -> Path:
    folder.mkdir(parents=True)
    for name, text in contents.items():
        (folder / name).write_text(text)
    return folder


def left(folder: Path, *, old: bool = True, new: bool = True, listed: object = OURS) -> Path:
    """What a run leaves that is killed between the two steps, or before, or after."""
    folder.mkdir(mode=0o700)
    (folder / "list.json").write_text(json.dumps({"calib": folders._MARK, "files": listed}))
    for there, name in ((old, "old"), (new, "new")):
        if there:
            fill(folder / name, dict.fromkeys(OURS, name))
    return folder


def at_operation(patched: pytest.MonkeyPatch, n: int, act: Callable[[], None], *, after: bool = False) -> list[int]:
    """Let something happen before, or after, the n-th operation from now; the list is empty until it has."""
    happened: list[int] = []
    count = [n]
    within = [False]

    def once() -> None:
        if not within[0]:
            count[0] -= 1
            if count[0] == -1:
                happened.append(n)
                within[0] = True
                try:
                    act()
                finally:
                    within[0] = False

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def operate(*arguments: Any, **options: Any) -> Any:
            if not after:
                once()
            done = None if function is fsync else function(*arguments, **options)
            if after:
                once()
            return done

        return operate

    fsync = os.fsync  # no disk is lost here
    for name in _OPERATIONS:
        patched.setattr(os, name, counted(getattr(os, name)))
    return happened


def swap(path: Path, away: Path, home: Path) -> None:
    """Move what is called ``path`` away, and let a link to another folder take its name."""
    if os.path.lexists(path):
        path.rename(away)
    path.symlink_to(home)
