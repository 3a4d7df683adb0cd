"""A matplotlib figure that a notebook shows in place. Importing this imports matplotlib."""

import io

from matplotlib.figure import Figure


class InlineFigure(Figure):
    """A figure of its own, of no global state, that a notebook shows without a magic line."""

    def _repr_svg_(self) -> str:
        """Return the figure as SVG, which IPython asks for."""
        text = io.StringIO()
        self.savefig(text, format="svg")
        return text.getvalue()
