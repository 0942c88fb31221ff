"""Each arm's base pose in a photo, from its own board, from all boards together, or from a recording."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..config.rig import RigConfig
from ..geometry.camera import CameraModel
from ..geometry.se3 import Array, inverse
from ..images.image import Image
from ..images.image_files import grey_of
from ..vision.fiducials.focal_length.estimate import FocalEstimate, estimate_focal, known_focal, outlines_in
from ..vision.fiducials.judge import USUAL_LIMITS, Limits
from ..vision.fiducials.locate import locate, unlocated
from ..vision.fiducials.markers import seen_ids
from ..vision.fiducials.sighting import Sighting, Status
from ..vision.fiducials.together import locate_together
from .photos import Photo
from .print_size import size_ratio

# Status of an arm that has a pose without its own board: from the other board and the rig, or from the recording.
INFERRED = "inferred"
RECORDED = "recorded"
NO_BOARD = "no_board"

# A note is made if markers lie farther than this from where the pose puts them, px.
_PRINT_TOLERANCE = 0.5
# A note is made if the measured margin differs from the rig's by more than this (m), and by more than its uncertainty.
_MARGIN_TOLERANCE = 0.002

# To estimate an unknown camera's focal length, boards are searched in so many photos at most.
_PHOTOS_TO_SEARCH = 40
# The search ends once so many of them show a board.
_PHOTOS_FOR_FOCAL = 8


@dataclass(frozen=True)
class Lens:
    """The camera's focal length and model, and where they come from: "file", "episode" or "estimated"."""

    focal: FocalEstimate
    source: str

    @classmethod
    def known(cls, camera: CameraModel, source: str) -> Lens:
        """The lens of a calibrated camera."""
        return cls(known_focal(camera), source)

    @property
    def camera(self) -> CameraModel:
        """The camera, with the estimated focal length if it is not calibrated."""
        return self.focal.camera


@dataclass(frozen=True)
class ArmPose:
    """What a photo shows of one arm.

    Attributes:
        name: the arm's name.
        board: the board's name; None for an arm without one.
        status: "ok", "uncertain" if the board's pose is too uncertain, or why the board gives no pose; "inferred" or
            "recorded" if the pose has another source.
        sighting: what was found of the board.
        T_base_in_cam: pose (4, 4) of the arm's base; None if there is none.
        edge_residual: median distance (px) of the rendered outline to the photo's edges.
    """

    name: str
    board: str | None
    status: str
    sighting: Sighting | None = None
    T_base_in_cam: Array | None = None
    edge_residual: float | None = None

    @property
    def located(self) -> bool:
        """Whether there is a pose of the base that is not uncertain."""
        return self.T_base_in_cam is not None and self.status != Status.UNCERTAIN


@dataclass(frozen=True)
class PhotoResult:
    """What a photo shows of a rig.

    Attributes:
        path: the photo's file.
        lens: the camera that took it.
        joints_source: where the joints come from: "home", "file" or "episode".
        ids: ids of all markers that were read, also of those that belong to no board of the rig.
        T_arm2_in_arm1: measured pose (4, 4), with each arm's pose from its own board; None unless both were found.
        margin: the distance between the arms by that pose, m.
        margin_sigma: its standard deviation, m.
        edge_residual: median distance (px) of all rendered outlines to the photo's edges.
        iou: overlap with the user's mask, 0..1.
        notes: sentences for a person.
        time: when it was taken, s; None if not known.
    """

    path: Path
    lens: Lens
    joints_source: str
    arms: tuple[ArmPose, ...]
    ids: tuple[int, ...]
    T_arm2_in_arm1: Array | None = None
    margin: float | None = None
    margin_sigma: float | None = None
    edge_residual: float | None = None
    iou: float | None = None
    notes: tuple[str, ...] = ()
    time: float | None = None

    @property
    def bases(self) -> dict[int, Array]:
        """Index of an arm -> pose (4, 4) of its base in the camera's frame, for all arms that are located."""
        return {
            k: arm.T_base_in_cam for k, arm in enumerate(self.arms) if arm.located and arm.T_base_in_cam is not None
        }


def unknown_lens(images: Iterable[Image], size: tuple[int, int], rig: RigConfig) -> Lens:
    """The lens of photos by an unknown camera, estimated from the boards in them.

    Args:
        images: RGB, all of one size.
        size: their height and width, px.
    """
    boards = [arm.board.board for arm in rig.arms if arm.board]
    outlines, telling = [], 0
    for image in itertools.islice(images, _PHOTOS_TO_SEARCH):
        found = outlines_in(grey_of(image), boards)
        outlines += found
        telling += bool(found)
        if telling == _PHOTOS_FOR_FOCAL:
            break
    height, width = size
    return Lens(estimate_focal(outlines, (width, height)), "estimated")


