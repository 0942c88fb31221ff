"""The episode engine: effects of commands, verdicts, and ends of an episode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.attempts import all_actions, planned, start_of
from yamsim_cli.core.attempt_data import ActionSequence, FailureCause
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode import Episode, EpisodeGoal, EpisodeResult
from yamsim_cli.core.episode.episode_rules import (
    EXPERT_RULES,
    REPLAY_RULES,
    EndReason,
    EndRule,
    EpisodeEnd,
    EpisodeRules,
)
from yamsim_cli.core.episode.execution import SimulatedAttempt, simulate_actions
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array

HOLD = 8  # control ticks in the 0.25 s for which the goal of `pickplace` has to hold
SUCCESS_RULES = EpisodeRules(EndRule.SUCCESS)


@pytest.fixture(scope="module")
def simulator(config: RecordConfig, locations: Locations) -> Simulator:
    return Simulator(Session(config, locations))


@pytest.fixture(scope="module")
def done(simulator: Simulator) -> SimulatedAttempt:
    """A demonstration that succeeds."""
    done = planned(simulator, 4)
    assert done.outcome.success, done.outcome
    return done


def goal_of(simulator: Simulator, hold_ticks: int = HOLD) -> EpisodeGoal:
    return EpisodeGoal(simulator.config.task.goal, simulator.roles, hold_ticks)


def open_at(
    simulator: Simulator, start: Array, rules: EpisodeRules | None = None, goal: EpisodeGoal | None = None
) -> Episode:
    task = simulator.config.task
    return Episode(
        simulator.scene, start, task.timing, arm_sides(simulator.config), goal or goal_of(simulator), rules
    )  # fmt: skip


def still(simulator: Simulator, start: Array, ticks: int) -> ActionSequence:
    """Actions that hold the arm's joints."""
    (arm,) = simulator.scene.arms
    ctrl = np.zeros(simulator.scene.model.nu)
    ctrl[arm.drive_ctrl] = place = start[arm.recorded_qpos]
    return ActionSequence(np.tile(ctrl, (ticks, 1)), np.zeros((ticks, 1), bool), np.tile(place, (ticks, 1, 1)))


def put(simulator: Simulator, qpos: Array, thing: str, place: Array) -> None:
    address = simulator.scene.object_qpos[thing]
    qpos[address : address + 3] = place


@pytest.fixture(scope="module")
def start(simulator: Simulator) -> Array:
    return start_of(simulator)


@pytest.fixture(scope="module")
def over_plate(simulator: Simulator, start: Array) -> Array:
    """The start with the banana 20 mm above its place on the plate."""
    address, over = simulator.scene.object_qpos["plate"], start.copy()
    put(simulator, over, "banana", start[address : address + 3] + np.array([0.0, 0.0, 0.042]))
    return over


def played_to(episode: Episode, actions: ActionSequence) -> EpisodeResult:
    episode.run_commands(actions)
    return episode.end_episode()


def assert_same(one: EpisodeResult, other: EpisodeResult) -> None:
    assert len(one.states) == len(other.states)
    for before, after in zip(one.states, other.states, strict=True):
        assert before.time == after.time
        np.testing.assert_array_equal(before.qpos, after.qpos)
        for key in ("ctrl", "magnet", "joints"):
            np.testing.assert_array_equal(getattr(before.actions, key), getattr(after.actions, key))
    assert (one.end, one.held_ticks, one.margins, one.speeds) == (
        other.end, other.held_ticks, other.margins, other.speeds
    )  # fmt: skip
    for name, T in one.T_at_end.items():
        np.testing.assert_array_equal(T, other.T_at_end[name])


def test_the_same_commands_in_pieces_or_at_once_give_the_same_bits(
    simulator: Simulator, done: SimulatedAttempt
) -> None:
    assert done.result is not None and done.attempt.start is not None
    actions = all_actions(done.recorded_states)
    whole = played_to(open_at(simulator, done.attempt.start, EXPERT_RULES), actions)
    assert_same(whole, done.result)
    pieces = open_at(simulator, done.attempt.start, EXPERT_RULES)
    for first, last in ((0, 1), (1, 8), (8, 8), (8, 75), (75, len(actions.ctrl))):
        pieces.run_commands(
            ActionSequence(actions.ctrl[first:last], actions.magnet[first:last], actions.joints[first:last])
        )
    assert_same(pieces.end_episode(), whole)
    ticks = open_at(simulator, done.attempt.start, EXPERT_RULES)
    for ctrl, magnet, joints in zip(actions.ctrl, actions.magnet, actions.joints, strict=True):
        ticks.step(ctrl[simulator.scene.recorded_drive_ctrl], magnet, joints)
    assert_same(ticks.end_episode(), whole)


