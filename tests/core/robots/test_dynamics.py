"""A revision of an arm's dynamics: a file for a rig's arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config, parse_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.upgrade import upgrade_config
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.arm_model import arm_spec, kinematic_model

WHERE = Locations.from_environment({})
MINE = """
base: i2rt_yam
revision: mine
joints:
  joint2: {armature: 0.05, damping: 0.7, frictionloss: 0.4, kp: 50, kv: 3, gravity_factor: 1.1, offset_rad: 0.01}
command_delay_ms: 20
tip_mass_g: 100
"""


def _file(tmp_path: Path, text: str = MINE) -> str:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return str(path)


def _rig(files: list[str], name: str = "single") -> RigConfig:
    return load_config(RigConfig, "rigs", name, WHERE, {("robot",): ("--robot", files)})


def test_joints_move_as_the_file_says_and_others_as_the_model(tmp_path: Path) -> None:
    plain = arm_spec(load_config(RigConfig, "rigs", "single", WHERE).arms[0], None).compile()
    model = arm_spec(_rig([_file(tmp_path)]).arms[0], None).compile()

    moved, drive = model.joint("joint2").dofadr[0], model.actuator("joint2").id
    assert (model.dof_armature[moved], model.dof_damping[moved], model.dof_frictionloss[moved]) == (0.05, 0.7, 0.4)
    assert (model.actuator_gainprm[drive, 0], model.actuator_biasprm[drive, 2]) == (50, -3)
    for key in ("dof_armature", "dof_damping", "dof_frictionloss"):
        assert np.array_equal(np.delete(getattr(model, key), moved), np.delete(getattr(plain, key), moved))


def test_a_mass_at_the_tip_hangs_where_fingers_meet_and_nothing_bears_it(tmp_path: Path) -> None:
    model = arm_spec(_rig([_file(tmp_path)]).arms[0], None).compile()

    tip = model.body("tip_mass")

    assert (tip.mass[0], model.body_gravcomp[tip.id]) == (0.1, 0)
    assert np.allclose(tip.pos, model.site("pinch_site").pos)
    # Kinematics stay those of the arm.
    assert kinematic_model(_rig([_file(tmp_path)]).arms[0]).nq == 6


def test_a_rigs_file_may_name_it_as_its_model(tmp_path: Path) -> None:
    arm = f"{{name: arm1, side: right, model: {_file(tmp_path)}, gripper: linear_4310}}"
    (tmp_path / "rig.yaml").write_text(f"arms: [{arm}]\n")

    rig = load_config(RigConfig, "rigs", str(tmp_path / "rig.yaml"), WHERE)

    assert rig.arms[0].model.name == "i2rt_yam"
    assert rig.arms[0].dynamics is not None
    assert rig.arms[0].dynamics.revision == "mine"


def test_one_side_alone_may_have_it(tmp_path: Path) -> None:
    rig = _rig([_file(tmp_path, MINE + "side: left\n")], "bimanual")

    assert {arm.side: arm.dynamics is not None for arm in rig.arms} == {"left": True, "right": False}


def test_a_recordings_config_says_all_of_it(tmp_path: Path) -> None:
    overrides = {("rig", "robot"): ("--robot", [_file(tmp_path)])}
    config = load_config(RecordConfig, "record", "default", WHERE, overrides)

    text = dump_yaml(config.data_config())
    again = parse_config(RecordConfig, text, "config.yaml", WHERE, upgrade=upgrade_config)

    assert again.rig.arms[0].dynamics == config.rig.arms[0].dynamics
    plain = load_config(RecordConfig, "record", "default", WHERE).data_config()
    assert [arm["dynamics"] for arm in plain["rig"]["arms"]] == [None]


@pytest.mark.parametrize(
    ("text", "rig", "error", "said"),
    [
        (MINE, "yam_station_crank_4310_d405", UsageError, "is for 'i2rt_yam', but the rig has 'yam_v1'"),
        (MINE.replace("joint2", "joint9"), "single", UsageError, "unknown joint 'joint9'; valid: joint1, joint2"),
        (MINE + "side: left\n", "single", UsageError, "on the left, but the rig has 'i2rt_yam' on the right"),
        (MINE.replace("damping: 0.7", "damping: -1"), "single", ConfigError, "must lie in 0..10000 N m s/rad"),
        (MINE.replace("base: i2rt_yam", ""), "single", ConfigError, "base"),
        ("arms: []\n", "single", ConfigError, "has keys of the kind 'rigs'"),
    ],
)
def test_dynamics_of_another_arm_are_refused(
    tmp_path: Path, text: str, rig: str, error: type[Exception], said: str
) -> None:
    with pytest.raises((ConfigError, UsageError), match=r"mine\.yaml") as told:
        _rig([_file(tmp_path, text)], rig)

    assert said in str(told.value)
    assert isinstance(told.value, error | ConfigError)


def test_a_missing_dynamics_file_is_named() -> None:
    with pytest.raises(UsageError, match=r"--robot: revision config file nope\.yaml does not exist"):
        _rig(["nope.yaml"])
