"""Files that are none: pipes, devices, folders, files that grow, shrink or change under the reader."""

import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from calib.foundations.errors import CalibError, JobError, OutputError
from calib.foundations.files import encoded, read_bytes, sha256, write_atomically
from calib.job.inputs import load
from tests.support.cases import JOB, TABLE, URDF, copy_case, run, write

NO_FILE = "is not a regular file."


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", [JOB, URDF, TABLE])
@pytest.mark.parametrize("kind", ["pipe", "zeros", "folder", "terminal"])
def test_what_is_no_file_is_neither_opened_nor_waited_for(folder: Path, name: str, kind: str) -> None:
    (folder / name).unlink()
    match kind:
        case "pipe":
            os.mkfifo(folder / name)
        case "folder":
            (folder / name).mkdir()
        case _:
            (folder / name).symlink_to({"zeros": "/dev/zero", "terminal": "/dev/tty"}[kind])
    assert run("check", JOB) == (1, "", f"Error: {name}: {NO_FILE}\n")


def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "f")
    monkeypatch.setattr(Path, "is_file", lambda _: True)
    with pytest.raises(JobError) as caught:
        read_bytes(tmp_path / "f", JobError)
    assert str(caught.value) == f"{tmp_path / 'f'}: {NO_FILE}"


def test_a_file_that_shrinks_or_grows_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"0123456789")
    told = os.fstat

    def telling(size: int) -> None:
        monkeypatch.setattr(
            "calib.foundations.files.os.fstat",
            lambda handle: SimpleNamespace(st_mode=told(handle).st_mode, st_size=size),
        )

    telling(15)
    assert read_bytes(path, JobError, 20) == b"0123456789"
    telling(0)
    assert read_bytes(path, JobError, 20) == b"0123456789"
    with pytest.raises(JobError, match="is larger than 9 bytes"):
        read_bytes(path, JobError, 9)
    telling(21)
    with pytest.raises(JobError, match="is larger than 20 bytes"):
        read_bytes(path, JobError, 20)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has files that say they are empty")
def test_a_file_of_the_system_that_says_it_is_empty() -> None:
    assert Path("/proc/self/status").stat().st_size == 0
    with pytest.raises(JobError, match="is larger than 100 bytes"):
        read_bytes(Path("/proc/self/status"), JobError, 100)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "no/such", "\udcff", "."])
def test_names_that_no_file_has(tmp_path: Path, name: str) -> None:
    with pytest.raises(CalibError) as caught:
        read_bytes(tmp_path / name, JobError)
    assert str(caught.value)


def test_long_names_are_shortened_wherever_they_are_told(tmp_path: Path) -> None:
    long = "x" * 5000
    for error in (CalibError, JobError, OutputError):
        said = str(error(f"{long}/{long}: cannot be read, and has {long}."))
        assert len(said) < 1500
        assert said.startswith("xxx")
        assert said.endswith("x.")
    assert len(str(JobError("word " * 2000))) < 2100
    assert len(run("check", long).err) < 1500
    assert len(run("calibrate", tmp_path / "job.toml", "-o", long).err) < 1500


