from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..attempt_data import ActionSequence, AttemptJob, FailureCause, MotionMargins, StepState, WeldStates
from ..config.goals.goal import Goal, GoalVerdict, evaluate_goal
from ..config.goals.role_assignment import RoleAssignment
from ..config.program_task import ProgramTiming
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..sim.encoder_readings import delayed_positions, encoder_readings
from ..sim.sim_world import make_sim_world
from .episode_rules import EndReason, EndRule, EpisodeEnd, EpisodeRules
from .grasps import is_weld_active, make_grasp_simulator
from .held_objects import HeldObjectSlipMonitor
from .monitor import StepMonitor, describe_exceeded_limits

# Is called with MuJoCo's state at the start and after every physics step, and must not change it.
PhysicsStepCallback = Callable[[mujoco.MjData], None]


@dataclass(frozen=True)
class EpisodeGoal:
    """A goal, the objects in its roles, and for how many control ticks the goal has to hold."""

    goal: Goal
    roles: RoleAssignment
    hold_ticks: int


@dataclass(frozen=True)
class EpisodeResult:
    """The result of an episode.

    Attributes:
        states: the state of each recorded frame, before the frame's first command.
        verdict: evaluation of the goal at the end. If the goal held, but not for its hold time, the last evaluation in
            which it did not hold.
        held_ticks: control ticks for which the goal held without a break until the end.
        collision: the first contact of an arm with the table or another arm.
        T_at_end: object -> pose in `world`.
        speeds: object -> speed at the end, m/s.
    """

    states: tuple[StepState, ...]
    end: EpisodeEnd
    verdict: GoalVerdict | None
    held_ticks: int
    margins: MotionMargins | None
    collision: str | None
    T_at_end: dict[str, Array]
    speeds: dict[str, float]

    @property
    def success(self) -> bool:
        """Whether the goal held for its hold time at the end, and no rule failed the episode."""
        return self.end.cause is None


