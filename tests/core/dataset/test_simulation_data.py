"""What a simulated frame holds beside what a real one does: enough to repeat it bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from tests.core.dataset.making import CAMERA, frame
from yamsim_cli.core.dataset.checks.lowdim import expected_forms, frame_faults
from yamsim_cli.core.dataset.lowdim import (
    SimulationData,
    dump_frame,
    frame_data,
    has_simulation,
    load_frame,
    recorded_actions,
    shapes,
)
from yamsim_cli.core.errors import DatasetError

OBJECTS = ("banana", "plate")
# No two of these are the same number in float32.
QPOS = 0.1 + np.arange(22) * 1e-12
CTRL = 0.2 + np.arange(14).reshape(2, 7) * 1e-12


def simulated() -> dict:
    plain = {key: np.zeros((1, *shape)) for key, shape in shapes(1, 7).items()}
    return frame_data(
        **plain,
        timestamp=0.064,
        intrinsics={CAMERA: np.eye(3)},
        extrinsics={CAMERA: np.eye(4)},
        object_poses={name: np.eye(4) for name in OBJECTS},
        magnet=np.array([False]),
        language_task="",
        language_prompt="",
        simulation=SimulationData(QPOS, CTRL, np.array([[False], [True]])),
    )


def test_it_comes_last_and_keeps_every_bit():
    assert list(simulated())[-3:] == ["sim_qpos", "sim_ctrl", "sim_magnet"]
    data = load_frame(dump_frame(simulated()))
    np.testing.assert_array_equal(data["sim_qpos"], QPOS)
    np.testing.assert_array_equal(data["sim_ctrl"], CTRL)
    assert data["sim_magnet"].tolist() == [False, True]
    assert (data["sim_qpos"].dtype, data["sim_magnet"].dtype) == (np.float64, np.bool_)


def test_a_frame_has_all_of_it_or_none():
    assert has_simulation(simulated())
    assert not has_simulation(frame())
    assert frame_faults(simulated(), expected_forms(OBJECTS, [CAMERA], 1, 7)) == []
    assert frame_faults(frame(), expected_forms(OBJECTS, [CAMERA], 1, 7)) == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"sim_qpos": None}, "sim_qpos is missing"),
        ({"sim_qpos": QPOS.astype(np.float32)}, "sim_qpos is float32 (22,), not float64 with 1 dimensions"),
        ({"sim_ctrl": CTRL[0]}, "sim_ctrl is float64 (7,), not float64 with 2 dimensions"),
        ({"sim_ctrl": CTRL * np.nan}, "sim_ctrl has values that are not finite, or beyond 1000 m or rad"),
        ({"sim_qpos": QPOS * 1e300}, "sim_qpos has values that are not finite, or beyond 1000 m or rad"),
        ({"sim_magnet": [True, False]}, "sim_magnet is list, not bool with 1 dimensions"),
        ({"sim_magnet": np.array([True])}, "sim_ctrl has 2 ticks and sim_magnet 1"),
        ({"sim_magnet": np.ones((2, 2), bool)}, "sim_magnet is bool (2, 2), not bool with 1 dimensions"),
    ],
)
def test_each_fault_is_named(change, fault):
    (found,) = frame_faults(simulated() | change, expected_forms(OBJECTS, [CAMERA], 1, 7))
    assert found.endswith(fault)


def test_the_actions_of_an_episode_are_those_of_every_tick():
    last = simulated() | {"sim_ctrl": CTRL[:1] + 1, "sim_magnet": np.array([True])}
    recorded = recorded_actions([simulated(), last], 22, 7)
    assert recorded is not None
    start, actions = recorded
    np.testing.assert_array_equal(start, QPOS)
    np.testing.assert_array_equal(actions.ctrl, [*CTRL, CTRL[0] + 1])
    assert actions.magnet.tolist() == [[False], [True], [True]]
    assert actions.joints.shape == (3, 1, 7)


def test_without_simulation_data_in_every_frame_there_are_no_actions():
    assert recorded_actions([simulated(), frame()], 22, 7) is None
    assert recorded_actions([], 22, 7) is None


def test_an_episode_of_another_scene_is_refused():
    with pytest.raises(DatasetError, match="frame 0 has 22 positions and 7 drives, and its scene 44 and 14"):
        recorded_actions([simulated()], 44, 14)
