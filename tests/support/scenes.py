"""What a page with a scene tells its viewer."""

import base64
import json
import re
from typing import Any


def page_of(text: str) -> dict[str, Any]:
    match = re.search(r'<script type="application/json" id="page">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    page: dict[str, Any] = json.loads(match[1])
    return page


def commands_of(text: str) -> list[dict[str, Any]]:
    import umsgpack

    return [umsgpack.unpackb(base64.b64decode(command)) for command in page_of(text)["commands"]]
