"""The same actions get the same verdict at the same control tick by every interface.

The expert's actions are tried unchanged, followed by their reverse, reversed before the goal has held for its hold
time, and delayed. All numbers are rounded to float32 first, because some interfaces accept only float32.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from tests.attempts import all_actions
from tests.viewers.teleop.tray import CollectingReceiver
from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode_rules import EndRule, EpisodeRules
from yamsim_cli.core.episode.execution import simulate_actions, simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache, open_episode
from yamsim_cli.core.files.documents.yaml_document import dump_yaml, load_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialRunner
from yamsim_cli.program_checks import check_task_config
from yamsim_cli.station import Station, StationSettings
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene

End = Literal["success", "actor"]

# Interfaces whose packages are not installed.
ABSENT = {
    way
    for way, packages in {"gymnasium": ["gymnasium"], "inspect": ["inspect_robots", "kitchenbench"]}.items()
    if not all(map(importlib.util.find_spec, packages))
}

STATION = "yam_station_linear_4310_d405"
JOB = AttemptJob(seed=0, attempt=0)
TICK_HZ = 30  # Hz, rate of control ticks in every test here: Inspect Robots' embodiment has no other rate

SPARE_TICKS = 40  # control ticks; the time limit of a trial is twice the expert's duration and this

PLAYER = """
import numpy as np


class Player:
    images = ()

    def __init__(self):
        self._played = np.load({file!r})

    def reset(self):
        self._tick = 0

    def __call__(self, observation):
        tick, self._tick = self._tick, self._tick + 1
        return {{"ctrl": self._played["ctrl"][tick], "magnet": self._played["magnet"][tick]}}
"""


@dataclass(frozen=True)
class Played:
    """Commands of a trial, tick by tick: of drives (n, arms, drives), and whether welds are on (n, arms)."""

    ctrl: np.ndarray
    magnet: np.ndarray

    def __getitem__(self, ticks: slice) -> Played:
        return Played(self.ctrl[ticks], self.magnet[ticks])

    def __add__(self, other: Played) -> Played:
        return Played(np.concatenate([self.ctrl, other.ctrl]), np.concatenate([self.magnet, other.magnet]))

    def __len__(self) -> int:
        return len(self.ctrl)

    @property
    def back(self) -> Played:
        """The same motion in reverse."""
        return self[::-1]

    def still(self, ticks: int) -> Played:
        """The last command for `ticks` ticks."""
        last = self[-1:]
        return Played(np.repeat(last.ctrl, ticks, axis=0), np.repeat(last.magnet, ticks, axis=0))


@dataclass(frozen=True)
class Verdict:
    """Whether a trial succeeded, and the control tick of the verdict."""

    success: bool
    tick: int


@dataclass
class TrialCase:
    """A task, the start of one trial, and its expert's commands.

    Attributes:
        file: config of a recording of the task.
        base: the expert's commands.
        limit: control ticks that a trial may take.
    """

    file: Path
    session: Session
    simulator: Simulator
    attempt: Attempt
    base: Played
    limit: int

    @property
    def hold(self) -> int:
        return self.session.config.task.hold_ticks

    def padded(self, played: Played) -> Played:
        """The same, extended to the time limit."""
        assert len(played) <= self.limit
        return played + played.still(self.limit - len(played))

    def actions(self, played: Played) -> ActionSequence:
        ctrl = np.zeros((len(played), self.simulator.scene.model.nu))
        ctrl[:, self.simulator.scene.recorded_drive_ctrl] = played.ctrl
        return ActionSequence(ctrl, played.magnet, played.ctrl)

    def held_ticks(self, played: Played) -> list[int]:
        """Number of ticks for which the goal has held, after each tick."""
        episode, held = open_episode(self.simulator, self.attempt, EpisodeRules()), []
        for ctrl, magnet in zip(played.ctrl, played.magnet, strict=True):
            episode.step(ctrl, magnet)
            held.append(episode.held_ticks)
        return held


def by_repeat(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    rules = EpisodeRules(EndRule(end), max_ticks=case.limit)
    done = simulate_actions(case.simulator, case.attempt, case.actions(played), rules)
    assert done.result is not None and done.outcome.success == done.result.success
    return Verdict(done.outcome.success, done.result.end.tick)


def by_eval(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    np.savez(folder / "played.npz", ctrl=played.ctrl.reshape(len(played), -1), magnet=played.magnet)
    (folder / "player.py").write_text(PLAYER.format(file=str(folder / "played.npz")))
    with TrialRunner(case.session, PolicyChoice("player.py:Player", folder, end=EndRule(end))) as runner:
        result = runner.run(JOB)
    assert result.error == ""
    return Verdict(result.outcome.success, result.ticks)


def by_gymnasium(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    import gymnasium

    import yamsim_cli.gym_env

    env = gymnasium.make(yamsim_cli.gym_env.ENV_ID, config=str(case.file), end=end)
    env.reset(seed=JOB.seed, options={"trial": JOB.attempt})
    over, ticks = False, 0
    while not over:
        action = np.append(played.ctrl[ticks], played.magnet[ticks]).astype(np.float32)
        _, reward, terminated, truncated, info = env.step(action)
        over, ticks = terminated or truncated, ticks + 1
    env.close()
    assert reward == info["success"]
    return Verdict(bool(info["success"]), ticks)


def by_station(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    """By the station, a tick at a time."""
    with Station(StationSettings(config=str(case.file)), pictures=False, end=end) as station:
        assert station.begin(JOB.seed, JOB.attempt) == JOB.attempt
        for ctrl, magnet in zip(played.ctrl, played.magnet, strict=True):
            station.command(np.append(ctrl, magnet))
            station.tick()
        return Verdict(station.judge() == "", round(station.time * TICK_HZ))


def by_inspect(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    """By the judge of Inspect Robots' embodiment, whose only rule is the first success."""
    assert end == "success"
    from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
    from yamsim_cli.kitchenbench.success_judges import GoalJudge
    from yamsim_cli.kitchenbench.yamsim_scene import build_task_scene

    own = build_task_scene(case.session, JOB.seed)
    motion = SceneStepper(own, 1)
    judge = GoalJudge(own, motion)
    reached = False
    with own.simulator:
        for ctrl, magnet in zip(played.ctrl, played.magnet, strict=True):
            motion.episode.step(ctrl, magnet)
            reached, _ = judge.evaluate()
            if reached:
                break
    return Verdict(reached, motion.episode.ticks)


