"""The examples of docs/ are run, page by page, in a folder of their own, and what they print is compared.

* ``console``: lines after ``$`` are typed in, and the lines below are what they print, standard error included; a line
  ``...`` stands for any number of lines. Numbers may differ by two units of the last printed digit.
* ``python``: is executed, in one namespace for the page; with ``>>>`` what it prints is compared as well.
* A block of any language whose first line is a comment that says nothing but a file's name is written to that file.
"""

import doctest
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from sybil import Example, Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser
from typer.main import get_command

import calib
from calib.cli.whole import app
from tests.support.cases import CASE, ROOT, TABLE, copy_case, run

DOCS = ROOT / "docs"
# Its examples need more than an empty folder, and have tests of their own.
ELSEWHERE = {"tutorial_sockets.md"}
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if path.name not in ELSEWHERE and "_build" not in path.parts]

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
NAMED = re.compile(r"(?:#|<!--) (\S+\.\w+)(?: -->)?\n")


def console(example: Example) -> str | None:
    """Type in what follows every ``$``, and compare what is printed."""
    for typed in re.split(r"^\$ ", example.parsed, flags=re.MULTILINE)[1:]:
        command, shown = typed.split("\n", 1)
        printed = output_of(command)
        if not alike(lines_of(shown), lines_of(printed)):
            return f"$ {command}\nshould print\n{shown}\nand prints\n{printed}"
    return None


def output_of(command: str) -> str:
    """What a command prints: ours in this process, for speed, all others by a shell."""
    words = shlex.split(command)
    if words[0] == "calib" and not set(words) & {"|", ">", "&&", ";"}:
        said = run(*words[1:])
        os.environ["CODE"] = str(said.code)
        return said.out + said.err
    # The shell that shows how the command before has ended is another one.
    command = command.replace("$?", "$CODE")
    done = subprocess.run(
        ["sh", "-c", command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    return done.stdout


def lines_of(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip("\n").splitlines()]


def alike(wanted: list[str], lines: list[str]) -> bool:
    """Whether lines are as wanted, ``...`` standing for any number of them."""
    if not wanted:
        return not lines
    if wanted[0].strip() == "...":
        return any(alike(wanted[1:], lines[start:]) for start in range(len(lines) + 1))
    return bool(lines) and same(wanted[0], lines[0]) and alike(wanted[1:], lines[1:])


def same(wanted: str, line: str) -> bool:
    """Whether two lines are the same, and their numbers nearly so."""
    if NUMBER.sub("#", wanted) != NUMBER.sub("#", line):
        return False
    return all(near(a, b) for a, b in zip(NUMBER.findall(wanted), NUMBER.findall(line), strict=True))


def near(a: str, b: str) -> bool:
    mantissa, _, exponent = a.partition("e")
    if "." not in mantissa and not exponent:
        return a == b
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(float(a) - float(b)) <= 2.001 * unit


def written(example: Example) -> None:
    """Write a block that names its file; others of such languages are only shown."""
    named = NAMED.match(example.parsed)
    if named:
        Path(named.group(1)).write_text(example.parsed, encoding="utf-8")


class Python:
    """Python that is executed, unless it names a file to be written."""

    def __init__(self) -> None:
        self.executed = PythonCodeBlockParser(doctest_optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
        self.files = CodeBlockParser("python", written)

    def __call__(self, document):
        named = [region for region in self.files(document) if NAMED.match(region.parsed)]
        starts = {region.start for region in named}
        yield from named
        yield from (region for region in self.executed(document) if region.start not in starts)


EXAMPLES = Sybil(
    parsers=[
        Python(),
        CodeBlockParser("console", console),
        *(CodeBlockParser(language, written) for language in ("toml", "xml", "text")),
    ]
)
PARSED = {path.relative_to(DOCS).as_posix(): EXAMPLES.parse(path) for path in PAGES}


def fitted(_: Path) -> dict[str, object]:
    """What is at hand on pages that take a calibration for granted."""
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=0.02e-3)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    return {"calib": calib, "fit": fit, "machine": calib.machine_of(fit), "readings": data.readings}


def measured(folder: Path) -> dict[str, object]:
    """Write what is at hand on pages that begin with a URDF and a table."""
    shutil.copyfile(CASE / "arm_cmm.urdf", folder / "arm.urdf")
    shutil.copyfile(CASE / TABLE, folder / TABLE)
    return {}


def calibrated(folder: Path) -> dict[str, object]:
    """Write what is at hand on pages that begin with results."""
    assert run("calibrate", copy_case(folder / "case"), "-o", folder / "out", "-q").code == 0
    return {}


AT_HAND = {"seeing.md": fitted, "assessment.md": fitted, "api/index.md": measured, "controllers.md": calibrated}


@pytest.mark.parametrize("page", [name for name, document in PARSED.items() if document.regions])
def test_page(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("robots", "scripts"):
        (tmp_path / name).symlink_to(ROOT / name)
    # A shell's "python" is this one, and imports what is tested.
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    monkeypatch.setenv("CODE", "")
    monkeypatch.setenv("COLUMNS", "80")
    if page in AT_HAND:
        PARSED[page].namespace.update(AT_HAND[page](tmp_path))
    for example in PARSED[page].examples():
        example.evaluate()


def test_what_is_compared() -> None:
    assert alike(["a 1.23 mm", "..."], ["a 1.24 mm", "more", "and more"])
    assert alike(["...", "last"], ["last"])
    assert not alike(["a 1.23 mm"], ["a 1.26 mm"])
    assert not alike(["27 rows"], ["28 rows"])
    assert not alike(["a"], ["a", "more"])
    assert not alike(["...", "a"], ["a", "more"])


COMMANDS = [
    (path.relative_to(ROOT).as_posix(), command)
    for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")), *sorted(ROOT.glob("robots/*/README.md")))
    if "_build" not in path.parts
    for command in re.findall(r"^ {4}calib (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
]


@pytest.mark.parametrize(("page", "command"), COMMANDS, ids=lambda text: text[:40])
def test_command_that_is_only_shown_can_be_typed(page: str, command: str) -> None:
    """Its arguments and options exist and have values of their kinds; nothing is done."""
    name, *arguments = shlex.split(command, comments=True)
    commands = get_command(app).commands
    assert name in commands, f"{page}: calib {command}"
    commands[name].make_context(name, arguments)
