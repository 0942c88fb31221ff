"""A mug with a handle and a printed side, made here and written by another library: the input of import tests."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

HEIGHT, RADIUS, WALL = 0.095, 0.041, 0.004


def has_import_extra() -> bool:
    return all(find_spec(name) for name in ("trimesh", "PIL", "defusedxml", "collada", "coacd"))


def mug_mesh(segments: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3), m, and faces (m, 3): upright, its foot at 0, its handle towards +x; a closed surface."""
    import manifold3d as m

    outer = m.Manifold.cylinder(HEIGHT, RADIUS, RADIUS, segments)
    inner = m.Manifold.cylinder(HEIGHT, RADIUS - WALL, RADIUS - WALL, segments).translate((0, 0, 0.006))
    ring = m.CrossSection.circle(0.0055, max(8, segments // 3)).translate((0.024, 0))
    handle = m.Manifold.revolve(ring, segments).rotate((90, 0, 0)).translate((RADIUS + 0.006, 0, HEIGHT / 2))
    handle -= m.Manifold.cylinder(HEIGHT, RADIUS - WALL / 2, RADIUS - WALL / 2, segments)
    mesh = (outer - inner + handle).to_mesh()
    return np.array(mesh.vert_properties[:, :3], np.float64), np.array(mesh.tri_verts, np.int64)


def picture(size: int = 512) -> np.ndarray:
    """An image (size, size, 3) uint8 without similar places."""
    y, x = np.mgrid[0:size, 0:size] / size
    image = np.stack([0.35 + 0.6 * x, 0.3 + 0.5 * y, 0.6 - 0.4 * x], axis=-1)
    stripes = (np.floor(8 * x) % 2 == 0) & (y > 0.25) & (y < 0.7)
    image[stripes] = (0.95, 0.93, 0.85)
    return np.rint(image * 255).astype(np.uint8)


def mug(segments: int = 64, *, looks: str = "texture") -> Any:
    """A trimesh mug: `looks` of "texture" or "vertex" colours."""
    import trimesh
    from PIL import Image

    vertices, faces = mug_mesh(segments)
    angle = np.arctan2(vertices[:, 1], vertices[:, 0])
    uv = np.stack([angle / (2 * np.pi) + 0.5, vertices[:, 2] / HEIGHT], axis=1)
    # A seam at the back, in line with the handle's far side, whose triangles have their own corners.
    corner = uv[faces]
    wraps = np.ptp(corner[..., 0], axis=1) > 0.5
    corner[wraps, :, 0] += corner[wraps, :, 0] < 0.5
    keys = np.concatenate([faces.reshape(-1, 1), np.round(corner.reshape(-1, 2), 9)], axis=1)
    found, index = np.unique(keys, axis=0, return_inverse=True)
    points, coordinates = vertices[found[:, 0].astype(int)], found[:, 1:]
    index = index.reshape(-1, 3)
    if looks == "texture":
        material = trimesh.visual.material.PBRMaterial(
            name="print", baseColorTexture=Image.fromarray(picture()), baseColorFactor=[255, 255, 255, 255]
        )
        visual = trimesh.visual.TextureVisuals(uv=coordinates, material=material)
        return trimesh.Trimesh(points, index, visual=visual, process=False)
    image = picture()
    at = (np.stack([1 - coordinates[:, 1], coordinates[:, 0] % 1], 1) * (len(image) - 1)).astype(int)
    colours = np.concatenate([image[at[:, 0], at[:, 1]], np.full((len(at), 1), 255, np.uint8)], axis=1)
    return trimesh.Trimesh(points, index, vertex_colors=colours, process=False)


SDF = """<?xml version="1.0"?>
<sdf version="1.7"><model name="mug"><link name="mug">
<inertial><mass>{mass}</mass><pose>{x} 0 {z} 0 0 0</pose><inertia><ixx>{ixx}</ixx><iyy>{iyy}</iyy><izz>{izz}</izz>
<ixz>{ixz}</ixz></inertia></inertial>
<visual name="v"><geometry><mesh><uri>model://mug/meshes/mug.obj</uri></mesh></geometry></visual>
<collision name="c"><geometry><mesh><uri>meshes/mug.obj</uri></mesh></geometry></collision>
</link></model></sdf>
"""


def write_mugs(folder: Path, segments: int = 64, mass: float = 0.3) -> dict[str, Path]:
    """Write a mug by trimesh's exporters: kind -> file. GLB is y up, as its standard requires; the others z up."""
    import trimesh

    made = mug(segments)
    paths = {kind: folder / f"mug_{kind}.{kind}" for kind in ("glb", "stl", "ply", "dae")}
    y_up = made.copy()
    y_up.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    y_up.export(paths["glb"])
    trimesh.Trimesh(*mug_mesh(segments)).export(paths["stl"])
    mug(segments, looks="vertex").export(paths["ply"])
    _write_dae(made, paths["dae"])
    paths["obj"] = folder / "mug_obj" / "mug.obj"
    paths["obj"].parent.mkdir()
    _write_obj(made, paths["obj"])
    paths["sdf"] = folder / "mug" / "model.sdf"
    (paths["sdf"].parent / "meshes").mkdir(parents=True)
    _write_obj(made, paths["sdf"].parent / "meshes" / "mug.obj")
    solid = trimesh.Trimesh(*mug_mesh(segments))
    solid.density = mass / solid.volume
    tensor, centre = solid.moment_inertia, solid.center_mass
    paths["sdf"].write_text(
        SDF.format(
            mass=mass, x=centre[0], z=centre[2], ixx=tensor[0, 0], iyy=tensor[1, 1], izz=tensor[2, 2], ixz=tensor[0, 2]
        )
    )
    return paths


def _write_obj(mesh: Any, path: Path) -> None:
    import trimesh

    simple = mesh.copy()
    image = simple.visual.material.baseColorTexture
    simple.visual.material = trimesh.visual.material.SimpleMaterial(image=image, diffuse=[255, 255, 255, 255])
    simple.export(path)


def _write_dae(mesh: Any, path: Path) -> None:
    """trimesh writes no picture with COLLADA: it is added here."""
    import trimesh
    from PIL import Image

    simple = mesh.copy()
    simple.visual.material = trimesh.visual.material.SimpleMaterial(diffuse=[255, 255, 255, 255])
    text = simple.export(file_type="dae").decode()
    Image.fromarray(picture()).save(path.with_name("print.png"))
    images = '<library_images><image id="im" name="im"><init_from>print.png</init_from></image></library_images>'
    sampler = (
        '<newparam sid="sf"><surface type="2D"><init_from>im</init_from></surface></newparam>'
        '<newparam sid="sp"><sampler2D><source>sf</source></sampler2D></newparam>'
    )
    import re

    text = re.sub(r"<library_effects>", images + "<library_effects>", text, count=1)
    text = re.sub(r"<profile_COMMON>", "<profile_COMMON>" + sampler, text, count=1)
    text = re.sub(r"<diffuse>.*?</diffuse>", '<diffuse><texture texture="sp" texcoord="UVSET0"/></diffuse>', text,
                  count=1, flags=re.DOTALL)  # fmt: skip
    text = re.sub(r"<up_axis>.*?</up_axis>", "<up_axis>Z_UP</up_axis>", text)
    path.write_text(text)
