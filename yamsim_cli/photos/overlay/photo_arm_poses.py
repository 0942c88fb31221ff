"""Find each arm's base pose in a photo: by its board, by all boards, or from a recording."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import Array, invert_pose

from ..fiducials.board_detection import DEFAULT_POSE_LIMITS, BoardDetection, BoardStatus, PoseLimits
from ..fiducials.board_localization import detections_without_pose, locate_boards, locate_boards_together
from ..fiducials.markers import sorted_marker_ids
from .photo_cameras import PhotoCamera
from .photos import Photo, PlacedCamera

STATUS_INFERRED_FROM_OTHER_BOARD = "inferred"  # arm status: pose from the other board and the rig
STATUS_RECORDED = "recorded"  # arm status: pose from the recording
STATUS_CALIBRATED = "calibrated"  # arm status: pose from a calibration of the station
STATUS_NO_BOARD = "no_board"  # arm status: no board in the rig, pose unknown

_MAX_REPROJECTION_PX = 0.5  # px, above which the result has a note
_MARGIN_TOLERANCE = 0.002  # m, error of the rig's distance between arms, above which the result has a note

# Chi-squared test of whether two prints have the rig's sizes.
_MARGIN_SIGMA = 0.005  # m, of the real distance between the arms from the rig's
_POSITION_SIGMA = 0.002  # m, of the real arm positions from the rig's, along each axis
_MIN_CHI_SQUARED_DECREASE = 25.0  # decrease of chi squared by another print size
_MAX_CHI_SQUARED = 14.0  # chi squared that remains with another print size
_MIN_SIZE_DIFFERENCE = 0.01  # smallest reported difference, relative to the rig


@dataclass(frozen=True)
class ArmBasePose:
    """The pose of one arm in a photo.

    Attributes:
        board: name, if the arm has one.
        status: the board's `BoardStatus`, STATUS_INFERRED_FROM_OTHER_BOARD, STATUS_RECORDED, STATUS_CALIBRATED or
            STATUS_NO_BOARD.
        T_base_in_cam: pose (4, 4); None if unknown.
        edge_residual: median distance of the rendered outline to edges, px; None if not measured.
    """

    name: str
    board: str | None
    status: str
    detection: BoardDetection | None = None
    T_base_in_cam: Array | None = None
    edge_residual: float | None = None

    @property
    def is_located(self) -> bool:
        """Whether the base's pose is within the limits of uncertainty."""
        return self.T_base_in_cam is not None and self.status != BoardStatus.UNCERTAIN


@dataclass(frozen=True)
class RigInPhoto:
    """The poses of a rig's arms in a photo.

    Attributes:
        joints_source: "home", "file" or "episode".
        ids: of all detected markers, also of other boards.
        T_arm2_in_arm1: pose (4, 4) of arm 2's base, if both boards are located.
        margin, margin_sigma: measured distance of the arms along world y, m.
        edge_residual: median distance of all rendered outlines to edges, px.
        iou: overlap with the user's mask, 0..1.
        notes: warnings for users, such as a margin that differs from the rig's.
        time: s; None if not known.
    """

    path: Path
    lens: PhotoCamera
    joints_source: str
    arms: tuple[ArmBasePose, ...]
    ids: tuple[int, ...]
    T_arm2_in_arm1: Array | None = None
    margin: float | None = None
    margin_sigma: float | None = None
    edge_residual: float | None = None
    iou: float | None = None
    notes: tuple[str, ...] = ()
    time: float | None = None

    @property
    def base_poses(self) -> dict[int, Array]:
        """Arm index -> pose (4, 4) of its base in the camera frame, for located arms."""
        return {
            k: arm.T_base_in_cam for k, arm in enumerate(self.arms) if arm.is_located and arm.T_base_in_cam is not None
        }


def find_arms(
    rig: RigConfig,
    photo: Photo,
    grey: NDArray[np.uint8],
    lens: PhotoCamera,
    trust_margin: bool,
    before: RigInPhoto | None = None,
    limits: PoseLimits = DEFAULT_POSE_LIMITS,
) -> RigInPhoto:
    """Find base poses by the photo's calibration, each arm's board, all boards (`trust_margin`) or the recording.

    Args:
        grey: the photo (height, width).
        lens: with too uncertain a focal length, no board gives a pose.
        trust_margin: take the rig's relative arm poses as exact, and fit one rig pose.
        before: the previous photo's result, for start poses.
    """
    if photo.placed is not None:
        return _with_calibrated_poses(rig, photo, lens, photo.placed)
    boards, camera = [arm.board.board_in_metres for arm in rig.arms if arm.board], lens.camera
    if lens.focal.reason:
        sightings, markers = detections_without_pose(grey, camera, boards, lens.focal.reason)
    else:
        T_boards = [_T_board_in_world(rig, k) for k, arm in enumerate(rig.arms) if arm.board]
        seen_before = {arm.board: arm.detection for arm in before.arms if arm.detection} if before else {}
        poses = [one.T_board_in_cam if (one := seen_before.get(board.name)) else None for board in boards]
        sightings, markers = locate_boards(grey, camera, boards, T_boards, poses, limits)
    by_board = {seen.board.name: seen for seen in sightings}
    arms = []
    for arm in rig.arms:
        if arm.board is None:
            arms.append(ArmBasePose(arm.name, None, STATUS_NO_BOARD))
            continue
        seen = by_board[arm.board.board_in_metres.name]
        T = None if seen.T_board_in_cam is None else seen.T_board_in_cam @ invert_pose(arm.T_board_in_base)
        arms.append(ArmBasePose(arm.name, arm.board.name, seen.status, seen, T))
    notes = _reprojection_notes(arms)
    arms = _drop_inconsistent_sizes(rig, arms)
    ids = tuple(sorted_marker_ids(markers))
    result = RigInPhoto(photo.path, lens, photo.joints_source, tuple(arms), ids, notes=notes, time=photo.time)
    result = _with_measured_margin(rig, result)
    if trust_margin and len(arms) > 1 and result.base_poses:
        result = _pose_by_trusted_margin(rig, result, grey)
    return result if photo.T_base_in_cam is None else _with_recorded_poses(rig, result, photo.T_base_in_cam)


