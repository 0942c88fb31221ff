"""A dataset as a sequence of episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import yamsim_cli
from tests.core.dataset.making import FRAMES, made
from yamsim_cli.core.dataset.reader import StoredEpisode, StoredEpisodes
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.images.jpeg import decode_jpeg

Build = Callable[..., Path]


def numbers(episodes: Sequence[StoredEpisode]) -> list[int]:
    return [episode.record.episode for episode in episodes]


@pytest.fixture
def episodes(dataset: Path) -> StoredEpisodes:
    return yamsim_cli.open_dataset(dataset)  # type: ignore[no-any-return]


def test_a_dataset_is_a_sequence_of_episodes(episodes: StoredEpisodes) -> None:
    assert isinstance(episodes, Sequence)
    assert (len(episodes), bool(episodes)) == (3, True)
    assert [episodes[k].record.episode for k in (0, 2, -1, -3)] == [0, 2, 2, 0]
    assert episodes[np.int64(1)].record.episode == 1
    assert numbers(list(reversed(episodes))) == [2, 1, 0]
    assert len(episodes[1].frames()) == FRAMES


def test_a_dataset_can_be_iterated_repeatedly(episodes: StoredEpisodes) -> None:
    assert next(iter(episodes)).record.episode == 0
    assert numbers(episodes) == numbers(episodes) == [0, 1, 2]


def test_a_slice_of_a_dataset_is_a_sequence(episodes: StoredEpisodes) -> None:
    assert numbers(episodes[1:]) == [1, 2]
    assert numbers(episodes[::-2]) == [2, 0]
    assert episodes[1:][0].record.episode == 1
    assert len(episodes[5:]) == 0


def test_an_episode_and_a_dataset_become_arrays(episodes: StoredEpisodes, dataset: Path) -> None:
    episode, frames = episodes[1], episodes[1].frames()
    found = episode.arrays(["scene_camera"])
    for key in ("joints", "ctrl", "magnet", "timestamp", "ee_pose"):
        np.testing.assert_array_equal(found[key], [frame[key] for frame in frames])
    width, height = episode.record.cameras["scene_camera"]
    assert (found["scene_camera"].shape, found["scene_camera"].dtype) == ((FRAMES, height, width, 3), np.uint8)
    np.testing.assert_array_equal(found["scene_camera"][2], decode_jpeg(episode.image("scene_camera", 2)))
    assert {"language_task", "intrinsics", "sim_ctrl"}.isdisjoint(found)
    whole = episodes.arrays(["scene_camera"])
    assert whole["episode_index"].tolist() == [k for k in range(3) for _ in range(FRAMES)]
    for key, rows in found.items():
        np.testing.assert_array_equal(whole[key][FRAMES : 2 * FRAMES], rows)
    assert episodes[5:].arrays() == {}


def test_arrays_of_a_camera_that_is_not_there_name_the_others(episodes: StoredEpisodes) -> None:
    with pytest.raises(DatasetError, match="ep_000001: no camera 'front'; valid: scene_camera"):
        episodes[1].arrays(["front"])


@pytest.mark.parametrize("place", [3, -4])
def test_a_place_that_is_not_there_is_an_index_error(episodes: StoredEpisodes, place: int) -> None:
    with pytest.raises(IndexError, match=rf"dataset has 3 episodes, but none at index {place}$"):
        episodes[place]


def test_the_repr_of_a_dataset_has_its_length_and_path(episodes: StoredEpisodes, dataset: Path) -> None:
    assert repr(episodes) == f"<3 episodes of {dataset}>"


def test_an_episode_is_read_when_it_is_asked_for(dataset: Path) -> None:
    (dataset / "ep_000001/episode.json").write_text("{")
    episodes = yamsim_cli.open_dataset(dataset)
    assert episodes[2].record.episode == 2
    with pytest.raises(DatasetError, match=r"ep_000001/episode\.json: "):
        episodes[1]


def test_a_dataset_without_an_episode_is_an_empty_one(dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    (dataset / "config.yaml").rename(tmp_path / "new/config.yaml")
    assert list(yamsim_cli.open_dataset(tmp_path / "new")) == []


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("datset", r"datset is not a directory; give the directory that `yamsim record` wrote"),
        ("dataset/config.yaml", r"config\.yaml is not a directory"),
        ("dataset/ep_000001", r"ep_000001 is one episode; give the directory around it, .*/dataset$"),
        (".", r"holds no episodes \(ep_NNNNNN, .*\) and no config\.yaml"),
        ("x" * 300, r"cannot be read: File name too long; .* give the directory that `yamsim record` wrote"),
    ],
)
def test_a_path_without_a_dataset_is_refused_when_opened(dataset: Path, tmp_path: Path, path: str, told: str) -> None:
    with pytest.raises(DatasetError, match=told):
        yamsim_cli.open_dataset(tmp_path / path)


def test_a_plain_recording_has_no_episodes_to_open(build: Build) -> None:
    path = build(made(0))
    for name in ("config.yaml", "ep_000000/episode.json"):
        (path / name).unlink()
    with pytest.raises(DatasetError, match=r"is a plain recording, without config\.yaml and episode\.json"):
        yamsim_cli.open_dataset(path)
