"""Recordings of known motions as other programs write them."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow
import pyarrow.parquet

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.recorded_motion import RecordedMotion

START_NS = 1_760_000_000_123_456_789
PROMPT = "put the banana on the plate"
NAMES = [f"{side}_{what}" for side in ("left", "right") for what in (*[f"joint_{k}" for k in range(1, 7)], "gripper")]
FILM_EVERY = 4  # samples of an MCAP file for each image


def shares(motion: RecordedMotion, rig: RigConfig) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Measurements and commands of each arm (n, 7), grippers as shares of their opening."""
    measured, commanded = [], []
    for arm, k in zip(motion.arms, rig.recording_order, strict=True):
        fingers = rig.arms[k].robot.fingers
        assert fingers is not None and arm.commands is not None
        assert arm.openings is not None and arm.commanded_openings is not None
        measured.append(np.column_stack([arm.joints, arm.openings / fingers.full_opening]))
        commanded.append(np.column_stack([arm.commands, arm.commanded_openings / fingers.full_opening]))
    return measured, commanded


def write_raiden_raw(folder: Path, motion: RecordedMotion, rig: RigConfig) -> Path:
    """As raiden's recorder writes it: a key for each array, times in ns."""
    folder.mkdir()
    measured, commanded = shares(motion, rig)
    arrays: dict[str, Any] = {"timestamps": START_NS + np.round(motion.times * 1e9).astype(np.int64)}
    for name, rows, commands in zip(("follower_l", "follower_r"), measured, commanded, strict=False):
        arrays |= {
            f"{name}_joint_pos": rows[:, :6],
            f"{name}_gripper_pos": rows[:, 6:],
            f"{name}_joint_pos_7d": rows.astype(np.float32),
            f"{name}_joint_cmd": commands.astype(np.float32),
        }
    np.savez_compressed(folder / "robot_data.npz", **arrays)
    (folder / "metadata.json").write_text(json.dumps({"task_name": "banana", "task_instruction": PROMPT}))
    return folder


def write_lerobot_v2(folder: Path, motion: RecordedMotion, rig: RigConfig, names: Sequence[str] = NAMES) -> Path:
    """Version 2.1: one episode, one camera of 64 x 48 whose grey level is the frame's number."""
    measured, commanded = shares(motion, rig)
    rows, commands = np.hstack(measured), np.hstack(commanded)
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
    feature = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
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


def write_lowdim(folder: Path, motion: RecordedMotion, rig: RigConfig) -> Path:
    """As the lab writes it: a pickle per frame, grippers in metres, pictures whose grey level is the frame's number."""
    rows = np.hstack([np.column_stack([arm.joints, arm.openings]) for arm in motion.arms if arm.openings is not None])
    commanded = [
        np.column_stack([arm.commands, arm.commanded_openings]) for arm in motion.arms if arm.commands is not None
    ]
    (folder / "lowdim").mkdir(parents=True)
    (folder / "rgb/scene_camera").mkdir(parents=True)
    for k, time in enumerate(motion.times):
        frame = {"joints": rows[k], "timestamp": float(time), "language_prompt": PROMPT}
        if commanded:
            frame["action_joints"] = np.hstack(commanded)[k]
        (folder / f"lowdim/{k:06d}.pkl").write_bytes(pickle.dumps(frame))
        picture = cv2.imencode(".jpg", np.full((24, 32, 3), grey_of(k), np.uint8))[1]
        (folder / f"rgb/scene_camera/{k:06d}.jpg").write_bytes(picture.tobytes())
    return folder


def write_lerobot_v3(folder: Path, motion: RecordedMotion, rig: RigConfig, names: Sequence[str] = NAMES) -> Path:
    """Version 3.0: the same in other files, which `meta/episodes` lists."""
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
    """Grey level of frame k of a video."""
    return 20 + 2 * (frame % 100)


def _messages() -> dict[str, Any]:
    """Message name -> class: `RobotState`, `GripperState`, `Instructions` and `CompressedVideo`."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="recording.proto", package="test", syntax="proto3")
    fields = {
        "RobotState": [("position", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED)],
        "GripperState": [("position", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED)],
        "Instructions": [("data", kinds.TYPE_STRING, kinds.LABEL_OPTIONAL)],
        "CompressedVideo": [
            ("data", kinds.TYPE_BYTES, kinds.LABEL_OPTIONAL),
            ("format", kinds.TYPE_STRING, kinds.LABEL_OPTIONAL),
        ],
    }
    for name, members in fields.items():
        message = file.message_type.add(name=name)
        for number, (field, kind, label) in enumerate(members, start=1):
            message.field.add(name=field, number=number, type=kind, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"test.{name}")) for name in fields}


def _film_packets(frames: int) -> list[bytes]:
    """Packets of a video, one per frame."""
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.time_base = Fraction(1, 25)
    encoder.options = {"tune": "zerolatency"}
    packets = []
    for k in range(frames):
        grey = np.full((48, 64, 3), grey_of(k), np.uint8)
        packets += [bytes(packet) for packet in encoder.encode(av.VideoFrame.from_ndarray(grey, format="rgb24"))]
    return [*packets, *(bytes(packet) for packet in encoder.encode(None))]


def write_mcap(
    path: Path,
    motion: RecordedMotion,
    rig: RigConfig,
    leave_out: Callable[[str, float], bool] = lambda topic, time: False,
) -> Path:
    """Write a motion of two arms, with a video of one camera.

    Args:
        leave_out: whether a topic has no message at a time (s) of the motion.
    """
    from mcap_protobuf.writer import Writer

    kinds = _messages()
    measured, commanded = shares(motion, rig)
    film = _film_packets(len(range(0, len(motion.times), FILM_EVERY)))
    with path.open("wb") as file, Writer(file) as writer:

        def say(topic: str, message: Any, k: int) -> None:
            if leave_out(topic, float(motion.times[k])):
                return
            time = START_NS + round(motion.times[k] * 1e9)
            writer.write_message(topic, message, log_time=time, publish_time=time)

        say("/instruction", kinds["Instructions"](data=PROMPT), 0)
        for k in range(len(motion.times)):
            for side, rows, commands in zip(("left", "right"), measured, commanded, strict=True):
                say(f"/{side}-arm-state", kinds["RobotState"](position=rows[k, :6]), k)
                say(f"/{side}-arm-action", kinds["RobotState"](position=commands[k, :6]), k)
                say(f"/{side}-ee-state", kinds["GripperState"](position=rows[k, 6:]), k)
                say(f"/{side}-ee-action", kinds["GripperState"](position=commands[k, 6:]), k)
            if k % FILM_EVERY == 0:
                video = kinds["CompressedVideo"](data=film[k // FILM_EVERY], format="h264")
                say("/top-camera", video, k)
    return path
