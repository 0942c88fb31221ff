"""JSON records of a dataset: `episode.json`, lines of the attempt ledger, and the manifest."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic_core
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...correction_record import CorrectionRecord
from ..attempt_data import (
    Attempt,
    AttemptJob,
    AttemptPayload,
    FailureCause,
    FullPose,
    MotionMargins,
    ObjectLayout,
    Outcome,
)
from ..config.goals.role_assignment import RoleAssignment
from ..config.program_task import ProgramTask
from ..config.recording import RecordConfig
from ..config.variation import RandomizationSample
from ..errors import DatasetError, NewerFormatError
from ..files.documents.config_base import Name
from ..files.writing import sha256_bytes
from ..geometry.se3 import Array
from .dataset_paths import DATASET_FORMAT, EPISODE_FORMAT, FORMAT_VERSION
from .upgrade import upgrade_attempt, upgrade_episode

# Path of a file relative to its episode. No path component begins with a dot, so paths cannot leave the episode.
FilePath = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*(/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$", max_length=300)
]
# Camera -> (width, height) of its images, px. The camera name is also a folder name in episodes and exports.
CameraSizes = dict[Name, tuple[int, int]]


class Record(BaseModel):
    """Base class of all dataset records. Numbers must be finite. Unknown keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    @staticmethod
    def upgrade(data: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parsed JSON of any known format version in the form of the present one."""
        return dict(data)


class MarginsRecord(Record):
    """Largest speed and torque as shares of their limits, smallest joint margin, largest slip and tilt in the hand."""

    velocity_share: float
    torque_share: float
    joint_rad: float
    slip_m: float | None
    object_tilt_rad: float | None

    @classmethod
    def from_margins(cls, margins: MotionMargins) -> MarginsRecord:
        """Return the record of `margins`."""
        return cls(
            velocity_share=margins.velocity,
            torque_share=margins.torque,
            joint_rad=margins.joint,
            slip_m=margins.slip,
            object_tilt_rad=margins.tilt,
        )


class MeasureRecord(Record):
    """Predicate of a goal, and the margin (in `unit`) by which it holds; negative if it fails."""

    what: str
    margin: float
    unit: str
    detail: str = ""

    @property
    def is_distance(self) -> bool:
        """Whether the margin belongs to `on(object, surface)` and measures the distance from the surface's centre."""
        return self.unit == "m" and self.what.startswith("on(")


class RecoveryRecord(Record):
    """A skill that failed and was tried again: its number and name, the reason, and the first frame of the new try."""

    step: int
    skill: str
    detail: str
    frame: int


class OutcomeRecord(Record):
    """Outcome of an attempt as continuous values in m, m/s and rad, so that any threshold can be applied later."""

    success: bool
    cause: str | None
    detail: str
    dxy_m: float | None
    dz_m: float | None
    speed_mps: float | None
    plan_error_m: float | None
    tilt_rad: float | None
    margins: MarginsRecord | None = None
    measures: tuple[MeasureRecord, ...] = ()  # margins of the goal's predicates
    recoveries: tuple[RecoveryRecord, ...] = ()

    @classmethod
    def from_outcome(cls, outcome: Outcome) -> OutcomeRecord:
        """Return the record of `outcome`."""
        return cls(
            success=outcome.success,
            cause=outcome.cause,
            detail=outcome.detail,
            dxy_m=outcome.dxy,
            dz_m=outcome.dz,
            speed_mps=outcome.speed,
            plan_error_m=None,
            tilt_rad=None,
            margins=MarginsRecord.from_margins(outcome.margins) if outcome.margins else None,
            measures=tuple(MeasureRecord(**asdict(measure)) for measure in outcome.measures),
            recoveries=tuple(RecoveryRecord(**asdict(recovery)) for recovery in outcome.recoveries),
        )

    def is_within(self, threshold: float, max_height: float = math.inf) -> bool:
        """Return whether the object ended on its target, within `threshold` metres of the target's centre.

        `max_height` (of the object's origin above the target's, m) applies to outcomes without measured contact.
        """
        # After any other failure cause, the distance is meaningless: the object may have been thrown there.
        if self.dxy_m is None or self.dz_m is None or self.cause not in (None, FailureCause.OFF_TARGET):
            return False
        on_it = self.measures or 0.0 <= self.dz_m <= max_height
        others = all(measure.margin >= 0 for measure in self.measures if not measure.is_distance)
        return bool(on_it) and others and self.dxy_m <= threshold


class RoleAssignmentRecord(Record):
    """Role assignment: role -> objects, object -> name of its object config, object -> scale factor."""

    things: dict[str, tuple[str, ...]]
    kinds: dict[str, str]
    sizes: dict[str, float] = Field(default_factory=dict)


class AttemptRecord(Record):
    """One line of `attempts.jsonl`. `layout` is object -> initial pose in `world`."""

    upgrade = staticmethod(upgrade_attempt)
    attempt: int
    seed: int
    episode: int | None
    outcome: OutcomeRecord
    layout: dict[Name, FullPose]
    randomized: RandomizationSample = RandomizationSample()
    cast: RoleAssignmentRecord | None = None
    phrasing: str = ""


class EpisodeRecord(Record):
    """`episode.json`: all values that are needed to reproduce the episode, and the hashes of its files."""

    upgrade = staticmethod(upgrade_episode)
    format: Annotated[str, Field(pattern=f"^{EPISODE_FORMAT}$")] = EPISODE_FORMAT
    format_version: int = FORMAT_VERSION
    episode: int
    attempt: int
    seed: int
    source: str
    rig: str
    scene: str
    task: str
    grasp: str
    frames: int
    frame_period_s: float
    cameras: CameraSizes
    truth: bool = False
    arms: Annotated[int, Field(ge=1, le=2)] = 1
    drives: Annotated[int, Field(ge=1, le=64)] = 7  # per arm
    joint_actions: bool = False  # whether frames have the keys `state` and `action`
    objects: list[Name]
    outcome: OutcomeRecord
    # m, largest height of the object above its target on success; None if a goal decides success.
    max_height_m: float | None
    layout: dict[Name, FullPose]
    randomized: RandomizationSample = RandomizationSample()
    cast: RoleAssignmentRecord | None = None
    phrasing: str = ""
    # Articulated object -> names of its joints, in the order of `<object>_joints`.
    joints: dict[Name, tuple[str, ...]] = Field(default_factory=dict)
    # Cloth -> number of points of `<object>_points` along its x axis and its y axis.
    cloths: dict[Name, tuple[int, int]] = Field(default_factory=dict)
    versions: dict[str, str]
    renderer: str
    # Asset set -> description of the rendered meshes, see `core.scene.build.describe_meshes`; None if unknown.
    meshes: dict[str, str] | None = None
    correction: Annotated[CorrectionRecord | None, Field(exclude_if=lambda made: made is None)] = None
    content_sha256: str
    files: dict[FilePath, str]


class ManifestEntry(Record):
    """One episode in the manifest. `sha256` is the hash of `episode.json`, which holds the hashes of all files."""

    episode: int
    path: FilePath
    attempt: int
    frames: int
    bytes: int
    sha256: str


class Manifest(Record):
    """`manifest.json`: the index of a dataset, computed from its episodes."""

    format: Annotated[str, Field(pattern=f"^{DATASET_FORMAT}$")] = DATASET_FORMAT
    format_version: int = FORMAT_VERSION
    task: str
    seed: int
    attempts: int
    frames: int
    bytes: int
    episodes: list[ManifestEntry]


R = TypeVar("R", bound=Record)


def to_json(record: Record, *, indent: int | None = None) -> bytes:
    """Return a record as JSON text. Equal records give equal bytes."""
    return (json.dumps(record_data(record), indent=indent, ensure_ascii=False, allow_nan=False) + "\n").encode()


def from_json(model: type[R], data: bytes | str, source: Path | str) -> R:
    """Parse a record of type `model`, of any known format version. Raise DatasetError with the first fault."""
    try:
        parsed = pydantic_core.from_json(data)
        if isinstance(parsed, dict):
            version = parsed.get("format_version")
            if isinstance(version, int) and version > FORMAT_VERSION:
                raise NewerFormatError(
                    f"{source}: format_version {version} is newer than {FORMAT_VERSION}, the last one that this yamsim "
                    "reads; install a later yamsim"
                )
            parsed = model.upgrade(parsed) | ({"format_version": FORMAT_VERSION} if isinstance(version, int) else {})
        return model.model_validate(parsed)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DatasetError(f"{source}: {where + ': ' if where else ''}{first['msg']}") from error
    except ValueError as error:
        raise DatasetError(f"{source}: Invalid JSON: {error}") from error


def attempt_record(payload: AttemptPayload, episode: int | None) -> AttemptRecord:
    """Return the ledger record of a finished attempt. `episode` is the number of the published episode, or None."""
    cast, recorded = payload.attempt.roles, None
    if cast is not None:
        recorded = RoleAssignmentRecord(
            things=dict(cast.objects_by_role), kinds=dict(cast.config_names), sizes=dict(cast.scale_factors)
        )
    return AttemptRecord(
        attempt=payload.job.attempt,
        seed=payload.job.seed,
        episode=episode,
        outcome=OutcomeRecord.from_outcome(payload.outcome),
        layout=payload.attempt.object_places,
        randomized=payload.attempt.variation,
        cast=recorded,
        phrasing=payload.attempt.phrasing,
    )


def attempt_from_record(record: EpisodeRecord, start: Array | None = None) -> Attempt:
    """Rebuild the attempt of an episode from its record. `start` is the MuJoCo `qpos` (nq,) of the first frame."""
    cast = None if record.cast is None else RoleAssignment(record.cast.things, record.cast.kinds, record.cast.sizes)
    job, layout = AttemptJob(record.seed, record.attempt), ObjectLayout.from_places(record.layout)
    return Attempt(job, layout, record.randomized, start, cast, record.phrasing)


def file_hashes(files: Mapping[str, bytes]) -> dict[str, str]:
    """Return path -> SHA-256, sorted by path."""
    return {name: sha256_bytes(files[name]) for name in sorted(files)}


def record_data(record: Record) -> dict[str, Any]:
    """Return a record as JSON-ready data."""
    data: dict[str, Any] = record.model_dump(mode="json")
    return data


def episode_record(config: RecordConfig, payload: AttemptPayload, episode: int) -> EpisodeRecord:
    """Return the `episode.json` record of a successful attempt that is published as number `episode`."""
    cameras = (name.split("/")[1] for name in payload.files if name.startswith("rgb/"))
    attempt = attempt_record(payload, episode)
    task = config.task
    return EpisodeRecord(
        episode=episode,
        attempt=attempt.attempt,
        seed=attempt.seed,
        source="record",
        rig=config.rig.name,
        scene=config.scene.name,
        task=task.name,
        grasp=config.grasp,
        frames=payload.frames,
        frame_period_s=task.timing.tick_seconds * task.timing.ticks_per_frame,
        cameras=dict.fromkeys(cameras, config.image.size_px),
        truth=config.truth,
        arms=len(config.rig.arms),
        drives=config.rig.drive_count,
        joint_actions=config.action == "joints",
        objects=list(attempt.layout),
        outcome=attempt.outcome,
        max_height_m=None,
        layout=attempt.layout,
        randomized=attempt.randomized,
        cast=attempt.cast,
        phrasing=attempt.phrasing,
        joints=_object_joint_names(task, attempt),
        cloths=_cloth_grid_sizes(task, attempt),
        versions=dict(payload.versions),
        renderer=payload.renderer,
        meshes=None if config.meshes is None else dict(config.meshes),
        content_sha256=payload.content_sha256,
        files=file_hashes(payload.files),
    )


def _cloth_grid_sizes(task: ProgramTask, attempt: AttemptRecord) -> dict[str, tuple[int, int]]:
    cloths = {item.name: item.cloth for item in task.objects}
    kinds = attempt.cast.kinds if attempt.cast else {}
    return {thing: cloth.grid for thing, kind in kinds.items() if (cloth := cloths[kind]) is not None}


def _object_joint_names(task: ProgramTask, attempt: AttemptRecord) -> dict[str, tuple[str, ...]]:
    items = {item.name: item for item in task.objects}
    kinds = attempt.cast.kinds if attempt.cast else {}
    return {thing: tuple(link.name for link in items[kind].links) for thing, kind in kinds.items() if items[kind].links}
