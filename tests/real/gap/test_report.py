"""The report on several recordings: means with intervals, the limit, and the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.rig_scenes import later, plant, rig_scene, swings
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.real.gap.gap_figures import MotionGap, measure_gap
from yamsim_cli.real.gap.report import build_report, mean_interval95, require_gap_below, write_gap_page

TIMES = np.arange(0, 4.0, 0.01)


@pytest.fixture(scope="module")
def gaps() -> list[MotionGap]:
    commands = [swings(TIMES, seed=seed) for seed in range(3)]
    return [
        measure_gap(rig_scene(), later(plant(rig_scene(), TIMES, [rows]), samples))
        for rows, samples in zip(commands, (1, 2, 3), strict=True)
    ]


def test_an_interval_of_a_mean_is_students() -> None:
    # Source: R, t.test(c(1, 2, 4)).
    assert mean_interval95([1.0, 2.0, 4.0]) == pytest.approx((-1.461253, 6.127920), abs=1e-5)
    assert mean_interval95([1.0]) is None
    wide = np.random.default_rng(0).normal(size=400)
    low, high = mean_interval95(list(wide)) or (0.0, 0.0)
    assert (high - low) / 2 == pytest.approx(1.966 * wide.std(ddof=1) / 20, rel=1e-3)


def test_a_report_has_means_intervals_and_the_worst(gaps: list[MotionGap]) -> None:
    report = build_report(gaps, "single")
    json.dumps(report, allow_nan=False)
    assert [row["name"] for row in report["joints"]] == [f"joint{k}" for k in range(1, 7)]
    joint = report["joints"][2]
    delays = [gap.joints[2].measured_vs_simulated.delay for gap in gaps]
    assert joint["delay_s"] == pytest.approx(np.mean([value for value in delays if value is not None]))
    low, high = joint["intervals"]["delay_s"]
    assert low < 0.02 < high
    assert joint["max_rad"] == max(gap.joints[2].error.max for gap in gaps)
    assert "max_rad" not in joint["intervals"]
    # Intervals of three recordings are wide, and end at 0.
    assert min(row["intervals"]["rms_rad"][0] for row in report["joints"]) == 0
    worst = max(gaps, key=lambda gap: abs(gap.worst.error))
    assert report["worst"] == {"recording": "plant"} | report["recordings"][gaps.index(worst)]["worst"]
    assert sum(phase["share"] for phase in report["phases"]) == pytest.approx(1)
    (hand,) = report["hands"]
    assert 0 < hand["rms_mm"] < hand["max_mm"]


def test_one_recording_has_no_intervals(gaps: list[MotionGap]) -> None:
    report = build_report(gaps[:1], "single")
    assert "intervals" not in report and "intervals" not in report["joints"][0]
    assert report["joints"][0]["overshoot_rad"] is None


def test_a_joint_above_the_limit_is_named(gaps: list[MotionGap]) -> None:
    report = build_report(gaps, "single")
    largest = max(report["joints"], key=lambda joint: joint["rms_rad"])
    require_gap_below(report, largest["rms_rad"] * 1000 + 1e-6)
    require_gap_below(report, None)
    expected = rf"the error of {largest['name']} is .* mrad RMS \(and 5 more\), more than --fail-above"
    with pytest.raises(SimulationError, match=expected):
        require_gap_below(report, 0.1)


def test_a_page_shows_every_joint_and_the_worst_moment(gaps: list[MotionGap], tmp_path: Path) -> None:
    report = build_report(gaps, "<single>")
    path = tmp_path / "gap.html"
    write_gap_page(report, gaps, [], path)
    text = path.read_text()
    assert text.endswith("</html>\n") and "&lt;single&gt;" in text and "<single>" not in text
    assert text.count('class="curve measured"') == 6 and text.count('class="curve error-curve"') == 6
    # The worst moment is marked in the two plots of its joint.
    assert text.count('class="limit"') == 2
    assert "By recording" in text and "nan" not in text


def test_the_page_tells_the_photos_distance_without_a_gap(gaps: list[MotionGap], tmp_path: Path) -> None:
    distances = {"outline_px": 2.5, "measured_outline_px": 0.4, "iou": 0.9}
    pictures = {key: {"mean": value, "worst": value} for key, value in distances.items()}
    report = build_report(gaps, "single") | {"pictures": {"camera": "top", "photos": 4, "without_pose": 2, **pictures}}
    write_gap_page(report, gaps, [], tmp_path / "gap.html")
    text = (tmp_path / "gap.html").read_text()
    assert "4 photos of camera top were compared. 2 were left out" in text
    assert "at its measured joints, which does not include the gap: 0.4 px on average" in text
