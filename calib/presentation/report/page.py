"""A report as one HTML page that asks nobody for anything."""

import base64
import hashlib
from importlib.resources import files

from calib.presentation.report.document import Report, Sheet

_TEMPLATE = "pages/report.html.jinja"
_SORTING = "pages/sorting.js"


def render_page(report: Report) -> str:
    """Return a report as one HTML document: its style and its drawings are in it.

    It runs no script but, where a sheet can be sorted, the one that sorts, which the page names by its hash.
    """
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415 - calib must not load it on import

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    pages = files("calib.presentation")
    template = environment.from_string(pages.joinpath(_TEMPLATE).read_text(encoding="utf-8"))
    script = pages.joinpath(_SORTING).read_text(encoding="utf-8") if _sortable(report) else ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return template.render(report=report, script=script, digest=digest) + "\n"


def _sortable(report: Report) -> bool:
    blocks = (block for section in report.sections for block in section.blocks)
    return any(isinstance(block, Sheet) and block.sortable for block in blocks)
