import contextlib
import pickle
import pickletools
import random
import re
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.core.dataset.making import CAMERA, frame
from yamsim_cli.core.dataset.lowdim import (
    SimulationData,
    content_hash,
    dump_frame,
    flat,
    frame_data,
    load_frame,
    shapes,
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


def test_a_frame_survives_the_way_through_a_pickle(whole):
    assert same(load_frame(whole), frame(1))


def test_a_frame_reads_back_without_yamsim(whole):
    assert same(pickle.loads(whole), frame(1))


def test_a_frames_keys_come_in_one_order():
    assert list(frame()) == [
        *("joints", "timestamp", "intrinsics", "extrinsics", "banana_pose", "plate_pose"),
        *("ee_pose", "ctrl", "action_joints", "magnet", "language_task", "language_prompt"),
    ]


def test_the_wrist_cameras_matrix_is_stored_on_its_own_too():
    K = np.diag([5.0, 6.0, 1.0])
    data = frame_data(
        **{key: np.zeros((1, *shape)) for key, shape in shapes(1, 7).items()},
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
    data = frame_data(
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
    """What is there for each arm comes in with an axis of arms."""
    for arms in (1, 2):
        given = {key: np.zeros((arms, 7)) for key in ("joints", "ctrl", "action_joints")}
        data = frame_data(
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


def test_different_values_give_different_bytes():
    assert len({dump_frame(frame(k, seed)) for k in range(4) for seed in range(3)}) == 12


@pytest.mark.parametrize(
    ("module", "name", "arguments"),
    [
        ("os", "system", ("touch pwned",)),
        ("posix", "system", ("touch pwned",)),
        ("builtins", "eval", ("open('pwned', 'w')",)),
        ("builtins", "open", ("pwned", "w")),
        ("builtins", "getattr", ("", "join")),
        ("subprocess", "Popen", ("touch pwned",)),
        ("numpy", "load", ("pwned",)),
        ("numpy", "save", ("pwned", 1)),
        ("numpy", "fromfile", ("pwned",)),
        ("numpy.f2py", "compile", ("pwned",)),
        ("numpy", "core", ()),
        ("numpy", "ndarray.tofile", ()),
        ("numpy", "dtype.type", ()),
        ("numpy._core.multiarray", "fromstring", ("",)),
        ("numpy._core.numeric", "load", ("pwned",)),
        ("numpy.core.multiarray", "os.system", ("touch pwned",)),
        ("numpy.lib.npyio", "NpzFile", ("pwned",)),
        ("yamsim_cli.core.dataset.lowdim", "load_frame", (b"",)),
        ("collections", "OrderedDict", ()),
    ],
)
def test_a_pickle_that_names_anything_but_arrays_is_refused_by_name(module, name, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError) as caught:
        load_frame(call(module, name, *arguments))
    assert f"names {module}.{name}," in str(caught.value)
    assert "was not run" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


class Nest:
    class Bomb:
        def __reduce__(self):
            return eval, ("open('pwned', 'w')",)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_bomb_deep_inside_a_frame_is_refused_in_any_protocol(tmp_path, monkeypatch, protocol):
    monkeypatch.chdir(tmp_path)
    data = pickle.dumps({"deep": [({"x": Nest.Bomb()},)]}, protocol)
    with pytest.raises(DatasetError, match=r"(builtins|__builtin__)\.eval"):
        load_frame(data)
    assert list(tmp_path.iterdir()) == []


def test_an_instance_of_any_class_is_refused():
    with pytest.raises(DatasetError, match="pathlib"):
        load_frame(pickle.dumps({"joints": __import__("pathlib").PurePosixPath("x")}))


@pytest.mark.parametrize("code", [b"cos\nsystem\n(S'ls'\ntR.", b"(S'ls'\nios\nsystem\n.", b"\x80\x02\x82\x01."])
def test_the_old_ways_to_name_something_are_refused_too(code):
    with pytest.raises(DatasetError):
        load_frame(code)


def test_a_persistent_id_is_refused():
    with pytest.raises(DatasetError):
        load_frame(b"\x80\x04\x8c\x01xQ.")


@pytest.mark.parametrize("content", [[1, 2], "text", None, 5, np.zeros(3)])
def test_a_frame_is_a_dictionary(content):
    with pytest.raises(DatasetError, match=f"must be a dictionary, not {type(content).__name__}"):
        load_frame(pickle.dumps(content))


def test_a_frame_cut_off_anywhere_is_a_dataset_error(whole):
    for length in range(len(whole)):
        with pytest.raises(DatasetError, match="not a whole pickle"):
            load_frame(whole[:length])


@given(st.binary(max_size=200))
def test_random_bytes_are_a_dataset_error_or_a_dictionary(data):
    with contextlib.suppress(DatasetError):
        assert isinstance(load_frame(data), dict)


@pytest.mark.parametrize(
    "data",
    [
        b"\x80\x04\x95" + struct.pack("<Q", 2**64 - 1) + b"}.",
        b"\x80\x04\x8d" + struct.pack("<Q", 2**63) + b"x.",
        b"\x80\x04\x8e" + struct.pack("<Q", 2**64 - 1) + b"x.",
        b"\x80\xff}.",
        b"\x80\x04}" + b"\x8a\xff.",
        b"\x80\x04" + b"l" * 3 + b".",
        b"\x80\x04\x8c\x02\xff\xff.",
        b"",
        b".",
        b"}",
        b"{}",
        b"\xff\xd8\xff\xe0JFIF",
    ],
)
def test_what_is_no_pickle_is_a_dataset_error(data):
    with pytest.raises(DatasetError):
        load_frame(data)


def test_a_changed_value_is_read_as_another_value(whole):
    """Bytes inside strings and arrays carry no structure: that is what hashes are for."""
    operations = list(pickletools.genops(whole))
    arrays = [position for _, argument, position in operations if isinstance(argument, bytes) and len(argument) > 16]
    assert len(arrays) == 8
    for position in arrays:
        damaged = bytearray(whole)
        damaged[position + 10] ^= 0x01
        assert not same(load_frame(bytes(damaged)), frame(1))


@pytest.mark.parametrize("protocol", [3, 4, 5])
def test_frames_pickled_by_others_are_read_in_every_protocol_that_has_bytes(protocol):
    data = frame(1) | {"scale": np.float64(0.5), "counts": [1, 2**70, -3], "pair": (None, False)}
    assert same(load_frame(pickle.dumps(data, protocol)), data)


def test_frames_written_with_numpy_1_are_read():
    data = frame(1) | {"scale": np.float64(0.5)}
    # In protocol 3 a module's name is a plain line, so it can be replaced by the one that numpy 1 wrote.
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
    assert content_hash(frames) == content_hash(again) == content_hash(shuffled)


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


def test_the_content_hash_knows_the_order_of_frames():
    assert content_hash([frame(0), frame(1)]) != content_hash([frame(1), frame(0)])


def test_a_flat_frame_names_what_its_dictionaries_hold():
    entries = flat(frame())
    assert list(entries)[:4] == ["joints", "timestamp", f"intrinsics[{CAMERA}]", f"extrinsics[{CAMERA}]"]
    assert entries[f"intrinsics[{CAMERA}]"] is not None
