"""Photographs that do not belong to their readings or to their board: said, and no cause is blamed."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.assessment.blame import Blame
from calib.foundations.errors import CalibError
from calib.foundations.linear import one_thread
from calib.job.inputs import load
from calib.job.run import run
from calib.results.calibration import Calibration
from tests.support import machines
from tests.support.cameras import BOARD, TIP, UR5, Array, scene
from tests.support.cases import write_table

PHOTOGRAPHS, MARKS = 15, len(BOARD)
FREE = 'lens = "free"\nsize = [1280, 1024]\n'
GIVEN = (
    'lens = "given"\nfx = "1210 px"\nfy = "1190 px"\ncx = "655 px"\ncy = "508 px"\n'
    "k1 = -0.21\nk2 = 0.09\np1 = 8e-4\np2 = -5e-4\nk3 = -0.015\n"
)
# What nobody may say of such jobs.
CAUSES = ("lens, which is not", "size of the print", "bent or not square", "not as its URDF says")
SMALLER = "images made smaller"
Columns = dict[str, object]


def columns() -> Columns:
    """A sound table of 300 marks."""
    rng = np.random.default_rng(11)
    true = scene(rng, machines.arm(UR5, TIP), "tip")
    return true.columns(true.draw(rng, PHOTOGRAPHS), rng, 0.1)


def _readings(change: Callable[[Array], Array]) -> Callable[[Columns], Columns]:
    def changed(table: Columns) -> Columns:
        names = [name for name in table if name.endswith("[rad]")]
        new = change(np.column_stack([np.asarray(table[name]) for name in names]))
        return table | dict(zip(names, new.T, strict=True))

    return changed


def _marks(table: Columns) -> Columns:
    """Marks of each photograph by other numbers."""
    rng, names = np.random.default_rng(2), [f"board_{axis} [mm]" for axis in "xyz"]
    rows = np.concatenate([k * MARKS + rng.permutation(MARKS) for k in range(PHOTOGRAPHS)])
    return table | {name: np.asarray(table[name])[rows] for name in names}


def _smaller(table: Columns) -> Columns:
    """Images made smaller after they were taken."""
    return table | {f"{name} [px]": np.asarray(table[f"{name} [px]"]) / 4.0 for name in "uv"}


def _as_it_is(table: Columns) -> Columns:
    return table


WRONG: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "a camera that is said to stand on the floor": (_as_it_is, "floor"),
    "joints in the wrong order": (_readings(lambda J: J[:, ::-1]), "tip"),
    "readings of other photographs": (
        _readings(lambda J: np.repeat(np.random.default_rng(1).permutation(J[::MARKS]), MARKS, axis=0)),
        "tip",
    ),
    "a joint that turns the other way": (_readings(lambda J: J * [1, 1, 1, -1, 1, 1]), "tip"),
    "marks by other numbers": (_marks, "tip"),
    SMALLER: (_smaller, "tip"),
}


def calibrated(folder: Path, table: Columns, lens: str, camera_on: str) -> Calibration:
    write_table(folder / "marks.csv", {name: list(np.asarray(values)) for name, values in table.items()})
    (folder / "job.toml").write_text(
        f'schema = 1\n[robot]\nurdf = "{UR5}"\ntip = "{TIP}"\n[error_model]\noffsets = "all"\nplacements = "all"\n'
        f'base = "fixed"\ntool = "pose"\n[instruments.camera]\nkind = "camera"\ncamera_on = "{camera_on}"\n{lens}'
        '[[measurements]]\nfile = "marks.csv"\nobserves = "pixels"\ninstrument = "camera"\nhold_out = 0.25\n'
    )
    with one_thread():
        return run(load(folder / "job.toml", lambda _: None))


# A lens that is free may be that of smaller images as well.
CASES = [(wrong, lens) for wrong in WRONG for lens in (FREE, GIVEN) if (wrong, lens) != (SMALLER, FREE)]


@pytest.mark.parametrize(("wrong", "lens"), CASES, ids=[f"{wrong}, {lens[8:12]}" for wrong, lens in CASES])
def test_what_does_not_belong_together_is_said(tmp_path: Path, wrong: str, lens: str) -> None:
    change, camera_on = WRONG[wrong]
    try:
        found = calibrated(tmp_path, change(columns()), lens, camera_on)
    except CalibError as e:
        assert re.fullmatch(r"[^\n]+[.?]", str(e))
    else:
        assert not found.trusted
        assert found.blame is None or not found.blame.told or _corners(found.blame) or wrong == SMALLER


def _corners(blame: Blame) -> bool:
    return blame.named == "corners" and not any(cause in blame.sentence for cause in CAUSES)
