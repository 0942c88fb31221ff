from __future__ import annotations

import abc
import threading
from dataclasses import dataclass

import mujoco

from ..core.config.rig import ArmConfig, RigConfig
from ..core.geometry.se3 import Array, quat_from_rotation
from ..core.scene.fiducials import BOARD_BODY, MOUNT_BODY

_MAX_CATCH_UP = 0.1  # s, largest delay that the simulation catches up with; the rest is skipped


class ViewedScene(abc.ABC):
    """Base class of scenes in viewers. All methods are thread-safe.

    Attributes:
        title: of the browser tab.
        model, data: the scene and its state. After `model` is replaced, a page shows the new model.
        lock: held while the state is changed or read. The controls of a page run in separate threads.
    """

    title: str
    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.paused = False
        self._last: float | None = None

    @property
    @abc.abstractmethod
    def simulated_seconds(self) -> float:
        """Simulated time, s."""

    @abc.abstractmethod
    def advance_to(self, now: float) -> None:
        """Advance to the time `now`, s on a monotonic clock."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Reset the scene to its initial state."""

    def body_poses(self) -> tuple[Array, Array]:
        """Return positions (nbody, 3), m, and quaternions (nbody, 4), wxyz, of all bodies in `world`."""
        with self.lock:
            return self.data.xpos.copy(), self.data.xquat.copy()

    def cloth_points(self) -> Array:
        """Return the points of all cloths (nflexvert, 3) in `world`, m."""
        with self.lock:
            points: Array = self.data.flexvert_xpos.copy()
            return points

    def _seconds_since_last(self, now: float) -> float:
        elapsed = 0.0 if self._last is None else now - self._last
        self._last = now
        return elapsed


@dataclass(frozen=True)
class DriveControl:
    """A position drive that a user can command.

    Attributes:
        name: without the prefix of the arm.
        actuator: index in `ctrl`.
        low, high, home: limits of the command, and command in keyframe `home`, in `unit`.
        unit: `rad`, or `m` for a gripper, whose command is the opening of one finger.
    """

    arm: str
    name: str
    actuator: int
    low: float
    high: float
    home: float
    unit: str


class LiveRig(ViewedScene):
    """A rig that is simulated in real time, with joints that a user can move. `home` is the model's first keyframe."""

    def __init__(self, rig: RigConfig, model: mujoco.MjModel, title: str = "") -> None:
        super().__init__()
        self.rig = rig
        self.title = title or rig.name
        self.model = model
        self.data = mujoco.MjData(model)
        self.drives = tuple(_drive_control(model, arm, name) for arm in rig.arms for name in arm.robot.drive_names)
        self._pending_time = 0.0
        self.reset()

    @property
    def simulated_seconds(self) -> float:
        """Simulated time since the last reset, s."""
        return float(self.data.time)

    def reset(self) -> None:
        """Reset to keyframe `home`, at rest."""
        with self.lock:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
            self._move_boards_to_bases()
            mujoco.mj_forward(self.model, self.data)

    def set_command(self, drive: DriveControl, value: float) -> None:
        """Command a drive, clipped to its range."""
        with self.lock:
            self.data.ctrl[drive.actuator] = min(max(value, drive.low), drive.high)

    def set_margin(self, margin: float) -> None:
        """Set the distance (m) between the bases. Boards and mounts move with the arms."""
        with self.lock:
            self.rig = self.rig.model_copy(update={"margin": margin})
            for k, arm in enumerate(self.rig.arms):
                T = self.rig.T_base_in_world(k)
                base = self.model.body(arm.prefix + arm.robot.base)
                base.pos[:], base.quat[:] = T[:3, 3], quat_from_rotation(T[:3, :3])
            self._move_boards_to_bases()
            mujoco.mj_forward(self.model, self.data)

    def _move_boards_to_bases(self) -> None:
        """Move boards and mounts to the bases of their arms, since a reset restores the compiled poses."""
        for arm in self.rig.arms:
            base = self.model.body(arm.prefix + arm.robot.base)
            for body in (BOARD_BODY, MOUNT_BODY):
                number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, arm.prefix + body)
                if number >= 0:
                    mocap = self.model.body_mocapid[number]
                    self.data.mocap_pos[mocap], self.data.mocap_quat[mocap] = base.pos, base.quat

    def advance_to(self, now: float) -> None:
        """Simulate up to the time `now`, s on a monotonic clock, unless paused."""
        with self.lock:
            elapsed = self._seconds_since_last(now)
            if self.paused:
                return
            timestep = self.model.opt.timestep
            self._pending_time = min(self._pending_time + elapsed, _MAX_CATCH_UP)
            steps = int(self._pending_time / timestep)
            if steps:
                mujoco.mj_step(self.model, self.data, nstep=steps)
                self._pending_time -= steps * timestep


def _drive_control(model: mujoco.MjModel, arm: ArmConfig, name: str) -> DriveControl:
    actuator = model.actuator(arm.prefix + name).id
    low, high = (float(end) for end in model.actuator_ctrlrange[actuator])
    home = float(model.key_ctrl[0, actuator])
    return DriveControl(arm.name, name, actuator, low, high, home, "rad" if name in arm.robot.joint_drives else "m")


class EpisodePlayer(ViewedScene):
    """Plays recorded states in a loop, without physics.

    Args:
        positions: `qpos` of each frame (frames, nq).
        frame_period: simulated time between frames, s.
        speed: playback speed; 1 is real time.
    """

    def __init__(
        self, title: str, model: mujoco.MjModel, positions: Array, frame_period: float, speed: float = 1.0
    ) -> None:
        super().__init__()
        self.title = title
        self.model = model
        self.data = mujoco.MjData(model)
        self.frame_period = frame_period
        self._positions = positions
        self._speed = speed
        self._time = 0.0
        self.reset()

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self._positions)

    @property
    def frame_number(self) -> int:
        """Number of the shown frame, from 0."""
        return min(int(self._time / self.frame_period), self.frame_count - 1)

    @property
    def simulated_seconds(self) -> float:
        """Simulated time since the first frame, s."""
        return self._time

    def reset(self) -> None:
        """Show the first frame, and continue from there."""
        self.seek(0)

    def seek(self, frame: int) -> None:
        """Show a frame, and continue from there."""
        with self.lock:
            # In the middle of the frame, rounding errors do not matter.
            self._time = (frame + 0.5) * self.frame_period
            self._show_frame()

    def advance_to(self, now: float) -> None:
        """Advance the playback to the time `now`, s on a monotonic clock, unless paused."""
        with self.lock:
            elapsed = self._seconds_since_last(now)
            if not self.paused:
                self._time = (self._time + elapsed * self._speed) % (self.frame_count * self.frame_period)
            self._show_frame()

    def _show_frame(self) -> None:
        self.data.qpos[:] = self._positions[self.frame_number]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)
