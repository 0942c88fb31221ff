"""MCAP files with arms' joints in messages, protobuf or JSON, such as the episodes of ABC-130k."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..config.loader import load_config
from ..config.real import ArmTopics, RecordingNames
from ..config.rig import RigConfig
from ..errors import ConfigError, DatasetError, ResourceError
from ..geometry.se3 import Array
from ..images.jpeg import encode_jpeg
from ..images.video import packet_frames
from ..motion import ArmMotion, Motion
from ..resources import Locations
from .columns import sides
from .naming import KIND, known_names
from .recording import Pictures, Recording, Samples
from .times import from_nanoseconds

_ONLY = "only"
_QUALITY = 95
_MOST_MESSAGES = 5_000_000
# What was told last holds. A topic that begins later than this after the motion's own is not the same recording; one
# that ends earlier before its end is worth a word, s.
_LATEST_BEGIN = _EARLIEST_END = 1.0


def read_mcap(path: Path, rig: RigConfig, mapping: str | None, locations: Locations) -> list[Recording]:
    """The recording in an MCAP file, with the samples of the first arm's state; other topics are as they were last.

    Raises:
        DatasetError: it is damaged or cut off, or no naming fits its topics.
        ConfigError: the naming that was asked for is none.
        ResourceError: mcap is not installed.
    """
    topics = _topics(path)
    names = _naming(topics, rig, mapping, path, locations)
    numbers = {topic for arm in names.topics.values() for topic in _of(arm) if topic in topics}
    wanted = {*numbers, *([names.prompt_topic] if names.prompt_topic else [])}
    rows: dict[str, list[tuple[int, Array]]] = {topic: [] for topic in numbers}
    prompt = ""
    for topic, time, message in _messages(path, wanted):
        if topic == names.prompt_topic:
            said = _field(message, names.prompt_field)
            prompt = said if isinstance(said, str) and not prompt else prompt
            continue
        rows[topic].append((time, _numbers(message, names.field, topic, path)))
    return [_recording(path, rig, names, topics, rows, prompt)]


def _recording(
    path: Path,
    rig: RigConfig,
    names: RecordingNames,
    topics: Mapping[str, str],
    rows: Mapping[str, list[tuple[int, Array]]],
    prompt: str,
) -> Recording:
    first = names.topics[_key(sides(rig)[0])].state
    stamps = np.array([time for time, _ in rows[first]], dtype=np.int64)
    times = from_nanoseconds(stamps, f"{path} {first}")
    arms = []
    for side, k in zip(sides(rig), rig.recorded, strict=True):
        arm, dof = names.topics[_key(side)], rig.arms[k].robot.dof

        def at(topic: str | None, width: int) -> Array | None:
            return _held(rows[topic], stamps, width, f"{path} {topic}") if topic in rows and topic else None

        joints = at(arm.state, dof)
        assert joints is not None, "the naming fits"
        opening, told = at(arm.gripper_state, 1), at(arm.gripper_action, 1)
        arms.append(
            ArmMotion(
                side,
                joints,
                at(arm.action, dof),
                None if opening is None else opening[:, 0],
                None if told is None else told[:, 0],
            )
        )
    pictures = {camera: _pictures(path, topic, stamps) for topic, camera in names.cameras.items() if topic in topics}
    motion = Motion(str(path), times, tuple(arms))
    return Recording(motion, names.gripper, pictures, prompt, problems=tuple(_early_ends(rows, stamps)))


def _early_ends(rows: Mapping[str, list[tuple[int, Array]]], stamps: Samples) -> Iterator[str]:
    """Lines on the topics that end long before the motion does."""
    for topic, said in sorted(rows.items()):
        if said and (early := (stamps[-1] - said[-1][0]) * 1e-9) > _EARLIEST_END:
            yield f"{topic} ends {early:.1f} s before the arm's state, and is held as it was then: was it cut off?"


def _key(side: str) -> Any:
    return side or _ONLY


def _of(arm: ArmTopics) -> list[str]:
    return [topic for topic in (arm.state, arm.action, arm.gripper_state, arm.gripper_action) if topic]


def _naming(
    topics: Mapping[str, str], rig: RigConfig, mapping: str | None, path: Path, locations: Locations
) -> RecordingNames:
    wanted = {_key(side) for side in sides(rig)}
    asked = [load_config(RecordingNames, KIND, mapping, locations)] if mapping else known_names(locations)
    for names in asked:
        if wanted <= set(names.topics) and all(names.topics[key].state in topics for key in wanted):
            return names
    error = ConfigError if mapping else DatasetError
    raise error(
        f"{path}: its topics are {', '.join(topics) or 'none'}, and "
        + (f"--mapping {mapping}" if mapping else f"no naming in configs/{KIND}/")
        + f" does not name the states of rig {rig.name!r} among them; give --mapping names.yaml or another --rig"
    )


def _held(rows: list[tuple[int, Array]], stamps: Samples, width: int, source: str) -> Array:
    """What a topic said last at each time (n, width)."""
    if not rows:
        raise DatasetError(f"{source}: holds no message")
    when = np.array([time for time, _ in rows], dtype=np.int64)
    if when[0] - stamps[0] > _LATEST_BEGIN * 1e9:
        raise DatasetError(
            f"{source}: begins {(when[0] - stamps[0]) * 1e-9:.1f} s after the arm's state; was it cut off?"
        )
    short = next((k for k, (_, values) in enumerate(rows) if len(values) < width), None)
    if short is not None:
        raise DatasetError(f"{source}: message {short} has {len(rows[short][1])} numbers; {width} are needed")
    values = np.array([row[:width] for _, row in rows])
    if not np.isfinite(values).all():
        raise DatasetError(f"{source}: message {int(np.argwhere(~np.isfinite(values))[0, 0])} is not finite")
    return values[np.clip(np.searchsorted(when, stamps, side="right") - 1, 0, None)]


def _pictures(path: Path, topic: str, stamps: Samples) -> Pictures:
    """A camera's pictures, each at the sample that was there when it was taken."""
    when = [time for _, time, _ in _messages(path, {topic}, decoded=False)]
    after = np.searchsorted(stamps, np.array(when, dtype=np.int64), side="right")
    kept, first = np.unique(np.clip(after - 1, 0, None).astype(np.int64), return_index=True)
    return Pictures(kept, functools.partial(_jpegs, path, topic, frozenset(int(k) for k in first)))


