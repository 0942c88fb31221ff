"""Report an overlay run by captions, JSON and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import PartialJobError, ResourceError
from yamsim_cli.core.files.documents.json_text import json_text
from yamsim_cli.core.files.writing import write_output
from yamsim_cli.core.geometry.se3 import Array, invert_pose

from .move_detection import DetectedMove, MoveReport
from .photo_arm_poses import STATUS_INFERRED_FROM_OTHER_BOARD, STATUS_RECORDED, ArmBasePose, RigInPhoto

REPORT_NAME = "overlay.json"


@dataclass
class OverlayReport:
    """The results of an overlay run: written `files`, violated limits (`failures`), and `unreadable` photos."""

    rig: RigConfig
    results: list[RigInPhoto] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    move_report: MoveReport = field(default_factory=MoveReport)

    def to_json_data(self) -> dict[str, Any]:
        """Return data for JSON: m, rad, poses (4, 4) row by row."""
        return {
            "images": [_result_data(result, self.rig) for result in self.results],
            "files": [str(path) for path in self.files],
            "failures": list(self.failures),
            "unreadable": list(self.unreadable),
            "still": None if self.move_report.why_unknown else not self.move_report.moves,
            "still_unknown": self.move_report.why_unknown,
            "moved": [_move_data(move) for move in self.move_report.moves],
        }

    def write_report(self, out: Path) -> None:
        """Write the report into the folder `out`."""
        self.files.append(out / REPORT_NAME)
        write_output(out / REPORT_NAME, json_text(self.to_json_data()).encode())

    def raise_for_failures(self) -> None:
        """Raise an error for photos without a pose and for violated limits.

        Raises:
            ResourceError: no photo gives a pose, or a photo violates a limit.
            PartialJobError: some photos give a pose, others give none or cannot be read.
        """
        without = [result for result in self.results if not result.base_poses]
        if len(without) == len(self.results):
            raise ResourceError(_nothing_found_message(without, self.rig))
        if self.failures:
            raise ResourceError(_first_message(self.failures))
        if self.unreadable:
            raise PartialJobError(_first_message(self.unreadable))
        if without:
            raise PartialJobError(
                f"{len(without)} of {len(self.results)} photos give no pose, first "
                f"{_nothing_found_message(without[:1], self.rig)}"
            )


def photo_captions(result: RigInPhoto) -> list[str]:
    """Return text to draw: a line per arm, then joints, lens and distance of the arms."""
    lines = []
    for arm in result.arms:
        text = f"{arm.name}: {arm.status}"
        if arm.detection and (
            arm.detection.markers or arm.status not in (STATUS_INFERRED_FROM_OTHER_BOARD, STATUS_RECORDED)
        ):
            text += f", {len(arm.detection.markers)}/{len(arm.detection.board.marker_ids)} markers"
            if arm.detection.reprojection_rms is not None:
                text += f", {arm.detection.reprojection_rms:.2f} px"
        if arm.edge_residual is not None:
            text += f", outline {arm.edge_residual:.1f} px"
        lines.append(text)
    if result.joints_source == "home" and result.base_poses:
        lines.append("joints not given: arms shown at home")
    focal = result.lens.focal
    if result.lens.source == "estimated" and not focal.reason:
        within = f"within {focal.low:.0f} to {focal.high:.0f} px"
        lines.append(f"focal length estimated: {focal.camera.mean_focal_length:.0f} px, {within}")
    elif result.lens.source == "estimated" and any(arm.detection and arm.detection.markers for arm in result.arms):
        lines.append(f"no pose: {focal.reason}")
    if result.margin is not None:
        lines.append(f"margin measured: {result.margin:.4f} m")
    return lines


def _first_message(messages: Sequence[str]) -> str:
    more = f" (and {len(messages) - 1} more)" if len(messages) > 1 else ""
    return f"{messages[0]}{more}"


def _nothing_found_message(results: Sequence[RigInPhoto], rig: RigConfig) -> str:
    first = results[0]
    boards = [arm.board for arm in rig.arms if arm.board]
    wanted = ", ".join(
        f"{board.board_in_metres.marker_ids[0]}-{board.board_in_metres.marker_ids[-1]} ({board.dictionary})"
        for board in boards
    )
    seen = ", ".join(map(str, first.ids)) or "none"
    focal = first.lens.focal.reason
    refused = [
        f"{arm.name}: {arm.detection.failure_explanation}"
        for arm in first.arms
        if arm.detection and arm.detection.reason
    ]
    # All arms share the lens, so its problem is named once.
    why = f"; {focal if focal else '; '.join(refused)}" if refused else ""
    more = f" (and {len(results) - 1} more photos)" if len(results) > 1 else ""
    return f"{first.path}{more}: no board gives a pose: looked for marker ids {wanted or 'none'}, saw {seen}{why}"


def _move_data(move: DetectedMove) -> dict[str, Any]:
    return {
        "frame": move.photo,
        "image": str(move.path),
        "time_s": move.time,
        "what": str(move.what),
        "arm": move.arm,
        "shift_m": move.shift,
        "shift_sigma_m": move.shift_sigma,
        "turn_rad": move.turn,
        "turn_sigma_rad": move.turn_sigma,
        "shift_in_base_m": move.shift_in_base.tolist(),
    }


def _result_data(result: RigInPhoto, rig: RigConfig) -> dict[str, Any]:
    camera, focal = result.lens.camera, result.lens.focal
    return {
        "image": str(result.path),
        "time_s": result.time,
        "camera": {
            "source": result.lens.source,
            "K": [list(row) for row in camera.K],
            "distortion": list(camera.distortion),
            "width": camera.width,
            "height": camera.height,
            "focal_sigma": camera.focal_sigma,
            "focal_low": focal.low,
            "focal_high": focal.high,
        },
        "joints": result.joints_source,
        "ids_seen": list(result.ids),
        "arms": [_arm_data(arm) for arm in result.arms],
        "T_arm2_in_arm1": _matrix_rows(result.T_arm2_in_arm1),
        "margin_m": result.margin,
        "margin_sigma_m": result.margin_sigma,
        "rig_margin_m": rig.margin if len(rig.arms) > 1 else None,
        "edge_residual_px": result.edge_residual,
        "iou": result.iou,
        "notes": list(result.notes),
    }


def _arm_data(arm: ArmBasePose) -> dict[str, Any]:
    seen = arm.detection
    return {
        "name": arm.name,
        "board": arm.board,
        "status": str(arm.status),
        "reason": seen.reason if seen else "",
        "advice": list(seen.advice) if seen else [],
        "markers_found": len(seen.markers) if seen else 0,
        "marker_ids": list(seen.markers) if seen else [],
        "T_board_in_cam": _matrix_rows(seen.T_board_in_cam if seen else None),
        "T_base_in_cam": _matrix_rows(arm.T_base_in_cam),
        "T_cam_in_base": _matrix_rows(None if arm.T_base_in_cam is None else invert_pose(arm.T_base_in_cam)),
        "covariance": _matrix_rows(seen.covariance if seen else None),
        "position_sigma_m": seen.position_sigma if seen else None,
        "rotation_sigma_rad": seen.rotation_sigma if seen else None,
        "reprojection_rms_px": seen.reprojection_rms if seen else None,
        "blur_px": seen.blur.blur if seen and seen.blur else None,
        "motion_px": seen.blur.motion_length if seen and seen.blur else None,
        "edge_residual_px": arm.edge_residual,
    }


def _matrix_rows(matrix: Array | None) -> list[list[float]] | None:
    return None if matrix is None else matrix.tolist()
