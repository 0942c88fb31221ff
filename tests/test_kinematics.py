"""Kinematics from Python: round trips, errors with distances, and nothing of the CLI is loaded."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.attempts import planned
from tests.pages import snippet
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError, SimulationError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import invert_pose, pose, rotation_from_vector, rotation_vector, rotation_z
from yamsim_cli.kinematics import Kinematics, KinematicSite, OutOfReachError

START = np.array([0, 1.85, 1.90, -1.37, 0, 0])
DOWN = np.diag([1.0, -1.0, -1.0])


def run(code: str, repository: Path, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run a user's program, without a chosen OpenGL."""
    env = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=env | {"PYTHONPATH": str(repository)} | environ,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("site", ["pinch_site", "grasp_site"])
@pytest.mark.parametrize(("rig", "arm"), [("single", None), ("single_linear", "right"), ("russet", "left")])
def test_what_goes_forwards_comes_back(rig: str, arm: str | None, site: KinematicSite) -> None:
    kinematics = Kinematics(rig, arm, site=site)
    low, high = kinematics.joint_range.T
    rng = np.random.default_rng(3)
    for _ in range(12):
        T = kinematics.fk(rng.uniform(low, high))
        joints = kinematics.ik(T)
        assert ((low - 1e-9 <= joints) & (joints <= high + 1e-9)).all()
        found = kinematics.fk(joints)
        assert np.linalg.norm(found[:3, 3] - T[:3, 3]) <= 1e-3
        assert np.linalg.norm(rotation_vector(T[:3, :3].T @ found[:3, :3])) <= math.radians(1)


def test_the_answer_is_the_same_every_time_and_near_the_start() -> None:
    kinematics = Kinematics()
    T = kinematics.fk(START)
    T[:3, 3] += (0.02, 0.01, -0.01)
    joints = kinematics.ik(T, START)
    assert np.abs(joints - START).max() < 0.3
    np.testing.assert_array_equal(joints, kinematics.ik(T, START))
    np.testing.assert_array_equal(joints, Kinematics().ik(T, START))
    np.testing.assert_allclose(kinematics.fk(joints), T, atol=1e-6)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_poses_are_those_of_observations_and_of_physics(
    arm: str, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("rig",): "russet"})
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 0)
        frame, scene = frame_records(simulator, done.attempt, done.recorded_states[:1])[0], simulator.scene
    number = ("left", "right").index(arm)
    grasp, pinch = (Kinematics("russet", arm, site=site) for site in ("grasp_site", "pinch_site"))
    np.testing.assert_allclose(grasp.T_base_in_world, scene.arms[number].T_base_in_world)
    joints = frame["joints"][7 * number :][:6]
    T_grasp_in_world = grasp.T_base_in_world @ grasp.fk(joints)
    # Datasets have poses in the left arm's base.
    np.testing.assert_allclose(T_grasp_in_world, scene.T_base_in_world @ frame["ee_pose"][number], atol=1e-5)
    # The crank's pads meet 42 mm beside its axis. Source: robot_models/i2rt_yam/yam_crank.xml.
    between = invert_pose(grasp.fk(joints)) @ pinch.fk(joints)
    np.testing.assert_allclose(np.abs(between[:3, 3]), [0.042, 0, 0], atol=1e-9)
    np.testing.assert_allclose(between[:3, :3], np.eye(3), atol=1e-12)


def test_joints_of_a_pose_in_reach_are_exact() -> None:
    kinematics = Kinematics()
    for joints in np.random.default_rng(6).uniform(*kinematics.joint_range.T, (100, 6)):
        T = kinematics.fk(joints)
        np.testing.assert_allclose(kinematics.fk(kinematics.ik(T)), T, atol=1e-6)
        np.testing.assert_allclose(kinematics.ik(T, joints), joints, atol=1e-6)


def test_a_pose_of_few_digits_is_reached_as_well_as_those_allow() -> None:
    kinematics = Kinematics()
    rounded = kinematics.ik(np.round(kinematics.fk(START + 0.1), 4), START)
    np.testing.assert_allclose(rounded, START + 0.1, atol=2e-3)
    np.testing.assert_allclose(kinematics.fk(rounded)[:3, 3], kinematics.fk(START + 0.1)[:3, 3], atol=1e-4)


def test_out_of_reach_says_how_far_off_the_nearest_is() -> None:
    kinematics = Kinematics()
    with pytest.raises(OutOfReachError, match=r"out of the arm's reach: the nearest pose is \d+\.\d mm") as caught:
        kinematics.ik(pose((1.2, 0, 0.1), DOWN))
    assert isinstance(caught.value, SimulationError)
    nearest = caught.value.nearest
    reached = kinematics.fk(nearest.joints)
    assert nearest.position_error == pytest.approx(np.linalg.norm(reached[:3, 3] - (1.2, 0, 0.1)), abs=1e-6)
    turned = np.linalg.norm(rotation_vector(reached[:3, :3].T @ DOWN))
    assert nearest.rotation_error == pytest.approx(turned, abs=1e-6)
    assert 0.3 < nearest.position_error < 0.6
    assert f"{nearest.position_error * 1000:.1f} mm" in str(caught.value)


