"""The table of what a recording holds."""

from collections.abc import Sequence

from calib.measurement.formats.recordings import Topic
from calib.presentation.report.document import Sheet


def topic_sheet(topics: Sequence[Topic]) -> Sheet:
    """Return the topics of a recording, with rates and longest gaps."""
    rows = []
    for topic in topics:
        rate = f"{topic.rate:.1f}" if topic.rate > 0.0 else "-"
        rows.append((topic.name, topic.of or "-", str(topic.messages), rate, f"{topic.gap:.3f}"))
    return Sheet.of("Topics", ("topic", "becomes", ">messages", ">a second", ">longest gap [s]"), rows)
