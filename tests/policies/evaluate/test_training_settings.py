"""Trials take image size and quality from the dataset that their policy was trained on, and say where they differ."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli.api import API_SESSION_OPENER
from yamsim_cli.core.attempt_data import Attempt, AttemptJob, Outcome
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.dataset.records import OutcomeRecord
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.evaluate.evaluation import Evaluation
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialResult
from yamsim_cli.policies.evaluate.run import open_evaluation_session, scene_camera_warning
from yamsim_cli.policies.evaluate.training_settings import TrainingSettings, find_training_settings
from yamsim_cli.recorded_settings import describe_recorded_settings

SIZE = (96, 72)


@pytest.fixture
def trained(make_config: Callable[..., RecordConfig], tmp_path: Path, locations: Locations) -> RecordConfig:
    """The config of small and fast pictures, as that of `tmp_path / "demos"`."""
    fast = load_config(RenderConfig, "quality", "fast", locations).model_dump(mode="json")
    config = make_config({("image", "size_px"): list(SIZE), ("render",): fast})
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos/config.yaml").write_text(dump_yaml(config.data_config()))
    return config


def write_export(folder: Path, config: RecordConfig | None) -> None:
    """Write the part of a LeRobot export that says how its pictures were rendered; an older one does not."""
    (folder / "meta").mkdir(parents=True)
    content = {} if config is None else {"recorded": describe_recorded_settings(config)}
    (folder / "meta/yamsim.json").write_text(json.dumps(content))


def test_size_and_quality_are_those_of_the_dataset_unless_given(
    trained: RecordConfig, tmp_path: Path, locations: Locations
) -> None:
    found = find_training_settings("mine.py", Path("demos"), None, locations, tmp_path)
    assert found is not None and found.source == "demos"
    assert found.defaults(None, None) == {"size": [96, 72], "quality": trained.render.model_dump(mode="json")}
    assert found.defaults("640x480", "high") == {"size": "640x480", "quality": "high"}
    assert found.warning(trained) is None


def test_differences_are_named(
    trained: RecordConfig, tmp_path: Path, locations: Locations, make_config: Callable[..., RecordConfig]
) -> None:
    found = find_training_settings("mine.py", tmp_path / "demos", None, locations, Path("/"))
    assert found is not None
    other = make_config({("image", "size_px"): [640, 480], ("grasp",): "contact", ("rig",): "single_linear"})
    assert found.differences(other) == {
        "size": ("640x480", "96x72"),
        "rig": ("single_linear", "single"),
        "grasp": ("contact", "weld"),
        "quality": (other.render.name, "fast"),
    }
    assert found.warning(other) == (
        f"These trials differ from {tmp_path}/demos, on which the policy was trained: size 640x480, in training 96x72; "
        f"rig single_linear, in training single; grasp contact, in training weld; quality {other.render.name}, "
        "in training fast."
    )
    finer = trained.model_copy(update={"render": trained.render.model_copy(update={"shadow_map_px": 0})})
    assert found.differences(finer) == {"quality": ("fast (shadow_map_px differ)", "fast")}


def test_other_meshes_are_a_difference_if_both_sides_state_them(
    trained: RecordConfig, tmp_path: Path, locations: Locations
) -> None:
    reduced, full = {"yam_v1": f"reduced {'a' * 64}"}, {"yam_v1": f"full {'b' * 64}", "mug": f"full {'c' * 64}"}
    recorded = trained.model_copy(update={"meshes": reduced})
    (tmp_path / "demos/config.yaml").write_text(dump_yaml(recorded.data_config()))
    write_export(tmp_path / "demos_lerobot", recorded)
    for name in ("demos", "demos_lerobot"):
        found = find_training_settings("mine.py", Path(name), None, locations, tmp_path)
        assert found is not None
        here = trained.model_copy(update={"meshes": full})
        assert found.differences(here) == {"meshes": ("yam_v1 full bbbbbbbbbbbb", "yam_v1 reduced aaaaaaaaaaaa")}
        # Trials without images, and older recordings, do not state their meshes.
        assert found.differences(trained) == found.differences(recorded) == {}


@pytest.mark.render
def test_only_trials_with_images_compare_their_meshes(trained: RecordConfig, tmp_path: Path) -> None:
    recorded = trained.model_copy(update={"meshes": {"i2rt_yam_crank": f"full {'0' * 64}"}})
    (tmp_path / "demos/config.yaml").write_text(dump_yaml(recorded.data_config()))
    said: list[str] = []
    opener = replace(API_SESSION_OPENER, notify=said.append)
    for policy, warns in (("hold_still", False), ("mine.py:Mine", True)):
        said.clear()
        open_evaluation_session(opener, "default", PolicyChoice(policy, tmp_path), (), tmp_path / "demos")
        assert any("in training i2rt_yam_crank full 000000000000" in text for text in said) == warns


def test_reading_a_camera_that_the_rig_does_not_record_gives_one_line(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    station = make_config({("rig",): "yam_station_linear_4310_d405", ("task",): "set_upright"})
    single = make_config()
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos/config.yaml").write_text(dump_yaml(station.data_config()))
    found = find_training_settings("mine.py", Path("demos"), None, locations, tmp_path)
    assert found is not None and found.cameras == station.rig.camera_names

    def warning(config: RecordConfig, training: TrainingSettings | None, *read: str) -> str | None:
        outcome = OutcomeRecord.from_outcome(Outcome(False))
        trial = TrialResult(Attempt(AttemptJob(0, 0)), outcome, TrialEnd.DONE, read_cameras=frozenset(read))
        done = Evaluation(PolicyChoice("mine.py", tmp_path), (trial,), 1.0, ("",))
        return scene_camera_warning(done, config, training)

    told = "mine.py reads the image 'scene', which recordings of rig 'yam_station_linear_4310_d405' do not have; "
    for training in (None, found):
        text = warning(station, training, SCENE_CAMERA, "top")
        assert text is not None and text.startswith(f"{told}their cameras: {', '.join(station.rig.camera_names)}. ")
        assert warning(station, training, "top") is None
    for cameras in (None, (SCENE_CAMERA, "top")):
        assert warning(station, replace(found, cameras=cameras), SCENE_CAMERA) is None
    assert warning(station.model_copy(update={"cameras": (SCENE_CAMERA,)}), None, SCENE_CAMERA) is None
    assert warning(single, None, SCENE_CAMERA) is None


def test_a_checkpoint_or_a_policy_config_names_the_dataset(
    trained: RecordConfig, tmp_path: Path, locations: Locations
) -> None:
    write_export(tmp_path / "demos_lerobot", trained)
    (tmp_path / "model").mkdir()
    (tmp_path / "model/train_config.json").write_text(json.dumps({"dataset": {"root": "demos_lerobot"}}))
    (tmp_path / "mine.yaml").write_text(
        f"gripper: metres\nactions: {{key: action, hz: 15.625}}\ntrained_on: {tmp_path}/demos\n"
    )

    def find(policy: str, mapping: str | None = None) -> TrainingSettings | None:
        return find_training_settings(policy, None, mapping, locations, tmp_path)

    of_checkpoint, of_config = find("lerobot:model"), find("act://127.0.0.1:9", str(tmp_path / "mine.yaml"))
    assert of_checkpoint is not None and of_config is not None
    assert (of_checkpoint.size_px, of_checkpoint.source) == (SIZE, "demos_lerobot")
    assert of_checkpoint.quality == of_config.quality == trained.render.model_dump(mode="json")
    # Nothing names a dataset, the export is gone, or it is an older one.
    assert find("mine.py") is None
    assert find("lerobot:nowhere") is None
    (tmp_path / "demos_lerobot/meta/yamsim.json").write_text("{}")
    assert find("lerobot:model") is None


def test_what_is_no_dataset_is_refused(tmp_path: Path, locations: Locations) -> None:
    write_export(tmp_path / "old_export", None)
    for name, told in (
        ("nowhere", "--trained-on nowhere: give a dataset of yamsim record: .*nowhere/config.yaml cannot be read"),
        ("old_export", "--trained-on old_export: the export is by an older yamsim"),
    ):
        with pytest.raises(UsageError, match=told):
            find_training_settings("mine.py", Path(name), None, locations, tmp_path)
