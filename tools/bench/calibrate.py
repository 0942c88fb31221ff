"""Errors, coverage of intervals and refusals of `yamsim calibrate` for stations with planted truth, and its cost.

    python -m tools.bench.calibrate [--stations N] [--first SEED] [--size 640x480] [--task swap] [--keep out/bench]
    python -m tools.bench.calibrate --renderer filament --size 640x480 --hand
    python -m tools.bench.calibrate --arms 2 --wrist --size 640x480
    python -m tools.bench.calibrate --boards --size 640x480

Each station has its own camera, lights, table and floor, four episodes of `pickplace` with distractors (or as `--task`
and `--episodes` say), joint offsets, a delay of the pictures and an error of the given focal length. Pictures have full
meshes, shadows, noise, blur and JPEG; the fit renders the same meshes without light. With `--arms 2`, the second base
is not where the rig has it, and with `--wrist`, wrist cameras are not. `--renderer filament` takes the fixed camera's
pictures with MuJoCo's physically based renderer, see `tools.bench.filament_pictures`. Seeds up to 1010 served
development, those above did not. A given focal length is not changed: its error is that of the planted camera file.

With `--mixed`, each seed chooses renderer, lens, hand, compression and number of arms; table and floor have textures,
and joint offsets and delays are up to 3 degrees and 120 ms.

With `--rolling`, the fixed camera has a rolling shutter of 30 ms.

With `--boards`, a fiducial board lies beside the arm in the same pictures. The bench compares the poses of `calibrate`
and of `overlay`, which reads the board, with the truth and with each other.

The command runs with wide limits. The bench counts which poses `--max-shift` and `--max-turn` would refuse.
"""

from __future__ import annotations

import argparse
import json
import resource
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from tools.bench.board_poses import board_pose, both_widths, in_measured_base, pose_difference
from tools.bench.calibration_stations import (
    CAMERA,
    CLASSIC,
    FILAMENT,
    LENSES,
    Planted,
    StationOptions,
    record_station,
    run_yamsim,
)
from yamsim_cli.core.files.writing import scratch_directory
from yamsim_cli.core.geometry.se3 import Array, pose_from_quat

WIDE = 200, 20  # mm and degrees, limits that refuse no pose for its interval


