"""Read MCAP files with joints in protobuf or JSON messages, such as ABC-130k episodes."""

from __future__ import annotations

import functools
import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.real_recordings import RecordingNames
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, DatasetError, ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.video import decode_packets
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

from .column_names import CONFIG_KIND, arm_keys, candidate_namings
from .recording import JPEG_QUALITY, CameraImages, Recording, SampleIndices, motion_sides, times_from_nanoseconds

_MAX_MESSAGES = 5_000_000
# s, relative to the first arm's state. A later start of a topic is an error, an earlier end a problem.
_MAX_START_DELAY = _EARLIEST_END = 1.0

TopicRows = list[tuple[int, Array]]  # time (ns) and values of a topic's messages


def mcap_files(path: Path) -> list[Path]:
    """Return a file itself, or the MCAP files in a folder and its subfolders."""
    return sorted(path.rglob("*.mcap")) if path.is_dir() else [path]


def read_mcap(path: Path, rig: RigConfig, mapping: str | None, locations: Locations) -> list[Recording]:
    """Return the recordings of an MCAP file, or of all in a folder.

    Raises:
        DatasetError: the folder has no such file; or as for a file.
        ConfigError: `mapping` does not exist or does not fit.
        ResourceError: mcap is not installed.
    """
    files = mcap_files(path)
    if not files:
        raise DatasetError(f"{path}: contains no .mcap file; give a file, or a folder with such files")
    return [_read_file(file, rig, mapping, locations) for file in files]


def _read_file(path: Path, rig: RigConfig, mapping: str | None, locations: Locations) -> Recording:
    """Return the recording of an MCAP file.

    Samples are the first arm's state messages; other topics give their last value before each.

    Raises:
        DatasetError: the file is damaged or cut off, or no naming fits its topics.
        ConfigError: `mapping` does not exist or does not fit.
        ResourceError: mcap is not installed.
    """
    with _OpenedMcap(path) as reader:
        summary = reader.get_summary()
        if summary is None:
            raise DatasetError(f"{path}: has no summary, so it was probably cut off: run `mcap recover`")
        topics = [channel.topic for channel in summary.channels.values()]
    names = _matching_naming(topics, rig, mapping, path, locations)
    rows: dict[str, TopicRows] = {
        topic: []
        for arm in names.topics.values()
        for topic in (arm.state, arm.action, arm.gripper_state, arm.gripper_action)
        if topic and topic in topics
    }
    prompt = ""
    for topic, time, message in _read_messages(path, {*rows, *([names.prompt_topic] if names.prompt_topic else [])}):
        if topic == names.prompt_topic:
            text = _message_field(message, names.prompt_field)
            prompt = prompt or (text if isinstance(text, str) else "")
        else:
            rows[topic].append((time, _field_numbers(message, names.field, topic, path)))
    first = names.topics[arm_keys(rig)[0]].state
    stamps = np.array([time for time, _ in rows[first]], dtype=np.int64)
    motion = RecordedMotion(
        str(path), times_from_nanoseconds(stamps, f"{path} {first}"), _arm_motions(path, rig, names, rows, stamps)
    )
    pictures = {
        camera: _camera_images(path, topic, stamps) for topic, camera in names.cameras.items() if topic in topics
    }
    return Recording(motion, names.gripper, pictures, prompt, problems=tuple(_early_end_problems(rows, stamps)))


def _arm_motions(
    path: Path, rig: RigConfig, names: RecordingNames, rows: Mapping[str, TopicRows], stamps: SampleIndices
) -> tuple[ArmMotion, ...]:
    def topic_values(topic: str | None, width: int) -> Array | None:
        return _last_values(rows[topic], stamps, width, f"{path} {topic}") if topic and topic in rows else None

    motions = []
    for side, key, k in zip(motion_sides(rig), arm_keys(rig), rig.recording_order, strict=True):
        arm, dof = names.topics[key], rig.arms[k].robot.dof
        joints = topic_values(arm.state, dof)
        assert joints is not None, "the naming fits"
        measured, commanded = topic_values(arm.gripper_state, 1), topic_values(arm.gripper_action, 1)
        motions.append(
            ArmMotion(
                side,
                joints,
                topic_values(arm.action, dof),
                None if measured is None else measured[:, 0],
                None if commanded is None else commanded[:, 0],
            )
        )
    return tuple(motions)


def _early_end_problems(rows: Mapping[str, TopicRows], stamps: SampleIndices) -> Iterator[str]:
    for topic, messages in sorted(rows.items()):
        if messages and (early := (stamps[-1] - messages[-1][0]) * 1e-9) > _EARLIEST_END:
            yield f"{topic} ends {early:.1f} s before the arm's state, and keeps its last value: was it cut off?"