class PlayedArm:
    """Replaces a teleoperated arm, with commands tick by tick."""

    def __init__(self, played: Played, number: int) -> None:
        self._played, self._number, self._tick = played, number, -1

    def step(self, qpos: np.ndarray) -> np.ndarray:
        self._tick = min(self._tick + 1, len(self._played) - 1)
        return self.command_reference

    @property
    def command_reference(self) -> np.ndarray:
        ctrl: np.ndarray = self._played.ctrl[self._tick, self._number]
        return ctrl

    @property
    def magnet(self) -> bool:
        return bool(self._played.magnet[self._tick, self._number])

    @magnet.setter
    def magnet(self, on: bool) -> None: ...

    def reset(self, stand: object) -> None: ...

    def release(self) -> None: ...

    def halt(self) -> None: ...


def by_teleop(case: TrialCase, played: Played, end: End, folder: Path) -> Verdict:
    """By a teleoperated recording, which the task's time limit does not end."""
    tray = CollectingReceiver()
    driven = TeleopScene(case.session, tray, end=EndRule(end))
    driven.start_recording()
    driven.attempt_scene.arms = tuple(PlayedArm(played, k) for k in range(played.ctrl.shape[1]))  # type: ignore[assignment]
    for _ in range(len(played)):
        if not tray.attempts:
            driven.advance_tick()
    if not tray.attempts:
        driven.stop_recording()
        driven.settle()
        return Verdict(tray.attempts[0].outcome.success, case.limit)
    (handed_in,) = tray.attempts
    assert handed_in.result is not None
    return Verdict(handed_in.outcome.success, handed_in.result.end.tick)


Way = Callable[[TrialCase, Played, End, Path], Verdict]

WAYS: dict[str, Way] = {
    "eval": by_eval,
    "gymnasium": by_gymnasium,
    "station": by_station,
    "inspect": by_inspect,
    "teleop": by_teleop,
}


def task_file(name: str, folder: Path, locations: Locations, limit: int | None = None) -> Path:
    """The file of a shipped task, with the control ticks of all interfaces, and another time limit."""
    task: dict[str, Any] = load_yaml(locations.config_file("tasks", name)).data
    timing = {"physics_steps_per_tick": 16} | task.get("timing", {})
    task["timing"] = timing | {"timestep": 1 / (TICK_HZ * timing["physics_steps_per_tick"])}
    if limit is not None:
        # Between two ticks, so that rounding does not matter.
        task["time_limit_s"] = (limit - 0.5) / TICK_HZ
    file = folder / f"{name}.yaml"
    file.write_text(dump_yaml(task))
    return file


def opened(name: str, rig: str, folder: Path, locations: Locations, limit: int | None = None) -> tuple[Path, Session]:
    """Config of a recording, and its session without meshes."""
    config: dict[str, Any] = load_yaml(locations.config_file("record", "default")).data
    config |= {"task": str(task_file(name, folder, locations, limit)), "rig": rig, "wrist": True}
    file = folder / "record.yaml"
    file.write_text(dump_yaml(config))
    made = load_config(RecordConfig, "record", str(file), locations, check=check_task_config)
    return file, Session(made, locations).without_meshes()


def rounded(actions: ActionSequence, drives: np.ndarray) -> Played:
    return Played(actions.ctrl[:, drives].astype(np.float32).astype(float), np.asarray(actions.magnet, bool))


