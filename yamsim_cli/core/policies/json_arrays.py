"""JSON with arrays in it, as the package json_numpy writes it: base64 of the bytes, the dtype's name and the shape."""

from __future__ import annotations

import base64
import binascii
import json
from typing import Any

import numpy as np

from .bounds import DamagedError, array_of, check_json

_MARK = "__numpy__"


def dump_json(message: Any) -> bytes:
    """A message of plain containers, text, numbers and arrays."""
    return json.dumps(message, default=_array).encode()


def load_json(data: bytes) -> Any:
    """The message in bytes; arrays in it are read-only.

    Raises:
        DamagedError: they are no JSON, hold too many values, or an array in it is damaged.
    """
    try:
        check_json(data)
        return json.loads(data, object_hook=_whole)
    except (ValueError, RecursionError) as error:
        text = str(error) if isinstance(error, DamagedError) else f"no JSON: {str(error)[:100]}"
        raise DamagedError(text) from error


def _array(value: object) -> dict[str, Any]:
    if isinstance(value, np.ndarray | np.generic):
        content = base64.b64encode(value.tobytes()).decode("ascii")
        return {_MARK: content, "dtype": value.dtype.str, "shape": list(value.shape)}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _whole(found: dict[str, Any]) -> Any:
    if _MARK not in found:
        return found
    try:
        content = base64.b64decode(found[_MARK], validate=True)
    except (TypeError, ValueError, binascii.Error) as error:
        raise DamagedError("an array whose content is no base64") from error
    whole = array_of(content, found.get("dtype"), found.get("shape"))
    return whole if whole.ndim else whole[()]
