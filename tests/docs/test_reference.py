"""What is said about the project in files that are not run: the reference, and how it is to be cited."""

import datetime
import importlib
import re
import tomllib

import yaml

import calib
from tests.support.cases import ROOT

DIRECTIVE = re.compile(r"\.\. auto(?:function|class|exception|module):: ([\w.]+)")
DESCRIBED = {
    name
    for page in (ROOT / "docs" / "api").glob("*.md")
    for name in DIRECTIVE.findall(page.read_text(encoding="utf-8"))
}
VERSION = re.compile(r"\d+\.\d+\.\d+(\.dev\d+|(a|b|rc)\d+)?")


def test_every_public_name_is_in_the_reference() -> None:
    objects = [getattr(calib, name) for name in calib.__all__]
    described = [resolved(name) for name in DESCRIBED]
    missing = [
        name for name, thing in zip(calib.__all__, objects, strict=True) if not any(thing is d for d in described)
    ]
    assert not missing


def resolved(name: str) -> object:
    """What a dotted name stands for: a module, or a name in one."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, last = name.rpartition(".")
        return getattr(importlib.import_module(module), last)


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
