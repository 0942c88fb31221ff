"""Checks for optional libraries, each installed by an extra of yamsim."""

from __future__ import annotations

import importlib

from .errors import ResourceError


def require_library(feature: str, library: str, extra: str) -> None:
    """Make sure that a library is installed.

    Args:
        feature: the feature that needs the library, for the message.
        library: name of the module.
        extra: extra of yamsim that installs the library.

    Raises:
        ResourceError: the library is not installed; the message names the extra.
    """
    try:
        importlib.import_module(library)
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        raise ResourceError(f"{feature} needs {library}, which is missing: pip install 'yamsim[{extra}]'") from error
