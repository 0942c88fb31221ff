"""The server of the review page: what it answers, what it refuses, and what is on the disk after each decision."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.core.dataset.making import CAMERA, FRAMES, failed_attempt, made, publish, tree, write_dataset
from yamsim_cli.core.dataset.dataset_paths import episode_directories, image_path
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import DatasetError, ResourceError
from yamsim_cli.review.decisions import DecisionFile
from yamsim_cli.review.episode_index import read_reports, read_rows
from yamsim_cli.review.page_server import CLAIM_SECONDS, PageClaim, ReviewServer
from yamsim_cli.selection import episode_hash, read_selection


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset", *(made(k) for k in range(5)))


@pytest.fixture
def server(dataset: Path) -> Iterator[ReviewServer]:
    directories = dict(episode_directories(dataset))
    with (
        DecisionFile(dataset / "selection.yaml", dataset, directories, None) as decisions,
        ReviewServer(dataset, directories, read_rows(dataset, {}), decisions, "ann", None, 0) as made,
    ):
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.shutdown()


Ask = Callable[..., tuple[int, Any]]


@pytest.fixture
def ask(server: ReviewServer) -> Ask:
    def send(path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
        return request(server.server_address[1], path, body, **headers)

    return send


def request(port: int, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    data = None if body is None else json.dumps(body)
    given = {key.replace("_", "-"): value for key, value in headers.items()}
    connection.request("GET" if body is None else "POST", path, data, given)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    is_json = answer.headers["Content-Type"] == "application/json"
    return answer.status, json.loads(content) if is_json else content


@pytest.fixture
def token(ask: Ask) -> str:
    return ask("/api/claim", {})[1]["token"]  # type: ignore[no-any-return]


def test_the_overview_knows_the_ledger_without_opening_episodes(tmp_path: Path) -> None:
    with DatasetWriter(tmp_path / "d", {"task": {"name": "pickplace"}, "seed": 7}, ExistingDatasetMode.NEW) as writer:
        publish(writer, made(0))
        writer.log_attempt(failed_attempt(1))
        publish(writer, made(1, attempt=2))
        writer.write_manifest()
    (tmp_path / "d/ep_000000/episode.json").write_text("not opened")
    rows = read_rows(tmp_path / "d", {1: {"problems": ("lowdim.jump",)}})
    assert [row["episode"] for row in rows] == [0, 1]
    assert (rows[0]["frames"], rows[0]["distance_mm"], rows[0]["x_m"]) == (FRAMES, 20.0, 0.3)
    assert rows[1]["problems"] == ("lowdim.jump",)
    assert "cause" not in rows[0], "no episode fills it"


def test_an_episode_that_ledger_or_manifest_lack_is_opened(dataset: Path) -> None:
    before = read_rows(dataset, {})
    (dataset / "manifest.json").unlink()
    with (dataset / "attempts.jsonl").open("ab") as ledger:
        ledger.write(b'{"attempt": 5, "cut')
    assert [{**row, "bytes": 0} for row in read_rows(dataset, {})] == [{**row, "bytes": 0} for row in before]
    (dataset / "ep_000002/episode.json").write_bytes(b"{")
    with pytest.raises(DatasetError, match="ep_000002"):
        read_rows(dataset, {})


def test_problems_of_a_report(tmp_path: Path, dataset: Path) -> None:
    report = yamsim("summarize", dataset, "--json").json
    (tmp_path / "report.json").write_text(json.dumps(report))
    found = read_reports([tmp_path / "report.json"])
    wanted = {problem["code"] for problem in report["problems"] if problem["episode"] == "ep_000003"}
    assert wanted
    assert set(found[3]["problems"]) == wanted
    (tmp_path / "report.json").write_text('{"problems": [3]}')
    run = yamsim("review", dataset, "--report", tmp_path / "report.json")
    assert run.code == 3
    assert "is no report of" in run.message


def test_pictures_strips_and_time_lines(ask: Ask, dataset: Path) -> None:
    status, picture = ask(f"/picture/1/{CAMERA}/2.jpg")
    assert (status, picture) == (200, (dataset / "ep_000001" / image_path(CAMERA, 2)).read_bytes())
    status, strip = ask("/strip/1.jpg")
    image = cv2.imdecode(np.frombuffer(strip, np.uint8), cv2.IMREAD_COLOR)
    assert (status, image.shape) == (200, (72, 4 * 96, 3))
    status, detail = ask("/api/episode/1")
    assert (status, detail["frames"], len(detail["series"]["joints"])) == (200, FRAMES, FRAMES)
    assert {event["what"] for event in detail["events"]} == {"weld on", "weld off"}


@pytest.mark.parametrize(
    "path",
    ["/picture/1/../../x/2.jpg", f"/picture/1/{CAMERA}/99.jpg", "/picture/1/other/0.jpg", "/api/episode/77",
     "/strip/9.jpg", "/../../etc/passwd", "/review.py", "/picture/1/%2e%2e/0.jpg"],
)  # fmt: skip
def test_what_is_not_there_is_refused(ask: Ask, path: str) -> None:
    status, answer = ask(path)
    assert status in (404, 422)
    assert "\n" not in answer["error"]


def test_a_link_out_of_the_dataset_is_refused(ask: Ask, dataset: Path, tmp_path: Path) -> None:
    picture = dataset / "ep_000001" / image_path(CAMERA, 0)
    outside = tmp_path / "outside.jpg"
    picture.rename(outside)
    picture.symlink_to(outside)
    status, answer = ask(f"/picture/1/{CAMERA}/0.jpg")
    assert status == 422
    assert "is a link out of the dataset" in answer["error"]
    (dataset / "ep_000002/lowdim").rename(tmp_path / "lowdim")
    (dataset / "ep_000002/lowdim").symlink_to(tmp_path / "lowdim")
    assert "is a link out of the dataset" in ask("/api/episode/2")[1]["error"]


def test_a_cut_file_is_refused_and_told(ask: Ask, dataset: Path) -> None:
    picture = dataset / "ep_000001" / image_path(CAMERA, 0)
    picture.write_bytes(picture.read_bytes()[:40])
    status, answer = ask(f"/picture/1/{CAMERA}/0.jpg")
    assert status == 422
    assert "is not what was recorded" in answer["error"]
    assert ask("/strip/1.jpg")[0] == 200, "its other pictures are shown"
    frame = next((dataset / "ep_000002/lowdim").iterdir())
    frame.write_bytes(frame.read_bytes()[:40])
    assert "is not what was recorded" in ask("/api/episode/2")[1]["error"]


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Origin": "null"}, {"Sec_Fetch_Site": "cross-site"}],
)
def test_other_sites_are_refused(ask: Ask, token: str, dataset: Path, headers: dict[str, str]) -> None:
    for path, body in (("/api/episodes", None), ("/strip/0.jpg", None),
                       ("/api/decide", {"token": token, "episode": 0, "decision": "drop"})):  # fmt: skip
        status, answer = ask(path, body, **headers)
        assert status == 403
        assert answer["error"].startswith("refused: ")
    assert not (dataset / "selection.yaml").exists()


def test_each_decision_is_on_the_disk_and_the_dataset_unchanged(ask: Ask, token: str, dataset: Path) -> None:
    before = tree(dataset)
    values = {"decision": "keep", "first_frame": 1, "last_frame": 2, "tags": ["slow"], "note": "späť"}
    status, answer = ask("/api/decide", {"token": token, "episode": 3, **values})
    assert (status, answer["decision"]["note"]) == (200, "späť")
    written = read_selection(dataset / "selection.yaml").decisions[3]
    assert written.model_dump(exclude={"episode"}) == values | {
        "tags": ("slow",), "sha256": episode_hash(dataset / "ep_000003"), "reviewer": "ann",
    }  # fmt: skip
    assert ask("/api/episodes")[1]["decisions"]["3"]["tags"] == ["slow"]
    ask("/api/decide", {"token": token, "episode": 3, "decision": "undecided"})
    assert read_selection(dataset / "selection.yaml").decisions == {}
    assert {name: data for name, data in tree(dataset).items() if name != "selection.yaml"} == before


@pytest.mark.parametrize(
    "values",
    [{"decision": "maybe"}, {"decision": "keep", "note": "two\nlines"}, {"decision": "keep", "last_frame": FRAMES},
     {"decision": "keep", "first_frame": 3, "last_frame": 1}, {"decision": "keep", "tags": [""]}, {"episode": "3"}],
)  # fmt: skip
def test_an_invalid_decision_is_refused(ask: Ask, token: str, dataset: Path, values: dict[str, Any]) -> None:
    status, answer = ask("/api/decide", {"token": token, "episode": 3, **values})
    assert status == 400
    assert "\n" not in answer["error"]
    assert not (dataset / "selection.yaml").exists()


def test_only_the_page_that_decides_starts_the_scene_of_an_episode_that_exists(
    ask: Ask, token: str, server: ReviewServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server.scenes, "play", lambda directory: f"http://127.0.0.1:1/{directory.name}")
    assert ask("/api/scene", {"token": token, "episode": 3}) == (200, {"url": "http://127.0.0.1:1/ep_000003"})
    assert ask("/api/scene", {"token": "other", "episode": 3})[0] == 409
    assert ask("/api/scene", {"token": token, "episode": "../../3"})[0] == 400
    assert ask("/api/scene", {"token": token, "episode": 77})[0] == 422


def test_a_request_that_is_no_decision_is_refused(ask: Ask) -> None:
    assert ask("/api/decide", [3])[0] == 400
    assert ask("/api/decide", {"note": "x" * 200_000})[0] == 400
    assert ask("/api/other", {})[0] == 404


def test_a_second_page_is_told_and_may_take_over(ask: Ask, token: str) -> None:
    assert ask("/api/claim", {})[0] == 409
    assert ask("/api/claim", {"token": token})[1]["token"] == token
    assert ask("/api/decide", {"token": "other", "episode": 1, "decision": "drop"})[0] == 409
    other = ask("/api/claim", {"take_over": True})[1]["token"]
    assert ask("/api/decide", {"token": token, "episode": 1, "decision": "drop"})[0] == 409
    assert ask("/api/decide", {"token": other, "episode": 1, "decision": "drop"})[0] == 200
    ask("/api/release", {"token": other})
    assert ask("/api/claim", {})[0] == 200


def test_a_page_that_vanished_blocks_for_a_few_seconds() -> None:
    now = 0.0
    claim = PageClaim(lambda: now)
    first = claim.claim("", take_over=False)
    now = CLAIM_SECONDS - 1
    assert claim.claim("", take_over=False) is None
    now = CLAIM_SECONDS + 1
    second = claim.claim("", take_over=False)
    assert second not in (None, first)
    assert claim.claim(first or "", take_over=False) is None


def test_a_second_review_of_the_same_file_is_refused(server: ReviewServer, dataset: Path) -> None:
    run = yamsim("review", dataset)
    assert run.code == 4
    assert f"is being written by process {os.getpid()} on " in run.err
    assert "choose another --out" in run.err
    with pytest.raises(ResourceError, match=r"selection\.yaml is being written by process"):
        DecisionFile(dataset / "selection.yaml", dataset, {}, None)
    DecisionFile(dataset / "bob.yaml", dataset, {}, None).close()
    assert [path.name for path in dataset.glob(".*.lock")] == [".selection.yaml.lock"]


def test_a_changed_episode_is_undecided_again(ask: Ask, token: str, dataset: Path, tmp_path: Path) -> None:
    for episode in (1, 2):
        ask("/api/decide", {"token": token, "episode": episode, "decision": "drop", "note": "dark"})
    record = dataset / "ep_000001/episode.json"
    record.write_bytes(record.read_bytes() + b"\n")
    copy = tmp_path / "copy.yaml"
    copy.write_bytes((dataset / "selection.yaml").read_bytes())
    directories = dict(episode_directories(dataset))
    with DecisionFile(copy, dataset, directories, None) as decisions:
        assert decisions.stale == [1]
        assert {k: (d.decision, d.note) for k, d in decisions.decisions.items()} == {
            1: ("undecided", "dark"), 2: ("drop", "dark"),
        }  # fmt: skip
    del directories[2]
    with pytest.raises(DatasetError, match="ep_000002 is not in the dataset"):
        DecisionFile(copy, dataset, directories, None)


@pytest.mark.slow
def test_killed_while_writing_nothing_but_the_last_key_is_lost(dataset: Path) -> None:
    """Decide as fast as the server answers, and kill it at a random time."""
    command = [sys.executable, "-m", "yamsim_cli", "review", dataset, "--port", "0", "--reviewer", "ann"]
    notes: dict[int, str | None] = {}
    for seed in range(3):
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            port = int(process.stdout.readline().split("/")[2].split(":")[1])
            token = request(port, "/api/claim", {})[1]["token"]
            timer = threading.Timer(0.2 + 0.1 * seed, os.kill, (process.pid, signal.SIGKILL))
            confirmed, sent = [], []
            try:
                for k in range(10_000):
                    sent.append((k % 5, f"{seed} {k}"))
                    body = {"token": token, "episode": k % 5, "decision": "drop", "note": f"{seed} {k}"}
                    status, _ = request(port, "/api/decide", body)
                    assert status == 200
                    confirmed.append(sent[-1])
                    if k == 0:
                        timer.start()
            except (OSError, http.client.HTTPException):
                pass
            timer.join()
        assert confirmed
        kept, notes = notes, {k: d.note for k, d in read_selection(dataset / "selection.yaml").decisions.items()}
        assert notes in (kept | dict(confirmed), kept | dict(sent))
    leftovers = [path.name for path in dataset.iterdir() if path.name.endswith(".part")]
    assert len(leftovers) <= 3
