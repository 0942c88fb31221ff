"""Fake attempts: small payloads that follow from their numbers, made in the test's process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from yamsim_cli.core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, ObjectLayout, Outcome
from yamsim_cli.core.closable import Closable
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import image_path, lowdim_path
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.ledger import Ledger
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.workers.executors import LostJobError
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.recorder import RecordReport, record
from yamsim_cli.recording.recording_output import RecordingOutput

FRAMES = 1


def payload(job: AttemptJob) -> AttemptPayload:
    """Every third attempt fails."""
    place = (0.3 + job.attempt / 1000, 0.0, 0.0, 1.0, 0.0, 0.0, float(job.seed % 3))
    attempt = Attempt(job, ObjectLayout.from_places({"banana": place}))
    if job.attempt % 3 == 1:
        return AttemptPayload(attempt, Outcome(False, FailureCause.OFF_TARGET, "far off", dxy=0.2, dz=0.0))
    names = [name for k in range(FRAMES) for name in (lowdim_path(k), image_path("scene_camera", k))]
    files = {name: f"{job.seed} {job.attempt} {name}".encode() * 3 for name in names}
    return AttemptPayload(
        attempt,
        Outcome(True, dxy=0.01, dz=0.0),
        files,
        FRAMES,
        "c0ffee",
        {"numpy": "2", "looks": "1", "engine": "1"},
        "none",
    )


@dataclass
class Inline(Closable):
    """An `Executor` that runs the newest job first when a result is requested, so that results come out of order.

    Attributes:
        make: gives a job's result; may raise.
        lose: attempts that end every worker.
    """

    make: Callable[[AttemptJob], AttemptPayload] = payload
    lose: set[int] = field(default_factory=set)
    workers: int = 2
    jobs: list[AttemptJob] = field(default_factory=list)
    made: list[int] = field(default_factory=list)

    def __call__(self, session: object, workers: int) -> Inline:
        self.workers = workers
        return self

    @property
    def idle(self) -> int:
        return self.workers - len(self.jobs)

    @property
    def in_flight(self) -> int:
        return len(self.jobs)

    def submit(self, job: AttemptJob) -> None:
        assert self.idle
        self.jobs.append(job)

    def next_result(self, timeout: float | None = None) -> tuple[AttemptJob, AttemptPayload]:
        job = self.jobs.pop()
        self.made.append(job.attempt)
        if job.attempt in self.lose:
            raise LostJobError(job, 3, "fell over")
        return job, self.make(job)

    def close(self) -> None:
        self.jobs.clear()


class Recording:
    """Records with fake attempts."""

    def __init__(self, config: RecordConfig, path: Path, stage: Path | None = None) -> None:
        self.config = config
        self.path = path
        self.stage = stage
        self.meshes: dict[str, Path | None] = {}
        self.warnings: list[str] = []
        self.locations = Locations(Locations.from_environment({}).data, Path("/nowhere"))
        self.stop = StopRequest()

    def run(
        self, executor: Inline | None = None, mode: ExistingDatasetMode = ExistingDatasetMode.NEW, workers: int = 2
    ) -> RecordReport:
        locations = replace(self.locations, meshes=self.meshes)
        return record(
            Session(self.config.model_copy(update={"workers": workers}), locations),
            RecordingOutput(self.path, mode, self.stage),
            executor or Inline(),
            RecordCallbacks(lambda done, wanted, attempts: None, self.warnings.append),
            self.stop,
        )

    def resume(self, executor: Inline | None = None) -> RecordReport:
        return self.run(executor, ExistingDatasetMode.RESUME)

    def causes(self) -> list[str | None]:
        return [attempt.outcome.cause for attempt in Ledger(self.path).known_attempts.values()]
