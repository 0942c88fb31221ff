"""A small dataset as `yamsim record` writes it, which tests change before it is written, or damage afterwards."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from yamsim_cli.core.attempt_data import FullPose
from yamsim_cli.core.dataset.checks.context import find_episodes, read_context
from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.dataset.dataset_paths import episode_name, image_path, lowdim_path
from yamsim_cli.core.dataset.lowdim import content_hash, dump_frame, make_frame
from yamsim_cli.core.dataset.records import (
    AttemptRecord,
    EpisodeRecord,
    Manifest,
    ManifestEntry,
    OutcomeRecord,
    file_hashes,
    to_json,
)
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.core.geometry.camera import Intrinsics
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.images.jpeg import JpegReader
from yamsim_cli.datasets.check_summary import CheckResults, combine_checks
from yamsim_cli.datasets.checks.episode import check_episode

CAMERA = "scene_camera"
WIDTH, HEIGHT = 64, 48
FRAMES = 6
PERIOD = 0.064
# As in the recorded scene: a metre in front of the base, looking back and down at the table.
T_CAM_IN_BASE = np.array(
    [[0, 0.73593104, -0.67705655, 1.05], [1, 0, 0, 0], [0, -0.67705655, -0.73593104, 0.85], [0, 0, 0, 1]]
)
START_JOINTS = np.array([0, 1.92, 2.22, -1.55, 0, 0, 0.037])
OUTCOME = OutcomeRecord(
    success=True, cause=None, detail="", dxy_m=0.0, dz_m=0.02, speed_mps=0.0, plan_error_m=1e-4, tilt_rad=0.01
)


def encode(image: np.ndarray) -> bytes:
    done, data = cv2.imencode(".jpg", image)
    assert done
    return bytes(data.tobytes())


def picture(k: int, seed: int = 0, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """Coarse colours with a bright square that moves with k."""
    rng = np.random.default_rng(seed)
    image = cv2.resize(rng.integers(40, 200, (6, 8, 3), dtype=np.uint8), size, interpolation=cv2.INTER_NEAREST)
    image[10:20, 4 * k : 4 * k + 10] = 255
    return encode(image)


def black(noise: float = 0.0, level: float = 0.0) -> bytes:
    """An image of one brightness, with noise."""
    rng = np.random.default_rng(0)
    return encode(np.clip(rng.normal(level, noise, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8))


@dataclass
class Episode:
    """An episode before it is written. `over` changes its record; `others` are files beside its frames."""

    number: int
    attempt: int
    frames: list[dict[str, Any]]
    images: dict[str, list[bytes]]
    layout: dict[str, FullPose]
    over: dict[str, Any] = field(default_factory=dict)
    others: dict[str, bytes] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, bytes]:
        files = {lowdim_path(k): dump_frame(frame) for k, frame in enumerate(self.frames)}
        files |= {image_path(c, k): data for c, images in self.images.items() for k, data in enumerate(images)}
        return files | self.others

    @property
    def record(self) -> EpisodeRecord:
        carried, target = self.frames[-1]["banana_pose"], self.frames[-1]["plate_pose"]
        dxy = float(np.hypot(*(carried[:2, 3] - target[:2, 3])))
        values: dict[str, Any] = {
            "episode": self.number,
            "attempt": self.attempt,
            "seed": 7,
            "source": "record",
            "rig": "single",
            "scene": "tabletop",
            "task": "pickplace",
            "grasp": "weld",
            "frames": len(self.frames),
            "frame_period_s": PERIOD,
            "cameras": dict.fromkeys(self.images, (WIDTH, HEIGHT)),
            "objects": ["banana", "plate"],
            "outcome": OUTCOME.model_copy(update={"dxy_m": dxy}),
            "max_height_m": 0.1,
            "layout": self.layout,
            "versions": {"numpy": "2.0", "looks": "1", "engine": "1"},
            "renderer": "none",
            "content_sha256": content_hash(self.frames),
            "files": file_hashes(self.files),
        }
        return EpisodeRecord(**(values | self.over))


def episode(number: int, frames: int = FRAMES) -> Episode:
    """A valid episode, different for each number: the banana goes to the plate while the arm moves."""
    start = np.array([0.32 + 0.03 * number, -0.1, 0.02])
    plate = np.array([0.45, 0.1 - 0.02 * number, 0.0])
    data = []
    for k in range(frames):
        part = k / max(1, frames - 1)
        banana = start * (1 - part) + (plate + np.array([0.002, 0, 0.02])) * part
        data.append(
            make_frame(
                joints=START_JOINTS + (0.05 * k + 0.01 * number) * np.array([[1, -1, -1, 1, 0.2, 1, -0.02]]),
                timestamp=k * PERIOD,
                intrinsics={CAMERA: Intrinsics.from_fovy(WIDTH, HEIGHT, 0.9).K},
                extrinsics={CAMERA: T_CAM_IN_BASE},
                object_poses={"banana": pose(banana), "plate": pose(plate)},
                ee_pose=pose(banana + np.array([0, 0, 0.1]))[None],
                ctrl=np.array([START_JOINTS]),
                action_joints=np.array([START_JOINTS]),
                magnet=np.array([0 < k < frames - 1]),
                language_task="pick_place_banana",
                language_prompt="pick up the banana",
            )
        )
    return Episode(
        number,
        number,
        data,
        {CAMERA: [picture(k, number) for k in range(frames)]},
        {name: (*map(float, place), 1.0, 0.0, 0.0, 0.0) for name, place in (("banana", start), ("plate", plate))},
    )


@dataclass
class SampleDataset:
    """A dataset before it is written: its episodes, and failed attempts."""

    config: dict[str, Any]
    episodes: list[Episode]
    failures: list[AttemptRecord] = field(default_factory=list)

    def fail(self, cause: str, dxy: float | None = 0.2, layout: dict[str, Any] | None = None) -> None:
        """Add a failed attempt at the end."""
        outcome = OUTCOME.model_copy(update={"success": False, "cause": cause, "dxy_m": dxy})
        number = len(self.episodes) + len(self.failures)
        self.failures.append(AttemptRecord(attempt=number, seed=7, episode=None, outcome=outcome, layout=layout or {}))

    def write(self, path: Path) -> Path:
        """Write everything as the recorder does."""
        path.mkdir()
        (path / "config.yaml").write_text(dump_yaml(self.config))
        entries, attempts = [], list(self.failures)
        for made in self.episodes:
            record, folder = made.record, path / episode_name(made.number)
            for name, data in {**made.files, "episode.json": to_json(record)}.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(data)
            text = to_json(record)
            entries.append(
                ManifestEntry(
                    episode=made.number,
                    path=folder.name,
                    attempt=made.attempt,
                    frames=record.frames,
                    bytes=sum(map(len, made.files.values())) + len(text),
                    sha256=sha256_bytes(text),
                )
            )
            attempts.append(
                AttemptRecord(
                    attempt=made.attempt,
                    seed=record.seed,
                    episode=made.number,
                    outcome=record.outcome,
                    layout=record.layout,
                )
            )
        attempts.sort(key=lambda attempt: attempt.attempt)
        (path / "attempts.jsonl").write_bytes(b"".join(map(to_json, attempts)))
        manifest = Manifest(
            task="pickplace",
            seed=7,
            attempts=len(attempts),
            frames=sum(entry.frames for entry in entries),
            bytes=sum(entry.bytes for entry in entries),
            episodes=entries,
        )
        (path / "manifest.json").write_bytes(to_json(manifest, indent=1))
        return path

    def write_plain(self, path: Path, change: Callable[[dict[str, Any]], dict[str, Any]] = dict) -> Path:
        """Write rgb/ and lowdim/ alone, as a lab's own recorder does: in directories `0`, `1` ..."""
        for made in self.episodes:
            for name, data in made.files.items():
                file = path / str(made.number) / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(data)
            for k, frame in enumerate(made.frames):
                (path / str(made.number) / lowdim_path(k)).write_bytes(pickle.dumps(change(frame)))
        return path


def look(path: Path, locations: Locations) -> CheckResults:
    """Return the findings of `yamsim summarize`, in this process."""
    directories, recorded = find_episodes(path)
    problems = ProblemCollector()
    context = read_context(path, recorded, locations, problems)
    with JpegReader() as reader:
        facts = [check_episode(directory, context, reader) for directory in directories]
    found = combine_checks(path, context, facts, problems)
    json.dumps([problem.to_json_data() for problem in found.problems], allow_nan=False)
    for problem in found.problems:
        assert "\n" not in problem.text
    return found
