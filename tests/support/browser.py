"""A headless Chromium, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import http.client
import importlib
import itertools
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

OFF = "gpu", "quic", "background-networking", "component-update", "sync", "dev-shm-usage"
FLAGS = ("--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--remote-debugging-port=0")
PATIENCE = 60.0  # s
PROBLEMS = "Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"


def executable() -> str | None:
    """Return where Chromium is, None if it is not installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Tab:
    """One page and everything that it logged and asked for."""

    def __init__(self, connection: Any) -> None:
        self._connection, self._ids = connection, itertools.count(1)
        self.problems: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result; events that come meanwhile are recorded."""
        number = next(self._ids)
        self._connection.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._connection.recv(timeout=PATIENCE))
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._record(message.get("method"), message.get("params", {}))

    def _record(self, method: str | None, event: dict[str, Any]) -> None:
        if method in PROBLEMS:
            self.problems.append(json.dumps(event))
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"])

    def open(self, path: Path, *, width: int = 1280, height: int = 900, scheme: str = "light") -> None:
        """Open a file in a window of this size, for a reader who prefers this colour scheme."""
        self.size(width, height)
        self.prefer(scheme)
        self.problems.clear(), self.requests.clear()
        self.call("Page.navigate", url=path.as_uri())
        self.wait_for("document.readyState === 'complete' && location.protocol === 'file:'")

    def size(self, width: int, height: int, scale: float = 1.0) -> None:
        """Set the size of the window [CSS px] and its pixels per CSS px."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)

    def prefer(self, scheme: str, motion: str = "no-preference") -> None:
        """Set the reader's preferences: ``light`` or ``dark``, ``no-preference`` or ``reduce``."""
        features = {"prefers-color-scheme": scheme, "prefers-reduced-motion": motion}
        self.call("Emulation.setEmulatedMedia", features=[{"name": n, "value": v} for n, v in features.items()])

    def run(self, expression: str) -> Any:
        """Return the value of a JavaScript expression; a promise is awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']['exception'].get('description')}")
        return answer["result"].get("value")

    def barriers(self) -> list[str]:
        """Return the rules of axe that the page breaks."""
        axe = Path(importlib.import_module("axe_core_python").__file__ or "").with_name("axe.min.js")
        self.run(f"{axe.read_text(encoding='utf-8')};0")
        found: list[str] = self.run("axe.run().then(found => found.violations.map(rule => rule.id))")
        return found

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        deadline = time.monotonic() + PATIENCE
        while not self.run(condition):
            if time.monotonic() > deadline:
                raise TimeoutError(f"not true after {PATIENCE:g} s: {condition}")
            time.sleep(0.02)

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press and release a key, named as in `KeyboardEvent.key`."""
        number = {"End": 35, "Home": 36, "ArrowLeft": 37, "ArrowRight": 39, "Tab": 9}.get(key, ord(key[0]))
        name, text = "Space" if key == " " else key, {"text": key} if len(key) == 1 else {}
        event = {"key": key, "code": name, "modifiers": 8 * shift, "windowsVirtualKeyCode": number}
        self.call("Input.dispatchKeyEvent", type="keyDown", **event, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **event)

    def click(self, right: float, down: float) -> None:
        """Click at a place of the window [CSS px]."""
        for kind in ("mousePressed", "mouseReleased"):
            where = {"x": right, "y": down, "button": "left", "buttons": 1, "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, **where)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Save what the window shows, or the whole page, as PNG."""
        picture = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(picture["data"]))


@contextlib.contextmanager
def chromium() -> Iterator[Tab]:
    """Run a Chromium of its own, with a fresh profile, and give its first tab."""
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        off = (f"--disable-{feature}" for feature in OFF)
        command = [str(executable()), *FLAGS, *off, f"--user-data-dir={profile}", "about:blank"]
        log = Path(profile) / "log.txt"
        with log.open("wb") as output:
            process = subprocess.Popen(command, stdout=output, stderr=output)
        try:
            address = _first_page(Path(profile) / "DevToolsActivePort", process, log)
            # No pings: they draw from Python's global generator in a thread, whenever they like, in other tests too.
            with connect(address, max_size=None, ping_interval=None) as connection:
                yield Tab(connection)
        finally:
            process.terminate()
            process.wait(PATIENCE)


def _first_page(path: Path, process: subprocess.Popen[bytes], log: Path) -> str:
    """Return the address of the first page once the browser has written its port down."""
    deadline = time.monotonic() + PATIENCE
    while not path.is_file() or path.read_text().count("\n") < 1:
        if process.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError(f"Chromium did not start: {log.read_text(errors='replace')[-2000:]}")
        time.sleep(0.05)
    port = path.read_text().split("\n")[0]
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", int(port), timeout=PATIENCE)) as browser:
        browser.request("GET", "/json")
        targets = json.load(browser.getresponse())
    return str(next(target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page"))
