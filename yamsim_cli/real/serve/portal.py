"""Serve calls by the library `portal`, as the arm's maker does in `minimum_gello.py`.

A message has its length (8 bytes), the request's number, a method's name or a status, and a packed tree. A packed tree
has the number of buffers, their sizes, and the buffers. The first two are msgpack: the tree, and each leaf's type.
Reading never executes code. Leaves in shared memory are refused.
Source: `portal` 3.8.3, packlib.py, buffers.py, client.py.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from yamsim_cli.core.extras import require_library

from .follower import JointController
from .socket_servers import ClientConnection, TcpServer

_READ_BYTES = 65_536
_BACKLOG_BYTES = 1_000_000  # unsent bytes; above, a client is dropped

HANDSHAKE_BYTES = b"portal_handshake"  # first bytes of a client
_MAX_MESSAGE_BYTES = 65_536  # a command has some hundred bytes
_MAX_LEAVES = 256
_MAX_DEPTH = 8  # lists and dictionaries in a call's arguments
_DTYPE_KINDS = "biuf"  # NumPy booleans, integers and floats
_STATUS_ERROR = 4


class PortalError(ValueError):
    """Received bytes are no portal call."""


class PortalServer(TcpServer):
    """Answers portal calls for one arm. The caller closes the server; no method blocks.

    Raises:
        ResourceError: msgpack is not installed, or the server cannot listen on the port.
    """

    def __init__(self, follower: JointController, host: str, port: int) -> None:
        require_library("--portal", "msgpack", "remote")
        self._methods: dict[str, Callable[..., Any]] = {
            "num_dofs": follower.num_dofs,
            "get_joint_pos": follower.joint_pos,
            "command_joint_pos": follower.command_joint_pos,
            "command_joint_state": follower.command_joint_state,
            "get_observations": follower.get_observations,
        }
        super().__init__(host, port, "--portal", _READ_BYTES, _BACKLOG_BYTES)

    def handle(self, ready: set[Any]) -> None:
        """Receive calls and answer them."""
        for client in self.receive_from_clients(ready):
            try:
                while (message := _next_message(client)) is not None:
                    client.outgoing += self._answer_call(message)
            except PortalError:
                self.drop_client(client)
            else:
                self.send_outgoing(client)

    def _answer_call(self, message: bytes) -> bytes:
        try:
            number, name, arguments = _read_call(message)
        except PortalError as error:
            return _error_answer(message[:8].ljust(8, b"\0"), f"Could not decode message: {error}")
        method = self._methods.get(name)
        if method is None:
            return _error_answer(number, f"Unknown method {name!r}; valid: {', '.join(self._methods)}")
        try:
            return _add_frame_header(number + bytes(8) + pack_tree(method(*arguments)))
        # Wrong number or types of arguments.
        except (TypeError, ValueError) as error:
            return _error_answer(number, f"Error in server method: {error}")


def _next_message(client: ClientConnection) -> bytes | None:
    received = client.received
    if not client.handshake_done:
        head = bytes(received[: len(HANDSHAKE_BYTES)])
        if not HANDSHAKE_BYTES.startswith(head):
            raise PortalError("the client does not speak portal")
        if len(head) < len(HANDSHAKE_BYTES):
            return None
        client.handshake_done = True
        del received[: len(head)]
    if len(received) < 8:
        return None
    length = int.from_bytes(received[:8], "little")
    if not 1 <= length <= _MAX_MESSAGE_BYTES:
        raise PortalError(f"a message of {length} bytes is too long")
    if len(received) < 8 + length:
        return None
    message = bytes(received[8 : 8 + length])
    del received[: 8 + length]
    return message


def _read_call(message: bytes) -> tuple[bytes, str, list[Any]]:
    if len(message) < 16:
        raise PortalError("the message is too short")
    length = int.from_bytes(message[8:16], "little")
    if length > 64:
        raise PortalError("the method's name is too long")
    try:
        name = message[16 : 16 + length].decode()
    except UnicodeDecodeError as error:
        raise PortalError("the method's name is not text") from error
    arguments = unpack_tree(message[16 + length :])
    if not isinstance(arguments, list):
        raise PortalError("the arguments are not a list")
    return message[:8], name, arguments


def _error_answer(number: bytes, text: str) -> bytes:
    return _add_frame_header(number + _STATUS_ERROR.to_bytes(8, "little") + text.encode())


def _add_frame_header(message: bytes) -> bytes:
    return len(message).to_bytes(8, "little") + message


def pack_tree(tree: Any) -> bytes:
    """Pack dictionaries with text keys, lists, arrays, numbers and None."""
    import msgpack

    specs: list[list[Any]] = []
    buffers = []
    for leaf in _iterate_leaves(tree):
        if leaf is None:
            specs.append(["none"])
            buffers.append(b"\0")
        else:
            array = np.asarray(leaf, order="C")
            specs.append(["array", list(array.shape), array.dtype.str])
            buffers.append(array.tobytes() or b"\0")
    buffers = [msgpack.packb(_tree_structure(tree)), msgpack.packb(specs), *buffers]
    sizes = struct.pack(f"<{len(buffers)}Q", *map(len, buffers))
    return b"".join([len(buffers).to_bytes(8, "little"), sizes, *buffers])


def unpack_tree(data: bytes) -> Any:
    """Return the tree in packed bytes.

    Raises:
        PortalError: the bytes are no tree, or a leaf has an unsupported type.
    """
    import msgpack

    count = int.from_bytes(data[:8], "little")
    if not 2 <= count <= _MAX_LEAVES or len(data) < 8 + 8 * count:
        raise PortalError("the arguments are not packed as they should be")
    sizes = struct.unpack_from(f"<{count}Q", data, 8)
    if sum(sizes) != len(data) - 8 - 8 * count:
        raise PortalError("the sizes of the arguments do not add up")
    buffers, at = [], 8 + 8 * count
    for size in sizes:
        buffers.append(data[at : at + size])
        at += size
    try:
        tree, specs = (msgpack.unpackb(one, strict_map_key=True) for one in buffers[:2])
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise PortalError("the arguments are not packed as they should be") from error
    if not isinstance(specs, list) or len(specs) != len(buffers) - 2:
        raise PortalError("the description of the arguments is not valid")
    leaves = iter([_decode_leaf(spec, buffer) for spec, buffer in zip(specs, buffers[2:], strict=True)])
    found = _fill_tree(tree, leaves, 0)
    if next(leaves, leaves) is not leaves:
        raise PortalError("the message has more leaves than the tree")
    return found


def _iterate_leaves(tree: Any) -> Iterator[Any]:
    if isinstance(tree, dict | list):
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from _iterate_leaves(value)
    else:
        yield tree


def _tree_structure(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _tree_structure(value) for key, value in tree.items()}
    return [_tree_structure(value) for value in tree] if isinstance(tree, list) else None


def _decode_leaf(spec: Any, data: bytes) -> Any:
    kind = spec[0] if isinstance(spec, list) and spec else None
    if kind == "none":
        return None
    if kind == "utf8":
        return data.decode(errors="replace")
    if kind == "bytes":
        return data
    if kind != "array" or len(spec) != 3:
        raise PortalError("a leaf is of an unsupported kind")
    shape, name = spec[1:]
    most = _MAX_MESSAGE_BYTES
    if not isinstance(shape, list) or len(shape) > 4 or not all(type(n) is int and 0 <= n <= most for n in shape):
        raise PortalError("an array's shape is not valid")
    try:
        dtype = np.dtype(name) if isinstance(name, str) and len(name) <= 4 else None
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or dtype.kind not in _DTYPE_KINDS:
        raise PortalError("an array is of an unsupported type")
    if math.prod(shape) * dtype.itemsize != (len(data) if math.prod(shape) else 0):
        raise PortalError("the bytes of an array do not match its shape")
    return np.frombuffer(data if math.prod(shape) else b"", dtype).reshape(shape)


def _fill_tree(tree: Any, leaves: Iterator[Any], depth: int) -> Any:
    if depth > _MAX_DEPTH:
        raise PortalError("the arguments are nested too deeply")
    if isinstance(tree, dict):
        return {key: _fill_tree(value, leaves, depth + 1) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_fill_tree(value, leaves, depth + 1) for value in tree]
    try:
        return next(leaves)
    except StopIteration:
        raise PortalError("the tree has more leaves than the message") from None
