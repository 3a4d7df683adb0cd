"""What the commands say when a disk is full, and that older results outlive it."""

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.cases import JOB, copy_case, run, tree
from tests.support.swaps import left

MAIN = "from calib.cli import main; main()"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_standard_output_on_a_full_disk(folder: Path) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-W", "error", "-c", MAIN, "check", JOB]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    said = b"Error: standard output: cannot be written (No space left on device).\n"
    assert (done.returncode, done.stderr) == (1, said)


def test_the_exit_code_is_of_the_command_and_not_of_who_read_enough(folder: Path) -> None:
    """``calib check job | head -n 1`` under ``set -o pipefail``."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-W", "error", "-c", MAIN, "check", JOB]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_what_is_misspelt_is_so_also_on_a_full_disk(folder: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-W", "error", "-c", MAIN, "nonsense"], stderr=full, check=False)
    assert done.returncode == 2


def test_a_file_that_may_not_grow(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    before = tree(folder)
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, {resource.RLIM_INFINITY})); {MAIN}"
    command = [sys.executable, "-W", "error", "-c", limited, "calibrate", JOB, "-o", "out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    why = f"Error: {folder / 'out'}: the results cannot be written (File too large).\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", why)
    assert tree(folder) == before
    assert {path.name for path in folder.iterdir()} == (
        {JOB, "arm_cmm.urdf", "identification.csv", "out", "validation.csv"}
    )


def test_commands_read_what_an_interrupted_run_left(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    out, hidden = folder / "out", folder / ".out.0123abcd.calib"

    def kill() -> None:
        """Leave what a run does that is killed between the two steps."""
        shutil.rmtree(hidden, ignore_errors=True)
        out.rename(left(hidden, old=False) / "old")

    before = tree(out)
    for command in (
        ("compare", "out", "out"),
        ("sensitivity", JOB, "--errors", "out"),
        ("export", "out", "--to", "ros", "-o", "a.yaml"),
    ):
        kill()
        said = run(*command)
        assert (said.code, said.err) == (0, "")
        assert tree(out) == before
        assert not (hidden / "old").exists()
    kill()
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    assert tree(out) == before
    assert not hidden.exists()
