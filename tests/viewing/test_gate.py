"""The door in front of the viewer: nobody passes without the token, and who has it notices nothing."""

from __future__ import annotations

import http.client
import http.server
import threading
from collections.abc import Iterator

import pytest

from dofbench.core.errors import InputError
from dofbench.viewing.gate import Gate
from dofbench.viewing.view_options import View

TOKEN = "abcdefghijklmnop"


@pytest.fixture
def gate() -> Iterator[Gate]:
    """A gate in front of a server that says hello."""

    class Hello(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(f"hello {self.path}".encode())

        def log_message(self, *_: object) -> None: ...

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hello) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        gate = Gate("127.0.0.1", 0, server.server_port, TOKEN)
        yield gate
        gate.close()
        server.shutdown()


def ask(gate: Gate, path: str, **fields: str) -> tuple[int, str, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=20)
    connection.request("GET", path, headers=fields)
    answer = connection.getresponse()
    return answer.status, answer.read().decode(), answer.headers


@pytest.mark.parametrize(
    ("path", "fields"),
    [
        ("/", {}),
        ("/?token=", {}),
        ("/?token=abcdefghijklmnox", {}),
        ("/", {"Cookie": "dofbench_token=abcdefghijklmnox"}),
        ("/", {"Cookie": "dofbench_token="}),
        ("/", {"Cookie": f"other={TOKEN}"}),
    ],
)
def test_without_the_token_nothing_is_answered(gate: Gate, path: str, fields: dict[str, str]) -> None:
    status, text, _ = ask(gate, path, **fields)
    assert status == 403 and "hello" not in text


def test_the_token_opens_and_is_remembered(gate: Gate) -> None:
    status, _, headers = ask(gate, f"/?token={TOKEN}")
    assert status == 303 and headers["Location"] == "/" and "HttpOnly" in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].split(";")[0]
    assert ask(gate, "/page", Cookie=f"a=b; {cookie}")[:2] == (200, "hello /page")


@pytest.mark.parametrize(
    "change", [{"host": "0.0.0.0"}, {"token": "short"}, {"token": "with space and more"}, {"what": ()}]
)
def test_an_open_door_is_refused(change: dict) -> None:
    from pathlib import Path

    with pytest.raises(InputError):
        View(**{"what": (Path("a"),), **change})
