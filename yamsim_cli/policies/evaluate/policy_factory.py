from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from yamsim_cli.core.attempt_data import Attempt, AttemptJob, WeldStates
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.dataset_paths import episode_directories
from yamsim_cli.core.dataset.environment_state import object_pose_keys
from yamsim_cli.core.dataset.lowdim import recorded_actions
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.episode.execution import SimulatedAttempt, simulate_expert
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compiled import CompiledScene

from .. import act, lerobot, openpi
from ..external_policy import MappedPolicy, PolicyClient, PolicyScene
from ..policy_loading import EXTERNAL_FORMS, POLICY_FORMS, check_policy, is_external, load_policy, takes_keywords
from ..policy_protocol import Observation, Policy
from ..remote_policy import RemotePolicy
from .observation import available_cameras
from .policy_choice import PolicyChoice

# Scheme of a policy's name -> default config in `configs/policies/`, which describes its messages.
_CONFIGS = {act.SCHEME: "molmoact2_yam", openpi.SCHEME: "openpi_aloha", lerobot.SCHEME: "lerobot_export"}


class PrivilegedTrial:
    """The simulator's state of a trial, which only privileged policies see."""

    def __init__(self, simulator: Simulator, attempt: Attempt) -> None:
        self._simulator = simulator
        self.attempt = attempt
        self.scene = simulator.scene

    @functools.cached_property
    def expert_attempt(self) -> SimulatedAttempt:
        """Attempt of the task's scripted expert at this trial, simulated at the first access."""
        return simulate_expert(self._simulator, self.attempt, disturbed=False)


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """A policy that reads the simulator's state."""

    def prepare_trial(self, trial: PrivilegedTrial) -> Array | None:
        """Prepare for a trial, before `reset`. Return MuJoCo's initial positions (nq,), or None for the sampled."""


class _ActionSequencePolicy:
    images = ()

    def __init__(self) -> None:
        self._ctrl: Array = np.zeros((0, 0))
        self._weld_on: WeldStates = np.zeros((0, 0), bool)
        self._tick = 0

    def _set_actions(self, ctrl: Array, magnet: WeldStates, scene: CompiledScene) -> None:
        """Set the commands to MuJoCo's drives (ticks, nu) and to each arm's weld (ticks, arms)."""
        self._ctrl, self._weld_on = ctrl[:, scene.recorded_drive_ctrl.ravel()], magnet

    def reset(self) -> None:
        self._tick = 0

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        tick, self._tick = self._tick, self._tick + 1
        return {"ctrl": self._ctrl[tick], "magnet": self._weld_on[tick], "done": tick + 1 == len(self._ctrl)}


class ExpertPolicy(_ActionSequencePolicy):
    """Repeats the actions of the task's scripted expert, which `yamsim record` records."""

    def prepare_trial(self, trial: PrivilegedTrial) -> Array | None:
        """Set the expert's actions, and return MuJoCo's start positions (nq,), or None."""
        states = trial.expert_attempt.recorded_states
        ctrl = np.concatenate([state.actions.ctrl for state in states])
        self._set_actions(ctrl, np.concatenate([state.actions.magnet for state in states]), trial.scene)
        return trial.expert_attempt.attempt.start