def test_results_need_a_folder_and_no_pipe(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    for out in ("pipe", "/dev/null"):
        said = f"Error: {out}: is a pipe or a device, and the results need a folder.\n"
        assert run("calibrate", JOB, "-o", out) == (1, "", said)


def test_names_of_files_that_are_no_text(folder: Path) -> None:
    odd = os.fsdecode(b"\xff<b>\x1b[31m.toml")
    (folder / JOB).rename(folder / odd)
    assert run("calibrate", odd, "-o", "out", "--quiet").code == 0
    page = (folder / "out/report.html").read_text(encoding="utf-8")
    assert "\\udcff&lt;b&gt;" in page
    assert "<b>\x1b" not in page


def test_text_is_written_whatever_it_holds(tmp_path: Path) -> None:
    write_atomically(tmp_path / "f", "a\udcff\u00e9\n")
    assert (tmp_path / "f").read_bytes() == encoded("a\udcff\u00e9\n") == b"a\\udcff\xc3\xa9\n"


def test_a_job_names_files_and_never_writes_them(folder: Path) -> None:
    """A job may name any file that its user may read; what is in it is quoted at most as one cell."""
    write("secret", "root:x:0:0:secret words\n")(folder)
    (folder / JOB).write_text(
        (folder / JOB).read_text(encoding="utf-8").replace(f'"{TABLE}"', '"../' + folder.name + '/secret"'),
        encoding="utf-8",
    )
    said = run("calibrate", JOB, "-o", "out")
    assert said.code == 1
    assert said.err.startswith(f"Error: ../{folder.name}/secret:1: column ")
    assert not (folder / "out").exists()
    assert (folder / "secret").read_text(encoding="utf-8") == "root:x:0:0:secret words\n"


@pytest.mark.parametrize("name", [JOB, TABLE])
def test_a_file_that_changes_before_its_hash_is_taken(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The result names what was read by its hash."""

    def meanwhile(model: object, sets: object) -> list[object]:
        (folder / name).write_bytes((folder / name).read_bytes() + b"\n")
        return []

    monkeypatch.setattr("calib.job.refusals.named", meanwhile)
    sentence = f"Error: {name}: has changed while it was read; run again when it is whole.\n"
    assert run("check", JOB) == (1, "", sentence)


def test_a_urdf_that_changes_is_known_by_what_was_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = sha256((folder / URDF).read_bytes())

    def meanwhile(model: object, sets: object) -> list[object]:
        (folder / URDF).write_bytes(b"<robot/>")
        return []

    monkeypatch.setattr("calib.job.refusals.named", meanwhile)
    assert load(folder / JOB).hashes[URDF] == before


# Names under which nothing can be. -----------------------------------------------------------------------------------

LONG = "n" * 300
# Where what is to be written may not be: nothing has that name, and no way leads there.
NOWHERE = {
    "behind no folder": ("missing/../x", "missing/../x: leads through missing, which is no folder."),
    "behind a file": (f"{TABLE}/../x", f"{TABLE}/../x: leads through {TABLE}, which is no folder."),
    "in a circle": ("circle/x", "circle/x: cannot hold the results (a symbolic link leads in a circle)."),
    "in a file": (f"{TABLE}/x", f"{TABLE}/x: cannot be made, as {{}}/{TABLE} is a file."),
    "endless": (f"{LONG}/x", f"{LONG}/x: cannot hold the results (File name too long)."),
}


@pytest.mark.parametrize("command", [("demo",), ("calibrate", JOB, "-o"), ("fleet", JOB, "-o")], ids=lambda c: c[0])
@pytest.mark.parametrize("where", NOWHERE)
def test_folders_that_no_way_leads_to_are_not_made(folder: Path, where: str, command: tuple[str, ...]) -> None:
    (folder / "circle").symlink_to("circle")
    out, why = NOWHERE[where]
    before = sorted(folder.rglob("*"))
    code, _, said = run(*command, out)
    assert (code, said.replace(f"{folder}/{out}", out)) == (1, f"Error: {why.format(folder)}\n")
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "command",
    [
        ("plan", URDF, "-n", "5", "--candidates", "20", "-o"),
        ("dh", URDF, "-o"),
        ("compensate", "out", TABLE, "-o"),
        ("export", "out", "--to", "offsets", "-o"),
        ("uncertainty", "out", "-o"),
        ("cell", "out", "out", "-o"),
    ],
    ids=lambda c: c[0],
)
def test_files_that_cannot_be_looked_for_are_refused_in_a_sentence(
    folder: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    run("calibrate", JOB, "-o", "out", "-q")
    code, out, said = run(*command, LONG + ".csv")
    assert (code, out, said.count("\n")) == (1, "", 1)
    assert said.startswith("Error: ")
    (folder / "nothing.csv").symlink_to("nowhere")
    assert run(*command, "nothing.csv") == (1, "", "Error: nothing.csv: already exists; choose another name.\n")


def test_an_arm_that_may_not_be_looked_for_is_refused_in_a_sentence(folder: Path) -> None:
    run("calibrate", JOB, "-o", "out", "-q")
    code, _, said = run("cell", f"{LONG}.urdf", "out", "-o", "cell.urdf")
    assert (code, said) == (1, f"Error: {LONG}.urdf: cannot be read (File name too long).\n")


@pytest.mark.parametrize("hidden", ["too long", "not to be looked at"])
def test_results_that_cannot_be_looked_for_are_refused_in_a_sentence(
    folder: Path, hidden: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, why = (LONG, "File name too long") if hidden == "too long" else ("out", "Permission denied")
    if hidden != "too long":
        (folder / "out").mkdir()
        there = os.stat

        def looked_at(path: str | Path, **how: object) -> os.stat_result:
            if str(path).startswith("out"):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return there(path, **how)  # type: ignore[arg-type]

        monkeypatch.setattr(os, "stat", looked_at)
    for command in (("compare", name, name), ("view", name), ("sensitivity", JOB, "--errors", name)):
        assert run(*command) == (1, "", f"Error: {name}/model.json: cannot be read ({why}).\n")


# Every command, with what is there in the place of all its files and folders.
COMMANDS = (
    ("calibrate", JOB, "-o", "there"),
    ("check", JOB),
    ("compensate", "there", TABLE, "-o", "there"),
    ("demo", "there"),
    ("view", "there"),
    ("app", "--folder", TABLE),
    ("sensitivity", JOB, "--errors", "there", "--plot", "there"),
    ("performance", "there", TABLE, "--probe", TABLE),
    ("cell", "there", "there", "-o", "there", "--scene", "there", "--mesh-root", "there"),
    ("dh", URDF, "-o", TABLE),
    ("fleet", JOB, "-o", TABLE),
    ("models", JOB),
    ("plan", URDF, "-o", "there", "--measured", TABLE, "--working", TABLE, "--mesh-root", "there"),
    ("verify", "there", TABLE),
    ("compare", "there", "there", "-o", "there"),
    ("iso9283", TABLE),
    ("uncertainty", "there", "-o", "there"),
    ("export", "there", "--to", "offsets", "-o", "there"),
    ("five-point", TABLE, "-o", "there"),
    ("board", "-o", TABLE),
    ("import", TABLE, "-o", "there"),
    ("init", URDF, TABLE, "-o", "there"),
)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c[0])
def test_what_may_not_be_read_is_bad_input_and_no_wrong_usage(
    folder: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "there").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode, **_: False)
    code, _, said = run(*command)
    assert code in ((0, 1, 3) if command[0] in ("check", "models") else (1,)), said


def test_these_are_all_commands() -> None:
    _, _, listed = run("--help").out.partition("\nCalibrate:\n")
    names = [line.split()[0] for line in listed.splitlines() if line.startswith("  ") and line[2] != " "]
    assert sorted(names) == sorted(c[0] for c in COMMANDS)
