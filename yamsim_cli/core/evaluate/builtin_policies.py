"""Policies that come with yamsim: a task's expert, standing still, and a dataset's actions."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..attempt.engine import Simulated, demonstrate
from ..attempt.simulator import Simulator
from ..dataset.layout import episode_directories
from ..dataset.lowdim import recorded_actions
from ..dataset.reader import open_episode
from ..errors import UsageError
from ..geometry.se3 import Array
from ..policies.base import Observation, Policy
from ..policies.loading import ELSEWHERE, FORMS, check_policy, is_elsewhere, load_policy, takes_keywords
from ..policies.remote import RemotePolicy
from ..scene.compiled import CompiledScene
from ..session import Session
from ..types import Attempt, EpisodeJob, Holds
from .choice import PolicyChoice
from .elsewhere import make_elsewhere


class Trial:
    """What only a privileged policy is told; what it does not ask for is not made.

    Attributes:
        attempt: as it was sampled.
        scene: in which it is made.
    """

    def __init__(self, simulator: Simulator, attempt: Attempt) -> None:
        self._simulator = simulator
        self.attempt = attempt
        self.scene = simulator.scene

    @functools.cached_property
    def demonstrated(self) -> Simulated:
        """What the task's expert makes of the attempt."""
        return demonstrate(self._simulator, self.attempt)


@runtime_checkable
class Privileged(Protocol):
    """A policy that is told what a robot cannot see."""

    def begin(self, trial: Trial) -> Array | None:
        """Prepare for a trial, ahead of `reset`.

        Returns:
            MuJoCo's positions (nq,) at which the trial is to begin; None for those that were sampled.
        """
        ...


class _Playback:
    """Answers with actions that are known beforehand, tick by tick, whatever it sees."""

    images = ()

    def __init__(self) -> None:
        self._ctrl: Array = np.zeros((0, 0))
        self._magnet: Holds = np.zeros((0, 0), bool)
        self._tick = 0

    def _play(self, ctrl: Array, magnet: Holds, scene: CompiledScene) -> None:
        """Answer with these, of MuJoCo's drives (ticks, nu) and each arm's weld (ticks, arms), from now on."""
        self._ctrl, self._magnet = ctrl[:, scene.drives.ravel()], magnet

    def reset(self) -> None:
        self._tick = 0

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        tick, self._tick = self._tick, self._tick + 1
        return {"ctrl": self._ctrl[tick], "magnet": self._magnet[tick], "done": tick + 1 == len(self._ctrl)}


class Scripted(_Playback):
    """Does what a task's expert does in `trials` and `record`: it knows where everything is."""

    def begin(self, trial: Trial) -> Array | None:
        """Take over the expert's actions, and its start."""
        states = trial.demonstrated.states
        ctrl = np.concatenate([state.actions.ctrl for state in states])
        self._play(ctrl, np.concatenate([state.actions.magnet for state in states]), trial.scene)
        return trial.demonstrated.attempt.start


class HoldStill:
    """Stays where it is."""

    images = ()

    def __init__(self) -> None:
        self._ctrl: Any = None

    def reset(self) -> None:
        """Stay where the next observation finds it."""
        self._ctrl = None

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """The joints of the first observation."""
        self._ctrl = observation["joints"] if self._ctrl is None else self._ctrl
        return {"ctrl": self._ctrl}


class Replay(_Playback):
    """Repeats a dataset's actions: those of the trial's own seed and number, or else of another episode, blindly.

    Raises:
        UsageError: there are no episodes.
        DatasetError: one is damaged, or of another scene.
    """

    def __init__(self, dataset: Path) -> None:
        super().__init__()
        directories = episode_directories(dataset) if dataset.is_dir() else []
        if not directories:
            raise UsageError(f"--policy replay:{dataset}: there are no episodes; give a dataset of yamsim record")
        self._episodes = [open_episode(directory) for _, directory in directories]
        self._by_job = {EpisodeJob(episode.record.seed, episode.record.attempt): episode for episode in self._episodes}

    def begin(self, trial: Trial) -> Array | None:
        """Read the trial's episode, which begins where it was recorded."""
        job = trial.attempt.job
        other = self._episodes[job.attempt % len(self._episodes)]
        episode = self._by_job.get(job, other)
        found = recorded_actions(episode.frames(), trial.scene.model.nq, trial.scene.model.nu)
        if found is None:
            raise UsageError(f"{episode.directory} holds no sim_ctrl, so its actions cannot be replayed")
        start, actions = found
        self._play(actions.ctrl, actions.magnet, trial.scene)
        return start if job in self._by_job else None


def make_policy(choice: PolicyChoice, session: Session) -> Policy:
    """The policy that a name says.

    Args:
        choice: its folder is where the user's modules, files and datasets are looked for.

    Raises:
        ConfigError: the config of a policy from elsewhere is not valid.
        UsageError: there is no such policy, or it cannot be loaded, or does not fit the rig.
        ResourceError: nobody answers at its address, or a package is missing.
    """
    name, folder = choice.name, choice.folder
    kind, colon, rest = name.partition(":")
    elsewhere = is_elsewhere(name)
    if choice.mapping is not None and not elsewhere:
        raise UsageError(f"--policy-config is for policies of other programs: {', '.join(ELSEWHERE)}")
    if choice.arguments and not takes_keywords(name):
        raise UsageError(f"--policy-arg is for a policy of your own, module:Class or file.py:Class, and not for {name}")
    if elsewhere:
        return make_elsewhere(choice, session)
    if name == "scripted":
        return Scripted()
    if name == "hold_still":
        return HoldStill()
    if kind == "replay" and colon:
        return Replay(folder / rest)
    if kind in ("http", "https"):
        remote: Any = RemotePolicy(name, choice.call_seconds)
        return check_policy(remote, name)
    return load_policy(name, folder, FORMS, choice.arguments, known_only=choice.known_only)
