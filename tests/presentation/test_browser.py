"""Scene and report as a person meets them: in a real browser, from files, without a network."""

import json
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import f as f_distribution

import calib
from calib.foundations.rigid import inverse
from calib.job.inputs import load
from calib.job.run import run
from calib.presentation.scene import render_scene
from calib.results.calibration import Calibration
from calib.results.folder import report, scene, write_results
from calib.results.scene import scene_of
from calib.robot.links import link_placements
from scripts.benchmarks import first_picture
from scripts.development.browser import CHROMIUM, Page, browser
from tests.support.cases import CASE, JOB

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")

WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def outcome() -> Calibration:
    """The IRB2400: loops, levels, many rows."""
    return run(load(CASE.parent / "irb2400" / JOB))


@pytest.fixture(scope="module")
def out(outcome: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser") / "out"
    write_results(outcome, folder)
    return folder


@pytest.fixture(scope="module")
def chromium() -> Iterator[Page]:
    with browser() as page:
        yield page


@pytest.fixture
def page(chromium: Page) -> Iterator[Page]:
    """The browser's page; whatever a test does with it, nothing goes wrong and nothing but files is asked for."""
    chromium.trouble.clear()
    chromium.requests.clear()
    chromium.media()
    yield chromium
    assert chromium.trouble == []
    assert [address[:60] for address in chromium.requests if not address.startswith(("file:", "data:", "blob:"))] == []


def pixels(page: Page, file: Path) -> Any:
    from PIL import Image

    page.screenshot(file)
    return np.asarray(Image.open(file).convert("RGB")).astype(int)


# Both. ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["report", "scene"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_axe_finds_nothing_that_shuts_people_out(page: Page, out: Path, name: str, scheme: str, width: int) -> None:
    axe = find_spec("axe_core_python")
    if axe is None or axe.submodule_search_locations is None:
        pytest.skip("axe-core-python is not installed")
    page.size(width, 800)
    page.media(prefers_color_scheme=scheme)
    page.open((out / f"{name}.html").as_uri())
    page.evaluate(Path(axe.submodule_search_locations[0], "axe.min.js").read_text(encoding="utf-8") + "; true")
    found = "axe.run().then(({ violations: v }) => v.map(({ id, nodes }) => [id, nodes[0].html.slice(0, 100)]))"
    assert page.evaluate(found) == []


# The report. ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", WIDTHS)
def test_report_is_as_wide_as_the_window_and_its_tables_scroll_in_their_boxes(
    page: Page, out: Path, width: int, tmp_path: Path
) -> None:
    page.size(width, 800)
    page.open((out / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == width
    outside = """[...document.querySelectorAll("body *")].filter(e => e.getBoundingClientRect().right > innerWidth + 1
        && !e.closest(".scroll, pre")).map(e => e.outerHTML.slice(0, 80))"""
    assert page.evaluate(outside) == []
    # The picture is not empty: words, and the green of the verdict.
    picture = pixels(page, tmp_path / "report.png")
    assert picture.shape == (800, width, 3)
    assert (np.abs(picture - (20, 113, 63)).max(axis=2) < 12).sum() > 200


def test_report_says_what_the_result_says(page: Page, out: Path) -> None:
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))
    page.size(1280, 800)
    page.open((out / "report.html").as_uri())
    before, after = (found["metrics"]["validation"][when]["position"] for when in ("before", "after"))
    said = page.evaluate("document.querySelector('#verdict .headline').innerText")
    numbers = [float(x) for x in re.findall(r"\d+(?:\.\d+)?", said)]
    assert numbers == [
        round(before["rms"] / after["rms"]),
        after["n"],
        round(1e3 * before["rms"], 4),
        round(1e3 * after["rms"], 4),
    ]
    assert page.evaluate("document.querySelector('#verdict').className") == "verdict"  # not doubted, as the result
    assert found["trusted"]
    rows = page.evaluate(
        "[...document.querySelectorAll('#errors tbody tr')].map(r => [...r.cells].map(c => c.innerText))"
    )
    for use, when, n, *figures, unit in rows:
        m = found["metrics"][use][when]["position"]
        assert (int(n), unit) == (m["n"], "mm")
        assert [float(x) for x in figures] == [round(1e3 * m[name], 4) for name in ("mean", "rms", "p95", "max")]
    assert len(rows) == 4
    names = page.evaluate("[...document.querySelectorAll('#parameters tbody tr')].map(r => r.cells[0].innerText)")
    assert names == [record["name"] for record in found["parameters"]]


def test_report_can_be_read_in_light_in_dark_and_on_paper(page: Page, out: Path) -> None:
    """Text and marks against what lies behind them, by the contrast of WCAG 2: 4.5 for words, 3 for marks."""
    contrast = """(() => {
      const luminance = c => c.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
        .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
        .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
      const behind = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor;
        if (!/, 0\\)$/.test(c)) return c; } return "rgb(255, 255, 255)"; };
      const ratio = (a, b) => { const [x, y] = [luminance(a), luminance(b)].sort((p, q) => q - p);
        return (x + 0.05) / (y + 0.05); };
      const worst = (selector, kind) => Math.min(...[...document.querySelectorAll(selector)]
        .map(e => ratio(getComputedStyle(e)[kind], behind(e))));
      return { words: worst("h1, h2, h3, p, td, th, a, dt, dd, li, figcaption, pre", "color"),
        svg: worst("svg text", "fill"), marks: worst("svg .dot, svg .line", "color") };
    })()"""
    page.size(1280, 800)
    for medium, scheme in (("", "light"), ("", "dark"), ("print", "dark")):
        page.media(medium, prefers_color_scheme=scheme)
        page.open((out / "report.html").as_uri())
        found = page.evaluate(contrast)
        assert found["words"] > 4.5, (medium, scheme)
        assert found["svg"] > 4.5, (medium, scheme)
        assert found["marks"] > 3.0, (medium, scheme)
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (paper == "rgb(255, 255, 255)") == (scheme == "light" or medium == "print")


def test_the_first_page_on_paper_holds_the_certificate_and_nothing_else(page: Page, out: Path) -> None:
    page.size(718, 1047)  # A4 within margins of 1 cm
    page.open((out / "report.html").as_uri())
    bottom = "document.getElementById('certificate').getBoundingClientRect().bottom"
    assert page.evaluate(bottom) == 0.0  # on a screen it would say all twice
    page.media("print")
    assert 300.0 < page.evaluate(bottom) < 1047.0
    assert page.evaluate("getComputedStyle(document.getElementById('certificate')).breakAfter") == "page"
    assert page.evaluate("document.documentElement.scrollWidth") == 718
    hashes = json.loads((out / "result.json").read_text(encoding="utf-8"))["inputs"]
    said = page.evaluate("document.getElementById('certificate').innerText")
    assert all(sha in said for sha in hashes.values())


def test_marks_of_the_report_have_colours(page: Page, out: Path) -> None:
    page.size(1280, 800)
    page.media(prefers_color_scheme="light")
    page.open((out / "report.html").as_uri())
    colours = """name => [...new Set([...document.querySelectorAll("svg ." + name)]
        .map(e => getComputedStyle(e).color))]"""
    found = [page.evaluate(f"({colours})('{name}')") for name in ("before", "after", *(f"scale-{k}" for k in range(6)))]
    assert all(len(colour) == 1 for colour in found)
    assert len({colour[0] for colour in found}) == 8


# The scene. -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", WIDTHS)
def test_scene_opens_and_draws(page: Page, out: Path, width: int, tmp_path: Path) -> None:
    page.size(width, 800)
    page.open((out / "scene.html").as_uri())
    page.evaluate("new Promise(done => setTimeout(done, 300))")
    picture = pixels(page, tmp_path / "scene.png")
    orange = (picture[:, :, 0] > 150) & (picture[:, :, 1] < 110) & (picture[:, :, 2] < 60)
    legend = page.evaluate("document.getElementById('legend').getBoundingClientRect().toJSON()")
    a, b = int(legend["top"]), int(legend["bottom"])
    orange[a:b, int(legend["left"]) : int(legend["right"])] = False
    assert orange.sum() > 0.004 * orange.size  # the arm is orange, and not under the legend
    assert page.evaluate("document.getElementById('legend').scrollWidth <= innerWidth")


def test_links_stand_where_python_puts_them(page: Page, out: Path, outcome: Calibration) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    for row in (0, 250):
        page.evaluate(f"pose.value = {row}; pose.dispatchEvent(new Event('input')); true")
        for name, arm in (("robot", s.calibrated), ("nominal", s.nominal)):
            shift = inverse(s.calibrated.root) @ arm.root
            links = link_placements(s.urdf, arm)
            for link in ("rod_end", "rear_lever_pin", "tool0", "lower_arm"):
                node = f"viewer.scene_tree.find(['{name}', '{link}']).object"
                matrix = page.evaluate(f"{node}.updateMatrix(), {node}.matrix.elements")
                found = np.array(matrix).reshape(4, 4).T
                np.testing.assert_allclose(found, shift @ links[link][row], atol=5e-6)
        said = page.evaluate("document.getElementById('row').innerText")
        before, after = (1e3 * np.linalg.norm((x - s.measured)[row]) for x in (s.before, s.after))
        assert said == f"Pose {row + 1} of 492, {s.rows[row]}: before {before:.3f} mm, after {after:.3f} mm"


def in_order(page: Page, drawn: Any) -> Any:
    """Return what is drawn of each row, in the order of the rows."""
    found = np.empty_like(drawn)
    found[page.evaluate("spread")] = drawn
    return found


def test_vectors_lead_from_the_points_to_the_magnified_predictions(page: Page, out: Path, outcome: Calibration) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    to_base = inverse(s.calibrated.root)
    measured = s.measured @ to_base[:3, :3].T + to_base[:3, 3]

    def corners(path: str) -> Any:
        node = f"viewer.scene_tree.find({path}).object"
        parts = "n => (n.children[0] ? n.children : [n]).map(m => [...m.geometry.attributes.position.array])"
        found = page.evaluate(f"({parts})({node})")
        return [in_order(page, np.array(flat).reshape(492, -1, 3)) for flat in found]

    (dots,) = corners("['measured', '<object>']")
    np.testing.assert_allclose(dots.mean(axis=1), measured, atol=2e-6)
    cases = [(name, scale) for scale in (s.scales[0], 1000.0, 1.0) for name in ("before", "after")]
    for name, scale in cases:
        turned = page.evaluate("page.factors").index(scale)
        page.evaluate(f"turns.value = {turned}; turns.dispatchEvent(new Event('input')); true")
        assert page.evaluate(f"document.getElementById('drawn-{name}').innerText") == f"×{scale:.0f}"
        errors = ((s.before if name == "before" else s.after) - s.measured) @ to_base[:3, :3].T
        sticks, ends = corners(f"['{name}', '<object>']")
        drawn = measured + scale * errors
        np.testing.assert_allclose(ends.mean(axis=1), drawn, atol=1e-5)
        np.testing.assert_allclose(sticks.mean(axis=1), (measured + drawn) / 2, atol=5e-3 * np.ptp(measured))
        along = np.einsum("nij,nj->ni", sticks - measured[:, None], errors / np.linalg.norm(errors, axis=1)[:, None])
        np.testing.assert_allclose(np.ptp(along, axis=1), scale * np.linalg.norm(errors, axis=1), atol=1e-5)


def test_colours_tell_the_direction_or_the_table_of_errors(page: Page, out: Path, outcome: Calibration) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    assert page.evaluate("[...colour.options].map(option => option.value)") == ["error", "direction", "table"]

    def chosen(by: str, cloud: str) -> Any:
        page.evaluate(f"colour.value = '{by}'; colour.dispatchEvent(new Event('change')); true")
        mesh = f"viewer.scene_tree.find(['{cloud}', '<object>']).object.children[1]"
        flat = np.array(page.evaluate(f"[...{mesh}.geometry.attributes.color.array]"))
        kinds = np.array(page.evaluate("KINDS.map(colour => colour.toArray())"))
        seen = in_order(page, flat.reshape(492, -1, 3))[:, 0]
        return np.abs(seen[:, None] - kinds).sum(axis=2).argmin(axis=1), np.abs(seen[:, None] - kinds).sum(axis=2).min()

    for cloud, predicted in (("before", s.before), ("after", s.after)):
        kinds, off = chosen("direction", cloud)
        errors = (predicted - s.measured) @ s.calibrated.root[:3, :3]
        largest = np.abs(errors).argmax(axis=1)
        assert off < 1e-6
        np.testing.assert_array_equal(kinds, 2 * largest + (errors[np.arange(492), largest] < 0.0))
        assert page.evaluate("key.innerText").split() == ["+x", "−x", "+y", "−y", "+z", "−z"]
        kinds, _ = chosen("table", cloud)
        files = page.evaluate("key.innerText").split()
        assert [files[k] for k in kinds] == [row.split(" line ")[0] for row in s.rows]
    assert page.evaluate("getComputedStyle(document.getElementById('magnitude')).display") == "none"


def test_regions_are_as_large_as_stated_and_stand_where_the_errors_end(
    page: Page, out: Path, outcome: Calibration
) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    flat = page.evaluate(
        "[...viewer.scene_tree.find(['regions', '<object>']).object.geometry.attributes.position.array]"
    )
    corners = np.array(flat).reshape(len(s.regions), -1, 3)
    to_base, factor = inverse(s.calibrated.root), s.scales[0]
    data = np.concatenate([judged.data.readings for judged in outcome.sets])
    for (n, _), drawn in zip(s.regions.items(), corners, strict=True):
        centre = to_base[:3, :3] @ (s.measured[n] + factor * (s.after - s.measured)[n]) + to_base[:3, 3]
        sure = calib.judging.tool_uncertainty(outcome.machine, data[n : n + 1])
        R = s.calibrated.root[:3, :3]
        C = R.T @ sure.covariance[0, :3, :3] @ R
        off = (drawn - centre) / factor
        reached = np.einsum("ni,ij,nj->n", off, np.linalg.inv(C), off)
        bound = f_distribution.ppf(0.95, 3, sure.degrees_of_freedom) * 3.0
        np.testing.assert_allclose(reached, bound, rtol=5e-3)


def test_thousands_of_points_are_points_of_the_card(page: Page, tmp_path: Path) -> None:
    many = first_picture.scene(2500)
    (tmp_path / "many.html").write_text(render_scene(many), encoding="utf-8")
    page.size(1280, 800)
    page.open((tmp_path / "many.html").as_uri())
    for name, where in (("measured", many.measured), ("before", many.measured + 20.0 * (many.before - many.measured))):
        found = "[...(node.isPoints ? node : node.children[1]).geometry.attributes.position.array]"
        flat = page.evaluate(f"(node => {found})(viewer.scene_tree.find(['{name}', '<object>']).object)")
        np.testing.assert_allclose(in_order(page, np.array(flat).reshape(-1, 3)), where, atol=1e-5)
    picture = pixels(page, tmp_path / "many.png")
    assert (picture.max(axis=2) - picture.min(axis=2) > 90).sum() > 3000  # errors in colours


def test_less_is_drawn_while_a_slow_machine_moves_and_all_of_it_at_rest(page: Page, tmp_path: Path) -> None:
    (tmp_path / "many.html").write_text(render_scene(first_picture.scene(2500)), encoding="utf-8")
    page.size(1280, 800)
    page.open((tmp_path / "many.html").as_uri())
    page.wait_for("moved === 0 && nodeAt('nominal').object.visible")
    count = (
        "(viewer.render(), (({ triangles, lines, points }) => [triangles, lines, points])(viewer.renderer.info.render))"
    )
    whole = page.evaluate(f"late = 0, {count}")
    # It is late with three pictures, then the camera is turned.
    light = page.evaluate(f"late = 3, viewer.controls.dispatchEvent({{ type: 'change' }}), {count}")
    assert light[0] < 0.2 * whole[0]
    assert light[1] < 0.5 * whole[1]
    assert 300 < light[2] < 0.5 * whole[2]
    width = "viewer.renderer.domElement.width"
    assert page.evaluate(width) == 1280 / 2
    # In pictures that take long it does not rest: it is turned on in each of them.
    turned = """new Promise(done => {
        let n = 0, least = Infinity, change = () => viewer.controls.dispatchEvent({ type: "change" });
        requestAnimationFrame(function next() {
            const end = performance.now() + 200;
            while (performance.now() < end);
            change(), least = Math.min(least, light);
            if (++n < 5) requestAnimationFrame(next); else done(least);
        });
    })"""
    assert page.evaluate(turned) == 1
    assert page.evaluate("spread.length === new Set(spread).size")
    page.wait_for("moved === 0")
    assert page.evaluate(count) == whole
    assert page.evaluate(width) == 1280
    assert page.trouble == []


def test_parallelogram_moves_when_it_is_played(page: Page, out: Path) -> None:
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    rod = "viewer.scene_tree.find(['robot', 'rod']).object.quaternion.toArray()"
    first = page.evaluate(rod)
    page.evaluate("play.click(); true")
    page.wait_for("at > 0.5")
    assert np.abs(np.array(page.evaluate(rod)) - first).max() > 1e-3
    page.evaluate("play.click(); true")
    assert page.evaluate("playing") == 0
    assert page.evaluate("Number.isInteger(at)")


def test_every_layer_has_its_switch(page: Page, out: Path) -> None:
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    layers = page.evaluate("boxes.map(box => box.dataset.layer)")
    assert layers == ["measured", "before", "after", "robot", "nominal", "regions", "frames", "labels", "Grid"]
    # Where there are many, regions hide what else there is to see: they are shown when asked for.
    assert page.evaluate("viewer.scene_tree.find(['regions']).object.visible") is False
    page.evaluate("boxes.find(box => box.dataset.layer === 'regions').click(); true")
    for layer in layers:
        shown = (
            "labels.filter(l => l.element.style.display === '').length > 0"
            if layer == "labels"
            else f"viewer.scene_tree.find({layer.split('/')!r}).object.visible"
        )
        click = f"boxes.find(box => box.dataset.layer === '{layer}').click(), viewer.render(), {shown}"
        assert page.evaluate(shown) is True, layer
        assert page.evaluate(click) is False, layer
        assert page.evaluate(click) is True, layer
    # What is hidden stays hidden when it is drawn anew.
    page.evaluate("boxes.find(box => box.dataset.layer === 'after').click(); turns.value = 0; true")
    page.evaluate("turns.dispatchEvent(new Event('input')); true")
    assert page.evaluate("viewer.scene_tree.find(['after']).object.visible") is False


POINT_ON_SCREEN = """(n => {
    const p = new THREE.Vector3(...measured[n]).applyMatrix4(viewer.scene.matrixWorld).project(camera);
    return [(p.x + 1) / 2 * pane.offsetWidth, (1 - p.y) / 2 * innerHeight]; })"""


def test_a_point_tells_its_row_and_takes_the_arm_there(page: Page, out: Path, outcome: Calibration) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    page.evaluate("new Promise(done => setTimeout(done, 300))")
    n = 250
    x, y = page.evaluate(f"{POINT_ON_SCREEN}({n})")
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        page.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)
        if kind == "mouseMoved":
            page.wait_for("told.style.display === 'block'")
            before, after = (1e3 * np.linalg.norm((p - s.measured)[n]) for p in (s.before, s.after))
            assert page.evaluate("told.innerText") == f"{s.rows[n]}: {before:.3f} mm before, {after:.3f} mm after"
    page.wait_for(f"pose.value === '{n}'")
    reached = page.evaluate(
        "viewer.render(), new THREE.Vector3(...measured[250]).applyMatrix4(viewer.scene.matrixWorld)"
    )
    tip = np.array(
        page.evaluate("viewer.scene_tree.find(['frames', 'tip', 'tools', 'tool']).object.matrixWorld.elements")
    )
    assert np.linalg.norm(tip[12:15] - [reached[axis] for axis in "xyz"]) < 1e-3  # within the error that is left
    said = page.evaluate("document.getElementById('joints').innerText")
    readings = [float(value) for value in re.findall(r"\xa0(-?\d+\.\d+)\xa0deg", said)]
    assert readings == pytest.approx(s.readings[n], abs=5.1e-3)
    # Beside all points nothing is told.
    page.ask("Input.dispatchMouseEvent", type="mouseMoved", x=1270, y=10)
    page.wait_for("told.style.display === 'none'")


