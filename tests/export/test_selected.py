"""Exports obey a selection: dropped episodes are left out, and trimmed frames are cut off."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.export.conftest import frames_of, jpeg
from yamsim_cli.selection import EpisodeDecision, Selection, episode_hash, write_selection


@pytest.fixture
def selection(tmp_path: Path, dataset: Path) -> Path:
    def decide(number: int, **values: object) -> EpisodeDecision:
        return EpisodeDecision(episode=number, sha256=episode_hash(dataset / f"ep_{number:06d}"), **values)

    decisions = {0: decide(0, decision="drop"), 1: decide(1, decision="keep", first_frame=3, last_frame=7)}
    write_selection(tmp_path / "selection.yaml", Selection("dataset", "keep", decisions))
    return tmp_path / "selection.yaml"


def test_lerobot(tmp_path: Path, dataset: Path, selection: Path) -> None:
    pytest.importorskip("pyarrow")
    run = yamsim("export", "lerobot", dataset, tmp_path / "out", "--selection", selection, "--no-pictures", "--json")
    assert run.code == 0, run.err
    assert run.json["frames"] == 5 + frames_of(dataset)[2]
    assert (run.json["selection"]["dropped"], run.json["selection"]["trimmed"]) == (1, 1)
    made = json.loads((tmp_path / "out/meta/yamsim.json").read_text())
    assert [episode["episode"] for episode in made["episodes"]] == ["ep_000001", "ep_000002"]
    assert made["selection"]["sha256"] == run.json["selection"]["sha256"]


def test_raiden_copies_the_kept_frames(tmp_path: Path, dataset: Path, selection: Path) -> None:
    words = ["--fps", "source", "--images", "jpg", "--selection", selection]
    run = yamsim("export", "raiden", dataset, tmp_path / "out", *words)
    assert run.code == 0, run.err
    folders = sorted((tmp_path / "out").glob("*/rgb/scene_camera"))
    pictures = sorted(folders[0].glob("*.jpg"))
    assert [file.read_bytes() for file in pictures] == [jpeg("scene_camera", 1, k) for k in range(3, 8)]


def test_raiden_resamples_the_kept_part(tmp_path: Path, dataset: Path, selection: Path) -> None:
    words = ["--fps", "60", "--pictures", "nearest", "--images", "jpg"]
    for name, more in (("whole", ()), ("kept", ("--selection", selection))):
        run = yamsim("export", "raiden", dataset, tmp_path / name, *words, "--episodes", "1", *more)
        assert run.code == 0, run.err
    whole, kept = (sorted((tmp_path / name).glob("*/rgb/scene_camera"))[0] for name in ("whole", "kept"))
    pictures = [file.read_bytes() for file in sorted(kept.glob("*.jpg"))]
    assert pictures[0] == jpeg("scene_camera", 1, 3)
    assert pictures[-1] == jpeg("scene_camera", 1, 7)
    assert len(pictures) < len(list(whole.glob("*.jpg")))


def test_an_episode_that_is_dropped_cannot_be_exported(tmp_path: Path, dataset: Path, selection: Path) -> None:
    run = yamsim("export", "mp4", dataset, tmp_path / "out", "--selection", selection, "--episodes", "0")
    assert run.code == 2
    assert "keeps none of these" in run.err
