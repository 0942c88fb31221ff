from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.arm_model import arm_spec, kinematic_model
from yamsim_cli.core.scene.assets import AssetStore, load_lock, make_reduced

JOINTS = tuple(f"joint{k}" for k in range(1, 7))
REFERENCE = Path(__file__).parents[2] / "data" / "kinematics_reference.json"


@pytest.fixture(scope="module")
def arm(config: RecordConfig) -> mujoco.MjModel:
    return arm_spec(config.rig.arms[0], None).compile()


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    return json.loads(REFERENCE.read_text())


def _mass_matrix(model: mujoco.MjModel, q: list[float]) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full - np.diag(model.dof_armature)


def test_forward_kinematics_agree_with_an_independent_model(arm: mujoco.MjModel, reference: dict[str, Any]) -> None:
    assert [arm.joint(k).name for k in range(arm.njnt)] == reference["joints"]
    data = mujoco.MjData(arm)
    for sample in reference["samples"]:
        data.qpos[:] = sample["q"]
        mujoco.mj_kinematics(arm, data)
        for name, expected in sample["bodies"].items():
            body = data.body(name)
            np.testing.assert_allclose([*body.xpos, *body.xmat], expected, atol=1e-9, err_msg=name)
        tcp = data.site("tcp_site")
        np.testing.assert_allclose([*tcp.xpos, *tcp.xmat], sample["tcp_site"], atol=1e-9)


def test_mass_matrix_agrees_but_for_the_mass_of_the_finger_geoms(
    arm: mujoco.MjModel, reference: dict[str, Any]
) -> None:
    assert reference["geom_mass_per_finger"] == pytest.approx(0.0606, abs=1e-4)
    for sample in reference["samples"]:
        ours = _mass_matrix(arm, sample["q"])
        np.testing.assert_allclose(ours, sample["mass_matrix_without_geom_mass"], atol=1e-9)
        extra = np.array(sample["mass_matrix"]) - ours
        # Along its slide a finger is heavier by exactly that mass; nowhere lighter.
        np.testing.assert_allclose(np.diag(extra)[6:], reference["geom_mass_per_finger"], atol=1e-6)
        assert np.linalg.eigvalsh(extra).min() > -1e-9


@pytest.mark.network
def test_committed_reference_is_what_the_other_model_gives(tmp_path: Path, reference: dict[str, Any]) -> None:
    subprocess.run(
        [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(tmp_path), "mjlab==1.6.0"], check=True
    )
    script = Path(__file__).with_name("make_kinematics_reference.py")
    made = subprocess.run(
        [sys.executable, str(script), str(next(tmp_path.glob("*.whl")))], check=True, capture_output=True, text=True
    )
    assert json.loads(made.stdout) == reference


def test_drives(arm: mujoco.MjModel) -> None:
    # Source: MuJoCo Menagerie i2rt_yam.
    kp = [40, 40, 40, 20, 10, 10, 100]
    kv = [2.5, 2.5, 2.5, 0.5, 1, 1, 10]
    drives = [arm.actuator(k) for k in range(arm.nu)]
    assert [drive.name for drive in drives] == [*JOINTS, "gripper"]
    assert [drive.gainprm[0] for drive in drives] == kp
    assert [-drive.biasprm[2] for drive in drives] == kv
    assert [list(drive.forcerange) for drive in drives[:6]] == [[-28, 28]] * 3 + [[-10, 10]] * 3
    assert list(drives[6].ctrlrange) == [0, 0.041]
    assert [arm.joint(name).armature[0] for name in JOINTS] == [0.032] * 3 + [0.0018] * 3
    assert (arm.dof_frictionloss == 0.1).all()


def test_gravity_is_compensated_from_link_2_on(arm: mujoco.MjModel) -> None:
    names = [f"link_{k}" for k in range(2, 7)] + ["link_left_finger", "link_right_finger"]
    assert [arm.body_gravcomp[arm.body(name).id] for name in names] == [1] * 7
    assert arm.body_gravcomp[arm.body("link_1").id] == 0


def test_grasp_site_can_be_moved_by_the_rig(config: RecordConfig) -> None:
    arm = config.rig.arms[0]
    assert kinematic_model(arm).site("grasp_site").pos[2] == 0.1347
    moved = arm.model_copy(update={"grasp_offset": 0.14465})
    assert kinematic_model(moved).site("grasp_site").pos[2] == 0.14465


def test_pinch_site_lies_between_the_finger_tips(arm: mujoco.MjModel) -> None:
    data = mujoco.MjData(arm)
    for opening in (0.0, 0.02, 0.0375):
        data.qpos[6:] = opening, -opening
        mujoco.mj_kinematics(arm, data)
        site = data.site("pinch_site")
        tips = [data.geom(f"{side}_finger_tip_b1").xpos for side in ("left", "right")]
        offset = site.xmat.reshape(3, 3).T @ (np.mean(tips, axis=0) - site.xpos)
        np.testing.assert_allclose(offset, 0, atol=0.005)
        # The fingers close along the site's y axis.
        apart = site.xmat.reshape(3, 3).T @ (tips[0] - tips[1])
        assert abs(apart[0]) < 0.007
        assert apart[1] == pytest.approx(2 * opening, abs=2e-3)


def test_tool_site_can_be_moved_after_compiling(config: RecordConfig) -> None:
    bare = kinematic_model(config.rig.arms[0])
    bare.site("tool").pos[:] = (0, 0, 0.1)
    data = mujoco.MjData(bare)
    mujoco.mj_kinematics(bare, data)
    link = data.body("link_6")
    np.testing.assert_allclose(data.site("tool").xpos, link.xpos + link.xmat.reshape(3, 3) @ (0, 0, 0.1))


def test_physics_does_not_depend_on_the_meshes(config: RecordConfig, locations: Locations) -> None:
    """Primitives, full meshes and reduced ones: the same bits after a second."""
    lock, store = load_lock(locations), AssetStore(locations.assets)
    assets = lock.sets["i2rt_yam_crank"]
    meshes = store.find_verified_folder(assets)
    if meshes is None:
        pytest.skip("the meshes are not here: yamsim assets fetch")
    reduced = make_reduced(store, assets, meshes, lock.notices[assets.notice])
    faces, trajectories = [], []
    for folder in (None, meshes, reduced.directory):
        model = arm_spec(config.rig.arms[0], {assets.name: folder}).compile()
        data = mujoco.MjData(model)
        data.ctrl[:] = (0.5, 1.2, 1.0, -0.3, 0.2, 0.4, 0.02)
        mujoco.mj_step(model, data, 500)
        faces.append(model.nmeshface)
        trajectories.append(np.concatenate([data.qpos, data.qvel]))
    assert faces[0] == 0
    assert faces[2] < faces[1] / 5
    assert np.abs(trajectories[0]).max() > 0.1
    for other in trajectories[1:]:
        assert (other == trajectories[0]).all()
