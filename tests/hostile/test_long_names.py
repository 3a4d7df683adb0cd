"""Names longer than a file system takes are refused in a sentence, as other files that are not there."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calib.foundations.errors import OutputError
from calib.foundations.files import refuse_taken
from calib.foundations.folders import refuse_unwritable, write_folder
from calib.job.calibrate import calibrate
from calib.job.inputs import STEPS_OF_LOADING
from tests.support.cases import JOB, copy_case, run

LONG = 300 * "y"


@pytest.mark.parametrize(
    "given", [("import", LONG), ("plan", LONG, "-n", "9"), ("plan", "a.urdf", "--mesh-root", LONG, "-n", "9")], ids=str
)
def test_a_name_too_long_is_refused_in_a_sentence(given: tuple[str, ...], tmp_path: Path) -> None:
    said = run(*given, "-o", tmp_path / "out.csv")
    assert said.code == 1
    assert said.err.startswith("Error: ")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("kind", [refuse_taken, refuse_unwritable])
def test_a_name_too_long_to_be_written_is_refused_before_work_is_done(
    kind: Callable[[Path], None], tmp_path: Path
) -> None:
    """The hidden name beside it is longer by 16 bytes."""
    for length in (1, 100, 239):
        kind(tmp_path / (length * "y"))
    write_folder(tmp_path / (239 * "y"), {"a": "b"})
    for name in (240 * "y", 255 * "y", 256 * "y", 80 * "\N{SNOWMAN}"):
        with pytest.raises(OutputError) as caught:
            kind(tmp_path / name)
        assert str(caught.value) == (
            f"{tmp_path / name}: its name is too long, as while it is written a hidden one beside it has 16 characters "
            "more; choose a shorter name."
        )
    assert [path.name for path in tmp_path.iterdir()] == [239 * "y"]


def test_a_long_name_below_folders_that_are_to_be_made_is_refused(tmp_path: Path) -> None:
    refuse_unwritable(tmp_path / "new" / (255 * "y") / "out")
    for path in (tmp_path / "new" / (240 * "y"), tmp_path / "new" / (256 * "y") / "out"):
        with pytest.raises(OutputError, match="its name is too long"):
            refuse_unwritable(path)


def test_a_calibration_whose_folder_has_too_long_a_name_is_not_begun(tmp_path: Path) -> None:
    copy_case(tmp_path)
    steps: list[str] = []
    with pytest.raises(OutputError, match="its name is too long"):
        calibrate(tmp_path / JOB, tmp_path / (245 * "y"), steps.append)
    assert len(steps) <= STEPS_OF_LOADING
