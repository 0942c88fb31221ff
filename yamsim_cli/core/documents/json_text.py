"""JSON text of results, for stdout and for reports."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np


def json_text(data: Mapping[str, Any]) -> str:
    """Return a result as indented JSON that ends in a newline.

    NumPy's scalars and arrays become numbers, booleans and lists, paths become text, and numbers that are not finite
    become null.

    Raises:
        TypeError: a value has no JSON form.
    """
    return json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """The same value of types that JSON knows, as far as there are such."""
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
