"""The directive ``commands``: a section for every command, as ``typer utils docs`` describes it."""

import re
import subprocess
import sys
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]


class Commands(SphinxDirective):
    """Takes the place of the commands' own descriptions, so that no second list of options has to be kept."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        described = subprocess.run(
            [sys.executable, "-m", "typer", "calib.cli.whole", "utils", "docs", "--name", "calib"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        # What stands before the first command is the list of them all.
        _, heading, text = described.partition("\n## ")
        text = re.sub(r"^Example: (.*)$", r"Example: `\1`", text, flags=re.MULTILINE)
        for path in (ROOT / "calib" / "cli").glob("*.py"):
            self.env.note_dependency(str(path))
        return self.parse_text_to_nodes(heading.lstrip("\n") + text, allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Name the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