class Episode:
    """Simulate one attempt. The same commands from the same start give bit-identical states, however calls divide them.

    Attributes:
        data: MuJoCo's present state, with poses and contacts up to date.
        ticks: control ticks that have passed.
        verdict: present evaluation of the goal.
        held_ticks: control ticks for which the goal has held without a break.
        end: how the episode ended; None while it runs.

    Args:
        start: MuJoCo's positions (nq,), at rest.
        sides: "left" or "right" for each arm.
        goal: None if the caller decides about success.
    """

    def __init__(
        self,
        scene: CompiledScene,
        start: Array,
        timing: ProgramTiming,
        sides: Sequence[str],
        goal: EpisodeGoal | None,
        rules: EpisodeRules | None = None,
        *,
        on_step: PhysicsStepCallback | None = None,
    ) -> None:
        self.scene, self._timing, self._goal = scene, timing, goal
        self._rules, self._on_step = rules or EpisodeRules(), on_step
        self.data = mujoco.MjData(scene.model)
        scene.reset(self.data, start)
        self.world = make_sim_world(scene, self.data, sides)
        self.world.store_start()
        self._grasp = make_grasp_simulator(scene, self._rules.weld_reach)
        self._monitor = StepMonitor(scene, timing.physics_steps_per_tick)
        self._held_monitor = HeldObjectSlipMonitor(scene, self.world)
        self._ctrl: list[Array] = []
        self._weld_on: list[Sequence[bool]] = []
        self._joints: list[Array] = []
        self._frames: list[tuple[float, Array, Array | None]] = []
        self._low, self._high = scene.model.actuator_ctrlrange.T
        self.ticks = 0
        self.end: EpisodeEnd | None = None
        self.held_ticks = 0
        self.verdict: GoalVerdict | None = None
        self._last_unmet: GoalVerdict | None = None
        self._evaluate_goal()
        if on_step:
            on_step(self.data)

    @property
    def frame_count(self) -> int:
        """Frames recorded so far."""
        return len(self._frames)

    @property
    def simulated_seconds(self) -> float:
        """Simulated time, s."""
        return self.ticks * self._timing.tick_seconds

    @property
    def has_succeeded(self) -> bool:
        """Whether the goal has now held for its hold time."""
        goal = self._goal
        return goal is not None and self._goal_holds and self.held_ticks >= goal.hold_ticks

    @property
    def welds_active(self) -> tuple[bool, ...]:
        """Whether each arm's weld holds an object (arms,)."""
        return tuple(is_weld_active(self.data, arm) for arm in self.scene.arms)

    @property
    def joint_velocities(self) -> Array:
        """Velocities of each arm's joints, rad/s, and finger, m/s, (arms, drives)."""
        return np.array([self.data.qvel[arm.recorded_dof] for arm in self.scene.arms])

    @property
    def executed_actions(self) -> ActionSequence:
        """The actions so far."""
        return ActionSequence(np.array(self._ctrl), np.array(self._weld_on), np.array(self._joints))

    @property
    def goal_status(self) -> str:
        """The state of the goal as text; empty without a goal."""
        if self.verdict is None or self._goal is None:
            return ""
        worst = self.verdict.worst
        if not worst.holds:
            return f"not yet: {worst.what}" + (f" ({worst.detail})" if worst.detail else "")
        left = (self._goal.hold_ticks - self.held_ticks) * self._timing.tick_seconds
        return "the goal holds" + (f", and must hold for {left:.1f} s more" if left > 0 else "")

    def simulated_encoder_readings(self, job: AttemptJob) -> Array:
        """Return simulated encoder readings of joints, rad, and finger openings, m, (arms, drives)."""
        now = np.array([self.data.qpos[arm.recorded_qpos] for arm in self.scene.arms])
        seen = delayed_positions(self.scene, self.data)
        return encoder_readings(self.scene, now if seen is None else seen, job, self.ticks)

    def step(self, ctrl: Array, magnet: Sequence[bool] | WeldStates, joints: Array | None = None) -> None:
        """Execute a command for one control tick; do nothing once the episode has ended.

        Args:
            ctrl: drive commands (arms, drives), rad and m.
            magnet: whether each arm's weld is commanded on (arms,).
            joints: recorded references (arms, drives); the commands by default.
        """
        self._execute_tick(self._commands(ctrl), magnet, joints)

    def begin_tick(self, ctrl: Array, magnet: Sequence[bool]) -> None:
        """Begin a control tick as `step` does, and write its commands and constraints into `data`.

        The caller then steps the tick's physics, such as with other episodes on several threads, sets `data` to the
        result, and calls `end_tick`. Motion margins and collisions are not observed, so the rules must not be strict.
        """
        self._begin_tick(self._commands(ctrl), magnet, None)

    def end_tick(self) -> None:
        """Judge the state after a control tick."""
        self._update_kinematics_and_contacts()
        self._monitor.check_tick(self.data)
        self.ticks += 1
        self._held_monitor.measure_tick(self.world.update_handovers())
        self._evaluate_goal()
        self._check_end()

    def run_commands(self, actions: ActionSequence, *, until_success: bool = False) -> None:
        """Execute actions until the episode ends, or if `until_success`, until the goal has held for its time."""
        for ctrl, magnet, joints in zip(actions.ctrl, actions.magnet, actions.joints, strict=True):
            if self.end is not None or (until_success and self.has_succeeded):
                return
            self._execute_tick(ctrl, magnet, joints)

    def end_episode(self) -> EpisodeResult:
        """End the episode on behalf of its actor if it runs, and return its result."""
        if self.end is None:
            self._record_end(EndReason.ACTOR)
        assert self.end is not None
        verdict = (
            self._last_unmet
            if self._goal_holds and not self.has_succeeded and self._last_unmet is not None
            else self.verdict
        )
        return EpisodeResult(
            states=self._recorded_states(),
            end=self.end,
            verdict=verdict,
            held_ticks=self.held_ticks,
            margins=self._monitor.motion_margins(self._held_monitor.slip, self._held_monitor.tilt)
            if self.ticks
            else None,
            collision=self._monitor.collision,
            T_at_end=self._object_poses(),
            speeds={name: self.world.speed(name) for name in self.scene.object_names},
        )

    @property
    def _goal_holds(self) -> bool:
        return self.verdict is not None and self.verdict.reached

    def _execute_tick(self, ctrl: Array, magnet: Sequence[bool] | WeldStates, joints: Array | None) -> None:
        if self.end is not None:
            return
        self._begin_tick(ctrl, magnet, joints)
        for _ in range(self._timing.physics_steps_per_tick):
            self.scene.step(self.data)
            self._monitor.check_step(self.data)
            if self._on_step:
                self._on_step(self.data)
        self.end_tick()

    def _commands(self, ctrl: Array) -> Array:
        """Return the commands (nu,) of all drives, given the commands of the recorded drives (arms, drives)."""
        command = np.empty(self.scene.model.nu)
        command[self.scene.recorded_drive_ctrl] = ctrl
        return command

    def _begin_tick(self, ctrl: Array, magnet: Sequence[bool] | WeldStates, joints: Array | None) -> None:
        scene, data, timing = self.scene, self.data, self._timing
        ctrl = np.clip(ctrl, self._low, self._high)
        if self.ticks % timing.ticks_per_frame == 0:
            self._frames.append((data.time, data.qpos.copy(), delayed_positions(scene, data)))
        self._weld_on.append(self._grasp.update(data, ctrl, magnet))
        self._ctrl.append(ctrl)
        self._joints.append(ctrl[scene.recorded_drive_ctrl] if joints is None else joints)
        data.ctrl[:] = ctrl

    def _update_kinematics_and_contacts(self) -> None:
        """`mj_step` leaves poses and contacts from before the step: compute the present ones."""
        model, data = self.scene.model, self.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if self.scene.cloths:
            mujoco.mj_flex(model, data)
        mujoco.mj_collision(model, data)

    def _evaluate_goal(self) -> None:
        if self._goal is None:
            return
        held_before = self._goal_holds
        self.verdict = evaluate_goal(self._goal.goal, self.world, self._goal.roles)
        self.held_ticks = self.held_ticks + 1 if held_before and self._goal_holds else 0
        if not self._goal_holds:
            self._last_unmet = self.verdict

    def _check_end(self) -> None:
        monitor, rules = self._monitor, self._rules
        if monitor.breakdown:
            self._record_end(EndReason.UNSTABLE, FailureCause.UNSTABLE, monitor.breakdown)
        elif rules.strict and monitor.collision:
            self._record_end(EndReason.FORBIDDEN, FailureCause.COLLIDED, monitor.collision)
        elif rules.strict and (fault := describe_exceeded_limits(monitor.motion_margins())):
            self._record_end(EndReason.FORBIDDEN, FailureCause.LIMITS, fault)
        elif rules.end is EndRule.SUCCESS and self.has_succeeded:
            self._record_end(EndReason.SUCCESS)
        elif rules.max_ticks is not None and self.ticks >= rules.max_ticks:
            self._record_end(EndReason.TIME_LIMIT)

    def _record_end(self, reason: EndReason, cause: FailureCause | None = None, detail: str = "") -> None:
        if cause is None and self._goal is not None and not self.has_succeeded:
            cause, detail = self._goal_failure()
        self.end = EpisodeEnd(reason, self.ticks, cause, detail)

    def _goal_failure(self) -> tuple[FailureCause, str]:
        assert self.verdict is not None and self._goal is not None
        if not self._goal_holds:
            worst = self.verdict.worst
            return FailureCause.GOAL, f"{worst.what}: {worst.detail or 'it does not hold'}"
        tick = self._timing.tick_seconds
        return FailureCause.GOAL, (
            f"the goal has held for {self.held_ticks * tick:.2f} s, but must hold for "
            f"{self._goal.hold_ticks * tick:.2f} s"
        )

    def _object_poses(self) -> dict[str, Array]:
        return {name: self.world.pose(name) for name in self.scene.object_names}

    def _recorded_states(self) -> tuple[StepState, ...]:
        ticks, actions = self._timing.ticks_per_frame, self.executed_actions
        spans = [slice(k * ticks, (k + 1) * ticks) for k in range(len(self._frames))]
        return tuple(
            StepState(time, qpos, ActionSequence(actions.ctrl[span], actions.magnet[span], actions.joints[span]), seen)
            for (time, qpos, seen), span in zip(self._frames, spans, strict=True)
        )
