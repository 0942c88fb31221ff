"""Recordings as other programs write them, of motions that are known."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow
import pyarrow.parquet

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.motion import Motion

START_NS = 1_760_000_000_123_456_789
PROMPT = "put the banana on the plate"


def shares(motion: Motion, rig: RigConfig) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What was measured of each arm, and what it was told (n, 7), grippers as shares of their opening."""
    measured, told = [], []
    for arm, k in zip(motion.arms, rig.recorded, strict=True):
        fingers = rig.arms[k].robot.fingers
        assert fingers is not None
        assert arm.commands is not None
        assert arm.openings is not None
        assert arm.commanded_openings is not None
        measured.append(np.column_stack([arm.joints, arm.openings / fingers.full_opening]))
        told.append(np.column_stack([arm.commands, arm.commanded_openings / fingers.full_opening]))
    return measured, told


def write_raiden_raw(folder: Path, motion: Motion, rig: RigConfig) -> Path:
    """As raiden's recorder writes it: a key for each array, times in ns."""
    folder.mkdir()
    measured, told = shares(motion, rig)
    arrays: dict[str, Any] = {"timestamps": START_NS + np.round(motion.times * 1e9).astype(np.int64)}
    for name, rows, commands in zip(("follower_l", "follower_r"), measured, told, strict=False):
        arrays |= {
            f"{name}_joint_pos": rows[:, :6],
            f"{name}_gripper_pos": rows[:, 6:],
            f"{name}_joint_pos_7d": rows.astype(np.float32),
            f"{name}_joint_cmd": commands.astype(np.float32),
        }
    np.savez_compressed(folder / "robot_data.npz", **arrays)
    (folder / "metadata.json").write_text(json.dumps({"task_name": "banana", "task_instruction": PROMPT}))
    return folder


def write_lerobot_v2(folder: Path, motion: Motion, rig: RigConfig, names: list[str]) -> Path:
    """Version 2.1: one episode, one camera of 64 x 48 whose grey tells the frame."""
    measured, told = shares(motion, rig)
    rows, commands = np.hstack(measured), np.hstack(told)
    n = len(rows)
    for place in ("data/chunk-000", "videos/chunk-000/observation.images.top", "meta"):
        (folder / place).mkdir(parents=True)
    pyarrow.parquet.write_table(
        pyarrow.table(
            {
                "observation.state": rows.astype(np.float32).tolist(),
                "action": commands.astype(np.float32).tolist(),
                "timestamp": motion.times,
                "episode_index": np.zeros(n, np.int64),
                "task_index": np.zeros(n, np.int64),
            }
        ),
        folder / "data/chunk-000/episode_000000.parquet",
    )
    with av.open(str(folder / "videos/chunk-000/observation.images.top/episode_000000.mp4"), "w") as film:
        stream = film.add_stream("libx264", rate=round(1 / (motion.times[1] - motion.times[0])))
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for k in range(n):
            grey = np.full((48, 64, 3), grey_of(k), np.uint8)
            film.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        film.mux(stream.encode())
    feature = {"dtype": "float32", "shape": [len(names)], "names": names}
    features = {
        "observation.state": feature,
        "action": feature,
        "observation.images.top": {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channels"]},
    }
    info = {
        "codebase_version": "v2.1",
        "robot_type": "bimanual_yam",
        "fps": 1 / (motion.times[1] - motion.times[0]),
        "chunks_size": 1000,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": features,
    }
    (folder / "meta/info.json").write_text(json.dumps(info))
    (folder / "meta/tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": PROMPT}) + "\n")
    (folder / "meta/episodes.jsonl").write_text(json.dumps({"episode_index": 0, "length": n}) + "\n")
    return folder


def write_lowdim(folder: Path, motion: Motion, rig: RigConfig) -> Path:
    """As the lab writes it: a pickle a frame, grippers in metres, and pictures whose grey tells the frame."""
    rows = np.hstack([np.column_stack([arm.joints, arm.openings]) for arm in motion.arms if arm.openings is not None])
    told = [np.column_stack([arm.commands, arm.commanded_openings]) for arm in motion.arms if arm.commands is not None]
    (folder / "lowdim").mkdir(parents=True)
    (folder / "rgb/scene_camera").mkdir(parents=True)
    for k, time in enumerate(motion.times):
        frame = {"joints": rows[k], "timestamp": float(time), "language_prompt": PROMPT}
        if told:
            frame["action_joints"] = np.hstack(told)[k]
        (folder / f"lowdim/{k:06d}.pkl").write_bytes(pickle.dumps(frame))
        picture = cv2.imencode(".jpg", np.full((24, 32, 3), grey_of(k), np.uint8))[1]
        (folder / f"rgb/scene_camera/{k:06d}.jpg").write_bytes(picture.tobytes())
    return folder


def write_lerobot_v3(folder: Path, motion: Motion, rig: RigConfig, names: list[str]) -> Path:
    """Version 3.0: what version 2.1 has, and in which files it lies."""
    write_lerobot_v2(folder, motion, rig, names)
    film = folder / "videos/observation.images.top/chunk-000"
    film.mkdir(parents=True)
    (folder / "videos/chunk-000/observation.images.top/episode_000000.mp4").rename(film / "file-000.mp4")
    (folder / "data/chunk-000/episode_000000.parquet").rename(folder / "data/chunk-000/file-000.parquet")
    info = json.loads((folder / "meta/info.json").read_text())
    info |= {
        "codebase_version": "v3.0",
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    (folder / "meta/info.json").write_text(json.dumps(info))
    (folder / "meta/episodes.jsonl").unlink()
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    row = {
        "episode_index": [0],
        "length": [len(motion.times)],
        "videos/observation.images.top/chunk_index": [0],
        "videos/observation.images.top/file_index": [0],
        "videos/observation.images.top/from_timestamp": [0.0],
    }
    pyarrow.parquet.write_table(pyarrow.table(row), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


def grey_of(frame: int) -> int:
    """Which grey frame k of a film has."""
    return 20 + 2 * (frame % 100)
