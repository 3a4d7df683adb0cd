"""The requests of the page, each behind guards: this computer alone, a secret in the address, no other page."""

import asyncio
import json
import secrets
import signal
import sys
import threading
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

from tornado.web import stream_request_body

from calib.app.folder import LARGEST_FILE, RESULTS, TOO_LARGE, as_zip, private_folder
from calib.app.session import UNKNOWN, Session
from calib.foundations.errors import CalibError, JobError, OutputError
from calib.foundations.files import open_inside
from calib.presentation.local import Guarded, listening
from calib.results.folder import REPORT_FILE, SCENE_FILE
from calib.robot.sources import examples

_PAGES = {"": ("page.html", "text/html"), "app.js": ("app.js", "text/javascript"), "app.css": ("app.css", "text/css")}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
# Report and scene hold names from files: whatever they were made to do, they could not speak to this server.
_SANDBOX = "sandbox allow-scripts allow-popups"
_LARGEST_PAGE = 200_000_000


async def serve(folder: Path | None, port: int, started: Callable[[str, str], None]) -> None:
    """Serve the page until it is cancelled, or the process told to end.

    ``folder``: where files are kept, else for as long as the page is served. ``port`` 0: any free one. ``started`` is
    told the address, which holds a secret: who has it may use the page; and an address that leads there once, for whom
    others may watch. Raises OutputError where folder or port cannot be had.
    """
    with private_folder(folder) as place:
        session, secret, once = Session(place), secrets.token_urlsafe(16), secrets.token_urlsafe(16)
        given = {"session": session}
        routes = [
            (rf"/{once}", _Door, {"way": [f"/{secret}/"]}),
            (rf"/{secret}/(app\.js|app\.css|)", _Page, given),
            (rf"/{secret}/state", _State, given),
            (rf"/{secret}/examples", _Examples, given),
            (rf"/{secret}/offer", _Offer, given),
            (rf"/{secret}/files/(.{{1,3000}})", _Files, given),
            (rf"/{secret}/(look|check|calibrate|cancel)", _Verb, given),
            (rf"/{secret}/results/({REPORT_FILE}|{SCENE_FILE})", _Results, given),
            (rf"/{secret}/calibration\.zip", _Folder, given),
        ]
        async with listening(routes, port) as address:
            started(f"{address}{secret}/", f"{address}{once}")
            try:
                await _told_to_end()
            finally:
                await session.end()


async def _told_to_end() -> None:
    """Wait until the system, or whoever closes the terminal, ends this process: files are tidied up as at Ctrl-C.

    What is ignored, as by nohup, stays so.
    """
    told, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL and threading.current_thread() is threading.main_thread():
            loop.add_signal_handler(number, told.set)
    await told.wait()


class _Door(Guarded):
    """Leads to the page, once: other users of this computer may see with which address a browser was started."""

    def initialize(self, way: list[str]) -> None:
        self.way = way

    def get(self) -> None:
        if self.way:
            self.redirect(self.way.pop())
            return
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish("This address has been used. The address that the terminal shows still leads to the page.")


class _Ours(Guarded):
    """A request of the page. One that changes something must come from a page of this server."""

    def initialize(self, session: Session) -> None:
        self.session = session

    def prepare(self) -> None:
        own = f"http://{self.request.host}"
        if self.request.method not in ("GET", "HEAD") and self.request.headers.get("Origin") != own:
            self.refuse(403, "This request does not come from the page.")

    def refuse(self, status: int, sentence: str) -> None:
        self.set_status(status)
        self.finish({"sentence": sentence})

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        if not isinstance(value, CalibError):
            super().log_exception(typ, value, tb)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answer an error of a user's with its sentence, all others as tornado does."""
        error = kwargs.get("exc_info", (None, None))[1]
        if isinstance(error, CalibError):
            self.refuse(400, str(error))
        else:
            super().write_error(status_code, **kwargs)


