"""Clients of other programs' policies: messages, answers, and harmless peers."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import re
import socket
import struct
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.policies.servers import act_server, openpi_server, raw_server, read_request
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.policies.act import ActClient, dump_json, load_json
from yamsim_cli.policies.openpi import OpenpiClient, pack_openpi, unpack_openpi
from yamsim_cli.policies.policy_client import (
    MAX_ANSWER_BYTES,
    DamagedMessageError,
    RemoteError,
    action_period,
    action_rows,
    array_from_bytes,
)
from yamsim_cli.policies.policy_protocol import InvalidActionError

pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
pytest.importorskip("websockets", reason="yamsim[remote] is not installed")

MESSAGE = {"picture": np.arange(60, dtype=np.uint8).reshape(4, 5, 3), "state": np.ones(14, np.float32), "prompt": "p"}


def doubled(message: Mapping[str, Any]) -> dict[str, Any]:
    """Actions that show whether the whole message arrived."""
    assert message["picture"].dtype == np.uint8
    assert message["picture"][3, 4, 2] == 59
    assert message["prompt"] == "p"
    return {"actions": np.stack([message["state"] * 2] * 3), "dt_ms": 20.0}


def test_act_sends_arrays_and_understands_them() -> None:
    with act_server(doubled) as url:
        client = ActClient(url, 5.0)
        for _ in range(3):
            answer = client.infer(MESSAGE)
            assert answer["actions"].dtype == np.float32
            np.testing.assert_array_equal(answer["actions"], np.full((3, 14), 2.0))
            assert answer["dt_ms"] == 20.0
        client.close()
        with pytest.raises(RemoteError, match=r"answers 404"):
            ActClient(f"{url}/elsewhere", 5.0).infer(MESSAGE)


def test_openpi_sends_arrays_and_understands_them() -> None:
    with openpi_server(lambda data: pack_openpi(doubled(unpack_openpi(data)))) as url:
        client = OpenpiClient(url, 5.0)
        client.begin_trial(0)
        for _ in range(3):
            np.testing.assert_array_equal(client.infer(MESSAGE)["actions"], np.full((3, 14), 2.0))
        # Longer than the short forms of a frame's length.
        client.infer({**MESSAGE, "more": np.zeros(300_000, np.uint8)})
        client.close()


def test_an_error_of_openpis_server_is_told_and_the_next_trial_connects_again() -> None:
    answers = iter(["Traceback (most recent call last):\n  ...\nKeyError: 'no such thing'\n", b"\x81\xa1a\x01"])
    with openpi_server(lambda _: next(answers)) as url:
        client = OpenpiClient(url, 5.0)
        with pytest.raises(RemoteError, match="KeyError: 'no such thing'") as caught:
            client.infer(MESSAGE)
        assert caught.value.fault.traceback.startswith("Traceback")
        client.begin_trial(1)
        assert client.infer(MESSAGE) == {"a": 1}
        client.close()


@pytest.mark.parametrize("make", [ActClient, OpenpiClient])
def test_an_address_without_a_server_is_refused(make: Callable[..., Any]) -> None:
    scheme = "act" if make is ActClient else "ws"
    with pytest.raises(ResourceError, match="no policy answers there"):
        make(f"{scheme}://127.0.0.1:9", 2.0)
    for url in (f"{scheme}://", "wss://127.0.0.1:9", f"{scheme}://127.0.0.1:99999", f"{scheme}://u:p@127.0.0.1:9"):
        with pytest.raises(UsageError, match=f"give {scheme}://HOST:PORT"):
            make(url, 2.0)


def http_answer(body: bytes, length: int | None = None, status: str = "200 OK") -> bytes:
    return f"HTTP/1.1 {status}\r\nContent-Length: {len(body) if length is None else length}\r\n\r\n".encode() + body


ARRAY = '{{"actions": {{"__numpy__": "{}", "dtype": {}, "shape": {}}}}}'
LIES = [
    (b"nonsense", "BadStatusLine|nonsense"),
    (http_answer(b"<html>"), "not JSON"),
    (http_answer(b"[" * 100_000), "not JSON"),
    (http_answer(b"1" * 10_000), "not JSON|answers 200"),
    (http_answer(b"\xff\xfe\x00"), "not JSON"),
    (http_answer(b"[1]"), r"answers 200: \[1\]"),
    (http_answer(b"{}", status="500 Internal Server Error"), "answers 500"),
    (http_answer(b"{", length=10**12), "not JSON"),
    (http_answer(b" " * (MAX_ANSWER_BYTES + 1)), "longer than"),
    (b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 1000, "headers"),
    (b"", "connection is lost"),
    (http_answer(ARRAY.format("AAAA", '"|O8"', "[1]").encode()), "not a dtype of plain numbers"),
    (http_answer(ARRAY.format("AAAA", '"O"', "[1]").encode()), "not a dtype"),
    (http_answer(ARRAY.format("AAAA", '[["a", "<f8"]]', "[1]").encode()), "the name of a dtype"),
    (http_answer(ARRAY.format("AAAA", '"f4,f4"', "[1]").encode()), "not a dtype"),
    (http_answer(ARRAY.format("AAAA", '"S1000000000"', "[1]").encode()), "not a dtype"),
    (http_answer(ARRAY.format("AAAA", '"M8[ns]"', "[1]").encode()), "not a dtype"),
    (http_answer(ARRAY.format("AAAA", '"<f4"', "[1000000, 1000000]").encode()), "do not fit an array of float32"),
    (http_answer(ARRAY.format("AAAA", '"u1"', "[-3, -1]").encode()), "is not a shape"),
    (http_answer(ARRAY.format("AAAA", '"u1"', "[true, 3]").encode()), "is not a shape"),
    (http_answer(ARRAY.format("AAAA", '"u1"', "3").encode()), "a shape is a list"),
    (http_answer(ARRAY.format("A!", '"u1"', "[1]").encode()), "not base64"),
    (http_answer(b'{"a": {"__numpy__": 7}}'), "not base64"),
]


@pytest.mark.parametrize(("said", "told"), LIES)
def test_an_invalid_answer_of_an_act_server_is_refused(said: bytes, told: str) -> None:
    def answer(connection: socket.socket) -> None:
        read_request(connection)
        connection.sendall(said)

    with raw_server(answer) as port:
        client = ActClient(f"act://127.0.0.1:{port}", 2.0)
        with pytest.raises(RemoteError) as caught:
            client.infer({"state": [1.0]})
        assert re.search(told, str(caught.value)), str(caught.value)
        client.close()


def test_an_answer_that_comes_too_late_is_never_another_questions() -> None:
    calls: list[int] = []

    def infer(message: Mapping[str, Any]) -> dict[str, Any]:
        calls.append(message["n"])
        time.sleep(0.5 if len(calls) == 1 else 0)
        return {"n": message["n"]}

    with act_server(infer) as url:
        client = ActClient(url, 0.1)
        with pytest.raises(TimeoutError):
            client.infer({"n": 1})
        assert client.infer({"n": 2}) == {"n": 2}
        client.close()


def frame(data: bytes, *, code: int = 2, last: bool = True, length: int | None = None) -> bytes:
    size = len(data) if length is None else length
    return struct.pack(">BBQ", (0x80 if last else 0) | code, 127, size) + data


def handshake(connection: socket.socket) -> None:
    key = re.search(rb"Sec-WebSocket-Key: (\S+)", read_request(connection))
    assert key is not None
    accept = base64.b64encode(hashlib.sha1(key[1] + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest())
    connection.sendall(
        b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Accept: " + accept + b"\r\n\r\n" + frame(b"\x80")
    )


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (frame(b"\xc1"), "not msgpack"),
        (frame(b"\x90"), "list instead of a mapping"),
        (frame(b"\x91" * 100_000), "not msgpack"),
        (frame(b"\xdd\xff\xff\xff\xff"), "not msgpack"),
        (frame(b"\x81\x90\x01"), "not msgpack"),
        (frame(b"\x81\xa1a\xc7\x01\x05\x00"), "ExtType|not msgpack|a"),
        (frame(pack_openpi({"a": {b"__ndarray__": True, b"data": b"x" * 8, b"dtype": "|O8", b"shape": [1]}})), "dtype"),
        (frame(pack_openpi({"a": {b"__ndarray__": True, b"data": 5, b"dtype": "<f8", b"shape": [1]}})), "needs bytes"),
        (frame(pack_openpi({"a": {b"__ndarray__": True}})), "needs bytes"),
        (frame(b"", length=2**62), "longer than 4000000 bytes"),
        (
            frame(b"x" * 3_000_000, last=False) + frame(b"x" * 3_000_000, code=0),
            "longer than 4000000 bytes",
        ),
        (frame(b"", code=9) * 5000, "connection is lost"),
        (frame(b"a", last=False) + frame(b"b"), "protocol error"),
        (frame(b"a", code=0), "protocol error"),
        (frame(b"a", code=5), "protocol error"),
        (frame(b"\x03\xe8bye", code=8), "bye"),
        (b"\xff\x00", "protocol error"),
        (b"", "no close frame received"),
        (frame(b"oops", code=1), "oops"),
    ],
)
def test_an_invalid_answer_of_an_openpi_server_is_refused(said: bytes, told: str) -> None:
    def answer(connection: socket.socket) -> None:
        handshake(connection)
        connection.recv(65536)
        connection.sendall(said)

    with raw_server(answer) as port:
        client = OpenpiClient(f"ws://127.0.0.1:{port}", 2.0)
        try:
            client.infer({"state": [1.0]})
        except RemoteError as error:
            assert re.search(told, str(error)), str(error)
        else:
            # An unknown type of msgpack is an invalid value.
            assert "ExtType" in told
        client.close()


@pytest.mark.parametrize("said", [b"", b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 20_000, http_answer(b"", status="101 Yes")])
def test_a_server_without_websocket_is_refused(said: bytes) -> None:
    def answer(connection: socket.socket) -> None:
        read_request(connection)
        connection.sendall(said)

    with raw_server(answer) as port, pytest.raises(ResourceError):
        OpenpiClient(f"ws://127.0.0.1:{port}", 2.0)


@pytest.mark.parametrize("make", [ActClient, OpenpiClient])
def test_a_peer_that_says_nothing_is_not_waited_for(make: Callable[..., Any]) -> None:
    def answer(connection: socket.socket) -> None:
        if make is OpenpiClient:
            handshake(connection)
        while connection.recv(65536):
            pass

    with raw_server(answer) as port:
        client = make(f"{'act' if make is ActClient else 'ws'}://127.0.0.1:{port}", 0.2)
        began = time.monotonic()
        with pytest.raises(TimeoutError):
            client.infer({"state": [1.0]})
        assert time.monotonic() - began < 5
        client.close()


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (np.zeros((3, 13)), r"has the shape \(3, 13\), not \(actions, 14\)"),
        (np.zeros((1, 3, 14)), r"has the shape \(1, 3, 14\)"),
        (np.zeros((0, 14)), "holds 0 actions, not 1 to 1000"),
        (np.zeros((1001, 14)), "holds 1001 actions"),
        (np.full((2, 14), np.nan), "is not finite, first in action 0"),
        ([[1.0] * 14, [1.0] * 13], "its rows differ in length"),
        ([["a"] * 14], "is of type list, not an array of numbers"),
        ([[10**400] * 14], "is of type list, not an array of numbers"),
        (None, "is of type NoneType, not an array of numbers"),
        ({"a": 1}, "is of type dict, not an array of numbers"),
    ],
)
def test_invalid_rows_of_actions_are_refused(value: object, told: str) -> None:
    with pytest.raises(InvalidActionError, match=f"^actions {told}" if "its rows" not in told else told):
        action_rows(value, "actions", 14)


def test_a_row_alone_is_one_action_and_whole_numbers_do() -> None:
    assert action_rows(list(range(14)), "actions", 14).shape == (1, 14)


@pytest.mark.parametrize("value", [-5, 0.5, 20_000, float("nan"), "20", True, [20]])
def test_an_invalid_period_is_refused(value: object) -> None:
    with pytest.raises(InvalidActionError, match=r"^dt_ms is "):
        action_period(value, "dt_ms")


def test_without_a_period_in_the_answer_the_config_gives_it() -> None:
    assert (action_period(None, "dt_ms"), action_period(0, "dt_ms"), action_period(20, "dt_ms")) == (None, None, 0.02)


@pytest.mark.parametrize("dtype", ["<f4", "<f8", ">f8", "<i8", "|u1", "|b1", "<f2"])
def test_arrays_survive_both_formats(dtype: str) -> None:
    whole = np.arange(6).reshape(2, 3).astype(dtype)
    for found in (load_json(dump_json({"a": whole}))["a"], unpack_openpi(pack_openpi({"a": whole}))["a"]):
        assert found.dtype == whole.dtype
        np.testing.assert_array_equal(found, whole)
    assert load_json(dump_json({"a": np.float64(0.5)}))["a"] == 0.5
    assert unpack_openpi(pack_openpi({"a": np.float64(0.5)}))["a"] == 0.5


@pytest.mark.parametrize("seed", range(4))
def test_random_bytes_are_refused_or_read_without_a_crash(seed: int) -> None:
    """A good message with bytes that were changed."""
    rng = np.random.default_rng(seed)
    good = {"actions": np.zeros((3, 14)), "n": 1, "text": "t"}
    for load, data in ((load_json, dump_json(good)), (unpack_openpi, pack_openpi(good))):
        for _ in range(300):
            spoilt = bytearray(data)
            for place in rng.integers(0, len(data), 3):
                spoilt[place] = rng.integers(0, 256)
            with contextlib.suppress(DamagedMessageError):
                load(bytes(spoilt))


@pytest.mark.slow
@pytest.mark.parametrize("make", [ActClient, OpenpiClient])
def test_thousands_of_spoilt_answers_are_refused_or_read_and_memory_stays(make: Callable[..., Any]) -> None:
    """Over the wire: changed bytes anywhere in good answers, the protocol's headers included, or cut short."""
    rng = np.random.default_rng(0)
    good = {"actions": np.zeros((30, 14)), "dt_ms": 20.0}
    whole = http_answer(dump_json(good)) if make is ActClient else frame(pack_openpi(good))

    def answer(connection: socket.socket) -> None:
        if make is OpenpiClient:
            handshake(connection)
            connection.recv(65536)
        else:
            read_request(connection)
        spoilt = bytearray(whole)
        for place in rng.integers(0, len(spoilt) if rng.random() < 0.5 else 60, 3):
            spoilt[place] = rng.integers(0, 256)
        connection.sendall(spoilt if rng.random() < 0.8 else spoilt[: rng.integers(0, len(spoilt))])

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    with raw_server(answer) as port:
        client = make(f"{'act' if make is ActClient else 'ws'}://127.0.0.1:{port}", 5.0)
        counts, before = {"read": 0, "refused": 0}, 0
        for number in range(3_000):
            if number == 1000:
                before = resident()
            try:
                client.infer({"state": [1.0]})
                counts["read"] += 1
            except RemoteError:
                counts["refused"] += 1
            client.close()
    assert min(counts.values()) > 100, counts
    assert resident() - before < 20_000_000


def test_an_array_is_no_larger_than_its_bytes() -> None:
    assert array_from_bytes(b"\0" * 8, b"<f8", [1]).shape == (1,)
    with pytest.raises(DamagedMessageError, match="float64"):
        array_from_bytes(b"", "<f8", [MAX_ANSWER_BYTES])
    assert array_from_bytes(b"", "<f8", [0, 5]).size == 0


def test_no_client_unpickles() -> None:
    """Neither clients nor their modules use pickle."""
    folder = Path(__file__).parents[2] / "yamsim_cli/policies"
    for path in folder.glob("*.py"):
        assert not re.search(r"(?<!\.)\b(pickle|allow_pickle|np\.load|eval\(|exec\()", path.read_text()), path.name
