"""A rig simulated in real time, whose joints a person moves while watching."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from ..config.rig import ArmConfig, RigConfig
from ..geometry.se3 import quat_from_rotation
from ..scene.fiducials import BOARD_BODY, MOUNT_BODY
from .watched_state import WatchedState

# Most time that physics makes up for at once, s. After a stall, such as a sleep of the machine, it goes on from where
# it was instead of racing through the time that it missed.
_LONGEST_CATCH_UP = 0.1


@dataclass(frozen=True)
class Drive:
    """One position drive that a person can set.

    Attributes:
        arm: name of its arm.
        name: its own name, without the arm's prefix.
        actuator: its index in `ctrl`.
        low, high, home: its range, and its command in keyframe `home`, in `unit`.
        unit: `rad`, or `m` for a gripper, whose command is the opening of one finger.
    """

    arm: str
    name: str
    actuator: int
    low: float
    high: float
    home: float
    unit: str


class LiveRig(WatchedState):
    """The state of a simulated rig. Its methods may be called from any thread.

    Args:
        model: a compiled rig, with or without a task's objects, whose first keyframe is `home`.
        title: title of the page's tab; the rig's name unless given.
    """

    def __init__(self, rig: RigConfig, model: mujoco.MjModel, title: str = "") -> None:
        super().__init__()
        self.rig = rig
        self.title = title or rig.name
        self.model = model
        self.data = mujoco.MjData(model)
        self.drives = tuple(_drive(model, arm, name) for arm in rig.arms for name in arm.robot.drives)
        self._owed = 0.0
        self._last: float | None = None
        self.reset()

    @property
    def time(self) -> float:
        """Simulated time since the last reset, s."""
        return float(self.data.time)

    def reset(self) -> None:
        """Go back to keyframe `home`, at rest, with every drive holding its place."""
        with self.lock:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
            self._follow_bases()
            mujoco.mj_forward(self.model, self.data)

    def command(self, drive: Drive, value: float) -> None:
        """Tell a drive where to go, in its unit; a value outside its range is clipped."""
        with self.lock:
            self.data.ctrl[drive.actuator] = min(max(value, drive.low), drive.high)

    def place(self, margin: float) -> None:
        """Change the distance (m) between the arms; boards and mounts move with them."""
        with self.lock:
            self.rig = self.rig.model_copy(update={"margin": margin})
            for k, arm in enumerate(self.rig.arms):
                T = self.rig.T_base_in_world(k)
                base = self.model.body(arm.prefix + arm.robot.base)
                base.pos[:], base.quat[:] = T[:3, 3], quat_from_rotation(T[:3, :3])
            self._follow_bases()
            mujoco.mj_forward(self.model, self.data)

    def _follow_bases(self) -> None:
        """Move boards and mounts to their arm's base. A reset of the model would put them where they were compiled."""
        for arm in self.rig.arms:
            base = self.model.body(arm.prefix + arm.robot.base)
            for body in (BOARD_BODY, MOUNT_BODY):
                number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, arm.prefix + body)
                if number >= 0:
                    mocap = self.model.body_mocapid[number]
                    self.data.mocap_pos[mocap], self.data.mocap_quat[mocap] = base.pos, base.quat

    def advance(self, now: float) -> None:
        """Step physics up to `now`, s on a steady clock; while paused, no step is made."""
        with self.lock:
            elapsed = 0.0 if self._last is None else now - self._last
            self._last = now
            if self.paused:
                return
            timestep = self.model.opt.timestep
            self._owed = min(self._owed + elapsed, _LONGEST_CATCH_UP)
            steps = int(self._owed / timestep)
            if steps:
                mujoco.mj_step(self.model, self.data, nstep=steps)
                self._owed -= steps * timestep


def _drive(model: mujoco.MjModel, arm: ArmConfig, name: str) -> Drive:
    actuator = model.actuator(arm.prefix + name).id
    low, high = (float(end) for end in model.actuator_ctrlrange[actuator])
    home = float(model.key_ctrl[0, actuator])
    return Drive(arm.name, name, actuator, low, high, home, "rad" if name in arm.robot.joint_drives else "m")
