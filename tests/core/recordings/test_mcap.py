"""MCAP files as ABC-130k has them: protobuf, states and actions of arms and of grippers apart, films in packets."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.core.recordings.foreign import PROMPT, START_NS, grey_of, shares
from tests.core.recordings.making import swinging
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.core.motion import Motion
from yamsim_cli.core.recordings.formats import format_of, reader_of
from yamsim_cli.core.resources import Locations

pytest.importorskip("mcap", reason="the extra mcap is not installed")

STATION = "yam_station_linear_4310_d405"
FILM_EVERY = 4


@pytest.fixture(scope="module")
def station(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", STATION, locations)


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


def write(path: Path, motion: Motion, rig: RigConfig) -> Path:
    from mcap_protobuf.writer import Writer

    kinds = messages()
    measured, told = shares(motion, rig)
    film = film_packets(len(range(0, len(motion.times), FILM_EVERY)))
    with path.open("wb") as file, Writer(file) as writer:

        def say(topic: str, message: Any, k: int) -> None:
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


@pytest.fixture(scope="module")
def motion(station: RigConfig) -> Motion:
    return swinging(station, 0.6)


@pytest.fixture(scope="module")
def file(station: RigConfig, motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("mcap") / "episode.mcap", motion, station)


def test_a_recording_comes_in_with_its_film(
    file: Path, station: RigConfig, motion: Motion, locations: Locations
) -> None:
    assert format_of(file) == "mcap"
    (recording,) = reader_of("mcap")(file, station, None, locations)
    found = recording.in_metres(station)
    np.testing.assert_allclose(found.times, motion.times, atol=1e-9)
    for arm, other in zip(found.arms, motion.arms, strict=True):
        for key in ("joints", "commands", "openings", "commanded_openings"):
            np.testing.assert_allclose(getattr(arm, key), getattr(other, key), atol=1e-12)
    assert recording.prompt == PROMPT
    pictures = recording.pictures["top_camera"]
    np.testing.assert_array_equal(pictures.samples, np.arange(0, len(motion.times), FILM_EVERY))
    images = [decode_jpeg(data) for data in pictures.read()]
    assert len(images) == len(pictures.samples)
    for k, image in enumerate(images):
        assert image is not None
        assert abs(float(image.mean()) - grey_of(k)) < 3


def test_a_file_that_was_cut_off_is_refused(
    file: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    data = file.read_bytes()
    for share in (0.3, 0.9, 0.999):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(DatasetError, match=r"cut\.mcap"):
            reader_of("mcap")(cut, station, None, locations)


def test_another_rig_is_told_the_topics(file: Path, locations: Locations) -> None:
    single = load_config(RigConfig, "rigs", "single", locations)
    with pytest.raises(DatasetError, match="/left-arm-state"):
        reader_of("mcap")(file, single, None, locations)
