"""The arm with the gripper linear_4310: its pads, mass, contact pairs, and looks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import ArmConfig, RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.arm_model import arm_spec, finger_addresses, kinematic_model

SIDES = ("left", "right")
FINGERS = tuple(f"link_{side}_finger" for side in SIDES)


@pytest.fixture(scope="module")
def arm(locations: Locations) -> ArmConfig:
    return load_config(RigConfig, "rigs", "single_linear", locations).arms[0]


@pytest.fixture(scope="module")
def model(arm: ArmConfig) -> mujoco.MjModel:
    return arm_spec(arm, None).compile()


def _at(model: mujoco.MjModel, opening: float, joints: tuple[float, ...] = (0.0,) * 6) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:6] = joints
    data.qpos[6:] = opening
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("opening", [-0.005, 0.0, 0.018, 0.0475])
def test_pads_face_each_other_around_the_pinch_site(model: mujoco.MjModel, opening: float) -> None:
    data = _at(model, opening, (0.3, 1.2, 1.0, -0.4, 0.2, 0.5))
    site = data.site("pinch_site")
    R = site.xmat.reshape(3, 3)
    for side, sign in (("left", 1), ("right", -1)):
        pad = data.geom(f"{side}_finger_collide_pad")
        # The pad's face is half its thickness nearer. Source: linear_4310's pad box, 3.4 mm thick.
        face = R.T @ (pad.xpos - site.xpos) - (0, sign * 0.0017, 0)
        np.testing.assert_allclose(face, (0, sign * opening, 0), atol=1e-6)
        # Its flat side faces the closing axis.
        assert abs((R.T @ pad.xmat.reshape(3, 3))[1, 1]) == pytest.approx(1, abs=1e-6)


def test_tips_end_144_mm_beyond_link_6(model: mujoco.MjModel) -> None:
    """I2RT's SDK has 0.14465 m."""
    data = _at(model, 0.0)
    link = data.body("link_6")
    for side in SIDES:
        pad = data.geom(f"{side}_finger_collide_pad")
        tip = (link.xmat.reshape(3, 3).T @ (pad.xpos - link.xpos))[2] + model.geom(pad.id).size[2]
        assert tip == pytest.approx(0.1444, abs=1e-4)


def test_masses_and_inertias(model: mujoco.MjModel) -> None:
    # Source: MuJoCo Menagerie yam_linear_4310.
    for name, mass in (("link_6", 0.553219), ("link_left_finger", 0.0710042), ("wrist_camera", 0.1087)):
        assert model.body(name).mass[0] == mass
    left, right = (model.body(f"link_{side}_finger") for side in SIDES)
    assert left.mass[0] == right.mass[0]
    np.testing.assert_array_equal(left.inertia, right.inertia)
    assert model.body("arm").subtreemass[0] == pytest.approx(
        sum((0.12415, 1.24434, 0.853698, 0.463511, 0.350962, 0.553219, 0.1087, 2 * 0.0710042))
    )
    # The arm does not compensate the wrist camera's weight.
    assert model.body_gravcomp[model.body("wrist_camera").id] == 0
    assert all(model.body_gravcomp[model.body(f"link_{k}").id] == 1 for k in range(2, 7))


def test_the_fingers_centres_of_mass_mirror_each_other(model: mujoco.MjModel) -> None:
    data = _at(model, 0.01)
    link = data.body("link_6")
    left, right = (link.xmat.reshape(3, 3).T @ (data.body(f"link_{side}_finger").xipos - link.xpos) for side in SIDES)
    np.testing.assert_allclose(left * (-1, -1, 1), right, atol=1e-5)


def test_drives(model: mujoco.MjModel) -> None:
    # Source: MuJoCo Menagerie yam_linear_4310.
    drives = [model.actuator(k) for k in range(model.nu)]
    assert [drive.gainprm[0] for drive in drives] == [80, 80, 80, 40, 10, 10, 2000]
    assert [-drive.biasprm[2] for drive in drives] == [5, 5, 5, 1.5, 1.5, 1.5, 150]
    assert [tuple(drive.forcerange) for drive in drives] == [(-28, 28)] * 3 + [(-10, 10)] * 3 + [(-100, 100)]
    assert tuple(drives[6].ctrlrange) == (-0.005, 0.0475)


