"""A motion holds the recorded values, with one row per time."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion


def test_a_motion_lasts_from_its_first_sample_to_its_last() -> None:
    motion = RecordedMotion("log.csv", np.array([0.0, 0.01, 0.03]), (ArmMotion("", np.zeros((3, 6))),))
    assert motion.duration == 0.03


@pytest.mark.parametrize("times", [[0.0, 0.0, 0.1], [0.1, 0.2, 0.3], [0.0, 0.2, 0.1]])
def test_times_that_do_not_begin_at_zero_and_increase_are_refused(times: list[float]) -> None:
    with pytest.raises(ValueError, match="times"):
        RecordedMotion("log.csv", np.array(times), (ArmMotion("", np.zeros((3, 6))),))


def test_other_numbers_of_rows_are_refused() -> None:
    times = np.array([0.0, 0.1, 0.2])
    with pytest.raises(ValueError, match=r"\(2, 6\)"):
        RecordedMotion("log.csv", times, (ArmMotion("", np.zeros((3, 6)), commands=np.zeros((2, 6))),))
    with pytest.raises(ValueError, match=r"\(4,\)"):
        RecordedMotion("log.csv", times, (ArmMotion("", np.zeros((3, 6)), openings=np.zeros(4)),))
