"""How a fit shows itself in Python: printed, in a notebook, as DataFrames and figures; and nothing sooner."""

import io
import subprocess
import sys
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import calib
from calib.identification.fit import Fit
from calib.presentation.inline import Page
from tests.support.cases import CASE, TABLE


def fit_of(**changes: Any) -> Fit:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=0.02e-3)
    return calib.identify(calib.error_model(robot, **{"offsets": "all", "placements": "all", **changes}), data)


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fit_of()


def test_printed_it_is_its_table(fit: Fit) -> None:
    assert str(fit) == f"{fit}" == calib.table(fit)
    assert "joint_6.offset" in str(fit)
    assert len(repr(fit)) < 100  # what a prompt and a debugger show is one line


def test_any_way_to_a_fit_leads_through_the_front_door() -> None:
    code = "import calib.identification.fit, sys; from calib.foundations.showing import shower; "
    code += "print('calib.presentation.display' in sys.modules, shower().table.__name__, shower().html.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False table html\n"


def test_a_notebook_shows_the_same_words(fit: Fit) -> None:
    class Words(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.found: list[str] = []

        def handle_data(self, data: str) -> None:
            self.found.append(data)

    shown = fit._repr_html_()
    words = Words()
    words.feed(shown)
    assert "<script" not in shown
    joined = " ".join(words.found).split()
    for word in str(fit).split():
        if not set(word) <= {"-"}:
            assert word in joined
    from IPython.core.formatters import HTMLFormatter

    assert HTMLFormatter()(fit) == shown


def test_nothing_heavy_is_loaded_until_it_is_asked_for() -> None:
    code = f"""
import sys, calib
robot = calib.load_robot({str(CASE / "arm_cmm.urdf")!r}, tip="probe")
data = calib.read_measurements({str(CASE / TABLE)!r}, robot, sigma=0.02e-3)
fit = calib.identify(calib.error_model(robot, offsets="all"), data)
str(fit), repr(fit), fit._repr_html_(), calib.table(fit)
heavy = lambda: sorted({{"matplotlib", "pandas", "meshcat", "tornado", "jinja2", "trimesh"}} & set(sys.modules))
print(heavy())
calib.plot(fit)
print(heavy())
calib.data_frame(fit)
print(heavy(), "matplotlib.pyplot" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "['matplotlib']", "['matplotlib', 'pandas'] False"]


def test_parameters_as_a_data_frame(fit: Fit) -> None:
    frame = calib.data_frame(fit)
    assert list(frame.index) == [parameter.name for parameter in fit.parameters]
    np.testing.assert_array_equal(frame["value"], fit.values)
    np.testing.assert_array_equal(frame["sigma"], fit.sigmas)
    np.testing.assert_array_equal(~frame["identifiable"], fit.unidentifiable)
    assert frame.loc["joint_2.offset", "unit"] == "rad"


def test_residuals_as_a_data_frame(fit: Fit) -> None:
    frame = calib.data_frame(fit, "residuals")
    assert list(frame.columns) == [
        *("file", "line", "tool"),
        *(f"{when}_{axis}" for when in ("before", "after") for axis in "xyz"),
    ]
    np.testing.assert_array_equal(frame[["after_x", "after_y", "after_z"]], fit.residuals[0])
    np.testing.assert_array_equal(frame["line"], fit.measurements[0].lines)


def test_correlations_as_a_data_frame(fit: Fit) -> None:
    frame = calib.data_frame(fit, "correlations")
    assert list(frame.columns) == list(frame.index)
    assert len(frame) == (~fit.unidentifiable).sum()
    np.testing.assert_allclose(np.diag(frame), 1.0)
    np.testing.assert_allclose(frame, frame.T, atol=1e-12)
    index = [k for k, p in enumerate(fit.parameters) if p.name in frame.index[:2]]
    C = fit.told_covariance(np.array(index))
    assert frame.iloc[0, 1] == pytest.approx(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))


def test_without_pandas_it_is_said_in_a_sentence(fit: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(calib.OutputError, match="needs pandas"):
        calib.data_frame(fit)


def test_a_notebook_shows_a_figure_without_a_magic_line(fit: Fit) -> None:
    text = calib.plot(fit)._repr_svg_()  # type: ignore[attr-defined]
    assert text.startswith("<?xml")
    assert "<svg" in text


def test_figures_show_the_numbers(fit: Fit) -> None:
    (axes,) = calib.plot(fit).axes
    before, after = axes.get_lines()
    length = 1e3 * np.linalg.norm(fit.residuals[0], axis=1)
    np.testing.assert_allclose(np.sort(np.asarray(after.get_xdata())[1:]), np.sort(length))
    assert np.median(np.asarray(before.get_xdata())) > 100 * np.median(length)
    lengths, angles = calib.plot(fit, "parameters").axes
    names = [label.get_text() for axes in (lengths, angles) for label in axes.get_yticklabels()]
    assert sorted(names) == sorted(p.name for p in fit.parameters if p.of_robot)
    image = calib.plot(fit, "correlations").axes[0].get_images()[0].get_array()
    np.testing.assert_allclose(np.asarray(image), calib.data_frame(fit, "correlations"))


@pytest.mark.parametrize("what", ["errors", "parameters", "correlations"])
@pytest.mark.parametrize("changes", [{}, {"placements": "none"}, {"placements": "none", "offsets": ["joint_3"]}])
def test_figures_can_be_saved(what: Any, changes: dict[str, Any]) -> None:
    file = io.BytesIO()
    calib.plot(fit_of(**changes), what).savefig(file, format="svg")
    assert file.getvalue().startswith(b"<?xml")


def test_a_page_at_a_prompt_is_a_line_and_not_its_text() -> None:
    page = Page("<p>" + "x" * 1_000_000)
    assert repr(page) == "<Page of 1000003 characters>"
    assert str(page).startswith("<p>x") and "srcdoc" in page._repr_html_()
