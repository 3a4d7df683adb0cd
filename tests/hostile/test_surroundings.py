"""What the command line does where a full disk is behind its output, or its folder is gone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_CALIB = "import sys; sys.argv[0] = 'calib'; from calib_start import main; main()"


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_output_that_cannot_be_written_is_one_sentence(option: str) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no device that is always full")
    with full.open("w", encoding="utf-8") as out:
        said = subprocess.run(
            [sys.executable, "-c", _CALIB, option], stdout=out, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (said.returncode, said.stderr) == (
        1,
        "Error: standard output: cannot be written (No space left on device).\n",
    )


def test_a_folder_that_is_gone_is_one_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    start = f"import os; os.chdir({str(folder)!r}); os.rmdir({str(folder)!r}); {_CALIB}"
    said = subprocess.run([sys.executable, "-c", start, "--help"], capture_output=True, text=True, check=False)
    assert said.returncode == 1
    assert said.stderr == "Error: the folder in which calib was started is not there any more.\n"


@pytest.mark.parametrize(
    "met",
    [
        "MemoryError()",
        "ImportError('lapack.so: failed to map segment from shared object', name='lapack')",
        "SystemError('<function calibrate> returned NULL without setting an exception')",
    ],
)
def test_too_little_memory_is_one_sentence(met: str, tmp_path: Path) -> None:
    fails = f"import calib.robot.load as load\ndef fails(*_, **__): raise {met}\nload.load_robot = fails\n"
    said = subprocess.run(
        [sys.executable, "-c", fails + _CALIB, "plan", "none.urdf", "-o", "poses.csv"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert (said.returncode, said.stdout, said.stderr) == (
        1,
        "",
        "Error: The memory that this process may use does not suffice; see ulimit -v.\n",
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["COLUMNS", "LINES"])
@pytest.mark.parametrize("size", ["²", "9" * 5000])
def test_a_terminal_of_a_size_that_is_no_number_is_one_that_says_none(name: str, size: str, tmp_path: Path) -> None:
    said = subprocess.run(
        [sys.executable, "-c", _CALIB, "check", "no.toml"],
        env={**os.environ, name: size},
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert (said.returncode, said.stderr) == (1, "Error: no.toml: there is no such file.\n")
