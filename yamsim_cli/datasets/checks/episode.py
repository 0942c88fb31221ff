"""Check the files of one episode, and collect facts for statistics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from yamsim_cli.core.dataset.checks.context import CheckContext, EpisodeDirectory
from yamsim_cli.core.dataset.checks.lowdim import LowdimChecks, recorded_specs
from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE, lowdim_path
from yamsim_cli.core.dataset.imported_records import RealEpisodeRecord
from yamsim_cli.core.dataset.lowdim import content_hash
from yamsim_cli.core.dataset.records import EpisodeRecord, from_json
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.writing import sha256_bytes

from .episode_facts import (
    POSE_SUFFIX,
    EpisodeFacts,
    Values,
    initial_layout,
    object_positions,
    outcome_from_frames,
    rigid_poses,
    values_by_frame,
)
from .episode_files import check_missing_files, list_files, read_file
from .images import CameraChecks, TruthChecks, check_frozen_images
from .motion import (
    TIMESTAMPS_FILE,
    angles_by_camera,
    check_fingers,
    check_intrinsics,
    check_limits,
    check_objects_in_view,
    check_pose,
    check_speeds,
    check_times,
    read_timestamps,
    split_by_arm,
)

if TYPE_CHECKING:
    from yamsim_cli.core.images.jpeg import JpegReader

# m, largest difference between the object-target distance in the recorded outcome and in the last frame. The outcome is
# measured shortly after that frame; a resting object moves by less than 0.1 mm until then.
_OUTCOME_TOLERANCE = 0.005
_SHOWN_HASH_DIGITS = 12  # of a SHA-256 in messages


def check_episode(episode: EpisodeDirectory, context: CheckContext, reader: JpegReader) -> EpisodeFacts:
    """Check every file of an episode. A fault in one file does not stop other checks."""
    return _EpisodeCheck(episode, context, reader).run()


class _EpisodeCheck:
    def __init__(self, episode: EpisodeDirectory, context: CheckContext, reader: JpegReader) -> None:
        self._episode = episode
        self._context = context
        self._reader = reader
        self._problems = ProblemCollector(episode.path.name)
        self._files = list_files(episode.path, context.recorded, self._problems)
        self._record: EpisodeRecord | None = None
        self._imported: RealEpisodeRecord | None = None
        self._record_sha256 = ""
        self._content = ""

    def run(self) -> EpisodeFacts:
        if self._context.recorded:
            self._read_record()
        elif self._context.real:
            self._read_imported()
        frames = check_missing_files(self._files, self._record, self._problems)
        if self._imported is not None:
            self._check_imported(self._imported, frames)
        lowdim = self._check_lowdim()
        cameras = self._check_images()
        self._check_truth()
        self._check_others()
        period = self._check_times(lowdim.values)
        self._check_joints(lowdim.values, cameras, period)
        self._check_poses(lowdim.values, cameras)
        outcome = outcome_from_frames(lowdim.values, self._context)
        if self._record and outcome and self._record.frames - 1 in lowdim.values:
            self._compare_outcomes(outcome.dxy_m, self._record.outcome.dxy_m)
        return EpisodeFacts(
            name=self._episode.path.name,
            number=self._episode.number,
            record=self._record,
            record_sha256=self._record_sha256,
            frames=frames,
            bytes=sum(self._files.sizes.values()),
            seconds=(frames - 1) * period if period and frames else None,
            cameras={name: checks.size for name, checks in cameras.items() if checks.size},
            images={
                name: [self._files.images[name][k] for k in sorted(checks.fingerprints)]
                for name, checks in cameras.items()
            },
            start_positions=object_positions(lowdim.values, self._context, last=False),
            end_positions=object_positions(lowdim.values, self._context, last=True),
            layout=initial_layout(lowdim.values, self._record),
            outcome=self._record.outcome if self._record else outcome,
            content=self._content,
            problems=self._problems.all_problems(),
            import_faults=self._imported.problems if self._imported else (),
        )

    def _read_episode_file(self, name: str) -> bytes | None:
        return read_file(self._episode.path, name, self._files, self._problems)

    def _read_record(self) -> None:
        if EPISODE_FILE not in self._files.sizes:
            self._problems.add("record.missing", EPISODE_FILE)
            return
        text = self._read_episode_file(EPISODE_FILE)
        if text is None:
            return
        self._record_sha256 = sha256_bytes(text)
        try:
            self._record = _require_plausible_record(from_json(EpisodeRecord, text, EPISODE_FILE))
        except DatasetError as error:
            self._problems.add("record.damaged", EPISODE_FILE, str(error).removeprefix(f"{EPISODE_FILE}: "))
            return
        if self._record.episode != self._episode.number:
            self._problems.add("episode.number", EPISODE_FILE, self._record.episode, self._episode.number)
        if not self._record.outcome.success:
            self._problems.add("episode.failed", EPISODE_FILE, self._record.outcome.cause)

    def _read_imported(self) -> None:
        text = self._read_episode_file(EPISODE_FILE)
        if text is None:
            self._problems.add("record.missing", EPISODE_FILE)
            return
        self._record_sha256 = sha256_bytes(text)
        try:
            self._imported = from_json(RealEpisodeRecord, text, EPISODE_FILE)
        except DatasetError as error:
            self._problems.add("record.damaged", EPISODE_FILE, str(error).removeprefix(f"{EPISODE_FILE}: "))

    def _check_imported(self, record: RealEpisodeRecord, frames: int) -> None:
        for name in record.files:
            if name not in self._files.sizes:
                self._problems.add("file.missing", name)
        if frames != record.frames:
            self._problems.add(
                "frames.count", "lowdim", f"{frames} in lowdim", f"{record.frames}, as in {EPISODE_FILE}"
            )

    def _hash_fits(self, name: str, data: bytes) -> bool:
        record = self._record or self._imported
        wanted = record.files.get(name) if record else None
        if wanted is None:
            if record:
                self._problems.add("file.unhashed", name)
            return True
        found = sha256_bytes(data)
        if found != wanted:
            value = f"{len(data)} bytes with sha256 {found[:_SHOWN_HASH_DIGITS]}..."
            self._problems.add("file.hash", name, value, f"{wanted[:_SHOWN_HASH_DIGITS]}...")
        return found == wanted

    def _check_lowdim(self) -> LowdimChecks:
        record = self._record
        checks = LowdimChecks(recorded_specs(record) if record else None, self._problems)
        unchanged = True
        for number, name in sorted(self._files.lowdim.items()):
            data = self._read_episode_file(name)
            if data is not None and checks.check_file(number, name, data):
                unchanged &= self._hash_fits(name, data)
        if checks.frames and len(checks.frames) == len(self._files.lowdim):
            found = self._content = content_hash(checks.frames[k] for k in sorted(checks.frames))
            if record and unchanged and len(checks.frames) == record.frames and found != record.content_sha256:
                value, valid = found[:_SHOWN_HASH_DIGITS], record.content_sha256[:_SHOWN_HASH_DIGITS]
                self._problems.add("lowdim.content", EPISODE_FILE, f"content_sha256 {value}...", f"{valid}...")
        return checks

    def _check_images(self) -> dict[str, CameraChecks]:
        cameras: dict[str, CameraChecks] = {}
        for camera, names in sorted(self._files.images.items()):
            size = self._record.cameras.get(camera) if self._record else None
            checks = cameras[camera] = CameraChecks(camera, size, self._reader, self._problems)
            for number, name in sorted(names.items()):
                data = self._read_episode_file(name)
                if data is not None and checks.check(number, name, data):
                    self._hash_fits(name, data)
        return cameras

    def _check_truth(self) -> None:
        record = self._record
        if record is None or not record.truth:
            return
        checks = TruthChecks(record, self._reader, self._read_episode_file, self._hash_fits, self._problems)
        checks.check_missing_files(self._files.sizes)
        for camera in record.cameras:
            checks.check_arrays(camera)
            for _, name in sorted(self._files.truth["depth"].get(camera, {}).items()):
                checks.check_depth(camera, name)
            for _, name in sorted(self._files.truth["segmentation"].get(camera, {}).items()):
                checks.check_segmentation(camera, name)

    def _check_others(self) -> None:
        for name in self._files.others:
            record = self._record or self._imported
            if record and name in record.files and (data := self._read_episode_file(name)) is not None:
                self._hash_fits(name, data)

    def _frame_name(self, number: int) -> str:
        return self._files.lowdim.get(number, lowdim_path(number))

    def _check_times(self, values: Values) -> float | None:
        times = {k: float(time) for k, time in values_by_frame(values, "timestamp").items() if np.ndim(time) == 0}
        if not times and not self._context.recorded:
            times = self._capture_times()
        period = self._record.frame_period_s if self._record else None
        return check_times(times, period, self._frame_name, self._problems)

    def _capture_times(self) -> dict[int, float]:
        """Return frame number -> time in s, from the first camera that has a file of capture times."""
        for camera, names in sorted(self._files.images.items()):
            name = f"rgb/{camera}/{TIMESTAMPS_FILE}"
            data = self._read_episode_file(name) if name in self._files.others else None
            times = read_timestamps(data) if data is not None else None
            if times and len(times) != len(names):
                self._problems.add("frames.count", name, f"{len(times)} times", f"{len(names)}, the number of images")
            elif times:
                return dict(zip(sorted(names), times, strict=True))
        return {}

    def _check_joints(self, values: Values, cameras: Mapping[str, CameraChecks], period: float | None) -> None:
        joints = values_by_frame(values, "joints")
        arms = split_by_arm(joints, self._context.arms, repeated=not self._context.recorded)
        for arm in arms:
            check_limits(arm.joints, arm.limits.joints, self._frame_name, self._problems)
            check_speeds(arm.joints, period, arm.limits.joints, self._frame_name, self._problems)
            if self._record and arm.limits.fingers and arm.openings:
                check_fingers(arm.openings, arm.limits.fingers, self._frame_name, self._problems)
        for camera, checks in cameras.items():
            moving = angles_by_camera(camera, arms, self._context.wrist_cameras)
            check_frozen_images(checks.fingerprints, self._files.images[camera], moving, self._problems)

    def _check_poses(self, values: Values, cameras: Mapping[str, CameraChecks]) -> None:
        before = len(self._problems)
        poses = rigid_poses(values)
        for key, by_frame in poses.items():
            check_pose(key, by_frame, self._frame_name, self._problems)
        for camera, checks in cameras.items():
            key = f"intrinsics[{camera}]"
            matrices = {k: K for k, K in values_by_frame(values, key).items() if np.shape(K) == (3, 3)}
            check_intrinsics(key, matrices, checks.size, self._frame_name, self._problems)
        if len(self._problems) == before:
            points = {key: T for key, T in poses.items() if key.partition("[")[0].endswith(POSE_SUFFIX)}
            for camera, checks in cameras.items():
                check_objects_in_view(camera, values, points, checks.size, self._problems)

    def _compare_outcomes(self, seen: float | None, stored: float | None) -> None:
        if seen is not None and (stored is None or abs(seen - stored) > _OUTCOME_TOLERANCE):
            value = "nothing" if stored is None else f"{stored * 1000:.1f} mm from the target's centre"
            self._problems.add("episode.outcome", EPISODE_FILE, value, f"{seen * 1000:.1f} mm")


def _require_plausible_record(record: EpisodeRecord) -> EpisodeRecord:
    if record.frames < 1 or record.frame_period_s <= 0:
        raise DatasetError(f"frames: {record.frames}, frame_period_s: {record.frame_period_s}: both must be above 0")
    for camera, (width, height) in record.cameras.items():
        if min(width, height) < 1:
            raise DatasetError(f"cameras.{camera}: {width}x{height} is not an image size")
    return record
