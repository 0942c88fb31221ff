"""First difference between two episodes, and its size."""

from __future__ import annotations

import numpy as np
import pytest

from tests.core.dataset.making import frame
from yamsim_cli.datasets.compare import ValueDifference, compare_frames, compare_values


def episode() -> list[dict]:
    return [frame(k) for k in range(4)]


def test_equal_episodes_do_not_differ():
    result = compare_frames(episode(), episode(), 0.0)
    assert result.first_difference is None
    assert result.max_error == 0.0
    assert {"joints", "timestamp", "banana_pose", "intrinsics.scene_camera"} <= set(result.largest)
    assert "language_task" not in result.largest


def test_the_first_frame_and_the_value_in_it_are_named():
    made = episode()
    for k, change in ((2, 0.25), (3, 7.0)):
        made[k]["joints"] = made[k]["joints"] + np.float32(change) * np.eye(7, dtype=np.float32)[5]
    stored = episode()
    result = compare_frames(stored, made, 0.0)
    assert result.first_difference is not None
    assert (result.first_difference.frame, result.first_difference.time_s, result.first_difference.quantity) == (
        2,
        0.128,
        "joints[5]",
    )
    assert result.first_difference.stored == float(stored[2]["joints"][5])
    assert result.first_difference.got == float(made[2]["joints"][5])
    assert result.first_difference.difference == pytest.approx(0.25)
    assert result.max_error == result.largest["joints"] > 3


def test_of_several_values_in_a_frame_the_one_that_differs_most():
    made = episode()
    made[1]["joints"] = made[1]["joints"] + np.float32(0.1)
    made[1]["plate_pose"] = made[1]["plate_pose"] + np.float32(0.2) * np.eye(4, dtype=np.float32)[::-1]
    first = compare_frames(episode(), made, 0.0).first_difference
    assert first is not None
    assert first.quantity == "plate_pose[0, 3]"


def test_what_is_within_the_tolerance_is_measured_and_not_told():
    made = episode()
    made[1]["ctrl"] = made[1]["ctrl"] + np.float32(1e-5)
    result = compare_frames(episode(), made, 1e-4)
    assert result.first_difference is None
    assert result.max_error == pytest.approx(1e-5, rel=0.1)
    assert compare_frames(episode(), made, 1e-6).first_difference is not None


def test_large_numbers_count_relative_to_what_is_stored():
    assert compare_values({"fx": 500.0}, {"fx": 500.5}, 0.0).max_error == pytest.approx(1e-3)
    assert compare_values({"dxy": 0.5}, {"dxy": 0.501}, 0.0).max_error == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("stored", "got", "shown"),
    [
        ("weld", "contact", ("weld", "contact")),
        (True, False, ("True", "False")),
        (None, "knocked", ("None", "knocked")),
        (1.0, None, (1.0, "None")),
        (1.0, float("nan"), (1.0, "nan")),
        (True, 1.0, ("True", 1.0)),
        (np.zeros(3), np.zeros(4), ("float64 (3,)", "float64 (4,)")),
        (np.zeros(3), np.zeros(3, np.float32), ("float64 (3,)", "float32 (3,)")),
        (np.zeros(3), "gone", ("float64 (3,)", "gone")),
    ],
)
def test_values_that_are_not_numbers_must_be_equal(stored, got, shown):
    result = compare_values({"a": stored}, {"a": got}, 1e9)
    assert result.first_difference == ValueDifference(None, None, "a", *shown, None)


def test_a_value_that_is_not_finite_is_named_before_any_other():
    made = episode()
    made[1]["joints"] = made[1]["joints"] + np.float32(5)
    made[1]["ctrl"] = np.where(np.arange(7) == 4, np.nan, made[1]["ctrl"]).astype(np.float32)
    result = compare_frames(episode(), made, 0.0)
    assert result.first_difference is not None
    assert (result.first_difference.quantity, result.first_difference.got, result.first_difference.difference) == (
        "ctrl[4]",
        "nan",
        None,
    )
    assert result.max_error == pytest.approx(5, rel=1)


def test_a_key_that_only_one_side_has_is_told():
    stored, made = episode(), episode()
    del stored[3]["ctrl"]
    made[3]["depth"] = 1.0
    first = compare_frames(stored, made, 0.0).first_difference
    assert first is not None
    assert (first.quantity, first.stored, first.got) == ("ctrl", "missing", "float32 (7,)")


def test_another_number_of_frames_is_told_after_what_differs_in_them():
    assert compare_frames(episode(), episode()[:3], 0.0).first_difference == ValueDifference(
        None, None, "frames", 4.0, 3.0, None
    )
    made = episode()[:3]
    made[0]["magnet"] = True
    first = compare_frames(episode(), made, 0.0).first_difference
    assert first is not None
    assert first.quantity == "magnet"
