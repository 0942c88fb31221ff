"""Cost of a physics step with each kind of collision: a mug with a ball in it, on a slab.

    python -m tools.bench.touching

Needs the extra `import` for convex parts. Leave the machine alone meanwhile.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import mujoco
from rich.console import Console
from rich.table import Table

from tests.mugs import mug_mesh
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.errors import YamsimError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.stl import encode_stl
from yamsim_cli.objects.building import ImportOptions
from yamsim_cli.objects.certify.physics_checks import find_deepest_hollow
from yamsim_cli.objects.certify.tested_object import (
    TestedObject,
    compile_or_raise,
    object_on_ground_spec,
    read_tested_object,
)
from yamsim_cli.objects.importing.file_import import import_file
from yamsim_cli.objects.readers.object_reader import UnitOptions

_SECONDS = 1.0
_SHIPPED = ("025_mug", "024_bowl", "kitchen_cup", "kitchen_bowl", "kitchen_plate", "kitchen_pot", "kitchen_dish_rack")


def main() -> None:
    """Measure and print."""
    where = Locations.from_environment({})
    table = Table(title="One physics step of 2 ms, the thing at rest with a ball in it", title_justify="left")
    for column in ("thing", "collides by", "geoms", "contacts", "ms a step", "ball stays in"):
        table.add_column(column, justify="left" if column in ("thing", "collides by") else "right")
    with tempfile.TemporaryDirectory() as folder:
        own = Locations(where.data, Path(folder))
        for name in _SHIPPED:
            item = load_config(ObjectConfig, "objects", name, where)
            table.add_row(name, "primitives", *_measured(read_tested_object(item, {}, where)))
        file = Path(folder) / "mug.stl"
        file.write_bytes(encode_stl(*mug_mesh()))
        for kind in ("hull", "sdf", "primitives", "decompose"):
            try:
                options = ImportOptions(f"mug_{kind}", 0.3, None, kind, None, None)  # type: ignore[arg-type]
                config = import_file(file, UnitOptions("m", "z"), options, own, Path(folder) / f"{kind}.yaml").config
                meshes = {config.mesh.set: own.assets / config.mesh.set}
                table.add_row("a mug of 5,748 faces", kind, *_measured(read_tested_object(config, meshes, own)))
            except YamsimError as error:
                table.add_row("a mug of 5,748 faces", kind, "", "", "", str(error)[:60])
    Console(width=110).print(table)


def _measured(looked: TestedObject) -> tuple[str, str, str, str]:
    spec = object_on_ground_spec(looked)
    found = find_deepest_hollow(looked) if looked.visual_surfaces else None
    place = found.place if found else (0.0, 0.0)
    top = float(looked.collision_points[:, 2].max())
    body = spec.worldbody.add_body(name="ball", pos=[*place, top + 0.02])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], density=1000, solref=[0.004, 1], priority=1)
    model = compile_or_raise(spec)
    data = mujoco.MjData(model)
    data.qpos[model.joint(looked.item.name).qposadr[0] + 2] = looked.item.rest_height
    steps = round(_SECONDS / model.opt.timestep)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    start = time.perf_counter()
    for _ in range(steps):
        mujoco.mj_step(model, data)
    each = (time.perf_counter() - start) / steps
    inside = float(data.body("ball").xpos[2]) < 0.6 * top
    return str(model.ngeom - 2), str(data.ncon), f"{each * 1000:.3f}", "yes" if inside else "no"


if __name__ == "__main__":
    main()
