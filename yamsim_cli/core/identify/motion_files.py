"""An excitation as files: the commands for a real arm, and what a simulated one makes of them."""

from __future__ import annotations

import csv
import io

import numpy as np

from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..geometry.se3 import Array
from ..motion import ArmMotion, Motion
from ..recordings.columns import TIME, header
from ..recordings.csv_file import csv_bytes
from ..resources import Locations
from ..scene.build import build_rig_scene
from ..sim.follow import follow
from .excitation import Excitation


def commands_csv(rig: RigConfig, number: int, found: Excitation) -> bytes:
    """The commands of all arms of a rig: of the one that moves its motion, of the other its rest."""
    names = [name for name in header(rig) if name == TIME or name.startswith("command_")]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    for time, row in zip(found.times, _told(rig, number, found), strict=True):
        writer.writerow([f"{time:.4f}", *(f"{value:.6f}" for value in row)])
    return stream.getvalue().encode()


def log_csv(rig: RigConfig, number: int, found: Excitation, surroundings: SceneConfig, locations: Locations) -> bytes:
    """What would be logged of the rig in simulation: commands, and what its encoders read, without noise and steps."""
    told, first, arms = _told(rig, number, found), 0, []
    for k in rig.recorded:
        arm = rig.arms[k]
        dof, drives = arm.robot.dof, len(arm.robot.drives)
        commands, openings = told[:, first : first + dof], told[:, first + dof] if drives > dof else None
        arms.append(ArmMotion(arm.side if len(rig.arms) > 1 else "", commands, commands, openings, openings))
        first += drives
    scene = build_rig_scene(rig, surroundings, locations)
    followed = follow(scene, Motion("excite", found.times, tuple(arms)))
    read = [
        part
        for arm in followed.arms
        for part in (arm.joints, *([] if arm.openings is None else [arm.openings[:, None]]))
    ]
    return csv_bytes(rig, found.times, np.column_stack([told, *read]))


def _told(rig: RigConfig, number: int, found: Excitation) -> Array:
    """What every drive is told (n, drives), in the order of recordings."""
    columns = []
    for k in rig.recorded:
        robot = rig.arms[k].robot
        still = np.tile(robot.home, (len(found.times), 1))
        columns.append(found.commands if k == number else still)
        if robot.fingers is not None:
            columns.append(np.full((len(found.times), 1), robot.fingers.opened))
    return np.hstack(columns)
