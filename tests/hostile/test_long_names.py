"""Names longer than a file system takes are refused in a sentence, as other files that are not there."""

from pathlib import Path

import pytest

from tests.support.cases import run

LONG = 300 * "y"


@pytest.mark.parametrize(
    "given", [("import", LONG), ("plan", LONG, "-n", "9"), ("plan", "a.urdf", "--mesh-root", LONG, "-n", "9")], ids=str
)
def test_a_name_too_long_is_refused_in_a_sentence(given: tuple[str, ...], tmp_path: Path) -> None:
    said = run(*given, "-o", tmp_path / "out.csv")
    assert said.code == 1
    assert said.err.startswith("Error: ")
    assert not (tmp_path / "out.csv").exists()
