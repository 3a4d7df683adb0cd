"""Pages that are served to this computer alone: one address, one port, and guards against pages of other sites."""

import asyncio
import contextlib
import errno
import socket
import time
from collections.abc import AsyncIterator, Sequence
from typing import IO, Any

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from calib.foundations.errors import OutputError
from calib.foundations.files import sentences

ADDRESS = "127.0.0.1"
# A page of another site may send its readers here by a name of its own; it is not answered.
_OURSELVES = r"(127\.0\.0\.1|localhost)"
# The largest body of a request that does not say otherwise.
_LARGEST_BODY = 1_000_000
# What is sent of a file at a time.
_PIECE = 1 << 20
# How long nobody is let in, in s, where a process has as many files and connections open as it may.
_PAUSE = 0.05
# How long connections may take to end when the server does, in s.
_LEAVE = 1.0


class _Listener(socket.socket):
    def accept(self) -> tuple[socket.socket, Any]:
        """Return who has come; where no connection more can be opened, they wait, and nothing is said."""
        try:
            return super().accept()
        except OSError as e:
            if e.errno not in (errno.EMFILE, errno.ENFILE):
                raise
            time.sleep(_PAUSE)
            raise BlockingIOError from e


class Guarded(RequestHandler):
    """Answers so that no page of another site may show this one in a frame, use it as its own, or learn its address."""

    def set_default_headers(self) -> None:
        """Set the headers of every answer."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Frame-Options", "DENY")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")

    async def send(self, file: IO[bytes], most: int) -> None:
        """Answer with at most so many bytes of a file, and close it: of who reads slowly a piece is kept, not all."""
        with file, contextlib.suppress(StreamClosedError):
            while most > 0 and (piece := file.read(min(_PIECE, most))):
                most -= len(piece)
                self.write(piece)
                await self.flush()

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        """Say nothing in the terminal of requests that are none."""
        if not isinstance(value, HTTPError):
            super().log_exception(typ, value, tb)


class _Unknown(Guarded):
    """Answers what leads nowhere, or comes by another name: tornado's own handler shows such requests."""

    def prepare(self) -> None:
        self.send_error(404)


@contextlib.asynccontextmanager
async def listening(routes: Sequence[Any], port: int, **settings: Any) -> AsyncIterator[str]:
    """Serve tornado's ``routes`` while the block runs, and give the address. ``port`` 0: any free one.

    Raises OutputError where the port cannot be had.
    """
    app = Application(log_function=lambda _: None, default_handler_class=_Unknown, **settings)
    app.add_handlers(_OURSELVES, list(routes))
    server = HTTPServer(app, max_body_size=_LARGEST_BODY)
    with sentences(f"port {port}", OutputError, "cannot be listened on"):
        listener = _Listener(fileno=socket.create_server((ADDRESS, port)).detach())
    listener.setblocking(False)
    server.add_socket(listener)
    try:
        yield f"http://{ADDRESS}:{listener.getsockname()[1]}/"
    finally:
        server.stop()
        with contextlib.suppress(TimeoutError):  # requests that were sent ahead are not all answered any more
            await asyncio.wait_for(server.close_all_connections(), _LEAVE)
