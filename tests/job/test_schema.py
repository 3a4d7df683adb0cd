"""The job file's schema: no wrong value is taken, and none is answered in the words of a validation library."""

import datetime
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from calib.foundations.errors import JobError
from calib.job.read import parse_job, read_job
from calib.job.schema import named_files
from tests.support.cases import CASE, JOB

FRAME: dict[str, Any] = {"position": ["1 mm", "2 cm", "-3 m"], "quaternion": [0.0, 1, 0, 0]}
EVERYTHING: dict[str, Any] = {
    "schema": 1,
    "robot": {"urdf": "arm.urdf", "tip": "tcp", "base": "base", "mesh_roots": ["meshes"]},
    "error_model": {
        "offsets": ["joint_1", "wrist_*"],
        "placements": "all",
        "base": "fixed",
        "tool": "fixed",
        "prior": {"length": "1 mm", "angle": "0.3 deg"},
        "null_space": "minimal",
    },
    "base": FRAME,
    "tools": {"left ball": FRAME},
    "instruments": {
        "leica": {
            "kind": "laser_tracker",
            "sigma": "15 um",
            "sigma_per_metre": "6 um",
            "station": ["0 m", "1 m", "2 m"],
        },
        "arm": {"kind": "arm", "sigma": "0.1 mm", "model": "arm_results", "tool": "spike"},
        "pivoted arm": {"kind": "arm", "sigma": "0.1 mm", "urdf": "arm.urdf", "tip": "flange", "pivot": "pivot.csv"},
        "other arm": {"kind": "arm", "sigma": "0.1 mm", "urdf": "b.urdf", "point": ["0 mm", "0 mm", "120 mm"]},
    },
    "measurements": [
        {
            "file": "a.csv",
            "observes": "pose",
            "sigma": "0.02 mm",
            "sigma_angle": "0.01 deg",
            "use": "identify",
            "model_sigma": "0 mm",
            "model_sigma_angle": "0 mrad",
            "columns": {"x [mm]": "X"},
        },
        {"file": "b.csv", "instrument": "leica", "use": "validate"},
    ],
}
WRONG = (True, 3, -0.5, float("nan"), float("inf"), "", "wrong", [], [[]], [1, "a"], [{}], {}, {"a": 1},
         datetime.date(2026, 1, 1))  # fmt: skip
# Words that a validation library says and a user of a job file does not understand.
FOREIGN = re.compile(
    r"[Ii]nput|\bvalid\b|validat(ion|or)|field|[Dd]ictionary|instance|tuple|NoneType|Error|type=|__|\("
)


