"""What is said about the project in files that are not run: the reference, and how it is to be cited."""

import datetime
import importlib
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from inspect import isfunction
from types import ModuleType
from typing import get_args

import numpy as np
import pytest
import yaml
from pydantic import BaseModel

import calib
from calib.job.schema import BoardSection, Job
from calib.machine import gaussian, grid
from calib.machine.model_file import ModelFile
from calib.machine.uncertainty_file import UncertaintyFile
from calib.results.folder import result
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf
from tests.support.cases import CASE, ROOT, TABLE

DIRECTIVE = re.compile(r"\.\. auto(?:function|class|exception|module):: ([\w.]+)")
DESCRIBED = {
    name
    for page in (ROOT / "docs" / "api").glob("*.md")
    for name in DIRECTIVE.findall(page.read_text(encoding="utf-8"))
}
MEMBERS = re.compile(r"\.\. automodule:: ([\w.]+)\n   :members:(.*)")
KEY = re.compile(r"\w+")
VERSION = re.compile(r"\d+\.\d+\.\d+(\.dev\d+|(a|b|rc)\d+)?")


def test_every_public_name_is_in_the_reference() -> None:
    objects = [getattr(calib, name) for name in calib.__all__]
    described = [resolved(name) for name in DESCRIBED]
    missing = [
        name for name, thing in zip(calib.__all__, objects, strict=True) if not any(thing is d for d in described)
    ]
    assert not missing


@pytest.mark.parametrize(
    "module", [calib.commands, calib.dh, calib.judging, calib.measuring, calib.planning, calib.positioner]
)
def test_every_function_of_a_public_module_is_in_the_reference(module: ModuleType) -> None:
    described = [resolved(name) for name in DESCRIBED]
    for page in (ROOT / "docs" / "api").glob("*.md"):
        for name, listed in MEMBERS.findall(page.read_text(encoding="utf-8")):
            home = resolved(name)
            described += [getattr(home, member) for member in listed.replace(",", " ").split() or dir(home)]
    functions = [name for name in module.__all__ if isfunction(getattr(module, name))]
    assert not [name for name in functions if not any(getattr(module, name) is thing for thing in described)]


def resolved(name: str) -> object:
    """What a dotted name stands for: a module, or a name in one."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, last = name.rpartition(".")
        return getattr(importlib.import_module(module), last)


def keys_of(section: type[BaseModel]) -> Iterator[str]:
    """The keys of a section of a file, and of the sections in it."""
    for name, field in section.model_fields.items():
        yield field.alias or name
        for inner in sections_in(field.annotation):
            yield from keys_of(inner)


def sections_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from sections_in(part)


def keys_of_result() -> list[str]:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=0.02e-3)
    fit = calib.identify(calib.error_model(robot, offsets="all"), data)
    return [*result(calib.assess(fit)), *fit.records()[0]]


KEYS: dict[str, Callable[[], Iterable[str]]] = {
    "a job": lambda: keys_of(Job),
    "a board": lambda: keys_of(BoardSection),
    "model.json": lambda: keys_of(ModelFile),
    "uncertainty.json": lambda: keys_of(UncertaintyFile),
    "result.json": keys_of_result,
    "grid.npz": lambda: grid._KEYS,
    "gaussian.npz": lambda: gaussian._KEYS,
}


@pytest.mark.parametrize("file", KEYS)
def test_every_key_of_a_file_is_in_the_formats(file: str) -> None:
    pages = ("formats.md", "cameras.md")
    text = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in pages)
    # In code font: the words of prose are not enough.
    told = {
        word for code in re.findall(r"`([^`]+)`|^    (.+)$", text, re.MULTILINE) for word in KEY.findall(" ".join(code))
    }
    assert {key for key in KEYS[file]() if key not in told} == set()


def test_citation() -> None:
    """The keys that Citation File Format 1.2.0 requires, and what this project says of itself elsewhere."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert (cited["cff-version"], cited["type"]) == ("1.2.0", "software")
    assert all(set(author) == {"name"} for author in cited["authors"])
    assert (cited["title"], cited["license"]) == (project["name"], project["license"])
    assert cited["version"] == calib.__version__
    assert cited["keywords"] == project["keywords"]
    # A version that is out has the day on which it came out.
    released = "dev" not in calib.__version__
    assert released == isinstance(cited.get("date-released"), datetime.date)


def test_changelog_has_the_version() -> None:
    """A version under way stands under its changes as unreleased; one that is out by its number and its day."""
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert VERSION.fullmatch(calib.__version__)
    if "dev" in calib.__version__:
        assert headings[0] == "Unreleased"
    else:
        assert re.fullmatch(rf"{re.escape(calib.__version__)} - \d{{4}}-\d{{2}}-\d{{2}}", headings[0])


def test_the_axes_of_components_are_those_that_the_formats_tell() -> None:
    """A length of a joint moves it along the axis of the URDF that the table says, whatever the joint's own axis."""
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    section = text.partition("### Components of placements")[2].partition("###")[0]
    rows = re.findall(r"^\| `([-01 ]+)`[^|]*\| (-?[xyz]) \| (-?[xyz]) \| (-?[xyz]) \|$", section, re.MULTILINE)
    assert len(rows) == 6
    for axis, *directions in rows:
        urdf = (
            '<robot name="arm"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
            f'<child link="b"/><axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
            "</joint></robot>"
        )
        robot = load_robot(parse_urdf(urdf.encode(), "arm.urdf"))
        for k, direction in enumerate(directions):
            d = replace(robot.no_deviations(), placements=np.eye(6)[None, k] * 1e-3)
            wanted = np.eye(3)["xyz".index(direction[-1])] * (-1.0 if direction.startswith("-") else 1.0)
            assert robot.tips(np.zeros((1, 1)), d)[0, :3, 3] == pytest.approx(1e-3 * wanted), (axis, k)