def test_one_drive_moves_both_fingers_between_their_stops(arm: ArmConfig, model: mujoco.MjModel) -> None:
    data = _at(model, 0.0)
    addresses, signs = finger_addresses(model, arm.robot)
    assert list(signs) == [1, 1]
    for wanted in (0.0475, -0.005):
        data.ctrl[6] = wanted
        mujoco.mj_step(model, data, 1500)
        np.testing.assert_allclose(data.qpos[addresses], wanted, atol=5e-4)


def test_a_pad_presses_with_half_of_the_drives_force(arm: ArmConfig) -> None:
    spec = arm_spec(arm, None)
    # Free to move between the pads, as a grasped object.
    block_body = spec.body("link_6").add_body(name="block", pos=(0, 0, 0.1362), gravcomp=1)
    block_body.add_joint(name="block", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1, 0, 0))
    block_body.add_geom(name="block", type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.02, 0.005, 0.005), mass=0.05)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[finger_addresses(model, arm.robot)[0]] = 0.03
    # Closed on 20 mm each way and commanded further, with 2000 N/m.
    data.ctrl[6] = 0.005
    mujoco.mj_step(model, data, 1500)
    block, pressed, force = model.geom("block").id, dict.fromkeys(FINGERS, 0.0), np.zeros(6)
    for k, contact in enumerate(data.contact):
        if block in contact.geom:
            mujoco.mj_contactForce(model, data, k, force)
            finger = model.geom_bodyid[contact.geom[contact.geom != block][0]]
            pressed[model.body(finger).name] += force[0]
    opening = float(data.qpos[finger_addresses(model, arm.robot)[0][0]])
    assert 0.018 < opening < 0.02
    assert list(pressed.values()) == pytest.approx([2000 * (opening - 0.005) / 2] * 2, rel=0.02)


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[set[str]]:
    for contact in data.contact:
        yield {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}


def test_the_gripper_does_not_touch_itself(model: mujoco.MjModel) -> None:
    for opening in np.linspace(-0.005, 0.0475, 8):
        touching = list(_touching(model, _at(model, opening, (0, 1.047, 1.047, 0, 0, 0))))
        assert touching == []


def test_only_neighbours_pass_through_each_other(arm: ArmConfig) -> None:
    # Source: MuJoCo Menagerie yam_linear_4310; the fingers' pads are geoms of their own.
    pairs = {frozenset((pair.bodyname1, pair.bodyname2)) for pair in arm_spec(arm, None).excludes}
    assert pairs == {
        frozenset(("arm", "link_1")),
        frozenset(("link_6", "link_left_finger")),
        frozenset(("link_6", "link_right_finger")),
        frozenset(("link_6", "wrist_camera")),
        frozenset(("link_left_finger", "link_right_finger")),
    }


def test_bare_arm_reaches_to_the_pinch_site(arm: ArmConfig, model: mujoco.MjModel) -> None:
    bare = kinematic_model(arm)
    assert (bare.nq, bare.nu, bare.ngeom, bare.neq) == (6, 0, 0, 0)
    joints = (0.3, 1.2, 1.0, -0.4, 0.2, 0.5)
    data = mujoco.MjData(bare)
    data.qpos[:] = joints
    mujoco.mj_kinematics(bare, data)
    whole = _at(model, 0.0, joints)
    for site in ("pinch_site", "grasp_site", "tcp_site"):
        np.testing.assert_allclose(data.site(site).xpos, whole.site(site).xpos, atol=1e-12)
    np.testing.assert_allclose(bare.site("pinch_site").pos, (0, 0, 0.1362))


def test_without_all_of_its_mesh_sets_an_arm_shows_its_primitives(arm: ArmConfig, tmp_path: Path) -> None:
    assert set(arm.robot.mesh_sets) == {"i2rt_yam_crank", "i2rt_yam_linear_4310"}
    for meshes in ({}, {"i2rt_yam_crank": tmp_path}):
        model = arm_spec(arm, meshes).compile()
        assert model.nmesh == 0
        assert set(model.geom_group) == {2}
