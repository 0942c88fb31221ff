"""Size, quality and meshes of the images that a policy was trained on, and how its trials differ from them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.mesh_provenance import ShownMeshes, describe_mesh_content
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.reader import read_recording_config
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.recorded_settings import describe_recorded_settings

from .. import lerobot

_TRAIN_CONFIG = "train_config.json"  # written by LeRobot beside a checkpoint's weights; `dataset.root` is the export
_EXPORT_PROVENANCE = "meta/yamsim.json"  # written by `export lerobot`; its key `recorded` has the dataset's settings


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of the recording that a policy was trained on.

    Attributes:
        source: the dataset or export, as in messages.
        size_px: width and height.
        quality: values of the rendering quality, as in the key `render` of a recording's `config.yaml`.
        names: the names of the rig, the task and the grasp.
        meshes: asset set -> description of the shown meshes; empty if unknown.
        cameras: names of the recorded cameras; None if unknown.
    """

    source: str
    size_px: tuple[int, int]
    quality: Mapping[str, Any]
    names: Mapping[str, str]
    meshes: ShownMeshes = field(default_factory=dict)
    cameras: tuple[str, ...] | None = None

    def defaults(self, size: Any, quality: str | None) -> dict[str, Any]:
        """Return `size` and `quality` for a session: the given values, or the values of the training dataset."""
        return {
            "size": list(self.size_px) if size is None else size,
            "quality": dict(self.quality) if quality is None else quality,
        }

    def differences(self, config: RecordConfig) -> dict[str, tuple[str, str]]:
        """Return name of a setting -> its value in trials of `config`, and in training; only unequal ones.

        Meshes are compared if both sides state them, for the asset sets that both show.
        """
        here = describe_recorded_settings(config)
        pairs = {
            "size": (f"{here['size_px'][0]}x{here['size_px'][1]}", f"{self.size_px[0]}x{self.size_px[1]}"),
            **{key: (here[key], self.names[key]) for key in self.names},
        }
        if here["quality"] != dict(self.quality):
            names = str(here["quality"]["name"]), str(self.quality["name"])
            changed = [key for key, value in here["quality"].items() if self.quality.get(key) != value]
            text = f" ({', '.join(changed)} differ)" if names[0] == names[1] else ""
            pairs["quality"] = (names[0] + text, names[1])
        shown = config.meshes or {}
        if changed := [name for name in sorted(self.meshes) if shown.get(name, self.meshes[name]) != self.meshes[name]]:
            pairs["meshes"] = _describe_meshes(shown, changed), _describe_meshes(self.meshes, changed)
        return {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}

    def warning(self, config: RecordConfig) -> str | None:
        """Return a sentence about the differences between trials and training; None if there are none."""
        found = self.differences(config)
        if not found:
            return None
        text = "; ".join(f"{key} {here}, in training {there}" for key, (here, there) in found.items())
        return f"These trials differ from {self.source}, on which the policy was trained: {text}."


def find_training_settings(
    policy: str, trained_on: Path | None, policy_config: str | None, locations: Locations, folder: Path
) -> TrainingSettings | None:
    """Return the settings of the dataset that a policy was trained on; None if nothing names the dataset.

    The dataset is `trained_on`, or else `trained_on` of the policy's config, or else a LeRobot checkpoint's dataset.
    Relative paths are in `folder`.

    Raises:
        UsageError: the named dataset is missing or is no recording of yamsim.
    """
    if trained_on is None and policy_config is not None:
        named = load_config(PolicyConfig, "policies", policy_config, locations).trained_on
        trained_on = Path(named) if named else None
    if trained_on is not None:
        return _read_settings(trained_on, folder, locations)
    scheme, _, rest = policy.partition(":")
    return _read_checkpoint_settings(folder / rest, folder) if scheme == lerobot.SCHEME else None


def _read_settings(dataset: Path, folder: Path, locations: Locations) -> TrainingSettings:
    if (folder / dataset / _EXPORT_PROVENANCE).is_file():
        found = _read_export_settings(folder / dataset, str(dataset))
        if found is None:
            raise UsageError(
                f"--trained-on {dataset}: the export is by an older yamsim, and does not say how its images were "
                "rendered; give the dataset of yamsim record, or export it again"
            )
        return found
    try:
        config = read_recording_config(folder / dataset, locations)
    except DatasetError as error:
        raise UsageError(f"--trained-on {dataset}: give a dataset of yamsim record: {error}") from error
    return _settings_from_json(describe_recorded_settings(config), str(dataset))


def _read_checkpoint_settings(checkpoint: Path, folder: Path) -> TrainingSettings | None:
    # The training's export may be on another machine; then the checkpoint does not state how images were rendered.
    try:
        root = json.loads((checkpoint / _TRAIN_CONFIG).read_bytes())["dataset"]["root"]
        return _read_export_settings(folder / root, str(root)) if isinstance(root, str) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _read_export_settings(export: Path, name: str) -> TrainingSettings | None:
    try:
        return _settings_from_json(json.loads((export / _EXPORT_PROVENANCE).read_bytes())["recorded"], name)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _settings_from_json(data: Mapping[str, Any], source: str) -> TrainingSettings:
    width, height = data["size_px"]
    names = {key: str(data[key]) for key in ("rig", "task", "grasp")}
    meshes = {str(name): str(text) for name, text in (data.get("meshes") or {}).items()}
    cameras = tuple(str(name) for name in data["cameras"]) if "cameras" in data else None
    return TrainingSettings(source, (int(width), int(height)), dict(data["quality"]), names, meshes, cameras)


def _describe_meshes(meshes: ShownMeshes, names: Sequence[str]) -> str:
    return ", ".join(f"{name} {describe_mesh_content(meshes[name])}" for name in names)