def calibrate_station(
    folder: Path, planted: Planted, options: StationOptions, known_focal: bool, near: Path | None = None
) -> dict[str, Any]:
    """Return errors and intervals of a station's calibration, or its refusal; `near` is an earlier calibration."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    names = [CAMERA, *planted.T_wrist_in_flange]
    given = [name if name == CAMERA and not known_focal else f"{name}={folder / f'{name}.yaml'}" for name in names]
    cameras = [part for value in given for part in ("--camera", value)]
    text = run_yamsim(
        *("calibrate", folder / "episodes", "--rig", options.rig, *cameras, "--frames", options.frames, "--json"),
        *("--max-shift", WIDE[0], "--max-turn", WIDE[1], "--out", folder / "calibration", "--overwrite"),
        *(("--near", near) if near else ()),
        codes=(0, 4, 6),
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(text)
    row: dict[str, Any] = {"cpu_s": after.ru_utime - before.ru_utime, "max_rss_mb": after.ru_maxrss / 1024}
    figures = [*report["cameras"], *report["wrist_cameras"]]
    row["figures"] = {key: value for key, value in figures[0].items() if key != "name"}
    row["refused"] = {one["name"]: one["reason"] for one in figures if one["status"] == "refused"}
    row["errors"] = [] if report["calibration"] is None else calibration_errors(report["calibration"], planted)
    if options.boards and report["calibration"] is not None:
        row["errors"] += board_errors(folder, report["calibration"]["cameras"][0], planted, options)
    return row


def board_errors(
    folder: Path, camera: Mapping[str, Any], planted: Planted, options: StationOptions
) -> list[dict[str, Any]]:
    """Return the errors of the pose by the board, and its distance from a calibrated camera; empty without a board."""
    found = board_pose(folder, options)
    if found is None:
        return []
    board = in_measured_base(found, planted)
    shift, turn = pose_difference(camera, pose_from_quat(board["position"], board["quat"]))
    return [
        *_pose_errors("board", board, planted.T_cam_in_base),
        _error("calibrate minus board, mm", shift, both_widths(camera, board, "position_95_mm")),
        _error("calibrate minus board, degrees", turn, both_widths(camera, board, "rotation_95_deg")),
    ]


def calibration_errors(found: Mapping[str, Any], planted: Planted) -> list[dict[str, Any]]:
    """Return the errors and half widths of 95 % intervals of each estimated quantity."""
    rows = []
    for wrist in found["wrist_cameras"]:
        rows += _pose_errors("wrist camera", wrist, planted.T_wrist_in_flange[wrist["name"]])
        rows += _k1_error("wrist camera's k1, thousandths", wrist, planted.wrist_k1.get(wrist["name"], 0.0))
    return [*_station_errors(found, planted), *rows] if found["cameras"] else rows


def _station_errors(found: Mapping[str, Any], planted: Planted) -> list[dict[str, Any]]:
    """Return the errors of the fixed camera, the arms and the second base."""
    camera, arms = found["cameras"][0], found["arms"]
    order = sorted(arms, key=lambda arm: arm["name"] != found["reference"])
    offsets = np.degrees(planted.offsets).reshape(len(arms), 6)
    rows = _pose_errors("camera", camera, planted.T_cam_in_base)
    rows += [
        *_k1_error("distortion k1, thousandths", camera, planted.k1),
        _error("focal length, %", 100 * (camera["K"][0][0] / planted.focal - 1), camera["focal_95_percent"]),
        _error("delay, ms", camera["delay_ms"] - 1000 * planted.delay, camera["delay_95_ms"]),
    ]
    for arm, truth in zip(order, offsets, strict=True):
        # The first joint's offset is 0 by definition.
        error = (np.array(arm["joint_offsets_deg"]) - truth)[1:]
        rows.append(_error("joint offsets, degrees", error, arm["joint_offsets_95_deg"][1:]))
    if planted.T_arm_in_base is not None:
        rows += _pose_errors("second base", order[1], planted.T_arm_in_base)
    return rows


def _k1_error(quantity: str, camera: Mapping[str, Any], truth: float) -> list[dict[str, Any]]:
    """Return the error of a camera's distortion; empty unless it was estimated."""
    if camera["k1_95"] is None:
        return []
    return [_error(quantity, 1000 * (camera["distortion"][0] - truth), 1000 * camera["k1_95"])]


def _pose_errors(what: str, found: Mapping[str, Any], truth: Array) -> list[dict[str, Any]]:
    shift, turn = pose_difference(found, truth)
    return [
        _error(f"{what}, mm", shift, found["position_95_mm"]),
        _error(f"{what}, degrees", turn, found["rotation_95_deg"]),
    ]


def _error(quantity: str, error: Array | float, width: Any) -> dict[str, Any]:
    return {
        "quantity": quantity,
        "error": np.atleast_1d(error).tolist(),
        "width": np.atleast_1d(np.asarray(width, dtype=np.float64)).tolist(),
    }


def summarize(rows: list[dict[str, Any]], limits: tuple[float, float], console: Console) -> None:
    """Print errors, coverage and refusals; `limits` are in mm and degrees."""
    for row in rows:
        for name, reason in row["refused"].items():
            console.print(f"  station {row['seed']}, {name} refused: {reason}")
    errors = [error for row in rows for error in row["errors"]]
    for quantity in dict.fromkeys(error["quantity"] for error in errors):
        own = [error for error in errors if error["quantity"] == quantity]
        is_pose = quantity.endswith((", mm", ", degrees")) and not quantity.startswith("joint")
        whole = [np.linalg.norm(one["error"]) if is_pose else np.abs(one["error"]) for one in own]
        low, middle, high = np.quantile(np.hstack(whole), (0.5, 0.95, 1.0))
        error, width = np.concatenate([one["error"] for one in own]), np.concatenate([one["width"] for one in own])
        ratio = np.abs(error) / np.maximum(width, 1e-9)
        line = (
            f"{quantity}: {low:.2f} / {middle:.2f} / {high:.2f} (median / 95 % / maximum); {(ratio <= 1).sum()} of "
            f"{len(ratio)} values inside their 95 % interval, the worst at {ratio.max():.1f} intervals; median "
            f"interval {np.median(width):.2f}"
        )
        if is_pose and not quantity.startswith("second"):
            widest = np.array([max(one["width"]) for one in own])
            limit = limits[0] if quantity.endswith("mm") else limits[1]
            line += f", widest of a pose {widest.min():.2f} to {widest.max():.2f}, {(widest > limit).sum()} of "
            line += f"{len(own)} over {limit:g}"
        console.print(line)
    cpu, memory = [row["cpu_s"] for row in rows], max(row["max_rss_mb"] for row in rows)
    console.print(f"{np.median(cpu):.0f} s of a core a station (median), {memory:.0f} MB at most")


