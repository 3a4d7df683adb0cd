"""``calib view``: the scene, live."""

import contextlib
from typing import Annotated

import typer

from calib.cli.application import PATH, command
from calib.cli.options import ResultFolder
from calib_start import loading


@command("view", PATH, "calib view out/")
def view(
    results: ResultFolder,
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="0: any that is free.")] = 0,
) -> None:
    """Serve the scene to this machine alone, live.

    Until Ctrl-C. Beside what scene.html shows, joints can be moved by hand, and newer results in the folder show
    themselves.
    """
    with loading():
        import asyncio

        from calib.presentation.console import printable, show
        from calib.presentation.live import serve
        from calib.results.folder import REPORT_FILE, SCENE_FILE

    def started(address: str) -> None:
        show(printable(f"The scene of {results} is at {address} until you press Ctrl-C."))

    serving = serve(results, SCENE_FILE, (REPORT_FILE,), port, started)
    # Ctrl-C is how this ends well.
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serving())
