"""The page as a person meets it: dropped files, the mapping, the check, progress and results in a real browser."""

import io
import os
import shutil
import signal
import zipfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from calib.robot.sources import resolve
from scripts.development.browser import CHROMIUM, Page, browser
from scripts.examples import positioner_camera_job
from tests.app.test_server import PANDA, Server
from tests.support.cases import CASE, JOB, ROOT, TABLE, URDF
from tests.support.people import UR10, session, text

DATASETS = os.environ.get("CALIB_DATASETS")
REAL = Path(DATASETS or "")
WIDTHS = [1280, 390]
RECORDINGS = ROOT / "robots" / "panda_sockets" / "recordings" / "raised"

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")
real = pytest.mark.skipif(DATASETS is None, reason="CALIB_DATASETS does not name a folder of real measurements")


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browser() as opened:
        yield opened


@pytest.fixture
def server() -> Iterator[Server]:
    served = Server()
    yield served
    served.end()


@pytest.fixture
def fresh(page: Page, server: Server) -> Page:
    page.trouble.clear()
    page.requests.clear()
    page.size(1280, 900)
    page.media(prefers_color_scheme="light")
    page.open(server.page)
    page.wait_for("document.querySelectorAll('#robot option').length > 5")
    return page


def change(page: Page, element: str, value: str | bool) -> None:
    """Change a control as a person does."""
    key = "checked" if isinstance(value, bool) else "value"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    page.evaluate(f"byId('{element}').{key} = {text}, byId('{element}').dispatchEvent(new Event('change')), true")


def settle(page: Page) -> None:
    page.wait_for("state && !state.busy && (state.look || state.sentence)")


def changed(page: Page, element: str, value: str | bool) -> None:
    page.evaluate("window.before = state, true")
    change(page, element, value)
    page.wait_for("state !== window.before")
    settle(page)


def calibrated(page: Page) -> str:
    """Press the button, wait for the verdict, and return its headline."""
    assert page.evaluate("byId('calibrate').disabled") is False, page.evaluate("state.sentence")
    page.evaluate("byId('calibrate').click(), true")
    page.wait_for("state.busy && state.busy.done > 0 && !byId('progress').hidden && !byId('cancel').disabled")
    page.wait_for("!state.busy && (state.results || state.sentence)")
    assert page.evaluate("state.sentence") == ""
    assert page.evaluate("byId('status').textContent") == "Calibrated."
    assert page.evaluate("document.activeElement.id") == "verdict"
    text: str = page.evaluate("byId('headline').textContent")
    return text


def grid(page: Page) -> dict[str, list[str]]:
    """Return column, unit and values by our names, as they are seen."""
    cells = "[...r.cells].map(c => c.firstElementChild ? c.firstElementChild.value : c.textContent)"
    rows = page.evaluate(f"[...document.querySelectorAll('#grids tbody tr')].map(r => {cells})")
    return {row[0]: row[1:] for row in rows}


def axe(page: Page) -> list[object]:
    spec = find_spec("axe_core_python")
    if spec is None or spec.submodule_search_locations is None:
        pytest.skip("axe-core-python is not installed")
    page.evaluate(Path(spec.submodule_search_locations[0], "axe.min.js").read_text(encoding="utf-8") + "; true")
    found: list[object] = page.evaluate(
        "axe.run().then(({ violations: v }) => v.map(({ id, nodes }) => [id, nodes[0].html.slice(0, 100)]))"
    )
    return found


def test_a_dropped_case_is_calibrated_and_everybody_can_read_it(fresh: Page, server: Server) -> None:
    assert axe(fresh) == []
    fresh.drop("#drop", [CASE / name for name in (URDF, TABLE)])
    settle(fresh)
    assert fresh.evaluate("state.sentence") == ""
    shown = grid(fresh)
    assert shown["x"][:2] == ["x [mm]", "mm"]
    assert "are the measured point" in fresh.evaluate("byId('why').textContent")
    assert "parameters (condition number" in fresh.evaluate("byId('determined').textContent")
    assert "better" in calibrated(fresh)
    fresh.evaluate("document.querySelectorAll('details').forEach(d => d.open = true), true")
    for width in WIDTHS:
        for scheme in ("light", "dark"):
            fresh.size(width, 900)
            fresh.media(prefers_color_scheme=scheme)
            assert axe(fresh) == []
            assert fresh.evaluate("document.documentElement.scrollWidth") <= width
    fresh.size(1280, 900)
    assert fresh.trouble == []
    assert all(address.startswith((server.origin, "data:")) for address in fresh.requests)
    # What was made can be looked at, in a sandbox, and be had.
    archive = zipfile.ZipFile(io.BytesIO(server.ask("GET", "calibration.zip")[1]))
    assert "calibration/results/calibrated.urdf" in archive.namelist()
    for name, ready in (("report", "document.querySelector('.headline')"), ("scene", "viewer.scene_tree")):
        fresh.open(f"{server.page}results/{name}.html")
        fresh.wait_for(f"Boolean({ready})")
        assert fresh.evaluate("self.origin") == "null"
    assert fresh.trouble == []