def test_an_episode_does_not_depend_on_earlier_episodes(
    simulator: Simulator, done: SimulatedAttempt, over_plate: Array
) -> None:
    """The compiled model is shared, and welds change it."""
    other = planned(simulator, 9)
    assert other.outcome.success
    open_at(simulator, over_plate).run_commands(still(simulator, over_plate, 10))
    again = simulate_actions(simulator, done.attempt, all_actions(done.recorded_states), EXPERT_RULES)
    assert again.result is not None and done.result is not None
    assert_same(again.result, done.result)


def test_one_command_a_frame_would_not_be_enough(simulator: Simulator, done: SimulatedAttempt) -> None:
    """If each frame's first command is held for the whole frame, the episode ends in another state."""
    actions, (arm,) = all_actions(done.recorded_states), simulator.scene.arms
    every = simulator.config.task.timing.ticks_per_frame
    held = np.array([actions.ctrl[k - k % every] for k in range(len(actions.ctrl))])
    again = simulate_actions(simulator, done.attempt, replace(actions, ctrl=held), REPLAY_RULES)
    apart = [
        np.abs((before.qpos - after.qpos)[arm.joint_qpos]).max()
        for before, after in zip(done.recorded_states, again.recorded_states, strict=True)
    ]
    assert max(apart) > 0.02


def test_frames_are_states_before_their_first_command(simulator: Simulator, start: Array) -> None:
    episode = open_at(simulator, start)
    episode.run_commands(still(simulator, start, 5))
    timing, played = simulator.config.task.timing, episode.end_episode()
    assert timing.ticks_per_frame == 2
    np.testing.assert_array_equal(played.states[0].qpos, start)
    assert [len(state.actions.ctrl) for state in played.states] == [2, 2, 1]
    np.testing.assert_allclose(
        [state.time for state in played.states], [0.0, 2 * timing.tick_seconds, 4 * timing.tick_seconds]
    )
    assert (episode.ticks, episode.frame_count, episode.simulated_seconds) == (
        5,
        3,
        pytest.approx(5 * timing.tick_seconds),
    )


def test_the_state_is_looked_at_after_every_physics_step(simulator: Simulator, start: Array) -> None:
    times: list[float] = []
    timing = simulator.config.task.timing
    episode = Episode(
        simulator.scene, start, timing, ("right",), None, on_step=lambda data: times.append(float(data.time))
    )
    episode.run_commands(still(simulator, start, 2))
    np.testing.assert_allclose(times, np.arange(2 * timing.physics_steps_per_tick + 1) * timing.timestep)


def test_the_arm_follows_the_references_of_a_demonstration(simulator: Simulator, done: SimulatedAttempt) -> None:
    (arm,) = simulator.scene.arms
    reached = np.array([state.qpos[arm.joint_qpos] for state in done.recorded_states[1:]])
    wanted = np.array([state.actions.joints[-1, 0, : arm.dof] for state in done.recorded_states[:-1]])
    assert np.abs(reached - wanted).max() < 0.05


def test_commands_are_clipped_to_what_drives_can_be_told(simulator: Simulator, start: Array) -> None:
    (arm,) = simulator.scene.arms
    episode = open_at(simulator, start)
    command = start[arm.recorded_qpos].copy()
    command[0], command[-1] = 100.0, -100.0
    episode.step(command[None], [False])
    low, high = simulator.scene.model.actuator_ctrlrange[arm.drive_ctrl].T
    np.testing.assert_array_equal(episode.executed_actions.ctrl[0, arm.drive_ctrl], np.clip(command, low, high))
    # Without references of the actor, records have the executed commands.
    np.testing.assert_array_equal(episode.executed_actions.joints[0, 0], np.clip(command, low, high))


def _first_held(simulator: Simulator, start: Array) -> int:
    """Return the first tick after which the goal holds without actions."""
    episode = open_at(simulator, start)
    for tick in range(1, 40):
        episode.run_commands(still(simulator, start, 1))
        assert episode.verdict is not None
        if episode.verdict.reached:
            return tick
    raise AssertionError("the goal never holds")


def test_the_goal_has_to_hold_for_its_hold_time(simulator: Simulator, over_plate: Array) -> None:
    first = _first_held(simulator, over_plate)
    assert first > 1
    episode = open_at(simulator, over_plate)
    episode.run_commands(still(simulator, over_plate, first + HOLD - 1))
    assert (episode.held_ticks, episode.has_succeeded) == (HOLD - 1, False)
    assert episode.goal_status == "the goal holds, and must hold for 0.0 s more"
    played = episode.end_episode()
    assert played.end == EpisodeEnd(
        EndReason.ACTOR, first + HOLD - 1, FailureCause.GOAL,
        "the goal has held for 0.22 s, but must hold for 0.26 s",
    )  # fmt: skip
    # The verdict is that of the last tick at which the goal did not hold.
    assert played.verdict is not None and not played.verdict.reached
    assert not played.success

    longer = open_at(simulator, over_plate)
    longer.run_commands(still(simulator, over_plate, first + HOLD))
    assert (longer.held_ticks, longer.has_succeeded, longer.goal_status) == (HOLD, True, "the goal holds")
    played = longer.end_episode()
    assert played.success and played.verdict is not None and played.verdict.reached
    assert (played.end, played.held_ticks) == (EpisodeEnd(EndReason.ACTOR, first + HOLD), HOLD)