# Tasks with their rigs, by weld, with one arm and with two.
WELDED = [
    pytest.param(("pickplace", "single"), id="pickplace"),
    pytest.param(("handover", "russet"), id="handover", marks=pytest.mark.slow),
]
# The same by friction: a joint is opened, and cloth is folded. These trials are the longest.
BY_FRICTION = [
    pytest.param(("drawer", STATION), id="drawer", marks=pytest.mark.slow),
    pytest.param(("fold_napkin", STATION), id="fold_napkin", marks=pytest.mark.slow),
]


@pytest.fixture(scope="module")
def case(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, locations: Locations
) -> Iterator[TrialCase]:
    name, rig = request.param
    folder = tmp_path_factory.mktemp(name)
    _, session = opened(name, rig, folder, locations)
    with SimulatorCache(session) as simulators:
        simulator = simulators.get(JOB)
        done = simulate_expert(simulator, sample_attempt(simulator, JOB))
        assert done.outcome.success, done.outcome
        base = rounded(all_actions(done.recorded_states), simulator.scene.recorded_drive_ctrl)
    limit = 2 * len(base) + SPARE_TICKS
    file, session = opened(name, rig, folder, locations, limit)
    assert session.config.task.max_ticks == limit
    with SimulatorCache(session) as simulators:
        simulator = simulators.get(JOB)
        yield TrialCase(file, session, simulator, sample_attempt(simulator, JOB), base, limit)


def same_everywhere(case: TrialCase, played: Played, end: End, folder: Path, *, but: tuple[str, ...] = ()) -> Verdict:
    """Return the verdict of all interfaces.

    Args:
        but: interfaces without this kind of trial.
    """
    padded = case.padded(played)
    verdict = by_repeat(case, padded, end, folder)
    found = {name: way(case, padded, end, folder) for name, way in WAYS.items() if name not in {*but, *ABSENT}}
    assert found == dict.fromkeys(found, verdict)
    return verdict


@pytest.mark.parametrize("case", [*WELDED, *BY_FRICTION], indirect=True)
def test_the_experts_actions(case: TrialCase, tmp_path: Path) -> None:
    verdict = same_everywhere(case, case.base, "success", tmp_path)
    held = case.held_ticks(case.base)
    assert verdict == Verdict(True, 1 + next(k for k, ticks in enumerate(held) if ticks == case.hold))


@pytest.mark.slow
@pytest.mark.parametrize("case", WELDED, indirect=True)
def test_what_was_done_and_is_undone_again(case: TrialCase, tmp_path: Path) -> None:
    """It is a success at the goal's hold time, and none if the actor ends the trial."""
    undone = case.base + case.base.back
    first = same_everywhere(case, undone, "success", tmp_path)
    assert first.success and first.tick <= len(case.base)
    last = same_everywhere(case, undone, "actor", tmp_path, but=("inspect",))
    assert last == Verdict(False, case.limit)


@pytest.mark.slow
@pytest.mark.parametrize("case", WELDED, indirect=True)
def test_a_goal_that_holds_too_short_a_time(case: TrialCase, tmp_path: Path) -> None:
    begins = case.held_ticks(case.base).index(1)
    short = case.base[: begins + 1]
    undone = short + short.back
    assert 0 < max(case.held_ticks(case.padded(undone))) < case.hold
    verdict = same_everywhere(case, undone, "success", tmp_path)
    assert verdict == Verdict(False, case.limit)


@pytest.mark.slow
@pytest.mark.parametrize("case", WELDED, indirect=True)
def test_a_success_at_the_last_moment_and_one_a_tick_too_late(case: TrialCase, tmp_path: Path) -> None:
    """Only the task's time limit distinguishes the two, which ends no teleoperated recording."""

    half = len(case.base) // 2

    def waiting(ticks: int, pause: int) -> Played:
        """The expert's actions after some ticks of rest, and with a pause in their middle."""
        middle = case.base[:half]
        return (case.base[:1].still(ticks) + middle + middle.still(pause) + case.base[half:])[: case.limit + 1]

    @functools.cache
    def reached(waits: tuple[int, int]) -> int | None:
        done = simulate_actions(
            case.simulator, case.attempt, case.actions(waiting(*waits)), EpisodeRules(EndRule.SUCCESS)
        )
        return done.result.end.tick if done.result and done.outcome.success else None

    # After a wait, in which objects settle further, the goal may be reached a little sooner or later.
    about = case.limit - by_repeat(case, case.padded(case.base), "success", tmp_path).tick
    waits = [(about + more - pause, pause) for pause in range(4) for more in range(-3, 4)]
    just = next(each for each in waits if reached(each) == case.limit)
    late = next(each for each in waits if reached(each) == case.limit + 1)
    in_time = same_everywhere(case, waiting(*just)[: case.limit], "success", tmp_path)
    assert in_time == Verdict(True, case.limit)
    too_late = same_everywhere(case, waiting(*late)[: case.limit], "success", tmp_path, but=("teleop",))
    assert too_late == Verdict(False, case.limit)
