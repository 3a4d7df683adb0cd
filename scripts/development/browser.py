"""A headless Chromium, spoken to over a pipe: opens local pages, looks at them, and notes whatever goes wrong.

The DevTools protocol as NUL-terminated JSON over two file descriptors: no port is opened, and no library is needed.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_FLAGS = (
    "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-background-networking "
    "--disable-component-update --disable-sync --no-first-run --hide-scrollbars --remote-debugging-pipe"
)
# The browser reads its orders from 3 and answers to 4; here these numbers may be in use.
_LAUNCH = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
)
# Whatever a page does here, it has done after a minute, on any machine; more means that it hangs.
_PATIENCE = 60.0


class Page:
    """One open page. ``trouble``: console errors and exceptions; ``requests``: all addresses asked for."""

    def __init__(self, browser: "_Pipe", session: str) -> None:
        self._browser, self._session = browser, session
        self.trouble: list[str] = []
        self.requests: list[str] = []

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send an order of the DevTools protocol and return its answer."""
        return self._browser.ask(method, parameters, self._session, self._note)

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page, awaited where it is a promise."""
        found = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"].get("exception", {}).get("description", expression))
        return found["result"].get("value")

    def open(self, address: str) -> None:
        """Go to an address, wait until it is loaded and two pictures of it have been drawn."""
        self.ask("Page.navigate", url=address)
        self.wait_for(f"document.readyState === 'complete' && location.href === {json.dumps(address)}")
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")

    def wait_for(self, expression: str) -> None:
        """Wait until an expression in the page is true."""
        end = time.monotonic() + _PATIENCE
        while not self.evaluate(expression):
            if time.monotonic() > end:
                raise TimeoutError(expression)
            time.sleep(0.02)

    def size(self, width: int, height: int) -> None:
        """Make the window as large as this, as a phone where it is narrow."""
        phone = width < 600
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)

    def media(self, kind: str = "", **features: str) -> None:
        """Show the page for a medium ("print") and with features (``prefers_color_scheme="dark"``)."""
        asked = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.ask("Emulation.setEmulatedMedia", media=kind, features=asked)

    def choose(self, selector: str, files: Iterable[Path]) -> None:
        """Choose files in an input of the page, as a person does in the window that it opens."""
        root = self.ask("DOM.getDocument")["root"]["nodeId"]
        node = self.ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.ask("DOM.setFileInputFiles", nodeId=node, files=[str(file) for file in files])

    def drop(self, selector: str, files: Iterable[Path]) -> None:
        """Drag files onto the middle of an element and drop them there."""
        where = f"(r => [r.x + r.width / 2, r.y + r.height / 2])(document.querySelector({json.dumps(selector)})"
        x, y = self.evaluate(f"{where}.getBoundingClientRect())")
        data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.ask("Input.dispatchDragEvent", type=kind, x=x, y=y, data=data)

    def press(self, key: str) -> None:
        """Press a key: ``"Tab"``, ``"Enter"``, ``" "``."""
        code = {"Tab": 9, "Enter": 13, " ": 32}[key]
        text = {"Enter": "\r", " ": " "}.get(key, "")
        told = {"key": key, "windowsVirtualKeyCode": code, "text": text}
        self.ask("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **told)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **told)

    def screenshot(self, file: Path, *, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as PNG."""
        clip = {}
        if whole:
            size = self.ask("Page.getLayoutMetrics")["cssContentSize"]
            clip = {"captureBeyondViewport": True, "clip": {**size, "scale": 1}}
        file.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png", **clip)["data"]))

    def _note(self, event: dict[str, Any]) -> None:
        if event.get("sessionId") != self._session:
            return
        method, told = event["method"], event["params"]
        if method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.trouble.append(str(told["exceptionDetails"].get("exception", told).get("description", told)))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.trouble.append(str([argument.get("value") for argument in told["args"]]))
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.trouble.append(told["entry"]["text"])


class _Pipe:
    def __init__(self, orders: int, answers: int) -> None:
        self._orders, self._answers, self._count, self._rest = orders, answers, 0, b""

    def ask(
        self, method: str, parameters: dict[str, Any], session: str | None = None, note: Any = None
    ) -> dict[str, Any]:
        self._count += 1
        order = {"id": self._count, "method": method, "params": parameters}
        os.write(
            self._orders, json.dumps(order if session is None else {**order, "sessionId": session}).encode() + b"\0"
        )
        for message in self._messages():
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                answer: dict[str, Any] = message["result"]
                return answer
            if "method" in message and note is not None:
                note(message)
        raise EOFError("the browser has ended")

    def _messages(self) -> Iterator[dict[str, Any]]:
        while True:
            whole, mark, rest = self._rest.partition(b"\0")
            if mark:
                self._rest = rest
                yield json.loads(whole)
                continue
            if not select.select([self._answers], [], [], _PATIENCE)[0]:
                raise TimeoutError("the browser does not answer")
            more = os.read(self._answers, 1 << 20)
            if not more:
                return
            self._rest += more


@contextmanager
def browser() -> Iterator[Page]:
    """Give an empty page of a browser of its own, which can reach this machine alone and ends with the block."""
    if CHROMIUM is None:
        raise FileNotFoundError("there is no Chromium on the path")
    orders, to_browser = os.pipe()
    from_browser, answers = os.pipe()
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        arguments = [
            *_FLAGS.split(),
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            f"--user-data-dir={profile}",
        ]
        process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCH, str(orders), str(answers), CHROMIUM, *arguments, "about:blank"],
            pass_fds=(orders, answers),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(orders)
        os.close(answers)
        try:
            pipe = _Pipe(to_browser, from_browser)
            target = pipe.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
            session = pipe.ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
            page = Page(pipe, session)
            for domain in ("Page", "Runtime", "Log", "Network"):
                page.ask(f"{domain}.enable")
            yield page
            pipe.ask("Browser.close", {})
            process.wait(_PATIENCE)
        finally:
            process.kill()
            process.wait()
            os.close(to_browser)
            os.close(from_browser)
