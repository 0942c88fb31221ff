"""Checks of what is seen: its size, whether it is closed, and which way its faces look."""

from __future__ import annotations

import numpy as np

from ..geometry.solid import filling, open_edges
from .outcome import Outcome, short, unchecked
from .portraits import portrait
from .subject import Subject

# What lies on a table and is no speck of dust, m.
_SIZES = (0.002, 1.5)
# Scans have a few faces too many where two patches meet: such a share of all edges.
_OPEN_SHARE = 1e-3

NO_LOOKS = "its meshes are not here: run `yamsim assets fetch`"


def size(looked: Subject) -> Outcome:
    """Whether it is as large as things are: a metre taken for a millimetre is not."""
    points = looked.surface[0] if looked.shown else looked.touching
    extent = np.ptp(points, axis=0)
    longest = float(extent.max())
    figures = {f"{axis}_m": short(value) for axis, value in zip("xyz", extent, strict=True)}
    fits = _SIZES[0] <= longest <= _SIZES[1]
    note = "" if fits else f"{longest:.4g} m long; valid are {_SIZES[0]:g} to {_SIZES[1]:g} m"
    return Outcome(fits, figures, note, (portrait(looked, "as it stands"),) if fits else ())


def closed(looked: Subject) -> Outcome:
    """Whether its surfaces enclose anything."""
    if not looked.shown:
        return unchecked(NO_LOOKS)
    edges = sum(3 * len(faces) // 2 for _, faces in looked.looks)
    open_ = sum(open_edges(faces) for _, faces in looked.looks)
    allowed = _OPEN_SHARE * edges
    note = "" if open_ <= allowed else f"{open_} of {edges} edges are open: there are holes in it"
    views = (portrait(looked, "from below", steep=-0.9),)
    return Outcome(open_ <= allowed, {"open_edges": open_, "edges": edges}, note, views)


def normals(looked: Subject) -> Outcome:
    """Whether its faces look outwards."""
    if not looked.shown:
        return unchecked(NO_LOOKS)
    volumes = [filling(*surface).volume for surface in looked.looks]
    inside_out = sum(volume <= 0 for volume in volumes)
    note = "" if not inside_out else f"{inside_out} of {len(volumes)} surfaces are inside out"
    figures = {"volume_cm3": short(sum(volumes) * 1e6), "inside_out": inside_out}
    return Outcome(not inside_out, figures, note, (portrait(looked, "from above", steep=2.0),))
