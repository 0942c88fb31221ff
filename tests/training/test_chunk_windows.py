"""Windows of demonstrations: actions and padding, the cache of decoded frames, and the order of batches."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.core.dataset.making import CAMERA, FRAMES, frame, made, write_dataset
from yamsim_cli import ChunkWindows, ShuffledBatches, open_dataset
from yamsim_cli.core.errors import DatasetError, ResourceError, UsageError
from yamsim_cli.core.images.jpeg import decode_jpeg

CHUNK = 3
LENGTHS = (FRAMES, 2, 5)  # frames of the episodes; one is shorter than a chunk


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    episodes = [made(k, frames=[frame(j, k) for j in range(length)]) for k, length in enumerate(LENGTHS)]
    return write_dataset(tmp_path / "demos", *episodes)


@pytest.fixture
def windows(dataset: Path) -> ChunkWindows:
    return ChunkWindows(open_dataset(dataset), [CAMERA], chunk=CHUNK)


def test_a_window_has_the_frame_and_the_actions_from_it_on(windows: ChunkWindows, dataset: Path) -> None:
    assert len(windows) == sum(LENGTHS)
    number = 0
    for episode in open_dataset(dataset):
        frames = episode.frames()
        for k in range(len(frames)):
            window, number = windows[number], number + 1
            np.testing.assert_array_equal(window["joints"], frames[k]["joints"])
            np.testing.assert_array_equal(window[CAMERA], decode_jpeg(episode.image(CAMERA, k)))
            for j in range(CHUNK):
                then = frames[min(k + j, len(frames) - 1)]
                np.testing.assert_array_equal(window["action"][j], np.append(then["ctrl"], np.float32(then["magnet"])))
                assert window["is_padding"][j] == (k + j >= len(frames))
    assert windows.episode_index.tolist() == [k for k, length in enumerate(LENGTHS) for _ in range(length)]
    with pytest.raises(IndexError, match="window 11 is not one of 11"):
        windows[11]


def test_a_batch_is_its_windows(windows: ChunkWindows) -> None:
    rows = [7, 0, -1, 7]
    batch = windows[rows]
    for key, values in batch.items():
        np.testing.assert_array_equal(values, np.stack([windows[row][key] for row in rows]))
        assert values.flags.writeable
    assert (batch["action"].shape, batch["action"].dtype) == ((4, CHUNK, 8), np.float32)


def test_frames_are_decoded_once(dataset: Path, windows: ChunkWindows, monkeypatch: pytest.MonkeyPatch) -> None:
    (cached,) = (dataset.parent / "demos_decoded").iterdir()
    monkeypatch.setattr("yamsim_cli.training.decoded_frames._decode", lambda *_: pytest.fail("decoded again"))
    again = ChunkWindows(open_dataset(dataset), [CAMERA], chunk=5)
    assert isinstance(again.arrays[CAMERA], np.memmap)
    np.testing.assert_array_equal(again.arrays[CAMERA], windows.arrays[CAMERA])
    # Processes share the files: a pickle does not hold the pictures.
    stored = pickle.dumps(windows)
    assert len(stored) < windows.arrays[CAMERA].nbytes
    np.testing.assert_array_equal(pickle.loads(stored)[4]["action"], windows[4]["action"])
    assert [file.name for file in sorted(cached.iterdir())] == [
        f"{name}.npy" for name in ("ctrl", "joints", "magnet", CAMERA)
    ]


def test_what_else_is_in_the_dataset_is_decoded_anew(dataset: Path, windows: ChunkWindows) -> None:
    """Other episodes, keys, or an episode that was recorded again."""
    ChunkWindows(open_dataset(dataset)[1:], [CAMERA])
    ChunkWindows(open_dataset(dataset), [CAMERA], keys=("joints", "ee_pose"))
    record = dataset / "ep_000001/episode.json"
    record.write_text(record.read_text().replace('"seed": 7', '"seed": 8'))
    found = ChunkWindows(open_dataset(dataset), [CAMERA], cache=dataset.parent / "elsewhere")
    assert len(list((dataset.parent / "demos_decoded").iterdir())) == 3
    assert len(list((dataset.parent / "elsewhere").iterdir())) == 1
    np.testing.assert_array_equal(found.arrays["joints"], windows.arrays["joints"])


def test_what_cannot_be_decoded_leaves_no_cache(dataset: Path) -> None:
    (dataset / "ep_000001/rgb/scene_camera/000001.jpg").write_bytes(b"\xff\xd8")
    with pytest.raises(DatasetError, match=r"000001\.jpg is not what was recorded"):
        ChunkWindows(open_dataset(dataset), [CAMERA])
    assert list((dataset.parent / "demos_decoded").iterdir()) == []


def test_bad_requests_say_what_is_valid(dataset: Path) -> None:
    episodes = open_dataset(dataset)
    with pytest.raises(UsageError, match="chunk=0 is not valid"):
        ChunkWindows(episodes, chunk=0)
    with pytest.raises(UsageError, match="has no episodes"):
        ChunkWindows(episodes[3:])
    with pytest.raises(DatasetError, match="no camera 'front'; valid: scene_camera"):
        ChunkWindows(episodes, ["front"])
    with pytest.raises(DatasetError, match="no 'joint'; valid: joints"):
        ChunkWindows(episodes, keys=["joint"])
    (dataset.parent / "a_file").touch()
    with pytest.raises(ResourceError, match=r"a_file.*give another cache"):
        ChunkWindows(episodes, cache=dataset.parent / "a_file")


def orders(count: int, size: int, ranks: int, seed: int, epoch: int) -> list[list[list[int]]]:
    """Batches of each rank."""
    found = []
    for rank in range(ranks):
        batches = ShuffledBatches(count, size, seed=seed, rank=rank, ranks=ranks)
        batches.set_epoch(epoch)
        found.append(list(batches))
        assert len(found[-1]) == len(batches)
    return found


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_an_epoch_has_each_window_once_over_all_ranks(ranks: int) -> None:
    batches = orders(100, 4, ranks, 5, 2)
    assert {len(one) for one in batches} == {100 // (4 * ranks)}
    seen = [k for one in batches for batch in one for k in batch]
    assert len(set(seen)) == len(seen) == 100 // (4 * ranks) * 4 * ranks
    assert orders(100, 4, ranks, 5, 2) == batches
    assert orders(100, 4, ranks, 5, 3) != batches
    assert orders(100, 4, ranks, 6, 2) != batches


def test_ranks_share_the_batches_of_one() -> None:
    (whole,) = orders(50, 8, 1, 1, 0)
    halves = orders(50, 4, 2, 1, 0)
    assert [one + other for one, other in zip(*halves, strict=True)] == whole


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"rank": 2, "ranks": 2}, "rank=2 is not valid: with ranks=2, give 0 to 1"),
        ({"size": 51, "ranks": 2}, "2 ranks need 102 windows for a batch, and there are 100; give 1 to 50"),
        ({"size": 0}, "size=0 is not valid"),
    ],
)
def test_batches_that_cannot_be_filled_are_refused(options: dict[str, int], told: str) -> None:
    with pytest.raises(UsageError, match=told):
        ShuffledBatches(100, **{"size": 4, **options})


@pytest.mark.slow
def test_pytorchs_loader_gives_the_same_batches_with_any_number_of_workers(windows: ChunkWindows) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")

    def load(workers: int) -> Sequence[dict[str, np.ndarray]]:
        batches = ShuffledBatches(len(windows), 2, seed=3)
        context = {"multiprocessing_context": "spawn", "persistent_workers": True} if workers else {}
        loader = torch.utils.data.DataLoader(windows, sampler=batches, batch_size=None, num_workers=workers, **context)
        found = []
        for epoch in range(2):
            batches.set_epoch(epoch)
            found += [{key: value.numpy() for key, value in batch.items()} for batch in loader]
        return found

    alone = load(0)
    assert len(alone) == 2 * (len(windows) // 2)
    assert (alone[0][CAMERA].dtype, alone[0]["action"].shape) == (np.uint8, (2, CHUNK, 8))
    for workers in (1, 2):
        for batch, other in zip(alone, load(workers), strict=True):
            for key, values in batch.items():
                np.testing.assert_array_equal(values, other[key])
    # PyTorch's own batches of single windows.
    plain = next(iter(torch.utils.data.DataLoader(windows, batch_size=3)))
    np.testing.assert_array_equal(plain["action"].numpy(), windows[[0, 1, 2]]["action"])


def test_the_cache_is_not_read_if_it_was_not_finished(dataset: Path, windows: ChunkWindows) -> None:
    """A killed process leaves a hidden folder, which the next one removes."""
    folder = dataset.parent / "demos_decoded"
    (cached,) = folder.iterdir()
    cached.rename(folder / f".{cached.name}.{'0' * 32}.part")
    ChunkWindows(open_dataset(dataset), [CAMERA])
    assert [path.name for path in folder.iterdir()] == [cached.name]
