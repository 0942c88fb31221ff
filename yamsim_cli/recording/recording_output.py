"""Output of a recording, written directly or through a staging directory."""

from __future__ import annotations

import contextlib
import math
import os
import statistics
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core.config.recording import RecordConfig
from ..core.dataset.records import ManifestEntry
from ..core.dataset.writing.directory_claim import ExistingDatasetMode
from ..core.dataset.writing.staged_writer import MAX_WAITING, EpisodeWriter, StagedWriter
from ..core.dataset.writing.writer import DatasetWriter, config_for_new_episodes
from ..core.errors import InterruptedJobError
from ..core.expert.skills.program import typical_tick_count
from ..core.files.writing import nearest_directory
from ..core.workers.stop_request import StopRequest
from ..filesystem_mounts import Mount, network_mount, read_mounts
from .collect import RecordCallbacks
from .disk_space import EpisodeSize, check_space, files_per_episode

_ROUND_TRIPS_PER_FILE = 6  # over sshfs: 60 ms at 10 ms per round trip
_NETWORK_ROUND_TRIP = 0.01  # s, that warnings assume
_POLL_SECONDS = 0.5  # s between checks of the stop request
_MIN_DURATION = 0.5  # frames of a successful episode, as a share of the typical number


@dataclass(frozen=True)
class RecordingOutput:
    """Output directory of a recording. With a slow or remote `path`, episodes wait in the local directory `stage`."""

    path: Path
    mode: ExistingDatasetMode
    stage: Path | None = None


class OpenRecordingOutput:
    """An output that is open for writing. `config` is the result of `config_for_new_episodes`."""

    def __init__(self, config: RecordConfig, writer: DatasetWriter, staged: StagedWriter | None) -> None:
        self.config = config_for_new_episodes(config, writer)
        self.writer = writer
        self._staged = staged

    @property
    def episode_writer(self) -> EpisodeWriter:
        """The writer for new episodes."""
        return self._staged or self.writer

    @property
    def describe_staged(self) -> str:
        """Clause for messages on how many episodes are still in the staging directory."""
        if self._staged is None or not (waiting := self._staged.pending_episodes):
            return ""
        return f" ({waiting} of them still in {self._staged.folder}: give the same --stage)"

    def finish(self, callbacks: RecordCallbacks, stop: StopRequest) -> None:
        """Wait until all episodes are in the dataset, and write the manifest."""
        if self._staged is None:
            self.writer.write_manifest()
            return
        if waiting := self._staged.pending_episodes:
            callbacks.warn(f"Moving the last {waiting} episodes to {self.writer.path}.")
        while not self._staged.wait_until_moved(_POLL_SECONDS):
            if stop.is_requested:
                raise InterruptedJobError("interrupted")
        self._staged.write_manifest()

    def close_after_error(self) -> None:
        """Write the manifest and ignore disk errors; the next --resume writes it again."""
        with contextlib.suppress(OSError):
            (self._staged or self.writer).write_manifest()


@contextlib.contextmanager
def open_destination(
    config: RecordConfig, output: RecordingOutput, callbacks: RecordCallbacks
) -> Iterator[OpenRecordingOutput]:
    """Open an output for the `with` block, exclusively."""
    # Warn before any access to the mount, which may not respond.
    mount = _check_mounts(config, output, callbacks)
    resuming = output.mode is ExistingDatasetMode.RESUME
    if not resuming:
        # Check the space before anything is written: a leftover file would make the next recording fail.
        _check_space(config, output.path, {}, config.episodes, callbacks)
    data_config = config.data_config()
    reach = mount is None or mount.locks_reach_others
    with contextlib.ExitStack() as stack:
        writer = stack.enter_context(DatasetWriter(output.path, data_config, output.mode, locks_reach_others=reach))
        staged = None
        if output.stage is not None:
            staged = StagedWriter(writer, output.stage, writer.config)
            stack.callback(staged.close)
        for repair in writer.repairs + (staged.repairs if staged else []):
            callbacks.warn(repair)
        destination = OpenRecordingOutput(config, writer, staged)
        left = (
            config.episodes
            - destination.episode_writer.episodes
            + len(destination.episode_writer.attempts_without_episode)
        )
        if resuming:
            _check_space(config, writer.path, writer.entries, left, callbacks)
        if output.stage is not None:
            _check_space(config, output.stage, writer.entries, min(left, MAX_WAITING), callbacks)
        yield destination


def _check_mounts(config: RecordConfig, output: RecordingOutput, callbacks: RecordCallbacks) -> Mount | None:
    """Return the output's network mount, and warn that writing to it is slow."""
    mounts = read_mounts()
    mount = network_mount(output.path, mounts)
    if output.stage is None and mount is not None:
        frames = _frames_per_episode(config, {})[1]
        files = files_per_episode(frames, len(config.recorded_cameras), truth=config.truth)
        seconds = files * _ROUND_TRIPS_PER_FILE * _NETWORK_ROUND_TRIP
        callbacks.warn(
            f"{output.path} is on {mount.point}, which is {mount.kind} ({mount.source}): an episode has {files} files, "
            f"so writing one takes about {seconds:.0f} s at a latency of 10 ms, while workers wait. "
            "With --stage DIR, a local directory, yamsim writes episodes to DIR and moves them in the background."
        )
    if output.mode is ExistingDatasetMode.RESUME and mount is not None:
        callbacks.warn(f"Every file in {output.path} is read and compared first; over a network that may take minutes.")
    if output.stage is not None and (other := network_mount(output.stage, mounts)) is not None:
        callbacks.warn(
            f"The staging directory {output.stage} is also on a network, {other.kind} ({other.source}): choose a local "
            "disk."
        )
    return mount


def _check_space(
    config: RecordConfig, place: Path, entries: Mapping[int, ManifestEntry], episodes: int, callbacks: RecordCallbacks
) -> None:
    if episodes <= 0:
        return
    disk = nearest_directory(place)
    block = os.statvfs(disk).f_frsize
    frames = _frames_per_episode(config, entries)
    size = EpisodeSize.estimate(frames, len(config.recorded_cameras), config.image, block, truth=config.truth)
    if warning := check_space(disk, episodes, size.from_recorded(entries.values(), block)):
        callbacks.warn(warning)


def _frames_per_episode(config: RecordConfig, entries: Mapping[int, ManifestEntry]) -> tuple[int, int]:
    """Return lower bound and typical frames of an episode, from the mean of `entries` or else estimated."""
    every = config.task.timing.ticks_per_frame
    frames = math.ceil(typical_tick_count(config.task) / every)
    if entries:
        frames = round(statistics.fmean(entry.frames for entry in entries.values()))
    return math.ceil(_MIN_DURATION * frames), frames
