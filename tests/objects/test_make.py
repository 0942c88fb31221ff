"""Import of a read object: mass, hollows, looks, and configs of moving parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.drawers import MJCF, URDF, cabinet_sdf
from tests.mugs import HEIGHT, RADIUS, WALL, has_import_extra, mug_mesh, write_mugs
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.closed_surface import uniform_mass_properties
from yamsim_cli.core.geometry.height_map import crossings_along_z
from yamsim_cli.core.images.png import decode_png
from yamsim_cli.core.scene.assets import AssetStore, resolve_user_set
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.objects.building import ImportOptions, build_object
from yamsim_cli.objects.certify.single_object_pick import reachable_grasp_points
from yamsim_cli.objects.convex_decomposition import decompose_body
from yamsim_cli.objects.importing.file_import import import_file, import_with_defaults, object_name_of
from yamsim_cli.objects.part_surfaces import mass_properties_and_is_solid
from yamsim_cli.objects.primitives import PointBody
from yamsim_cli.objects.readers.object_parts import ObjectDescription, RigidPart, Surface, SurfaceMaterial
from yamsim_cli.objects.readers.object_reader import UnitOptions
from yamsim_cli.objects.readers.primitive_shapes import collision_shape, primitive_surface
from yamsim_cli.objects.readers.reader_process import read_file
from yamsim_cli.objects.visual_meshes import make_visual_meshes

needs_extra = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")


def thing(*surfaces: Surface, **part: Any) -> ObjectDescription:
    return ObjectDescription("t", (RigidPart("base", None, np.eye(4), looks=surfaces, **part),))


def mug_surface(segments: int = 32) -> Surface:
    vertices, faces = mug_mesh(segments)
    return Surface(vertices, faces.astype(np.int32))


def test_mass_follows_from_the_given_mass_or_density() -> None:
    read = thing(mug_surface())
    volume = uniform_mass_properties(*mug_mesh(32)).volume
    kept = Path("unused")

    def mass(**wishes: Any) -> tuple[float, bool]:
        made = build_object(read, ImportOptions("mug", collision="hull", **wishes), kept)
        return made.mass, made.mass_is_guessed

    assert mass() == (pytest.approx(1000 * volume), True)
    assert mass(density=2400) == (pytest.approx(2400 * volume), False)
    assert mass(mass=0.3) == (pytest.approx(0.3), False)


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_a_plane_is_refused_since_it_has_no_volume(tilt: float) -> None:
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, tilt * 0.1], [0, 0.1, tilt * 0.1]])
    plane = Surface(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    with pytest.raises(ResourceError, match=r"^sheet: all 4 vertices of its base lie in one plane"):
        build_object(thing(plane), ImportOptions("sheet", collision="hull"), Path("unused"))


def test_an_open_surface_has_the_mass_of_a_sheet() -> None:
    vertices, faces = mug_mesh(32)
    held, closed = mass_properties_and_is_solid(vertices, faces[5:].astype(np.int32))
    assert not closed
    assert held.volume == pytest.approx(2 * uniform_mass_properties(vertices, faces.astype(np.int32)).volume, rel=0.6)


def test_a_mug_stands_on_its_foot_and_holds_things() -> None:
    made = build_object(thing(mug_surface()), ImportOptions("mug", mass=0.3, collision="hull"), Path("unused"))
    item = ObjectConfig.model_validate(made.config_with_mesh_set("own-mug-000000000000"))
    assert item.rest_height == 0 and item.preposition == "in"
    assert item.support == pytest.approx(0.006, abs=2e-4)
    assert item.mesh.origin == pytest.approx((0, 0, 0), abs=1e-3)
    assert item.grasp is not None
    assert item.grasp.opening == pytest.approx(RADIUS, abs=1e-3)  # across it, beside its handle
    assert abs(item.grasp.axis_deg - 90) < 50


@pytest.mark.long
@needs_extra
@pytest.mark.slow
def test_the_first_proposed_place_of_a_faceted_mug_keeps_the_fingers_off_its_handle(
    tmp_path: Path, locations: Locations
) -> None:
    where = Locations(locations.data, tmp_path / "assets")
    file = write_mugs(tmp_path, 24)["glb"]
    made = import_file(file, UnitOptions(), ImportOptions("mug", mass=0.3), where, tmp_path / "mug.yaml")
    item = load_config(ObjectConfig, "objects", str(made.path), where)
    assert item == made.config and item.grasp is not None and item.grasp.friction is not None
    # Straight down across 19 degrees, the narrowest direction, a finger would hit the handle.
    angles = [point.axis_deg for point in item.grasp.friction.points]
    assert angles[-1] == 19 and item.grasp.axis_deg == angles[0]
    assert min(abs(item.grasp.axis_deg), abs(item.grasp.axis_deg - 180)) > 45
    meshed = replace(where, meshes={item.mesh.set: resolve_user_set(AssetStore(where.assets), item.mesh.set)})
    assert reachable_grasp_points(item, meshed) == item.grasp.friction.points


def test_a_block_becomes_a_box_primitive() -> None:
    block = primitive_surface("box", np.array([0.05, 0.02, 0.03]), SurfaceMaterial())
    made = build_object(thing(block), ImportOptions("brick"), Path("unused"))
    assert made.collision[0].kind == "primitives" and made.data["collision"][0]["type"] == "box"
    assert made.collision[0].fit is not None and made.collision[0].fit.p99 < 1e-3


def test_the_interior_of_a_mug_adds_no_mass() -> None:
    vertices, faces = mug_mesh(32)
    body = PointBody.from_mesh(vertices, faces.astype(np.int32))
    inner = np.hypot(body.points[:, 0], body.points[:, 1]) < RADIUS - WALL - 0.001
    assert body.points[inner, 2].max() < 0.008
    assert len(body.points) * body.step**3 == pytest.approx(uniform_mass_properties(*mug_mesh(32)).volume, rel=0.05)


def test_columns_go_through_a_surface_an_even_number_of_times() -> None:
    vertices, faces = mug_mesh(32)
    found = crossings_along_z(vertices, faces, np.array([[0.001, 0.002], [RADIUS - WALL / 2, 0.0011], [0.2, 0.2]]))
    assert found[0] == pytest.approx([0, 0.006], abs=1e-6)
    assert found[1] == pytest.approx([0, HEIGHT], abs=1e-6)
    assert len(found[2]) == 0


@pytest.mark.long
@pytest.mark.slow
@needs_extra
def test_a_convex_decomposition_is_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import manifold3d as m

    corner = m.Manifold.cube((0.1, 0.1, 0.02)) + m.Manifold.cube((0.02, 0.1, 0.1))
    mesh = corner.to_mesh()
    body = np.array(mesh.vert_properties[:, :3], np.float64), np.array(mesh.tri_verts, np.int32)
    shares: list[float] = []
    parts = decompose_body(body, tmp_path, share=shares.append)
    assert 2 <= len(parts) <= 4
    assert sum(uniform_mass_properties(*part).volume for part in parts) == pytest.approx(
        uniform_mass_properties(*body).volume, rel=0.15
    )
    assert shares == sorted(shares) and shares[-1] == 1.0
    monkeypatch.setattr("yamsim_cli.objects.convex_decomposition.run_child", None)
    again = decompose_body(body, tmp_path)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(parts, again, strict=True))


@pytest.mark.slow
@needs_extra
def test_a_convex_decomposition_has_a_time_limit(tmp_path: Path) -> None:
    vertices, faces = mug_mesh(64)
    with pytest.raises(ResourceError, match=r"convex parts is not done after 0\.5 s: reduce the mesh first"):
        decompose_body((vertices, faces.astype(np.int32)), tmp_path, limit_s=0.5)


@pytest.mark.slow
def test_many_faces_are_reduced_within_half_a_millimetre_and_keep_their_colours() -> None:
    """A ball of 80,000 faces, half red and half blue."""
    vertices, faces = subdivided(6)
    uv = np.where(vertices[faces].mean(axis=1)[:, None, :1] > 0, 0.75, 0.25) * np.ones((1, 3, 2))
    from yamsim_cli.core.images.png import encode_png

    image = np.zeros((4, 4, 3), np.uint8)
    image[:, :2], image[:, 2:] = (0, 0, 255), (255, 0, 0)
    looks = make_visual_meshes(
        "ball", (Surface(vertices, faces, SurfaceMaterial((1, 1, 1, 1), encode_png(image)), uv),)
    )
    text = looks.files["ball_0.obj"].decode()
    assert text.count("\nf ") < len(faces) / 3
    points = np.array([[float(x) for x in line.split()[1:]] for line in text.splitlines() if line.startswith("v ")])
    assert np.abs(np.linalg.norm(points, axis=1) - 0.04).max() < 5e-4
    baked = decode_png(looks.files["ball_0.png"])
    assert baked is not None
    reds, blues = (baked[..., 0] > 200).mean(), (baked[..., 2] > 200).mean()
    assert reds == pytest.approx(blues, rel=0.1) and reds + blues > 0.9


def subdivided(levels: int) -> tuple[np.ndarray, np.ndarray]:
    """A ball of radius 4 cm from an octahedron: 8 x 4^levels faces."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
    for _ in range(levels):
        corner = vertices[faces]
        middles = (corner + np.roll(corner, -1, axis=1)) / 2
        middles /= np.linalg.norm(middles, axis=-1, keepdims=True)
        points = np.concatenate([corner, middles], axis=1).reshape(-1, 3)
        at = 6 * np.arange(len(faces))[:, None]
        pattern = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
        faces = np.concatenate([at + np.array(tri) for tri in pattern]).astype(np.int32)
        vertices, index = np.unique(points.round(12), axis=0, return_inverse=True)
        faces = index.reshape(-1)[faces].astype(np.int32)
    return vertices * 0.04, faces