def test_a_hand_may_lean_where_the_arm_is_too_short() -> None:
    kinematics = Kinematics()
    # The hand over the near half of the table, turned outwards.
    far = pose((0.60, 0.15, 0.08), rotation_z(math.atan2(0.15, 0.60)) @ kinematics.fk(START)[:3, :3])
    with pytest.raises(OutOfReachError, match=r"is 0\.0 mm and 2\d\.\d deg away \(at most 1 mm and 1 deg\)"):
        kinematics.ik(far, START)
    found = kinematics.fk(kinematics.ik(far, START, rotation_tolerance=0.6))
    assert np.linalg.norm(found[:3, 3] - far[:3, 3]) <= 1e-3
    assert math.radians(20) < np.linalg.norm(rotation_vector(found[:3, :3].T @ far[:3, :3])) <= 0.6


@pytest.mark.parametrize(
    ("make", "error", "told"),
    [
        (lambda: Kinematics("russet"), UsageError, "rig 'russet' has two arms: give arm='left' or arm='right'"),
        (lambda: Kinematics("single", "left"), UsageError, "rig 'single' has no arm 'left'; valid: right"),
        (lambda: Kinematics("singl"), ConfigError, "unknown rig 'singl'; did you mean 'single'"),
        (lambda: Kinematics(site="tcp"), UsageError, "there is no site 'tcp'; valid: grasp_site, pinch_site"),  # type: ignore[arg-type]
        (lambda: Kinematics().fk(np.zeros(7)), UsageError, r"joints has the shape \(7,\), and needs \(6,\)"),
        (lambda: Kinematics().fk([0, 0, 0, 0, 0, math.nan]), UsageError, "joints is not finite"),
        (lambda: Kinematics().fk("joints"), UsageError, "joints is not an array of numbers"),
        (
            lambda: Kinematics().fk([0, 106, 109, -78, 0, 0]),
            UsageError,
            r"joint2: 106 rad lies outside .*; is it in degrees\?",
        ),
        (lambda: Kinematics().ik(np.eye(3)), UsageError, r"T_site_in_base has the shape \(3, 3\)"),
        (
            lambda: Kinematics().ik(np.zeros((4, 4))),
            UsageError,
            "is not a pose: its upper left 3 x 3 part is not a rotation",
        ),
        (lambda: Kinematics().ik(pose(rotation=np.diag([1, 1, -1]))), UsageError, "is not a pose"),
        (lambda: Kinematics().ik(np.eye(4), START[:5]), UsageError, r"start has the shape \(5,\)"),
    ],
)
def test_invalid_arguments_are_refused(make: Callable[[], object], error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        make()


def test_it_loads_nothing_of_the_command_line(repository: Path) -> None:
    code = (
        "import sys\nfrom yamsim_cli.kinematics import Kinematics\nKinematics('russet', 'left').fk([0] * 6)\n"
        "print([name for name in ('typer', 'rich', 'click', 'cv2', 'yamsim_cli.commands') if name in sys.modules])"
    )
    assert run(code, repository).stdout.strip() == "[]"


def test_the_readmes_example_does_what_it_says(repository: Path) -> None:
    code = snippet("python", 'Kinematics("russet"')
    done = run(f"{code}\nprint(joints.shape, arm.fk(joints)[2, 3] - T_pinch_in_base[2, 3])", repository)
    assert done.returncode == 0, done.stderr
    shape, _, off = done.stdout.rpartition(" ")
    assert (shape, abs(float(off)) < 1e-3) == ("(6,)", True)


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(
    "first",
    [
        "from yamsim_cli.kinematics import Kinematics; Kinematics()",
        pytest.param("yamsim_cli.evaluate('hold_still', n=1)", marks=pytest.mark.slow),
    ],
)
def test_pictures_can_be_drawn_later_in_the_same_process(first: str, repository: Path, tmp_path: Path) -> None:
    """MuJoCo is imported by then, without OpenGL."""
    if os.environ["YAMSIM_TEST_GL"] == "native":
        pytest.skip("MuJoCo's own choice is right here")
    code = (
        f"import yamsim_cli\nif __name__ == '__main__':\n    {first}\n"
        f"    print(yamsim_cli.record({str(tmp_path / 'out')!r}, size=(32, 32), quality='fast').episodes)"
    )
    (tmp_path / "script.py").write_text(code)
    done = run(f"import runpy; runpy.run_path({str(tmp_path / 'script.py')!r}, run_name='__main__')", repository)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "1"


@pytest.mark.slow
def test_a_target_beyond_the_solvers_numbers_is_out_of_reach() -> None:
    """Task and damping are twelve orders of magnitude apart there, and the QP has no solution."""
    kinematics = Kinematics()
    # Joints at their limits, as after some steps towards a far target.
    start = [-2.61799, 3.66519, 0, -1.5708, 0.24, -2.0944]
    for direction in ((0, -1, 0), (1, 0, 0), (0.3, 0.9, 0.2)):
        for lean in (0, 0.5, 2):
            place = 60 * np.array(direction) / np.linalg.norm(direction)
            with pytest.raises(OutOfReachError):
                kinematics.ik(pose(place, rotation_from_vector([lean, 0.0, 0.0])), start)
