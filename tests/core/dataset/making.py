"""Hand-made episodes and frames of the right shape, for a small real dataset."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from yamsim_cli.core.dataset.dataset_paths import image_path, lowdim_path
from yamsim_cli.core.dataset.lowdim import content_hash, dump_frame, make_frame
from yamsim_cli.core.dataset.records import AttemptRecord, EpisodeRecord, OutcomeRecord, file_hashes
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter

CAMERA = "scene_camera"
CONFIG = {"task": {"name": "pickplace", "success": {"threshold": 0.05}}, "seed": 7, "arms": [{"name": "arm1"}]}
FRAMES = 4
SUCCESS = OutcomeRecord(
    success=True, cause=None, detail="", dxy_m=0.02, dz_m=0.01, speed_mps=0.0, plan_error_m=0.0001, tilt_rad=0.01
)
FAILURE = SUCCESS.model_copy(update={"success": False, "cause": "off_target", "detail": "0.2 m off", "dxy_m": 0.2})


def jpeg(width: int = 16, height: int = 12, seed: int = 0) -> bytes:
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    done, data = cv2.imencode(".jpg", image)
    assert done
    return data.tobytes()


def frame(k: int = 0, seed: int = 0) -> dict:
    rng = np.random.default_rng([seed, k])
    return make_frame(
        joints=rng.normal(size=(1, 7)),
        timestamp=k * 0.064,
        intrinsics={CAMERA: rng.normal(size=(3, 3))},
        extrinsics={CAMERA: np.eye(4)},
        object_poses={"banana": rng.normal(size=(4, 4)), "plate": np.eye(4)},
        ee_pose=np.eye(4)[None],
        ctrl=rng.normal(size=(1, 7)),
        action_joints=rng.normal(size=(1, 7)),
        magnet=np.array([k == 2]),
        language_task="pick_place_banana",
        language_prompt="pick up the banana",
    )


@dataclass(frozen=True)
class HandmadeEpisode:
    """An episode ready to be published."""

    record: EpisodeRecord
    files: dict[str, bytes]

    @property
    def attempt(self) -> AttemptRecord:
        record = self.record
        return AttemptRecord(
            attempt=record.attempt,
            seed=record.seed,
            episode=record.episode,
            outcome=record.outcome,
            layout=record.layout,
        )


def made(
    episode: int, attempt: int | None = None, frames: list[dict] | None = None, outcome: OutcomeRecord = SUCCESS
) -> HandmadeEpisode:
    frames = [frame(k, episode) for k in range(FRAMES)] if frames is None else frames
    files = {lowdim_path(k): dump_frame(data) for k, data in enumerate(frames)}
    files |= {image_path(CAMERA, k): jpeg(seed=10 * episode + k) for k in range(len(frames))}
    record = EpisodeRecord(
        episode=episode,
        attempt=episode if attempt is None else attempt,
        seed=7,
        source="simulation",
        rig="single",
        scene="tabletop",
        task="pickplace",
        grasp="weld",
        frames=len(frames),
        frame_period_s=0.064,
        cameras={CAMERA: (16, 12)},
        objects=["banana", "plate"],
        outcome=outcome,
        max_height_m=0.1,
        layout={
            "banana": (0.3 + 0.01 * episode, 0.1, 0.02, 1.0, 0.0, 0.0, 0.0),
            "plate": (0.5, -0.1, 0.0, 0.6, 0.0, 0.0, 0.8),
        },
        versions={"numpy": "2.0", "looks": "1", "engine": "1"},
        renderer="none",
        content_sha256=content_hash(frames),
        files=file_hashes(files),
    )
    return HandmadeEpisode(record, files)


def tree(folder: Path) -> dict[str, bytes]:
    """Path below `folder` -> content, of all files."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def publish(writer: DatasetWriter, episode: HandmadeEpisode) -> None:
    writer.publish_episode(episode.record, episode.files)
    writer.log_attempt(episode.attempt)


def failed_attempt(attempt: int) -> AttemptRecord:
    return AttemptRecord(attempt=attempt, seed=7, episode=None, outcome=FAILURE, layout={})


def write_dataset(path: Path, *episodes: HandmadeEpisode) -> Path:
    """Writes a dataset of these episodes, three by default."""
    with DatasetWriter(path, CONFIG, ExistingDatasetMode.NEW) as writer:
        for episode in episodes or [made(k) for k in range(3)]:
            publish(writer, episode)
        writer.write_manifest()
    return path
