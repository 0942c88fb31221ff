"""Estimates the size of a recording, and checks before it starts that the disk has room."""

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

_LEAST_PER_PIXEL = 0.03  # bytes of a JPEG per pixel, lower bound: plain scenes at low quality
# JPEG quality -> bytes per pixel of a typical image. Source: the pictures of docs/images and tests/golden, 300 to 720
# pixels wide, encoded at each quality. Noise (`--randomize`) doubles it.
_LIKELY_PER_PIXEL = {1: 0.03, 50: 0.055, 70: 0.072, 85: 0.1, 95: 0.18, 100: 0.32}
_PER_IMAGE = 600  # bytes of a JPEG besides its pixels: headers and tables
_PER_LOWDIM = 2200  # bytes of a frame's lowdim pickle; measured, 1600 to 2200
_PER_HASH = 85  # bytes in an episode's record for each of its files; measured, 85 to 95
# Bytes of ground truth per pixel, depth and segmentation together: lower bound, and typical. Source: measured at
# 640x480, 0.09 in the scene camera and 0.12 in the wrist camera.
_LEAST_TRUTH, _LIKELY_TRUTH = 0.04, 0.11
_PER_TRUTH = 1000  # bytes of ground truth per frame besides images; measured, 600
_RESERVE = 1_000_000  # bytes that stay free, for the ledger, the manifest and other programs
_LEAST_OF_MEAN = 0.9  # share of the mean recorded episode that others take at least, where all have as many frames


@dataclass(frozen=True)
class EpisodeSize:
    """The size of an episode on a disk.

    Attributes:
        least, likely: lower bound and estimate of bytes.
        least_inodes, inodes: lower bound and estimate of inodes.
    """

    least: int
    likely: int
    least_inodes: int
    inodes: int

    @classmethod
    def estimate(
        cls, frames: tuple[int, int], cameras: int, image: ImageConfig, block: int, *, truth: bool = False
    ) -> EpisodeSize:
        """An estimate from the settings alone.

        Args:
            frames: of an episode, at least and typically.
            block: size of the filesystem's blocks, bytes.
            truth: whether ground truth is recorded.
        """
        pixels = image.size_px[0] * image.size_px[1]
        qualities = list(_LIKELY_PER_PIXEL)
        likely_per_pixel = float(np.interp(image.jpeg_quality, qualities, [_LIKELY_PER_PIXEL[q] for q in qualities]))

        def total(count: int, per_pixel: float, per_truth: float) -> int:
            picture = _round_up_to_blocks(_PER_IMAGE + per_pixel * pixels, block)
            if truth:
                picture += 2 * _round_up_to_blocks(per_truth * pixels / 2, block) + _PER_TRUTH
            record = _round_up_to_blocks(_PER_HASH * files_per_episode(count, cameras, truth=truth), block)
            return count * (cameras * picture + _round_up_to_blocks(_PER_LOWDIM, block)) + record

        # The episode's directory, `rgb`, `lowdim`, a folder per camera, and `episode.json`. With truth also `depth`,
        # `segmentation` and `truth`, and two more folders per camera.
        besides = cameras + 4 + (3 + 2 * cameras if truth else 0)
        least_inodes, inodes = (files_per_episode(count, cameras, truth=truth) + besides for count in frames)
        return cls(
            total(frames[0], _LEAST_PER_PIXEL, _LEAST_TRUTH),
            total(frames[1], likely_per_pixel, _LIKELY_TRUTH),
            least_inodes,
            inodes,
        )

    def from_recorded(self, entries: Collection[ManifestEntry], block: int) -> EpisodeSize:
        """The size with the bytes of recorded episodes; `self` if there are none."""
        if not entries:
            return self
        # On average, half a block is lost at the end of each file.
        mean = sum(entry.bytes for entry in entries) / len(entries) + self.inodes * block / 2
        least = _LEAST_OF_MEAN * mean * self.least_inodes / self.inodes
        return replace(self, least=int(least), likely=int(mean))


def files_per_episode(frames: int, cameras: int, *, truth: bool) -> int:
    """Number of an episode's files, without `episode.json`."""
    return frames * (cameras + 1) + (2 * frames * cameras + cameras + 1 if truth else 0)


def check_space(place: Path, episodes: int, size: EpisodeSize) -> str | None:
    """Compare the free space with the size of `episodes` more episodes.

    Returns:
        A warning if the episodes may not fit, or None.

    Raises:
        ResourceError: the episodes cannot fit.
    """
    state = os.statvfs(place)
    free = max(0, state.f_bavail * state.f_frsize - _RESERVE)
    # Filesystems that make inodes on demand report none.
    inodes = state.f_favail if state.f_files else math.inf
    fit = int(min(free / size.least, inodes / size.least_inodes))
    verb = "takes" if episodes == 1 else "take"
    takes = (
        f"{count_noun(episodes, 'episode')} {verb} at least {size.least_inodes * episodes} files and "
        f"{_format_size(size.least * episodes)}"
    )
    there = f"{place} has room for {_format_size(free)}" + ("" if inodes == math.inf else f" in {inodes} files")
    if fit < episodes:
        raise ResourceError(f"{takes}, but {there}: {fit} fit; make room, choose another --out, or a smaller --n")
    if free < size.likely * episodes or inodes < size.inodes * episodes:
        return (
            f"{takes}, probably {size.inodes * episodes} files and {_format_size(size.likely * episodes)}, and {there}: "
            "if the disk fills up, continue with --resume."
        )
    return None


def _round_up_to_blocks(size: float, block: int) -> int:
    return math.ceil(size / block) * block


def _format_size(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"
