"""Jobs, results and models made to harm: numbers, keys and nesting without end, values twice, archives that lie."""

import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from calib.foundations.errors import JobError, OutputError
from calib.foundations.json_text import NotJsonError, parse_json
from calib.job.read import read_job
from calib.machine.model_file import load_machine
from calib.machine.npz import NotReadableError, arrays_of
from calib.results.result_file import robot_errors


def refused(tmp_path: Path, job: str | bytes) -> str:
    path = tmp_path / "job.toml"
    path.write_bytes(job.encode() if isinstance(job, str) else job)
    with pytest.raises(JobError) as caught:
        read_job(path)
    sentence = str(caught.value).removeprefix(str(path))
    assert "\n" not in sentence
    assert len(sentence) < 1000
    return sentence


@pytest.mark.parametrize(
    ("job", "sentence"),
    [
        ("schema = " + "9" * 10_000, ":1: is longer than the 10000 bytes that are allowed."),
        ("schema = " + "9" * 5000, ": is not TOML: a number has too many digits."),
        (
            "schema = 0x" + "f" * 5000,
            ": schema: a whole number of 20000 bits; TOML allows 64, one of which is the sign.",
        ),
        (
            "schema = 9223372036854775808",
            ": schema: a whole number of 64 bits; TOML allows 64, one of which is the sign.",
        ),
        (
            "schema = 99999999999999999999",
            ": schema: a whole number of 67 bits; TOML allows 64, one of which is the sign.",
        ),
        ("schema = 1.0e400", ": schema: inf is not a schema that this version reads; it must be 1."),
        ("schema = nan", ": schema: nan is not a schema that this version reads; it must be 1."),
        ("schema = 2026-11-21", ": schema: 2026-11-21 is not a schema that this version reads; it must be 1."),
        ("schema = 2026-02-31", ": is not TOML: Invalid date or datetime (at line 1, column 10)."),
        ("schema = 1\nschema = 1\n", ": is not TOML: Cannot overwrite a value (at line 2, column 11)."),
        ("schema = " + "[" * 9000, ": is nested too deep."),
        ("schema = " + "[\n" * 400_000, ": is nested too deep."),
        ("a" + ".a" * 4000 + " = 1", ": is nested too deep."),
        ("a" + ".a" * 400_000 + " = 1", ":1: is longer than the 10000 bytes that are allowed."),
        (("a" + ".a" * 4000 + " = 1\n") * 50, ": is not TOML: Cannot overwrite a value (at line 2, column 8006)."),
        (
            f'schema = 1\nrobot.urdf = """\n{"x" * 999}\n{"x" * 999}"""',
            f": robot.urdf: the text '{'x' * 60}...' is longer than 1000",
        ),
        ('schema = 1\nrobot.urdf = "\\ud800"', ": is not TOML: Escaped character is not a Unicode scalar value"),
        ("schema = 1".encode("utf-16"), ": is not UTF-8 text; save it as UTF-8."),
        ('robot.urdf = "\u00e4"'.encode("latin-1"), ": is not UTF-8 text; save it as UTF-8."),
        ("schema = 1\0", ": is not TOML:"),
    ],
    ids=range(20),
)
def test_jobs(tmp_path: Path, job: str | bytes, sentence: str) -> None:
    assert refused(tmp_path, job).startswith(sentence)


def test_a_job_of_a_windows_editor(tmp_path: Path) -> None:
    job = '\ufeffschema = 1\r\n[robot]\r\nurdf = "a.urdf"\r\n[[measurements]]\r\nfile = "a.csv"\r\n'
    assert refused(tmp_path, job.replace("a.csv", "")).startswith(": measurements[0].file: is empty.")


@pytest.mark.parametrize(
    ("source", "why"),
    [
        (b"[" * 1_000_000, "is not JSON that can be read: it is nested too deep"),
        (b'{"a":' * 100_000, "is not JSON that can be read: it is nested too deep"),
        (b'{"a": 1, "b": {"a": 2, "c": 3, "a": 4}}', "is not JSON that can be read: it has 'a' twice in one object"),
        (b'{"a": NaN}', "is not JSON, which has no NaN"),
        (b"[-Infinity]", "is not JSON, which has no -Infinity"),
        (b"[1e400]", "is not JSON that can be read: '1e400' is not a finite number"),
        (b"9" * 5000, "is not JSON that can be read: it has a number of 5000 digits"),
        (b'{"a": 1', "is not JSON, or is truncated"),
        (b'"\xe4"', "is not JSON, or is truncated"),
        ('{"a": 1}'.encode("utf-16"), "is not JSON, or is truncated"),
        (b"", "is not JSON, or is truncated"),
    ],
)
def test_json(source: bytes, why: str) -> None:
    with pytest.raises(NotJsonError) as caught:
        parse_json(source)
    assert str(caught.value) == why