class _Page(_Ours):
    def get(self, name: str) -> None:
        file, kind = _PAGES[name]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.set_header("Content-Security-Policy", _POLICY)
        self.finish(files("calib.app").joinpath("pages", file).read_bytes())


class _State(_Ours):
    def get(self) -> None:
        self.finish(self.session.state())


class _Examples(_Ours):
    def get(self) -> None:
        try:
            self.finish({"examples": list(examples())})
        except CalibError:  # not installed: none can be chosen
            self.finish({"examples": []})


@stream_request_body
class _Files(_Ours):
    """A dropped file, taken piece by piece: nothing is read of what does not come from the page or is too large."""

    def prepare(self) -> None:
        self._pieces: list[bytes] = []
        super().prepare()
        length = self.request.headers.get("Content-Length", "0")
        # Of thousands of digits Python makes no number.
        too_long = length.isdecimal() and (len(length) > len(str(LARGEST_FILE)) or int(length) > LARGEST_FILE)
        if not self._finished and too_long:
            self.refuse(413, f"The file {TOO_LARGE}")
        if self._finished:
            return
        self.request.connection.set_max_body_size(LARGEST_FILE)  # type: ignore[union-attr]

    def data_received(self, chunk: bytes) -> None:
        self._pieces.append(chunk)

    async def put(self, name: str) -> None:
        data = b"".join(self._pieces)
        self._pieces.clear()  # it is there twice otherwise
        await self.session.drop(name, data)
        self.finish(self.session.state())

    async def delete(self, name: str) -> None:
        await self.session.remove(name)
        self.finish(self.session.state())


class _Offer(_Ours):
    """What is about to be dropped; answered by what is of use of it."""

    def post(self) -> None:
        paths = _said(self.request.body).get("paths")
        if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
            raise JobError(UNKNOWN)
        wanted = self.session.offer(paths)
        self.finish({**self.session.state(), "wanted": wanted})


def _said(body: bytes) -> dict[str, Any]:
    try:
        said = json.loads(body or b"{}")
    except (ValueError, RecursionError) as e:
        raise JobError(UNKNOWN) from e
    if not isinstance(said, dict):
        raise JobError(UNKNOWN)
    return said


class _Verb(_Ours):
    async def post(self, verb: str) -> None:
        said = _said(self.request.body)
        match verb:
            case "look":
                await self.session.look(said)
            case "check":
                await self.session.check(str(said.get("job", "")))
            case "calibrate":
                await self.session.calibrate()
            case _:
                await self.session.cancel()
        self.finish(self.session.state())


class _Results(_Ours):
    async def get(self, name: str) -> None:
        # What has changed since is not what it shows.
        if self.session.results is None:
            self.send_error(404)
            return
        try:
            page = open_inside(self.session.folder / RESULTS, name, OutputError, _LARGEST_PAGE)
        except OutputError:
            self.send_error(404)
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Content-Security-Policy", _SANDBOX)
        await self.send(page, _LARGEST_PAGE)


class _Folder(_Ours):
    """All files as one. Who leaves before it is made, or while it is sent, ends that."""

    def prepare(self) -> None:
        self._left = threading.Event()
        super().prepare()

    def on_connection_close(self) -> None:
        self._left.set()

    async def get(self) -> None:
        try:
            archive = await self._archive()
        except OutputError as e:
            self.refuse(500, str(e))
            return
        self.set_header("Content-Type", "application/zip")
        self.set_header("Content-Disposition", 'attachment; filename="calibration.zip"')
        await self.send(archive, sys.maxsize)

    async def _archive(self) -> IO[bytes]:
        session = self.session
        session.refuse_gone()
        before = session.seen()
        try:
            # A thread is waited for when the server ends: what it makes is to be wanted until then alone.
            archive = await asyncio.to_thread(
                as_zip, session.folder, results=session.results is not None, wanted=lambda: not self._left.is_set()
            )
        finally:
            self._left.set()
        if session.seen() != before:
            archive.close()
            raise OutputError("The files changed while the archive was made; download it again.")
        return archive
