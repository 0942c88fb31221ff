import contextlib
import pickle
import random
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.core.dataset.making import CAMERA, frame
from yamsim_cli.core.dataset.checks.lowdim import expected_specs, frame_faults
from yamsim_cli.core.dataset.lowdim import (
    SimulationData,
    content_hash,
    dump_frame,
    flatten_frame,
    frame_array_shapes,
    has_simulation_keys,
    load_frame,
    make_frame,
    recorded_actions,
)
from yamsim_cli.core.errors import DatasetError


def call(module: str, name: str, *arguments) -> bytes:
    """A pickle that calls `module.name` when read by the standard unpickler."""
    stack_global = b"".join(pickle.SHORT_BINUNICODE + bytes([len(part)]) + part.encode() for part in (module, name))
    body = b"\x80\x04" + stack_global + pickle.STACK_GLOBAL + pickle.MARK
    body += b"".join(pickle.dumps(argument, 2)[2:-1] for argument in arguments)
    return body + pickle.TUPLE + pickle.REDUCE + pickle.STOP


def same(one, other) -> bool:
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    return type(one) is type(other) and one == other


@pytest.fixture(scope="module")
def whole() -> bytes:
    return dump_frame(frame(1))


def test_a_frame_survives_a_pickle_and_reads_back_without_yamsim(whole):
    assert same(load_frame(whole), frame(1))
    assert same(pickle.loads(whole), frame(1))


def test_a_frames_keys_come_in_one_order():
    assert list(frame()) == [
        *("joints", "timestamp", "intrinsics", "extrinsics", "banana_pose", "plate_pose"),
        *("ee_pose", "ctrl", "action_joints", "magnet", "language_task", "language_prompt"),
    ]


def test_the_wrist_cameras_matrix_is_stored_on_its_own_too():
    K = np.diag([5.0, 6.0, 1.0])
    data = make_frame(
        **{key: np.zeros((1, *shape)) for key, shape in frame_array_shapes(1, 7).items()},
        timestamp=0,
        intrinsics={"scene": np.eye(3), "wrist": K},
        extrinsics={},
        object_poses={},
        magnet=np.array([False]),
        language_task="",
        language_prompt="",
        wrist_camera="wrist",
    )
    assert list(data)[-1] == "K_wrist"
    assert np.array_equal(data["K_wrist"], K)


def test_arrays_are_contiguous_float32_and_scalars_plain():
    data = make_frame(
        joints=np.arange(7)[None],
        timestamp=np.float32(0.5),
        intrinsics={"c": np.asfortranarray(np.arange(9.0).reshape(3, 3))},
        extrinsics={"c": np.eye(4)[::-1]},
        object_poses={"banana": np.eye(4, dtype=int)},
        ee_pose=np.eye(4)[None],
        ctrl=np.arange(7)[None],
        action_joints=np.arange(7.0)[None, ::-1],
        magnet=np.array([True]),
        language_task="",
        language_prompt="",
    )
    arrays = [value for value in data.values() if isinstance(value, np.ndarray)]
    arrays += [*data["intrinsics"].values(), *data["extrinsics"].values()]
    assert len(arrays) == 7
    assert all(array.dtype == np.float32 and array.flags.c_contiguous for array in arrays)
    assert (type(data["timestamp"]), type(data["magnet"])) == (float, bool)


def test_a_lone_arm_has_no_axis_and_two_come_one_after_the_other():
    """Values per arm have an axis of arms after reading."""
    for arms in (1, 2):
        given = {key: np.zeros((arms, 7)) for key in ("joints", "ctrl", "action_joints")}
        data = make_frame(
            **given | {"joints": np.arange(7.0 * arms).reshape(arms, 7)},
            timestamp=0,
            intrinsics={},
            extrinsics={},
            object_poses={},
            ee_pose=np.tile(np.eye(4), (arms, 1, 1)),
            magnet=np.arange(arms) == 1,
            language_task="",
            language_prompt="",
            simulation=SimulationData(np.zeros(9), np.zeros((2, 7 * arms)), np.zeros((2, arms), bool)),
        )
        assert data["joints"].tolist() == list(range(7 * arms))
        assert data["ee_pose"].shape == ((4, 4) if arms == 1 else (2, 4, 4))
        assert data["sim_magnet"].shape == ((2,) if arms == 1 else (2, 2))
        assert data["magnet"] is False if arms == 1 else data["magnet"].tolist() == [False, True]


def test_equal_frames_give_equal_bytes_whatever_objects_they_are_made_of():
    shared = np.zeros((4, 4), dtype=np.float32)
    word = "pick"

    def data(separate: bool) -> dict:
        zeros = (lambda: np.zeros((4, 4), dtype=np.float32)) if separate else (lambda: shared)
        text = (lambda: "".join(["pi", "ck"])) if separate else (lambda: word)
        return {"a": zeros(), "b": zeros(), text(): text(), "c": {text(): text()}, "d": text()}

    assert data(True)["d"] is not word
    assert dump_frame(data(True)) == dump_frame(data(False))


def test_a_frames_bytes_do_not_depend_on_the_process(whole):
    script = (
        "import sys; from tests.core.dataset.making import frame\n"
        "from yamsim_cli.core.dataset.lowdim import dump_frame\n"
        "sys.stdout.buffer.write(dump_frame(frame(1)))"
    )
    other = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONPATH": ":".join(sys.path), "PYTHONHASHSEED": "7"},
        capture_output=True,
    )
    assert other.stdout == whole, other.stderr.decode()