def test_a_wrong_column_is_put_right_and_cancelled_work_leaves_nothing(fresh: Page, tmp_path: Path) -> None:
    lines = (CASE / TABLE).read_text(encoding="utf-8").splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    table = tmp_path / "<b>measured<b>.csv"
    try:
        table.write_text("\n".join(lines[start:]), encoding="utf-8")
    except OSError:  # a file system that has no such names
        pytest.skip("no file can be called so")
    fresh.choose("#choose", [CASE / URDF, table])
    settle(fresh)
    # What a file is called is text.
    assert fresh.evaluate("document.querySelector('#files span').textContent") == URDF
    assert fresh.evaluate("document.querySelectorAll('#files b, #grids b').length") == 0
    first = next(iter(grid(fresh)))
    other = grid(fresh)["y"][0]
    changed(fresh, "column-0-" + str(list(grid(fresh)).index("x")), other)
    assert "Said so far: x is" in fresh.evaluate("byId('named').textContent")
    fresh.evaluate("window.before = state, byId('forget').click(), true")
    fresh.wait_for("state !== window.before")
    settle(fresh)
    assert first in grid(fresh)
    assert grid(fresh)["x"][0] == "x [mm]"
    fresh.evaluate("byId('calibrate').click(), true")
    fresh.wait_for("state.busy && state.busy.verb === 'calibrate'")
    fresh.evaluate("byId('cancel').click(), true")
    fresh.wait_for("!state.busy")
    assert fresh.evaluate("byId('status').textContent") == "Cancelled; nothing was written."
    assert fresh.evaluate("[state.results, byId('calibrate').disabled]") == [None, False]
    assert fresh.trouble == []


def test_a_hostile_file_gets_its_sentence_on_the_page(fresh: Page, tmp_path: Path) -> None:
    for name, data in (("arm.urdf", "<!DOCTYPE r [<!ENTITY a 'x'>]><robot name='&a;'/>"), ("m.csv", "a\n1\n")):
        (tmp_path / name).write_text(data)
    fresh.drop("#drop", [tmp_path / "arm.urdf", tmp_path / "m.csv"])
    settle(fresh)
    assert "arm.urdf" in fresh.evaluate("byId('sentence').textContent")
    assert fresh.evaluate("byId('sentence').getAttribute('role')") == "alert"
    assert axe(fresh) == []
    assert fresh.evaluate("byId('calibrate').disabled") is True
    (tmp_path / "run.exe").write_text("MZ")
    fresh.choose("#choose", [tmp_path / "run.exe"])
    fresh.wait_for("byId('sentence').textContent.startsWith(\"'run.exe': is no robot\")")


def test_a_file_that_is_refused_does_not_keep_the_others_from_being_taken(fresh: Page, tmp_path: Path) -> None:
    """What came behind it was not taken, and what came before not looked at."""
    for name in ("a.exe", "b.docx"):
        (tmp_path / name).write_text("MZ")
    fresh.choose("#choose", [CASE / URDF, tmp_path / "a.exe", tmp_path / "b.docx", CASE / TABLE])
    fresh.wait_for("state.files.length === 2 && !state.busy && state.look")
    assert fresh.evaluate("state.look.sound !== undefined && !byId('calibrate').disabled")
    told = fresh.evaluate("byId('left-out').textContent")
    assert "'a.exe': is no robot" in told
    assert "'b.docx': is no robot" in told
    fresh.choose("#choose", [CASE / TABLE])
    fresh.wait_for("byId('left-out').textContent === ''")


def test_what_another_window_does_is_seen_when_one_goes_to_this_one(fresh: Page, server: Server) -> None:
    """It went on to show the verdict of files that had been removed."""
    fresh.choose("#choose", [CASE / URDF, CASE / TABLE])
    settle(fresh)
    assert server.ask("DELETE", f"files/{TABLE}")[0] == 200
    fresh.evaluate("window.dispatchEvent(new Event('focus')), true")
    fresh.wait_for("state.files.length === 1 && byId('calibrate').disabled")
    assert TABLE not in fresh.evaluate("byId('files').textContent")