def _jpegs(path: Path, topic: str, kept: frozenset[int]) -> Iterator[bytes]:
    codec = ""
    for _, _, message in _messages(path, {topic}):
        codec = str(_field(message, "format") or "")
        break
    packets = (bytes(_field(message, "data")) for _, _, message in _messages(path, {topic}))
    for number, image in enumerate(packet_frames(packets, codec, f"{path} {topic}")):
        if number in kept:
            yield encode_jpeg(image, _QUALITY)


def _numbers(message: Any, field: str, topic: str, path: Path) -> Array:
    values = _field(message, field)
    try:
        return np.atleast_1d(np.asarray(list(values) if np.iterable(values) else values, dtype=np.float64))
    except (TypeError, ValueError):
        raise DatasetError(f"{path} {topic}: {field} holds no numbers: {str(values)[:60]!r}") from None


def _field(message: Any, name: str) -> Any:
    """A field of a decoded message; fields of fields are parted by dots."""
    for part in name.split("."):
        message = message.get(part) if isinstance(message, dict) else getattr(message, part, None)
    return message


def _topics(path: Path) -> dict[str, str]:
    """Topic -> how its messages are encoded."""
    with _Reading(path) as reader:
        summary = reader.get_summary()
        if summary is None:
            raise DatasetError(f"{path}: has no summary: was it cut off? `mcap recover` mends it")
        return {channel.topic: channel.message_encoding for channel in summary.channels.values()}


def _messages(path: Path, topics: set[str], *, decoded: bool = True) -> Iterator[tuple[str, int, Any]]:
    """Topic, time in ns and content of each message, in the order of their times."""
    with _Reading(path) as reader:
        made = reader.iter_decoded_messages if decoded else reader.iter_messages
        for count, found in enumerate(made(topics=sorted(topics))):
            if count > _MOST_MESSAGES:
                raise DatasetError(f"{path}: has more than {_MOST_MESSAGES} messages; split it")
            yield found[1].topic, int(found[2].log_time), found[3] if decoded else None


class _Reading:
    """An MCAP file that is open, with decoders for protobuf and JSON. What mcap finds wrong is a `DatasetError`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> Any:
        try:
            from mcap.reader import make_reader
            from mcap_protobuf.decoder import DecoderFactory
        except ModuleNotFoundError as error:
            raise ResourceError("MCAP needs mcap, which is not here: pip install 'yamsim[mcap]'") from error
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise DatasetError(f"{self._path} cannot be read: {error.strerror or error}") from error
        decoders: list[Any] = [DecoderFactory(), _JsonDecoders()]
        return make_reader(self._file, decoder_factories=decoders)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if (
            error is not None
            and kind is not None
            and kind.__module__.split(".")[0] in ("mcap", "google", "mcap_protobuf")
        ):
            raise DatasetError(f"{self._path}: is damaged: {error}; was it copied whole?") from error


class _JsonDecoders:
    """Decoders of messages that are JSON."""

    def decoder_for(self, encoding: str, schema: Any) -> Any:
        """The decoder of a channel's messages; None if they are no JSON."""
        return json.loads if encoding == "json" else None
