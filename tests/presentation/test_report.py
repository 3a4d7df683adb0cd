"""The report: what its charts draw, what its parts say, and that the page, Markdown and terminal say the same."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from calib.job.inputs import load
from calib.job.run import run
from calib.presentation.console import drawn, short_report
from calib.presentation.report.charts import Axis, Bars, Curve, Points, chart, linear, logarithmic, map_of, matrix
from calib.presentation.report.document import Picture, Prose, Report, Row, Section, Sheet, Verdict
from calib.presentation.report.markdown import render_markdown
from calib.presentation.report.page import render_page
from calib.presentation.report.sections import correlations
from calib.presentation.sheets import in_urdf_sentences, signed
from calib.presentation.tables import plain
from calib.results.calibration import Calibration
from calib.results.folder import result
from calib.results.report import report_of
from tests.support.cases import CASE, JOB

UNIT = Axis("u", 0.0, 1.0)
NASTY = 'a|b <script>alert(1)</script> & "q" `x` *y*'


@pytest.fixture(scope="module")
def outcome() -> Calibration:
    return run(load(CASE / JOB))


@pytest.fixture(scope="module")
def report(outcome: Calibration) -> Report:
    return report_of(outcome)


class Reader(HTMLParser):
    """Every element's attributes and every text of a page, and whether what is opened is closed."""

    EMPTY = ("meta", "path", "rect", "br")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data.strip())


