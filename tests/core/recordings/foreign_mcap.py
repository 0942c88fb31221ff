"""MCAP files as ABC-130k has them, written by the packages `mcap` and `protobuf`."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from tests.core.recordings.foreign import PROMPT, START_NS, grey_of, shares
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.motion import Motion

FILM_EVERY = 4


def messages() -> dict[str, Any]:
    """Name -> class of a message: `RobotState`, `GripperState`, `Instruction` and a film's `CompressedVideo`."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="recording.proto", package="test", syntax="proto3")
    fields = {
        "RobotState": [("position", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED)],
        "GripperState": [("position", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED)],
        "Instruction": [("text", kinds.TYPE_STRING, kinds.LABEL_OPTIONAL)],
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


def film_packets(frames: int) -> list[bytes]:
    """A film's packets, one a frame."""
    import av

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
    path: Path, motion: Motion, rig: RigConfig, leave_out: Callable[[str, float], bool] = lambda topic, time: False
) -> Path:
    """A motion of two arms, with a film of one camera.

    Args:
        leave_out: whether a topic has no message at a time (s) of the motion.
    """
    from mcap_protobuf.writer import Writer

    kinds = messages()
    measured, told = shares(motion, rig)
    film = film_packets(len(range(0, len(motion.times), FILM_EVERY)))
    with path.open("wb") as file, Writer(file) as writer:

        def say(topic: str, message: Any, k: int) -> None:
            if leave_out(topic, float(motion.times[k])):
                return
            time = START_NS + round(motion.times[k] * 1e9)
            writer.write_message(topic, message, log_time=time, publish_time=time)

        say("/instruction", kinds["Instruction"](text=PROMPT), 0)
        for k in range(len(motion.times)):
            for side, rows, commands in zip(("left", "right"), measured, told, strict=True):
                say(f"/{side}-arm-state", kinds["RobotState"](position=rows[k, :6]), k)
                say(f"/{side}-arm-action", kinds["RobotState"](position=commands[k, :6]), k)
                say(f"/{side}-ee-state", kinds["GripperState"](position=rows[k, 6:]), k)
                say(f"/{side}-ee-action", kinds["GripperState"](position=commands[k, 6:]), k)
            if k % FILM_EVERY == 0:
                video = kinds["CompressedVideo"](data=film[k // FILM_EVERY], format="h264")
                say("/top-camera", video, k)
    return path
