"""Cost of each part alone, in one process."""

from __future__ import annotations

import os

import numpy as np

from tests.attempts import planned
from tests.board_photos import facing, photograph
from tools.bench.setting import median_seconds, setting
from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.expert.planning.ik import IkSolver
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.scene.arm_model import kinematic_model
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.photos.fiducials.board_localization import locate_boards

_CAMERA = CameraModel.from_focal_length(640, 480, 600.0)
_QUALITIES = {"fast": 20, "balanced": 20, "high": 5}


def measure_parts(episodes: int) -> dict[str, float]:
    """Figure -> median seconds."""
    using = setting("fast")
    figures = {"compose and compile the scene": median_seconds(lambda _: build_scene(using), 3)}
    with Simulator(using) as simulator:
        figures["plan and simulate a trial"] = median_seconds(lambda k: planned(simulator, 0, k), episodes)
        states = planned(simulator, 0).recorded_states
        figures["solve IK, from another pose of a trial"] = _ik_seconds(
            [state.qpos[simulator.scene.first_arm.joint_qpos] for state in states]
        )
    for quality, repetitions in _QUALITIES.items():
        figures |= _rendering(quality, [state.qpos for state in states], repetitions)
    figures["locate a board in a photo at 0.8 m"] = _locate_seconds()
    return figures


def _ik_seconds(joints: list[Array]) -> float:
    using = setting("fast")
    solver = IkSolver(kinematic_model(using.config.rig.arms[0]), np.eye(4))
    solver.set_held_object_frame(np.eye(4))
    targets = [solver.forward_kinematics(there) for there in joints]
    return median_seconds(lambda k: solver.solve(targets[k], joints[k - 5], 100), len(targets) - 1)


def _rendering(quality: str, states: list[Array], repetitions: int) -> dict[str, float]:
    using = setting(quality)
    with Simulator(using) as simulator:
        cameras, attempt = simulator.scene.cameras[:1], Attempt(AttemptJob(0, 0))
        (image,) = render_cameras(simulator, attempt, states[0], cameras).values()
        seconds = median_seconds(lambda k: render_cameras(simulator, attempt, states[k + 20], cameras), repetitions)
        figures = {f"draw a frame, {quality}": seconds}
    if quality == "balanced":
        figures["encode a frame"] = median_seconds(lambda _: encode_jpeg(image, using.config.image.jpeg_quality), 50)
    return figures


def _locate_seconds() -> float:
    rig = load_config(RigConfig, "rigs", "bimanual", Locations.from_environment(os.environ))
    assert rig.arms[0].board is not None
    board = rig.arms[0].board.board_in_metres
    photo = photograph(_CAMERA, [(board, facing(0.02, 0.03, 0.8))])
    return median_seconds(lambda _: locate_boards(photo, _CAMERA, [board]), 10)
