"""A report as one HTML page that asks nobody for anything."""

import base64
import hashlib

from calib.foundations.words import harmless
from calib.presentation.page_files import page_file, template
from calib.presentation.report.document import Report, Sheet


def render_page(report: Report) -> str:
    """Return a report as one HTML document: its style and its drawings are in it.

    It runs no script but, where a sheet can be sorted, the one that sorts, which the page names by its hash.
    """
    script = page_file("sorting.js") if _sortable(report) else ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return harmless(template("report.html.jinja").render(report=report, script=script, digest=digest)) + "\n"


def _sortable(report: Report) -> bool:
    blocks = (block for section in report.sections for block in section.blocks)
    return any(isinstance(block, Sheet) and block.sortable for block in blocks)
