"""Simulates teleoperated arms tick by tick, and submits the attempts. Independent of pages and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.episode_rules import EndRule, EpisodeRules
from yamsim_cli.core.episode.execution import SimulatedAttempt, build_outcome
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.sampling import describe_missing_start, sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache, open_episode
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compiled import CompiledScene

from ..viewed_scene import ViewedScene
from .attempt_writer import AttemptWriter
from .recording_journal import CommandTick, RecordingJournal, UnfinishedRecording
from .teleop_arm import TeleopArm

TIME_LIMIT = 600.0  # s, default of a recording


class TeleopAttemptScene:
    """Scene and arms of the present attempt, in the order of recordings. Each role assignment has a separate scene."""

    scene: CompiledScene
    arms: tuple[TeleopArm, ...]

    def __init__(self, session: Session) -> None:
        self._config = session.config
        self._simulators = SimulatorCache(session)
        self._simulator: Simulator | None = None
        self.sides = arm_sides(session.config)
        self.postures = start_postures(session.config)

    def begin_attempt(self, job: AttemptJob) -> Attempt:
        """Sample the attempt of a job, which becomes the present attempt."""
        attempt = self.sample_attempt(job)
        if attempt.start is None:
            assert self._simulator is not None, "begin comes first"
            raise SimulationError(
                f"task {self._config.task.name!r}: {describe_missing_start(self._simulator, attempt)}"
            )
        return attempt

    def sample_attempt(self, job: AttemptJob, start: Array | None = None) -> Attempt:
        """Sample the attempt of a job, which may lack a start unless `start` (nq,) is given."""
        simulator = self._simulators.get(job)
        if simulator is not self._simulator:
            self._simulator, self.scene = simulator, simulator.scene
            self.arms = tuple(TeleopArm(simulator.config, self.scene, k) for k in range(len(self.scene.arms)))
        attempt = sample_attempt(simulator, job)
        return attempt if start is None else replace(attempt, start=start)

    def set_up(self, attempt: Attempt, rules: EpisodeRules) -> Episode:
        """Reset the arms, and return the attempt's episode."""
        assert self._simulator is not None, "begin comes first"
        for arm, posture in zip(self.arms, self.postures, strict=True):
            arm.reset(posture)
        return open_episode(self._simulator, attempt, rules)

    def finish_attempt(self, attempt: Attempt, episode: Episode) -> SimulatedAttempt:
        """Finish the episode, and return the attempt with its result."""
        assert self._simulator is not None, "begin comes first"
        played = episode.end_episode()
        return SimulatedAttempt(attempt, build_outcome(self._simulator, played), played)


@dataclass(frozen=True)
class TeleopStatus:
    """State of a teleoperation session, for display.

    Attributes:
        arm: "left" or "right"; empty for a rig with one arm.
        seconds: length of the recording so far, s.
        episodes, failures, waiting: numbers of attempts; `waiting` ones are not judged yet.
        target_distance: from the target pose of the hand to the nearest reachable pose, m; 0 if reachable.
        at_limit: joints at a joint limit.
        obstacle: that blocks the arm; empty without one.
        gripper_open, magnet: commands of the gripper and the weld; `magnet` is None if grasps hold by friction alone.
        prompt: empty unless it differs between attempts.
        goal: how far the goal of the task is met; empty for tasks without a goal.
    """

    arm: str
    recording: bool
    seconds: float
    episodes: int
    failures: int
    waiting: int
    target_distance: float
    at_limit: tuple[str, ...]
    obstacle: str
    gripper_open: bool
    magnet: bool | None
    is_weld_holding: bool
    message: str
    prompt: str = ""
    goal: str = ""

    @property
    def can_follow(self) -> bool:
        """Whether the hand can reach its target."""
        return not (self.target_distance or self.at_limit or self.obstacle)


