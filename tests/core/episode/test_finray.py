"""An arm with fin-ray fingers: contact with the table, and reproduced attempts."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from tests.attempts import all_actions, planned
from yamsim_cli.core.attempt_data import ArmPosture, ObjectLayout
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.scene.compilation import physics_failure
from yamsim_cli.core.scene.compiled import GeomOwnerKind

# Both on the table, away from the hand.
_ASIDE = ObjectLayout({"strawberry": pose([0.60, -0.25, 0.0213]), "plate": pose([0.58, 0.20, 0.001])})


@pytest.fixture(scope="module")
def simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Simulator:
    changes = {("rig",): "single_finray", ("grasp",): "contact", ("task", "things", "object", "of"): "012_strawberry"}
    return Simulator(Session(make_config(changes), locations))


def _bends(model: mujoco.MjModel) -> list[int]:
    return [int(model.jnt_qposadr[k]) for k in range(model.njnt) if "_bend_" in model.joint(k).name]


def test_all_of_a_finger_is_a_finger(simulator: Simulator) -> None:
    model, kinds = simulator.scene.model, simulator.scene.geom_kind
    for side, kind in (("left", GeomOwnerKind.LEFT_FINGER), ("right", GeomOwnerKind.RIGHT_FINGER)):
        of_side = [k for k in range(model.ngeom) if model.geom(k).name.startswith(side)]
        assert len(of_side) > 20
        assert (kinds[of_side] == kind).all()


@pytest.mark.parametrize("ticks", [1, 40])
def test_driven_into_the_table_it_bends_and_comes_back(simulator: Simulator, ticks: int) -> None:
    """Commanded at once, or within 1.3 s, to 6 cm below the table's top."""
    scene, model = simulator.scene, simulator.scene.model
    data = mujoco.MjData(model)
    stand = ArmPosture(np.array(simulator.config.rig.arms[0].robot.start), 0.0375)
    start = scene.start_qpos(_ASIDE, [stand])
    scene.reset(data, start)
    table = data.geom("table").xpos[2] + model.geom("table").size[2]
    shoulder, told = scene.first_arm.arm_ctrl[1], data.ctrl[scene.first_arm.arm_ctrl[1]]
    bends, most, lowest = _bends(model), 0.0, np.inf

    def go(to: float) -> None:
        nonlocal most, lowest
        begin = data.ctrl[shoulder]
        for tick in range(ticks + 60):
            data.ctrl[shoulder] = begin + min(1.0, (tick + 1) / ticks) * (to - begin)
            mujoco.mj_step(model, data, 16)
            assert physics_failure(data) is None
            most = max(most, float(np.abs(data.qpos[bends]).max()))
            lowest = min(
                lowest, min(float(data.geom(f"{side}_foot_collide_tip_8").xpos[2]) for side in ("left", "right"))
            )

    go(told + 0.5)
    assert np.abs(data.qvel).max() < 0.1
    # The middles of the tips' ends, 4 mm high, touch the table without sinking in.
    assert table < lowest < table + 0.006
    assert most < np.radians(60)
    go(told)
    assert np.abs(data.qpos[bends]).max() < np.radians(0.1)
    assert np.abs(data.qvel).max() < 0.01


def test_an_attempt_comes_out_the_same_from_its_actions(simulator: Simulator) -> None:
    done = planned(simulator, 7)
    assert done.outcome.success, done.outcome.detail
    again = simulate_actions(simulator, done.attempt, all_actions(done.recorded_states), EXPERT_RULES)
    for one, other in zip(done.recorded_states, again.recorded_states, strict=True):
        # Including the fingers' bending joints.
        assert len(one.qpos) == 6 + 2 * (1 + 8) + 2 * 7
        np.testing.assert_array_equal(one.qpos, other.qpos)