def test_views_look_along_the_axes_and_a_bar_is_as_long_as_it_says(page: Page, out: Path) -> None:
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    for view, axis in (("front", [1, 0, 0]), ("side", [0, -1, 0]), ("top", [0, 0, 1])):
        page.evaluate(f"document.querySelector('[data-view={view}]').click(), viewer.render(), true")
        x, y, z = page.evaluate("camera.position.clone().sub(viewer.controls.target).normalize().toArray()")
        np.testing.assert_allclose([x, -z, y], axis, atol=1e-3)  # three.js has y up
        # What lies in the plane of the middle is seen as long as the bar says.
        ends = page.evaluate(
            """(() => { const right = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0);
            const middle = viewer.controls.target;
            return [0, 1].map(k => middle.clone().addScaledVector(right, 0.1 * k).project(camera).x); })()"""
        )
        text, width = page.evaluate("[bar.innerText, bar.getBoundingClientRect().width - 4]")
        metres = float(text.split()[0]) * (1.0 if text.endswith(" m") else 1e-3)
        assert (ends[1] - ends[0]) * 640 / 0.1 == pytest.approx(width / metres, rel=0.02)


def test_views_look_along_the_tool_and_from_the_instrument(page: Page, out: Path, outcome: Calibration) -> None:
    s = scene_of(outcome)
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    to_base = inverse(s.calibrated.root)
    tip = link_placements(s.urdf, s.calibrated)["tool0"][0, :3, 2]
    for view in ("along the tool", "from the instrument"):
        page.evaluate(f"document.querySelector('[data-view=\"{view}\"]').click(), viewer.render(), true")
        x, y, z = page.evaluate("camera.position.clone().sub(viewer.controls.target).normalize().toArray()")
        whence = np.array([x, -z, y])
        if view == "along the tool":
            np.testing.assert_allclose(whence, -tip / np.linalg.norm(tip), atol=1e-3)
        else:
            middle = page.evaluate("middle().toArray()")
            way = to_base[:3, 3] - np.array([middle[0], -middle[2], middle[1]])
            np.testing.assert_allclose(whence, way / np.linalg.norm(way), atol=1e-3)


