"""An excitation as files: the commands for a real arm, and what a simulated one makes of them."""

from __future__ import annotations

import csv
import io

import numpy as np

from ..config.rig import RigConfig
from ..geometry.se3 import Array
from ..recordings.columns import TIME, header
from ..recordings.csv_file import csv_bytes
from .excitation import Excitation
from .plant import ArmPlant, Log, Run


def commands_csv(rig: RigConfig, number: int, found: Excitation) -> bytes:
    """The commands of all arms of a rig: of the one that moves its motion, of the other its rest."""
    names = [name for name in header(rig) if name == TIME or name.startswith("command_")]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    for time, row in zip(found.times, _told(rig, number, found), strict=True):
        writer.writerow([f"{time:.4f}", *(f"{value:.6f}" for value in row)])
    return stream.getvalue().encode()


def log_csv(rig: RigConfig, number: int, found: Excitation) -> bytes:
    """What would be logged of the rig's arm in simulation: commands, and the joints that it reads."""
    arm, told = rig.arms[number], _told(rig, number, found)
    plant = ArmPlant(arm)
    opened = np.full(len(found.times), arm.robot.fingers.opened if arm.robot.fingers else 0.0)
    log = Log("excite", found.times, found.commands, found.commands, opened)
    read = told.copy()
    first = sum(len(rig.arms[k].robot.drives) for k in rig.recorded[: rig.recorded.index(number)])
    read[:, first : first + arm.robot.dof] = Run(plant, log).follow(plant.values, plain=True)
    return csv_bytes(rig, found.times, np.column_stack([told, read]))


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
