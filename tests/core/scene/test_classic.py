"""The MJCF for MuJoCo 3.3 and newer describes the same model."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations, MeshFolders
from yamsim_cli.core.scene.assets import AssetStore, load_lock
from yamsim_cli.core.scene.blueprint import Blueprint, task_blueprint
from yamsim_cli.viewers.show.compose import compose_at_home, first_attempt_start
from yamsim_cli.viewers.show.scene_files import mujoco_3_3_xml, scene_files

Composed = tuple[mujoco.MjSpec, mujoco.MjModel]

# Rig, task and grasp of all composed scenes.
SCENES = [
    *((rig, None, "weld") for rig in ("single", "single_linear", "bimanual", "russet")),
    *((rig, "pickplace", "weld") for rig in ("single", "single_linear", "bimanual", "russet")),
    *((rig, "handover", "weld") for rig in ("bimanual", "russet")),
    ("single_linear", "pickplace", "contact"),
]

# Allowed differences: looks, file names, and the name of an actuator's only control.
NOT_PHYSICS = {"geom_castshadow", "tex_colorspace", "actuator_ctrlspec", "npaths", "nbuffer", "paths", "signature"}


@pytest.fixture
def composed(make_config: Callable[..., RecordConfig], locations: Locations) -> Callable[..., Composed]:
    """Compose a scene with boards."""

    def compose(rig: str, task: str | None, grasp: str, meshes: MeshFolders) -> Composed:
        where = replace(locations, meshes=meshes)
        if task is None:
            studio = load_config(SceneConfig, "scenes", "studio", locations)
            return compose_at_home(Blueprint(load_config(RigConfig, "rigs", rig, locations), studio), where)
        config, home = first_attempt_start(
            Session(make_config({("rig",): rig, ("task",): task, ("grasp",): grasp}), where)
        )
        return compose_at_home(task_blueprint(config), where, home)

    return compose


@pytest.fixture(params=SCENES, ids=lambda scene: "-".join(map(str, scene)))
def scene(request: pytest.FixtureRequest, composed: Callable[..., Composed]) -> Composed:
    return composed(*request.param, {})


def _differences(one: mujoco.MjModel, other: mujoco.MjModel) -> dict[str, float]:
    """Array or number of a model -> difference of two models, where they differ."""
    found: dict[str, float] = {}
    for a, b in ((one, other), (one.opt, other.opt)):
        for name in dir(a):
            p, q = getattr(a, name), getattr(b, name)
            if name.startswith("_") or name in NOT_PHYSICS or not isinstance(p, np.ndarray | float | int):
                continue
            if np.shape(p) != np.shape(q):
                found[name] = np.inf
            elif name.endswith("pathadr"):
                continue
            elif not np.array_equal(p, q):
                found[name] = float(np.abs(np.subtract(p, q, dtype=float)).max())
    return found


def _read(files: dict[str, bytes]) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), files)


def test_the_written_scene_compiles_to_the_same_model(scene: Composed) -> None:
    differences = _differences(_read(scene_files(*scene)), scene[1])
    # Poses in frames are multiplied by yamsim and by MuJoCo with different rounding. Six digits would give 1e-6.
    assert max(differences.values(), default=0) < 1e-15, differences


@pytest.mark.parametrize("scene_of", [("single_linear", "pickplace", "contact"), ("russet", "handover", "weld")])
def test_it_does_with_meshes_too(
    scene_of: tuple[str, str, str], composed: Callable[..., Composed], locations: Locations
) -> None:
    lock, store = load_lock(locations), AssetStore(locations.assets)
    meshes = {assets.name: store.find_verified_folder(assets) for assets in lock.sets.values()}
    if None in meshes.values():
        pytest.skip("not all meshes are here: `yamsim assets fetch`")
    spec, model = composed(*scene_of, meshes)
    assert model.nmesh > 15
    differences = _differences(_read(scene_files(spec, model)), model)
    assert max(differences.values(), default=0) < 1e-15, differences


def test_what_3_3_does_not_read_is_refused_and_what_does_is_told(composed: Callable[..., Composed]) -> None:
    with pytest.raises(UsageError, match=r"armature=\S+ of <fixed> left_foot_slip_1, .* write it with --mujoco 4$"):
        mujoco_3_3_xml(*composed("single_finray", None, "weld", {}))


def test_what_has_another_default_in_another_version_is_said(scene: Composed) -> None:
    spec, model = scene
    root = ElementTree.fromstring(mujoco_3_3_xml(spec, model))
    assert root.find("option").get("ccd_iterations") == str(model.opt.ccd_iterations)
    assert root.find("option/flag").attrib == {"multiccd": "enable"}
    assert root.find("visual/headlight").get("active") == "1"
    for actuator in root.find("actuator"):
        assert len(actuator.get("ctrlrange").split()) == 2
    # 3.3 computes the centre of all bodies with geoms, even massless ones.
    for body in root.iter("body"):
        if model.body(body.get("name")).mass[0] == 0:
            assert body.find("inertial").get("mass") == "0"


def test_a_flag_that_is_off_stays_off(locations: Locations) -> None:
    studio = load_config(SceneConfig, "scenes", "studio", locations)
    spec, _ = compose_at_home(Blueprint(load_config(RigConfig, "rigs", "single", locations), studio), locations)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD | mujoco.mjtDisableBit.mjDSBL_ISLAND
    spec.visual.headlight.active = 0
    model = spec.compile()
    files = scene_files(spec, model)
    assert _differences(_read(files), model).keys() <= {"geom_pos", "bvh_aabb"}
    root = ElementTree.fromstring(files["scene.xml"])
    assert root.find("option/flag").attrib == {"island": "disable", "multiccd": "disable"}
    assert root.find("visual/headlight").get("active") == "0"


FRAMES = """
<mujoco>
  <compiler angle="radian"/>
  <default>
    <default class="small"><geom size="0.01" rgba="1 0 0 1"/><joint damping="3"/></default>
    <default class="large"><geom size="0.02"/></default>
  </default>
  <worldbody>
    <frame pos="1 2 3" quat="0.5 0.5 -0.5 0.5" childclass="small">
      <geom name="in_world" pos="0.1 0 0"/>
      <light name="light" pos="0 0 1" dir="0 1 0" type="directional"/>
      <light name="spot" type="spot"/>
      <camera name="camera" pos="0 1 0" quat="0.6 0.8 0 0"/>
      <body name="body" pos="0 0 0.5" quat="0.8 0 0.6 0">
        <frame pos="0.3 0.2 0.1" quat="0.6 0 0 0.8">
          <frame pos="0 0 1" quat="0 1 0 0" childclass="large">
            <joint name="hinge" pos="0.1 0 0" axis="1 0 0"/>
            <geom name="inner" type="capsule" fromto="0 0 0 0.1 0.2 0.3"/>
            <geom name="own" class="small"/>
            <site name="site" euler="0.1 0.2 0.3"/>
          </frame>
          <body name="plain"><geom name="inherited"/></body>
        </frame>
      </body>
      <body name="other" childclass="large"><geom name="of_other"/></body>
    </frame>
  </worldbody>
  <actuator><position name="drive" joint="hinge" kp="3" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def test_frames_become_part_of_what_is_in_them() -> None:
    spec = mujoco.MjSpec.from_string(FRAMES)
    model = spec.compile()
    text = mujoco_3_3_xml(spec, model)
    assert "<frame" not in text
    differences = _differences(mujoco.MjModel.from_xml_string(text), model)
    # Of numbers up to 75; the capsule and its quarter turns are rounded more often.
    assert max(differences.values(), default=0) < 1e-12, differences


