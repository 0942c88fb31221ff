"""Records onto a local disk, and moves finished episodes to a slow or remote dataset in the background.

One thread alone writes the dataset, by a `DatasetWriter`, episode by episode in the order of recording. The dataset is
therefore whole at every moment and can be resumed, and the stage holds only episodes on their way. Episodes of a lost
stage are made again, and no byte of the result changes.

<stage>/<name>-<hash of the dataset's path>/config.yaml
attempts.jsonl         attempts since the dataset was last opened
ep_000007/             episodes on their way
"""

from __future__ import annotations

import contextlib
import queue
import shutil
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import DatasetError, ResourceError
from ...files.documents.yaml_document import dump_yaml
from ...files.writing import append_line, move_to_backup, publish_directory, sha256_bytes, write_file
from ..dataset_paths import ATTEMPTS, CONFIG, EPISODE, STAGING, episode_directories, episode_name
from ..disk_errors import describe_disk_error
from ..records import AttemptRecord, EpisodeRecord, from_json, to_json
from .directory_claim import DirectoryLock
from .integrity import inspect_episode
from .writer import AttemptLog, DatasetWriter

MAX_WAITING = 100  # attempts on their way; limits the space on the local disk if the target is slow
_HALT_SECONDS = 10.0  # s, that moving one episode may take after the recording has ended


@dataclass(frozen=True)
class _StagedItem:
    """An episode to move, an attempt to log after it, or both."""

    episode: int | None
    attempt: AttemptRecord | None