@pytest.mark.parametrize(
    ("module", "name", "arguments"),
    [
        ("os", "system", ("touch pwned",)),
        ("builtins", "eval", ("open('pwned', 'w')",)),
        ("numpy", "load", ("pwned",)),
        ("numpy", "core", ()),
        ("numpy", "ndarray.tofile", ()),
        ("numpy", "dtype.type", ()),
        ("numpy._core.multiarray", "fromstring", ("",)),
        ("numpy._core.numeric", "load", ("pwned",)),
        ("numpy.core.multiarray", "os.system", ("touch pwned",)),
        ("yamsim_cli.core.dataset.lowdim", "load_frame", (b"",)),
    ],
)
def test_a_pickle_that_names_anything_but_arrays_is_refused_by_name(module, name, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError) as caught:
        load_frame(call(module, name, *arguments))
    assert f"names {module}.{name}," in str(caught.value)
    assert "was not run" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


class NestedPickle:
    class Bomb:
        def __reduce__(self):
            return eval, ("open('pwned', 'w')",)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_bomb_deep_inside_a_frame_is_refused_in_any_protocol(tmp_path, monkeypatch, protocol):
    monkeypatch.chdir(tmp_path)
    data = pickle.dumps({"deep": [({"x": NestedPickle.Bomb()},)]}, protocol)
    with pytest.raises(DatasetError, match=r"(builtins|__builtin__)\.eval"):
        load_frame(data)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [[1, 2], "text", None, 5, np.zeros(3)])
def test_a_frame_is_a_dictionary(content):
    with pytest.raises(DatasetError, match=f"must be a dictionary, not {type(content).__name__}"):
        load_frame(pickle.dumps(content))


def test_a_frame_cut_off_anywhere_is_a_dataset_error(whole):
    for length in range(len(whole)):
        with pytest.raises(DatasetError, match="not a valid pickle"):
            load_frame(whole[:length])


@given(st.binary(max_size=200))
def test_random_bytes_are_a_dataset_error_or_a_dictionary(data):
    with contextlib.suppress(DatasetError):
        assert isinstance(load_frame(data), dict)


def test_frames_written_with_numpy_1_are_read():
    data = frame(1) | {"scale": np.float64(0.5)}
    # In protocol 3 a module's name is a plain line, so it can be replaced by numpy 1's name.
    old = pickle.dumps(data, 3).replace(b"cnumpy._core.", b"cnumpy.core.")
    assert {b"multiarray\n_reconstruct", b"multiarray\nscalar"} <= set(re.findall(rb"cnumpy\.core\.(\w+\n\w+)", old))
    assert b"numpy._core" not in old
    assert same(load_frame(old), data)


@given(st.lists(npst.arrays(np.float32, npst.array_shapes(max_dims=2, max_side=4)), max_size=4), st.text(max_size=20))
def test_any_arrays_and_text_survive(arrays, text):
    data = {"arrays": dict(enumerate(arrays)), "text": text, "number": 0.1, "flag": True}
    assert same(load_frame(dump_frame(data)), data)


def test_the_content_hash_knows_values_and_not_pickles():
    frames = [frame(k) for k in range(3)]
    again = [load_frame(pickle.dumps(data, protocol)) for data, protocol in zip(frames, (3, 4, 5), strict=True)]
    shuffled = [dict(random.Random(1).sample(list(data.items()), len(data))) for data in frames]
    assert content_hash(frames) == content_hash(again) == content_hash(shuffled) != content_hash(frames[::-1])


@pytest.mark.parametrize(
    "change",
    [
        {"timestamp": 0.1000001},
        {"magnet": True},
        {"language_prompt": "pick up the bananas"},
        {"joints": np.zeros(7, np.float32)},
        {"joints": frame()["joints"].astype(np.float64)},
        {"joints": frame()["joints"].reshape(7, 1)},
        {"joints": frame()["joints"][::-1]},
        {"intrinsics": {}},
        {"more": 0},
    ],
)
def test_the_content_hash_changes_with_any_value(change):
    assert content_hash([frame() | change]) != content_hash([frame()])


def test_a_flat_frame_names_what_its_dictionaries_hold():
    entries = flatten_frame(frame())
    assert list(entries)[:4] == ["joints", "timestamp", f"intrinsics[{CAMERA}]", f"extrinsics[{CAMERA}]"]
    assert entries[f"intrinsics[{CAMERA}]"] is not None


OBJECTS = ("banana", "plate")
# No two values are equal in float32.
QPOS = 0.1 + np.arange(22) * 1e-12
CTRL = 0.2 + np.arange(14).reshape(2, 7) * 1e-12


def simulated() -> dict:
    plain = {key: np.zeros((1, *shape)) for key, shape in frame_array_shapes(1, 7).items()}
    return make_frame(
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


def test_simulation_data_comes_last_and_keeps_every_bit():
    assert list(simulated())[-3:] == ["sim_qpos", "sim_ctrl", "sim_magnet"]
    data = load_frame(dump_frame(simulated()))
    np.testing.assert_array_equal(data["sim_qpos"], QPOS)
    np.testing.assert_array_equal(data["sim_ctrl"], CTRL)
    assert data["sim_magnet"].tolist() == [False, True]
    assert (data["sim_qpos"].dtype, data["sim_magnet"].dtype) == (np.float64, np.bool_)


def test_a_frame_has_all_simulation_data_or_none():
    assert has_simulation_keys(simulated())
    assert not has_simulation_keys(frame())
    assert frame_faults(simulated(), expected_specs(OBJECTS, [CAMERA], 1, 7)) == []
    assert frame_faults(frame(), expected_specs(OBJECTS, [CAMERA], 1, 7)) == []


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
def test_each_fault_of_simulation_data_is_named(change, fault):
    (found,) = frame_faults(simulated() | change, expected_specs(OBJECTS, [CAMERA], 1, 7))
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
    with pytest.raises(DatasetError, match="frame 0 has 22 positions and 7 drives, but its scene has 44 and 14"):
        recorded_actions([simulated()], 44, 14)
