"""Limits of a policy server's answer: bytes, values and actions, for all protocols."""

from __future__ import annotations

import json
import socket
import tracemalloc
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.policies.servers import raw_server, read_request
from yamsim_cli.policies.act import ActClient, load_json
from yamsim_cli.policies.action_chunks import ChunkScheduler, ChunkSettings
from yamsim_cli.policies.openpi import unpack_openpi
from yamsim_cli.policies.policy_client import MAX_VALUES, DamagedMessageError, RemoteError, action_rows
from yamsim_cli.policies.policy_protocol import ActionChunk, InvalidActionError, read_chunk
from yamsim_cli.policies.remote_policy import MessageError, RemotePolicy, pack_message, unpack_message

_MOST_MEMORY = 40_000_000  # bytes during the reading of an answer: ten times the largest accepted one


def _peak(work: Callable[[], Any]) -> int:
    """Largest number of bytes that Python and numpy had allocated at once."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_text_in_place_of_actions_takes_no_memory() -> None:
    """numpy would make an array as wide as the longest text."""

    def work() -> None:
        for value in (["x" * 100_000, *["a"] * 1000], ["1"], [[{}]], [[[[[[[[[[1]]]]]]]]]]):
            with pytest.raises(InvalidActionError, match="actions "):
                action_rows(value, "actions", 7)

    assert _peak(work) < 2_000_000


@pytest.mark.parametrize("size", [3_900_000])
@pytest.mark.parametrize("load", [unpack_openpi, unpack_message])
def test_small_containers_are_counted_while_msgpack_is_decoded(load: Callable[[bytes], Any], size: int) -> None:
    heads = b"\x81\xa1a\xdd" + size.to_bytes(4, "big")

    def work() -> None:
        for inner in (b"\x90", b"\x80"):
            with pytest.raises((DamagedMessageError, MessageError), match=f"more than {MAX_VALUES} values"):
                load(heads + inner * size)

    assert _peak(work) < _MOST_MEMORY


@pytest.mark.parametrize("inner", ["[]", "{}", "0", "[[]]"])
def test_small_containers_are_counted_before_json_is_decoded(inner: str) -> None:
    data = f'{{"actions": [{",".join([inner] * 900_000)}]}}'.encode()

    def work() -> None:
        with pytest.raises(DamagedMessageError, match=f"more than {MAX_VALUES} values"):
            load_json(data)

    assert _peak(work) < _MOST_MEMORY


def test_the_largest_honest_answer_is_read() -> None:
    rows = np.random.default_rng(0).normal(size=(1000, 14)).tolist()
    assert action_rows(load_json(json.dumps({"actions": rows}).encode())["actions"], "actions", 14).shape == (1000, 14)
    assert unpack_message(pack_message({"ctrl": rows}))["ctrl"] == rows


@pytest.mark.parametrize("head", [b"Transfer-Encoding: chunked\r\n", b"", b"Content-Length: 99999999999\r\n"])
def test_an_endless_answer_is_cut_off(head: bytes) -> None:
    sent = 0

    def answer(connection: socket.socket) -> None:
        nonlocal sent
        read_request(connection)
        connection.sendall(b"HTTP/1.1 200 OK\r\n" + head + b"\r\n")
        block = b"x" * 0x10000
        while sent < 400_000_000:
            connection.sendall(b"10000\r\n" + block + b"\r\n" if b"chunked" in head else block)
            sent += len(block)

    def work() -> None:
        with raw_server(answer) as port:
            client = ActClient(f"act://127.0.0.1:{port}", 5.0)
            with pytest.raises(RemoteError, match="longer than"):
                client.infer({"state": [1.0]})

    assert _peak(work) < _MOST_MEMORY
    assert sent < 100_000_000


def test_a_long_error_is_shortened() -> None:
    error = RemoteError("e" * 1_000_000, "t" * 1_000_000)
    assert len(error.fault.text) < 10_000
    assert len(error.fault.traceback) < 100_000


def test_text_from_a_policy_server_is_refused_as_an_action() -> None:
    said = [
        pack_message({"session": "s", "images": [], "ticks": 1}),
        pack_message({"action": {"ctrl": ["x" * 1000, "a"]}}),
    ]

    def answer(connection: socket.socket) -> None:
        for data in said:
            read_request(connection)
            connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(data) + data)

    with raw_server(answer) as port:
        policy = RemotePolicy(f"http://127.0.0.1:{port}", 5.0)
        with pytest.raises(InvalidActionError, match="ctrl"):
            policy({"time": 0.0})
    policy.close()


def test_a_chunk_has_a_horizon() -> None:
    with pytest.raises(InvalidActionError, match="last 200 s, not at most 100"):
        read_chunk({"ctrl": np.zeros((20, 7)), "period": 10.0}, 1, 7)


def test_chunks_that_can_act_no_more_are_dropped() -> None:
    """With a request after each action, a scheduler without averaging keeps at most two chunks."""
    player = ChunkScheduler(ChunkSettings(execute=1), 0.032, 1, np.zeros((1, 7)))
    kept = list[weakref.ref[np.ndarray]]()
    for tick in range(200):
        rows = np.full((1000, 1, 7), tick)
        kept.append(weakref.ref(rows))
        player.add_chunk(ActionChunk(rows, np.zeros((1000, 1), bool), False), tick, 0.0)
        del rows
        ctrl, _ = player.command_at(tick)
        assert ctrl[0, 0] == tick
        assert sum(one() is not None for one in kept) <= 2


def test_an_older_chunk_acts_on_where_a_newer_one_is_shorter() -> None:
    player = ChunkScheduler(ChunkSettings(execute=1), 0.032, 1, np.zeros((1, 7)))
    for tick, length in ((0, 10), (1, 2)):
        player.add_chunk(ActionChunk(np.full((length, 1, 7), tick), np.zeros((length, 1), bool), False), tick, 0.0)
    acted = [player.command_at(tick)[0][0, 0] for tick in range(1, 12)]
    assert acted == [1, 1, 0, 0, 0, 0, 0, 0, 0, 1, 1]


def test_joints_in_degrees_are_refused_and_named() -> None:
    with pytest.raises(InvalidActionError, match=r"ctrl has a joint at -90.*is it in degrees"):
        read_chunk({"ctrl": [[0, -90, 45, 0, 0, 0, 0.01]]}, 1, 7)
    read_chunk({"ctrl": [0, 3.1, 0, 0, 0, 0, 50.0]}, 1, 7)
