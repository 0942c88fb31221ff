from __future__ import annotations

import re

# Renderer names of OpenGL implementations that use no GPU: Mesa's llvmpipe, softpipe, lavapipe and swrast, and others.
_SOFTWARE_RENDERER = re.compile("llvmpipe|softpipe|lavapipe|swrast|software|swiftshader", re.IGNORECASE)


def is_software_renderer(name: str) -> bool:
    """Return whether OpenGL's renderer with this name uses no GPU."""
    return _SOFTWARE_RENDERER.search(name) is not None
