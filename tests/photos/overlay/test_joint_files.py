"""Users' joint files, and each fault of a file in one line."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.photos.overlay.joint_files import ArmPostures, home_postures, load_postures

ARM = [0.3, 1.2, 1.0, -0.2, 0.1, 0.4]
LEFT = [-0.4, 0.8, 1.3, 0.2, -0.3, 0.1, 0.01]
RIGHT = [*ARM, 0.03]


def load_joints(path: Path, rig: RigConfig) -> np.ndarray:
    """Joints and opening of every arm (rows, arms, 7)."""
    return np.array([as_rows(row) for row in load_postures(path, rig)])


def as_rows(stands: ArmPostures) -> list[list[float]]:
    return [[*stand.joints, stand.opening] for stand in stands]


def npy(path: Path, values: Any) -> Path:
    np.save(path / "j.npy", np.array(values))
    return path / "j.npy"


def yaml(path: Path, text: str) -> Path:
    (path / "j.yaml").write_text(text)
    return path / "j.yaml"


def pkl(path: Path, data: Any) -> Path:
    (path / "j.pkl").write_bytes(pickle.dumps(data))
    return path / "j.pkl"


def test_without_joints_the_arms_are_at_home(single: RigConfig, russet: RigConfig) -> None:
    assert len(home_postures(single)) == 1
    assert as_rows(home_postures(russet)) == [[0, 1.047, 1.047, 0, 0, 0, 0]] * 2


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_file_with_one_row_of_one_arm_is_read(tmp_path: Path, single: RigConfig, dtype: type) -> None:
    for values, gripper in ((ARM, 0.0), (RIGHT, 0.03), ([RIGHT], 0.03)):
        rows = load_joints(npy(tmp_path, np.array(values, dtype)), single)
        assert rows.shape == (1, 1, 7)
        assert rows[0, 0] == pytest.approx([*ARM, gripper], abs=1e-6)


def test_a_file_with_a_row_for_each_photo_is_read(tmp_path: Path, single: RigConfig) -> None:
    many = np.array([RIGHT, RIGHT, RIGHT])
    many[:, 0] = [0.1, 0.2, 0.3]
    rows = load_joints(npy(tmp_path, many), single)
    assert rows.shape == (3, 1, 7)
    assert rows[:, 0, 0].tolist() == [0.1, 0.2, 0.3]


def test_fourteen_joints_are_those_of_the_left_arm_then_the_right_arm(
    tmp_path: Path, single: RigConfig, russet: RigConfig, locations: Locations
) -> None:
    rows = load_joints(npy(tmp_path, LEFT + RIGHT), russet)
    # The rig names its right arm first.
    assert [arm.side for arm in russet.arms] == ["right", "left"]
    assert rows[0].tolist() == [RIGHT, LEFT]
    one = load_joints(npy(tmp_path, LEFT + RIGHT), single)
    assert one[0].tolist() == [RIGHT if single.arms[0].side == "right" else LEFT]


def test_yaml_of_either_form(tmp_path: Path, single: RigConfig, russet: RigConfig) -> None:
    assert load_joints(yaml(tmp_path, f"joints: {RIGHT}\n"), single)[0].tolist() == [RIGHT]
    assert load_joints(yaml(tmp_path, f"joints: {LEFT + RIGHT}\n"), russet)[0].tolist() == [RIGHT, LEFT]
    both = load_joints(yaml(tmp_path, f"arm1: {RIGHT}\narm2: {LEFT}\n"), russet)
    assert both[0].tolist() == [RIGHT, LEFT]
    one = load_joints(yaml(tmp_path, f"arm2: {ARM}\n"), russet)
    assert one[0].tolist() == [as_rows(home_postures(russet))[0], [*ARM, 0.0]]
    rows = load_joints(yaml(tmp_path, f"joints: [{RIGHT}, {RIGHT}]\n"), single)
    assert rows.shape == (2, 1, 7)


def test_a_recorded_frame(tmp_path: Path, single: RigConfig, russet: RigConfig) -> None:
    frame = {"joints": np.array(RIGHT, np.float32), "timestamp": 0.5, "intrinsics": {}}
    assert load_joints(pkl(tmp_path, frame), single)[0, 0] == pytest.approx(RIGHT, abs=1e-6)
    frame["joints"] = np.array(LEFT + RIGHT, np.float32)
    assert load_joints(pkl(tmp_path, frame), russet)[0, 1] == pytest.approx(LEFT, abs=1e-6)


@pytest.mark.parametrize(
    ("grippers", "wanted"),
    [
        ((0.0, 0.0), (0.0, 0.0)),
        ((0.0375, 0.01), (0.0375, 0.01)),
        # The command of a fully open gripper, and a little noise at the closed end.
        ((0.041, -0.001), (0.0375, 0.0)),
        # Shares: one value beyond metres makes the whole file shares.
        ((1.0, 0.02), (0.0375, 0.00075)),
        ((0.5, 1.04), (0.01875, 0.0375)),
    ],
)
def test_grippers_in_metres_or_shares(
    tmp_path: Path, russet: RigConfig, grippers: tuple[float, float], wanted: tuple[float, float]
) -> None:
    row = [*ARM, grippers[1], *ARM, grippers[0]]
    assert load_joints(npy(tmp_path, row), russet)[0, :, 6] == pytest.approx(wanted)


def test_a_wider_gripper_has_a_wider_full_opening(tmp_path: Path, locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", "single_linear", locations)
    for given, wanted in ((0.0475, 0.0475), (-0.005, 0.0), (1.0, 0.0475), (0.5, 0.02375)):
        assert load_joints(npy(tmp_path, [*ARM, given]), rig)[0, 0, 6] == pytest.approx(wanted)


def test_a_joint_slightly_beyond_its_limit_is_accepted(tmp_path: Path, single: RigConfig) -> None:
    assert load_joints(npy(tmp_path, [0, -0.04, 0, 0, 0, 0]), single)[0, 0, 1] == -0.04


# Header of an array that no memory holds.
HUGE = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999999, 7), }".ljust(117)
    + b"\n"
)


class MaliciousPickle:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return (eval, ("open('owned', 'w')",))


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lambda p: npy(p, np.rad2deg(ARM)), "arm1.joint1: 17.19 rad lies outside -2.618..3.054; is it in degrees?"),
        (lambda p: npy(p, [0, -0.5, 0, 0, 0, 0]), "arm1.joint2: -0.5 rad lies outside 0..3.665"),
        (lambda p: npy(p, [0, np.nan, 0, 0, 0, 0]), "has values that are not finite"),
        (
            lambda p: npy(p, [*ARM, 7.0]),
            "gripper 7 is not an opening; valid: the opening of one finger, 0..0.0375 m, or a share",
        ),
        (lambda p: npy(p, [*ARM, -0.02]), "gripper -0.02"),
        (lambda p: npy(p, ARM[:5]), "joints have the shape (5,); rig 'single' needs 6 or 7 or 14 numbers a row"),
        (lambda p: npy(p, np.zeros((2, 3, 7))), "joints have the shape (2, 3, 7)"),
        (lambda p: npy(p, np.zeros((0, 7))), "holds no row of joints"),
        (lambda p: npy(p, 0.5), "joints have the shape ()"),
        (lambda p: npy(p, ["a", "b"]), "not an array of numbers"),
        (lambda p: npy(p, np.array([MaliciousPickle()], object)), "not an array of numbers"),
        (lambda p: pkl(p, {"joints": MaliciousPickle()}), "eval"),
        (lambda p: pkl(p, MaliciousPickle()), "eval"),
        (lambda p: pkl(p, {"q": np.zeros(7)}), "the frame has no key 'joints'"),
        (lambda p: pkl(p, [1, 2]), "dictionary"),
        (lambda p: pkl(p, {"joints": "none"}), "j.pkl: "),
        (lambda p: yaml(p, "joints: none\n"), "not a list of numbers"),
        (lambda p: yaml(p, "joints: [1, [2, 3]]\n"), "not a list of numbers"),
        (lambda p: yaml(p, f"left: {ARM}\n"), "has the keys left; valid: joints alone, or arm1"),
        (lambda p: yaml(p, f"arm1: {ARM[:4]}\n"), "arm1: has the shape (4,); give 6 joints, or 7 with the gripper"),
        (lambda p: yaml(p, "joints: [0\n"), "not valid YAML"),
        (lambda p: yaml(p, ""), "the top level must be a mapping"),
        (lambda p: p / "j.csv", "unknown kind of file '.csv'; valid: .npy, .yaml, .yml, .pkl"),
        (lambda p: p / "none.npy", "cannot be read: No such file or directory"),
        (lambda p: p / "none.yaml", "cannot be read: No such file or directory"),
    ],
)
def test_each_fault_is_one_line(
    tmp_path: Path, single: RigConfig, monkeypatch: pytest.MonkeyPatch, make: Any, part: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = make(tmp_path)
    with pytest.raises(ConfigError) as caught:
        load_joints(path, single)
    message = str(caught.value)
    assert part in message
    assert "\n" not in message
    assert path.name in message
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", HUGE, b"PK\x03\x04 an archive", b"text"])
def test_damaged_arrays_are_one_line(tmp_path: Path, single: RigConfig, content: bytes) -> None:
    for name in ("j.npy", "j.pkl"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=name):
            load_joints(tmp_path / name, single)


def test_an_archive_of_arrays_is_no_array(tmp_path: Path, single: RigConfig) -> None:
    with (tmp_path / "j.npy").open("wb") as stream:
        np.savez(stream, a=np.zeros(7))
    with pytest.raises(ConfigError, match=r"j\.npy"):
        load_joints(tmp_path / "j.npy", single)


def test_six_joints_are_refused_for_two_arms(tmp_path: Path, russet: RigConfig) -> None:
    wanted = r"rig 'russet' needs 14 \(left 6, left gripper, right 6, right gripper\) numbers a row"
    with pytest.raises(ConfigError, match=wanted):
        load_joints(npy(tmp_path, ARM), russet)
