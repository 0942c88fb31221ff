"""Datasets of older format versions are verified, summarized, exported and resumed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.run_cli import yamsim
from tests.older_formats import write_as_format
from tests.unrendered import SIZE, change_record, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.reader import open_episodes
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import NewerFormatError
from yamsim_cli.core.files.resources import Locations

EPISODES = 2


@pytest.fixture(scope="module")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("image", "size_px"): SIZE, ("seed",): 5})


@pytest.fixture(scope="module")
def present(tmp_path_factory: pytest.TempPathFactory, config: RecordConfig, locations: Locations) -> Path:
    path = tmp_path_factory.mktemp("present") / "dataset"
    write_dataset(path, config, locations, EPISODES)
    with DatasetWriter(path, config.data_config(), ExistingDatasetMode.RESUME) as writer:
        writer.write_manifest()
    return path


@pytest.fixture(params=[1, 2])
def dataset(request: pytest.FixtureRequest, present: Path, tmp_path: Path) -> Path:
    return write_as_format(shutil.copytree(present, tmp_path / "dataset"), request.param)


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_only_what_was_written_differs(dataset: Path, present: Path) -> None:
    assert "arms" in json.loads((present / "ep_000000/episode.json").read_text())
    assert not {"arms", "drives"} & set(json.loads((dataset / "ep_000000/episode.json").read_text()))
    assert len((dataset / "config.yaml").read_text()) < len((present / "config.yaml").read_text())


@pytest.mark.slow
def test_it_is_summarized_without_a_fault(dataset: Path, present: Path) -> None:
    found, today = (yamsim("summarize", path, "--json").json for path in (dataset, present))
    changed = {key for key in today if found[key] != today[key]}
    assert changed <= {"path", "versions", "bytes", "bytes_per_episode"}, changed


def test_it_is_verified(dataset: Path) -> None:
    version = json.loads((dataset / "ep_000000/episode.json").read_text())["format_version"]
    report = yamsim("verify", dataset, "--json").json
    assert (report["agree"], report["max_error"], report["problems"]) == (EPISODES, 0.0, [])
    assert report["checks"]["actions"]["agree"] == EPISODES
    assert report["checks"]["seed"]["agree"] == (EPISODES if version == 2 else 0)


def test_a_change_is_still_found(dataset: Path) -> None:
    record = json.loads((dataset / "ep_000001/episode.json").read_text())
    change_record(dataset / "ep_000001", outcome=record["outcome"] | {"dxy_m": record["outcome"]["dxy_m"] + 1e-6})
    run = yamsim("verify", dataset, "--json")
    assert run.code != 0 and run.json["agree"] == EPISODES - 1
    assert {found["quantity"] for found in run.json["divergences"]} == {"outcome.dxy_m"}


@pytest.mark.slow
def test_it_is_exported_as_one_of_today(dataset: Path, present: Path, tmp_path: Path) -> None:
    for name, path in (("older", dataset), ("today", present)):
        run = yamsim("export", "raiden", path, tmp_path / name, "--pictures", "nearest", "--json")
        assert run.code == 0, run.message
    older, today = tree(tmp_path / "older"), tree(tmp_path / "today")
    assert older.keys() == today.keys()
    different = [name for name in today if older[name] != today[name]]
    assert not [name for name in different if not name.endswith(".json")], different


def test_it_is_resumed_and_keeps_its_bytes(dataset: Path, config: RecordConfig, present: Path) -> None:
    before = tree(dataset)
    third = open_episodes(present)[0].record.model_copy(update={"episode": 2, "attempt": 2, "files": {}})
    with DatasetWriter(dataset, config.data_config(), ExistingDatasetMode.RESUME) as writer:
        assert (writer.episodes, writer.repairs) == (EPISODES, [])
        writer.publish_episode(third, {})
        writer.write_manifest()
    after = tree(dataset)
    del before["manifest.json"]
    assert before.items() <= after.items()
    assert json.loads(after["ep_000002/episode.json"])["format_version"] == 4
    assert json.loads(after["manifest.json"])["format_version"] == 4
    assert [episode.record.arms for episode in open_episodes(dataset)] == [1, 1, 1]


def test_another_config_is_no_reason_to_resume(dataset: Path, config: RecordConfig) -> None:
    changed: dict[str, Any] = config.data_config() | {"arm": "left"}
    with pytest.raises(Exception, match="arm: 'right' there, 'left' now"):
        DatasetWriter(dataset, changed, ExistingDatasetMode.RESUME)


def test_an_episode_of_a_later_version_is_refused_and_stays(dataset: Path, config: RecordConfig) -> None:
    change_record(dataset / "ep_000001", format_version=5)
    before = tree(dataset)
    with pytest.raises(NewerFormatError, match=r"ep_000001.*format_version 5 is newer than 4"):
        open_episodes(dataset)[1]
    with pytest.raises(NewerFormatError):
        DatasetWriter(dataset, config.data_config(), ExistingDatasetMode.RESUME)
    assert tree(dataset) == before
    run = yamsim("export", "raiden", dataset, dataset.parent / "out", "--pictures", "nearest")
    assert run.code == 4 and "format_version 5 is newer than 4" in run.message
