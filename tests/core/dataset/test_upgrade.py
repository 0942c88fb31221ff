"""Records and configs of format versions 1 to 3, as yamsim wrote them, are read in the form of the present version."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from yamsim_cli.core.attempt_data import ObjectLayout
from yamsim_cli.core.config.variation import RandomizationSample
from yamsim_cli.core.dataset.dataset_paths import FORMAT_VERSION
from yamsim_cli.core.dataset.imported_records import RealEpisodeRecord, read_imported_config
from yamsim_cli.core.dataset.reader import open_episode, open_recorded_episode, read_recording_config
from yamsim_cli.core.dataset.records import AttemptRecord, EpisodeRecord, Manifest, from_json, record_data, to_json
from yamsim_cli.core.dataset.upgrade import upgrade_attempt, upgrade_config, upgrade_episode
from yamsim_cli.core.dataset.writing.directory_claim import require_same_config
from yamsim_cli.core.errors import ConfigError, DatasetError, NewerFormatError
from yamsim_cli.core.files.documents.yaml_document import load_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import yaw

SAMPLES = Path(__file__).parents[2] / "data" / "older_formats"


def sample(version: int) -> Path:
    return SAMPLES / f"format_{version}"


def stored(version: int) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((sample(version) / "ep_000000" / "episode.json").read_text())
    return data


@pytest.mark.parametrize("version", [1, 2, 3])
def test_the_samples_are_of_older_versions_and_are_read_as_the_present_one(version: int) -> None:
    assert stored(version)["format_version"] == version
    record = open_recorded_episode(sample(version) / "ep_000000").record
    assert isinstance(record, RealEpisodeRecord if version == 3 else EpisodeRecord)
    assert record.format_version == FORMAT_VERSION == 4
    # Only episodes of `yamsim correct` have the key `correction`.
    assert set(record_data(record)) == set(type(record).model_fields) - {"correction"}
    given = {
        key: value for key, value in stored(version).items() if key not in ("format_version", "layout", "versions")
    }
    written = json.loads(to_json(record))
    for key, value in given.items():
        assert value.items() <= written[key].items() if isinstance(value, dict) else value == written[key]


def test_version_1_left_out_what_it_did_not_know() -> None:
    record = open_episode(sample(1) / "ep_000000").record
    assert (record.arms, record.drives, record.joint_actions, record.truth) == (1, 7, False, False)
    assert (record.cast, record.phrasing, record.joints, record.cloths) == (None, "", {}, {})
    without = {key: value for key, value in stored(1).items() if key != "meshes"}
    assert from_json(EpisodeRecord, json.dumps(without), "x").meshes is None
    assert (record.outcome.measures, record.outcome.recoveries, record.randomized) == ((), (), RandomizationSample())
    assert (record.versions["engine"], record.versions["looks"]) == ("1", "1")
    assert record.max_height_m == 0.1


def test_upright_poses_of_version_1_become_full_poses() -> None:
    record = open_episode(sample(1) / "ep_000000").record
    layout = ObjectLayout.from_places(record.layout)
    for name, (x, y, z, turn) in stored(1)["layout"].items():
        T = layout.T_in_world[name]
        assert tuple(T[:3, 3]) == (x, y, z)
        assert T[2, 2] == pytest.approx(1.0)
        assert math.remainder(yaw(T) - turn, math.tau) == pytest.approx(0.0, abs=1e-12)


def test_what_a_record_states_is_kept() -> None:
    record = open_episode(sample(2) / "ep_000000").record
    assert (record.versions["engine"], record.versions["looks"]) == ("3", "2")
    assert record.cast is not None and record.cast.things == {"object": ("banana",), "target": ("plate",)}
    assert record.cast.sizes == {} and len(record.outcome.measures) == 1
    assert list(record.layout["banana"]) == stored(2)["layout"]["banana"]


@pytest.mark.parametrize("version", [1, 2])
def test_a_ledger_line_equals_its_episode(version: int) -> None:
    line = from_json(AttemptRecord, (sample(version) / "attempts.jsonl").read_bytes(), "line 1")
    record = open_episode(sample(version) / "ep_000000").record
    for key in AttemptRecord.model_fields:
        assert getattr(line, key) == getattr(record, key)
    manifest = from_json(Manifest, (sample(version) / "manifest.json").read_bytes(), "manifest")
    assert (manifest.format_version, manifest.frames) == (FORMAT_VERSION, record.frames)


def test_an_upgrade_changes_no_present_record_and_not_its_argument() -> None:
    record = json.loads(to_json(open_episode(sample(1) / "ep_000000").record))
    assert upgrade_episode(record) == record
    line = json.loads((sample(1) / "attempts.jsonl").read_text())
    before = json.dumps(line)
    upgraded = upgrade_attempt(line)
    assert json.dumps(line) == before and upgrade_attempt(upgraded) == upgraded


@pytest.mark.parametrize(
    "change", [{"outcome": 1}, {"layout": {"banana": "here"}}, {"layout": []}, {"versions": []}, {"cast": 3}]
)
def test_a_damaged_older_record_is_a_dataset_error(change: dict[str, Any]) -> None:
    with pytest.raises(DatasetError, match=f"^x: {next(iter(change))}"):
        from_json(EpisodeRecord, json.dumps(stored(1) | change), "x")


@pytest.mark.parametrize("model", [EpisodeRecord, RealEpisodeRecord, Manifest])
def test_a_later_version_is_refused_in_one_line(model: Any) -> None:
    with pytest.raises(NewerFormatError) as caught:
        from_json(model, json.dumps({"format_version": 5}), "here")
    assert str(caught.value).startswith("here: format_version 5 is newer than 4, ")
    assert "\n" not in str(caught.value) and caught.value.exit_code == DatasetError.exit_code


def test_configs_of_older_versions_are_read(locations: Locations) -> None:
    older = read_recording_config(sample(1), locations)
    assert [item.name for item in older.task.objects] == ["banana", "plate"]
    assert (older.arm, older.action, older.task.kind) == ("right", "drives", "program")
    assert read_imported_config(sample(3), locations).rig.name == "single"


def test_a_config_with_defaults_left_out_is_the_same_as_with_all_values(locations: Locations) -> None:
    left_out = load_yaml(sample(2) / "config.yaml").data
    explicit = read_recording_config(sample(2), locations).data_config()
    assert "arm" not in left_out and explicit["arm"] == "right"
    require_same_config(sample(2), upgrade_config(left_out), explicit)
    with pytest.raises(ConfigError, match=r"push_out_s: None there, 0\.02 now"):
        require_same_config(sample(2), left_out, explicit)
    left = explicit | {"arm": "left"}
    with pytest.raises(ConfigError, match="arm: 'right' there, 'left' now"):
        require_same_config(sample(2), upgrade_config(left_out), left)