class StagedWriter(AttemptLog):
    """Takes a recording as a `DatasetWriter` does, and passes it on to a `DatasetWriter`.

    Attributes:
        folder: this dataset's directory in the stage.
    """

    def __init__(self, target: DatasetWriter, stage: Path, config: Mapping[str, Any]) -> None:
        """Continue with what an earlier recording left on its way.

        Args:
            target: the dataset, open for writing; from now on only this object uses `target`.
            stage: a directory on a local disk, made if missing. Several datasets can share a stage.

        Raises:
            ResourceError: the stage cannot be made or written, or another recorder uses it.
        """
        super().__init__(target.path)
        self.attempts = list(target.attempts)
        self.episodes = target.episodes
        self.missing = target.missing
        # A copy, since the target's own set changes in another thread.
        self.lost_lines = set(target.lost_lines)
        self._target = target
        self._error: BaseException | None = None
        self._halt = threading.Event()
        self.folder = stage / f"{target.path.name}-{sha256_bytes(str(target.path.absolute()).encode())[:12]}"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = DirectoryLock.acquire(self.folder)
            try:
                waiting = self._take_up(dump_yaml(config).encode())
            except BaseException:
                self._lock.release()
                raise
        except OSError as error:
            raise ResourceError(
                f"the stage {self.folder} cannot be used: {describe_disk_error(error, stage)}; choose another --stage"
            ) from error
        self._queue: queue.Queue[_StagedItem] = queue.Queue(max(MAX_WAITING, len(waiting)))
        for attempt in waiting:
            self._queue.put(_StagedItem(attempt.episode, attempt))
        self._move_thread = threading.Thread(target=self._move_all, name="yamsim-mover", daemon=True)
        self._move_thread.start()

    @property
    def pending_episodes(self) -> int:
        """How many episodes are in the stage, and not yet in the dataset."""
        return len(episode_directories(self.folder)) if self.folder.is_dir() else 0

    def publish(self, record: EpisodeRecord, files: Mapping[str, bytes]) -> None:
        """Put one episode into the stage; see `DatasetWriter.publish`."""
        self._raise_error()
        publish_directory(
            self.folder / episode_name(record.episode), {**files, EPISODE: to_json(record)}, self.folder / STAGING
        )
        if record.attempt < len(self.attempts):
            # The attempt is in the ledger already, and is not logged again.
            self._put(_StagedItem(record.episode, None))

    def log(self, attempt: AttemptRecord) -> None:
        """Add one attempt; waits while too many are on their way. See `DatasetWriter.log`."""
        self._raise_error()
        if attempt.attempt in self.lost_lines:
            # The attempt's episode, if any, is on its way already. If the stage is lost, the episode is made again.
            self._restore(attempt)
            self._put(_StagedItem(None, attempt))
            return
        append_line(self.folder / ATTEMPTS, to_json(attempt).decode().rstrip("\n"))
        self._count(attempt)
        self._put(_StagedItem(attempt.episode, attempt))

    def drain(self, seconds: float) -> bool:
        """Wait at most `seconds` until everything has arrived in the dataset; returns whether it has.

        Raises:
            OSError, DatasetError: something cannot be moved.
        """
        end = time.monotonic() + seconds
        with self._queue.all_tasks_done:
            while self._queue.unfinished_tasks and self._error is None and time.monotonic() < end:
                self._queue.all_tasks_done.wait(max(0.0, end - time.monotonic()))
            done = not self._queue.unfinished_tasks
        self._raise_error()
        return done

    def finish(self) -> None:
        """Stop the mover, and write the dataset's manifest. An empty stage is removed."""
        arrived = not self._queue.unfinished_tasks
        if not self._end_moving():
            # The target does not answer, and would block this thread, too.
            return
        self._target.finish()
        if arrived and self._error is None:
            shutil.rmtree(self.folder, ignore_errors=True)

    def close(self) -> None:
        """Stop the mover, and release the stage."""
        self._end_moving()
        self._lock.release()

    def _end_moving(self) -> bool:
        """Let the mover finish its current episode; False if that takes longer than `_HALT_SECONDS`."""
        self._halt.set()
        with contextlib.suppress(queue.Full):
            # This item only wakes the mover. From a full queue the mover gets another item.
            self._queue.put_nowait(_StagedItem(None, None))
        self._move_thread.join(_HALT_SECONDS)
        return not self._move_thread.is_alive()

    def _put(self, item: _StagedItem) -> None:
        # Waits in small steps while the queue is full, to notice an error of the mover.
        while True:
            self._raise_error()
            with contextlib.suppress(queue.Full):
                self._queue.put(item, timeout=0.5)
                return

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _move_all(self) -> None:
        while True:
            item = self._queue.get()
            if self._halt.is_set():
                return
            try:
                self._move(item)
            # The recording's thread raises any error at its next call. What was not moved stays in the stage.
            except BaseException as error:  # noqa: BLE001
                with self._queue.all_tasks_done:
                    self._error = error
                    self._queue.all_tasks_done.notify_all()
                return
            self._queue.task_done()

    def _move(self, item: _StagedItem) -> None:
        if item.episode is not None:
            directory = self.folder / episode_name(item.episode)
            found = inspect_episode(item.episode, directory)
            if found.record is None or found.fault:
                raise DatasetError(f"{directory} was damaged on its way: {found.fault}; --resume makes it again")
            self._target.publish(found.record, {name: (directory / name).read_bytes() for name in found.record.files})
        if item.attempt is not None:
            self._target.log(item.attempt)
        if item.episode is not None:
            shutil.rmtree(directory)

    def _take_up(self, config: bytes) -> list[AttemptRecord]:
        """The attempts that an earlier recording left; everything else in the stage is removed or moved aside."""
        file = self.folder / CONFIG
        if not file.is_file() or file.read_bytes() != config:
            # The content belongs to another dataset or config, and must not be deleted.
            self._start_empty(config)
        waiting = []
        for attempt in self._logged():
            if attempt.attempt == len(self.attempts) and self._is_here(attempt):
                self._count(attempt)
                waiting.append(attempt)
        kept = {attempt.episode for attempt in waiting}
        write_file(self.folder / ATTEMPTS, b"".join(map(to_json, waiting)))
        for number, directory in episode_directories(self.folder):
            if number not in kept:
                # The episode has arrived already; or it is not in the stage's own ledger yet, and is made again.
                shutil.rmtree(directory)
        shutil.rmtree(self.folder / STAGING, ignore_errors=True)
        return waiting

    def _start_empty(self, config: bytes) -> None:
        if episode_directories(self.folder):
            moved = move_to_backup(self.folder)
            self._lock.note_rename(moved)
            self._lock.release()
            self.repairs.append(f"The stage held episodes of another recording: they are now in {moved}.")
            self.folder.mkdir()
            self._lock = DirectoryLock.acquire(self.folder)
        write_file(self.folder / CONFIG, config)

    def _logged(self) -> list[AttemptRecord]:
        """The stage's ledger, up to the first line that a crash left incomplete."""
        file = self.folder / ATTEMPTS
        attempts: list[AttemptRecord] = []
        for line in file.read_bytes().splitlines() if file.is_file() else []:
            try:
                attempts.append(from_json(AttemptRecord, line, file))
            except DatasetError:
                break
        return attempts

    def _is_here(self, attempt: AttemptRecord) -> bool:
        if attempt.episode is None:
            return True
        found = inspect_episode(attempt.episode, self.folder / episode_name(attempt.episode))
        return found.record is not None and found.fault is None and found.record.attempt == attempt.attempt


# What records episodes: straight into the dataset, or by way of a stage.
Sink = DatasetWriter | StagedWriter
