from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import FiniteFloat, ValidationError, model_validator

from yamsim_cli.core.config.recording import RecordConfig, Side
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.documents.config_base import Config, Quaternion
from yamsim_cli.core.files.documents.units import Place, PlacePoint, QuantityBounds
from yamsim_cli.core.geometry.se3 import Array, pose_from_quat
from yamsim_cli.core.robots.joint_limits import describe_limit_violation

from .teleop_scene import TeleopScene

ArmRow = tuple[FiniteFloat, FiniteFloat, FiniteFloat, Place]

_LIMIT_TOLERANCE = math.radians(30)  # rad, by which a leader arm may exceed the follower's joint limits
_OPENING_BOUNDS = QuantityBounds("m", -0.02, 0.1)  # drives report values slightly outside the valid range


class PoseTarget(Config):
    """Pose of `grasp_site` in the arm's base: position in m, quaternion wxyz."""

    position: PlacePoint
    quaternion: Quaternion

    @property
    def T(self) -> Array:
        """Pose (4, 4)."""
        return pose_from_quat(self.position, self.quaternion)


class TeleopCommand(Config):
    """One line of a command stream. Omitted values keep their previous commands.

    Attributes:
        t: since the beginning of the stream, s.
        arm: the arm for this and the following commands; at first, the arm that acts first in the task.
        joints: joints of the arm, rad; or joints (rad) and finger openings (m) of both arms, the left arm first.
        ee: pose of `grasp_site` in the base of the left or only arm.
        gripper: opening of one finger, m.
    """

    t: Annotated[FiniteFloat, QuantityBounds("s", 0, 86400)]
    arm: Side | None = None
    joints: tuple[FiniteFloat, ...] | None = None
    ee: tuple[ArmRow, ArmRow, ArmRow, ArmRow] | PoseTarget | None = None
    gripper: Annotated[FiniteFloat, QuantityBounds("m", 0, 0.1)] | None = None
    magnet: bool | None = None
    event: Literal["start", "stop", "discard"] | None = None

    @property
    def T_grasp_in_base(self) -> Array | None:
        """Pose (4, 4) of `grasp_site` in the base of the left or only arm; None if the line has none."""
        if self.ee is None:
            return None
        return self.ee.T if isinstance(self.ee, PoseTarget) else np.array(self.ee)

    @model_validator(mode="after")
    def _one_target(self) -> TeleopCommand:
        if self.joints is not None and self.ee is not None:
            raise ValueError("give joints or ee, not both")
        if self.ee is not None and not isinstance(self.ee, PoseTarget):
            T = np.array(self.ee)
            R = T[:3, :3]
            if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
                raise ValueError("ee is not a pose: its upper left 3 x 3 is not a rotation")
            if not np.array_equal(T[3], (0, 0, 0, 1)):
                raise ValueError("ee is not a pose: its last row must be 0 0 0 1")
        return self


def read_stream(file: Path, config: RecordConfig) -> list[TeleopCommand]:
    """Read a file's commands, in order of time. Errors name line and key."""
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ConfigError(f"--input {file} cannot be read: {reason}") from error
    commands: list[TeleopCommand] = []
    arms = _CommandChecker(config)
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        command = _parse_command(line, f"{file}:{number}")
        arms.check_command(command, f"{file}:{number}")
        if commands and command.t < commands[-1].t:
            raise ConfigError(f"{file}:{number}: t {command.t:g} is before {commands[-1].t:g} of the line above")
        commands.append(command)
    if not commands:
        raise ConfigError(f"--input {file} is empty: give one JSON object a line, such as {{'t': 0, 'event': 'start'}}")
    return commands


def _parse_command(line: str, where: str) -> TeleopCommand:
    try:
        return TeleopCommand.model_validate_json(line)
    except ValidationError as error:
        # `ee` may be a matrix or position and quaternion. The most deeply nested error belongs to the intended variant.
        first = max(error.errors(include_url=False), key=lambda detail: len(detail["loc"]))
        key = ".".join(part for part in map(str, first["loc"]) if "[" not in part and part != PoseTarget.__name__)
        message = first["msg"].removeprefix("Value error, ")
        raise ConfigError(f"{where}: {key + ': ' if key else ''}{message}") from error


class _CommandChecker:
    def __init__(self, config: RecordConfig) -> None:
        rig = config.rig
        self._arms = {rig.arms[k].side: rig.arms[k] for k in rig.recording_order}
        self._all_drives = len(rig.arms) * rig.drive_count
        self._commanded_side: Side = config.acting_arms[0].side
        self._task, self._grasp = config.task.name, config.grasp

    def check_command(self, command: TeleopCommand, where: str) -> None:
        """Raise ConfigError if the arm, the weld or the joints are not valid."""
        if self._grasp != "weld" and command.magnet is not None:
            raise ConfigError(
                f"{where}: magnet: task {self._task!r} with grasp {self._grasp!r} has none: objects are held by "
                "friction; leave it out, and close the `gripper`"
            )
        if command.arm is not None and command.arm not in self._arms:
            raise ConfigError(f"{where}: arm: the rig has only a {next(iter(self._arms))} arm; leave it out")
        self._commanded_side = command.arm or self._commanded_side
        if command.joints is None:
            return
        joints = np.array(command.joints)
        count, dof = len(joints), self._arms[self._commanded_side].robot.dof
        rows = {self._commanded_side: joints}
        if len(self._arms) > 1 and count == self._all_drives:
            rows = dict(zip(self._arms, joints.reshape(len(self._arms), -1), strict=True))
        elif count != dof:
            both = f", or {self._all_drives} of both" if len(self._arms) > 1 else ""
            raise ConfigError(f"{where}: joints: {count} numbers; give {dof} of the {self._commanded_side} arm{both}")
        for side, row in rows.items():
            robot = self._arms[side].robot
            if fault := describe_limit_violation(self._arms[side].name, robot, row, _LIMIT_TOLERANCE):
                raise ConfigError(f"{where}: joints: {fault}")
            try:
                for opening in row[robot.dof :]:
                    _OPENING_BOUNDS.check(float(opening))
            except ValueError as error:
                raise ConfigError(f"{where}: joints: {error}") from error


class StreamPlayer:
    """Applies each command at the first control tick that begins at or after its time."""

    def __init__(self, commands: Sequence[TeleopCommand]) -> None:
        self._commands = commands
        self._next = 0

    @property
    def is_done(self) -> bool:
        """Whether all commands were applied."""
        return self._next == len(self._commands)

    def apply_due_commands(self, scene: TeleopScene, now: float) -> None:
        """Apply the commands due at `now`, s since the beginning of the stream."""
        # The tolerance covers rounding errors of `now`, which is a multiple of the tick.
        while not self.is_done and self._commands[self._next].t <= now + 1e-9:
            self._apply_command(scene, self._commands[self._next])
            self._next += 1

    def _apply_command(self, scene: TeleopScene, command: TeleopCommand) -> None:
        if command.event is not None:
            {"start": scene.start_recording, "stop": scene.stop_recording, "discard": scene.discard_recording}[
                command.event
            ]()
        if command.arm is not None:
            scene.select_arm(command.arm)
        if command.joints is not None:
            joints = np.array(command.joints)
            if joints.size > scene.dof:
                scene.set_all_joint_targets(joints.reshape(len(scene.sides), -1))
            else:
                scene.set_joint_target(joints)
        if (T := command.T_grasp_in_base) is not None:
            scene.set_grasp_target(T)
        if command.gripper is not None:
            scene.set_gripper(command.gripper)
        if command.magnet is not None:
            scene.set_weld(command.magnet)