def test_writing_leaves_the_spec_as_it_was() -> None:
    spec = mujoco.MjSpec.from_string(FRAMES)
    model = spec.compile()
    before = spec.to_xml()
    mujoco_3_3_xml(spec, model)
    assert spec.to_xml() == before
    assert scene_files(spec, model, "4") == {"scene.xml": before.encode()}


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("<compiler", '<option integrator="discrete"/><compiler', 'integrator="discrete" of <option>'),
        ("<compiler", '<option><flag speculative="enable"/></option><compiler', 'speculative="enable" of <flag>'),
        ('<geom name="own"', '<geom name="own" adhesion="3"', 'adhesion="3" of <geom> own'),
        ('<geom name="own"', '<geom name="own" margin="0.2" gap="0.1"', 'gap="0.1" of <geom> own'),
        ('type="directional"', 'type="point"', 'type="point" of <light> light'),
        ('<position name="drive"', '<position name="drive" delay="0.1" nsample="3"', "of <general> drive"),
        ("<actuator>", '<sensor><clock name="clock"/></sensor><actuator>', "<sensor>"),
    ],
)
def test_features_that_mujoco_3_3_lacks_are_refused(old: str, new: str, what: str) -> None:
    spec = mujoco.MjSpec.from_string(FRAMES.replace(old, new))
    spec.modelname = "mine"
    model = spec.compile()
    with pytest.raises(UsageError) as refusal:
        scene_files(spec, model)
    assert what in str(refusal.value)
    assert "scene 'mine' has" in str(refusal.value)
    assert "--mujoco 4" in str(refusal.value)
    assert "scene.xml" in scene_files(spec, model, "4")
