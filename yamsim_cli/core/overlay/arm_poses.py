"""From a photo to each arm's base pose: from its own board, from all boards together, or from what was recorded."""

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
from ..vision.fiducials.focal import FocalEstimate, estimate_focal, known_focal, outlines_in
from ..vision.fiducials.locate import Sighting, Status, locate, locate_together, unlocated
from ..vision.fiducials.markers import seen_ids
from .photos import Photo

# Status of an arm that has a pose without its own board: from the other board and the rig, or from the recording.
INFERRED = "inferred"
RECORDED = "recorded"
NO_BOARD = "no_board"

# Markers that lie farther (px) from where the pose puts them are worth a word.
_PRINT_TOLERANCE = 0.5
# A margin that is off by more than this (m), and by more than it is known to, is worth a word.
_MARGIN_TOLERANCE = 0.002

# Photos of one unknown camera that its focal length is estimated from, and that are looked at for boards, at most.
_PHOTOS_FOR_FOCAL = 8
_PHOTOS_TO_SEARCH = 40


@dataclass(frozen=True)
class Lens:
    """Through what a photo was taken, and where these figures come from: "file", "episode" or "estimated"."""

    focal: FocalEstimate
    source: str

    @classmethod
    def known(cls, camera: CameraModel, source: str) -> Lens:
        """That of a camera which somebody calibrated."""
        return cls(known_focal(camera), source)

    @property
    def camera(self) -> CameraModel:
        """The camera, as far as it is known."""
        return self.focal.camera


@dataclass(frozen=True)
class ArmPose:
    """What a photo says of one arm.

    Attributes:
        board: the board's name, None for an arm without one.
        status: "ok", or why the board gives no pose; "inferred" and "recorded" where the pose came another way.
        sighting: what was found of the board.
        T_base_in_cam: pose (4, 4) of the arm's base; None without.
        edge_residual: median distance (px) of the drawn outline to the photo's edges.
    """

    name: str
    board: str | None
    status: str
    sighting: Sighting | None = None
    T_base_in_cam: Array | None = None
    edge_residual: float | None = None


@dataclass(frozen=True)
class PhotoResult:
    """What a photo says of a rig.

    Attributes:
        lens: the camera that took it.
        joints_source: where the joints come from: "home", "file" or "episode".
        ids: of all markers that were read, whosever they are.
        T_arm2_in_arm1: measured pose (4, 4), each arm's from its own board; None unless both were found.
        margin: the distance between the arms that this amounts to, m.
        margin_sigma: its standard deviation, m.
        edge_residual: median distance (px) of all drawn outlines to the photo's edges.
        iou: overlap with the user's mask, 0..1.
        notes: for a person.
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

    @property
    def bases(self) -> dict[int, Array]:
        """Index -> pose (4, 4) of the base in the camera's frame, of all arms that have one."""
        return {k: arm.T_base_in_cam for k, arm in enumerate(self.arms) if arm.T_base_in_cam is not None}


def unknown_lens(images: Iterable[Image], size: tuple[int, int], rig: RigConfig) -> Lens:
    """The lens of photos that nothing is known of, from the boards in them; all of one size (height, width)."""
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