def find_arms(
    rig: RigConfig,
    photo: Photo,
    grey: NDArray[np.uint8],
    lens: Lens,
    trust_margin: bool,
    before: PhotoResult | None = None,
    limits: Limits = USUAL_LIMITS,
) -> PhotoResult:
    """Each arm's pose from its board, or else from the other's board or from the recording.

    Args:
        photo: the photo's path, joints and recorded pose.
        grey: the photo (height, width).
        lens: the camera. If its focal length is too uncertain, no board gives a pose.
        trust_margin: whether the arms stand as the rig says, so that all boards together give one pose of the rig.
        before: what the photo before this one in a series said: boards are looked for there too.
        limits: the uncertainty up to which a board's pose counts as located.
    """
    configs = [arm.board for arm in rig.arms]
    boards, camera = [config.board for config in configs if config], lens.camera
    if lens.focal.reason:
        sightings, markers = unlocated(grey, camera, boards, lens.focal.reason)
    else:
        T_boards = [rig.T_base_in_world(k) @ arm.T_board_in_base for k, arm in enumerate(rig.arms) if arm.board]
        seen_before = {arm.board: arm.sighting for arm in before.arms if arm.sighting} if before else {}
        poses = [one.T_board_in_cam if (one := seen_before.get(board.name)) else None for board in boards]
        sightings, markers = locate(grey, camera, boards, T_boards, poses, limits)
    by_board = {seen.board.name: seen for seen in sightings}
    arms = []
    for arm, config in zip(rig.arms, configs, strict=True):
        seen = by_board[config.board.name] if config else None
        T = None
        if config and seen and seen.T_board_in_cam is not None:
            T = seen.T_board_in_cam @ inverse(arm.T_board_in_base)
        arms.append(ArmPose(arm.name, config.name if config else None, seen.status if seen else NO_BOARD, seen, T))
    notes = _misfits(arms)
    arms = _of_one_size(rig, arms)
    ids = tuple(seen_ids(markers))
    result = PhotoResult(photo.path, lens, photo.joints_source, tuple(arms), ids, notes=notes, time=photo.time)
    result = _with_margin(rig, result)
    if trust_margin and len(arms) > 1 and result.bases:
        result = _trusting(rig, result, grey, camera)
    return result if photo.T_base_in_cam is None else _recorded(rig, result, photo.T_base_in_cam)


def _of_one_size(rig: RigConfig, arms: list[ArmPose]) -> list[ArmPose]:
    """The arms without the poses of two boards whose prints cannot both be of the sizes that the rig says."""
    seen = [k for k, arm in enumerate(arms) if arm.sighting and arm.sighting.status is Status.OK]
    for k, j in itertools.combinations(seen, 2):
        one, two = arms[k], arms[j]
        assert one.sighting and two.sighting
        T_one, T_two = (rig.T_base_in_world(n) @ rig.arms[n].T_board_in_base for n in (k, j))
        assert one.sighting.T_board_in_cam is not None
        # The margin is along world y.
        along = one.sighting.T_board_in_cam[:3, :3] @ T_one[:3, :3].T @ np.array([0.0, 1.0, 0.0])
        ratio = size_ratio(one.sighting, two.sighting, inverse(T_one) @ T_two, along)
        if ratio is None:
            continue
        reason = (
            f"the print of {two.name}'s board is {100 * ratio:.1f} % as large beside {one.name}'s as the rig says: "
            "measure both, and set the rig's marker_length_mm and gap_mm"
        )
        for n in (k, j):
            sighting = arms[n].sighting
            assert sighting is not None
            refused = replace(_without_pose(sighting), status=Status.POOR_FIT, reason=reason)
            arms[n] = replace(arms[n], status=refused.status, sighting=refused, T_base_in_cam=None)
        return arms
    return arms


def _without_pose(sighting: Sighting) -> Sighting:
    """Return a sighting without its pose, of an arm whose pose has another source or is refused."""
    return replace(sighting, T_board_in_cam=None, covariance=None, shared=None)


def _recorded(rig: RigConfig, result: PhotoResult, T_first_base_in_cam: Array) -> PhotoResult:
    """The result with the recorded poses of the arms for which no board gave one."""
    T_world_in_cam = T_first_base_in_cam @ inverse(rig.T_base_in_world(0))
    arms = tuple(
        replace(
            arm,
            status=RECORDED,
            sighting=arm.sighting and _without_pose(arm.sighting),
            T_base_in_cam=T_world_in_cam @ rig.T_base_in_world(k),
        )
        if not arm.located
        else arm
        for k, arm in enumerate(result.arms)
    )
    return replace(result, arms=arms)


