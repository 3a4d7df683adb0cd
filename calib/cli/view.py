"""``calib view``: the scene, live."""

import contextlib
from collections.abc import Callable, Coroutine
from typing import Any

from calib.cli.application import PATH, command
from calib.cli.options import Open, Port, ResultFolder
from calib_start import heeded_by, loading


@command("view", PATH, "calib view out/")
def view(results: ResultFolder, port: Port = 0, open_: Open = False) -> None:
    """Serve the scene to this computer only, until Ctrl-C.

    It shows what scene.html shows. Joints can also be moved by hand, and newer results in the folder are shown at once.
    """
    with loading():
        from calib.presentation.live import serve
        from calib.results.folder import REPORT_FILE, SCENE_FILE

    serving = serve(results, SCENE_FILE, (REPORT_FILE,), port, shown_at(f"The scene of {results}", open_=open_))
    run_until_interrupted(serving)


def run_until_interrupted(serving: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run what serves a page until Ctrl-C, which is how this ends well."""
    with loading():
        import asyncio

    async def run() -> None:
        loop, task = asyncio.get_running_loop(), asyncio.create_task(serving())
        with heeded_by(lambda: loop.call_soon_threadsafe(task.cancel)):
            await task

    with contextlib.suppress(asyncio.CancelledError, KeyboardInterrupt):  # the latter before the page is served
        asyncio.run(run())


def shown_at(what: str, *, open_: bool) -> Callable[..., None]:
    """Return what tells a person the address where something is, and opens it in the browser if that is asked.

    What is returned takes the address and, where that is a secret, another one for the browser.
    """
    import threading
    import webbrowser

    from calib.presentation.console import show, warning

    def started(address: str, door: str = "") -> None:
        show(f"{what} is at {address} until you press Ctrl-C.")
        if open_:  # a browser of the terminal would keep the server from answering it
            threading.Thread(target=opened, args=(door or address,), daemon=True).start()

    def opened(address: str) -> None:
        if not webbrowser.open(address):
            show(warning("no browser could be opened; open the address by hand."))

    return started
