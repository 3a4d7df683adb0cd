"""A package that is not installed is told apart from one that is, and that the system cannot load."""

import sys
from pathlib import Path

import pytest

from calib.foundations.errors import LITTLE_MEMORY, JobError, MeasurementError
from calib.foundations.lazy import needed
from calib.measurement.formats.images import opencv
from calib.measurement.formats.workbook import from_xlsx

LIBRARY = "libGL.so.1: cannot open shared object file: No such file or directory"


@pytest.mark.parametrize(
    ("met", "said"),
    [
        (ModuleNotFoundError("No module named 'one'"), "it needs one: install it."),
        (ImportError(LIBRARY), f"it needs one, which is installed and cannot be loaded: {LIBRARY}."),
        (ImportError("\nfirst\nsecond"), "it needs one, which is installed and cannot be loaded: first."),
        (ImportError("lapack.so: failed to map segment from shared object"), LITTLE_MEMORY),
    ],
)
def test_what_cannot_be_loaded_is_told_by_its_cause(met: ImportError, said: str) -> None:
    with pytest.raises(JobError) as caught, needed(JobError, "it needs one", ": install it"):
        raise met
    assert str(caught.value) == said


def test_packages_that_lack_a_library_are_not_to_be_installed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cv2", "openpyxl"):
        (tmp_path / f"{name}.py").write_text(f"raise ImportError({LIBRARY!r})\n", encoding="utf-8")
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(JobError, match="which is installed and cannot be loaded: libGL"):
        opencv()
    with pytest.raises(MeasurementError, match=r"one\.xlsx: needs the package openpyxl, which is installed and cannot"):
        from_xlsx(b"", "one.xlsx")
