from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.config.rendering import ImageConfig
from ..core.dataset.records import ManifestEntry
from ..core.errors import ResourceError, count_noun

_MIN_JPEG_PER_PIXEL = 0.03  # bytes per pixel, of plain scenes at low quality
# JPEG quality -> bytes per pixel of a typical image. Source: the images of docs/images and tests/golden, 300 to 720
# pixels wide. Noise (`--randomize`) doubles these values.
_JPEG_PER_PIXEL = {1: 0.03, 50: 0.055, 70: 0.072, 85: 0.1, 95: 0.18, 100: 0.32}
_JPEG_OVERHEAD = 600  # of headers and tables
_LOWDIM_BYTES = 2200  # of a frame; measured: 1600 to 2200
_HASH_BYTES = 85  # in an episode's record for each file; measured: 85 to 95
# Bytes of depth and segmentation together per pixel: lower bound and typical value. Source: at 640x480, 0.09 in the
# scene camera and 0.12 in the wrist camera.
_MIN_TRUTH_PER_PIXEL, _LIKELY_TRUTH_PER_PIXEL = 0.04, 0.11
_TRUTH_ARRAY_BYTES = 1000  # per frame and camera; measured: 600
_RESERVED_BYTES = 1_000_000  # for the ledger, the manifest and other programs
_MIN_SHARE_OF_MEAN = 0.9  # smallest size of an episode, as a share of the mean at equal numbers of frames


@dataclass(frozen=True)
class EpisodeSize:
    """Size of an episode on disk: lower bounds, and estimates of bytes (`likely`) and inodes."""

    min_bytes: int
    likely: int
    min_inodes: int
    inodes: int

    @classmethod
    def estimate(
        cls, frames: tuple[int, int], cameras: int, image: ImageConfig, block: int, *, truth: bool = False
    ) -> EpisodeSize:
        """Estimate the size of an episode from the recording settings.

        `frames` are a lower bound and the typical value per episode. `block` is the filesystem's block size, bytes.
        """
        pixels = image.size_px[0] * image.size_px[1]
        qualities = list(_JPEG_PER_PIXEL)
        likely_per_pixel = float(np.interp(image.jpeg_quality, qualities, [_JPEG_PER_PIXEL[q] for q in qualities]))

        def total_bytes(count: int, per_pixel: float, per_truth: float) -> int:
            picture = _round_up_to_blocks(_JPEG_OVERHEAD + per_pixel * pixels, block)
            if truth:
                picture += 2 * _round_up_to_blocks(per_truth * pixels / 2, block) + _TRUTH_ARRAY_BYTES
            record = _round_up_to_blocks(_HASH_BYTES * files_per_episode(count, cameras, truth=truth), block)
            return count * (cameras * picture + _round_up_to_blocks(_LOWDIM_BYTES, block)) + record

        # The episode directory, `rgb`, `lowdim`, one folder per camera, and `episode.json`. Truth adds `depth`,
        # `segmentation` and `truth`, and two folders per camera.
        besides = cameras + 4 + (3 + 2 * cameras if truth else 0)
        least_inodes, inodes = (files_per_episode(count, cameras, truth=truth) + besides for count in frames)
        return cls(
            total_bytes(frames[0], _MIN_JPEG_PER_PIXEL, _MIN_TRUTH_PER_PIXEL),
            total_bytes(frames[1], likely_per_pixel, _LIKELY_TRUTH_PER_PIXEL),
            least_inodes,
            inodes,
        )

    def from_recorded(self, entries: Collection[ManifestEntry], block: int) -> EpisodeSize:
        """Return a copy with bytes estimated from recorded episodes, if there are any."""
        if not entries:
            return self
        # On average, each file wastes half a block.
        mean = sum(entry.bytes for entry in entries) / len(entries) + self.inodes * block / 2
        least = _MIN_SHARE_OF_MEAN * mean * self.min_inodes / self.inodes
        return replace(self, min_bytes=int(least), likely=int(mean))


def files_per_episode(frames: int, cameras: int, *, truth: bool) -> int:
    """Return the number of files, without `episode.json`."""
    return frames * (cameras + 1) + (2 * frames * cameras + cameras + 1 if truth else 0)


def check_space(place: Path, episodes: int, size: EpisodeSize) -> str | None:
    """Warn if `episodes` more episodes may not fit into the free space at `place`."""
    state = os.statvfs(place)
    free = max(0, state.f_bavail * state.f_frsize - _RESERVED_BYTES)
    # Filesystems that create inodes on demand report zero inodes.
    inodes = state.f_favail if state.f_files else math.inf
    fit = int(min(free / size.min_bytes, inodes / size.min_inodes))
    verb = "takes" if episodes == 1 else "take"
    takes = (
        f"{count_noun(episodes, 'episode')} {verb} at least {size.min_inodes * episodes} files and "
        f"{_format_size(size.min_bytes * episodes)}"
    )
    there = f"{place} has room for {_format_size(free)}" + ("" if inodes == math.inf else f" in {inodes} files")
    if fit < episodes:
        raise ResourceError(f"{takes}, but {there}: {fit} fit; free some space, choose another --out, or a smaller --n")
    if free < size.likely * episodes or inodes < size.inodes * episodes:
        return (
            f"{takes}, probably {size.inodes * episodes} files and {_format_size(size.likely * episodes)}, "
            f"and {there}: if the disk fills up, continue with --resume."
        )
    return None


def _round_up_to_blocks(size: float, block: int) -> int:
    return math.ceil(size / block) * block


def _format_size(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