@pytest.mark.parametrize(
    "value", [b"1e400", b"-1e300", b"1" + b"0" * 400, b'"nan"', b'"Infinity"', b"1e7"], ids=range(6)
)
def test_results_hold_numbers_that_a_machine_can_have(tmp_path: Path, value: bytes) -> None:
    (tmp_path / "result.json").write_bytes(b'{"parameters": [{"name": "joint_1.rx", "value": %s}]}' % value)
    with pytest.raises(OutputError) as caught:
        robot_errors(tmp_path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_results_twice_under_one_name(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"parameters": [], "parameters": [{"name": "x", "value": 1}]}', "utf-8")
    with pytest.raises(OutputError, match="it has 'parameters' twice in one object"):
        robot_errors(tmp_path)


def test_a_model_with_a_key_twice(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text('{"schema": 1, "base_link": "a", "base_link": "b"}', "utf-8")
    with pytest.raises(OutputError, match="it has 'base_link' twice in one object"):
        load_machine(tmp_path)


# Archives. -------------------------------------------------------------------------------------------------------


def npy(descr: str = "'<f8'", shape: str = "(2,)", data: bytes = bytes(16), version: bytes = b"\1\0") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY" + version + len(header).to_bytes(2, "little") + header + data


def archive(contents: bytes, name: str = "a.npy", compression: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as opened:
        opened.writestr(name, contents)
    return stream.getvalue()


class Evil:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('run')",)


BAD = "an array is not what its header says, or holds no numbers"
ARCHIVES: dict[str, tuple[bytes, str]] = {
    "a pickle": (npy("'|O'", "()", pickle.dumps(Evil())), BAD),
    "a pickle for an archive": (pickle.dumps(Evil()), "it is not a readable npz file"),
    "an absurd shape": (npy(shape="(1000000000000,)"), BAD),
    "a shape that overflows": (npy(shape="(4294967296, 4294967296, 0)"), BAD),
    "a negative shape": (npy(shape="(-2,)"), BAD),
    "letters of no bytes": (npy("'<U0'", "(99999999999,)", b""), BAD),
    "fewer numbers than promised": (npy(data=bytes(8)), BAD),
    "more numbers than promised": (npy(data=bytes(24)), BAD),
    "a call in the header": (npy(shape="(__import__('os').getpid(),)"), BAD),
    "parentheses without end": (npy(shape="(" * 50_000), BAD),
    "minus signs without end": (npy(shape="-" * 50_000 + "1"), BAD),
    "another version": (npy(version=b"\2\0"), BAD),
    "an open parenthesis": (npy(shape="("), BAD),
    "halves of characters": (npy("'<U1'", "()", (0xD800).to_bytes(4, "little")), "a text has a character that is none"),
    "no characters": (npy("'<U1'", "()", (0x110000).to_bytes(4, "little")), "a text has a character that is none"),
    "numbers of no machine": (
        npy(data=np.array([1.0, 1e300]).tobytes()),
        "a number is beyond 1e+06, in metres and radians",
    ),
}


@pytest.mark.parametrize("name", ARCHIVES)
def test_archives(name: str) -> None:
    contents, why = ARCHIVES[name]
    data = contents if contents.startswith(b"\x80") else archive(contents)
    with pytest.raises(NotReadableError) as caught:
        arrays_of(data, ("a",))
    assert str(caught.value) == why


def test_an_archive_that_unpacks_to_more_than_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.machine.npz.LARGEST_FILE", 1_000_000)
    bomb = archive(npy(shape="(1000000,)", data=bytes(8_000_000)), compression=zipfile.ZIP_DEFLATED)
    assert len(bomb) < 20_000
    with pytest.raises(NotReadableError, match="it unpacks to more than 1000000 bytes"):
        arrays_of(bomb, ("a",))
    # One that says it is small: no more is unpacked than it says, and its checksum is then wrong.
    lying = bomb.replace(
        len(npy(shape="(1000000,)", data=bytes(8_000_000))).to_bytes(4, "little"), (1000).to_bytes(4, "little")
    )
    assert lying != bomb
    with pytest.raises(NotReadableError):
        arrays_of(lying, ("a",))


def test_archives_of_many_files_and_other_packings() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as opened:
        for k in range(1500):
            opened.writestr(f"{k}.npy", b"")
    for data in (stream.getvalue(), archive(npy(), "../a.npy"), archive(npy(), "b.npy")):
        with pytest.raises(NotReadableError, match="it must hold a and nothing else"):
            arrays_of(data, ("a",))
    for packing in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with pytest.raises(NotReadableError, match="it is packed in a way that npz files are not"):
            arrays_of(archive(npy(), compression=packing), ("a",))


def test_good_archives_are_read() -> None:
    made = {
        "a": np.array([[1.5, -2.0]]),
        "b": np.array("base \U0001f916"),
        "c": np.array([True]),
        "d": np.zeros((0, 3)),
    }
    stream = io.BytesIO()
    np.savez(stream, **made)
    for name, array in arrays_of(stream.getvalue(), tuple(made)).items():
        np.testing.assert_array_equal(array, made[name])
        assert array.dtype == made[name].dtype
    assert json.loads(json.dumps(str(arrays_of(stream.getvalue(), tuple(made))["b"]))) == "base \U0001f916"
