"""Light and colours: the table carries all shadows, no arm is overexposed, and objects differ in colour."""

from __future__ import annotations

import os

import cv2
import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.scene.blueprint import recording_blueprint
from yamsim_cli.core.scene.compilation import compile_spec
from yamsim_cli.core.scene.compose import compose_scene
from yamsim_cli.session_opener import SessionOpener

SIZE = (160, 120)
QUALITIES = ("fast", "balanced", "high")
RIGS = ("single", "russet", "yam_station_linear_4310_d405")
# A further camera below the tabletop, towards the place where the light would land.
BELOW = "below"
FLOOR = ("safety_plane", "floor_tiles")
# m, half edges of the box above the table, its height, and a place out of sight
HALF = (0.06, 0.06, 0.02)
HEIGHT = 0.15
AWAY = np.array([0.0, 0.0, -5.0])
# Of 255, smallest change: above rounding of colours, far below a shadow (about 30).
CHANGED = 4


def scene(rig: str, quality: str) -> tuple[mujoco.MjModel, RecordConfig, Array]:
    """The scene of a recording with a movable box, and the box's place above the table."""
    opener = SessionOpener({**os.environ, "YAMSIM_ASSETS": os.devnull}, lambda line: None, str)
    where = opener.find_locations()
    config = opener.load_record_config(
        "default", where, rig=rig, quality=quality, size=f"{SIZE[0]}x{SIZE[1]}", wrist=True
    )
    spec = compose_scene(recording_blueprint(config), where)
    table, light = config.widened_scene.table, np.array(config.widened_scene.lights[0].direction)
    assert table is not None
    place = np.array([*table.position[:2], table.top_height + HEIGHT])
    spec.worldbody.add_body(name="box", mocap=True, pos=place).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=HALF)
    landing = place + light * (place[2] - config.widened_scene.safety_plane) / -light[2]
    eye = np.array([landing[0], landing[1], table.top_height - 2 * table.half_size[2] - 0.02])
    spec.worldbody.add_camera(name=BELOW, pos=eye, fovy=70)
    return compile_spec(spec), config, place


def pictures(model: mujoco.MjModel, config: RecordConfig, at: Array) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return camera -> colours (h, w, 3) and geoms (h, w) with the box at a place."""
    data = mujoco.MjData(model)
    data.mocap_pos[model.body("box").mocapid[0]] = at
    mujoco.mj_forward(model, data)
    names = [model.camera(k).name for k in range(model.ncam)]
    with SceneRenderer(model, SIZE, config.render.fine_size(SIZE)) as renderer:
        return {
            name: (renderer.render(data, name).astype(int), renderer.render_geom_ids(data, name).copy())
            for name in names
        }


def inside(geoms: np.ndarray, wanted: list[int]) -> np.ndarray:
    """Pixels (h, w) of some geoms except edges, where supersampling mixes colours."""
    return cv2.erode(np.isin(geoms, wanted).astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0) > 0


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("rig", [RIGS[0], *(pytest.param(rig, marks=pytest.mark.slow) for rig in RIGS[1:])])
def test_the_table_carries_the_shadow_and_the_floor_below_has_none(rig: str, quality: str) -> None:
    model, config, place = scene(rig, quality)
    there, gone = pictures(model, config, place), pictures(model, config, AWAY)
    ghosts, carried, floor_seen = {}, {}, {}
    for name, (colours, geoms) in there.items():
        change = np.abs(colours - gone[name][0]).max(axis=-1)
        darker = (gone[name][0] - colours).min(axis=-1)
        same = geoms == gone[name][1]
        floor = inside(np.where(same, geoms, -1), [model.geom(part).id for part in FLOOR])
        ghosts[name], floor_seen[name] = int((floor & (change > CHANGED)).sum()), int(floor.sum())
        table = inside(np.where(same, geoms, -1), [model.geom("table").id])
        carried[name] = int((table & (darker > CHANGED)).sum())
    assert floor_seen[BELOW] > 1000
    assert not any(ghosts.values()), ghosts
    assert max(carried.values()) > 20, carried


@pytest.mark.slow
@pytest.mark.parametrize("quality", QUALITIES)
def test_nothing_but_the_box_darkens_the_tabletop(quality: str) -> None:
    """The table does not speckle itself: without its own shadow its lit top has the same pixels."""
    model, config, _ = scene("single", quality)
    ours = pictures(model, config, AWAY)["scene_camera"]
    for k in range(model.ngeom):
        if model.geom(k).name.endswith("_core"):
            model.geom_size[k] = 1e-4
    bare = pictures(model, config, AWAY)["scene_camera"]
    top = inside(ours[1], [model.geom("table").id])
    assert top.sum() > 500
    assert np.abs(ours[0] - bare[0]).max(axis=-1)[top].max() <= CHANGED


# Of 255, from which a channel counts as overexposed.
OVEREXPOSED = 250


def of_arms(model: mujoco.MjModel) -> list[int]:
    """Geoms of links: of bodies that a joint moves, without the box and free objects."""
    roots = {model.body_rootid[model.jnt_bodyid[k]] for k in range(model.njnt) if model.jnt_type[k] != 0}
    return [k for k in range(model.ngeom) if model.body_rootid[model.geom_bodyid[k]] in roots]


@pytest.mark.parametrize("rig", ["single", "yam_station_linear_4310_d405"])
def test_no_arm_is_overexposed(rig: str) -> None:
    model, config, _ = scene(rig, "fast")
    seen = 0
    for name, (colours, geoms) in pictures(model, config, AWAY).items():
        arm = colours[np.isin(geoms, of_arms(model))]
        seen += len(arm)
        assert (arm >= OVEREXPOSED).any(axis=-1).mean() < 0.01 if len(arm) else True, name
    assert seen > 1000


def test_apple_and_bowl_differ_in_colour(locations: Locations) -> None:
    apple, bowl = (load_config(ObjectConfig, "objects", name, locations).mesh for name in ("013_apple", "024_bowl"))
    assert np.abs(np.subtract(apple.rgba, bowl.rgba)).max() > 0.3
