"""The notebooks of docs/ are run, cell by cell, where they lie; what ends a cell shows itself."""

import ast
import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.cases import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
# What a person reads of a thing at the end of a cell without scrolling.
_LINES, _LETTERS = 60, 3000


def test_there_is_one_for_every_kind_of_user() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == ["arm_cmm", "camera", "sockets", "tracker"]
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert all(f"(notebooks/{notebook.name})" in text for notebook in NOTEBOOKS)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_it_promises(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(notebook.parent)
    before = sorted(notebook.parent.iterdir())
    contents = json.loads(notebook.read_text(encoding="utf-8"))
    assert contents["nbformat"] == 4
    assert len({cell["id"] for cell in contents["cells"]}) == len(contents["cells"])
    names: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    for cell in contents["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == []
        shown.append(value_of("".join(cell["source"]), names))
    assert sorted(notebook.parent.iterdir()) == before
    kinds = {type(one).__name__ for one in shown}
    assert "Page" in kinds, "a report or a scene in place"
    for one in shown:
        # A figure of matplotlib has both, and answers None to one of them.
        asked = [getattr(one, name)() for name in ("_repr_html_", "_repr_svg_") if hasattr(one, name)]
        drawn = [text for text in asked if text is not None]
        assert drawn or not asked
        assert all(text.strip().startswith("<") for text in drawn)
        if not drawn:
            assert len(repr(one)) < _LETTERS
            assert repr(one).count("\n") < _LINES
    assert "found" not in names or names["found"].trusted


def value_of(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; return the value of its last line, as a notebook shows it, or None."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)  # type: ignore[attr-defined]
