"""Surfaces with fewer triangles that stay near what they are made from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..assets.lock import Reduction
from ..assets.reduction import collapsed
from ..geometry.closed import is_closed
from ..geometry.deviation import deviation
from ..geometry.se3 import Array
from ..geometry.stl import Faces

_MM = 1000.0
_SAMPLES = 2000
# Slivers are cleared first where they stall the collapse, mm; see `core.assets.reduction`.
_SLIVERS_MM = (0.0, 0.1)


def coarser(
    body: tuple[Array, Faces], counts: Iterable[int], limit_mm: float, *, closed: bool = False
) -> tuple[Array, Faces] | None:
    """A surface (m) with about the first of some numbers of faces with which it stays within a limit; None without.

    Args:
        closed: it has to enclose a body as the given one does.
    """
    source = body[0] * _MM, body[1]
    for count in counts:
        if count >= len(body[1]):
            return None
        for slivers in _SLIVERS_MM:
            vertices, faces = collapsed(source, Reduction(faces=count, slivers_mm=slivers))
            faces = np.asarray(faces, np.int32)
            if not 4 <= len(faces) < len(body[1]) or (closed and not is_closed(faces)):
                continue
            if deviation(source, (vertices, faces), limit_mm, _SAMPLES) <= limit_mm:
                return vertices / _MM, faces
    return None