def test_a_goal_without_a_hold_time_holds_at_once(simulator: Simulator, over_plate: Array) -> None:
    first = _first_held(simulator, over_plate)
    episode = open_at(simulator, over_plate, SUCCESS_RULES, goal_of(simulator, hold_ticks=0))
    episode.run_commands(still(simulator, over_plate, 40))
    assert episode.end == EpisodeEnd(EndReason.SUCCESS, first)


def test_success_ends_at_the_first_tick_at_which_it_has_held_and_an_actor_goes_on(
    simulator: Simulator, over_plate: Array
) -> None:
    first = _first_held(simulator, over_plate)
    at_success = open_at(simulator, over_plate, SUCCESS_RULES)
    at_success.run_commands(still(simulator, over_plate, 40))
    assert at_success.end == EpisodeEnd(EndReason.SUCCESS, first + HOLD)
    assert at_success.ticks == len(at_success.executed_actions.ctrl) == first + HOLD
    # Later actions have no effect.
    before = at_success.data.qpos.copy()
    at_success.run_commands(still(simulator, over_plate, 3))
    np.testing.assert_array_equal(at_success.data.qpos, before)
    assert at_success.end_episode().end == EpisodeEnd(EndReason.SUCCESS, first + HOLD)

    by_actor = open_at(simulator, over_plate)
    by_actor.run_commands(still(simulator, over_plate, 40))
    assert by_actor.end is None and by_actor.ticks == 40
    assert by_actor.end_episode().end == EpisodeEnd(EndReason.ACTOR, 40)

    # An actor can omit later actions.
    waiting = open_at(simulator, over_plate)
    waiting.run_commands(still(simulator, over_plate, 40), until_success=True)
    assert (waiting.ticks, waiting.end, waiting.has_succeeded) == (first + HOLD, None, True)


@pytest.mark.parametrize("held", [HOLD - 1, HOLD + 5])
def test_a_success_that_is_undone_counts_only_if_success_ends_the_episode(
    simulator: Simulator, start: Array, over_plate: Array, held: int
) -> None:
    first = _first_held(simulator, over_plate)
    ends = {}
    for rules in (EpisodeRules(), SUCCESS_RULES):
        episode = open_at(simulator, over_plate, rules)
        episode.run_commands(still(simulator, over_plate, first + held))
        address = simulator.scene.object_qpos["banana"]
        put(simulator, episode.data.qpos, "banana", start[address : address + 3])
        episode.run_commands(still(simulator, over_plate, 4))
        ends[rules.end] = episode.end_episode()
    taken_back = ends[EndRule.ACTOR]
    assert taken_back.end == EpisodeEnd(
        EndReason.ACTOR, first + held + 4, FailureCause.GOAL, "on(banana, plate): they do not touch"
    )  # fmt: skip
    assert taken_back.held_ticks == 0
    assert ends[EndRule.SUCCESS].success is (held >= HOLD)


def test_an_interruption_starts_the_hold_time_anew(simulator: Simulator, start: Array, over_plate: Array) -> None:
    first = _first_held(simulator, over_plate)
    episode = open_at(simulator, over_plate, SUCCESS_RULES)
    episode.run_commands(still(simulator, over_plate, first + HOLD - 2))
    put(simulator, episode.data.qpos, "banana", over_plate[simulator.scene.object_qpos["banana"] :][:3])
    episode.run_commands(still(simulator, over_plate, 1))
    assert episode.held_ticks == 0 and episode.verdict is not None and not episode.verdict.reached
    episode.run_commands(still(simulator, over_plate, 40))
    assert episode.end is not None and episode.end.reason is EndReason.SUCCESS
    assert episode.end.tick > first + 2 * HOLD - 1
    assert episode.held_ticks == HOLD


