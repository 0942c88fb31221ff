"""Show a real recording: its rig, whose arms stand as they were measured."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from ..dataset.reader import RecordedEpisode
from ..geometry.se3 import Array
from ..recordings.reading import read_episode
from ..resources import Locations
from ..scene.blueprint import Blueprint
from ..viewers.address import PageAddress
from ..viewers.player import EpisodePlayer
from ..viewers.viewpoint import frame_rig
from .compose import at_home
from .view import PERIOD, require_page, run_page


def play_real(
    episode: RecordedEpisode,
    blueprint: Blueprint,
    locations: Locations,
    speed: float,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Play a recording in a loop until `stopped` says so; see `replay.play`.

    Raises:
        DatasetError: it is damaged, or of another rig.
        UsageError: the address cannot be had.
        ResourceError: the viewer is not installed, or no window can be opened.
    """
    _, model = at_home(blueprint, locations)
    period = episode.record.frame_period_s
    player = EpisodePlayer(str(episode.directory), model, _states(episode, blueprint, model, period), period, speed)
    viewpoint = frame_rig(blueprint.rig)
    if address is None:
        from ..viewers.window import run_window

        run_window(player, viewpoint, PERIOD, lambda: ready(None), stopped)
        return
    require_page()
    from ..dataset.reader import RecordedImages
    from ..viewers.episode_page import EpisodePage

    run_page(EpisodePage(player, viewpoint, address, RecordedImages(episode)), player, ready, stopped)


def _states(episode: RecordedEpisode, blueprint: Blueprint, model: mujoco.MjModel, period: float) -> Array:
    """MuJoCo's positions (n, nq) as they were measured last, at even times."""
    rig = blueprint.rig
    motion = read_episode(episode, rig)
    even = np.arange(0.0, motion.duration + period / 2, period)
    rows = np.clip(np.searchsorted(motion.times, even + period / 1000, side="right") - 1, 0, None)
    states = np.tile(model.key_qpos[0], (len(even), 1))
    for arm, number in zip(motion.arms, rig.recorded, strict=True):
        robot, prefix = rig.arms[number].robot, rig.arms[number].prefix
        for k, name in enumerate(robot.joint_names):
            states[:, model.joint(prefix + name).qposadr[0]] = arm.joints[rows, k]
        if robot.fingers is not None and arm.openings is not None:
            for name, sign in zip(robot.fingers.joints, robot.finger_signs, strict=True):
                states[:, model.joint(prefix + name).qposadr[0]] = sign * arm.openings[rows]
    return states
