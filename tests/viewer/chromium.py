"""A page in headless Chromium, driven by the DevTools protocol: what a person does in it."""

import base64
import itertools
import json
import re
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from tests.eval.reporting.browser import CHROMIUM

_ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0", "about:blank",
)  # fmt: skip


class Chromium:
    """A browser with one page; use it in a `with` statement.

    Args:
        folder: an empty folder for its profile.
        width: width of the page, px.
        height: height of the page, px.
    """

    def __init__(self, folder: Path, width: int = 1400, height: int = 900) -> None:
        size = [f"--user-data-dir={folder / 'profile'}", f"--window-size={width},{height}"]
        self._process = subprocess.Popen(
            [CHROMIUM, *size, *_ARGUMENTS], stderr=subprocess.PIPE, text=True
        )
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if found := re.search(r"DevTools listening on ws://([^/]+)/", line):
                break
        with urllib.request.urlopen(f"http://{found[1]}/json") as answer:
            pages = [one for one in json.load(answer) if one["type"] == "page"]
        self._socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=None, ping_interval=None)
        self._numbers = itertools.count()
        self.console: list[str] = []
        """Warnings and errors of the page's console."""
        self.requests: list[str] = []
        """Addresses that the page has asked for."""
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip

    def __enter__(self) -> "Chromium":
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()
        self.kill()

    def kill(self) -> None:
        """End the browser as rudely as a crash does."""
        self._process.kill()
        self._process.communicate()

    def send(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message["method"] == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"][:200])
        elif message["method"] == "Runtime.consoleAPICalled":
            if parameters["type"] in ("error", "warning"):
                said = " ".join(str(one.get("value", "")) for one in parameters["args"])
                self.console.append(f"{parameters['type']}: {said}")
        elif message["method"] == "Runtime.exceptionThrown":
            self.console.append(json.dumps(parameters["exceptionDetails"])[:400])
        elif message["method"] == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.console.append(parameters["entry"]["text"])

    def open(self, url: str) -> None:
        """Go to a page."""
        self.send("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        result = self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        return result["result"].get("value")

    def text(self) -> str:
        """Text of the page, as shown."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def wait(self, until: Callable[[], object], seconds: float = 60.0) -> None:
        """Wait until something holds of the page."""
        end_s = time.monotonic() + seconds
        while not until():
            assert time.monotonic() < end_s, self.text()[-2000:]
            time.sleep(0.05)

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Press, move or release the left button of the mouse."""
        down = kind != "mouseReleased"
        self.send(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left",
            buttons=int(down), clickCount=1,
        )  # fmt: skip
        self.draw()  # the page looks for what is under the mouse when it draws

    def draw(self) -> None:
        """Wait until the page has drawn itself."""
        frames = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        self.send("Runtime.evaluate", expression=frames, awaitPromise=True)

    def click(self, x: float, y: float) -> None:
        """Click somewhere."""
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def place_of(self, selector: str, text: str) -> tuple[float, float]:
        """Middle of the last visible element of a selector whose text, or value, is this."""
        found = self.evaluate(
            f"[...document.querySelectorAll({json.dumps(selector)})]"
            f".filter(one => (one.value || one.innerText).trim() === {json.dumps(text)})"
            ".map(one => one.getBoundingClientRect()).filter(b => b.width > 0)"
            ".map(b => [b.x + b.width / 2, b.y + b.height / 2])"
        )
        assert found, f"no {selector} with the text {text!r}"
        x, y = found[-1]
        return x, y

    def screenshot(self, path: Path) -> None:
        """Write a PNG of the page."""
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot")["data"]))
