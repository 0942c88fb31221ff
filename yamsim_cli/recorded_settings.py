"""Settings of a recording that affect the policies trained on it."""

from __future__ import annotations

from typing import Any

from .core.config.recording import RecordConfig


def describe_recorded_settings(config: RecordConfig) -> dict[str, Any]:
    """Return image size (width, height), px, quality, rig, task, grasp, meshes and cameras of a recording, as JSON.

    `meshes` is as in the config, null if unknown.
    """
    return {
        "cameras": list(config.recorded_cameras),
        "size_px": list(config.image.size_px),
        "quality": config.render.model_dump(mode="json"),
        "rig": config.rig.name,
        "task": config.task.name,
        "grasp": config.grasp,
        "meshes": None if config.meshes is None else dict(sorted(config.meshes.items())),
    }
