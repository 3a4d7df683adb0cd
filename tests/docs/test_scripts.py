"""The scripts: every one is in their index, whatever is named exists, and they find the project and each other."""

import ast
import importlib
import re
from pathlib import Path

import pytest

from tests.support.cases import ROOT

SCRIPTS = ROOT / "scripts"
EVERY = sorted(
    path.relative_to(ROOT) for kind in ("py", "sh", "json") for path in SCRIPTS.rglob(f"*.{kind}") if path.is_file()
)
# Runners of the race start in environments that have nothing of this project.
OURS = [path for path in EVERY if path.suffix == ".py" and "peers" not in path.parts]
# The changelog tells what things were called at the time.
TEXTS = [
    path
    for pattern in ("*.md", "*.toml", ".ci/*", "docs/**/*", "robots/**/*", "scripts/**/*", "tests/**/*", "calib/**/*")
    for path in ROOT.glob(pattern)
    if path.suffix in {".md", ".toml", ".py", ".sh", ".urdf", ".csv", ""} and path.is_file()
    if path.name != "CHANGELOG.md" and "_build" not in path.parts
]
NAMED = re.compile(r"\bscripts/[\w/]*\.(?:py|sh|json)\b")
AT_THE_PROJECT = "sys.path.insert(0, str(Path(__file__).resolve().parents[2]))"


def test_every_script_is_in_the_index_and_what_the_index_names_exists() -> None:
    linked = re.findall(r"\]\(([\w/.]+)\)", (SCRIPTS / "README.md").read_text(encoding="utf-8"))
    assert [name for name in linked if not (SCRIPTS / name).is_file()] == []
    scripts = sorted(Path("scripts", name) for name in linked if not name.startswith("../"))
    assert scripts == EVERY


def test_every_script_that_is_named_anywhere_exists() -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in TEXTS
        for name in NAMED.findall(path.read_text(encoding="utf-8", errors="replace"))
        if not (ROOT / name).is_file()
    }
    assert missing == set()


@pytest.mark.parametrize("path", OURS, ids=str)
def test_a_script_finds_the_project_and_the_scripts_that_it_needs(path: Path) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    imported = {name for node in ast.walk(ast.parse(text)) for name in names_of(node)}
    beside = {other.stem for other in EVERY if other.suffix == ".py"}
    assert imported & beside == set(), "as scripts.<folder>.<name>"
    if imported & {"scripts", "tests"} and "__main__" in text:
        assert AT_THE_PROJECT in text.splitlines()
    module = importlib.import_module(".".join(path.with_suffix("").parts))
    assert getattr(module, "ROOT", ROOT) == ROOT
    assert Path(getattr(module, "CASE", ROOT)).is_dir()


def names_of(node: ast.AST) -> set[str]:
    """The packages that a statement imports."""
    if isinstance(node, ast.Import):
        return {name.name.partition(".")[0] for name in node.names}
    return {str(node.module).partition(".")[0]} if isinstance(node, ast.ImportFrom) else set()
