"""A dataset in numbers."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.datasets.checks.sample import CAMERA, FRAMES, OUTCOME, SampleDataset, episode, look
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.statistics import wilson_interval_95
from yamsim_cli.datasets.check_summary import summarize_checks


@pytest.fixture
def sample(config: RecordConfig) -> SampleDataset:
    return SampleDataset(config.data_config(), [episode(k) for k in range(3)])


@pytest.fixture
def summary(tmp_path: Path, locations: Locations) -> Callable[..., dict[str, Any]]:
    def of(sample: SampleDataset, thresholds: Sequence[float] = (0.05, 0.08), plain: bool = False) -> dict[str, Any]:
        path = (sample.write_plain if plain else sample.write)(tmp_path / "dataset")
        report = summarize_checks(look(path, locations), thresholds)
        json.dumps(report, allow_nan=False)
        return report

    return of


def put(sample: SampleDataset, distances: Sequence[float]) -> None:
    """Let the banana of each episode end at a distance from the plate's centre."""
    for made, distance in zip(sample.episodes, distances, strict=True):
        last = made.frames[-1]
        pose = last["plate_pose"].copy()
        pose[0, 3] += distance
        pose[2, 3] += 0.02
        last["banana_pose"] = pose


def test_a_dataset_is_counted(sample: SampleDataset, summary: Any, tmp_path: Path) -> None:
    report = summary(sample)
    files = [path for path in (tmp_path / "dataset").glob("ep_*/**/*") if path.is_file()]
    assert (report["episodes"], report["frames"]) == (3, 3 * FRAMES)
    assert report["bytes"] == sum(path.stat().st_size for path in files)
    assert report["seconds"] == pytest.approx(3 * (FRAMES - 1) * 0.064)
    assert report["frames_per_episode"] == {"min": FRAMES, "median": FRAMES, "max": FRAMES}
    assert report["cameras"] == {CAMERA: [64, 48]}
    assert (report["tasks"], report["grasps"]) == (["pickplace"], ["weld"])
    assert report["versions"] == [{"numpy": "2.0", "looks": "1", "engine": "1"}]
    assert (report["errors"], report["warnings"], report["problems"]) == (0, 0, [])
    assert report["recorded_by_yamsim"] is True


def test_outcomes_are_scored_by_every_threshold(config: RecordConfig, summary: Any) -> None:
    sample = SampleDataset(config.data_config(), [episode(k) for k in range(4)])
    put(sample, (0.01, 0.06, 0.07, 0.2))
    report = summary(sample, (0.05, 0.065, 0.08))
    assert report["success_rate"] == {"0.05": 0.25, "0.065": 0.5, "0.08": 0.75}
    assert report["wilson95"]["0.065"] == wilson_interval_95(2, 4)
    assert report["dxy_m"]["max"] == pytest.approx(0.2, abs=1e-6)
    assert report["dxy_m"]["median"] == pytest.approx(0.065, abs=1e-6)
    assert sum(report["dxy_m"]["histogram"]["counts"]) == 4
    assert report["dz_m"]["median"] == 0.02


def test_every_episode_is_scored_by_the_height_its_own_task_allows(sample: SampleDataset, summary: Any) -> None:
    sample.episodes[1].over["max_height_m"] = 0.001
    assert summary(sample)["success_rate"]["0.05"] == pytest.approx(2 / 3)


def test_attempts_are_scored_too_and_counted_by_cause(sample: SampleDataset, summary: Any) -> None:
    sample.fail("off_target", dxy=0.06)
    sample.fail("dropped", dxy=0.3)
    sample.fail("off_target", dxy=0.09)
    sample.fail("no_layout", dxy=None)
    attempts = summary(sample)["attempts"]
    assert (attempts["n"], attempts["n_success"]) == (7, 3)
    assert attempts["success_rate"] == pytest.approx(3 / 7)
    assert attempts["wilson95"] == wilson_interval_95(3, 7)
    assert attempts["rates"] == {"0.05": pytest.approx(3 / 7), "0.08": pytest.approx(4 / 7)}
    assert attempts["rates_wilson95"]["0.08"] == wilson_interval_95(4, 7)
    assert next(iter(attempts["causes"])) == "off_target"
    assert attempts["causes"] == {"off_target": 2, "dropped": 1, "no_layout": 1}


def test_the_workspace_is_spanned_by_starts_and_ends(sample: SampleDataset, summary: Any) -> None:
    workspace = summary(sample)["workspace"]
    assert workspace["box"] == {"x": [0.3, 0.55], "y": [-0.18, 0.18], "cell_m": 0.05}
    banana = workspace["objects"]["banana"]
    assert banana["start"]["x"] == pytest.approx([0.32, 0.38])
    assert banana["start"]["y"] == pytest.approx([-0.1, -0.1])
    assert banana["end"]["y"] == pytest.approx([0.06, 0.1])
    assert (banana["start"]["cells"], banana["start"]["cells_hit"], banana["start"]["outside"]) == (40, 2, 0)
    assert list(workspace["objects"]) == ["banana", "plate"]


def test_places_are_in_the_world_where_the_base_is_not(
    config: RecordConfig, sample: SampleDataset, summary: Any
) -> None:
    sample.config["rig"]["arms"][0]["base"] = {"position": [0.0, 0.1, 0.0], "yaw_deg": 0.0}
    banana = summary(sample)["workspace"]["objects"]["banana"]
    assert banana["start"]["y"] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_plain_recording_is_counted_by_what_its_frames_show(sample: SampleDataset, summary: Any) -> None:
    put(sample, (0.01, 0.02, 0.06))
    report = summary(sample, plain=True)
    assert report["recorded_by_yamsim"] is False
    assert report["success_rate"] == {"0.05": pytest.approx(2 / 3), "0.08": 1.0}
    assert report["attempts"]["n"] == 0
    assert report["workspace"]["box"] is None
    assert "cells" not in report["workspace"]["objects"]["banana"]["start"]
    assert (report["errors"], report["warnings"]) == (0, 1)


def test_a_dataset_without_episodes_is_counted_too(sample: SampleDataset, summary: Any) -> None:
    sample.episodes = []
    report = summary(sample)
    assert (report["episodes"], report["bytes"], report["seconds"]) == (0, 0, 0)
    assert report["success_rate"] == {"0.05": None, "0.08": None}
    assert report["wilson95"]["0.05"] == (0.0, 1.0)
    assert (report["dxy_m"], report["bytes_per_episode"], report["workspace"]["objects"]) == (None, None, {})


def test_problems_are_listed_with_all_that_is_known(sample: SampleDataset, summary: Any) -> None:
    sample.episodes[1].over["outcome"] = OUTCOME.model_copy(update={"dxy_m": 0.04})
    report = summary(sample)
    assert report["errors"] == 1
    (problem,) = report["problems"]
    title, value = "the stored outcome contradicts the last frame", "40.0 mm from the target's centre"
    assert problem == {
        "code": "episode.outcome",
        "severity": "error",
        "episode": "ep_000001",
        "file": "episode.json",
        "title": title,
        "problem": f"{title}: {value}; valid: 2.0 mm",
        "value": value,
        "valid": "2.0 mm",
        "count": 1,
        "advice": "leave the episode out of training",
    }
