"""A scene in motion in which a task's goal is looked at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from ..config.program_task import ProgramTask
from ..geometry.se3 import Array
from ..goals.cast import Cast
from ..goals.goal import Verdict, judge
from ..scene.compiled import CompiledScene
from ..types import Actions, Margins, Motion, StepState
from .cloth import ClothGrips
from .faults import Faults
from .readings import sensed
from .rollout import Rollout
from .world import world_of

# How long things are given to come to rest, s; how often that is looked at, in steps; and how slow they are then, m/s
# and rad/s.
_SETTLE_SECONDS = 2.0
_SETTLE_STEPS = 25
_AT_REST = 0.01

# Called with the start, and with the state after every physics step, which it must not change.
See = Callable[[mujoco.MjData], None]


@dataclass(frozen=True)
class Watched(Rollout):
    """The result of a simulation in which a goal was looked at.

    Attributes:
        verdict: whether the goal held as long as it has to at the end: of the first moment at which it did not, else of
            the last.
    """

    verdict: Verdict


class WatchedLoop:
    """A scene in motion, by actions that are given piece by piece. The same actions from the same start give the same
    bits, in however many pieces they come.

    Attributes:
        data: MuJoCo's present state, with poses and contacts up to date.
        world: the same by the things' names.

    Args:
        start: MuJoCo's positions (nq,), from which everything starts at rest.
        sides: of the scene's arms.
        see: see `rollout.simulate`.
    """

    def __init__(
        self,
        scene: CompiledScene,
        start: Array,
        task: ProgramTask,
        cast: Cast,
        sides: Sequence[str],
        see: See | None = None,
    ) -> None:
        self._scene, self._task, self._cast, self._see = scene, task, cast, see
        self.data = mujoco.MjData(scene.model)
        scene.reset(self.data, start)
        self.world = world_of(scene, self.data, sides)
        self._grips = ClothGrips(scene) if scene.cloths else None
        self.world.begin()
        self._limits = _Limits(scene)
        self._T_at_start = self._poses()
        self._actions: list[Actions] = []
        self._positions: list[tuple[float, Array, Array | None]] = []
        self._verdict: Verdict | None = None
        self.ticks = 0
        if see:
            see(self.data)

    @property
    def hold_ticks(self) -> int:
        """For how many ticks at the end the goal has to hold."""
        return self._task.hold_ticks

    @property
    def frames(self) -> int:
        """How many frames were recorded so far."""
        return len(self._positions)

    def act(self, actions: Actions, *, last: bool = False) -> None:
        """Let actions act.

        Args:
            last: whether nothing follows, so that the goal has to hold at their end.
        """
        magnet = actions.magnet.copy()
        self._actions.append(replace(actions, magnet=magnet))
        timing, data, model = self._task.timing, self.data, self._scene.model
        judged_from = len(actions.ctrl) - self._task.hold_ticks if last else len(actions.ctrl)
        for tick, ctrl in enumerate(actions.ctrl):
            if self.ticks % timing.ticks_per_frame == 0:
                self._positions.append((data.time, data.qpos.copy(), sensed(self._scene, data)))
            if tick >= judged_from:
                self._judge()
            if self._grips:
                magnet[tick] = self._grips.update(data, ctrl)
            data.ctrl[:] = ctrl
            for _ in range(timing.physics_steps_per_tick):
                self._scene.step(data)
                self._limits.step(data)
                if self._see:
                    self._see(data)
            # After mj_step, poses and contacts are those of the step before.
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_flex(model, data)
            mujoco.mj_collision(model, data)
            self._limits.end_tick(data)
            self.world.watch()
            self.ticks += 1
        if last:
            self._judge()

    def result(self) -> Watched:
        """What happened, once the last actions have acted."""
        assert self._verdict is not None, "the last actions have not acted yet"
        return Watched(
            states=self._states(),
            T_at_start=self._T_at_start,
            T_object_before_grasp=np.eye(4),
            T_in_world=self._poses(),
            object_speed=max(self.world.speed(name) for name in self.world.things),
            motion=self._limits.motion(),
            verdict=self._verdict,
        )

    def judged(self) -> Verdict:
        """Whether the goal holds now."""
        return judge(self._task.goal, self.world, self._cast)

    def _judge(self) -> None:
        if self._verdict is None or self._verdict.reached:
            self._verdict = self.judged()

    def _poses(self) -> dict[str, Array]:
        return {name: self.world.pose(name) for name in self._scene.things}

    def _states(self) -> tuple[StepState, ...]:
        every = self._task.timing.ticks_per_frame
        ctrl = np.concatenate([actions.ctrl for actions in self._actions])
        magnet = np.concatenate([actions.magnet for actions in self._actions])
        joints = np.concatenate([actions.joints for actions in self._actions])
        spans = [slice(k * every, (k + 1) * every) for k in range(len(self._positions))]
        return tuple(
            StepState(time, qpos, Actions(ctrl[span], magnet[span], joints[span]), seen)
            for (time, qpos, seen), span in zip(self._positions, spans, strict=True)
        )


class _Limits:
    """Observes how near the arms come to what they can do, and what they touch that they must not."""

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        self._velocity = self._torque = 0.0
        self._joint = np.inf
        self._faults = Faults(scene)

    def step(self, data: mujoco.MjData) -> None:
        for arm in self._scene.arms:
            joints = data.qpos[arm.joint_qpos]
            self._velocity = max(self._velocity, float((np.abs(data.qvel[arm.joint_dof]) / arm.motor_speed).max()))
            force = np.abs(data.actuator_force[arm.arm_ctrl])
            self._torque = max(self._torque, float((force / arm.most_torque).max()))
            room = np.minimum(joints - arm.joint_range[:, 0], arm.joint_range[:, 1] - joints)
            self._joint = min(self._joint, float(room.min()))
        self._faults.step(data)

    def end_tick(self, data: mujoco.MjData) -> None:
        self._faults.end_tick(data)

    def motion(self) -> Motion:
        margins = Margins(self._velocity, self._torque, float(self._joint), None, None)
        return Motion(margins, None, self._faults.collision, self._faults.breakdown)


def settle(scene: CompiledScene, start: Array, timestep: float) -> Array:
    """MuJoCo's positions (nq,) once all things have come to rest, the arms being where they were at `start`."""
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    stiff = [np.arange(dof, dof + 6) for dof in scene.object_dof.values()]
    dofs = np.concatenate([*stiff, *(cloth.dof.ravel() for cloth in scene.cloths.values())])
    for _ in range(int(_SETTLE_SECONDS / timestep / _SETTLE_STEPS)):
        scene.step(data, _SETTLE_STEPS)
        if float(np.abs(data.qvel[dofs]).max()) < _AT_REST:
            break
    settled: Array = data.qpos.copy()
    for arm in scene.arms:
        settled[arm.joint_qpos] = start[arm.joint_qpos]
        if arm.fingers is not None:
            settled[arm.fingers.qpos] = start[arm.fingers.qpos]
    return settled