@needs_extra
@pytest.mark.parametrize(("name", "text"), [("c.sdf", cabinet_sdf()), ("f.urdf", URDF), ("d.xml", MJCF)])
def test_joints_of_a_file_move_in_a_scene(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    made = build_object(read_file(tmp_path / name, tmp_path), ImportOptions("thing"), tmp_path)
    set_name = "own-thing-000000000000"
    item = ObjectConfig.model_validate(made.config_with_mesh_set(set_name))
    folder = tmp_path / set_name
    folder.mkdir()
    for file, data in made.files.items():
        (folder / file).write_bytes(data)
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    add_object(spec, item, {set_name: folder})
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = item.rest_height
    joint = model.joint(f"thing_{item.links[0].name}")
    low, high = joint.range
    for way, end in ((1, high), (-1, low)):
        for _ in range(1500):
            data.qfrc_applied[joint.dofadr[0]] = way * (2.0 if item.links[0].joint.type == "slide" else 0.03)
            mujoco.mj_step(model, data)
        assert data.qpos[joint.qposadr[0]] == pytest.approx(end, abs=0.05 * (high - low)), way
    assert item.base == ("fixed" if name == "c.sdf" else "free")


@needs_extra
def test_a_file_stands_in_for_a_config(tmp_path: Path) -> None:
    where = Locations((tmp_path,), tmp_path / "assets")
    (tmp_path / "cabinet.sdf").write_text(cabinet_sdf())
    first = import_with_defaults(tmp_path / "cabinet.sdf", where)
    assert first.path.parent == tmp_path / "assets" / "imports"
    assert import_with_defaults(tmp_path / "cabinet.sdf", where).path == first.path
    assert [link.name for link in first.config.links] == ["drawer"]
    assert first.config.handles == () and [h.name for h in first.config.links[0].handles] == ["handle_fin"]


def test_objects_are_named_after_their_file() -> None:
    assert object_name_of(Path("my mug.glb")) == "my_mug"
    assert object_name_of(Path("lab/banana/model.sdf")) == "banana"
    assert object_name_of(Path("3d.obj")) == "thing_3d"


@pytest.mark.long
@needs_extra
@pytest.mark.slow
def test_a_ball_dropped_into_a_mug_of_any_format_stays_in(tmp_path: Path) -> None:
    from tools.bench.things import ball_stays_in, hangs, imported

    masses = []
    for path in write_mugs(tmp_path, segments=48).values():
        made, meshes = imported(path, tmp_path, density=2000.0)
        masses.append(made.built_object.mass)
        assert ball_stays_in(made.config, meshes)[0], path.name
        assert hangs(made.config, meshes) < 0.05, path.name
    assert max(masses) / min(masses) < 1.01


def test_plain_bodies_keep_their_kind_where_configs_can_say_them() -> None:
    T = np.eye(4)
    assert collision_shape("box", np.array([1, 2, 3.0]), T)["type"] == "box"  # type: ignore[index]
    T[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    turned = collision_shape("box", np.array([0.1, 0.2, 0.3]), T)
    assert isinstance(turned, dict) and turned["half_size"][2] == pytest.approx(0.2)
    lying = collision_shape("cylinder", np.array([0.1, 0.2]), T)
    assert isinstance(lying, Surface)
    assert np.abs(lying.vertices).max(axis=0) == pytest.approx([0.1, 0.2, 0.1], abs=1e-3)
