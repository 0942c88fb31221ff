"""An arm that is driven from outside, tick by tick: targets in, demonstrations out. Knows neither pages nor files."""

from __future__ import annotations

import threading
from dataclasses import replace

import mujoco
import numpy as np

from ..config.limits import load_limits
from ..config.record import RecordConfig
from ..errors import SimulationError
from ..geometry.se3 import Array, inverse, pose
from ..planning.ik import IkSolver
from ..planning.pursuit import Pursuit
from ..resources import Locations
from ..scene.build import build_scene
from ..scene.compose import Meshes
from ..scene.robot import JOINTS, bare_arm
from ..sim.closed_loop import ClosedLoop
from ..sim.obstruction import Obstruction
from ..tasks.kinds import draw_layout
from ..tasks.pickplace import OPEN
from ..types import EpisodeJob, Layout
from ..viewers.driven import DriveStatus
from .demonstrations import Demonstration, Inbox
from .episode import start_poses

_IK_ITERATIONS = 12
# A target this far from where the hand can be is out of reach, m.
_REACH = 0.003
# This near to its stop a joint is at it, rad.
_AT_LIMIT = 0.005
# The pinch frame's origin is never asked to be nearer to the table than this: the finger tips would be in it, m.
_CLEARANCE = 0.012


class TeleopSession:
    """Owns the scene and its state; a `viewers.driven.Driven`. Its methods may be called from any thread.

    The arm follows a target, a pose of the hand or six joints, as fast as its motors can and no nearer to the table or
    to itself than it may; after a stop, it takes none until all is at rest. A recording begins from rest at its
    attempt's layout, as every attempt of the task does.

    Args:
        config: of a rig with one arm, see `require_one_arm`.

    Raises:
        SimulationError: the task's sampling box has no room.
    """

    def __init__(self, config: RecordConfig, locations: Locations, meshes: Meshes, inbox: Inbox) -> None:
        self._config, self._inbox = config, inbox
        self.title = f"{config.task.name} teleop"
        self._scene = build_scene(config, locations, meshes)
        self.model = self._scene.model
        arm = config.rig.arms[0]
        self._ik = IkSolver(bare_arm(arm, locations), self._scene.T_base_in_world)
        self._ik.hold(np.eye(4))
        limits = load_limits(arm.model, locations).joints
        self._range = np.array([limit.range for limit in limits])
        speeds = np.array([limit.motor_rad_s for limit in limits])
        self._pursuit = Pursuit(speeds, self._range, config.task.timing.tick)
        self._obstruction = Obstruction(self._scene)
        self._T_pinch_in_grasp = self._fixed_pose("pinch_site", "grasp_site")
        # A page's controls live in threads of their own.
        self.lock = threading.RLock()
        self.paused = False
        self.message = ""
        self.episodes = self.failures = self.waiting = 0
        self.discarded = 0
        self._ticks = 0
        self._joint_target: Array | None = None
        # Ticks that are left of the second after a stop.
        self._settling: int = 0
        self._begin()

    @property
    def tick_seconds(self) -> float:
        """Length of a control tick, s."""
        return self._config.task.timing.tick

    @property
    def time(self) -> float:
        """Time that has passed in the simulation since the session began, whatever was started and ended, s."""
        return self._ticks * self.tick_seconds

    @property
    def recording(self) -> bool:
        """Whether what happens is recorded; the second after a stop is."""
        return self._recording

    @property
    def target(self) -> Array:
        """Where the pinch frame is to be: pose (4, 4) in `world`."""
        return self._target.copy()

    @property
    def status(self) -> DriveStatus:
        """How things stand."""
        with self.lock:
            return DriveStatus(
                recording=self._recording,
                seconds=self._loop.ticks * self.tick_seconds,
                episodes=self.episodes,
                failures=self.failures,
                waiting=self.waiting,
                apart=self._apart,
                at_limit=self._at_limit(),
                blocked=self._blocked,
                gripper_open=self._opening == OPEN,
                magnet=self._magnet,
                holds=self._loop.holds,
                message=self.message,
            )

    def aim(self, T_pinch_in_world: Array) -> None:
        """Give the hand another target (4, 4); one in the table is lifted out of it."""
        with self.lock:
            if not self._settling:
                self._joint_target = None
                self._target = self._above_table(T_pinch_in_world)

    def aim_grasp(self, T_grasp_in_base: Array) -> None:
        """Give the hand another target: a pose (4, 4) of `grasp_site` in the arm's base, as frames hold it."""
        self.aim(self._scene.T_base_in_world @ T_grasp_in_base @ self._T_pinch_in_grasp)

    def aim_joints(self, joints: Array) -> None:
        """Give the arm six joints (rad) to go to, as a leader arm would; beyond a stop counts as at it."""
        with self.lock:
            if not self._settling:
                reachable: Array = np.clip(joints, *self._range.T)
                self._joint_target, self._target = reachable, self._ik.pose_of(reachable)

    def set_gripper(self, opening: float) -> None:
        """Open each finger by so much, m; beyond its range counts as the end of it."""
        with self.lock:
            if not self._settling:
                self._opening = min(max(opening, 0.0), OPEN)

    def toggle_gripper(self) -> None:
        """Open the gripper, or close it to what the object needs."""
        grasp = self._config.task.object.grasp
        assert grasp is not None  # checked when the config was loaded
        self.set_gripper(grasp.opening if self._opening == OPEN else OPEN)

    def set_magnet(self, on: bool) -> None:
        """Switch the magnet, which holds the object where the hand is at it."""
        with self.lock:
            self._magnet = on and not self._settling

    def start(self) -> None:
        """Record from the attempt's beginning: everything goes back to where it was at first."""
        with self.lock:
            self.settle()
            self._begin()
            self._recording = True
            self.message = "recording"

    def stop(self) -> None:
        """End the recording: what is held is let go, and once everything has had a second to rest, it is handed in."""
        with self.lock:
            if not self._recording or self._settling:
                self.message = "nothing was being recorded"
                return
            self._magnet, self._opening = False, OPEN
            self._joint_target = self._pursuit.joints.copy()
            self._settling = self._config.task.timing.settle_ticks
            self.message = "letting go, and waiting until all is at rest"
            if not self._settling:
                self._hand_in()

    def settle(self) -> None:
        """Have what is left of a stop's second pass at once."""
        with self.lock:
            while self._settling:
                self._tick()

    def _hand_in(self) -> None:
        actions = replace(self._loop.actions, joints=np.array(self._asked))
        self._inbox.hand_in(Demonstration(self._job, start_poses(self._layout), self._start, actions))
        self.message = f"attempt {self._job.attempt} is being judged and drawn"
        self._begin()

    def discard(self) -> None:
        """End the recording as if it had never been: the same layout comes again."""
        with self.lock:
            if not self._recording:
                self.message = "nothing was being recorded"
                return
            self.discarded += 1
            self.message = "discarded"
            self._begin()

    def reset(self) -> None:
        """Back to the attempt's beginning; a recording that is going on is discarded."""
        with self.lock:
            if self._recording:
                self.discard()
            else:
                self._begin()

    def tick(self) -> None:
        """One control tick."""
        with self.lock:
            if not self.paused:
                self._tick()

    def advance(self, now: float) -> None:
        """One control tick; whoever calls keeps the time."""
        self.tick()

    def body_poses(self) -> tuple[Array, Array]:
        """Every body's position (nbody, 3), m, and orientation (nbody, 4), wxyz, in `world`."""
        with self.lock:
            return self.data.xpos.copy(), self.data.xquat.copy()

    def _begin(self) -> None:
        """Put the scene into its attempt's layout, at rest."""
        task = self._config.task
        self._job = EpisodeJob(self._config.seed, self._inbox.next_attempt)
        self._layout = self._draw_layout()
        joints = np.array(task.start_joints)
        self._start = self._scene.start_qpos(self._layout, joints, OPEN)
        self._loop = ClosedLoop(self._scene, self._start, task.object.name, task.timing)
        self.data = self._loop.data
        self._pursuit.reset(joints)
        self._joint_target = None
        self._target = self._ik.pose_of(joints)
        self._opening, self._magnet, self._recording = OPEN, False, False
        self._settling = 0
        self._apart, self._blocked = 0.0, ""
        self._asked: list[Array] = []

    def _draw_layout(self) -> Layout:
        layout = draw_layout(self._config, self._job)
        if layout is None:
            raise SimulationError(f"task {self._config.task.name!r}: the sampling box has no room for both objects")
        return layout

    def _tick(self) -> None:
        before = self._pursuit.joints
        velocity = self._step_reference()
        # As `rollout.drive_command`, without what makes up for inertia: where a person goes next is not known.
        scene = self._scene
        ctrl = np.zeros(scene.model.nu)
        ctrl[scene.arm.arm_ctrl] = (before + self._pursuit.joints) / 2 + scene.arm.kv * velocity / scene.arm.kp
        ctrl[scene.arm.gripper_ctrl] = self._opening
        self._loop.step(ctrl, self._magnet)
        if self._magnet and not self._loop.holds:
            self._magnet = False
            self.message = f"the magnet found no {self._config.task.object.name} within its reach"
        self._asked.append(np.append(self._pursuit.joints, self._opening))
        self._ticks += 1
        if self._settling:
            self._settling -= 1
            if not self._settling:
                self._hand_in()

    def _step_reference(self) -> Array:
        """Go one tick towards the target unless something is in the way; the velocity (6,) that this means, rad/s."""
        pursuit, qpos = self._pursuit, self.data.qpos
        after = pursuit.towards(self._goal())
        depth, name = self._obstruction.depth(qpos, after)
        # Out of what it is in already, it may go.
        if depth and depth >= self._obstruction.depth(qpos, pursuit.joints)[0]:
            self._blocked = name
            pursuit.halt()
            return np.zeros(6)
        self._blocked = ""
        return pursuit.go(after)

    def _goal(self) -> Array:
        """The joints (6,) to go to, rad."""
        if self._joint_target is not None:
            self._apart = 0.0
            return self._joint_target
        solution = self._ik.solve(self._target, self._pursuit.joints, _IK_ITERATIONS)
        self._apart = solution.position_error if solution.position_error > _REACH else 0.0
        return solution.joints

    def _at_limit(self) -> tuple[str, ...]:
        low, high = self._range.T
        joints = self._pursuit.joints
        near = (joints < low + _AT_LIMIT) | (joints > high - _AT_LIMIT)
        return tuple(name for name, there in zip(JOINTS, near, strict=True) if there)

    def _above_table(self, T: Array) -> Array:
        table, lifted = self._config.table, T.copy()
        x, y, _ = np.abs(T[:3, 3] - table.position)
        if x < table.half_size[0] and y < table.half_size[1]:
            lifted[2, 3] = max(lifted[2, 3], table.top + _CLEARANCE)
        return lifted

    def _fixed_pose(self, site: str, reference: str) -> Array:
        """Pose (4, 4) of one site of `link_6` in another."""
        data = mujoco.MjData(self._scene.model)
        mujoco.mj_kinematics(self._scene.model, data)
        T, T_reference = (pose(data.site(name).xpos, data.site(name).xmat.reshape(3, 3)) for name in (site, reference))
        return inverse(T_reference) @ T
