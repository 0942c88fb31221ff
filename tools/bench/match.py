"""Errors of `yamsim match` for stations with hidden truth, and its likeness to a photo that was not given to it.

    python -m tools.bench.match [--stations N] [--first SEED] [--photos N] [--size 640x480] [--picture FILE]
        [--filament]

Each station has its own light, table texture, floor, camera with distortion and arm postures. Photos have whole meshes,
finer shadows and edges, noise, blur and JPEG; the match has reduced meshes. The camera's pose is given, as by a
calibration. Seeds below 100 served development, those above did not.

With `--filament`, another renderer makes the photos: physically based shading and other tones, see
`filament_pictures`. The renderings "before" have the scene that was not matched.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.hidden_stations import HiddenStation, RenderPositions, calibration_of, hidden_station, take_photos
from tools.bench.filament_pictures import render_positions
from tools.bench.likeness import COARSE, ViewOfStation, accuracy
from tools.bench.pictures import ssim
from yamsim_cli.core.files.writing import scratch_directory, write_file
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.session_opener import SessionOpener, parse_size

_JPEG = 92


@dataclass(frozen=True)
class Measured:
    """Figures of a station, its unseen photo with renderings of the same state, and all of them side by side."""

    figures: dict[str, Any]
    view: ViewOfStation
    row: Image


def main() -> None:
    """Measure, and print one line of JSON for each station, then medians and extremes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stations", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--photos", type=int, default=3)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--picture", type=Path, help="JPEG of photos, matches and the scene before")
    parser.add_argument("--filament", action="store_true", help="render the photos with Filament")
    given = parser.parse_args()
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    render = render_positions if given.filament else None
    stations = []
    for seed in range(given.first, given.first + given.stations):
        stations.append(measure(opener, seed, given.photos, parse_size(given.size), render))
        print(json.dumps(stations[-1].figures), flush=True)
    for key in (key for key in stations[0].figures if key != "seed"):
        values = sorted(one.figures[key] for one in stations)
        print(f"{key}: median {np.median(values):.3g}, {values[0]:.3g} to {values[-1]:.3g}")
    if len(stations) > 1:
        print_accuracies([one.view for one in stations])
    if given.picture:
        write_file(given.picture, encode_jpeg(np.concatenate([one.row for one in stations]), 88))


def print_accuracies(views: list[ViewOfStation]) -> None:
    """Print the accuracy with which held-out patches are classified as photos or renderings."""
    for region in ("all", "arms"):
        for blur in (0.0, COARSE):
            shares = {
                name: accuracy(views, name, arms_only=region == "arms", blur=blur) for name in views[0].renderings
            }
            told = ", ".join(f"{name} {share:.3f}" for name, share in shares.items())
            print(f"classifier, {region}, blurred by {blur:g} px: {told}")


def measure(
    opener: SessionOpener, seed: int, photos: int, size: tuple[int, int], render: RenderPositions | None
) -> Measured:
    """Match a station to some photos, and compare the result with one more. `render` makes the photos, if given."""
    from yamsim_cli.calibration.calibration_file import load_calibration
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.match.match_run import MatchRequest, match_station

    where = opener.choose_gl_backend(opener.find_locations())
    station = hidden_station(seed, where, photos + 1, size)
    where = opener.with_mesh_folders(where, visual_mesh_sets(Blueprint(station.rig, station.scene)))
    base, studio = (load_config(SceneConfig, "scenes", name, where) for name in ("tabletop", "studio"))
    quality = load_config(RenderConfig, "quality", "balanced", where)
    taken = take_photos(station, where, seed, render)
    with scratch_directory("match_") as folder:
        (folder / "masks").mkdir()
        for k, (photo, mask) in enumerate(taken):
            write_file(folder / f"photo_{k}.jpg", encode_jpeg(photo, _JPEG))
            write_file(folder / "masks" / f"photo_{k}.png", encode_png(np.where(mask, 255, 0).astype(np.uint8)))
        write_file(folder / "calibration.yaml", calibration_of(station).encode())
        calibration = load_calibration(folder / "calibration.yaml", where)
        request = MatchRequest(
            [folder / f"photo_{k}.jpg" for k in range(photos)],
            station.postures[:photos],
            placed=calibration.placed_camera(calibration.camera(None, "--calibrated-camera")),
            masks=folder / "masks",
        )
        start = _cpu()
        done = match_station(station.rig, base, studio, quality, request, where, lambda *_: None)
        seconds = _cpu() - start
    after, before, arms = _unseen(station, done.scene, base, done.view, quality, where)
    photo, mask = (done.view.undistort(image) for image in (taken[-1][0], taken[-1][1].astype(np.uint8)))
    light = done.light.light.direction if done.light else (0.0, 0.0, -1.0)
    cosine = float(np.dot(light, station.direction) / np.linalg.norm(light))
    figures = {
        "seed": seed,
        "light_deg": math.degrees(math.acos(min(1.0, cosine))),
        "iou": float(np.mean([one.iou for one in done.photos])),
        "outline_px": float(np.mean([one.outline_px for one in done.photos])),
        "unseen_iou": float((arms & (mask > 0)).sum() / (arms | (mask > 0)).sum()),
        "unseen_arms_before": _apart(before, photo, arms),
        "unseen_arms_after": _apart(after, photo, arms),
        "unseen_all_before": _apart(before, photo, np.ones_like(arms)),
        "unseen_all_after": _apart(after, photo, np.ones_like(arms)),
        "unseen_ssim_before": ssim(before, photo),
        "unseen_ssim_after": ssim(after, photo),
        "filled_percent": 100 * done.plate.filled_share,
        "cpu_s": seconds,
    }
    shown = [cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA) for image in (photo, after, before)]
    rounded = {key: round(value, 4) for key, value in figures.items()}
    view = ViewOfStation(photo, {"before": before, "after": after}, arms)
    return Measured(rounded, view, np.asarray(np.concatenate(shown, axis=1), np.uint8))


def _unseen(
    station: HiddenStation, matched: Any, base: Any, view: Any, quality: Any, where: Any
) -> tuple[Image, Image, np.ndarray]:
    """Return the last posture in the matched scene and in the scene before, and where the arms are."""
    from yamsim_cli.core.config.recording import SCENE_CAMERA
    from yamsim_cli.match.station_renderer import StationRenderer

    size = view.intrinsics.width, view.intrinsics.height
    images = []
    arms = np.zeros(size[::-1], bool)
    for scene in (matched, base):
        camera = replace(view.scene_camera, name=SCENE_CAMERA)
        with StationRenderer(station.rig, scene, quality, camera, size, where) as renderer:
            renderer.set_postures(station.postures[-1])
            images.append(renderer.render())
            arms = renderer.masks()[0]
    return images[0], images[1], arms


def _apart(image: Image, photo: Image, where: np.ndarray) -> float:
    return float(np.abs(image[where].astype(float) - photo[where]).mean())


def _cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
