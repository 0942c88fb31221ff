"""The bytes of chiral, the protocol of TRI-ML's raiden: a length (4 bytes), a header in msgpack, and raw arrays.

Reading them runs no code. Source: TRI-ML/chiral f7293d7, protocol.py; its client asks, and the robot answers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ResourceError
from ..geometry.se3 import Array
from ..images.image import Image

# Of a message that is taken, bytes. An action has some hundreds.
LARGEST = 65_536
# Numbers of an action, at most.
_MOST_NUMBERS = 256
_DTYPES = ("float16", "float32", "float64")

METADATA, RESET, OBSERVATION, ACTION = "metadata", "reset", "obs_request", "apply_action"
_RESET_ANSWER, _OBSERVATION_ANSWER = "reset_response", "obs_response"


class ChiralError(ValueError):
    """Bytes that are no message of chiral's."""


@dataclass(frozen=True)
class View:
    """What a camera saw.

    Attributes:
        picture: RGB (height, width, 3).
        K: intrinsics (3, 3).
        T_cam_in_base: pose (4, 4) in the left arm's base, in OpenCV's convention.
        time_ns: when, ns since 1970.
    """

    picture: Image
    K: Array
    T_cam_in_base: Array
    time_ns: int


@dataclass(frozen=True)
class Observed:
    """What a client is told of one moment: views by camera, arrays (n,) by name, when in s since 1970, and remarks."""

    views: Mapping[str, View]
    proprios: Mapping[str, Array]
    time: float
    extra: Mapping[str, Any]


def require_libraries() -> None:
    """Make sure that msgpack and websockets are installed.

    Raises:
        ResourceError: one is not.
    """
    try:
        import msgpack  # noqa: F401
        import websockets  # noqa: F401
    except ModuleNotFoundError as error:
        raise ResourceError(f"--chiral needs {error.name}, which is not here: pip install 'yamsim[remote]'") from error


def read(message: bytes) -> tuple[str, Array | None]:
    """What a client asks for, and of an action its numbers (n,).

    Raises:
        ChiralError: it is no message that is taken.
    """
    import msgpack

    length = int.from_bytes(message[:4], "little")
    if len(message) < 4 or not 1 <= length <= len(message) - 4:
        raise ChiralError("the header's length does not fit")
    try:
        header = msgpack.unpackb(message[4 : 4 + length], raw=False, strict_map_key=True)
    # msgpack's errors have no base but these two.
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise ChiralError("the header is not msgpack") from error
    kind = header.get("type") if isinstance(header, dict) else None
    if kind in (METADATA, RESET, OBSERVATION):
        return str(kind), None
    if kind != ACTION:
        raise ChiralError(f"a message is one of {METADATA}, {RESET}, {OBSERVATION} and {ACTION}")
    return ACTION, _numbers(header.get("shape"), header.get("dtype"), message[4 + length :])


def metadata(told: Mapping[str, Any]) -> bytes:
    """The answer that says what the robot is."""
    return _framed({"type": "metadata_response", "data": dict(told)})


def observation(observed: Observed, *, reset: bool) -> bytes:
    """The answer that tells what is seen and felt, to a request or to a reset."""
    parts: list[bytes] = []
    at = 0

    def put(data: bytes) -> tuple[int, int]:
        nonlocal at
        parts.append(data)
        at += len(data)
        return at - len(data), len(data)

    cameras = []
    for name, view in observed.views.items():
        start, size = put(view.picture.tobytes())
        cameras.append(
            {
                "name": name,
                "timestamp": view.time_ns,
                "intrinsics": view.K.ravel().tolist(),
                "extrinsics": view.T_cam_in_base.ravel().tolist(),
                "image_shape": list(view.picture.shape),
                "image_dtype": "uint8",
                "image_offset": start,
                "image_size": size,
            }
        )
    proprios = []
    for name, values in observed.proprios.items():
        start, size = put(np.asarray(values, np.float32).tobytes())
        proprios.append({"name": name, "dtype": "float32", "offset": start, "size": size})
    header = {
        "type": _RESET_ANSWER if reset else _OBSERVATION_ANSWER,
        "timestamp": observed.time,
        "cameras": cameras,
        "proprios": proprios,
        "extra": dict(observed.extra),
        **({"info": {}} if reset else {}),
    }
    return _framed(header) + b"".join(parts)


def _framed(header: Mapping[str, Any]) -> bytes:
    import msgpack

    packed: bytes = msgpack.packb(header)
    return len(packed).to_bytes(4, "little") + packed


def _numbers(shape: Any, dtype: Any, data: bytes) -> Array:
    if dtype not in _DTYPES:
        raise ChiralError(f"an action's dtype is one of {', '.join(_DTYPES)}")
    if not isinstance(shape, list) or not 1 <= len(shape) <= 3 or not all(type(n) is int and n > 0 for n in shape):
        raise ChiralError("an action's shape is not valid")
    count = math.prod(shape)
    if count > _MOST_NUMBERS or count * np.dtype(dtype).itemsize != len(data):
        raise ChiralError("an action has not as many bytes as its shape says")
    numbers: Array = np.frombuffer(data, dtype).astype(np.float64)
    return numbers