def _misfits(arms: Sequence[ArmPose]) -> tuple[str, ...]:
    """A note on each board whose markers are not where rig and camera file put them."""
    return tuple(
        f"{arm.name}'s markers lie {rms:.2f} px from where its pose puts them: check the camera's distortion, and the "
        "rig's marker_length_mm and gap_mm against the print"
        for arm in arms
        if arm.located and arm.sighting
        if (rms := arm.sighting.reprojection_rms) is not None and rms > _PRINT_TOLERANCE
    )


def _with_margin(rig: RigConfig, result: PhotoResult) -> PhotoResult:
    """The result with the measured distance of the arms, and a note if it differs from the rig's."""
    if len(result.arms) < 2 or not all(arm.located for arm in result.arms[:2]):
        return result
    one, two = result.arms[:2]
    assert one.T_base_in_cam is not None and two.T_base_in_cam is not None
    measured = inverse(one.T_base_in_cam) @ two.T_base_in_cam
    expected = inverse(rig.T_base_in_world(0)) @ rig.T_base_in_world(1)
    # The margin is measured along world y, which is this direction in the first arm's frame.
    along = rig.T_base_in_world(0)[:3, :3].T @ np.array([0.0, 1.0, 0.0])
    margin = rig.margin + float(along @ (measured[:3, 3] - expected[:3, 3]))
    sigma = _margin_sigma(one, two, one.T_base_in_cam[:3, :3] @ along)
    notes = result.notes
    if abs(margin - rig.margin) > max(_MARGIN_TOLERANCE, 2 * sigma):
        notes += (
            f"the arms are {margin:.4f} m apart here (+- {sigma * 1000:.1f} mm) and {rig.margin:.4f} m in rig "
            f"{rig.name!r}: mend the rig's margin, or measure the prints",
        )
    return replace(result, T_arm2_in_arm1=measured, margin=margin, margin_sigma=sigma, notes=notes)


def _margin_sigma(one: ArmPose, two: ArmPose, direction: Array) -> float:
    """Standard deviation of two boards' distance along a direction (3,) of the camera's frame."""
    variance, scales = 0.0, []
    for arm in (one, two):
        assert arm.sighting is not None and arm.sighting.covariance is not None and arm.sighting.shared is not None
        assert arm.sighting.T_board_in_cam is not None and arm.T_base_in_cam is not None
        # If the board's pose turns about its centre, the base moves along with it.
        lever = arm.T_base_in_cam[:3, 3] - arm.sighting.T_board_in_cam[:3, 3]
        along = np.concatenate([np.cross(lever, direction), direction])
        shared = along @ arm.sighting.shared
        variance += float(along @ arm.sighting.covariance @ along - shared @ shared)
        scales.append(shared)
    # Errors of the lens and of the printer are the same for both boards: their difference counts, not their sum.
    apart = scales[1] - scales[0]
    return math.sqrt(max(0.0, variance) + float(apart @ apart))


def _trusting(rig: RigConfig, result: PhotoResult, grey: NDArray[np.uint8], camera: CameraModel) -> PhotoResult:
    """The result with all arms posed by one pose of the whole rig, which all found boards give together."""
    seen = [k for k, arm in enumerate(result.arms) if arm.sighting and arm.sighting.status is Status.OK]
    sightings, T_boards = [], []
    for k in seen:
        sighting = result.arms[k].sighting
        assert sighting is not None
        sightings.append(sighting)
        T_boards.append(rig.T_base_in_world(k) @ rig.arms[k].T_board_in_base)
    joint = locate_together(grey, camera, sightings, T_boards)
    if joint is None or joint[0].T_board_in_cam is None:
        refused = (
            f"the boards do not lie as rig {rig.name!r} says: its margin is not trusted, each arm has its own pose"
        )
        return replace(result, notes=(*result.notes, refused))
    T_world_in_cam = joint[0].T_board_in_cam @ inverse(T_boards[0])
    arms = []
    for k, arm in enumerate(result.arms):
        T = T_world_in_cam @ rig.T_base_in_world(k)
        if k in seen:
            arms.append(replace(arm, sighting=joint[seen.index(k)], T_base_in_cam=T))
        else:
            arms.append(
                replace(arm, status=INFERRED, sighting=arm.sighting and _without_pose(arm.sighting), T_base_in_cam=T)
            )
    return replace(result, arms=tuple(arms))
