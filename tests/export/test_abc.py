"""ABC's release episodes and training layout: written, and read again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from tests.export.conftest import EPISODES, ignore
from tests.export.real_datasets import bring_in, of_tables
from tests.export.station_datasets import (
    CAMERAS,
    CODEC_ERROR,
    FPS,
    image_error,
    images_of,
    motion_at,
    station_dataset,
    write_station_recording,
)
from tests.real.recordings.foreign import PROMPT, shares
from tests.real.recordings.making import same_motion
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.resize import resize_image
from yamsim_cli.export.abc import TICK_NS, AbcLayout, export_abc, frame_stamps, latest_frames
from yamsim_cli.export.export_source import open_real_source, open_source
from yamsim_cli.real.recordings.motion_reading import detect_format, format_reader, read_motions

pytest.importorskip("mcap_protobuf", reason="the extra mcap is not installed")

TASK = PROMPT.replace(" ", "_")
STATES = [f"/{side}-{part}" for side in ("left", "right") for part in ("arm-state", "ee-state")]
ACTIONS = [topic.replace("state", "action") for topic in STATES]
FILMS = ["/top-camera", "/left-wrist-camera", "/right-wrist-camera"]
FRAMES = (65, 40)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    motions = [motion_at(station, count) for count in FRAMES]
    return station_dataset(tmp_path_factory.mktemp("abc"), motions, station, locations)


@pytest.fixture(scope="module")
def release(recorded: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("abc_release") / "out"
    done = export_abc(open_real_source(recorded, None, locations), out, ignore, workers=2)
    assert (done.episodes, done.frames, done.notes) == (2, sum(FRAMES), ())
    return out


@pytest.fixture(scope="module")
def training(recorded: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("abc_training") / "out"
    export_abc(open_real_source(recorded, None, locations), out, ignore, layout="training")
    return out


def by_length(folders: list[Path]) -> list[Path]:
    """Folders of episodes, the longest first, as they were recorded."""
    return sorted(folders, key=lambda folder: -sum(file.stat().st_size for file in folder.iterdir()))


def test_a_release_episode_has_abcs_topics_and_messages(release: Path, station: RigConfig) -> None:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    folder = by_length(list((release / TASK).iterdir()))[0]
    with (folder / "episode.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        (metadata,) = reader.iter_metadata()
        messages = list(reader.iter_decoded_messages())
    assert metadata.name == "session-metadata"
    assert folder.name == f"episode_{metadata.metadata['session-uuid']}"
    found: dict[str, list[tuple[int, object]]] = {}
    for schema, channel, message, content in messages:
        assert schema is not None and schema.encoding == channel.message_encoding == "protobuf"
        assert message.log_time == content.timestamp.seconds * 10**9 + content.timestamp.nanos
        found.setdefault(channel.topic, []).append((message.log_time, content))
    assert set(found) == {*STATES, *ACTIONS, *FILMS, "/instruction"}
    assert {schema.name for schema, *_ in messages if schema} == {
        *("RobotState", "GripperState", "Instructions", "foxglove.CompressedVideo")
    }
    assert found["/instruction"][0][1].data == PROMPT  # type: ignore[attr-defined]
    for (state, action), rows, commands in zip(
        zip(STATES[::2], ACTIONS[::2], strict=True), *shares(motion_at(station, FRAMES[0]), station), strict=True
    ):
        for topic, wanted in ((state, rows), (action, commands)):
            assert [time for time, _ in found[topic]] == [TICK_NS * (k + 1) for k in range(FRAMES[0])]
            positions = [content.position for _, content in found[topic]]  # type: ignore[attr-defined]
            np.testing.assert_allclose(positions, wanted[:, :6], atol=1e-6)
    for topic in FILMS:
        packets = [content.data for _, content in found[topic]]  # type: ignore[attr-defined]
        assert len(packets) == FRAMES[0]
        # Parameter sets (types 7 and 8) before each key frame (type 5), and a key frame each second.
        kinds = [{packet[k + 3] & 31 for k in starts(packet)} for packet in packets]
        keys = [k for k, kind in enumerate(kinds) if 5 in kind]
        assert all({7, 8} <= kinds[k] for k in keys)
        assert keys[0] == 0
        assert np.diff([*keys, FRAMES[0]]).max() <= 30


def starts(packet: bytes) -> list[int]:
    """Where Annex B's start codes are."""
    places, at = [], packet.find(b"\0\0\1")
    while at >= 0:
        places.append(at)
        at = packet.find(b"\0\0\1", at + 3)
    return places


