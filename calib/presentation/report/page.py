"""A report as one HTML page that asks nobody for anything."""

from importlib.resources import files

from calib.presentation.report.document import Report

_TEMPLATE = "pages/report.html.jinja"


def render_page(report: Report) -> str:
    """Return a report as one HTML document: its style and its drawings are in it, and it runs no script."""
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415 - calib must not load it on import

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(files("calib.presentation").joinpath(_TEMPLATE).read_text(encoding="utf-8"))
    return template.render(report=report) + "\n"
