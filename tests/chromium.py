"""Headless Chromium for tests of pages, over the DevTools protocol: a page's requests, console and content."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--disable-extensions",
    "--no-default-browser-check",
    "--remote-debugging-port=0",
)
# WebGL without a GPU.
_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_PATIENCE = 240.0  # s, timeout for a start or an answer on a busy machine


class Page:
    """One page in one browser. errors: exceptions, and errors and warnings of the console. requests: every URL that
    was asked for, the page's own included."""

    def __init__(self, socket: Any):
        self._socket, self._numbers = socket, itertools.count(1)
        self.errors: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command of the protocol and return its answer; events in between are recorded."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=_PATIENCE))
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                return message["result"]
            self._note(message)

    def open(self, place: Path | str) -> None:
        """Load a file, or an address, and wait until it is there."""
        self.call("Page.navigate", url=place if isinstance(place, str) else place.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise AssertionError(found["exceptionDetails"].get("exception", {}).get("description", "an exception"))
        return found["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + _PATIENCE
        while not self.run(condition):
            assert time.monotonic() < end, f"never true: {condition}"
            time.sleep(0.02)

    def size(self, width: int, height: int, *, dark: bool = False, phone: bool = False) -> None:
        """Set the size of the window, CSS pixels."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 10) -> None:
        """Press the left button at `start`, move to `end`, and release it."""
        self.mouse("pressed", *start)
        for step in range(1, steps + 1):
            x, y = (a + (b - a) * step / steps for a, b in zip(start, end, strict=True))
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left", buttons=1)
        self.mouse("released", *end)

    def mouse(self, kind: str, x: float, y: float) -> None:
        """A mouse event; kind: moved, pressed or released, with the left button."""
        pressed = kind != "moved"
        self.call(
            "Input.dispatchMouseEvent",
            type=f"mouse{kind.capitalize()}",
            x=x,
            y=y,
            button="left" if pressed else "none",
            clickCount=int(pressed),
        )

    def key(self, name: str) -> None:
        """Press and release a key, as ArrowRight, Enter or Tab."""
        codes = {"Enter": 13, "Tab": 9, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, " ": 32}
        text = {"Enter": "\r", " ": " "}.get(name, "")
        self.call("Input.dispatchKeyEvent", type="keyDown", key=name, windowsVirtualKeyCode=codes[name], text=text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=name, windowsVirtualKeyCode=codes[name])

    def picture(self, file: Path, *, whole: bool = False) -> None:
        """A screenshot as PNG, of the window or of the whole page."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(shot["data"]))

    def _note(self, message: dict[str, Any]) -> None:
        told = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(told["request"]["url"])
            case "Runtime.exceptionThrown":
                self.errors.append(told["exceptionDetails"].get("exception", {}).get("description", "an exception"))
            case "Runtime.consoleAPICalled" if told["type"] in ("error", "warning", "assert"):
                self.errors.append(str(told["args"]))
            case "Log.entryAdded" if told["entry"]["level"] in ("error", "warning"):
                self.errors.append(told["entry"]["text"])


def find_chromium() -> str:
    """The program. Skips the test without Chromium, or without a client for its protocol."""
    pytest.importorskip("websockets", reason="websockets isn't installed, which talks to Chromium")
    for name in _NAMES:
        if (program := shutil.which(name)) is not None:
            return program
    pytest.skip(f"no Chromium here: looked for {', '.join(_NAMES)}")


@contextmanager
def browser(*, webgl: bool = False) -> Iterator[Page]:
    """A page of a browser of its own, with an empty profile; both are gone afterwards. webgl: in software."""
    from websockets.sync.client import connect

    program = find_chromium()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        drawing = _WEBGL if webgl else ("--disable-gpu",)
        command = [program, *_FLAGS, *drawing, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            port = _port(Path(profile) / "DevToolsActivePort", process)
            target = _target(port)
            with connect(target, max_size=None, open_timeout=_PATIENCE, proxy=None) as socket:
                yield Page(socket)
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def opened_in(page: Path) -> float:
    """Milliseconds until a page is loaded, its visible pictures too; the best of three, as other work takes time."""
    times = []
    for _ in range(3):
        with browser() as chromium:
            chromium.size(1280, 900)
            chromium.open(page)
            chromium.wait("performance.timing.loadEventEnd > 0")
            times.append(chromium.run("performance.getEntriesByType('navigation')[0].loadEventEnd"))
            assert chromium.errors == []
    return min(times)


def _port(file: Path, process: subprocess.Popen) -> int:
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        if process.poll() is not None:
            pytest.skip(f"Chromium can't run here: it ended with status {process.returncode}")
        if file.is_file() and "\n" in (text := file.read_text()):
            return int(text.splitlines()[0])
        time.sleep(0.05)
    pytest.skip("Chromium can't run here: it opened no port")


def _target(port: int) -> str:
    """The address of the open page, from the browser's own list on the loopback interface."""
    import http.client

    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_PATIENCE)
    connection.request("GET", "/json")
    targets = json.loads(connection.getresponse().read())
    return next(target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page")
