from __future__ import annotations

import importlib

from .errors import ResourceError


def require_library(feature: str, library: str, extra: str) -> None:
    """Raise ResourceError if an optional library of `feature` is not installed; the message names the extra."""
    try:
        importlib.import_module(library)
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        raise ResourceError(f"{feature} needs {library}, which is missing: pip install 'yamsim[{extra}]'") from error
