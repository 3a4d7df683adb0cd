"""Pages that a notebook shows in place."""

from html import escape


class Page(str):
    """A page as text, which a notebook shows in a frame of its own: it asks nobody for anything, and changes nothing.

    calib.report(found)  # in a notebook: the report
    Path("report.html").write_text(calib.report(found))  # elsewhere: its text
    """

    __slots__ = ()

    def __repr__(self) -> str:
        return f"<Page of {len(self)} characters>"

    def _repr_html_(self) -> str:
        """Return the page in a frame that keeps its style and its script to itself."""
        style = "width: 100%; height: 640px; border: 0"
        return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{escape(self)}"></iframe>'
