"""``model.json``: the fit's machine to the last digit, and one sentence for a file that is not one."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.foundations.errors import OutputError
from calib.machine.model_file import TermEntry, model_json
from calib.machine.of_fit import machine_of
from calib.robot.joint_terms import parts
from calib.robot.terms import KINDS, Kind
from tests.support import machines
from tests.support.cases import tree
from tests.support.swaps import left

TOOLS = {"left": machines.pose((0.05, 0.02, 0.15)), "right": machines.pose((-0.05, 0.01, 0.1))}


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    """An arm with a mimic joint, and two points on its flange."""
    text = machines.INLINE["mimic"]
    rng = np.random.default_rng(7)
    true = machines.arm(text, "tip").moved(rng)
    machine = machines.Machine(true, machines.anywhere(rng), TOOLS)
    readings = true.draw(rng, 80)
    points = list(TOOLS) * 40
    robot = machines.load(text, "tip")
    columns = machines.table(true, readings, machine.see(readings, points), "position") | {"tool": points}
    data = calib.read_measurements(columns, robot, sigma=1e-6)
    return calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)


@pytest.fixture(scope="module")
def written(fit: calib.Fit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    (folder / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
    (folder / "nominal.urdf").write_bytes(fit.model.robot.urdf.source)
    return folder


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    for path in written.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_round_trip_is_the_fits_machine(fit: calib.Fit, written: Path) -> None:
    model = calib.load_machine(written)
    readings = np.random.default_rng(8).uniform(-3.0, 3.0, (200, 6))
    for t, name in enumerate(fit.measurements[0].tools):
        assert np.abs(model.predict(readings, tool=name) - machines.predicted(fit, readings, t)).max() < 1e-13
    assert list(model.tools) == ["left", "right"]
    assert model.deviations.offsets.tolist() == fit.machine.deviations.offsets.tolist()
    assert model.deviations.placements.tolist() == fit.machine.deviations.placements.tolist()


def test_prediction_is_the_measured_point(fit: calib.Fit, written: Path) -> None:
    data, model = fit.measurements[0], calib.load_machine(written)
    for t, name in enumerate(data.tools):
        rows = data.tool == t
        assert np.abs(model.predict(data.readings[rows], tool=name)[:, :3, 3] - data.position[rows]).max() < 1e-7


def test_unknown_tool(written: Path) -> None:
    with pytest.raises(calib.MeasurementError, match=r"no tool 'middle'; the calibrated ones are 'left', 'right'"):
        calib.load_machine(written).predict(np.zeros((1, 6)), tool="middle")


def test_transmission_says_what_the_mimic_joint_does(written: Path) -> None:
    entries = {entry["joint"]: entry for entry in json.loads((written / "model.json").read_text())["transmission"]}
    assert entries["level"] == {
        "joint": "level",
        "readings": {"lift": -1.0},
        "constant": 0.1,
        "offsets": {"lift": -1.0, "level": 1.0},
    }


def test_current_folder_and_text_path(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert calib.load_machine(".").robot.tip == "tip"
    assert calib.load_machine(str(folder)).robot.tip == "tip"


def test_reading_removes_nothing(folder: Path) -> None:
    hidden = left(folder.with_name(f".{folder.name}.0123abcd.calib"), new=False)
    before = tree(hidden)
    calib.load_machine(folder)
    assert tree(hidden) == before


def test_results_of_a_killed_run_are_found(folder: Path) -> None:
    place = folder.with_name("moved")
    folder.rename(left(folder.with_name(".moved.0123abcd.calib"), old=False) / "old")
    assert calib.load_machine(place).robot.tip == "tip"


def refused(folder: Path) -> str:
    with pytest.raises(OutputError) as caught:
        calib.load_machine(folder)
    said = str(caught.value)
    assert "\n" not in said
    assert said.endswith(".")
    assert "pydantic" not in said
    return said.replace(str(folder), "out")


Change = Callable[[dict[str, Any]], None]


def put(value: Any, *path: str | int) -> Change:
    def apply(contents: Any) -> None:
        for key in path[:-1]:
            contents = contents[key]
        contents[path[-1]] = value

    return apply


HOSTILE: dict[str, tuple[Change, str]] = {
    "schema of the future": (put(2, "schema"), "schema is 2; it must be 1"),
    "no schema": (lambda c: c.pop("schema"), "schema is missing"),
    "unknown key": (put(1, "code"), "code is not known"),
    "another file": (put("../../etc/passwd", "urdf"), "urdf is \"../../etc/passwd\"; it must be 'nominal.urdf'"),
    "text for a number": (
        put("0", "joints", 0, "deviation", 0),
        'joints[0].deviation[0] is "0"; it must be a valid number',
    ),
    "truth for a number": (put(True, "joints", 0, "offset"), "joints[0].offset is true; it must be a valid number"),
    "NaN": (put(float("nan"), "base", "position", 1), "base.position[1] has a wrong value"),
    "too large": (
        put(1e9, "joints", 1, "offset"),
        "joints[1].offset is 1000000000.0; it must be less than or equal to 1000000",
    ),
    "infinity": (put(float("inf"), "joints", 1, "offset"), "joints[1].offset has a wrong value"),
    "five of six": (put([0.0] * 5, "joints", 0, "deviation"), "joints[0].deviation[5] is missing"),
    "no offset": (put(None, "joints", 0, "offset"), "joints[0]: a joint has an offset if, and only if, it moves"),
    "zero quaternion": (put([0.0] * 4, "base", "quaternion"), "base.quaternion: has the norm 0, and must have 1"),
    "long quaternion": (
        put([1.0, 1, 0, 0], "tools", "left", "quaternion"),
        "tools.left.quaternion: has the norm 1.41421, and must have 1",
    ),
}


def test_a_list_is_no_model(folder: Path) -> None:
    (folder / "model.json").write_text("[1]", encoding="utf-8")
    assert refused(folder) == "out/model.json: is not a model of this toolkit: its top level: it must be an object."


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_contents(folder: Path, name: str) -> None:
    change, why = HOSTILE[name]
    contents = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    change(contents)
    (folder / "model.json").write_text(json.dumps(contents), encoding="utf-8")
    said = refused(folder)
    if name in ("NaN", "infinity"):
        assert said.startswith("out/model.json: is not ")
    else:
        assert said == f"out/model.json: is not a model of this toolkit: {why}."


@pytest.mark.parametrize("key", ["urdf_sha256", "setups", "tool_tips", "residual_model", "payload", "loads", "in_urdf"])
def test_a_file_that_names_its_run_is_whole(folder: Path, key: str) -> None:
    """Without its residual model, or its payload, the machine would be another one, and nobody would be told."""
    contents = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    contents["run"] = "0" * 64
    del contents[key]
    (folder / "model.json").write_text(json.dumps(contents), encoding="utf-8")
    assert refused(folder) == f"out/model.json: is not a model of this toolkit: {key} is missing."


@pytest.mark.parametrize(("key", "what"), [("setups", "set-ups"), ("tools", "tools")])
def test_no_more_set_ups_and_tools_than_a_calibration_finds(folder: Path, key: str, what: str) -> None:
    """What is compared or drawn takes memory with the square of their number."""
    contents = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    contents[key] |= {f"another {k}": contents["base"] for k in range(100)}
    (folder / "model.json").write_text(json.dumps(contents), encoding="utf-8")
    count = len(contents[key]) + (key == "setups")
    assert refused(folder) == f"out/model.json: has {count} {what}; allowed are 100."


def test_no_more_joint_terms_than_a_calibration_finds(folder: Path) -> None:
    contents = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    reading = contents["joints"][0]["name"]
    term = {"reading": reading, "kind": "sin", "order": 1, "coefficient": 0.0}
    contents["terms"] = [term] * 8001
    (folder / "model.json").write_text(json.dumps(contents), encoding="utf-8")
    assert refused(folder) == "out/model.json: has 8001 joint terms; allowed are 8000."


MISMATCHES: dict[str, tuple[Change, str]] = {
    "another joint": (put("swung", "joints", 0, "name"), "its joints are not those of nominal.urdf."),
    "another type": (put("prismatic", "joints", 0, "type"), "its joints are not those of nominal.urdf."),
    "a joint less": (lambda c: c["joints"].pop(), "its joints are not those of nominal.urdf."),
    "another coupling": (
        put(2.0, "transmission", 2, "readings", "lift"),
        "its couplings are not those of nominal.urdf.",
    ),
    "no such tip": (put("flange", "tip"), "its robot cannot be used: out/nominal.urdf: tip 'flange' is not a link"),
}


@pytest.mark.parametrize("name", MISMATCHES)
def test_model_of_another_robot(folder: Path, name: str) -> None:
    change, why = MISMATCHES[name]
    contents = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    change(contents)
    (folder / "model.json").write_text(json.dumps(contents), encoding="utf-8")
    assert refused(folder).startswith(f"out/model.json: {why}")


@pytest.mark.parametrize(
    "contents", [b"", b"[]", b"null", b"\xff\xfe", b"[" * 100_000, b'{"schema": 1', b"9" * 10_000], ids=range(7)
)
def test_not_a_model(folder: Path, contents: bytes) -> None:
    (folder / "model.json").write_bytes(contents)
    assert refused(folder).startswith("out/model.json: is not ")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_truncated(folder: Path, share: float) -> None:
    whole = (folder / "model.json").read_bytes()
    (folder / "model.json").write_bytes(whole[: int(share * len(whole))])
    assert refused(folder) == "out/model.json: is not JSON, or is truncated."


def test_no_model(tmp_path: Path) -> None:
    assert refused(tmp_path) == "out/model.json: there is no such file."
    assert refused(tmp_path / "nowhere") == "out/model.json: there is no such file."


def test_nominal_urdf_is_missing_or_cut_off(folder: Path) -> None:
    urdf = folder / "nominal.urdf"
    urdf.write_bytes(urdf.read_bytes()[:300])
    assert refused(folder).startswith(
        "out/model.json: its robot cannot be used: out/nominal.urdf:1: is not well-formed"
    )
    urdf.unlink()
    assert refused(folder).endswith("out/nominal.urdf: there is no such file.")


def test_joint_terms_are_part_of_the_machine(fit: calib.Fit, tmp_path: Path) -> None:
    model = machines.model(fit.robot, offsets="all", gain="all", harmonics=["lift"], harmonic_orders=(2,))
    found = calib.identify(model, fit.measurements)
    (tmp_path / "model.json").write_text(model_json(machine_of(found)), encoding="utf-8")
    (tmp_path / "nominal.urdf").write_bytes(fit.robot.urdf.source)
    again = calib.load_machine(tmp_path)
    readings = np.random.default_rng(8).uniform(-3.0, 3.0, (50, 6))
    assert again.robot.terms == found.robot.terms
    assert np.abs(found.deviations.terms).min() > 0.0
    assert np.abs(again.predict(readings, tool="left") - machines.predicted(found, readings)).max() < 1e-13


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.key)
def test_terms_of_every_kind_come_back(kind: Kind) -> None:
    robot = machines.load("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    for word in ("all", *kind.words):
        for term in kind.chosen(word, parts(robot), {}):
            plain = {"reading": term.reading, "kind": term.kind, "order": term.order, "coefficient": 1e-5}
            entry = TermEntry(**plain, body=term.body)
            assert json.loads(entry.model_dump_json()) == plain | ({"body": term.body} if term.body else {})
            assert TermEntry.model_validate_json(entry.model_dump_json()).term == term


TERM = {"reading": "lift", "kind": "cos", "order": 2, "coefficient": 1e-4}


@pytest.mark.parametrize(
    ("terms", "sentence"),
    [
        ([TERM | {"reading": "level"}], "its joint terms are not those of nominal.urdf, or one appears twice"),
        ([TERM, TERM], "its joint terms are not those of nominal.urdf, or one appears twice"),
        ([TERM | {"order": 0}], "terms[0]: a term has an order, or a body, if, "),
        ([TERM | {"kind": "gain"}], "terms[0]: a term has an order, or a body, if, "),
        ([TERM | {"kind": "magic"}], "terms[0].kind: 'magic' is no kind of joint terms"),
        (
            [TERM | {"kind": "moment", "order": 0}],
            "terms[0]: a term has an order, or a body, if, ",
        ),
        ([TERM | {"body": "lift_x"}], "terms[0]: a term has an order, or a body, if, "),
        ([TERM | {"kind": "moment", "order": 0, "body": "lift_w"}], "its joint terms are not those of nominal.urdf"),
        ([TERM | {"kind": "bending", "order": 0, "reading": "rod"}], "its joint terms are not those of nominal.urdf"),
        ([TERM | {"kind": "bending", "order": 0, "reading": ""}], "its joint terms are not those of nominal.urdf"),
    ],
)
def test_wrong_terms_are_refused(folder: Path, terms: list[object], sentence: str) -> None:
    contents = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(contents | {"terms": terms}))
    assert sentence in refused(folder)


def test_an_older_file_has_no_terms(fit: calib.Fit, folder: Path) -> None:
    contents = json.loads((folder / "model.json").read_text())
    del contents["terms"]
    (folder / "model.json").write_text(json.dumps(contents))
    assert calib.load_machine(folder).robot.terms == ()