def test_the_keyboard_goes_through_the_page_in_its_order(fresh: Page) -> None:
    fresh.choose("#choose", [CASE / URDF, CASE / TABLE])
    settle(fresh)
    order = """[...document.querySelectorAll("a, button, input, select, summary, textarea, [tabindex='0']")]
        .filter(e => e.checkVisibility() && !e.disabled).map(e => e.id || e.textContent.slice(0, 20))"""
    expected = fresh.evaluate(order)
    fresh.evaluate("document.activeElement.blur(), true")
    reached = []
    for _ in expected:
        fresh.press("Tab")
        reached.append(fresh.evaluate("(e => e.id || e.textContent.slice(0, 20))(document.activeElement)"))
    assert reached == expected
    # After a control is changed by keys, the page is drawn anew, and the focus is where it was.
    fresh.evaluate("byId('column-0-0').focus(), true")
    changed(fresh, "column-0-0", fresh.evaluate("byId('column-0-0').value"))
    assert fresh.evaluate("document.activeElement.id") == "column-0-0"


def test_reflectors_in_a_row_are_taken_all(fresh: Page, tmp_path: Path) -> None:
    s = session()
    points = [1e3 * (s.position + s.rotation @ place) for place in ([0.0, 0.0, 0.0], [0.05, 0.0, 0.01])]
    titles = [*(f"J{k}" for k in range(1, 7)), *(f"{axis}{k}" for k in (1, 2) for axis in "xyz")]
    (tmp_path / "tracker.csv").write_text(text(titles, [np.degrees(s.readings), *points]))
    fresh.drop("#drop", [tmp_path / "tracker.csv"])
    settle(fresh)
    assert fresh.evaluate("byId('points-label').hidden")
    changed(fresh, "robot", UR10)
    assert "2 points keep their distances" in fresh.evaluate("byId('asked').textContent")
    assert not fresh.evaluate("byId('points-label').hidden")
    changed(fresh, "points", True)
    assert fresh.evaluate("byId('question').hidden && !byId('points-label').hidden")
    assert "tables/tracker_rows.csv: 'point 1', 'point 2' keep their distances" in fresh.evaluate(
        "byId('why').textContent"
    )
    assert " times better" in calibrated(fresh)
    assert axe(fresh) == []


@real
@pytest.mark.parametrize("robot", ["panda_1/front", "panda_3/frontcenter"])
def test_a_real_panda_and_printed_sockets(fresh: Page, robot: str) -> None:
    fresh.drop("#drop", [REAL / "sockets" / robot / f"hole_{k}.csv" for k in (0, 1)])
    settle(fresh)
    assert fresh.evaluate("byId('sentence').textContent").startswith("There is no robot yet")
    changed(fresh, "robot", PANDA)
    assert "no column says what was measured" in fresh.evaluate("byId('asked').textContent")
    changed(fresh, "stack", True)
    if robot.startswith("panda_1"):  # far off: rows of one socket touch one point in no unit so well as to be certain
        assert fresh.evaluate("byId('question').hidden") is False
        changed(fresh, "angles", "rad")
    shown = grid(fresh)
    assert [shown[f"panda_joint{k}"][:2] for k in range(1, 8)] == [[f"column {k}", "rad"] for k in range(1, 8)]
    assert "do not determine the size of the arm" in fresh.evaluate("byId('findings').textContent")
    assert " times better" in calibrated(fresh)


@real
def test_a_real_ur10_and_a_tracker(fresh: Page) -> None:
    fresh.choose("#choose", [REAL / "ur10_leica" / "series_b.csv"])
    settle(fresh)
    changed(fresh, "robot", "example:ur_description/urdf/ur10_robot.urdf")
    shown = grid(fresh)
    assert [shown[axis][:2] for axis in ("x", "rx")] == [["measurement_x", "mm"], ["measurement_rx", "deg"]]
    assert shown["wrist_3_joint"][:2] == ["wrist_3_joint", "rad"]
    assert "1.06 mm rms off the nominal arm" in fresh.evaluate("byId('why').textContent")
    assert " times better" in calibrated(fresh)


@real
def test_a_real_positioner_and_a_camera(fresh: Page, tmp_path: Path) -> None:
    (tmp_path / "positioner.urdf").write_text(positioner_camera_job.URDF)
    fresh.drop("#drop", [tmp_path / "positioner.urdf", REAL / "positioner_camera" / "measurements.yaml"])
    settle(fresh)
    # Metres and millimetres fit alike: the arm has no length that would tell.
    assert "lengths in m and in mm fit equally well" in fresh.evaluate("byId('asked').textContent")
    answers = fresh.evaluate("[...document.querySelectorAll('#choices button')].map(b => b.textContent)")
    fresh.evaluate(f"window.before = state, byId('choice-{answers.index('m')}').click(), true")
    fresh.wait_for("state !== window.before")
    settle(fresh)
    shown = grid(fresh)
    assert (shown["x"][1], shown["joint_1"][1]) == ("m", "rad")
    assert calibrated(fresh)


