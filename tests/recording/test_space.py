from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.core.dataset.making import made, write_dataset
from yamsim_cli.core.config.rendering import ImageConfig
from yamsim_cli.core.dataset.disk_errors import describe_disk_error, explain_disk_error
from yamsim_cli.core.dataset.records import Manifest, from_json
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.recording.disk_space import EpisodeSize, check_space, files_per_episode

SIZE = EpisodeSize(min_bytes=1_000_000, likely=4_000_000, min_inodes=100, inodes=120)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A disk of 4 KB blocks, with a given free space."""
    state = SimpleNamespace(f_frsize=4096, f_bavail=0, f_files=10_000, f_favail=10_000)
    monkeypatch.setattr(os, "statvfs", lambda place: state)
    return state


def test_episodes_that_fit_cause_no_warning(disk: SimpleNamespace) -> None:
    disk.f_bavail, disk.f_favail = 10**6, 12_000
    assert check_space(Path("/d"), 100, SIZE) is None


def test_episodes_that_cannot_fit_are_refused_with_the_number_that_fits(disk: SimpleNamespace) -> None:
    disk.f_bavail = 5000
    with pytest.raises(
        ResourceError, match=r"100 episodes take at least 10000 files and 100 MB, but /d has .*: 19 fit"
    ):
        check_space(Path("/d"), 100, SIZE)


def test_files_run_out_before_bytes(disk: SimpleNamespace) -> None:
    disk.f_bavail, disk.f_favail = 10**9, 950
    with pytest.raises(ResourceError, match=r"room for .* in 950 files: 9 fit"):
        check_space(Path("/d"), 10, SIZE)


def test_a_disk_without_a_fixed_number_of_inodes_has_enough(disk: SimpleNamespace) -> None:
    disk.f_bavail, disk.f_files, disk.f_favail = 10**9, 0, 0
    assert check_space(Path("/d"), 10_000, SIZE) is None


def test_what_may_not_fit_is_a_warning(disk: SimpleNamespace) -> None:
    disk.f_bavail = 50_000
    warning = check_space(Path("/d"), 100, SIZE)
    assert warning is not None
    assert "at least 10000 files and 100 MB, probably 12000 files and 400 MB, and /d has room for 204 MB" in warning


def test_every_image_takes_whole_blocks() -> None:
    tiny = ImageConfig(size_px=(16, 16), jpeg_quality=85)
    size = EpisodeSize.estimate((57, 57), 2, tiny, block=4096)
    assert size.inodes == 57 * 3 + 6
    assert size.min_bytes >= 57 * 3 * 4096
    assert size.min_bytes < EpisodeSize.estimate((57, 57), 2, tiny, block=65536).min_bytes


def test_ground_truth_is_counted() -> None:
    image = ImageConfig(size_px=(640, 480), jpeg_quality=85)
    plain, truth = (EpisodeSize.estimate((57, 57), 2, image, 4096, truth=truth) for truth in (False, True))
    assert files_per_episode(57, 2, truth=False) == 57 * 3
    # Depth and segmentation of each camera; its numbers; the labels; and their folders.
    assert truth.inodes - plain.inodes == 57 * 4 + 3 + 7
    # Measured with two cameras: 3.5 MB an episode.
    assert truth.min_bytes - plain.min_bytes < 3_500_000
    assert 0.7 < (truth.likely - plain.likely) / 3_500_000 < 2


def test_episodes_that_are_there_teach_what_the_next_will_take(tmp_path: Path, disk: SimpleNamespace) -> None:
    guess = EpisodeSize.estimate((57, 57), 1, ImageConfig(size_px=(640, 480), jpeg_quality=85), block=4096)
    assert guess.from_recorded([], 4096) == guess
    dataset = write_dataset(tmp_path / "dataset")
    manifest = from_json(Manifest, (dataset / "manifest.json").read_bytes(), "manifest")
    known = guess.from_recorded(manifest.episodes, 4096)
    real = sum(len(data) for data in made(0).files.values())
    assert real < known.likely < real + 119 * 4096
    assert 0.7 * known.likely < known.min_bytes < known.likely


def test_of_a_program_the_lower_bound_is_refused_and_the_likely_size_warned_of(disk: SimpleNamespace) -> None:
    image = ImageConfig(size_px=(64, 48), jpeg_quality=85)
    size = EpisodeSize.estimate((40, 80), 2, image, block=4096)
    assert (size.min_inodes, size.inodes) == (40 * 3 + 6, 80 * 3 + 6)
    disk.f_bavail, disk.f_favail = 10**6, 126
    assert "246 files" in (check_space(Path("/d"), 1, size) or "")
    disk.f_favail = 125
    with pytest.raises(ResourceError, match="1 episode takes at least 126 files"):
        check_space(Path("/d"), 1, size)


def test_a_typical_picture_takes_more_at_a_higher_quality() -> None:
    sizes = [
        EpisodeSize.estimate((57, 57), 1, ImageConfig(size_px=(640, 480), jpeg_quality=quality), 4096)
        for quality in (20, 50, 85, 100)
    ]
    assert [size.likely for size in sizes] == sorted({size.likely for size in sizes})
    assert all(size.min_bytes <= size.likely for size in sizes)


@pytest.mark.parametrize(("inodes", "what"), [(0, "no inodes left on the device"), (7, "no space left on the device")])
def test_a_full_disk_says_whether_space_or_inodes_ran_out(disk: SimpleNamespace, inodes: int, what: str) -> None:
    disk.f_favail = inodes
    assert what in describe_disk_error(OSError(28, "No space left on device"), Path("/d"))


def test_an_error_names_its_file_or_at_least_the_dataset() -> None:
    assert explain_disk_error(OSError(5, "Input/output error", "/d/x"), Path("/d")).startswith(
        "/d/x: Input/output error: "
    )
    assert explain_disk_error(OSError(1, "Odd"), Path("/d")) == "/d: Odd"
