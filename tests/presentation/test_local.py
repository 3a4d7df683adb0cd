"""Pages that are served to this computer alone."""

import asyncio
import errno
import socket
from typing import Any

import pytest

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
