"""Read the attempt ledger, `attempts.jsonl`, and restore damaged lines from the episodes.

Intact lines keep their bytes, so a restored ledger differs only where it was damaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...errors import DatasetError
from ...files.writing import write_file
from ..dataset_paths import LEDGER_FILE, episode_name
from ..records import AttemptRecord, EpisodeRecord, OutcomeRecord, from_json, to_json
from .integrity import quarantine_path

# Outcome of an attempt whose ledger line is lost and that has not been simulated again.
LOST_LINE_OUTCOME = OutcomeRecord(
    success=False,
    cause="line_lost",
    detail=f"its line in {LEDGER_FILE} could not be read",
    dxy_m=None,
    dz_m=None,
    speed_mps=None,
    plan_error_m=None,
    tilt_rad=None,
)


class Ledger:
    """The content of a dataset's `attempts.jsonl`.

    Attributes:
        known: attempt number -> record, from intact lines, in order.
        fault: the first fault of the file, or None. A truncated last line is not a fault.
    """

    def __init__(self, dataset: Path) -> None:
        """Read the file. A missing file holds no attempts. A truncated last line is ignored."""
        self._file = dataset / LEDGER_FILE
        self.known_attempts: dict[int, AttemptRecord] = {}
        self.fault: str | None = None
        self._lines: dict[int, bytes] = {}
        self._read = self._file.read_bytes() if self._file.is_file() else b""
        lines = self._read.split(b"\n")
        for number, line in enumerate(lines, start=1):
            if line:
                self._read_line(number, line, last=number == len(lines))
        self.known_attempts = dict(sorted(self.known_attempts.items()))

    def _read_line(self, number: int, line: bytes, *, last: bool) -> None:
        try:
            attempt = from_json(AttemptRecord, line, f"line {number}")
            if attempt.attempt < 0:
                raise DatasetError(f"line {number}: attempt: {attempt.attempt} is not the number of an attempt")
        except DatasetError as error:
            if not last:
                self.fault = self.fault or str(error)
            return
        if attempt.attempt in self.known_attempts:
            self.fault = self.fault or f"line {number}: attempt {attempt.attempt} is listed twice"
            if attempt.attempt != number - 1:
                # The earlier line of this attempt is at the correct position.
                return
        self._store_line(attempt, line + b"\n")

    def _store_line(self, attempt: AttemptRecord, line: bytes) -> None:
        self.known_attempts[attempt.attempt] = attempt
        self._lines[attempt.attempt] = line

    @property
    def missing_attempts(self) -> set[int]:
        """Numbers of the attempts before the last known attempt whose lines are lost."""
        return set(range(max(self.known_attempts, default=-1))) - self.known_attempts.keys()

    def restore_lost_lines(self, episodes: Sequence[EpisodeRecord]) -> None:
        """Restore lost lines from the intact episodes of the dataset, and drop lines that contradict the episodes.

        Raises:
            DatasetError: an episode and the ledger contradict each other, and neither is known to be correct.
        """
        made = {record.episode: record for record in episodes}
        for attempt in list(self.known_attempts.values()):
            if attempt.episode in made and made[attempt.episode].attempt != attempt.attempt:
                name, other = episode_name(attempt.episode), made[attempt.episode].attempt
                self.fault = (
                    self.fault or f"attempt {attempt.attempt} is listed as {name}, but {name} is attempt {other}"
                )
                del self.known_attempts[attempt.attempt], self._lines[attempt.attempt]
        for record in episodes:
            line = self.known_attempts.get(record.attempt)
            if line is not None and line.episode != record.episode:
                raise DatasetError(
                    f"{self._file.parent / episode_name(record.episode)} is attempt {record.attempt}, "
                    f"but {LEDGER_FILE} lists another episode for this attempt; the dataset cannot be resumed"
                )
            if line is None:
                adopted = AttemptRecord.model_validate(
                    {key: getattr(record, key) for key in AttemptRecord.model_fields}
                )
                self._store_line(adopted, to_json(adopted))
        self._check_order()
        self._drop_failures_after_gap()
        self.known_attempts = dict(sorted(self.known_attempts.items()))

    def _check_order(self) -> None:
        numbers = [self.known_attempts[number].episode for number in sorted(self.known_attempts)]
        episodes = [number for number in numbers if number is not None]
        if episodes != sorted(set(episodes)):
            raise DatasetError(
                f"{self._file.parent} has episodes that are not in the order of their attempts; it cannot be resumed"
            )

    def _drop_failures_after_gap(self) -> None:
        """Drop failed attempts after a gap if no episode follows them. They are simulated again if needed."""
        last = max(
            (number for number, attempt in self.known_attempts.items() if attempt.episode is not None), default=-1
        )
        while last + 1 in self.known_attempts:
            last += 1
        for number in [number for number in self.known_attempts if number > last]:
            self.fault = self.fault or f"attempt {number} is listed, but attempt {last + 1} is missing"
            del self.known_attempts[number], self._lines[number]

    def insert_lost_attempt(self, attempt: AttemptRecord) -> None:
        """Insert the line of an attempt whose line was lost. After an OSError the file is unchanged."""
        self._store_line(attempt, to_json(attempt))
        self._write_lines()

    def repair_file(self) -> Path | None:
        """Rewrite the ledger file if it differs from `known_attempts`. After an OSError the file is unchanged.

        Returns:
            Path of a copy of the damaged file; None if the file was not damaged.
        """
        if self._read == self._ledger_bytes():
            return None
        kept = None
        if self.fault is not None:
            # Copy instead of move, so that a ledger exists at all times.
            kept = quarantine_path(self._file)
            write_file(kept, self._read)
        self._write_lines()
        return kept

    def _ledger_bytes(self) -> bytes:
        return b"".join(self._lines[number] for number in sorted(self._lines))

    def _write_lines(self) -> None:
        write_file(self._file, self._ledger_bytes())


def missing_episode(attempts: Sequence[AttemptRecord], attempt: int) -> int | None:
    """Return the episode number that an attempt must have if it succeeded.

    Episodes are numbered in order of attempts. None means that the attempt failed: the episodes before and after it
    leave no number free.
    """
    before = [record.episode for record in attempts[:attempt] if record.episode is not None]
    after = [record.episode for record in attempts[attempt:] if record.episode is not None]
    number = before[-1] + 1 if before else 0
    return number if not after or after[0] > number else None


def placeholder_record(attempt: int, seed: int) -> AttemptRecord:
    """Return a record that marks an attempt as failed because its ledger line is lost."""
    return AttemptRecord(attempt=attempt, seed=seed, episode=None, outcome=LOST_LINE_OUTCOME, layout={})
