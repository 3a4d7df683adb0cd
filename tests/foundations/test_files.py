"""Files appear whole or not at all, and what a killed run leaves is put right."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calib.foundations.errors import CalibError, JobError, OutputError
from calib.foundations.files import read_bytes, recover_folder, replace_folder, sha256, write_atomically

as_root = os.geteuid() == 0


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_read_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    assert read_bytes(path, JobError) == b"abc"
    os.mkfifo(tmp_path / "fifo")
    for bad, sentence in (
        (tmp_path / "b", "there is no such file."),
        (tmp_path, "is not a regular file."),
        (tmp_path / "fifo", "is not a regular file."),
        (tmp_path / ("n" * 300), "cannot be read (File name too long)."),
    ):
        with pytest.raises(JobError) as caught:
            read_bytes(bad, JobError)
        assert str(caught.value) == f"{bad}: {sentence}"
    with pytest.raises(JobError, match="is larger than 2 bytes"):
        read_bytes(path, JobError, largest=2)


def test_sha256() -> None:
    assert sha256(b"") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


def test_write_atomically_replaces_and_leaves_nothing_beside(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_atomically(path, "grün")
    assert path.read_text(encoding="utf-8") == "grün"
    write_atomically(path, b"\0new")
    assert path.read_bytes() == b"\0new"
    assert names(tmp_path) == ["result.json"]
    assert path.stat().st_mode & 0o777 == 0o644


def test_write_atomically_says_why_it_cannot(tmp_path: Path) -> None:
    with pytest.raises(OutputError) as caught:
        write_atomically(tmp_path / "no" / "a", "")
    assert str(caught.value) == f"{tmp_path / 'no' / 'a'}: cannot be written (No such file or directory)."
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="Is a directory"):
        write_atomically(tmp_path / "folder", "")
    assert names(tmp_path) == ["folder"]


@pytest.mark.skipif(as_root, reason="root writes anywhere")
def test_write_atomically_in_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        write_atomically(tmp_path / "a", "")
    tmp_path.chmod(0o700)


def test_a_killed_writer_leaves_the_old_contents_or_the_new(tmp_path: Path) -> None:
    path = tmp_path / "a"
    old, new = b"o" * 2_000_000, b"n" * 2_000_000
    write_atomically(path, old)
    code = (
        "from pathlib import Path; from calib.foundations.files import write_atomically\n"
        f"print('go', flush=True)\nwhile True: write_atomically(Path({str(path)!r}), b'n' * 2_000_000)"
    )
    for delay in (0.0, 0.003, 0.011):
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as writer:
            writer.stdout.readline()
            time.sleep(delay)
            writer.kill()
        assert path.read_bytes() in (old, new)


def test_replace_folder(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    for content in ("first", "second"):
        with replace_folder(out) as new:
            assert names(new) == []
            (new / "sub").mkdir()
            (new / "sub" / "a").write_text(content)
        assert (out / "sub" / "a").read_text() == content
        assert names(out.parent) == ["out"]
    assert out.stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("error", [KeyError("x"), KeyboardInterrupt(), JobError("x")])
def test_replace_folder_leaves_the_old_one_when_the_block_raises(tmp_path: Path, error: BaseException) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a").write_text("old")
    with pytest.raises(type(error)), replace_folder(out) as new:
        (new / "a").write_text("new")
        raise error
    assert (out / "a").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_replace_folder_says_why_it_cannot(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(OutputError) as caught, replace_folder(file):
        pass
    assert str(caught.value) == f"{file}: is a file, and the results need a folder."
    with pytest.raises(OutputError) as caught, replace_folder(file / "out"):
        pass
    assert str(caught.value) == f"{file / 'out'}: the results cannot be written (File exists)."
    assert file.read_text() == "mine"
    with pytest.raises(OutputError, match="No space left"), replace_folder(tmp_path / "out"):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == ["file"]


def test_what_a_killed_exchange_left_is_put_right(tmp_path: Path) -> None:
    out, previous = tmp_path / "out", tmp_path / ".out.previous"
    previous.mkdir()
    (previous / "a").write_text("old")
    recover_folder(out)  # killed between the two renames
    assert (out / "a").read_text() == "old"
    previous.mkdir()
    (previous / "a").write_text("older")
    recover_folder(out)  # killed before the old one was removed, which the next writer does
    assert (out / "a").read_text() == "old"
    with replace_folder(out) as new:
        (new / "a").write_text("new")
    assert names(tmp_path) == ["out"]
    assert (out / "a").read_text() == "new"


def test_every_error_is_a_calib_error() -> None:
    assert issubclass(OutputError, CalibError)
    assert issubclass(OutputError, OSError)