def test_a_notebook_shows_report_and_scene_in_place(page: Page, outcome: Calibration, tmp_path: Path) -> None:
    page.size(1280, 800)
    for kind, show in (("report", report), ("scene", scene)):
        text = show(outcome)
        assert text.startswith("<!DOCTYPE html>")
        file = tmp_path / f"{kind}.html"
        file.write_text(f"<!DOCTYPE html><meta charset=utf-8>{text._repr_html_()}", encoding="utf-8")
        page.open(file.as_uri())
        page.evaluate("new Promise(done => setTimeout(done, 1500))")
        picture = pixels(page, tmp_path / f"{kind}.png")[:640]
        if kind == "report":  # the green of the verdict
            assert (np.abs(picture - (20, 113, 63)).max(axis=2) < 12).sum() > 200
        else:  # the arm
            orange = (picture[:, :, 0] > 150) & (picture[:, :, 1] < 110) & (picture[:, :, 2] < 60)
            assert orange[:, 340:].sum() > 0.004 * orange.size


def test_every_input_of_the_scene_has_a_name(page: Page, out: Path) -> None:
    page.size(1280, 800)
    page.open((out / "scene.html").as_uri())
    unnamed = """[...document.querySelectorAll("input, select, button")].filter(e => !(e.ariaLabel || e.innerText ||
        (e.labels && [...e.labels].some(l => l.innerText.trim())))).map(e => e.outerHTML)"""
    assert page.evaluate(unnamed) == []
    assert page.evaluate("document.querySelectorAll('.dg').length") == 0


