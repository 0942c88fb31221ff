"""A minimal WebDriver client for headless Chromium."""

from __future__ import annotations

import base64
import json
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from yamsim_cli.core.geometry.se3 import Array

CHROMIUM, CHROMEDRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # key under which WebDriver names an element
CHROMIUM_ARGS = [
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=900,600",  # without a GPU, each picture's time is proportional to its pixels
]
PAGE_TIMEOUT_S = 300  # s, for a script, a page load and a request: the shared processor renders


class WebDriverError(Exception):
    """An error of WebDriver.

    Attributes:
        error: the protocol's name of the error, such as `no such element`.
    """

    def __init__(self, request: str, error: str, message: str) -> None:
        super().__init__(f"{request}: {error}: {message}")
        self.error = error


class Browser:
    """A session of Chromium."""

    def __init__(self, port: int, profile: Path, args: Sequence[str] = CHROMIUM_ARGS) -> None:
        self._root = f"http://127.0.0.1:{port}"
        options = {"binary": str(CHROMIUM), "args": [*args, f"--user-data-dir={profile}"]}
        timeouts = {"script": 1000 * PAGE_TIMEOUT_S, "pageLoad": 1000 * PAGE_TIMEOUT_S}
        wanted = {"browserName": "chrome", "goog:chromeOptions": options, "timeouts": timeouts}
        session = self._call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self._root += f"/session/{session['sessionId']}"

    def _call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._root + path, method=method, data=data)
        try:
            with urllib.request.urlopen(request, timeout=PAGE_TIMEOUT_S) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as refusal:
            with refusal:
                text = refusal.read().decode(errors="replace")
            raise _told(f"{method} {path} {data.decode() if data else ''}"[:300], refusal.code, text) from None

    def open(self, url: str) -> None:
        self._call("POST", "/url", {"url": url})

    def resize(self, width: int, height: int) -> None:
        """Set the window's size in pixels."""
        self._call("POST", "/window/rect", {"width": width, "height": height})

    def text(self) -> str:
        text: str = self._call("POST", "/execute/sync", {"script": "return document.body.innerText", "args": []})
        return text

    def devtools(self, command: str, **parameters: Any) -> Any:
        """The result of a command of the DevTools protocol."""
        return self._call("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def screenshot(self, file: Path | None = None) -> Array:
        """The page as rendered now, BGR; also written to a PNG file, if one is given."""
        # WebDriver's own screenshot fails after 10 s, which is too short for a live page on a busy machine. This
        # command has no limit.
        png = base64.b64decode(self.devtools("Page.captureScreenshot", format="png")["data"])
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(png)
        return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))

    def run(self, script: str, *args: Any) -> Any:
        return self._call("POST", "/execute/sync", {"script": script, "args": list(args)})

    def keys(self, text: str) -> None:
        """Press keys without focus."""
        down_up = [{"type": kind, "value": key} for key in text for kind in ("keyDown", "keyUp")]
        self._act({"type": "key", "id": "keys", "actions": down_up})

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag with the mouse from one pixel to another."""

        def move(share: float, duration: int) -> dict[str, Any]:
            x, y = (round(a + (b - a) * share) for a, b in zip(start, end, strict=True))
            return {"type": "pointerMove", "duration": duration, "x": x, "y": y}

        # The page must render a few pictures with the pointer on an object before a drag.
        pause = {"type": "pause", "duration": 2000}
        steps = [move(0, 0), pause, move(0.02, 50), pause, {"type": "pointerDown", "button": 0}, pause]
        steps += [move(k / 8, 150) for k in range(1, 9)]
        steps += [pause, {"type": "pointerUp", "button": 0}]
        self._act({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps})

    def _act(self, source: dict[str, Any]) -> None:
        self._call("POST", "/actions", {"actions": [source]})

    def press(self, selector: str, keys: str) -> None:
        self._with_element(
            "css selector",
            selector,
            lambda element: self._call("POST", f"/element/{element}/value", {"text": keys}),
        )

    def click(self, label: str) -> None:
        def click(element: str) -> None:
            self.run("arguments[0].scrollIntoView({block: 'center'})", {ELEMENT: element})
            self._call("POST", f"/element/{element}/click", {})

        self._with_element("xpath", f"//button[contains(., '{label}')]", click)

    def _with_element(self, using: str, value: str, act: Callable[[str], object]) -> None:
        """Act on an element, which is found again if the page replaces it in between."""
        for attempts_left in reversed(range(10)):
            try:
                act(self._call("POST", "/element", {"using": using, "value": value})[ELEMENT])
                return
            except WebDriverError as refusal:
                if not attempts_left or refusal.error != "stale element reference":
                    raise

    def close(self) -> None:
        self._call("DELETE", "")


def _told(request: str, status: int, text: str) -> WebDriverError:
    """An error in the driver's own words, without its stack trace."""
    try:
        value = json.loads(text)["value"]
        return WebDriverError(request, value["error"], value["message"])
    except (ValueError, KeyError, TypeError):
        return WebDriverError(request, f"HTTP {status}", text[:300])


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait_until(true: Callable[[], object], seconds: float = PAGE_TIMEOUT_S) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.1)
