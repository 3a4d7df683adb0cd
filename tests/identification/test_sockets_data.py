"""Real arms with a ball in printed sockets: places that took no part in a calibration, and what moves in panda_1.

The data are not part of the project; CALIB_DATASETS names the folder that holds ``sockets``.
"""

import os
from pathlib import Path

import pytest

import calib
from scripts.studies import sockets_figures as figures

DATASETS = os.environ.get("CALIB_DATASETS")

pytestmark = pytest.mark.skipif(
    DATASETS is None, reason="CALIB_DATASETS does not name a folder of real measurements (sockets)"
)


def loaded(name: str) -> tuple[object, calib.Robot, dict[str, calib.Measurements]]:
    case = next(case for case in figures.CASES if case.name == name)
    return case, *figures.load(Path(str(DATASETS)) / "sockets" / name, case.arm)


@pytest.mark.parametrize("name", ["panda_1", "panda_3", "kuka_14"])
def test_identified_at_one_place(name: str) -> None:
    case, robot, sets = loaded(name)
    found = figures.at_one_place(case, robot, sets, elastic=False)
    assert found.after <= case.one  # type: ignore[attr-defined]
    assert found.before > 1.8 * found.after


@pytest.mark.parametrize("name", ["panda_3", "kuka_14"])
def test_each_place_left_out(name: str) -> None:
    case, robot, sets = loaded(name)
    found = figures.mean(figures.each_left_out(robot, sets, elastic=False))
    assert found.after <= case.each  # type: ignore[attr-defined]
    # A smaller arm would scatter less, and have its sockets closer.
    assert found.distance <= 0.1e-3


def test_what_moves_in_panda_1() -> None:
    _, robot, sets = loaded("panda_1")
    found = calib.judging.outliers(figures.fit(robot, sets, elastic=False)[0])
    (first, *_) = found.disagreeing
    assert (first.kind, first.name) == ("file", "back-high.csv")
    table_places = {place: sets[place] for place in ("front", "right")}
    found = calib.judging.outliers(figures.fit(robot, table_places, elastic=False)[0])
    # 22 rows of hole_1, below the header and 30 rows of hole_0, or one less.
    assert found.moved[0].target == "right/hole_1"
    assert found.moved[0].line in (52, 53)
    assert not found.disagreeing


def test_panda_3_stood_still() -> None:
    _, robot, sets = loaded("panda_3")
    found = calib.judging.outliers(figures.fit(robot, sets, elastic=False)[0])
    assert not found.moved
    assert not found.disagreeing


def test_joints_that_give_way_explain_what_back_high_asks_for() -> None:
    _, robot, sets = loaded("panda_1")
    assert not calib.judging.outliers(figures.fit(robot, sets, elastic=True)[0]).disagreeing
    found = figures.mean(figures.each_left_out(robot, sets, elastic=True))
    assert found.after <= 0.65e-3
    assert figures.mean(figures.each_left_out(robot, sets, elastic=True, split=True)).after < found.after
