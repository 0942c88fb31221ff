"""Protobuf messages of ABC's release episodes.

Source of names and field numbers: i2rt-robotics/yam-abc-reproduce 7d9f9d1, `abc_schemas.binpb`; Foxglove's schema
`foxglove.CompressedVideo`.
"""

from __future__ import annotations

import functools
from typing import Any

ROBOT_STATE, GRIPPER_STATE = "RobotState", "GripperState"
INSTRUCTIONS = "Instructions"
COMPRESSED_VIDEO = "foxglove.CompressedVideo"

_STAMP = "timestamp"  # field of every message
_TIMESTAMP_FILE = "google/protobuf/timestamp.proto"
_NUMBERS = ("position", "velocity", "acceleration", "torque")
# Message -> its fields in the order of their numbers: 2, 3 and so on.
_FIELDS: dict[str, tuple[tuple[str, str, bool], ...]] = {
    ROBOT_STATE: tuple((name, "DOUBLE", True) for name in (*_NUMBERS, "pose")),
    GRIPPER_STATE: tuple((name, "DOUBLE", True) for name in _NUMBERS),
    INSTRUCTIONS: (("data", "STRING", False),),
    COMPRESSED_VIDEO: (("frame_id", "STRING", False), ("data", "BYTES", False), ("format", "STRING", False)),
}
_FILES = {
    "robot.proto": (ROBOT_STATE, GRIPPER_STATE),
    "task.proto": (INSTRUCTIONS,),
    "foxglove/CompressedVideo.proto": (COMPRESSED_VIDEO,),
}


@functools.cache
def message_classes() -> dict[str, Any]:
    """Return message name -> protobuf class."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    kinds = descriptor_pb2.FieldDescriptorProto
    pool = descriptor_pool.DescriptorPool()
    stamp_file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp_file)
    pool.Add(stamp_file)
    for path, messages in _FILES.items():
        package, _, _ = messages[0].rpartition(".")
        file = descriptor_pb2.FileDescriptorProto(name=path, package=package, syntax="proto3")
        file.dependency.append(_TIMESTAMP_FILE)
        for name in messages:
            message = file.message_type.add(name=name.rpartition(".")[2])
            message.field.add(
                name=_STAMP,
                number=1,
                type=kinds.TYPE_MESSAGE,
                label=kinds.LABEL_OPTIONAL,
                type_name=".google.protobuf.Timestamp",
            )
            for number, (field, kind, repeated) in enumerate(_FIELDS[name], start=2):
                label = kinds.LABEL_REPEATED if repeated else kinds.LABEL_OPTIONAL
                message.field.add(name=field, number=number, type=kinds.Type.Value(f"TYPE_{kind}"), label=label)
        pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name)) for name in _FIELDS}


def stamped_message(name: str, time_ns: int, **fields: Any) -> Any:
    """Return a message of the class `name` with its time in ns."""
    message = message_classes()[name](**fields)
    message.timestamp.seconds, message.timestamp.nanos = divmod(time_ns, 1_000_000_000)
    return message
