"""JSON text of results, for stdout and for reports."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np


def json_text(data: Mapping[str, Any]) -> str:
    """Return a result as indented JSON that ends in a newline.

    NumPy's scalars and arrays become numbers, booleans and lists, and paths become text.

    Raises:
        TypeError: a value has no JSON form.
        ValueError: a number is infinite or not a number.
    """
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False, default=_plain) + "\n"


def _plain(value: object) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"a result has a {type(value).__name__}, which JSON cannot hold: {value!r}")
