"""With nothing but the README at hand: six robots of six makers, from an empty folder to a report."""

from pathlib import Path

import pytest

from scripts.examples.six_makers import ROBOTS, commands, errors, walked
from tests.support.cases import run


def test_three_commands_and_the_first_installs() -> None:
    lines = commands()
    assert [line[:4] for line in lines[:1]] == [["python", "-m", "pip", "install"]]
    assert [line[:2] for line in lines[1:]] == [["calib", "init"], ["calib", "calibrate"]]


@pytest.mark.parametrize(("name", "urdf", "tip", "write"), ROBOTS, ids=[robot[0] for robot in ROBOTS])
def test_no_command_fails_or_asks(name, urdf, tip, write, tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(tmp_path)
    said = []

    def command(words: list[str]) -> int:
        said.append(run(*words))
        return said[-1].code

    assert walked(Path(), urdf, tip, write, command) == [0, 0], said
    assert Path("out/report.html").is_file()
    before, after = map(float, errors(Path("out")).split(", "))
    assert after < 0.06 < 1.0 < before
