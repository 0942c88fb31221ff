from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.lowdim import has_simulation_keys
from yamsim_cli.core.dataset.reader import RecordedEpisode, RecordedImages, StoredEpisode, read_side_by_side_images
from yamsim_cli.core.dataset.records import attempt_from_record
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import Simulator, make_simulator
from yamsim_cli.core.errors import DatasetError, UsageError, suggest_similar
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.video import VideoWriter
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.core.scene.arm_model import finger_addresses
from yamsim_cli.core.scene.blueprint import Blueprint

from ..page_address import PageAddress
from ..viewed_scene import EpisodePlayer
from ..viewpoint import Viewpoint, rig_viewpoint
from .compose import compose_at_home
from .viewer import show_scene, task_viewpoint

if TYPE_CHECKING:
    from ..scene_page import ScenePage


@dataclass(frozen=True)
class WrittenVideo:
    """A written video: its length in s, size (width, height) in px, and the backup of an older file of that name."""

    path: Path
    frames: int
    seconds: float
    size: tuple[int, int]
    cameras: tuple[str, ...]
    moved_aside: Path | None


def film_recorded(
    episode: RecordedEpisode, cameras: Sequence[str], path: Path, frame_period: float, *, overwrite: bool
) -> WrittenVideo:
    """Make a video of the recorded images of cameras side by side, by default the first, at `frame_period`, s."""
    if not episode.record.cameras:
        raise DatasetError(
            f"{episode.directory} has no images; render them with --render, or show its arms without --video"
        )
    chosen = _choose_cameras(cameras, tuple(episode.record.cameras))
    return _write_video(read_side_by_side_images(episode, chosen), chosen, path, frame_period, overwrite=overwrite)


def film_rendered(
    episode: StoredEpisode,
    session: Session,
    cameras: Sequence[str],
    path: Path,
    frame_period: float,
    *,
    overwrite: bool,
) -> WrittenVideo:
    """Render an episode again, and make a video.

    Args:
        session: result of `session_with_wrist_camera`, with its meshes.
    """
    with _simulator_of(episode, session) as simulator:
        chosen = _choose_cameras(cameras, simulator.scene.cameras)
        attempt = attempt_from_record(episode.record)
        seen = (render_cameras(simulator, attempt, qpos, chosen) for qpos in episode_positions(episode, simulator))
        images = (np.concatenate(list(image.values()), axis=1) for image in seen)
        return _write_video(images, chosen, path, frame_period, overwrite=overwrite)


def _write_video(
    images: Iterable[Image], cameras: tuple[str, ...], path: Path, frame_period: float, *, overwrite: bool
) -> WrittenVideo:
    size = (0, 0)
    with VideoWriter(path, frame_period, overwrite=overwrite) as video:
        for image in images:
            video.write(image)
            size = (image.shape[1], image.shape[0])
    return WrittenVideo(path, video.frame_count, video.frame_count * frame_period, size, cameras, video.moved_aside)


def _choose_cameras(wanted: Sequence[str], valid: Sequence[str]) -> tuple[str, ...]:
    for name in wanted:
        if name not in valid:
            raise UsageError(f"--camera {name!r} is not valid; {suggest_similar(name, valid)}")
    return tuple(wanted) or (valid[0],)


def session_with_wrist_camera(session: Session, size: tuple[int, int] | None = None) -> Session:
    """Return the session of a dataset with a wrist camera, recorded or not, and images of `size` (w, h), px."""
    image, cameras = session.config.image, session.config.cameras
    image = image.model_copy(update={"size_px": size}) if size else image
    return session.with_values(wrist=True, image=image, cameras=cameras or None)


def episode_positions(episode: StoredEpisode, simulator: Simulator) -> Array:
    """Return `qpos` of each frame (frames, nq) of a simulated episode."""
    frames = episode.frames()
    if not all(map(has_simulation_keys, frames)):
        raise DatasetError(
            f"{episode.directory} holds no sim_qpos, so only its recorded images can be shown: give --video without "
            "--render"
        )
    nq = simulator.scene.model.nq
    for k, frame in enumerate(frames):
        if len(frame["sim_qpos"]) != nq:
            raise DatasetError(
                f"{episode.directory}: frame {k} has {len(frame['sim_qpos'])} positions, and its scene has {nq}: "
                "its robot model or scene differs from the dataset's config"
            )
    return np.array([frame["sim_qpos"] for frame in frames])


def _simulator_of(episode: StoredEpisode, session: Session) -> Simulator:
    return make_simulator(session, AttemptJob(episode.record.seed, episode.record.attempt))


def play_simulated(
    episode: StoredEpisode,
    session: Session,
    speed: float,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Play a simulated episode in a loop; further arguments as in `viewer.show_scene`.

    Args:
        speed: playback speed; 1 is real time.
    """
    record, config = episode.record, session.config
    with _simulator_of(episode, session_with_wrist_camera(session)) as simulator:
        states = episode_positions(episode, simulator)
        model = simulator.apply_randomization(attempt_from_record(record)).model
        player = EpisodePlayer(f"{config.task.name} {record.episode}", model, states, record.frame_period_s, speed)
        _show_player(player, episode, task_viewpoint(config), address, ready, stopped)


def play_real(
    episode: RecordedEpisode,
    motion: RecordedMotion,
    blueprint: Blueprint,
    locations: Locations,
    speed: float,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Play the measured motion of a real recording in a loop; further arguments as in `viewer.show_scene`.

    `motion` has the rig's recording order.
    """
    _, model = compose_at_home(blueprint, locations)
    period = episode.record.frame_period_s
    states = _measured_positions(motion, blueprint, model, period)
    player = EpisodePlayer(str(episode.directory), model, states, period, speed)
    _show_player(player, episode, rig_viewpoint(blueprint.rig), address, ready, stopped)


def _show_player(
    player: EpisodePlayer,
    episode: RecordedEpisode,
    viewpoint: Viewpoint,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    def open_page(address: PageAddress) -> ScenePage:
        from ..episode_page import EpisodePage

        return EpisodePage(player, viewpoint, address, RecordedImages(episode))

    show_scene(player, viewpoint, address, open_page, ready, stopped)


def _measured_positions(motion: RecordedMotion, blueprint: Blueprint, model: mujoco.MjModel, period: float) -> Array:
    """Return `qpos` (n, nq) at multiples of `period` (s), each from the latest earlier measurement."""
    rig = blueprint.rig
    even = np.arange(0.0, motion.duration + period / 2, period)
    rows = np.clip(np.searchsorted(motion.times, even + period / 1000, side="right") - 1, 0, None)
    states = np.tile(model.key_qpos[0], (len(even), 1))
    for arm, number in zip(motion.arms, rig.recording_order, strict=True):
        robot, prefix = rig.arms[number].robot, rig.arms[number].prefix
        for k, name in enumerate(robot.joint_names):
            states[:, model.joint(prefix + name).qposadr[0]] = arm.joints[rows, k]
        if robot.fingers is not None and arm.openings is not None:
            addresses, signs = finger_addresses(model, robot, prefix)
            states[:, addresses] = arm.openings[rows, None] * signs
    return states