def station_line(row: Mapping[str, Any]) -> str:
    """Return a line about a station."""
    norms = [f"{one['quantity']} {np.linalg.norm(one['error']):.2f}" for one in row["errors"]]
    refused = [f"{name}: {reason}" for name, reason in row["refused"].items()]
    return f"{row['seed']}: {'; '.join(norms + refused)}; {row['cpu_s']:.0f} s of a core"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stations", type=int, default=12)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first station")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--task", default="pickplace")
    parser.add_argument("--episodes", type=int, default=4, help="of each station")
    parser.add_argument("--renderer", choices=(CLASSIC, FILAMENT), default=CLASSIC)
    parser.add_argument("--arms", type=int, choices=(1, 2), default=1)
    parser.add_argument("--wrist", action="store_true", help="wrist cameras too")
    parser.add_argument("--lens", choices=LENSES, default="none", help="distortion that the camera file has or lacks")
    parser.add_argument("--wrist-lens", action="store_true", help="distortion of wrist cameras that their files lack")
    parser.add_argument("--hand", action="store_true", help="a hand hides part of some pictures")
    parser.add_argument("--h264", action="store_true", help="a video instead of JPEG")
    parser.add_argument("--boards", action="store_true", help="a board beside the arm, and poses by it")
    parser.add_argument("--rolling", action="store_true", help="a rolling shutter, with --renderer filament")
    parser.add_argument("--hard", action="store_true", help="textures, and larger joint offsets and delays")
    parser.add_argument(
        "--mixed", action="store_true", help="hard stations; the seed chooses all options but --size and --frames"
    )
    parser.add_argument("--only-record", action="store_true", help="record stations into --keep, and end")
    parser.add_argument("--unknown-focal", action="store_true", help="do not give the camera's calibration")
    parser.add_argument("--max-shift", type=float, default=5.0, help="mm, of intervals that count as refused")
    parser.add_argument("--max-turn", type=float, default=0.5, help="degrees, likewise")
    parser.add_argument("--keep", type=Path, help="folder for episodes and results; recorded episodes are used again")
    given = parser.parse_args()
    same = StationOptions(**{field.name: getattr(given, field.name) for field in fields(StationOptions)})
    if same.h264 and same.renderer == FILAMENT:
        parser.error("--h264 needs all pictures, and Filament renders those that the fit reads; leave one out")
    if same.rolling and same.renderer != FILAMENT:
        parser.error("--rolling is for --renderer filament")
    if same.boards and (same.arms == 2 or same.wrist):
        parser.error("--boards is for one arm without wrist cameras")
    if given.only_record and not given.keep:
        parser.error("--only-record needs --keep")
    console, rows = Console(width=240), []
    with scratch_directory("yamsim-calibrate-") as scratch:
        for seed in range(given.first, given.first + given.stations):
            options = StationOptions.mixed(seed, given.size, given.frames) if given.mixed else same
            folder = (given.keep or scratch) / options.folder(seed)
            truth = folder / "truth.json"
            if truth.is_file():
                planted = Planted.load(truth)
            else:
                planted = record_station(seed, folder, options)
                planted.save(truth)
            if given.only_record:
                console.print(f"{seed}: {folder}")
                continue
            row = calibrate_station(folder, planted, options, not given.unknown_focal) | {"seed": seed}
            rows.append(row)
            suffix = "_unknown_focal" if given.unknown_focal else ""
            (folder / f"result_{options.frames}{suffix}.json").write_text(json.dumps(row, indent=1))
            console.print(station_line(row), highlight=False)
    if rows:
        summarize(rows, (given.max_shift, given.max_turn), console)


if __name__ == "__main__":
    main()