def dots(svg: str, name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The places (n, 2) of the dots of one class, as drawn."""
    (d,) = re.findall(rf'<path class="dot {name}"[^>]* d="([^"]*h0)"', svg)
    return np.array([tuple(map(float, xy)) for xy in re.findall(r"M(\S+) (\S+?)h0", d)])


def test_dots_are_drawn_where_their_values_lie() -> None:
    x, y = np.array([0.0, 0.5, 1.0]), np.array([1.0, 10.0, 100.0])
    drawn = dots(chart(UNIT, Axis("v", 1.0, 100.0, log=True), [Points("after", x, y)]), "after")
    assert drawn[1] == pytest.approx((drawn[0] + drawn[2]) / 2, abs=0.1)  # the middle of both scales
    assert drawn[0, 0] < drawn[2, 0]
    assert drawn[0, 1] > drawn[2, 1]  # up is down in a picture


def test_a_map_has_one_scale_for_both_axes_and_shows_the_worst_last() -> None:
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])
    svg = map_of(points, ("x", "y"), np.array([0.0, 0.4, 1.0]), "mm")
    a, b, c = (dots(svg, f"scale-{k}")[-1] for k in (0, 2, 5))
    assert (b - a)[0] == pytest.approx(2 * (b - c)[1], abs=0.3)
    assert svg.index('class="dot scale-0"') < svg.index('class="dot scale-5"')
    assert ">1 mm<" in svg


def test_bars_stand_on_zero_and_lines_pass_their_points() -> None:
    edges, heights = np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0])
    svg = chart(UNIT, UNIT, [Bars("before", edges, heights), Curve("after", edges, edges)])
    (bar,) = re.findall(r'class="bar before" d="([^"]*)"', svg)
    assert bar.count("M") == 1  # nothing is drawn for an empty bin
    (line,) = re.findall(r'class="line after" d="M([^"]*)"', svg)
    places = [tuple(map(float, xy.split())) for xy in line.split("L")]
    assert np.ptp(np.diff(places, axis=0), axis=0) == pytest.approx([0.0, 0.0], abs=0.11)


@pytest.mark.parametrize("values", [[], [0.0], [3.0, 3.0], [-4.0, 5e6], [1e-9, 2e-9], [0.0, 1e-30]])
@pytest.mark.parametrize("make", [linear, logarithmic])
def test_axes_take_in_what_is_shown(make: object, values: list[float]) -> None:
    axis = make("x", np.array(values))  # type: ignore[operator]
    assert axis.low < axis.high
    assert 1 <= len(axis.ticks()) <= 12
    for value in values:
        if value > 0.0 or not axis.log:
            assert axis.low <= value <= axis.high
    assert np.isfinite(axis.place(np.array([axis.low, axis.high]))).all()


def test_a_matrix_is_as_strong_as_its_numbers() -> None:
    r = np.array([[1.0, 0.0, 0.0], [0.75, 1.0, 0.0], [-0.5, 0.01, 1.0]])
    svg = matrix(r, ["a", "b<", "c"])
    assert re.findall(r'<rect class="(\w+)"[^>]*fill-opacity="([\d.]+)"', svg) == [
        ("after", "0.45"),
        ("before", "0.30"),
    ]
    assert "b&lt;" in svg


def test_the_verdict_is_of_data_held_out(outcome: Calibration, report: Report) -> None:
    after = outcome.metrics["validation"]["after"]["position"]
    before = outcome.metrics["validation"]["before"]["position"]
    assert report.verdict.trusted
    said = report.verdict.headline
    assert said.startswith(f"{before.rms / after.rms:.0f} times better: on 30 held-out rows")
    assert f"from {before.rms * 1e3:.4f} mm to {after.rms * 1e3:.4f} mm rms" in said
    doubted = report_of(replace(outcome, doubts=("It is wrong.",))).verdict
    assert (doubted.trusted, doubted.reasons) == (False, ("Not to be trusted: It is wrong.",))
    own = replace(outcome, metrics={"identification": outcome.metrics["identification"]})
    alone = report_of(own).verdict
    assert "60 fitted rows" in alone.headline
    assert "no data were held out" in alone.reasons[0]


def test_no_better_is_said_so(outcome: Calibration) -> None:
    swapped = {use: {"before": whens["after"], "after": whens["before"]} for use, whens in outcome.metrics.items()}
    said = report_of(replace(outcome, metrics=swapped)).verdict.headline
    assert said.startswith("No better: on 30 held-out rows")


def test_every_part_of_the_issue_is_there(report: Report) -> None:
    keys = [section.key for section in report.sections]
    assert keys == [
        *("errors", "checks", "distribution", "poses", "joints", "workspace", "outliers", "budget", "parameters"),
        *("correlations", "rank", "noise", "provenance"),
    ]
    pictures = [block for section in report.sections for block in section.blocks if isinstance(block, Picture)]
    assert len(pictures) == 2 + 2 + 6 + 2 + 1 + 1 + 1


def test_a_check_is_said_in_words_beside_its_figure_and_a_terminal_has_the_figures(report: Report) -> None:
    (on_pages,) = [sheet for section in report.sections if section.key == "checks" for sheet in section.blocks]
    sheets = [block for block in report.brief() if isinstance(block, Sheet)]
    (in_terminal,) = [sheet for sheet in sheets if sheet.title == "Checks of the verdict"]
    assert isinstance(on_pages, Sheet)
    assert [row.cells[:-1] for row in on_pages.rows] == [row.cells for row in in_terminal.rows]
    assert on_pages.columns[:-1] == in_terminal.columns
    assert on_pages.rows[0].cells[-1] == "The solver converged."


def test_angles_of_a_base_are_said_to_be_no_whole_orientation(outcome: Calibration, report: Report) -> None:
    said = "rx, ry and rz of a base, a tool or a target turn it from where the search began"
    turned = np.max(np.abs([outcome.fit.value(f"base.{angle}") for angle in ("rx", "ry", "rz")]))
    assert turned < 0.1 < np.arccos(0.5 * (np.trace(outcome.machine.base[:3, :3]) - 1.0))
    assert said in render_page(report)
    assert said in render_markdown(report)


def test_correlations_are_of_the_parameters_that_are_seen(outcome: Calibration) -> None:
    section = correlations(outcome.fit)
    assert section is not None
    (sheet,) = [block for block in section.blocks if isinstance(block, Sheet)]
    names = [parameter.name for parameter in outcome.fit.parameters]
    for first, second, shown in (row.cells for row in sheet.rows):
        i, j = names.index(first), names.index(second)
        assert not outcome.fit.unidentifiable[[i, j]].any()
        C = outcome.fit.told_covariance(np.array([i, j]))
        assert float(shown) == pytest.approx(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]), abs=6e-4)
    strengths = [abs(float(row.cells[2])) for row in sheet.rows]
    assert strengths == sorted(strengths, reverse=True)


def test_many_parameters_are_drawn_by_those_that_correlate_most(
    outcome: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.presentation.report.sections._MOST_CORRELATED", 8)
    section = correlations(outcome.fit)
    assert section is not None
    (picture,) = [block for block in section.blocks if isinstance(block, Picture)]
    assert picture.svg.count('class="diagonal"') == 8
    assert "Drawn are the 8 parameters that correlate most, of " in picture.alternative
    (sheet,) = [block for block in section.blocks if isinstance(block, Sheet)]
    for first, second, shown in (row.cells for row in sheet.rows[:4]):
        pair = {f"<title>{first}, {second}: {shown}</title>", f"<title>{second}, {first}: {shown}</title>"}
        assert any(title in picture.svg for title in pair)


@pytest.mark.parametrize(
    ("value", "said"), [(-4e-5, "0.0000"), (4e-5, "0.0000"), (0.0, "0.0000"), (-6e-5, "-0.0001"), (2.0, "+2.0000")]
)
def test_what_is_rounded_to_nothing_has_no_sign(value: float, said: str) -> None:
    assert signed(value, 4) == said


def test_the_report_says_what_the_job_says_of_the_robot_and_leads_to_the_scene(outcome: Calibration) -> None:
    about = {"date": "2025-03-31", "serial": "24-10 <7>", "operator": "A | B"}
    told = report_of(replace(outcome, origin=replace(outcome.origin, about=about)), (("The scene", "scene.html"),))
    reader = Reader(render_page(told))
    for name, said in about.items():
        assert reader.texts[reader.texts.index(name) + 1] == said
    assert [a["href"] for _, a in reader.elements if not (a.get("href") or "#").startswith("#")] == ["scene.html"]
    markdown = render_markdown(told)
    assert "- operator: A \\| B" in markdown
    assert "[The scene](scene.html)" in markdown


def test_the_first_page_on_paper_is_a_certificate(report: Report) -> None:
    titles = [sheet.title for sheet in report.certificate()]
    assert titles == ["Tip errors, measured minus predicted", "Budget of the tool, in the instrument's frame", "Inputs"]


def cells(report: Report) -> Iterator[str]:
    for section in report.sections:
        for block in section.blocks:
            if isinstance(block, Sheet):
                yield from (cell for row in block.rows for cell in row.cells)


def test_page_markdown_and_terminal_say_the_same(report: Report) -> None:
    page, markdown = render_page(report), render_markdown(report)
    texts = set(Reader(page).texts)
    plainly = re.sub(r"\\(.)", r"\1", markdown)
    for cell in cells(report):
        assert cell in texts
        assert f"| {cell} |" in plainly
    for section in report.sections:
        assert section.title in texts
        assert f"\n## {section.title}\n" in plainly
    from rich.console import Group

    terminal = plain(Group(*map(drawn, short_report(report))))
    assert max(map(len, terminal.splitlines())) <= 80
    for sheet in (block for block in report.brief() if isinstance(block, Sheet)):
        for row in sheet.rows:
            assert re.search(r" +".join(map(re.escape, row.cells)), terminal)
    assert report.verdict.headline in terminal.replace("\n", " ")


def test_numbers_are_those_of_the_result(outcome: Calibration, report: Report) -> None:
    found = json.loads(json.dumps(result(outcome)))
    texts = Reader(render_page(report)).texts
    for record in found["parameters"]:
        factor = 1e3 if record["unit"] == "m" else 180.0 / np.pi
        at = texts.index(record["name"], texts.index("identifiable"))
        assert texts[at + 1] == signed(record["value"] * factor, 4)
        assert texts[at + 2] == ("-" if record["sigma"] is None else f"{record['sigma'] * factor:.4f}")
    for name, sha in found["inputs"].items():
        assert texts[texts.index(sha) - 1] == name


def test_page_stands_alone_repeats_exactly_and_describes_its_pictures(report: Report) -> None:
    page = render_page(report)
    assert page == render_page(report)
    reader = Reader(page)
    assert {tag for tag, _ in reader.elements}.isdisjoint({"script", "link", "img", "iframe", "object", "base", "form"})
    for _, attributes in reader.elements:
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")
        assert not any(name.startswith("on") for name in attributes)
    assert "url(" not in page
    svgs = sum(tag == "svg" for tag, _ in reader.elements)
    labels = [a["aria-label"] or "" for _, a in reader.elements if a.get("role") == "img"]
    assert len(labels) == svgs > 10
    assert all(len(label) > 30 for label in labels)
    targets = {a["id"] for _, a in reader.elements if "id" in a}
    assert {(a["href"] or "")[1:] for _, a in reader.elements if "href" in a} <= targets


def test_words_of_a_user_are_words() -> None:
    sheet = Sheet(NASTY, (NASTY, "n"), frozenset("n"), (Row((NASTY, "1")),), NASTY)
    blocks = (
        sheet,
        Prose((NASTY,)),
        Prose((NASTY,), "list"),
        Prose((NASTY,), "code"),
        Picture(NASTY, "<svg></svg>", NASTY),
    )
    report = Report(NASTY, Verdict(True, NASTY, (NASTY,), (), (NASTY,)), (Section("s", NASTY, blocks),))
    page = render_page(report)
    assert "<script" not in page
    assert Reader(page).texts.count(NASTY) >= 8
    markdown = render_markdown(report)
    assert "\n| a\\|b \\<script\\>" in markdown
    assert "<script" not in re.sub(r"\\.", "", markdown.replace(f"    {NASTY}", ""))


def test_many_rows_stay_light(outcome: Calibration) -> None:
    big = tuple(
        s._replace(
            data=s.data.subset(np.tile(np.arange(len(s.data)), 200)),
            before=np.tile(s.before, (200, 1)),
            after=np.tile(s.after, (200, 1)),
        )
        for s in outcome.sets
    )
    assert len(render_page(report_of(replace(outcome, sets=big)))) < 1_000_000


def test_poses_beside_positions_have_figures_of_their_own(outcome: Calibration) -> None:
    own, held_out = outcome.sets
    angles = np.random.default_rng(0).normal(scale=1e-3, size=(2, len(own.data), 3))
    poses = own._replace(
        data=replace(own.data, kind="pose"),
        before=np.hstack([own.before, 3.0 * angles[0]]),
        after=np.hstack([own.after, angles[1]]),
    )
    sections = {
        section.key: section for section in report_of(replace(outcome, sets=(own, poses, held_out, held_out))).sections
    }
    titles = [block.title for block in sections["poses"].blocks]
    assert titles[:2] == ["Position error of every row", "Orientation error of every row"]
    said = [block.alternative for block in sections["poses"].blocks if isinstance(block, Picture)]
    assert "Rows from 121 on" in said[0]
    assert "held out" not in said[1]
    worst = np.degrees(np.linalg.norm(angles[1], axis=1).max())
    assert f"is {worst:.4f} deg, from {own.file}, line" in said[1]


def test_levels_and_loops_are_told() -> None:
    outcome = run(load(CASE.parent / "irb2400" / JOB))
    report = report_of(outcome)
    (levels,) = [section for section in report.sections if section.key == "levels"]
    (sheet,) = [block for block in levels.blocks if isinstance(block, Sheet)]
    assert [row.cells[0] for row in sheet.rows] == ["base", "joint", "kinematic", "residual"]
    assert "A URDF holds no closed loops, no couplings of a job and no joint terms" in render_page(report)


def test_a_urdf_that_lacks_a_coupling_alone_is_told_so() -> None:
    (said,) = in_urdf_sentences({}, {}, converged=True)
    assert "no couplings of a job" in said
    assert "calibrated.urdf alone needs other joint readings" in said


def test_importing_the_report_loads_no_template_engine() -> None:
    import subprocess
    import sys

    code = "import sys, calib.results.report, calib.presentation.report.page as p; print({'jinja2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