def _matching_naming(
    topics: Collection[str], rig: RigConfig, mapping: str | None, path: Path, locations: Locations
) -> RecordingNames:
    keys = arm_keys(rig)
    for names in candidate_namings(mapping, locations):
        if set(keys) <= set(names.topics) and all(names.topics[key].state in topics for key in keys):
            return names
    error = ConfigError if mapping else DatasetError
    raise error(
        f"{path}: its topics are {', '.join(topics) or 'none'}, and "
        + (f"--mapping {mapping}" if mapping else f"no config in configs/{CONFIG_KIND}/")
        + f" names the states of rig {rig.name!r} among them; give a file for --mapping, or another --rig"
    )


def _last_values(rows: TopicRows, stamps: SampleIndices, width: int, source: str) -> Array:
    """Return a topic's last values (n, width) before time stamps (n,), ns."""
    if not rows:
        raise DatasetError(f"{source}: contains no message")
    when = np.array([time for time, _ in rows], dtype=np.int64)
    if when[0] - stamps[0] > _MAX_START_DELAY * 1e9:
        raise DatasetError(
            f"{source}: begins {(when[0] - stamps[0]) * 1e-9:.1f} s after the arm's state; it was probably cut off: "
            "copy it again, or leave it out"
        )
    short = next((k for k, (_, values) in enumerate(rows) if len(values) < width), None)
    if short is not None:
        raise DatasetError(f"{source}: message {short} has {len(rows[short][1])} numbers; {width} are needed")
    values = np.array([row[:width] for _, row in rows])
    if not np.isfinite(values).all():
        raise DatasetError(f"{source}: message {int(np.argwhere(~np.isfinite(values))[0, 0])} is not finite")
    return values[np.clip(np.searchsorted(when, stamps, side="right") - 1, 0, None)]


def _camera_images(path: Path, topic: str, stamps: SampleIndices) -> CameraImages:
    when = [time for _, time, _ in _read_messages(path, {topic}, decoded=False)]
    after = np.searchsorted(stamps, np.array(when, dtype=np.int64), side="right")
    kept, first = np.unique(np.clip(after - 1, 0, None).astype(np.int64), return_index=True)
    return CameraImages(kept, functools.partial(_topic_jpegs, path, topic, frozenset(int(k) for k in first)))


def _topic_jpegs(path: Path, topic: str, kept: frozenset[int]) -> Iterator[bytes]:
    codec = next((str(_message_field(message, "format") or "") for _, _, message in _read_messages(path, {topic})), "")
    packets = (bytes(_message_field(message, "data")) for _, _, message in _read_messages(path, {topic}))
    for number, image in enumerate(decode_packets(packets, codec, f"{path} {topic}")):
        if number in kept:
            yield encode_jpeg(image, JPEG_QUALITY)


def _field_numbers(message: Any, field: str, topic: str, path: Path) -> Array:
    values = _message_field(message, field)
    try:
        return np.atleast_1d(np.asarray(list(values) if np.iterable(values) else values, dtype=np.float64))
    except (TypeError, ValueError):
        raise DatasetError(f"{path} {topic}: {field} holds no numbers: {str(values)[:60]!r}") from None


def _message_field(message: Any, name: str) -> Any:
    for part in name.split("."):
        message = message.get(part) if isinstance(message, dict) else getattr(message, part, None)
    return message


def _read_messages(path: Path, topics: set[str], *, decoded: bool = True) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time (ns) and content (None if not decoded), in order of time."""
    with _OpenedMcap(path) as reader:
        made = reader.iter_decoded_messages if decoded else reader.iter_messages
        for count, found in enumerate(made(topics=sorted(topics))):
            if count > _MAX_MESSAGES:
                raise DatasetError(f"{path}: has more than {_MAX_MESSAGES} messages; split it")
            yield found[1].topic, int(found[2].log_time), found[3] if decoded else None


class _OpenedMcap:
    """Opens an MCAP file with protobuf and JSON decoders. Errors of mcap become `DatasetError`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> Any:
        try:
            from mcap.reader import make_reader
            from mcap_protobuf.decoder import DecoderFactory
        except ModuleNotFoundError as error:
            raise ResourceError("MCAP needs the package mcap: run `pip install 'yamsim[mcap]'`") from error
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise DatasetError(f"{self._path} cannot be read: {error.strerror or error}") from error
        decoders: list[Any] = [DecoderFactory(), _JsonDecoders()]
        return make_reader(self._file, decoder_factories=decoders)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if kind is not None and kind.__module__.split(".")[0] in ("mcap", "google", "mcap_protobuf"):
            raise DatasetError(f"{self._path}: is damaged: {error}; copy it again") from error


class _JsonDecoders:
    def decoder_for(self, encoding: str, schema: Any) -> Any:
        return json.loads if encoding == "json" else None