def test_the_scene_in_the_dark_can_be_read(page: Page, out: Path, tmp_path: Path) -> None:
    page.size(1280, 800)
    page.media(prefers_color_scheme="light")
    page.open((out / "scene.html").as_uri())
    shades = "[...document.querySelectorAll('#scale b, i[data-shade]')].map(e => getComputedStyle(e).backgroundColor)"
    light = page.evaluate(shades)
    page.media(prefers_color_scheme="dark")  # the page follows while it is open
    page.wait_for(f"JSON.stringify({shades}) !== {json.dumps(json.dumps(light, separators=(',', ':')))}")
    page.evaluate("new Promise(done => setTimeout(done, 300))")
    picture = pixels(page, tmp_path / "dark.png")
    assert np.median(picture) < 60
    for shade in page.evaluate(shades):
        rgb = np.array([int(v) for v in re.findall(r"\d+", shade)[:3]])
        assert rgb.max() > 180, shade


@pytest.mark.parametrize("width", WIDTHS)
def test_names_keep_off_each_other_and_inside_the_window(page: Page, out: Path, width: int) -> None:
    page.size(width, 800)
    page.open((out / "scene.html").as_uri())
    for row in (0, 40, 250):
        boxes = page.evaluate(
            f"show({row}), viewer.render(), labels.filter(l => l.element.style.display === '')"
            ".map(l => l.element.getBoundingClientRect()).map(r => [r.left, r.top, r.right, r.bottom])"
        )
        assert len(boxes) >= 3
        for k, a in enumerate(boxes):
            assert a[0] >= 0
            assert a[2] <= width
            for b in boxes[:k]:
                assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
