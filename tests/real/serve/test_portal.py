"""portal's calls: read and answered as portal packs them, and nothing else is accepted."""

from __future__ import annotations

import random
import resource
import select
import socket
import struct
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest

from yamsim_cli.real.serve.portal import HANDSHAKE_BYTES, PortalError, PortalServer, pack_tree, unpack_tree

# `portal.packlib.pack({"joint_pos": np.arange(2.0), "n": 3})` of 3.8.3, joined.
PACKED = bytes.fromhex(
    "04000000000000000f000000000000001a000000000000001000000000000000080000000000000082a96a6f696e745f706f73c0a16ec0"
    "9293a561727261799102a33c663893a5617272617990a33c69380000000000000000000000000000f03f0300000000000000"
)


class Arm:
    """A follower that only records its calls."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def num_dofs(self) -> int:
        return 7

    def joint_pos(self) -> np.ndarray:
        return np.arange(7.0)

    def get_observations(self) -> dict[str, np.ndarray]:
        return {"joint_pos": np.arange(6.0), "gripper_pos": np.array([0.5])}

    def command_joint_pos(self, joint_pos: Any) -> None:
        if not len(joint_pos):
            raise ValueError("joint_pos: has shape (0,)")
        self.told.append(np.asarray(joint_pos, dtype=float))

    def command_joint_state(self, joint_state: Any) -> None:
        self.told.append(joint_state)


@pytest.fixture
def arm() -> Arm:
    return Arm()


@pytest.fixture
def server(arm: Arm) -> Iterator[PortalServer]:
    made = PortalServer(arm, "127.0.0.1", 0)  # type: ignore[arg-type]
    yield made
    made.close()


def join(server: PortalServer, greeting: bytes = HANDSHAKE_BYTES) -> socket.socket:
    one = socket.create_connection(("127.0.0.1", server.port), timeout=5)
    one.sendall(greeting)
    serve(server)
    return one


def serve(server: PortalServer) -> None:
    while ready := select.select(server.readers, [], [], 0.02)[0]:
        server.handle(set(ready))


def request(name: str, *arguments: Any, number: int = 1) -> bytes:
    body = number.to_bytes(8, "little") + len(name).to_bytes(8, "little") + name.encode()
    body += pack_tree(list(arguments))
    return len(body).to_bytes(8, "little") + body


def answered(one: socket.socket) -> tuple[int, int, Any]:
    """The number, the status, and the result or the text."""
    length = int.from_bytes(one.recv(8), "little")
    body = b""
    while len(body) < length:
        body += one.recv(length - len(body))
    number, status = struct.unpack("<QQ", body[:16])
    return number, status, body[16:].decode() if status else unpack_tree(body[16:])


def test_messages_have_the_bytes_of_portal() -> None:
    tree = {"joint_pos": np.arange(2.0), "n": 3}
    assert pack_tree(tree) == PACKED
    np.testing.assert_equal(unpack_tree(PACKED), tree)


def test_trees_come_back_as_they_were() -> None:
    tree = [{"pos": np.arange(7.0), "kp": np.float32(2.0)}, None, np.zeros((0, 3)), 4]
    back = unpack_tree(pack_tree(tree))
    np.testing.assert_equal(back, [{"pos": np.arange(7.0), "kp": np.float32(2.0)}, None, np.zeros((0, 3)), 4])


def test_calls_are_answered_in_their_order(server: PortalServer, arm: Arm) -> None:
    one = join(server)
    one.sendall(request("num_dofs", number=5) + request("command_joint_pos", np.ones(7), number=6))
    serve(server)
    assert answered(one) == (5, 0, 7)
    assert answered(one) == (6, 0, None)
    np.testing.assert_equal(arm.told, [np.ones(7)])
    one.sendall(request("get_observations"))
    serve(server)
    np.testing.assert_equal(answered(one)[2], {"joint_pos": np.arange(6.0), "gripper_pos": np.array([0.5])})


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (request("move"), "Unknown method 'move'; valid: num_dofs"),
        (request("num_dofs", np.ones(1)), "Error in server method"),
        (request("command_joint_pos", ["left"][0:0]), "Error in server method"),
        ((24).to_bytes(8, "little") + bytes(8) + (0).to_bytes(8, "little") + b"8" * 8, "Could not decode message"),
    ],
    ids=["method", "arguments", "shape", "packing"],
)
def test_a_wrong_call_is_told_and_the_next_is_answered(server: PortalServer, wrong: bytes, says: str, arm: Arm) -> None:
    one = join(server)
    one.sendall(wrong)
    serve(server)
    _, status, text = answered(one)
    assert status and says in text
    one.sendall(request("num_dofs"))
    serve(server)
    assert answered(one)[2] == 7


def _packed(tree: Any, specs: Any, *buffers: bytes) -> bytes:
    whole = [msgpack.packb(tree), msgpack.packb(specs), *buffers]
    return len(whole).to_bytes(8, "little") + struct.pack(f"<{len(whole)}Q", *map(len, whole)) + b"".join(whole)


@pytest.mark.parametrize(
    "data",
    [
        _packed([None], [["sharray", "psm_1", [3], "<f8"]], b"\0"),
        _packed([None], [["array", [1], "|O"]], bytes(8)),
        _packed([None], [["array", [2**40, 2**40], "<f8"]], bytes(8)),
        _packed([None], [["array", [-1], "<f8"]], bytes(8)),
        _packed([None], [["array", [1], "<f8,<f8"]], bytes(16)),
        _packed([None, None], [["none"]], b"\0"),
        _packed([], [["none"]], b"\0"),
        _packed([[[[[[[[[[None]]]]]]]]]], [["none"]], b"\0"),
        _packed({"a": None}, 3),
        b"\xff" * 64,
    ],
    ids=["shared-memory", "objects", "huge", "negative", "records", "missing", "surplus", "deep", "specs", "sizes"],
)
def test_invalid_messages_are_refused(data: bytes) -> None:
    with pytest.raises(PortalError):
        unpack_tree(data)


def test_another_greeting_or_a_message_without_end_is_hung_up_on(server: PortalServer) -> None:
    for said in (b"GET / HTTP/1.1\r\n\r\n", HANDSHAKE_BYTES + (2**40).to_bytes(8, "little")):
        one = join(server, said)
        assert one.recv(8) == b""


def test_random_messages_do_no_harm_and_fill_no_memory(server: PortalServer, arm: Arm) -> None:
    """10,000 messages, most framed correctly, so that all parts of the reader are reached."""
    draw = random.Random(7)
    whole = request("command_joint_pos", np.ones(7))
    one = join(server)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(10_000):
        noise = bytearray(whole[8:])
        for _ in range(draw.randrange(1, 6)):
            noise[draw.randrange(len(noise))] = draw.randrange(256)
        body = bytes(noise) if k % 2 else draw.randbytes(draw.randrange(1, 200))
        try:
            one.sendall(len(body).to_bytes(8, "little") + body if k % 499 else draw.randbytes(24))
        except OSError:
            one = join(server)
        if k % 10 == 0:
            ready = select.select(server.readers, [], [], 0)[0]
            server.handle(set(ready))
            while select.select([one], [], [], 0)[0]:
                if not one.recv(65_536):
                    one = join(server)
                    break
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000
    last = join(server)
    last.sendall(request("num_dofs"))
    serve(server)
    assert answered(last)[2] == 7