def test_photographs_of_a_board_calibrate_an_arm(fresh: Page, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    from scripts.simulate import photographs as simulation
    from tests.support.photographs import small_session

    simulation.write(tmp_path, small_session(3, 8), 3)
    files = [*sorted((tmp_path / "photographs").iterdir()), tmp_path / "board.toml", tmp_path / "readings.csv"]
    fresh.drop("#drop", files)
    settle(fresh)
    assert "readings of the joints, and there is no robot yet" in fresh.evaluate("byId('sentence').textContent")
    changed(fresh, "robot", simulation.UR5)
    assert fresh.evaluate("state.sentence") == ""
    why = fresh.evaluate("byId('why').textContent")
    assert "the tip is tool0; 'wrist_3_link', 'ee_link' would do as well" in why
    assert "corners of 8 of 8 photographs" in why
    assert "times better" in calibrated(fresh)
    assert fresh.trouble == []


def test_without_a_server_the_page_says_so(fresh: Page, server: Server) -> None:
    server.process.send_signal(signal.SIGKILL)
    server.process.wait()
    fresh.choose("#choose", [CASE / JOB])
    fresh.wait_for("byId('sentence').textContent.startsWith('The server does not answer.')")


def test_a_folder_with_meshes_is_dropped_and_the_page_goes_on_after_a_restart(page: Page, tmp_path: Path) -> None:
    robot = resolve(PANDA)
    folder = tmp_path / "panda_description"
    shutil.copytree(robot.parents[1] / "meshes" / "visual", folder / "meshes" / "visual")
    (folder / "urdf").mkdir()
    (folder / "urdf" / "arm.urdf").write_bytes(robot.read_bytes())
    for name in ("package.xml", "CMakeLists.txt", "meshes/visual/skin.png"):
        (folder / name).write_text("<package><name>panda_description</name></package>")
    server = Server("--folder", tmp_path / "work")
    try:
        page.trouble.clear()
        page.size(1280, 900)
        page.open(server.page)
        page.drop("#drop", [folder])
        settle(page)
        assert page.evaluate("state.files.map(f => f.kind).filter(k => k === 'robot').length") == 1
        meshes = len(list((folder / "meshes" / "visual").glob("*.dae")))
        assert f"{meshes} meshes" in page.evaluate("byId('files').textContent")
        assert page.evaluate("byId('left-out').textContent").startswith("3 files are left out")
        page.drop("#drop", sorted(RECORDINGS.glob("hole_*.csv")))
        page.wait_for("state.files.filter(f => f.kind === 'table').length > 1")
        settle(page)
        changed(page, "stack", True)
        why = page.evaluate("byId('why').textContent")
        assert f"arm.urdf: its {meshes} meshes were found among those that were dropped." in why
        headline = calibrated(page)
        assert axe(page) == []
        before = page.evaluate("JSON.stringify({ ...state, busy: null })")
        # The same page in the same browser, and another server in the same folder.
        page.open(server.page)
        page.wait_for("state && state.results")
        assert page.evaluate("JSON.stringify({ ...state, busy: null })") == before
        assert server.end()[0] == 0
        server = Server("--folder", tmp_path / "work")
        page.open(server.page)
        page.wait_for("state && state.results")
        assert page.evaluate("byId('headline').textContent") == headline
        assert page.evaluate("byId('stack').checked && !byId('calibrate').disabled")
        page.open(f"{server.page}results/scene.html")
        page.wait_for("Boolean(viewer.scene_tree)")
        parts = page.evaluate("(n => (nodeAt('robot').object.traverse(o => n += o.isMesh ? 1 : 0), n))(0)")
        assert parts > 2 * meshes  # the parts of the meshes, each of a colour
        assert page.trouble == []
    finally:
        server.process.kill()
        server.process.communicate()


def test_an_archive_is_dropped_and_a_robot_without_its_meshes_is_said(fresh: Page, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "arm.zip", "w") as archive:
        archive.writestr("arm/urdf/arm.urdf", resolve(PANDA).read_bytes())
        archive.writestr("arm/meshes/visual/link0.dae", b"no mesh")
    (tmp_path / "bad.zip").write_bytes(b"PK no archive")
    fresh.choose("#choose", [tmp_path / "arm.zip"])
    settle(fresh)
    assert fresh.evaluate("state.robot") == "arm.urdf"
    fresh.choose("#choose", sorted(RECORDINGS.glob("hole_*.csv")))
    fresh.wait_for("state.files.length === 4")
    settle(fresh)
    assert "9 of its 10 meshes are not among" in fresh.evaluate("byId('why').textContent")
    assert "link0.dae" in fresh.evaluate("byId('files').textContent")
    fresh.evaluate("[...document.querySelectorAll('#files button')].at(-1).click(), true")
    fresh.wait_for("state.files.length === 3 && !state.busy")
    assert "mesh" not in fresh.evaluate("byId('files').textContent")
    fresh.choose("#choose", [tmp_path / "bad.zip"])
    fresh.wait_for("byId('sentence').textContent === \"'bad.zip': is no archive that can be read.\"")
