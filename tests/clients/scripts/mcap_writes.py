"""An MCAP file by Foxglove's writers, with the topics of ABC-130k: `mcap_writes.py MOTION.npz OUT.mcap
libx264|libx265`.

`left`, `right`, `left_told`, `right_told` are (n, 7), `times` (n,) ns, `grey` (m,) the grey levels of the film, one
picture every fourth sample.
"""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap_protobuf.writer import Writer

EVERY = 4
FORMATS = {"libx264": "h264", "libx265": "h265"}


def message(name: str, field: str, kind: int, label: int) -> type:
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package="abc", syntax="proto3")
    file.message_type.add(name=name).field.add(name=field, number=1, type=kind, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"abc.{name}"))


def packets(greys: np.ndarray, encoder: str) -> list[bytes]:
    context = av.CodecContext.create(encoder, "w")
    context.width, context.height, context.pix_fmt = 128, 96, "yuv420p"
    context.time_base = Fraction(1, 25)
    context.options = {"tune": "zerolatency"}
    frames = [av.VideoFrame.from_ndarray(np.full((96, 128, 3), grey, np.uint8), format="rgb24") for grey in greys]
    return [bytes(packet) for frame in [*frames, None] for packet in context.encode(frame)]


def main(motion: str, out: str, encoder: str) -> None:
    kinds = descriptor_pb2.FieldDescriptorProto
    Robot, Gripper = (
        message(name, "position", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED) for name in ("RobotState", "GripperState")
    )
    Instructions = message("Instructions", "data", kinds.TYPE_STRING, kinds.LABEL_OPTIONAL)
    given = np.load(motion)
    times = given["times"].tolist()
    film = packets(given["grey"], encoder)
    with Path(out).open("wb") as file, Writer(file) as writer:
        said = {"publish_time": times[0], "log_time": times[0]}
        writer.write_message("/instruction", Instructions(data="put the banana on the plate"), **said)
        for k, now in enumerate(times):
            said = {"publish_time": now, "log_time": now}
            for side in ("left", "right"):
                for what, rows in (("state", given[side]), ("action", given[f"{side}_told"])):
                    writer.write_message(f"/{side}-arm-{what}", Robot(position=rows[k, :6]), **said)
                    writer.write_message(f"/{side}-ee-{what}", Gripper(position=rows[k, 6:]), **said)
            if k % EVERY == 0:
                video = CompressedVideo(frame_id="top", data=film[k // EVERY], format=FORMATS[encoder])
                writer.write_message("/top-camera", video, **said)
    print(json.dumps({"pictures": len(film)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
