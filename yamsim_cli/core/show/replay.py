"""Show a recorded episode: as a film of its images, rendered anew, or in a viewer; and its actions again in physics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..attempt.pictures import render
from ..attempt.simulator import Simulator
from ..attempt.simulators import simulator_for
from ..dataset.compare import Comparison
from ..dataset.lowdim import has_simulation
from ..dataset.reader import RecordedEpisode, RecordedImages, StoredEpisode, recorded_images
from ..dataset.records import recorded_attempt
from ..errors import DatasetError, UsageError, suggest
from ..geometry.se3 import Array
from ..images.image import Image
from ..images.video import VideoWriter
from ..session import Session
from ..types import EpisodeJob
from ..verify import repeat_actions
from ..viewers.address import PageAddress
from ..viewers.player import EpisodePlayer
from .view import PERIOD, require_page, run_page, task_viewpoint


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
    episode: RecordedEpisode, cameras: Sequence[str], path: Path, frame_period: float, *, overwrite: bool
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
    if not episode.record.cameras:
        raise DatasetError(f"{episode.directory} has no pictures; without --video its arms are shown")
    chosen = _choose(cameras, tuple(episode.record.cameras))
    return _film(recorded_images(episode, chosen), chosen, path, frame_period, overwrite=overwrite)


def film_rendered(
    episode: StoredEpisode,
    simulator: Simulator,
    cameras: Sequence[str],
    path: Path,
    frame_period: float,
    *,
    overwrite: bool,
) -> Film:
    """Make a video of an episode rendered anew.

    Args:
        simulator: of a session that `shown_again` gave.

    Raises:
        DatasetError: the episode was not simulated, or in another scene.
        UsageError, ResourceError: as for `film_recorded`.
    """
    chosen = _choose(cameras, simulator.scene.cameras)
    attempt = recorded_attempt(episode.record)
    seen = (render(simulator, attempt, qpos, chosen) for qpos in positions(episode, simulator))
    images = (np.concatenate(list(image.values()), axis=1) for image in seen)
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


def shown_again(session: Session, size: tuple[int, int] | None = None) -> Session:
    """A dataset's session to look at it with: the wrist camera is there even if it was not recorded.

    Args:
        size: width and height of images in pixels, if not the recorded one.
    """
    image = session.config.image
    return session.with_values(wrist=True, image=image.model_copy(update={"size_px": size}) if size else image)


def positions(episode: StoredEpisode, simulator: Simulator) -> Array:
    """MuJoCo's positions (frames, nq) of a simulated episode.

    Raises:
        DatasetError: it was not simulated, or in another scene, or a file is damaged.
    """
    frames = episode.frames()
    if not all(map(has_simulation, frames)):
        raise DatasetError(
            f"{episode.directory} holds no sim_qpos, so only its recorded images can be shown: --video without --render"
        )
    nq = simulator.scene.model.nq
    for k, frame in enumerate(frames):
        if len(frame["sim_qpos"]) != nq:
            raise DatasetError(
                f"{episode.directory}: frame {k} has {len(frame['sim_qpos'])} positions, and its scene {nq}: "
                "it was made with another robot model or scene than its dataset says"
            )
    return np.array([frame["sim_qpos"] for frame in frames])


def simulator_of(episode: StoredEpisode, session: Session) -> Simulator:
    """The simulator of a session in which an episode took place."""
    job = EpisodeJob(episode.record.seed, episode.record.attempt)
    return simulator_for(session, job)


def repeat(episode: StoredEpisode, session: Session) -> Comparison | None:
    """Let an episode's actions act again; None when it holds none that physics could repeat.

    Args:
        session: of the dataset's own config.

    Raises:
        DatasetError: a file is damaged, or the episode is of another scene.
    """
    with simulator_of(episode, session.without_meshes()) as simulator:
        return repeat_actions(simulator, episode, episode.frames(), tolerance=0.0)


def play(
    episode: StoredEpisode,
    session: Session,
    speed: float,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Play an episode in a loop until `stopped` says so.

    Args:
        session: of the dataset's own config.
        speed: how fast time passes; 1 is real time.
        address: of the browser page; None for MuJoCo's window.
        ready: called once, with the page's URL.

    Raises:
        DatasetError: the episode was not simulated, or is damaged.
        UsageError: the address cannot be had.
        ResourceError: the viewer is not installed, or no window can be opened.
    """
    record, config = episode.record, session.config
    viewpoint = task_viewpoint(config)
    with simulator_of(episode, shown_again(session)) as simulator:
        states = positions(episode, simulator)
        model = simulator.varied(recorded_attempt(record)).model
        player = EpisodePlayer(f"{config.task.name} {record.episode}", model, states, record.frame_period_s, speed)
        if address is None:
            from ..viewers.window import run_window

            run_window(player, viewpoint, PERIOD, lambda: ready(None), stopped)
            return
        require_page()
        from ..viewers.episode_page import EpisodePage

        images = RecordedImages(episode)
        run_page(EpisodePage(player, viewpoint, address, images), player, ready, stopped)
