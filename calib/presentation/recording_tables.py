"""The table of what a recording holds."""

from collections.abc import Sequence

from rich import box
from rich.table import Table

from calib.measurement.formats.recordings import Topic


def topic_table(topics: Sequence[Topic]) -> Table:
    """Return the topics of a recording, with rates and longest gaps."""
    out = Table(title="Topics", title_justify="left", box=box.SIMPLE_HEAD)
    out.add_column("topic", overflow="fold")
    out.add_column("becomes")
    for name in ("messages", "a second", "longest gap [s]"):
        out.add_column(name, justify="right")
    for topic in topics:
        rate = f"{topic.rate:.1f}" if topic.rate > 0.0 else "-"
        out.add_row(topic.name, topic.of or "-", str(topic.messages), rate, f"{topic.gap:.3f}")
    return out