def _T_board_in_world(rig: RigConfig, k: int) -> Array:
    T: Array = rig.T_base_in_world(k) @ rig.arms[k].T_board_in_base
    return T


def _located_boards(arms: Sequence[ArmBasePose]) -> list[tuple[int, BoardDetection]]:
    return [
        (k, arm.detection) for k, arm in enumerate(arms) if arm.detection and arm.detection.status is BoardStatus.OK
    ]


def _drop_inconsistent_sizes(rig: RigConfig, arms: list[ArmBasePose]) -> list[ArmBasePose]:
    """Drop two arms' poses if their prints cannot both have the rig's sizes."""
    for (k, one), (j, two) in itertools.combinations(_located_boards(arms), 2):
        ratio = _size_ratio(one, two, _T_board_in_world(rig, k), _T_board_in_world(rig, j))
        if ratio is None:
            continue
        reason = (
            f"relative to the print of {arms[k].name}'s board, that of {arms[j].name}'s board has {100 * ratio:.1f} % "
            "of its size in the rig: measure both prints, and set the rig's marker_length_mm and gap_mm"
        )
        for n, sighting in ((k, one), (j, two)):
            refused = replace(_without_pose(sighting), status=BoardStatus.POOR_FIT, reason=reason)
            arms[n] = replace(arms[n], status=refused.status, detection=refused, T_base_in_cam=None)
        break
    return arms


def _size_ratio(one: BoardDetection, two: BoardDetection, T_one: Array, T_two: Array) -> float | None:
    """Return the second print's relative size if another size explains the boards' relative pose, else None.

    A smaller print appears farther away: only this error displaces a board along the line of sight. `T_one` and `T_two`
    are poses (4, 4) in the rig's `world`.
    """
    assert one.T_board_in_cam is not None and two.T_board_in_cam is not None
    assert one.covariance is not None and two.covariance is not None
    assert one.errors_shared_by_boards is not None and two.errors_shared_by_boards is not None
    expected = one.T_board_in_cam @ (invert_pose(T_one) @ T_two)
    lever = expected[:3, 3] - one.T_board_in_cam[:3, 3]
    # A rotation w moves the second board by w x lever.
    x, y, z = lever
    swung = np.column_stack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
    own_one: Array = one.covariance - one.errors_shared_by_boards @ one.errors_shared_by_boards.T
    own_two: Array = two.covariance - two.errors_shared_by_boards @ two.errors_shared_by_boards.T
    shared: Array = two.errors_shared_by_boards[3:] - swung @ one.errors_shared_by_boards
    noise = swung @ own_one @ swung.T + own_two[3:, 3:] + shared @ shared.T
    # The margin is along world y.
    along = one.T_board_in_cam[:3, :3] @ T_one[:3, :3].T @ np.array([0.0, 1.0, 0.0])
    noise = noise + _POSITION_SIGMA**2 * np.eye(3) + _MARGIN_SIGMA**2 * np.outer(along, along)
    off = two.T_board_in_cam[:3, 3] - expected[:3, 3]
    # Another size scales the vector from camera to board.
    way = two.T_board_in_cam[:3, 3]
    weighted = np.linalg.solve(noise, np.column_stack([off, way]))
    size_change = -float(way @ weighted[:, 0]) / float(way @ weighted[:, 1])
    before = float(off @ weighted[:, 0])
    left = before - size_change**2 * float(way @ weighted[:, 1])
    if before - left < _MIN_CHI_SQUARED_DECREASE or left > _MAX_CHI_SQUARED or abs(size_change) < _MIN_SIZE_DIFFERENCE:
        return None
    return 1.0 + size_change


def _without_pose(detection: BoardDetection) -> BoardDetection:
    return replace(detection, T_board_in_cam=None, covariance=None, errors_shared_by_boards=None)


def _with_replaced_pose(arm: ArmBasePose, status: str, T_base_in_cam: Array) -> ArmBasePose:
    sighting = arm.detection and _without_pose(arm.detection)
    return replace(arm, status=status, detection=sighting, T_base_in_cam=T_base_in_cam)


