from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np


def json_text(data: Mapping[str, Any]) -> str:
    """Return indented JSON with a newline at the end.

    NumPy's values become plain ones; paths become text; infinities and NaN become null.
    """
    return json.dumps(_to_plain_data(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _to_plain_data(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return _to_plain_data(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _to_plain_data(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain_data(each) for each in value]
    return value
