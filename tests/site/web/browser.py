"""Headless Chromium for tests of the page, driven over its DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.waiting import eventually
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_socket

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
    "--disable-extensions", "--disable-dev-shm-usage", "--remote-debugging-port=0",
    "--disable-back-forward-cache", "--disable-site-isolation-trials",
    "--disable-background-networking", "--disable-component-update", "--disable-breakpad",
    "--disable-sync", "--disable-default-apps", "--metrics-recording-only",
    "--disable-features=PreloadTopChromeWebUI,SpareRendererForSitePerProcess",
)  # fmt: skip
# Pages ask for a frame sixty times a second, and here the processor draws each: 80 ms
# later is soon enough.
FRAMES = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 80);
window.cancelAnimationFrame = clearTimeout;
"""
AXE = Path(__file__).parent / "axe" / "axe.min.js"
SIZES = {"screen": (1440, 900), "tablet": (1024, 768), "phone": (390, 844)}
LOOKS = {"screen": False, "tablet": True, "phone": False}  # whether the system asks for dark
SHOWN_S = 90.0  # for a browser beside others, on a machine that is very busy


def browser_path() -> str | None:
    """Return where a browser is; None if there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


in_browser = pytest.mark.skipif(
    browser_path() is None, reason="found no chromium, .ci/run installs one"
)


class Page:
    """A page of the browser."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._count = socket, 0
        self.messages: list[str] = []  # what the page wrote to its console, and its errors
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=FRAMES)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(60))
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        said = event.get("params", {})
        if event["method"] == "Runtime.exceptionThrown":
            self.messages.append(str(said["exceptionDetails"]))
        elif event["method"] == "Log.entryAdded":
            self.messages.append(f"{said['entry']['text']} {said['entry'].get('url', '')}")

    def resize(self, width: int, height: int) -> None:
        """Give the window a size; a narrow one is that of a phone."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 600)  # fmt: skip

    def open(self, url: str, width: int = 1280, height: int = 900) -> None:
        """Open an address in a window of a size."""
        self.resize(width, height)
        self.call("Page.navigate", url="about:blank")  # else another fragment loads nothing
        assert eventually(lambda: self.run("location.href") == "about:blank")
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def of(self, module: str, expression: str) -> Any:
        """Return the value of an expression in which `m` is a module of the page."""
        return self.run(f"import('/{module}.js').then((m) => ({expression}))")

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press and release a key."""
        codes = {"Enter": 13, "Tab": 9, " ": 32, "Escape": 27, "ArrowLeft": 37, "ArrowRight": 39}
        text = {"Enter": "\r", " ": " "}.get(key, key if len(key) == 1 else "")
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=key if len(key) > 1 else "",
                windowsVirtualKeyCode=codes.get(key, 0), modifiers=8 if shift else 0,
                **({"text": text} if text and kind == "keyDown" else {}),
            )  # fmt: skip

    def dark(self, on: bool) -> None:
        """Let the system ask for a dark page, or a light one."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if on else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def slow(self, on: bool = True) -> None:
        """Let the network be slow: 0.4 s to an answer, 200 kB a second; or as fast as it is."""
        self.call("Network.enable")
        self.call(
            "Network.emulateNetworkConditions", offline=False, latency=400 if on else 0,
            downloadThroughput=200_000 if on else -1, uploadThroughput=200_000 if on else -1,
        )  # fmt: skip

    def serious(self, what: str = "document") -> list[Any]:
        """Return what axe finds of what is serious: rule, and each element with what is wrong.

        Args:
            what: a script's expression for what to look at.
        """
        if self.run("typeof axe") == "undefined":
            self.run(AXE.read_text() + ";undefined")
        found = self.run(
            f"axe.run({what}, {{ resultTypes: ['violations'] }}).then((all) => JSON.stringify("
            "all.violations.map((v) => [v.impact, v.id, v.nodes.map((n) => [n.html.slice(0, 120),"
            " n.failureSummary])])))"
        )
        return [one for one in json.loads(found) if one[0] in ("serious", "critical")]

    def judge(self, what: str = "document") -> None:
        """Look at the page that is open on each screen, with axe.

        Nothing serious may be found, nothing be wider than the screen, and the page be dark where
        the system asks for it.
        """
        ground = "getComputedStyle(document.body).backgroundColor"
        try:
            for size, dark in LOOKS.items():
                self.dark(dark)
                self.resize(*SIZES[size])
                width = f"document.documentElement.scrollWidth === {SIZES[size][0]}"
                assert eventually(partial(self.run, width)), size
                assert (int(self.run(ground)[4:].split(",")[0]) < 60) == dark, (size, dark)
                assert self.serious(what) == [], (size, dark)
        finally:
            self.dark(False)
            self.resize(*SIZES["screen"])

    def text(self, element: str) -> str:
        """Return the text of an element by its id; empty while it is not there."""
        return str(self.run(f"document.getElementById({element!r})?.textContent ?? ''"))

    def shows(self, element: str, text: str) -> bool:
        """Wait until an element has a text in it; return whether it does in time."""
        return eventually(lambda: text in self.text(element), SHOWN_S)

    def picture(self, path: Path | None = None) -> NDArray[np.uint8]:
        """Return the window as `(height, width, 3)` RGB."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(image[..., ::-1], dtype=np.uint8)


@contextmanager
def browser(folder: Path, *flags: str) -> Iterator[Page]:
    """Start a browser with a profile in a folder; yield its page.

    Args:
        folder: of the profile.
        flags: more of them.
    """
    path = browser_path()
    assert path is not None
    program = subprocess.Popen(
        [path, *FLAGS, *flags, f"--user-data-dir={folder}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    port_file = folder / "DevToolsActivePort"
    try:
        assert eventually(lambda: port_file.is_file() and "\n" in port_file.read_text(), 60)
        port = port_file.read_text().splitlines()[0]
        with connect_socket(_page_address(port), max_size=None, ping_interval=None) as socket:
            yield Page(socket)
    finally:
        program.terminate()
        try:
            program.wait(10)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()


def _page_address(port: str) -> str:
    import httpx

    def pages() -> list[dict[str, Any]]:
        found = httpx.get(f"http://127.0.0.1:{port}/json", timeout=30).json()
        return [one for one in found if one["type"] == "page"]

    assert eventually(pages)
    return str(pages()[0]["webSocketDebuggerUrl"])