def _with_calibrated_poses(rig: RigConfig, photo: Photo, lens: PhotoCamera, placed: PlacedCamera) -> RigInPhoto:
    arms = tuple(
        ArmBasePose(arm.name, arm.board.name if arm.board else None, STATUS_CALIBRATED, T_base_in_cam=T)
        for arm, T in zip(rig.arms, placed.T_bases_in_cam, strict=True)
    )
    return RigInPhoto(photo.path, lens, photo.joints_source, arms, (), time=photo.time)


def _with_recorded_poses(rig: RigConfig, result: RigInPhoto, T_first_base_in_cam: Array) -> RigInPhoto:
    T_world_in_cam = T_first_base_in_cam @ invert_pose(rig.T_base_in_world(0))
    arms = tuple(
        arm if arm.is_located else _with_replaced_pose(arm, STATUS_RECORDED, T_world_in_cam @ rig.T_base_in_world(k))
        for k, arm in enumerate(result.arms)
    )
    return replace(result, arms=arms)


def _reprojection_notes(arms: Sequence[ArmBasePose]) -> tuple[str, ...]:
    return tuple(
        f"{arm.name}'s markers lie {rms:.2f} px from where its pose puts them: check the camera's distortion, and the "
        "rig's marker_length_mm and gap_mm against the print"
        for arm in arms
        if arm.is_located and arm.detection
        if (rms := arm.detection.reprojection_rms) is not None and rms > _MAX_REPROJECTION_PX
    )


def _with_measured_margin(rig: RigConfig, result: RigInPhoto) -> RigInPhoto:
    if len(result.arms) < 2 or not all(arm.is_located for arm in result.arms[:2]):
        return result
    one, two = result.arms[:2]
    assert one.T_base_in_cam is not None and two.T_base_in_cam is not None
    measured = invert_pose(one.T_base_in_cam) @ two.T_base_in_cam
    expected = invert_pose(rig.T_base_in_world(0)) @ rig.T_base_in_world(1)
    # World y, in the first arm's frame.
    along = rig.T_base_in_world(0)[:3, :3].T @ np.array([0.0, 1.0, 0.0])
    margin = rig.margin + float(along @ (measured[:3, 3] - expected[:3, 3]))
    sigma = _margin_sigma(one, two, one.T_base_in_cam[:3, :3] @ along)
    notes = result.notes
    if abs(margin - rig.margin) > max(_MARGIN_TOLERANCE, 2 * sigma):
        notes += (
            f"the arms are {margin:.4f} m apart here (+- {sigma * 1000:.1f} mm) and {rig.margin:.4f} m in rig "
            f"{rig.name!r}: correct the rig's margin, or measure the prints",
        )
    return replace(result, T_arm2_in_arm1=measured, margin=margin, margin_sigma=sigma, notes=notes)


def _margin_sigma(one: ArmBasePose, two: ArmBasePose, direction: Array) -> float:
    """Return the sigma (m) of two bases' distance along a direction (3,) of the camera frame."""
    variance, scales = 0.0, []
    for arm in (one, two):
        assert (
            arm.detection is not None
            and arm.detection.covariance is not None
            and arm.detection.errors_shared_by_boards is not None
        )
        assert arm.detection.T_board_in_cam is not None and arm.T_base_in_cam is not None
        # A rotation of the board moves the base.
        lever = arm.T_base_in_cam[:3, 3] - arm.detection.T_board_in_cam[:3, 3]
        along = np.concatenate([np.cross(lever, direction), direction])
        shared = along @ arm.detection.errors_shared_by_boards
        variance += float(along @ arm.detection.covariance @ along - shared @ shared)
        scales.append(shared)
    # Lens and printer errors are common: only their difference counts.
    apart = scales[1] - scales[0]
    return math.sqrt(max(0.0, variance) + float(apart @ apart))


def _pose_by_trusted_margin(rig: RigConfig, result: RigInPhoto, grey: NDArray[np.uint8]) -> RigInPhoto:
    seen = dict(_located_boards(result.arms))
    T_boards = [_T_board_in_world(rig, k) for k in seen]
    joint = locate_boards_together(grey, result.lens.camera, list(seen.values()), T_boards)
    if joint is None or joint[0].T_board_in_cam is None:
        refused = (
            f"the boards do not lie as rig {rig.name!r} says: its margin is ignored, and each arm has its own pose"
        )
        return replace(result, notes=(*result.notes, refused))
    T_world_in_cam = joint[0].T_board_in_cam @ invert_pose(T_boards[0])
    found, arms = dict(zip(seen, joint, strict=True)), []
    for k, arm in enumerate(result.arms):
        T = T_world_in_cam @ rig.T_base_in_world(k)
        if k in found:
            arms.append(replace(arm, detection=found[k], T_base_in_cam=T))
        else:
            arms.append(_with_replaced_pose(arm, STATUS_INFERRED_FROM_OTHER_BOARD, T))
    return replace(result, arms=tuple(arms))
