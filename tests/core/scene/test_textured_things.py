"""An object's texture, from its file to the scene, the web page and composed scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.mugs import HEIGHT, RADIUS, has_import_extra, mug, picture
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, resolve_user_set
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.objects.building import ImportOptions
from yamsim_cli.objects.importing.file_import import ImportedObjectFile, import_file
from yamsim_cli.objects.readers.object_reader import UnitOptions, read_object
from yamsim_cli.viewers.show.scene_files import mujoco_3_3_xml, scene_files

pytestmark = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")

# Places on the side (share of the circumference from -x, share of the height).
PLACES = [(0.25, 0.15), (0.75, 0.9), (0.6, 0.5), (0.1, 0.8)]


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory, locations: Locations) -> tuple[ImportedObjectFile, Locations]:
    folder = tmp_path_factory.mktemp("printed")
    made = mug(24)
    made.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # y up
    made.export(folder / "mug.glb")
    where = Locations((folder, *locations.data), folder / "assets")
    wishes = ImportOptions("mug", mass=0.3, collision="hull")
    return import_file(folder / "mug.glb", UnitOptions(), wishes, where, folder / "mug.yaml"), where


def spec_of(printed: tuple[ImportedObjectFile, Locations]) -> mujoco.MjSpec:
    imported, where = printed
    name = imported.config.mesh.set
    spec = mujoco.MjSpec()
    add_object(spec, imported.config, {name: resolve_user_set(AssetStore(where.assets), name)})
    return spec


def shown_colours(uv: np.ndarray, corners: np.ndarray, image: np.ndarray) -> list[np.ndarray]:
    """Colours at `PLACES`, of triangles (m, 3, 3) with texture coordinates (m, 3, 2) from the lower edge."""
    found = []
    for u, v in PLACES:
        angle = (u - 0.5) * 2 * np.pi
        normal = np.array([np.cos(angle), np.sin(angle), 0])
        start = np.array([*(2 * RADIUS * normal[:2]), v * HEIGHT])
        found.append(_hit(start, -normal, uv, corners, image))
    return found


def _hit(start: np.ndarray, way: np.ndarray, uv: np.ndarray, corners: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the colour of the first triangle on a ray."""
    a, edges = corners[:, 0], np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    matrix = np.concatenate([edges, np.broadcast_to(-way[None, :, None], (len(a), 3, 1))], axis=2)
    regular = np.abs(np.linalg.det(matrix)) > 1e-15
    share = np.full((len(a), 3), np.inf)
    share[regular] = np.linalg.solve(matrix[regular], (start - a[regular])[..., None])[..., 0]
    inside = (share[:, 0] >= 0) & (share[:, 1] >= 0) & (share[:, 0] + share[:, 1] <= 1) & (share[:, 2] > 0)
    first = int(np.argmin(np.where(inside, share[:, 2], np.inf)))
    s, t = share[first, :2]
    u, v = uv[first, 0] + s * (uv[first, 1] - uv[first, 0]) + t * (uv[first, 2] - uv[first, 0])
    row, column = int((1 - v % 1) * (image.shape[0] - 1)), int((u % 1) * (image.shape[1] - 1))
    colour: np.ndarray = image[row, column].astype(float)
    return colour


def expected() -> list[Any]:
    image = picture()
    return [pytest.approx(image[int((1 - v) * 511), int(u * 511)].astype(float), abs=12) for u, v in PLACES]


@pytest.mark.slow
def test_the_web_page_shows_the_picture(printed: tuple[ImportedObjectFile, Locations]) -> None:
    pytest.importorskip("viser")
    from yamsim_cli.viewers.scene_nodes import textured_mesh

    model = spec_of(printed).compile()
    geom = model.geom("mug_look").id
    mesh = textured_mesh(model, geom)
    assert mesh is not None
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    corners = (mesh.vertices @ R.reshape(3, 3).T + model.geom_pos[geom])[mesh.faces] + origin(printed)
    image = np.asarray(mesh.visual.material.baseColorTexture)
    assert shown_colours(mesh.visual.uv[mesh.faces], corners, image) == expected()
    assert textured_mesh(model, model.geom("mug_collide_0").id) is None


def origin(printed: tuple[ImportedObjectFile, Locations]) -> np.ndarray:
    return np.array(printed[0].config.mesh.origin)


@pytest.mark.slow
@pytest.mark.parametrize("reader", ["3.3", "4"])
def test_a_composed_scene_is_read_back_with_its_picture(
    printed: tuple[ImportedObjectFile, Locations], tmp_path: Path, reader: Any
) -> None:
    spec = spec_of(printed)
    spec.modelname = "mug_scene"
    files = scene_files(spec, spec.compile(), reader)
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    (part,) = read_object(tmp_path / "scene.xml", UnitOptions()).parts
    (look,) = part.looks
    from yamsim_cli.core.images.png import decode_png

    image = decode_png(look.material.texture or b"")
    assert look.uv is not None and image is not None
    assert shown_colours(look.uv, look.vertices[look.faces] + origin(printed), image) == expected()
    assert part.weight is not None and part.weight.mass == pytest.approx(0.3)
    assert part.shapes is not None and len(part.shapes) == 1


@pytest.mark.render
def test_it_is_drawn_as_it_istextured_mesh(printed: tuple[ImportedObjectFile, Locations]) -> None:
    spec = spec_of(printed)
    spec.worldbody.add_camera(name="c", pos=[0, -0.4, HEIGHT / 2], xyaxes=[1, 0, 0, 0, 0, 1], fovy=20)
    spec.worldbody.add_light(pos=[0, -1, 0.05], dir=[0, 1, 0], ambient=[0.4] * 3, diffuse=[0.6] * 3)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 200, 200) as renderer:
        renderer.update_scene(data, "c")
        image = renderer.render().astype(float)
    # As seen from -y, redder from left to right, greener from top to bottom.
    columns = image[100, 60:140]
    stripes = np.abs(np.diff(columns.sum(axis=1))) > 25
    assert stripes.sum() >= 2
    assert image[138, 100, 1] > image[62, 100, 1] + 20


def test_what_collides_by_files_needs_them(printed: tuple[ImportedObjectFile, Locations]) -> None:
    with pytest.raises(ResourceError, match=r"the mesh set own-mug-.*, the collision geometry of mug"):
        add_object(mujoco.MjSpec(), printed[0].config, {})


def test_a_body_by_its_distance_is_for_newer_mujocos(
    printed: tuple[ImportedObjectFile, Locations], tmp_path: Path
) -> None:
    imported, where = printed
    config = imported.config
    sdf = config.collision[0].model_dump() | {"type": "sdf"}
    changed = type(config).model_validate(config.model_dump() | {"collision": [sdf]})
    spec = mujoco.MjSpec()
    add_object(spec, changed, {config.mesh.set: resolve_user_set(AssetStore(where.assets), config.mesh.set)})
    model = spec.compile()
    assert model.geom_type[model.geom("mug_collide_0").id] == mujoco.mjtGeom.mjGEOM_SDF
    with pytest.raises(UsageError, match="write it with --mujoco 4"):
        mujoco_3_3_xml(spec, model)
