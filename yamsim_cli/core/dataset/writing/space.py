"""Checks, before recording starts, that the disk has room for it."""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from ...config.pictures import ImageConfig
from ...errors import ResourceError, counted
from ..records import ManifestEntry

# Bytes of a JPEG, per pixel and besides: at least (plain scenes at low quality) and at most (noisy scenes at high
# quality). Source: measured at 640x480 from quality 50 (0.042 per pixel) to 100 (0.26); noise doubles it.
_LEAST_PER_PIXEL, _LEAST_PER_IMAGE = 0.03, 600
_MOST_PER_PIXEL, _MOST_PER_IMAGE = 0.5, 2000
# Bytes of a frame's lowdim pickle. Source: measured, 1600 to 2200.
_PER_LOWDIM = 2200
# Bytes in an episode's record for each of its files. Source: measured, 90.
_PER_HASH = 110
# Bytes of ground truth: per pixel for depth and segmentation together, at least and at most, and per frame for the
# rest. Source: measured at 640x480, 0.09 per pixel in the scene camera and 0.12 in the wrist camera, and 600 per frame.
_LEAST_TRUTH, _MOST_TRUTH, _PER_TRUTH = 0.04, 0.4, 1500
# Bytes that stay free, for the ledger, the manifest, and other programs.
_RESERVE = 1_000_000


@dataclass(frozen=True)
class EpisodeSize:
    """The room that an episode takes on a disk: bytes at least and at most, and inodes."""

    least: int
    most: int
    inodes: int

    @classmethod
    def expected(cls, frames: int, cameras: int, image: ImageConfig, block: int, *, truth: bool = False) -> EpisodeSize:
        """An estimate from the settings alone.

        Args:
            block: bytes that the filesystem hands out at a time.
            truth: whether ground truth is recorded too.
        """
        pixels = image.size_px[0] * image.size_px[1]

        def total(per_pixel: float, per_image: int, per_truth: float) -> int:
            picture = _blocks(per_image + per_pixel * pixels, block)
            if truth:
                picture += 2 * _blocks(per_truth * pixels / 2, block) + _PER_TRUTH
            record = _blocks(_PER_HASH * files_per_episode(frames, cameras, truth=truth), block)
            return frames * (cameras * picture + _blocks(_PER_LOWDIM, block)) + record

        # The episode's directory, `rgb`, `lowdim`, a folder per camera, and `episode.json`. With truth also `depth`,
        # `segmentation` and `truth`, and two more folders per camera.
        inodes = files_per_episode(frames, cameras, truth=truth) + cameras + 4 + (3 + 2 * cameras if truth else 0)
        least = total(_LEAST_PER_PIXEL, _LEAST_PER_IMAGE, _LEAST_TRUTH)
        return cls(least, total(_MOST_PER_PIXEL, _MOST_PER_IMAGE, _MOST_TRUTH), inodes)

    def learned(self, entries: Collection[ManifestEntry], files: int, block: int) -> EpisodeSize:
        """A better estimate, from episodes that are already there and have `files` files each."""
        if not entries:
            return self
        mean = sum(entry.bytes for entry in entries) / len(entries)
        # On average, half a block is lost at the end of each file.
        mean += files * block / 2
        return EpisodeSize(int(0.9 * mean), int(1.2 * mean), self.inodes)


def files_per_episode(frames: int, cameras: int, *, truth: bool) -> int:
    """How many files an episode has, not counting its `episode.json`."""
    return frames * (cameras + 1) + (2 * frames * cameras + cameras + 1 if truth else 0)


def block_size(place: Path) -> int:
    """Bytes that the filesystem at `place`, a directory, hands out at a time."""
    return os.statvfs(place).f_frsize


def check_space(place: Path, episodes: int, size: EpisodeSize) -> str | None:
    """Compare the free space with what `episodes` more episodes will take.

    Returns:
        A warning if they may not fit; None if they will.

    Raises:
        ResourceError: they cannot fit.
    """
    state = os.statvfs(place)
    free = max(0, state.f_bavail * state.f_frsize - _RESERVE)
    # Filesystems that make inodes as needed report that they have none.
    inodes = state.f_favail if state.f_files else math.inf
    fit = int(min(free / size.least, inodes / size.inodes))
    verb = "takes" if episodes == 1 else "take"
    takes = (
        f"{counted(episodes, 'episode')} {verb} {size.inodes * episodes} files and at least "
        f"{_amount(size.least * episodes)}"
    )
    there = f"{place} has room for {_amount(free)}" + ("" if inodes == math.inf else f" in {inodes} files")
    if fit < episodes:
        raise ResourceError(f"{takes}, but {there}: {fit} fit; make room, choose another --out, or a smaller --n")
    if free < size.most * episodes:
        return (
            f"{takes}, perhaps {_amount(size.most * episodes)}, and {there}: watch it. --resume goes on if it fills up."
        )
    return None


def _blocks(size: float, block: int) -> int:
    return math.ceil(size / block) * block


def _amount(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
