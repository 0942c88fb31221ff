"""Golden pictures, and negative twins: pictures with a known mistake, which must fail."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from tests.golden.shots import RIGS, VIEWS, GoldenPicture, centre_faults, faults, save_failure, take
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.viewers.show.rig_views import set_up_views

pytestmark = pytest.mark.render

Shots = Callable[..., dict[str, GoldenPicture]]


def _rig(name: str, locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", name, locations)


@pytest.fixture(scope="module")
def shots(locations: Locations) -> Shots:
    """Pictures of a rig, by its name and a mistake; each is rendered once."""

    @functools.cache
    def shots(name: str, mistake: Callable[[Any], Any] | None = None) -> dict[str, GoldenPicture]:
        rig = _rig(name, locations)
        if mistake is _boards_upright:
            return take(rig, locations, mistake)
        return take(mistake(rig) if mistake else rig, locations)

    return shots


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", RIGS)
def test_picture_is_the_golden_one(name: str, view: str, shots: Shots) -> None:
    shot = shots(name)[view]
    if found := faults(shot, name, view):
        pytest.fail(f"{'; '.join(found)}; see {save_failure(shot, name, view)}")


def _boards_upright(model: mujoco.MjModel) -> None:
    """A known mistake: without the pose inside the mocap body, the board stands on its edge."""
    for name in ("base_board", "arm2_base_board"):
        if (geom := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)) >= 0:
            model.geom_quat[geom] = np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)
            model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE


def _margin_2_cm_off(rig: RigConfig) -> RigConfig:
    return rig.model_copy(update={"margin": rig.margin + 0.02})


def _prefixes_swapped(rig: RigConfig) -> RigConfig:
    one, two = rig.arms
    swapped = (one.model_copy(update={"prefix": two.prefix}), two.model_copy(update={"prefix": one.prefix}))
    return rig.model_copy(update={"arms": swapped})


def _board_not_mirrored(rig: RigConfig) -> RigConfig:
    one, two = rig.arms
    assert one.board is not None
    assert two.board is not None
    board = two.board.model_copy(update={"position_mm": one.board.position_mm})
    mount = one.mount
    return rig.model_copy(update={"arms": (one, two.model_copy(update={"board": board, "mount": mount}))})


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", RIGS)
def test_an_upright_board_fails(name: str, view: str, shots: Shots) -> None:
    assert faults(shots(name, _boards_upright)[view], name, view)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("bimanual", _margin_2_cm_off),
        ("russet", _margin_2_cm_off),
        ("bimanual", _prefixes_swapped),
        ("russet", _prefixes_swapped),
        ("russet", _board_not_mirrored),
    ],
)
def test_a_wrong_rig_fails(name: str, mistake: Callable[[RigConfig], RigConfig], view: str, shots: Shots) -> None:
    assert faults(shots(name, mistake)[view], name, view)


def test_a_margin_2_cm_off_is_seen_in_the_centres_alone(shots: Shots) -> None:
    """The first test needs no golden picture, only the figures."""
    shot = shots("russet", _margin_2_cm_off)["near_top"]
    assert any("base_board is seen" in fault for fault in centre_faults(shot, "russet", "near_top"))


@pytest.mark.parametrize("name", RIGS)
def test_every_marker_is_found_from_above(name: str, locations: Locations) -> None:
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig

    rig, size = _rig(name, locations), (1280, 960)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    # Where a shadow ends on a marker, the plain detector misplaces its corners.
    quality = quality.model_copy(update={"shadow_map_px": 0})
    stage = set_up_views(Blueprint(rig, scene), locations, quality, size)
    with stage.open_renderer() as renderer:
        grey = cv2.cvtColor(renderer.render(stage.data, "near_top"), cv2.COLOR_RGB2GRAY)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
    expected = list(range(217, 226 if name == "single" else 235))
    assert sorted(ids.ravel().tolist()) == expected

    # Each marker's corners agree with the rig: a rotated or mirrored board would show here.
    camera = stage.cameras["near_top"]
    for arm in range(len(rig.arms)):
        board = rig.arms[arm].board
        assert board is not None
        T = rig.T_base_in_world(arm) @ rig.arms[arm].T_board_in_base
        for number, marker in zip(
            board.board_in_metres.marker_ids, board.board_in_metres.marker_corners(), strict=True
        ):
            seen = corners[ids.ravel().tolist().index(number)][0]
            wanted = np.array([camera.project_point((T @ [*corner, 1])[:3]) for corner in marker])
            np.testing.assert_allclose(seen, wanted, atol=1.5)
