"""The scene, live: served to this machine alone, with joints to be moved by hand and new results shown by themselves.

meshcat's own server listens on every address of the machine, on a second port for commands as well, and knows neither
loops nor errors. Here its viewer, which the page of a scene holds, is served by tornado on 127.0.0.1 and on one port;
what moves is computed by the calibrated model.
"""

import contextlib
import json
import os
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from calib.foundations.errors import CalibError, KeptError, OutputError, PoseError
from calib.foundations.files import open_inside, stamp
from calib.foundations.folders import reading_folder
from calib.foundations.units import MM, UNITS
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import usual_conditions
from calib.machine.model_file import load_machine
from calib.robot.links import arm_of
from calib.robot.robot import Deviations

# How often a folder is looked at for newer results, in s.
_EVERY = 1.0
# How often a page is looked for where another run keeps the folder, and for how long, in s.
_AGAIN, _PATIENCE = 0.1, 30.0
# Shown of joints without limits: one turn, or one metre, to both sides.
_TURN, _METRE = np.pi, 1.0
_LONGEST_MESSAGE = 100_000
_LARGEST_PAGE = 200_000_000
_LARGEST_NUMBER = 1e6
# As our own pages say of themselves; those in a folder may be of somebody else, and say nothing of it.
_ONLY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
_POLICY = f"{_ONLY}; script-src 'unsafe-inline'; img-src data: blob:; connect-src 'self'"


def serve(
    folder: Path, page: str, others: tuple[str, ...], port: int, started: Callable[[str], None]
) -> Callable[[], Coroutine[Any, Any, None]]:
    """Return what serves the scene of a folder of results until it is cancelled.

    ``page`` and ``others``: names of the pages in the folder, the first one also without a name. ``port`` 0: any free
    one. ``started`` is told the address. Raises OutputError when there is nothing to show, or no port.
    """
    seen = stamp(folder)
    model = load_machine(folder)
    if not os.path.lexists(folder / page):
        raise OutputError(f"{folder}: holds no {page}; run calib calibrate again.")
    open_inside(folder, page, OutputError, _LARGEST_PAGE).close()

    async def run() -> None:
        await _run(folder, model, seen, page, others, port, started)

    return run


async def _run(
    folder: Path,
    model: CalibratedMachine,
    seen: tuple[int, int, int] | None,
    page: str,
    others: tuple[str, ...],
    port: int,
    started: Callable[[str], None],
) -> None:
    import asyncio  # noqa: PLC0415 - calib must load none of these on import

    from tornado.websocket import WebSocketClosedError, WebSocketHandler  # noqa: PLC0415

    from calib.presentation.local import Guarded, listening  # noqa: PLC0415

    pages_open: set[Any] = set()

    class Page(Guarded):
        async def get(self, name: str) -> None:
            # The lock is not waited for at once: nobody else would be answered meanwhile, nor Ctrl-C heard.
            until = time.monotonic() + _PATIENCE
            while time.monotonic() < until:
                try:
                    with reading_folder(folder, patience=0.0):
                        opened = open_inside(folder, name or page, OutputError, _LARGEST_PAGE)
                    self.set_header("Content-Security-Policy", _ONLY if name in others else _POLICY)
                    await self.send(opened, _LARGEST_PAGE)
                    return
                except KeptError:
                    await asyncio.sleep(_AGAIN)
                except OutputError:  # a page that older results have not, or that is a link or no file
                    self.send_error(404)
                    return
            self.send_error(503)

    class Live(Guarded, WebSocketHandler):
        def prepare(self) -> None:
            try:
                urlsplit(self.request.headers.get("Origin", ""))
            except ValueError:  # tornado would show where it failed
                self.send_error(403)

        async def open(self, *_: str, **__: str) -> None:
            pages_open.add(self)
            await self.tell({"readings": sliders(model)})

        async def on_message(self, message: str | bytes) -> None:
            # Waited for: who asks and does not read is not asked on.
            await self.tell(answer(model, message))

        async def tell(self, contents: dict[str, Any]) -> None:
            with contextlib.suppress(WebSocketClosedError):  # the page has gone meanwhile
                await self.write_message(json.dumps(contents))

        def log_exception(self, *what: Any) -> None:
            if what[0] is not asyncio.CancelledError:  # Ctrl-C, while something was told
                super().log_exception(*what)

        def on_close(self) -> None:
            pages_open.discard(self)

    names = "|".join(map(_literally, (page, *others)))
    routes = [(rf"/({names})?", Page), ("/live", Live)]
    async with listening(routes, port, websocket_max_message_size=_LONGEST_MESSAGE) as address:
        started(address)
        while True:
            await asyncio.sleep(_EVERY)
            now = stamp(folder)
            if now not in (seen, None):
                try:
                    with reading_folder(folder, patience=0.0):
                        model, seen = load_machine(folder), now
                except CalibError:  # half way through an exchange; the next look finds it
                    continue
                telling = [asyncio.create_task(one.tell({"reload": True})) for one in pages_open]
                if telling:  # who does not read is not waited for
                    await asyncio.wait(telling, timeout=_EVERY)


def sliders(model: CalibratedMachine) -> list[dict[str, Any]]:
    """Return what a person may move: name, unit, limits and a first value of every reading, in degrees and mm."""
    found = []
    for reading in model.robot.readings:
        angle = reading.dimension == "angle"
        unit, widest = ("deg", _TURN) if angle else ("mm", _METRE)
        factor = UNITS[unit].factor
        lower = -widest if reading.lower is None else reading.lower
        upper = widest if reading.upper is None else reading.upper
        value = min(max(0.0, lower), upper)
        limits = {"lower": lower / factor, "upper": upper / factor, "value": value / factor}
        found.append({"name": reading.name, "unit": unit, **limits})
    return found


def answer(model: CalibratedMachine, message: str | bytes) -> dict[str, Any]:
    """Return the positions of both arms' joints at the readings that a page asks for, and how far their tips are apart.

    The nominal arm's difference is taken as often as the page draws it; the distance told is the true one, of both
    arms on the same base. Whatever cannot be answered is said in a sentence.
    """
    robot = model.robot
    try:
        asked = json.loads(message)
        shown = np.array(asked["readings"], dtype=np.float64)
        apart = float(asked["apart"])
        factors = [UNITS["deg" if reading.dimension == "angle" else "mm"].factor for reading in robot.readings]
        if shown.shape != (len(factors),):
            raise ValueError("not one number for every reading")
        readings = (shown * factors)[None]
        if not np.all(np.abs([*readings[0], apart]) <= _LARGEST_NUMBER):
            raise ValueError("not finite, or beyond all machines")
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
        return {"sentence": "The server does not know this request."}
    d = model.deviations
    led = Deviations((1.0 - apart) * d.placements, (1.0 - apart) * d.offsets, (1.0 - apart) * d.terms)
    usual = usual_conditions(model, readings)
    try:
        positions = {
            name: arm_of(robot, deviations, readings, np.eye(4), usual).positions[0].tolist()
            for name, deviations in (("robot", d), ("nominal", led))
        }
        tips = robot.tips(readings, d, usual)[0], robot.tips(readings, conditions=usual)[0]
    except PoseError as e:
        return {"sentence": f"At these readings {e.reason}."}
    distance = float(np.linalg.norm(tips[0][:3, 3] - tips[1][:3, 3])) / MM
    return {
        "positions": positions,
        "sentence": f"The tips of the nominal and the calibrated arm, on one base, are {distance:.3f} mm apart here.",
    }


def _literally(name: str) -> str:
    return name.replace(".", r"\.")