class TeleopScene(ViewedScene):
    """A scene with teleoperated arms, and its state. All methods are thread-safe.

    Of two arms, one is teleoperated at a time, and the other continues to its last target. Methods without a side
    command the teleoperated arm. Each attempt has its own role assignment, so scene and model change between attempts.
    A stop releases objects that welds hold. Fingers keep their grasp, since the goal may require it. After a stop, the
    scene ignores targets until it is at rest.

    Attributes:
        config: config of the session.
        attempt_scene: scene and arms of the present attempt.
        sides: sides of the arms, in the order of recordings.
        is_recording: whether an attempt is being recorded, including the ticks after a stop.
        active_arm: index of the teleoperated arm in that order.
        episodes, failures, waiting, discarded: numbers of attempts; `waiting` ones are not judged yet.

    Args:
        journal: saves the present recording to the disk; None saves nothing.
        time_limit: of a recording, s.
    """

    def __init__(
        self,
        session: Session,
        receiver: AttemptWriter,
        journal: RecordingJournal | None = None,
        time_limit: float = TIME_LIMIT,
        end: EndRule = EndRule.ACTOR,
    ) -> None:
        super().__init__()
        self.config = config = session.config
        self._receiver, self._journal = receiver, journal
        self._max_ticks = max(1, round(time_limit / config.task.timing.tick_seconds))
        self._rules = EpisodeRules(end)
        self._has_welds = config.grasp == "weld"
        self.title = f"{config.task.name} teleop"
        self.attempt_scene = TeleopAttemptScene(session)
        self.sides = self.attempt_scene.sides
        self.active_arm = config.acting_scene_arms[0]
        self.is_recording = False
        self.message = ""
        self.episodes = self.failures = self.waiting = 0
        self.discarded = 0
        self._ticks = 0
        # Remaining ticks until a stopped recording is submitted.
        self._settling_ticks_left: int = 0
        self._begin_attempt()

    @property
    def tick_seconds(self) -> float:
        """Duration of a control tick, s."""
        return self.config.task.timing.tick_seconds

    @property
    def dof(self) -> int:
        """The number of joints of each arm, without fingers."""
        return self.attempt_scene.scene.arms[0].dof

    @property
    def simulated_seconds(self) -> float:
        """Simulated time since the session began, over all recordings, s."""
        return self._ticks * self.tick_seconds

    @property
    def target_pose(self) -> Array:
        """Target pose (4, 4) of the pinch frame in `world`."""
        return self._selected_arm.target_pose

    @property
    def status(self) -> TeleopStatus:
        """State of the session, for display."""
        with self.lock:
            arm = self._selected_arm
            return TeleopStatus(
                arm=arm.side if len(self.sides) > 1 else "",
                recording=self.is_recording,
                seconds=self._episode.simulated_seconds,
                episodes=self.episodes,
                failures=self.failures,
                waiting=self.waiting,
                target_distance=arm.target_distance,
                at_limit=arm.at_limit,
                obstacle=arm.obstacle,
                gripper_open=arm.is_open,
                magnet=arm.magnet if self._has_welds else None,
                is_weld_holding=self._episode.welds_active[self.active_arm],
                message=self.message,
                prompt=self._attempt.phrasing,
                goal=self._episode.goal_status,
            )

    def switch_arm(self) -> None:
        """Teleoperate the other arm, if the rig has two."""
        with self.lock:
            self.active_arm = (self.active_arm + 1) % len(self.sides)

    def select_arm(self, side: str) -> None:
        """Teleoperate the arm of a side, "left" or "right"."""
        with self.lock:
            self.active_arm = self.sides.index(side)

    def set_target_pose(self, T_pinch_in_world: Array) -> None:
        """Set the target pose (4, 4) of the pinch frame in `world`. A target inside the table is lifted above it."""
        self._command_arm(lambda arm: arm.set_target_pose(T_pinch_in_world))

    def set_grasp_target(self, T_grasp_in_base: Array) -> None:
        """Set the target pose (4, 4) of `grasp_site` in the base of the left or only arm."""
        self._command_arm(lambda arm: arm.set_grasp_target(self.attempt_scene.scene.T_base_in_world @ T_grasp_in_base))

    def set_joint_target(self, joints: Array) -> None:
        """Set the target joints (dof,), rad, clipped to the joint limits."""
        self._command_arm(lambda arm: arm.set_joint_target(joints))

    def set_all_joint_targets(self, joints: Array) -> None:
        """Set target joints and openings (arms, drives), rad and m."""
        with self.lock:
            if not self._settling_ticks_left:
                for arm, row in zip(self._arms, joints, strict=True):
                    posture = arm.posture_of(row)
                    arm.set_joint_target(posture.joints)
                    arm.set_gripper(posture.opening)

    def set_gripper(self, opening: float) -> None:
        """Set the opening of each finger, m, clipped to its range."""
        self._command_arm(lambda arm: arm.set_gripper(opening))

    def toggle_gripper(self) -> None:
        """Open the gripper fully, or close it. With welds, it closes to the opening around the object."""
        self._command_arm(lambda arm: arm.toggle_gripper())

    def set_weld(self, on: bool) -> None:
        """Switch the weld, which holds an object near the hand, on or off."""
        self._command_arm(lambda arm: arm.set_weld(on))

    def _command_arm(self, command: Callable[[TeleopArm], None]) -> None:
        with self.lock:
            if not self._settling_ticks_left:
                command(self._selected_arm)

    def start_recording(self) -> None:
        """Reset the scene to the start of the attempt, and record."""
        with self.lock:
            self.settle()
            self._begin_attempt(recording=True)
            if self._journal:
                self._journal.open_recording(self._attempt)
            self.message = "recording"

    def stop_recording(self) -> None:
        """End the recording, and release objects that welds hold. The attempt is submitted after settling and hold
        time.
        """
        with self.lock:
            if not self.is_recording or self._settling_ticks_left:
                self.message = "no recording was in progress"
                return
            self._end_recording()

    def _end_recording(self) -> None:
        self._halt_arms()
        if self._journal:
            self._journal.mark_stop()
        self._settling_ticks_left = self._ticks_after_stop
        self.message = f"{'releasing objects, and ' if self._has_welds else ''}waiting until all objects are at rest"
        if not self._settling_ticks_left:
            self._finish_recording()

    def _halt_arms(self) -> None:
        for arm in self._arms:
            if self._has_welds:
                arm.release()
            else:
                arm.halt()

    @property
    def _ticks_after_stop(self) -> int:
        task = self.config.task
        return task.timing.settle_ticks + task.hold_ticks

    def pause_unattended(self) -> None:
        """Pause a recording because the last page was closed."""
        with self.lock:
            if self.is_recording and not self.paused:
                self.paused = True
                self.message = "paused, because no browser was connected; click Play to continue"

    def submit_unfinished(self, left: UnfinishedRecording) -> None:
        """Submit the recording of a killed session, after simulating the ticks that miss after its stop."""
        with self.lock:
            self._set_attempt(self.attempt_scene.sample_attempt(left.job, left.start), self._rules)
            for tick in left.ticks:
                self._episode.step(tick.ctrl, tick.magnet, tick.reference)
            for k, arm in enumerate(self._arms):
                references = np.array([tick.reference[k] for tick in left.ticks])
                if len(references) and (references != references[0]).any():
                    last = arm.posture_of(references[-1])
                    arm.reset(last)
                    arm.set_joint_target(last.joints)
            self._halt_arms()
            since = 0 if left.stopped is None else len(left.ticks) - left.stopped
            for _ in range(max(0, self._ticks_after_stop - since)):
                self._step_physics()
            self._submit_recording()

    def settle(self) -> None:
        """Simulate all remaining ticks after a stop."""
        with self.lock:
            while self._settling_ticks_left:
                self._simulate_tick()

    def _finish_recording(self) -> None:
        if self._journal:
            self._journal.close_recording()
        self._submit_recording()

    def _submit_recording(self) -> None:
        self._receiver.submit(self.attempt_scene.finish_attempt(self._attempt, self._episode))
        self.message = f"attempt {self._attempt.job.attempt} is being rendered"
        self._begin_attempt()

    def discard_recording(self) -> None:
        """End and delete the recording. The next attempt has the same layout."""
        with self.lock:
            if not self.is_recording:
                self.message = "no recording was in progress"
                return
            self.discarded += 1
            if self._journal:
                self._journal.discard_recording()
            self.message = "discarded"
            self._begin_attempt()

    def reset(self) -> None:
        """Reset the scene to the start of the attempt. Discard a present recording."""
        with self.lock:
            if self.is_recording:
                self.discard_recording()
            else:
                self._begin_attempt()

    def advance_tick(self) -> None:
        """Simulate a control tick, unless paused."""
        with self.lock:
            if not self.paused:
                self._simulate_tick()

    def advance_to(self, now: float) -> None:
        """Simulate a control tick, unless paused: the caller paces the ticks."""
        self.advance_tick()

    def _begin_attempt(self, *, recording: bool = False) -> None:
        """Reset the scene to the start of the next attempt. End rule and time limit apply to recordings only."""
        attempt = self.attempt_scene.begin_attempt(AttemptJob(self.config.seed, self._receiver.next_attempt))
        self._set_attempt(attempt, self._rules if recording else EpisodeRules())
        self.is_recording = recording

    def _set_attempt(self, attempt: Attempt, rules: EpisodeRules) -> None:
        self._attempt = attempt
        self._episode = self.attempt_scene.set_up(attempt, rules)
        self.model, self.data = self.attempt_scene.scene.model, self._episode.data
        self.is_recording, self._settling_ticks_left = False, 0

    @property
    def _arms(self) -> tuple[TeleopArm, ...]:
        return self.attempt_scene.arms

    @property
    def _selected_arm(self) -> TeleopArm:
        return self._arms[self.active_arm]

    def _step_physics(self) -> None:
        ctrl = np.array([arm.step(self.data.qpos) for arm in self._arms])
        magnet = tuple(arm.magnet for arm in self._arms)
        reference = np.array([arm.command_reference for arm in self._arms])
        self._episode.step(ctrl, magnet, reference)
        if self.is_recording and self._journal:
            self._journal.add_tick(CommandTick(ctrl, magnet, reference))

    def _simulate_tick(self) -> None:
        self._step_physics()
        for arm, holds in zip(self._arms, self._episode.welds_active, strict=True):
            if arm.magnet and not holds:
                arm.magnet = False
                if self._has_welds:
                    self.message = "no object is within reach of the magnet"
        self._ticks += 1
        if self._settling_ticks_left:
            self._settling_ticks_left -= 1
            if not self._settling_ticks_left:
                self._finish_recording()
        elif self.is_recording and self._episode.end is not None:
            self._finish_recording()
        elif self.is_recording and self._episode.ticks >= self._max_ticks:
            self._end_recording()
            self.message = f"stopped after {self._max_ticks * self.tick_seconds:.0f} s, the time limit of a recording"