def places(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Return the path of every value in a document."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(p for key, child in children for p in places(child, (*path, key)))]


def replaced(path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    document: Any = json.loads(json.dumps(EVERYTHING))
    target = document
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    return dict(document)


def test_every_key_is_read() -> None:
    job = parse_job(EVERYTHING, "job")
    assert json.loads(json.dumps(job.model_dump(by_alias=True, exclude_unset=True))) == EVERYTHING


@pytest.mark.parametrize("path", places(EVERYTHING)[1:], ids=lambda path: ".".join(map(str, path)))
def test_wrong_values_are_refused_in_our_words(path: tuple[str | int, ...]) -> None:
    refused = 0
    for value in WRONG:
        try:
            parse_job(replaced(path, value), "job.toml")
        except JobError as e:
            refused += 1
            said = str(e)
            assert said.startswith("job.toml: ")
            assert said.endswith((".", "?"))
            assert "\n" not in said
            assert FOREIGN.search(said.replace("validate", "")) is None, said
    # A few of the values are right in some places; at a text, every text is.
    assert refused >= len(WRONG) - 4


@pytest.mark.parametrize("path", [path for path in places(EVERYTHING)[1:] if isinstance(path[-1], str)], ids=str)
def test_misspelt_keys_are_named_with_the_nearest(path: tuple[str | int, ...]) -> None:
    if (path[0] in ("tools", "instruments") and len(path) == 2) or "columns" in path[:-1]:
        return  # names that the user chooses
    parent: Any = EVERYTHING
    for key in path[:-1]:
        parent = parent[key]
    misspelt = f"{path[-1]}x"
    value = {(misspelt if key == path[-1] else key): child for key, child in parent.items()}
    with pytest.raises(JobError, match=f"{misspelt}: is not a known key; did you mean '{path[-1]}'"):
        parse_job(replaced(path[:-1], value) if path[:-1] else value, "job")


def test_defaults_are_those_of_the_simple_case() -> None:
    job = parse_job({"schema": 1, "robot": {"urdf": "a.urdf"}, "measurements": [{"file": "a.csv"}]}, "job")
    assert (job.error_model.offsets, job.error_model.base, job.error_model.tool) == ("none", "pose", "position")
    assert (job.measurements[0].observes, job.measurements[0].use) == ("position", "identify")


def test_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    plain = read_job(CASE / JOB)
    (tmp_path / JOB).write_bytes(b"\xef\xbb\xbf" + (CASE / JOB).read_bytes().replace(b"\n", b"\r\n"))
    assert read_job(tmp_path / JOB) == plain


@pytest.mark.parametrize(
    ("kinds", "free"),
    [
        (("plane",), True),
        (("distance", "pair_distance", "indicator"), True),
        (("plane", "position"), False),
        (("socket",), False),
    ],
)
def test_a_free_tool_begins_where_the_job_says_where_nothing_shows_it(kinds: tuple[str, ...], free: bool) -> None:
    text = 'schema = 1\n[robot]\nurdf = "arm.urdf"\n[error_model]\ntool = "pose"\n[tools.tool]\n'
    text += 'position = ["10 mm", "0 mm", "5 mm"]\nquaternion = [1, 0, 0, 0]\n'
    text += "".join(f'[[measurements]]\nfile = "{kind}.csv"\nobserves = "{kind}"\n' for kind in kinds)
    if free:
        assert parse_job(tomllib.loads(text), "job.toml").error_model.tool == "pose"
    else:
        with pytest.raises(JobError, match=r"tools: poses are given, and .* leaves them free"):
            parse_job(tomllib.loads(text), "job.toml")


@pytest.mark.parametrize(
    ("section", "sentence"),
    [
        ({"levels": [{"name": "a", "free": ["*"], "measurements": []}]}, "levels[0].measurements: is empty."),
        ({"levels": [{"name": " ", "free": ["*"]}]}, "levels[0].name: is empty."),
        (
            {
                "robot": {
                    "urdf": "a.urdf",
                    "loop": [{"name": "  ", "frames": ["a", "b"], "closes": ["x"], "passive": ["j"]}],
                }
            },
            "robot.loop[0].name: is empty.",
        ),
    ],
)
def test_an_empty_list_and_blanks_are_no_names(section: dict[str, Any], sentence: str) -> None:
    """None of the tables would be all of them, and a name of blanks cannot be read in a message."""
    with pytest.raises(JobError) as caught:
        parse_job({**EVERYTHING, **section}, "job")
    assert str(caught.value) == f"job: {sentence}"


def test_every_file_that_a_job_names_is_known() -> None:
    """Where files of a stranger's job may be, the page of this computer asks of all of them."""
    camera = {"kind": "camera", "camera_on": "tip", "sigma": "1 px", "lens_file": "lens.yaml", "size": [640, 480]}
    instruments = {**EVERYTHING["instruments"], "camera": camera}
    stream = {"file": "stream.csv", "readings": "joints.csv", "clock": "free", "sigma": "1 mm"}
    seen = {"file": "marks.csv", "observes": "pixels", "instrument": "camera", "board": "board.toml"}
    job = parse_job({**EVERYTHING, "instruments": instruments, "measurements": [stream, seen], "levels": []}, "job")
    assert sorted(set(named_files(job))) == [
        ("board", "board.toml"),
        ("file", "marks.csv"),
        ("file", "stream.csv"),
        ("lens_file", "lens.yaml"),
        ("mesh_roots", "meshes"),
        ("model", "arm_results"),
        ("pivot", "pivot.csv"),
        ("readings", "joints.csv"),
        ("urdf", "arm.urdf"),
        ("urdf", "b.urdf"),
    ]
