"""What is told of an episode beside its frames."""

from __future__ import annotations

from ..config.program_task import ProgramTask
from ..config.recording import RecordConfig
from ..dataset.layout import PROGRAM_FORMAT_VERSION
from ..dataset.records import AttemptRecord, EpisodeRecord, attempt_record, file_hashes
from ..types import EpisodePayload


def episode_record(config: RecordConfig, payload: EpisodePayload, episode: int) -> EpisodeRecord:
    """The `episode.json` of a successful attempt, published as number `episode`."""
    cameras = (name.split("/")[1] for name in payload.files if name.startswith("rgb/"))
    attempt = attempt_record(payload, episode)
    task = config.task
    return EpisodeRecord(
        format_version=PROGRAM_FORMAT_VERSION,
        episode=episode,
        attempt=attempt.attempt,
        seed=attempt.seed,
        source="record",
        rig=config.rig.name,
        scene=config.scene.name,
        task=task.name,
        grasp=config.grasp,
        frames=payload.frames,
        frame_period_s=task.timing.tick * task.timing.ticks_per_frame,
        cameras=dict.fromkeys(cameras, config.image.size_px),
        truth=config.truth,
        arms=len(config.rig.arms),
        drives=config.rig.drives,
        joint_actions=config.action == "joints",
        objects=list(attempt.layout),
        outcome=attempt.outcome,
        max_height_m=None,
        layout=attempt.layout,
        randomized=attempt.randomized,
        cast=attempt.cast,
        phrasing=attempt.phrasing,
        joints=_joints(task, attempt),
        cloths=_cloths(task, attempt),
        versions=dict(payload.versions),
        renderer=payload.renderer,
        meshes=None if config.meshes is None else dict(config.meshes),
        content_sha256=payload.content_sha256,
        files=file_hashes(payload.files),
    )


def _cloths(task: ProgramTask, attempt: AttemptRecord) -> dict[str, tuple[int, int]]:
    """Cloth -> how many points lie along its x axis and along its y axis."""
    cloths = {item.name: item.cloth for item in task.objects}
    kinds = attempt.cast.kinds if attempt.cast else {}
    return {thing: cloth.grid for thing, kind in kinds.items() if (cloth := cloths[kind]) is not None}


def _joints(task: ProgramTask, attempt: AttemptRecord) -> dict[str, tuple[str, ...]]:
    """Articulated thing -> names of its joints."""
    items = {item.name: item for item in task.objects}
    kinds = attempt.cast.kinds if attempt.cast else {}
    return {thing: tuple(link.name for link in items[kind].links) for thing, kind in kinds.items() if items[kind].links}
