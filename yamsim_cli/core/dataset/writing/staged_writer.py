"""Record to a local staging directory, and move finished episodes to a slow or remote dataset in the background.

A single thread writes the dataset with a `DatasetWriter`, episode by episode in recording order. The dataset is
therefore consistent at all times and can be resumed. The staging directory holds only episodes that wait to be moved.
Episodes of a lost staging directory are recorded again, with identical bytes.

<stage>/<name>-<hash of the dataset's path>/config.yaml
attempts.jsonl         attempts since the dataset was last opened
ep_000007/             episodes that wait to be moved
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

from ...errors import ConfigError, DatasetError, ResourceError
from ...files.documents.yaml_document import dump_yaml, load_yaml
from ...files.writing import append_line, move_to_backup, publish_directory, sha256_bytes, write_file
from ..dataset_paths import CONFIG_FILE, EPISODE_FILE, LEDGER_FILE, STAGING_FOLDER, episode_directories, episode_name
from ..disk_errors import describe_disk_error
from ..records import AttemptRecord, EpisodeRecord, from_json, to_json
from ..upgrade import upgrade_config
from .directory_claim import DirectoryLock, require_same_config
from .integrity import inspect_episode
from .writer import AttemptLog, DatasetWriter

MAX_WAITING = 100  # attempts that wait to be moved; limits the local disk space if the target is slow
HALT_SECONDS = 10.0  # s, longest wait for the episode in transfer when the writer stops


@dataclass(frozen=True)
class _StagedItem:
    """An episode to move, an attempt to log after it, or both."""

    episode: int | None
    attempt: AttemptRecord | None


class StagedWriter(AttemptLog):
    """Writer with the interface of `DatasetWriter` that passes episodes and attempts on to a `DatasetWriter`.

    Attributes:
        folder: subdirectory of the stage for this dataset.
    """

    def __init__(self, target: DatasetWriter, stage: Path, config: Mapping[str, Any]) -> None:
        """Open the stage and continue to move the episodes that an earlier recording left there.

        Args:
            target: the dataset, open for writing. Only this object may use `target` from now on.
            stage: a directory on a local disk, created if missing. Several datasets can share a stage.
            config: configuration of the recording, as in the dataset's config.yaml.

        Raises:
            ResourceError: the stage cannot be created or written, or another recorder uses it.
        """
        super().__init__(target.path)
        self.attempts = list(target.attempts)
        self.episodes = target.episodes
        self.attempts_without_episode = target.attempts_without_episode
        # Copied because the move thread changes the set of `target`.
        self.lost_lines = set(target.lost_lines)
        self._target = target
        self._error: BaseException | None = None
        self._halt = threading.Event()
        self.folder = stage / f"{target.path.name}-{sha256_bytes(str(target.path.absolute()).encode())[:12]}"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = DirectoryLock.acquire(self.folder)
            try:
                waiting = self._recover_unmoved_attempts(config)
            except BaseException:
                self._lock.release()
                raise
        except OSError as error:
            raise ResourceError(
                f"the staging directory {self.folder} cannot be used: {describe_disk_error(error, stage)}; "
                "choose another --stage"
            ) from error
        self._queue: queue.Queue[_StagedItem] = queue.Queue(max(MAX_WAITING, len(waiting)))
        for attempt in waiting:
            self._queue.put(_StagedItem(attempt.episode, attempt))
        self._move_thread = threading.Thread(target=self._move_queued_items, name="yamsim-mover", daemon=True)
        self._move_thread.start()

    @property
    def pending_episodes(self) -> int:
        """Number of episodes that are in the stage and not yet in the dataset."""
        return len(episode_directories(self.folder)) if self.folder.is_dir() else 0

    def publish_episode(self, record: EpisodeRecord, files: Mapping[str, bytes]) -> None:
        """Write one episode atomically to the stage, from which the move thread moves it to the dataset."""
        self._raise_error()
        publish_directory(
            self.folder / episode_name(record.episode),
            {**files, EPISODE_FILE: to_json(record)},
            self.folder / STAGING_FOLDER,
        )
        if record.attempt < len(self.attempts):
            # `self.attempts` already has the attempt, so `log_attempt` does not queue its episode.
            self._queue_item(_StagedItem(record.episode, None))

    def log_attempt(self, attempt: AttemptRecord) -> None:
        """Log an attempt, and queue it for the dataset. Blocks while `MAX_WAITING` attempts wait to be moved."""
        self._raise_error()
        if attempt.attempt in self.lost_lines:
            # `publish_episode` has queued the episode, if any. If the stage is lost, the episode is recorded again.
            self._restore_lost_attempt(attempt)
            self._queue_item(_StagedItem(None, attempt))
            return
        append_line(self.folder / LEDGER_FILE, to_json(attempt).decode().rstrip("\n"))
        self._add_attempt(attempt)
        self._queue_item(_StagedItem(attempt.episode, attempt))

    def wait_until_moved(self, seconds: float) -> bool:
        """Return whether all items are moved within `seconds`. Raise OSError or DatasetError if one cannot be moved."""
        end = time.monotonic() + seconds
        with self._queue.all_tasks_done:
            while self._queue.unfinished_tasks and self._error is None and time.monotonic() < end:
                self._queue.all_tasks_done.wait(max(0.0, end - time.monotonic()))
            done = not self._queue.unfinished_tasks
        self._raise_error()
        return done

    def write_manifest(self) -> None:
        """Stop the move thread and write the dataset manifest. Remove the stage if all items were moved."""
        arrived = not self._queue.unfinished_tasks
        if not self._stop_move_thread():
            # The move thread still waits for the target, which would block this thread too.
            return
        self._target.write_manifest()
        if arrived and self._error is None:
            shutil.rmtree(self.folder, ignore_errors=True)

    def close(self) -> None:
        """Stop the move thread and release the lock of the stage."""
        self._stop_move_thread()
        self._lock.release()

    def _stop_move_thread(self) -> bool:
        """Let the move thread finish its current item. Return False if that exceeds `HALT_SECONDS`."""
        self._halt.set()
        with contextlib.suppress(queue.Full):
            # This item only wakes the move thread. If the queue is full, the thread wakes without it.
            self._queue.put_nowait(_StagedItem(None, None))
        self._move_thread.join(HALT_SECONDS)
        return not self._move_thread.is_alive()

    def _queue_item(self, item: _StagedItem) -> None:
        # While the queue is full, wait in short steps to notice an error of the move thread.
        while True:
            self._raise_error()
            with contextlib.suppress(queue.Full):
                self._queue.put(item, timeout=0.5)
                return

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _move_queued_items(self) -> None:
        while True:
            item = self._queue.get()
            if self._halt.is_set():
                return
            try:
                self._move_item(item)
            # The recording thread raises the error at its next call. Items that were not moved stay in the stage.
            except BaseException as error:  # noqa: BLE001
                with self._queue.all_tasks_done:
                    self._error = error
                    self._queue.all_tasks_done.notify_all()
                return
            self._queue.task_done()

    def _move_item(self, item: _StagedItem) -> None:
        if item.episode is not None:
            directory = self.folder / episode_name(item.episode)
            found = inspect_episode(item.episode, directory)
            if found.record is None or found.fault:
                raise DatasetError(f"{directory} was damaged in transfer: {found.fault}; --resume records it again")
            self._target.publish_episode(
                found.record, {name: (directory / name).read_bytes() for name in found.record.files}
            )
        if item.attempt is not None:
            self._target.log_attempt(item.attempt)
        if item.episode is not None:
            shutil.rmtree(directory)

    def _recover_unmoved_attempts(self, config: Mapping[str, Any]) -> list[AttemptRecord]:
        """Return the attempts that an earlier recording left. Remove or back up all other content of the stage."""
        try:
            require_same_config(self.folder, upgrade_config(load_yaml(self.folder / CONFIG_FILE).data), config)
        except ConfigError:
            # The content belongs to another dataset or config and must not be deleted.
            self._start_empty_stage(config)
        waiting = []
        for attempt in self._read_log():
            if attempt.attempt == len(self.attempts) and self._is_staged(attempt):
                self._add_attempt(attempt)
                waiting.append(attempt)
        kept = {attempt.episode for attempt in waiting}
        write_file(self.folder / LEDGER_FILE, b"".join(map(to_json, waiting)))
        for number, directory in episode_directories(self.folder):
            if number not in kept:
                # The episode is already in the dataset, or is missing in the stage's ledger and will be recorded again.
                shutil.rmtree(directory)
        shutil.rmtree(self.folder / STAGING_FOLDER, ignore_errors=True)
        return waiting

    def _start_empty_stage(self, config: Mapping[str, Any]) -> None:
        if episode_directories(self.folder):
            moved = move_to_backup(self.folder)
            self._lock.note_rename(moved)
            self._lock.release()
            self.repairs.append(f"The staging directory held episodes of another recording: they are now in {moved}.")
            self.folder.mkdir()
            self._lock = DirectoryLock.acquire(self.folder)
        write_file(self.folder / CONFIG_FILE, dump_yaml(config).encode())

    def _read_log(self) -> list[AttemptRecord]:
        file = self.folder / LEDGER_FILE
        attempts: list[AttemptRecord] = []
        for line in file.read_bytes().splitlines() if file.is_file() else []:
            try:
                attempts.append(from_json(AttemptRecord, line, file))
            except DatasetError:
                break
        return attempts

    def _is_staged(self, attempt: AttemptRecord) -> bool:
        if attempt.episode is None:
            return True
        found = inspect_episode(attempt.episode, self.folder / episode_name(attempt.episode))
        return found.record is not None and found.fault is None and found.record.attempt == attempt.attempt


# Writer of a recording: directly into the dataset, or through a stage.
EpisodeWriter = DatasetWriter | StagedWriter