def test_a_round_trip_by_release_keeps_numbers_and_pictures(
    recorded: Path, release: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    assert detect_format(release) == "mcap"
    files = [folder / "episode.mcap" for folder in by_length(list((release / TASK).iterdir()))]
    again = bring_in(tmp_path / "again", files, station, locations)
    compare(again, recorded, station, locations)
    for camera in CAMERAS:
        assert image_error(images_of(again, 0, camera), images_of(recorded, 0, camera)) < CODEC_ERROR


def compare(again: Path, recorded: Path, station: RigConfig, locations: Locations) -> None:
    found, wanted = read_motions([again], station, locations), read_motions([recorded], station, locations)
    for one, other in zip(found, wanted, strict=True):
        same_motion(one, other)
    for k in range(len(found)):
        frames = [open_recorded_episode(path / f"ep_{k:06d}").frames() for path in (again, recorded)]
        for name in ("joints", "ctrl"):
            one, other = (np.array([frame[name] for frame in rows]) for rows in frames)
            np.testing.assert_allclose(one, other, atol=1e-7)
        assert frames[0][0]["language_prompt"] == PROMPT


def test_a_training_episode_has_the_trainers_rows_and_film(training: Path, station: RigConfig) -> None:
    folder = by_length(list(training.iterdir()))[0]
    assert sorted(file.name for file in folder.iterdir()) == [
        *("combined_camera-images-rgb.mp4", "episode_metadata.json", "states_actions.bin")
    ]
    rows = np.fromfile(folder / "states_actions.bin").reshape(-1, 28)
    measured, commanded = shares(motion_at(station, FRAMES[0]), station)
    np.testing.assert_allclose(rows, np.hstack([*measured, *commanded]), atol=1e-6)
    metadata = json.loads((folder / "episode_metadata.json").read_text())
    assert metadata["cameras"] == ["top", "left", "right"]
    assert (metadata["task_name"], metadata["num_steps"], metadata["tick_ns"]) == (TASK, FRAMES[0], 33333333)
    with av.open(str(folder / "combined_camera-images-rgb.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.time_base.denominator, stream.width, stream.height) == (15360, 224, 3 * 224)
        packets = [packet for packet in film.demux(stream) if packet.pts is not None]
    assert [packet.pts for packet in packets] == [packet.dts for packet in packets] == [512 * k for k in range(65)]
    assert [k for k, packet in enumerate(packets) if packet.is_keyframe] == [0, 30, 60]


def test_a_film_has_no_key_frames_at_changes(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    """The pictures change completely in the middle, where the encoder would add a key frame."""
    log = write_station_recording(tmp_path / "log", motion_at(station, 40))
    for name in CAMERAS:
        for k in range(20, 40):
            file = log / f"rgb/{name}/{k:06d}.jpg"
            noise = np.random.default_rng(k).integers(0, 255, (48, 64, 3), np.uint8)
            file.write_bytes(encode_jpeg(noise, 95))
    dataset = bring_in(tmp_path / "real", [log], station, locations)
    export_abc(open_real_source(dataset, None, locations), tmp_path / "out", ignore, layout="training")
    (film,) = tmp_path.glob("out/*/*.mp4")
    with av.open(str(film)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.pts is not None]
    assert [k for k, packet in enumerate(packets) if packet.is_keyframe] == [0, 30]


def test_a_round_trip_by_training_keeps_numbers_and_scaled_pictures(
    recorded: Path, training: Path, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    assert detect_format(training) == detect_format(next(training.iterdir())) == "abc_training"
    again = bring_in(tmp_path / "again", by_length(list(training.iterdir())), station, locations)
    compare(again, recorded, station, locations)
    for camera in CAMERAS:
        wanted = np.stack([resize_image(image, (224, 224), pad=True) for image in images_of(recorded, 0, camera)])
        assert image_error(images_of(again, 0, camera), wanted) < CODEC_ERROR


def test_stamps_of_30_hz_fall_on_rows() -> None:
    for times in (np.arange(900) / 30, np.arange(900) * 0.033333333, np.arange(900) * 0.0333333333333):
        stamps = frame_stamps(times)
        np.testing.assert_array_equal(np.diff(stamps), TICK_NS)
        np.testing.assert_array_equal(latest_frames(stamps), np.arange(900))


def test_rows_of_other_rates_have_the_last_frame_before_them() -> None:
    stamps = frame_stamps(np.arange(6) * 0.064)
    np.testing.assert_array_equal(np.diff(stamps), 64_000_000)
    np.testing.assert_array_equal(latest_frames(stamps), [0, 0, 1, 1, 2, 2, 3, 3, 4, 4])
    uneven = frame_stamps(np.array([0.0, 0.04, 0.05, 0.2]))
    np.testing.assert_array_equal(uneven - uneven[0], [0, 40_000_000, 50_000_000, 200_000_000])
    np.testing.assert_array_equal(latest_frames(uneven), [0, 0, 2, 2, 2, 2, 2])


@pytest.mark.parametrize("layout", ["release", "training"])
def test_a_simulated_arm_becomes_the_left_one(
    layout: AbcLayout, dataset: Path, single: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    done = export_abc(open_source(dataset, None, locations), tmp_path / "out", ignore, layout=layout)
    assert done.episodes == EPISODES
    assert done.notes == ("ABC's own models need a right camera, a right arm, which the dataset does not have",)
    if layout == "training":
        (recording, *_) = format_reader("abc_training")(tmp_path / "out", single, None, locations)
        assert len(recording.motion.arms) == 1
        assert set(recording.pictures) == {"top_camera", "left_wrist_camera"}


def test_a_dataset_without_a_top_camera_is_refused(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    tables = of_tables(tmp_path, [motion_at(station, 30)], station, locations)
    with pytest.raises(DatasetError, match=r"no camera above the arms.*its cameras are none"):
        export_abc(open_real_source(tables, None, locations), tmp_path / "out", ignore)
    assert not (tmp_path / "out").exists()


def cut_rows(folder: Path) -> None:
    file = folder / "states_actions.bin"
    file.write_bytes(file.read_bytes()[:-8])


def other_cameras(folder: Path) -> None:
    change(folder, cameras=["top", "left", "right", "front", "back"])


def change(folder: Path, **values: object) -> None:
    file = folder / "episode_metadata.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | values))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (cut_rows, "has 1119 numbers, 39 rows of 28 and 27 more"),
        (other_cameras, "is 672 px high; valid: a multiple of 5 cameras"),
        (lambda folder: change(folder, tick_ns=0), "tick_ns is 0"),
        (lambda folder: (folder / "episode_metadata.json").unlink(), "cannot be read"),
        (lambda folder: change(folder, num_steps=41), "says 41 rows"),
    ],
)
def test_a_damaged_training_episode_is_refused_in_one_line(
    spoil: Callable[[Path], None],
    message: str,
    training: Path,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    folder = tmp_path / "episode_x"
    shutil.copytree(by_length(list(training.iterdir()))[1], folder)
    spoil(folder)
    with pytest.raises(DatasetError, match=message) as caught:
        bring_in(tmp_path / "real", [folder], station, locations)
    assert "\n" not in str(caught.value)


def test_two_arms_do_not_fit_a_rig_of_one(training: Path, single: RigConfig, locations: Locations) -> None:
    with pytest.raises(DatasetError, match="has two arms, and rig 'single' has one"):
        format_reader("abc_training")(training, single, None, locations)


def test_the_rate_of_the_recordings_is_the_layouts() -> None:
    assert int(1e9 / FPS) == TICK_NS
