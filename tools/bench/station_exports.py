"""`export maker` and `export abc`: seconds and bytes, and what a round trip changes.

    [YAMSIM_MAKER=CHECKOUT] [YAMSIM_ABC=CHECKOUT] python -m tools.bench.station_exports DATASET [--checked 5]

`import` reads the exports of the first episodes again. With the checkouts, the maker's converter to LeRobot and ABC's
converter run on them too, in environments of their own. Differences of numbers are maxima, those of images are means
over all pixels, of 255. The dataset has two arms and 30 frames a second, such as that of
`yamsim record --rig yam_station_linear_4310_d405 --n 100 --size 96x72 --quality fast --fps 30`.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.clients.environments import UnavailableError, checkout
from tests.clients.rows import ROWS
from tests.export.real_datasets import bring_in
from tests.export.station_datasets import images_of
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.resize import resize_image
from yamsim_cli.export.abc import episode_uuid

_FORMATS = {"maker": ["maker"], "release": ["abc"], "training": ["abc", "--layout", "training"]}
_RIG = "yam_station_linear_4310_d405"
_ROLES = ("top", "left", "right")  # of cameras, with which their names begin
_SQUARE = (224, 224)  # px, an image in ABC's layout for training
_PATIENCE_S = 3600  # s, for a converter; the machine may be busy
_NUMBERS = 28  # of a row in ABC's training layout: states and actions of two arms
_ACTIONS = "action-SIDE-joint action-SIDE-gripper"  # files of an episode of the maker's, for each SIDE


def main() -> None:
    """Measure, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--checked", type=int, default=5, help="episodes that are read again")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        report = {kind: measure_export(words, arguments.dataset, folder / kind) for kind, words in _FORMATS.items()}
        print(json.dumps({"exports": report}, indent=2), flush=True)
        trips = RoundTrips(arguments.dataset, arguments.checked, folder / "checked")
        print(json.dumps({"round_trips": trips.measure()}, indent=2))