def find_arms(rig: RigConfig, photo: Photo, grey: NDArray[np.uint8], lens: Lens, trust_margin: bool) -> PhotoResult:
    """Each arm's pose from its board; else from the other's or from the recording.

    Args:
        photo: what is known of it beside its camera.
        grey: the photo (height, width).
        lens: through which it was taken; if its focal length is not told well enough, no board gives a pose.
        trust_margin: the arms stand as the rig says, so all boards together give one pose of the rig.
    """
    configs = [arm.board for arm in rig.arms]
    boards, camera = [config.board for config in configs if config], lens.camera
    if lens.focal.reason:
        sightings, markers = unlocated(grey, camera, boards, lens.focal.reason)
    else:
        sightings, markers = locate(grey, camera, boards)
    by_board = {seen.board.name: seen for seen in sightings}
    arms = []
    for arm, config in zip(rig.arms, configs, strict=True):
        seen = by_board[config.board.name] if config else None
        T = None
        if config and seen and seen.T_board_in_cam is not None:
            T = seen.T_board_in_cam @ inverse(config.T_board_in_arm)
        arms.append(ArmPose(arm.name, config.name if config else None, seen.status if seen else NO_BOARD, seen, T))
    ids = tuple(seen_ids(markers))
    result = PhotoResult(photo.path, lens, photo.joints_source, tuple(arms), ids, notes=_misfits(arms))
    result = _with_margin(rig, result)
    if trust_margin and len(arms) > 1 and result.bases:
        result = _trusting(rig, result, grey, camera)
    return result if photo.T_base_in_cam is None else _recorded(rig, result, photo.T_base_in_cam)


def _recorded(rig: RigConfig, result: PhotoResult, T_first_base_in_cam: Array) -> PhotoResult:
    """Arms that no board gave a pose, where they stood when the episode was recorded."""
    T_world_in_cam = T_first_base_in_cam @ inverse(rig.T_base_in_world(0))
    arms = tuple(
        replace(arm, status=RECORDED, T_base_in_cam=T_world_in_cam @ rig.T_base_in_world(k))
        if arm.T_base_in_cam is None
        else arm
        for k, arm in enumerate(result.arms)
    )
    return replace(result, arms=arms)


def _misfits(arms: Sequence[ArmPose]) -> tuple[str, ...]:
    """A word on each board whose print is not quite as the rig and the camera file have it."""
    return tuple(
        f"{arm.name}'s markers lie {rms:.2f} px from where its pose puts them: check the camera's distortion, and the "
        "rig's marker_length_mm and gap_mm against the print"
        for arm in arms
        if arm.T_base_in_cam is not None and arm.sighting
        if (rms := arm.sighting.reprojection_rms) is not None and rms > _PRINT_TOLERANCE
    )


def _with_margin(rig: RigConfig, result: PhotoResult) -> PhotoResult:
    """The arms' measured distance beside the rig's."""
    if len(result.arms) < 2 or any(arm.T_base_in_cam is None for arm in result.arms[:2]):
        return result
    one, two = result.arms[:2]
    assert one.T_base_in_cam is not None and two.T_base_in_cam is not None
    measured = inverse(one.T_base_in_cam) @ two.T_base_in_cam
    expected = inverse(rig.T_base_in_world(0)) @ rig.T_base_in_world(1)
    # The margin is along world y, which is so in the first arm's frame:
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
        # A turn of the board about its centre swings the base, which is fixed to it.
        lever = arm.T_base_in_cam[:3, 3] - arm.sighting.T_board_in_cam[:3, 3]
        along = np.concatenate([np.cross(lever, direction), direction])
        shared = along @ arm.sighting.shared
        variance += float(along @ arm.sighting.covariance @ along - shared @ shared)
        scales.append(shared)
    # One lens and one printer: their mistakes do not add up by chance.
    apart = scales[1] - scales[0]
    return math.sqrt(max(0.0, variance) + float(apart @ apart))


def _trusting(rig: RigConfig, result: PhotoResult, grey: NDArray[np.uint8], camera: CameraModel) -> PhotoResult:
    """All arms from one pose of the whole rig, which all boards that were found give together."""
    seen = [k for k, arm in enumerate(result.arms) if arm.sighting and arm.sighting.status is Status.OK]
    sightings, T_boards = [], []
    for k in seen:
        config, sighting = rig.arms[k].board, result.arms[k].sighting
        assert config is not None and sighting is not None
        sightings.append(sighting)
        T_boards.append(rig.T_base_in_world(k) @ config.T_board_in_arm)
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
            arms.append(replace(arm, status=INFERRED, T_base_in_cam=T))
    return replace(result, arms=tuple(arms))
