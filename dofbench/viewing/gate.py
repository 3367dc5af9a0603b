"""A door in front of a server on the loopback interface: who comes with the token is let through.

The first request holds the token in its address (/?token=...); the answer sets a cookie and leads to the page. Later
connections, those of web sockets too, show the cookie. Everything else gets status 403.
"""

from __future__ import annotations

import asyncio
import hmac
import threading
from collections.abc import Mapping
from urllib.parse import parse_qs, urlsplit

_HEAD = 65536  # bytes, longest head of a request
_COOKIE = "dofbench_token"
_REASON = "open the address with its token\n"
_REFUSED = f"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n{_REASON}".encode()


class Gate:
    """Listens at host:port and forwards to 127.0.0.1:behind, in a thread of its own."""

    def __init__(self, host: str, port: int, behind: int, token: str):
        self._behind, self._token = behind, token
        self._loop = asyncio.new_event_loop()
        self._server = self._loop.run_until_complete(asyncio.start_server(self._serve, host, port, limit=_HEAD))
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await reader.readuntil(b"\r\n\r\n")
            answer = self._answer(head)
            if answer is not None:
                writer.write(answer)
                await writer.drain()
            else:
                await self._forward(head, reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # a connection that broke off
        finally:
            writer.close()

    def _answer(self, head: bytes) -> bytes | None:
        """What to answer a request by itself; None to let it through."""
        first, *lines = head.decode("latin-1").split("\r\n")
        parts = first.split(" ")
        fields = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        given = parse_qs(urlsplit(parts[1]).query).get("token", [""])[0] if len(parts) == 3 else ""
        if given and self._right(given):
            cookie = f"{_COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
            lines = [
                "HTTP/1.1 303 See Other",
                "Location: /",
                f"Set-Cookie: {cookie}",
                "Content-Length: 0",
                "Connection: close",
            ]
            return "\r\n".join([*lines, "", ""]).encode()
        return None if self._right(_cookie(fields)) else _REFUSED

    def _right(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())

    async def _forward(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        behind_reader, behind_writer = await asyncio.open_connection("127.0.0.1", self._behind)
        behind_writer.write(head)
        await asyncio.gather(_copied(reader, behind_writer), _copied(behind_reader, writer))


def _cookie(fields: Mapping[str, str]) -> str:
    pairs = (pair.strip().partition("=") for pair in fields.get("cookie", "").split(";"))
    return next((value for name, _, value in pairs if name == _COOKIE), "")


async def _copied(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Everything from one to the other, until it ends."""
    try:
        while data := await reader.read(_HEAD):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()
