"""Pages that are served to this computer alone."""

import asyncio
import errno
import socket
import time
from typing import Any

import pytest
from tornado.web import RequestHandler

from calib.presentation.local import listening


def test_who_finds_no_room_waits(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """Where a process has as many connections open as it may, nothing is said, and the next one is let in."""
    refused: list[socket.socket] = []
    accept = socket.socket.accept

    def few(self: socket.socket) -> tuple[socket.socket, Any]:
        if len(refused) < 2:
            refused.append(self)
            raise OSError(errno.EMFILE, "Too many open files")
        return accept(self)

    async def asked() -> bytes:
        async with listening([], 0) as address:
            monkeypatch.setattr(socket.socket, "accept", few)
            host, _, port = address.removeprefix("http://").rstrip("/").partition(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            said = await reader.readline()
            writer.close()
            return said

    assert asyncio.run(asked()) == b"HTTP/1.1 404 Not Found\r\n"
    assert len(refused) == 2
    assert not caplog.records


def test_a_server_that_ends_does_not_answer_all_that_was_asked_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who sends a thousand requests at once is not answered a thousand times before Ctrl-C ends the server."""
    monkeypatch.setattr("calib.presentation.local._LEAVE", 0.01)
    answered: list[None] = []

    class Slow(RequestHandler):
        def get(self) -> None:
            answered.append(None)
            time.sleep(0.001)

    async def asked() -> None:
        async with listening([("/", Slow)], 0) as address:
            host, _, port = address.removeprefix("http://").rstrip("/").partition(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" * 1000)
            await reader.readline()
        writer.close()

    asyncio.run(asked())
    assert len(answered) < 1000


@pytest.mark.parametrize("host", ["localhost", "evil.example"])
def test_a_body_that_is_none_is_not_shown_in_the_terminal(host: str, caplog: pytest.LogCaptureFixture) -> None:
    """Any program here, and any page of another site, can send one to an address that leads nowhere."""
    form = f"Host: {host}\r\nContent-Type: multipart/form-data; boundary=\r\nContent-Length: 1\r\n\r\na"

    async def asked() -> bytes:
        async with listening([], 0) as address:
            reader, writer = await asyncio.open_connection("127.0.0.1", int(address.rstrip("/").rpartition(":")[2]))
            writer.write(f"POST /\x9b31m HTTP/1.1\r\n{form}".encode("latin-1"))
            said = await reader.readline()
            writer.close()
            return said

    assert asyncio.run(asked()) == b"HTTP/1.1 400 Bad Request\r\n"
    assert not caplog.records
