"""The bytes of portal, the maker's remote calls: a tree of numbers, arrays and text. Reading them runs no code.

A message is its length (8 bytes), then a request's number, then a method's name or a status, then a packed tree: how
many buffers there are, their sizes, and the buffers, of which the first two are msgpack: the tree, and what each leaf
is.
Source: `portal` 3.8.3, packlib.py, buffers.py, client.py. Leaves in shared memory, which portal also has, are refused.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import ResourceError

HANDSHAKE = b"portal_handshake"
# Of a message that is taken, bytes. A command has some hundreds.
LARGEST = 65_536
_MOST_LEAVES = 256
_DEEPEST = 8
_KINDS = "biuf"


class PortalError(ValueError):
    """Bytes that are no call."""


def require_msgpack() -> None:
    """Make sure that msgpack is installed.

    Raises:
        ResourceError: it is not.
    """
    try:
        import msgpack  # noqa: F401
    except ModuleNotFoundError as error:
        raise ResourceError("--portal needs msgpack, which is not here: pip install 'yamsim[remote]'") from error


def read_call(message: bytes) -> tuple[bytes, str, list[Any]]:
    """A request's number (8 bytes), the method that it calls, and the arguments.

    Raises:
        PortalError: it is none.
    """
    if len(message) < 16:
        raise PortalError("the message is too short")
    length = int.from_bytes(message[8:16], "little")
    if length > 64:
        raise PortalError("the method's name is too long")
    try:
        name = message[16 : 16 + length].decode()
    except UnicodeDecodeError as error:
        raise PortalError("the method's name is no text") from error
    arguments = unpack(message[16 + length :])
    if not isinstance(arguments, list):
        raise PortalError("the arguments are no list")
    return message[:8], name, arguments


def answer(number: bytes, result: Any) -> bytes:
    """The message that answers a request with a result."""
    return _framed(number + bytes(8) + pack(result))


def refusal(number: bytes, text: str) -> bytes:
    """The message that tells whoever made a request what was wrong with it."""
    return _framed(number + (4).to_bytes(8, "little") + text.encode())


def pack(tree: Any) -> bytes:
    """A tree of dictionaries with text for keys, lists, arrays, numbers and None."""
    import msgpack

    leaves = list(_leaves(tree))
    specs: list[list[Any]] = []
    buffers = []
    for leaf in leaves:
        if leaf is None:
            specs.append(["none"])
            buffers.append(b"\0")
        else:
            array = np.asarray(leaf, order="C")
            specs.append(["array", list(array.shape), array.dtype.str])
            buffers.append(array.tobytes() or b"\0")
    buffers = [msgpack.packb(_structure(tree)), msgpack.packb(specs), *buffers]
    sizes = struct.pack(f"<{len(buffers)}Q", *map(len, buffers))
    return b"".join([len(buffers).to_bytes(8, "little"), sizes, *buffers])


def unpack(data: bytes) -> Any:
    """The tree in packed bytes.

    Raises:
        PortalError: it is none, or has what is not taken.
    """
    import msgpack

    count = int.from_bytes(data[:8], "little")
    if not 2 <= count <= _MOST_LEAVES or len(data) < 8 + 8 * count:
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
    # msgpack's errors have no base but these two.
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise PortalError("the arguments are not packed as they should be") from error
    if not isinstance(specs, list) or len(specs) != len(buffers) - 2:
        raise PortalError("the arguments are not described as they should be")
    leaves = iter([_leaf(spec, buffer) for spec, buffer in zip(specs, buffers[2:], strict=True)])
    found = _filled(tree, leaves, 0)
    if next(leaves, leaves) is not leaves:
        raise PortalError("there are more leaves than the tree has")
    return found


def _framed(message: bytes) -> bytes:
    return len(message).to_bytes(8, "little") + message


def _leaves(tree: Any) -> Iterator[Any]:
    if isinstance(tree, dict):
        for value in tree.values():
            yield from _leaves(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _leaves(value)
    else:
        yield tree


def _structure(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _structure(value) for key, value in tree.items()}
    return [_structure(value) for value in tree] if isinstance(tree, list) else None


def _leaf(spec: Any, data: bytes) -> Any:
    kind = spec[0] if isinstance(spec, list) and spec else None
    if kind == "none":
        return None
    if kind == "utf8":
        return data.decode(errors="replace")
    if kind == "bytes":
        return data
    if kind != "array" or len(spec) != 3:
        raise PortalError("a leaf is of a kind that is not taken")
    shape, name = spec[1:]
    if not isinstance(shape, list) or len(shape) > 4 or not all(type(n) is int and 0 <= n <= LARGEST for n in shape):
        raise PortalError("an array's shape is not valid")
    try:
        dtype = np.dtype(name) if isinstance(name, str) and len(name) <= 4 else None
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or dtype.kind not in _KINDS:
        raise PortalError("an array is of a type that is not taken")
    if math.prod(shape) * dtype.itemsize != (len(data) if math.prod(shape) else 0):
        raise PortalError("an array has not as many bytes as its shape says")
    return np.frombuffer(data if math.prod(shape) else b"", dtype).reshape(shape)


def _filled(tree: Any, leaves: Iterator[Any], depth: int) -> Any:
    if depth > _DEEPEST:
        raise PortalError("the arguments are nested too deeply")
    if isinstance(tree, dict):
        return {key: _filled(value, leaves, depth + 1) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_filled(value, leaves, depth + 1) for value in tree]
    try:
        return next(leaves)
    except StopIteration:
        raise PortalError("the tree has more leaves than there are") from None