def measure_export(words: list[str], dataset: Path, out: Path, *more: str) -> dict[str, float]:
    """Export with one process, and return its cost and the size of the output."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    command = [sys.executable, "-m", "yamsim_cli", "export", *words, str(dataset), str(out), "--workers", "1", *more]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    seconds = time.monotonic() - began
    if done.returncode:
        raise SystemExit(done.stderr)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    files = [path for path in out.rglob("*") if path.is_file()]
    return {"cpu_s": cpu, "s": seconds, "bytes": sum(path.stat().st_size for path in files), "files": len(files)}


class RoundTrips:
    """Exports of the first episodes, which are read again.

    Args:
        count: episodes.
        folder: for exports and imports.
    """

    def __init__(self, dataset: Path, count: int, folder: Path) -> None:
        self._count, self._folder, self._locations = count, folder, Locations.from_environment({})
        self._rig = load_config(RigConfig, "rigs", _RIG, self._locations)
        self._episodes = [open_recorded_episode(dataset / f"ep_{k:06d}") for k in range(count)]
        self._uuids = [f"episode_{episode_uuid(episode)}" for episode in self._episodes]
        self._images = {role: self._images_of(dataset, role) for role in _ROLES}
        folder.mkdir()
        for kind, words in _FORMATS.items():
            measure_export(words, dataset, folder / kind, "--episodes", f"0-{count - 1}")

    def measure(self) -> dict[str, Any]:
        """Return differences for each round trip."""
        release = self._folder / "release"
        report = {
            "ours -> maker -> ours": self._imported([self._folder / "maker"]),
            "ours -> ABC's release -> ours": self._imported(
                [next(release.glob(f"*/{name}/episode.mcap")) for name in self._uuids]
            ),
            "ours -> ABC's training -> ours": self._imported(
                [self._folder / "training" / name for name in self._uuids], squares=True
            ),
        }
        for name, measure in (
            ("ours -> maker -> LeRobot", self._lerobot),
            ("ours -> ABC's converter", self._converted),
        ):
            try:
                report[name] = measure()
            except UnavailableError as reason:
                report[name] = {"not measured": str(reason)}
        return report

    def _imported(self, sources: list[Path], squares: bool = False) -> dict[str, Any]:
        again = bring_in(self._folder / f"again_{sources[0].name}", sources, self._rig, self._locations)
        numbers = {}
        for key in ("joints", "ctrl"):
            pairs = [
                [rows_of(episode, key) for episode in (one, open_recorded_episode(again / f"ep_{k:06d}"))]
                for k, one in enumerate(self._episodes)
            ]
            numbers[key] = max(float(np.abs(one - other).max()) for one, other in pairs)
        images = {role: self._images_of(again, role) for role in _ROLES}
        return {"largest difference, rad and m": numbers, "images": self._image_difference(images, squares)}

    def _lerobot(self) -> dict[str, Any]:
        root, program = checkout("YAMSIM_MAKER"), ROWS["maker-lerobot"].environment.make()
        (task,) = (self._folder / "maker").iterdir()
        out, read = self._folder / "lerobot", self._folder / "read.npz"
        program.run("maker_to_lerobot.py", root, task, out, timeout_s=_PATIENCE_S)
        program.run("read_lerobot.py", out, read, timeout_s=_PATIENCE_S)
        found, numbers = np.load(read), {}
        for name, parts in (("observation.state", "SIDE-joint_pos SIDE-gripper_pos"), ("action", _ACTIONS)):
            files = [f"{part.replace('SIDE', side)}.npy" for side in ("left", "right") for part in parts.split()]
            folders = sorted(task.iterdir())
            rows = np.concatenate([np.hstack([np.load(path / file) for file in files]) for path in folders])
            numbers[name] = float(np.abs(found[name] - rows).max())
        images = {
            role: (255 * found[f"observation.images.{role}_rgb"].transpose(0, 2, 3, 1)).round().astype(np.uint8)
            for role in _ROLES
        }
        return {"largest difference, rad and shares": numbers, "images": self._image_difference(images)}

    def _converted(self) -> dict[str, Any]:
        script, program = checkout("YAMSIM_ABC") / "export_mcap.py", ROWS["abc-export"].environment.make()
        out = self._folder / "converted"
        words = [str(script), str(self._folder / "release"), str(out), "1"]
        done = program.call(words, timeout_s=_PATIENCE_S)
        if done.returncode:
            raise UnavailableError(done.stderr.strip().splitlines()[-1])
        differences = []
        for name in self._uuids:
            theirs, ours = (
                np.fromfile(folder / name / "states_actions.bin").reshape(-1, _NUMBERS)
                for folder in (out, self._folder / "training")
            )
            # Its rows begin one tick after the first message.
            differences.append(float(np.abs(theirs - ours[1:]).max()))
        return {"largest difference from --layout training, rad and shares": max(differences)}

    def _images_of(self, dataset: Path, role: str) -> Array:
        names = open_recorded_episode(dataset / "ep_000000").record.cameras
        (camera,) = (name for name in names if name.split("_")[0] == role)
        return np.concatenate([images_of(dataset, k, camera) for k in range(self._count)])

    def _image_difference(self, found: dict[str, Array], squares: bool = False) -> dict[str, float]:
        means = []
        for role, images in found.items():
            wanted = self._images[role]
            if squares:
                wanted = np.stack([resize_image(image, _SQUARE, pad=True) for image in wanted])
            means.append(np.abs(images.astype(np.int16) - wanted).mean(axis=(1, 2, 3)))
        return {"mean": float(np.concatenate(means).mean()), "worst image": float(np.concatenate(means).max())}


def rows_of(episode: Any, key: str) -> Array:
    """Return a key of an episode's frames, (n, values)."""
    return np.array([np.ravel(frame[key]) for frame in episode.frames()])


if __name__ == "__main__":
    main()
