"""Arms that are driven from outside, tick by tick: targets in, driven attempts out. Knows neither pages nor files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..episode.rules import EndRule, EpisodeRules
from ..geometry.se3 import Array
from ..session import Session
from ..types import Attempt, EpisodeJob
from ..viewers.driven import Driven, DriveStatus
from .desk import Inbox
from .driven_arm import DrivenArm
from .journal import Journal, Tick, Unfinished
from .stage import Stage

# The longest recording unless another is asked for, s.
TIME_LIMIT = 600.0


class DrivenScene(Driven):
    """A scene and its state; a `viewers.driven.Driven`. Its methods may be called from any thread.

    Of two arms one is driven at a time, and the other holds its place or goes on to where it was last told to go. What
    is said of the arm, its hand, gripper and magnet is of the driven one. It follows a target, a pose of the hand or
    joints, see `DrivenArm`; after a stop, it takes none until all is at rest. A recording begins from rest at its
    attempt's layout, as every attempt of the task does. Attempts have casts of their own, so that the scene, and the
    model with it, changes between attempts. A stop lets go what magnets hold. What fingers hold stays held, since that
    may be the goal.

    Attributes:
        sides: of its arms, in the order of recordings.
        driven: number of the driven one in that order.

    Args:
        time_limit: longest recording, s.
        end: who ends a recording: the person, or the first moment at which the goal has held for its hold time.

    Raises:
        SimulationError: the task's things have no room.
    """

    def __init__(
        self,
        session: Session,
        inbox: Inbox,
        journal: Journal | None = None,
        time_limit: float = TIME_LIMIT,
        end: EndRule = EndRule.ACTOR,
    ) -> None:
        super().__init__()
        self._config = config = session.config
        self._inbox, self._journal = inbox, journal
        self._longest = max(1, round(time_limit / config.task.timing.tick))
        self._rules = EpisodeRules(end)
        self._magnets = config.grasp == "weld"
        self.title = f"{config.task.name} teleop"
        self._stage = Stage(session)
        self.sides = self._stage.sides
        self.driven = config.acting_scene_arms[0]
        self._recording = False
        self.message = ""
        self.episodes = self.failures = self.waiting = 0
        self.discarded = 0
        self._ticks = 0
        # Ticks that are left of the second after a stop.
        self._settling: int = 0
        self._begin()

    @property
    def tick_seconds(self) -> float:
        """Length of a control tick, s."""
        return self._config.task.timing.tick

    @property
    def dof(self) -> int:
        """How many joints each arm has, fingers not counted."""
        return self._stage.scene.arms[0].dof

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
        return self._arm.target

    @property
    def status(self) -> DriveStatus:
        """How things stand."""
        with self.lock:
            arm = self._arm
            return DriveStatus(
                arm=arm.side if len(self.sides) > 1 else "",
                recording=self._recording,
                seconds=self._episode.seconds,
                episodes=self.episodes,
                failures=self.failures,
                waiting=self.waiting,
                apart=arm.apart,
                at_limit=arm.at_limit,
                blocked=arm.blocked,
                gripper_open=arm.is_open,
                magnet=arm.magnet if self._magnets else None,
                holds=self._episode.held[self.driven],
                message=self.message,
                prompt=self._attempt.phrasing,
                goal=self._episode.status,
            )

    def switch_arm(self) -> None:
        """Drive the other arm, if there is one."""
        with self.lock:
            self.driven = (self.driven + 1) % len(self.sides)

    def drive(self, side: str) -> None:
        """Drive the arm of a side, "left" or "right", which has to be there."""
        with self.lock:
            self.driven = self.sides.index(side)

    def aim(self, T_pinch_in_world: Array) -> None:
        """Give the hand another target (4, 4); one in the table is lifted out of it."""
        self._tell(lambda arm: arm.aim(T_pinch_in_world))

    def aim_grasp(self, T_grasp_in_base: Array) -> None:
        """Give the hand another target: a pose (4, 4) of `grasp_site` in the base that frames' `ee_pose` is in."""
        self._tell(lambda arm: arm.aim_grasp(self._stage.scene.T_base_in_world @ T_grasp_in_base))

    def aim_joints(self, joints: Array) -> None:
        """Give the arm joints (rad) to go to, as a leader arm would; beyond a stop counts as at it."""
        self._tell(lambda arm: arm.aim_joints(joints))

    def aim_all(self, joints: Array) -> None:
        """Give every arm joints and an opening, if it has fingers, (arms, drives) to go to, rad and m."""
        with self.lock:
            if not self._settling:
                for arm, row in zip(self._arms, joints, strict=True):
                    stand = arm.stand(row)
                    arm.aim_joints(stand.joints)
                    arm.set_gripper(stand.opening)

    def set_gripper(self, opening: float) -> None:
        """Open each finger by so much, m; beyond its range counts as the end of it."""
        self._tell(lambda arm: arm.set_gripper(opening))

    def toggle_gripper(self) -> None:
        """Open the gripper wide, or close it, see `DrivenArm.toggle_gripper`."""
        self._tell(lambda arm: arm.toggle_gripper())

    def set_magnet(self, on: bool) -> None:
        """Switch the magnet, which holds the object where the hand is at it."""
        self._tell(lambda arm: arm.set_magnet(on))

    def _tell(self, order: Callable[[DrivenArm], None]) -> None:
        """Give the driven arm an order, unless all is coming to rest."""
        with self.lock:
            if not self._settling:
                order(self._arm)

    def start(self) -> None:
        """Record from the attempt's beginning: everything goes back to where it was at first."""
        with self.lock:
            self.settle()
            self._begin(recording=True)
            if self._journal:
                self._journal.begin(self._attempt)
            self.message = "recording"

    def stop(self) -> None:
        """End the recording: once everything has had the time to rest, and the goal the time to hold, it is handed in.
        What magnets hold is let go first.
        """
        with self.lock:
            if not self._recording or self._settling:
                self.message = "nothing was being recorded"
                return
            self._end()

    def _end(self) -> None:
        self._leave_off()
        if self._journal:
            self._journal.stop()
        self._settling = self._rest_ticks
        self.message = f"{'letting go, and ' if self._magnets else ''}waiting until all is at rest"
        if not self._settling:
            self._hand_in()

    def _leave_off(self) -> None:
        for arm in self._arms:
            if self._magnets:
                arm.release()
            else:
                arm.halt()

    @property
    def _rest_ticks(self) -> int:
        """How many ticks follow a stop."""
        task = self._config.task
        return task.timing.settle_ticks + task.hold_ticks

    def leave(self) -> None:
        """Nobody watches any more: a recording stands still until somebody plays on."""
        with self.lock:
            if self._recording and not self.paused:
                self.paused = True
                self.message = "paused, since nobody was watching: Play goes on"

    def take_up(self, left: Unfinished) -> None:
        """Hand in what a killed session left; what it had not come to, to let go and to rest, is done now."""
        with self.lock:
            self._put(self._stage.again(left.job, left.start), self._rules)
            for tick in left.ticks:
                self._episode.step(tick.ctrl, tick.magnet, tick.asked)
            for k, arm in enumerate(self._arms):
                asked = np.array([tick.asked[k] for tick in left.ticks])
                if len(asked) and (asked != asked[0]).any():
                    last = arm.stand(asked[-1])
                    arm.reset(last)
                    arm.aim_joints(last.joints)
            self._leave_off()
            since = 0 if left.stopped is None else len(left.ticks) - left.stopped
            for _ in range(max(0, self._rest_ticks - since)):
                self._act()
            self._deliver()

    def settle(self) -> None:
        """Have what is left of a stop's second pass at once."""
        with self.lock:
            while self._settling:
                self._tick()

    def _hand_in(self) -> None:
        if self._journal:
            self._journal.end()
        self._deliver()

    def _deliver(self) -> None:
        self._inbox.hand_in(self._stage.result(self._attempt, self._episode))
        self.message = f"attempt {self._attempt.job.attempt} is being rendered"
        self._begin()

    def discard(self) -> None:
        """End the recording as if it had never been: the same layout comes again."""
        with self.lock:
            if not self._recording:
                self.message = "nothing was being recorded"
                return
            self.discarded += 1
            if self._journal:
                self._journal.discard()
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

    def _begin(self, *, recording: bool = False) -> None:
        """Put the scene into its attempt's layout, at rest, with open fingers. Only a recording ends by itself."""
        attempt = self._stage.begin(EpisodeJob(self._config.seed, self._inbox.next_attempt))
        self._put(attempt, self._rules if recording else EpisodeRules())
        self._recording = recording

    def _put(self, attempt: Attempt, rules: EpisodeRules) -> None:
        """Put the scene to an attempt's start, at rest."""
        self._attempt = attempt
        self._episode = self._stage.set_up(attempt, rules)
        self.model, self.data = self._stage.scene.model, self._episode.data
        self._recording, self._settling = False, 0

    @property
    def _arms(self) -> tuple[DrivenArm, ...]:
        return self._stage.arms

    @property
    def _arm(self) -> DrivenArm:
        return self._arms[self.driven]

    def _act(self) -> None:
        """Let what the arms are told act for a tick."""
        ctrl = np.array([arm.step(self.data.qpos) for arm in self._arms])
        magnet = tuple(arm.magnet for arm in self._arms)
        asked = np.array([arm.asked for arm in self._arms])
        self._episode.step(ctrl, magnet, asked)
        if self._recording and self._journal:
            self._journal.add(Tick(ctrl, magnet, asked))

    def _tick(self) -> None:
        self._act()
        for arm, holds in zip(self._arms, self._episode.held, strict=True):
            if arm.magnet and not holds:
                arm.magnet = False
                if self._magnets:
                    self.message = "the magnet found nothing within its reach"
        self._ticks += 1
        if self._settling:
            self._settling -= 1
            if not self._settling:
                self._hand_in()
        elif self._recording and self._episode.end is not None:
            self._hand_in()
        elif self._recording and self._episode.ticks >= self._longest:
            self._end()
            self.message = f"stopped after {self._longest * self.tick_seconds:.0f} s, the longest that is recorded"