class HoldStillPolicy:
    """Holds the joints of the first observation."""

    images = ()

    def __init__(self) -> None:
        self._ctrl: Any = None

    def reset(self) -> None:
        """Forget the joints, so that the next observation sets them."""
        self._ctrl = None

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Return the joints of the first observation as the command."""
        self._ctrl = observation["joints"] if self._ctrl is None else self._ctrl
        return {"ctrl": self._ctrl}


class ReplayPolicy(_ActionSequencePolicy):
    """Repeats the actions of the dataset's episode with the trial's seed and number, or else of another episode."""

    def __init__(self, dataset: Path) -> None:
        super().__init__()
        directories = episode_directories(dataset) if dataset.is_dir() else []
        if not directories:
            raise UsageError(f"--policy replay:{dataset}: it has no episodes; give a dataset of yamsim record")
        self._episodes = [open_episode(directory) for _, directory in directories]
        self._by_job = {AttemptJob(episode.record.seed, episode.record.attempt): episode for episode in self._episodes}

    def prepare_trial(self, trial: PrivilegedTrial) -> Array | None:
        """Set an episode's actions. Return its initial positions (nq,) if it has the trial's seed and number."""
        job = trial.attempt.job
        other = self._episodes[job.attempt % len(self._episodes)]
        episode = self._by_job.get(job, other)
        found = recorded_actions(episode.frames(), trial.scene.model.nq, trial.scene.model.nu)
        if found is None:
            raise UsageError(f"{episode.directory} holds no sim_ctrl, so its actions cannot be replayed")
        start, actions = found
        self._set_actions(actions.ctrl, actions.magnet, trial.scene)
        return start if job in self._by_job else None


def make_policy(choice: PolicyChoice, station: PolicyScene, locations: Locations) -> Policy:
    """Make the chosen policy: built in, a class of the user, or a client of another program."""
    name, folder = choice.name, choice.folder
    kind, colon, rest = name.partition(":")
    external = is_external(name)
    if choice.mapping is not None and not external:
        raise UsageError(f"--policy-config is for policies of other programs: {', '.join(EXTERNAL_FORMS)}")
    if choice.arguments and not takes_keywords(name):
        raise UsageError(f"--policy-arg is for a policy of your own, module:Class or file.py:Class, and not for {name}")
    if external:
        return _make_external(choice, station, locations)
    if name == "scripted":
        return ExpertPolicy()
    if name == "hold_still":
        return HoldStillPolicy()
    if kind == "replay" and colon:
        return ReplayPolicy(folder / rest)
    if kind in ("http", "https"):
        remote: Any = RemotePolicy(name, choice.call_seconds)
        return check_policy(remote, name)
    return load_policy(
        name, folder, POLICY_FORMS, choice.arguments, ignore_unknown_arguments=choice.ignore_unknown_arguments
    )


def _make_external(choice: PolicyChoice, station: PolicyScene, locations: Locations) -> MappedPolicy:
    kind, _, rest = choice.name.partition(":")
    mapping = load_config(PolicyConfig, "policies", choice.mapping or _CONFIGS[kind], locations)
    chunking = choice.chunking
    if mapping.realtime_chunking is not None and (chunking.execute is not None or chunking.ensemble is not None):
        raise UsageError(
            f"--execute and --ensemble are not for real-time chunking, which --policy-config {mapping.name} asks for: "
            "set execute in its realtime_chunking"
        )
    if kind == lerobot.SCHEME:
        local = choice.folder / rest
        checkpoint = lerobot.LeRobotClient(str(local) if local.is_dir() else rest, mapping)
        return MappedPolicy(checkpoint, mapping, station, checkpoint.input_keys)
    client: PolicyClient
    if kind == act.SCHEME:
        client = act.ActClient(choice.name, choice.call_seconds)
    else:
        client = openpi.OpenpiClient(choice.name, choice.call_seconds)
    return MappedPolicy(client, mapping, station)


def policy_station(config: RecordConfig) -> PolicyScene:
    """Return the arms, cameras and objects on which a policy acts."""
    arms = [config.rig.arms[k] for k in config.rig.recording_order]
    cameras = {name: next(iter(keys)) for name, keys in available_cameras(config).items() if len(keys) == 1}
    return PolicyScene(
        config.rig.name,
        tuple(arm.side for arm in arms),
        len(arms[0].robot.joints) + 1,
        tuple(arm.robot.fingers.full_opening if arm.robot.fingers else 0.0 for arm in arms),
        cameras,
        object_pose_keys(config),
        config.rig.T_base_in_world(config.rig.recording_order[0]),
    )
