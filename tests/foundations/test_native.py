"""What libraries in C write to the terminal is heard, and nothing else changes."""

import os
import subprocess
import sys

import pytest

from calib.foundations.native import heard


def test_what_is_written_by_descriptor_is_heard_and_not_shown(capfd: pytest.CaptureFixture[str]) -> None:
    with heard() as said:
        os.write(2, b"one\ntwo\n")
    os.write(2, b"later\n")
    assert said == ["one", "two"]
    assert capfd.readouterr().err == "later\n"


def test_nothing_written_is_nothing_heard_also_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="of the block"), heard() as said:
        raise ValueError("of the block")
    os.write(2, b"later\n")
    assert (said, capfd.readouterr().err) == ([], "later\n")


def test_more_than_a_pipe_holds_is_not_waited_for() -> None:
    with heard() as said:
        for _ in range(100):
            try:
                os.write(2, b"x" * 10_000)
            except BlockingIOError:  # C's own output passes over it
                break
    assert said == ["x" * 10_000]


def test_a_process_without_standard_error_stays_without() -> None:
    code = "import os; from calib.foundations.native import heard\nwith heard() as said: os.write(2, b'x')\n"
    code += "try: os.fstat(2)\nexcept OSError: print(said)"
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" 2>&-', "sh", sys.executable, "-c", code], stdout=subprocess.PIPE, check=False
    )
    assert done.stdout == b"['x']\n"
