"""Show a recorded episode: as a film of its images, drawn anew, or in a viewer; and its actions again in physics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..attempt.runner import EpisodeRunner
from ..config.recording import RecordConfig
from ..dataset.compare import Comparison
from ..dataset.lowdim import has_simulation
from ..dataset.reader import StoredEpisode
from ..dataset.recorded_images import RecordedImages, recorded_images
from ..errors import DatasetError, UsageError, suggest
from ..geometry.se3 import Array
from ..images.image import Image
from ..images.video import VideoWriter
from ..resources import Locations
from ..verify.remake import repeat_actions, vary
from ..viewers.address import PageAddress
from ..viewers.player import EpisodePlayer
from .view import PERIOD, require_page, run_page, task_viewpoint

Meshes = Mapping[str, Path | None]


@dataclass(frozen=True)
class Film:
    """A video that was written: its length in s, its size in pixels, and where an older file of its name went."""

    path: Path
    frames: int
    seconds: float
    size: tuple[int, int]
    cameras: tuple[str, ...]
    moved_aside: Path | None


def film_recorded(
    episode: StoredEpisode, cameras: Sequence[str], path: Path, frame_period: float, *, overwrite: bool
) -> Film:
    """Make a video of the images that were recorded.

    Args:
        cameras: whose, side by side; none for the first one.
        frame_period: from one frame to the next in the video, s.

    Raises:
        UsageError: there is no such camera, or the file is in the way.
        DatasetError: an image is missing, altered or damaged; there is no video then.
        ResourceError: see `VideoWriter`.
    """
    chosen = _choose(cameras, tuple(episode.record.cameras))
    return _film(recorded_images(episode, chosen), chosen, path, frame_period, overwrite=overwrite)


def film_rendered(
    episode: StoredEpisode,
    runner: EpisodeRunner,
    cameras: Sequence[str],
    path: Path,
    frame_period: float,
    *,
    overwrite: bool,
) -> Film:
    """Make a video of an episode drawn anew.

    Args:
        runner: see `scene_config`.

    Raises:
        DatasetError: the episode was not simulated, or in another scene.
        UsageError, ResourceError: as for `film_recorded`.
    """
    chosen = _choose(cameras, runner.scene.cameras)
    vary(runner, episode)
    drawn = (runner.draw(qpos, chosen) for qpos in positions(episode, runner))
    images = (np.concatenate(list(image.values()), axis=1) for image in drawn)
    return _film(images, chosen, path, frame_period, overwrite=overwrite)


def _film(
    images: Iterable[Image], cameras: tuple[str, ...], path: Path, frame_period: float, *, overwrite: bool
) -> Film:
    size = (0, 0)
    with VideoWriter(path, frame_period, overwrite=overwrite) as video:
        for image in images:
            video.write(image)
            size = (image.shape[1], image.shape[0])
    return Film(path, video.frames, video.frames * frame_period, size, cameras, video.moved_aside)


def _choose(wanted: Sequence[str], valid: Sequence[str]) -> tuple[str, ...]:
    for name in wanted:
        if name not in valid:
            raise UsageError(f"--camera {name!r} is not valid; {suggest(name, valid)}")
    return tuple(wanted) or (valid[0],)


def scene_config(config: RecordConfig, size: tuple[int, int] | None = None) -> RecordConfig:
    """A dataset's configuration to draw with: the wrist camera is there even if it was not recorded.

    Args:
        size: width and height of images in pixels, if not the recorded one.
    """
    image = config.image.model_copy(update={"size_px": size}) if size else config.image
    return config.model_copy(update={"image": image, "wrist": True})


def positions(episode: StoredEpisode, runner: EpisodeRunner) -> Array:
    """MuJoCo's positions (frames, nq) of a simulated episode.

    Raises:
        DatasetError: it was not simulated, or in another scene, or a file is damaged.
    """
    frames = episode.frames()
    if not all(map(has_simulation, frames)):
        raise DatasetError(
            f"{episode.directory} holds no sim_qpos, so only its recorded images can be shown: --video without --render"
        )
    nq = runner.scene.model.nq
    for k, frame in enumerate(frames):
        if len(frame["sim_qpos"]) != nq:
            raise DatasetError(
                f"{episode.directory}: frame {k} has {len(frame['sim_qpos'])} positions, and its scene {nq}: "
                "it was made with another robot model or scene than its dataset says"
            )
    return np.array([frame["sim_qpos"] for frame in frames])


def repeat(episode: StoredEpisode, config: RecordConfig, locations: Locations) -> Comparison | None:
    """Let an episode's actions act again; None when it holds none that physics could repeat.

    Args:
        config: the dataset's own.

    Raises:
        DatasetError: a file is damaged, or the episode is of another scene.
    """
    with EpisodeRunner(config, locations, {}, draw=False) as runner:
        return repeat_actions(runner, episode, episode.frames(), tolerance=0.0)


def play(
    episode: StoredEpisode,
    config: RecordConfig,
    locations: Locations,
    meshes: Meshes,
    speed: float,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Play an episode in a loop until `stopped` says so.

    Args:
        config: the dataset's own.
        meshes: asset set -> folder of its files, or None for primitives.
        speed: how fast time passes; 1 is real time.
        address: of the browser page; None for MuJoCo's window.
        ready: called once, with the page's URL.

    Raises:
        DatasetError: the episode was not simulated, or is damaged.
        UsageError: the address cannot be had.
        ResourceError: the viewer is not installed, or no window can be opened.
    """
    record = episode.record
    viewpoint = task_viewpoint(config)
    with EpisodeRunner(scene_config(config), locations, meshes, draw=False) as runner:
        states = positions(episode, runner)
        vary(runner, episode)
        player = EpisodePlayer(
            f"{config.task.name} {record.episode}", runner.scene.model, states, record.frame_period_s, speed
        )
        if address is None:
            from ..viewers.window import run_window

            run_window(player, viewpoint, PERIOD, lambda: ready(None), stopped)
            return
        require_page()
        from ..viewers.episode_page import EpisodePage

        images = RecordedImages(episode)
        run_page(EpisodePage(player, viewpoint, address, images), player, ready, stopped)
