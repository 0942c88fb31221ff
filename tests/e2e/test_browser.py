"""The tests' WebDriver client, against a driver that refuses."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.e2e.browser import ELEMENT, Browser, WebDriverError

Reply = tuple[int, object]


class Driver(HTTPServer):
    """A scripted driver: end of a path -> its replies, the last one repeatedly."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.replies: dict[str, list[Reply]] = {
            "/session": [(200, {"sessionId": "s"})],
            "/element": [(200, {ELEMENT: "e"})],
            "/sync": [(200, None)],
            "/click": [(200, None)],
        }
        self.asked: list[str] = []


class Handler(BaseHTTPRequestHandler):
    server: Driver

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        end = self.path[self.path.rindex("/") :]
        self.server.asked.append(end)
        replies = self.server.replies[end]
        status, value = replies.pop(0) if len(replies) > 1 else replies[0]
        self.send_response(status)
        self.end_headers()
        self.wfile.write(json.dumps({"value": value}).encode() if not isinstance(value, bytes) else value)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def driver() -> Iterator[Driver]:
    with Driver() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def client(driver: Driver, folder: Path) -> Browser:
    return Browser(driver.server_address[1], folder)


def refusal(error: str) -> Reply:
    return 500, {"error": error, "message": f"{error}, in its own words", "stacktrace": "#0 0x55"}


def test_a_refusal_is_told_in_the_drivers_words(driver: Driver, tmp_path: Path) -> None:
    driver.replies["/sync"] = [refusal("javascript error")]
    with pytest.raises(WebDriverError, match=r"return 1.*javascript error, in its own words") as raised:
        client(driver, tmp_path).run("return 1")
    assert "0x55" not in str(raised.value)


def test_what_is_no_webdriver_answer_is_told_as_it_is(driver: Driver, tmp_path: Path) -> None:
    driver.replies["/sync"] = [(502, b"<html>")]
    with pytest.raises(WebDriverError, match="HTTP 502: <html>"):
        client(driver, tmp_path).text()


def test_an_element_drawn_anew_is_found_again(driver: Driver, tmp_path: Path) -> None:
    driver.replies["/click"] = [refusal("stale element reference"), (200, None)]
    client(driver, tmp_path).click("Home")
    assert driver.asked.count("/element") == driver.asked.count("/click") == 2


@pytest.mark.parametrize(
    ("error", "times"), [("element click intercepted", 1), ("no such element", 1), ("stale element reference", 10)]
)
def test_no_other_fault_of_a_page_is_hidden(driver: Driver, tmp_path: Path, error: str, times: int) -> None:
    driver.replies["/click"] = [refusal(error)]
    with pytest.raises(WebDriverError, match=error):
        client(driver, tmp_path).click("Home")
    assert driver.asked.count("/click") == times