def test_the_time_limit_ends_an_episode(simulator: Simulator, start: Array, over_plate: Array) -> None:
    episode = open_at(simulator, start, EpisodeRules(max_ticks=5))
    episode.run_commands(still(simulator, start, 9))
    assert episode.end == EpisodeEnd(EndReason.TIME_LIMIT, 5, FailureCause.GOAL, "on(banana, plate): they do not touch")
    # Success at the last tick counts.
    last = _first_held(simulator, over_plate) + HOLD
    for limit, reason in ((last, EndReason.SUCCESS), (last - 1, EndReason.TIME_LIMIT)):
        episode = open_at(simulator, over_plate, EpisodeRules(EndRule.SUCCESS, max_ticks=limit))
        episode.run_commands(still(simulator, over_plate, 60))
        assert episode.end is not None
        assert (episode.end.reason, episode.end.tick) == (reason, limit)
        assert (episode.end.cause is None) is (reason is EndReason.SUCCESS)


def _bows(simulator: Simulator, start: Array, ticks: int = 60) -> ActionSequence:
    """Actions that bend the arm until its fingers are on the table, within the motors' speeds."""
    actions, (arm,) = still(simulator, start, ticks), simulator.scene.arms
    actions.ctrl[:, arm.arm_ctrl[1]] += np.linspace(0, 1.5, ticks)
    return actions


def test_a_strict_rule_ends_it_at_the_first_forbidden_contact(simulator: Simulator, start: Array) -> None:
    actions = _bows(simulator, start)
    strict = open_at(simulator, start, EXPERT_RULES)
    strict.run_commands(actions)
    assert strict.end is not None
    assert (strict.end.reason, strict.end.cause) == (EndReason.FORBIDDEN, FailureCause.COLLIDED)
    assert "table" in strict.end.detail and "finger" in strict.end.detail
    assert 0 < strict.end.tick < len(actions.ctrl)
    # One tick earlier, there is no end.
    shorter = open_at(simulator, start, EXPERT_RULES)
    shorter.run_commands(
        ActionSequence(*(part[: strict.end.tick - 1] for part in (actions.ctrl, actions.magnet, actions.joints)))
    )
    assert shorter.end is None and shorter.end_episode().collision is None

    free = open_at(simulator, start, REPLAY_RULES)
    free.run_commands(actions)
    played = free.end_episode()
    assert (played.end.reason, played.end.tick, played.collision) == (
        EndReason.ACTOR, len(actions.ctrl), strict.end.detail
    )  # fmt: skip
    # Up to there, both are equal.
    for one, other in zip(strict.end_episode().states, played.states, strict=False):
        np.testing.assert_array_equal(one.qpos, other.qpos)


def test_a_strict_rule_ends_it_at_an_exceeded_limit(simulator: Simulator, start: Array) -> None:
    actions, (arm,) = still(simulator, start, 20), simulator.scene.arms
    actions.ctrl[5:, arm.arm_ctrl[0]] += 2.0
    strict = open_at(simulator, start, EXPERT_RULES)
    strict.run_commands(actions)
    assert strict.end is not None
    assert (strict.end.reason, strict.end.cause) == (EndReason.FORBIDDEN, FailureCause.LIMITS)
    assert 5 < strict.end.tick < 20
    free = open_at(simulator, start, REPLAY_RULES)
    free.run_commands(actions)
    margins = free.end_episode().margins
    assert free.ticks == 20 and margins is not None and max(margins.velocity, margins.torque) >= 1


def test_physics_that_breaks_down_ends_it_whatever_the_rules(simulator: Simulator, start: Array) -> None:
    episode = open_at(simulator, start, REPLAY_RULES)
    episode.run_commands(still(simulator, start, 2))
    episode.data.qvel[simulator.scene.object_dof["banana"] + 2] = 1e20
    episode.run_commands(still(simulator, start, 5))
    assert episode.end is not None
    assert (episode.end.reason, episode.end.tick, episode.end.cause) == (EndReason.UNSTABLE, 3, FailureCause.UNSTABLE)
    assert "physics broke down within 0.0" in episode.end.detail


def test_without_a_goal_nobody_succeeds_and_nothing_failed(simulator: Simulator, over_plate: Array) -> None:
    episode = Episode(
        simulator.scene, over_plate, simulator.config.task.timing, ("right",), None, EpisodeRules(EndRule.SUCCESS)
    )
    episode.run_commands(still(simulator, over_plate, 30))
    assert (episode.verdict, episode.has_succeeded, episode.goal_status, episode.end) == (None, False, "", None)
    assert episode.end_episode().end == EpisodeEnd(EndReason.ACTOR, 30)


def test_an_episode_in_which_nothing_acts_has_neither_states_nor_margins(simulator: Simulator, start: Array) -> None:
    played = open_at(simulator, start).end_episode()
    assert (played.states, played.margins, played.end.tick) == ((), None, 0)
    assert not played.success


def test_a_goal_is_said_in_words_for_whoever_acts(simulator: Simulator, start: Array) -> None:
    assert open_at(simulator, start).goal_status == "not yet: on(banana, plate) (they do not touch)"
