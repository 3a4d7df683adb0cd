"""``calib app``: the way from files to results, on a page of this computer."""

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import PATH, command
from calib.cli.view import shown_at
from calib_start import loading


@command("app", PATH, "calib app --open")
def app(
    folder: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            metavar="FOLDER",
            help="A new or empty folder that keeps files and results; else they go at Ctrl-C.",
            show_default=False,
            readable=False,
        ),
    ] = None,
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port; 0 takes a free one.")] = 0,
    open_: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
) -> None:
    """Calibrate on a page of this computer, until Ctrl-C.

    Drop a URDF and tables or photographs, see and correct how they are read, check, calibrate, look at the results.
    Nothing leaves this computer. The address holds a secret: whoever has it can use the page.
    """
    with loading():
        import asyncio

        from calib.app.server import serve
    with contextlib.suppress(KeyboardInterrupt):  # how this ends well
        asyncio.run(serve(folder, port, shown_at("The page", open_=open_)))
