"""Stand-ins for meshes: small cubes under the locked names, for tests that only distinguish meshes."""

from __future__ import annotations

from pathlib import Path

from tests.meshes import box
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.stl import encode_stl
from yamsim_cli.core.scene.assets import load_lock


def stand_ins(
    folder: Path, locations: Locations, *names: str, edge: float = 0.02, reduced: bool = False
) -> dict[str, Path | None]:
    """Return asset set -> folder with cubes of `edge` m, below `folder`; `reduced` as `assets.reduction` leaves it."""
    cube = encode_stl(*box(edge, cuts=1))
    made: dict[str, Path | None] = {}
    for assets in load_lock(locations).select_sets(names):
        place = folder / assets.name
        place.mkdir(parents=True)
        for file in assets.files:
            (place / file).write_bytes(cube)
        if reduced:
            (place / "reduction.json").write_text("{}")
        made[assets.name] = place
    return made
