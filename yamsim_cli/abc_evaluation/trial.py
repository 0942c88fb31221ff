"""Trials of a policy at `put_bottles`, with the observations and answers of all policies of yamsim."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.attempt_data import AttemptJob
from ..core.closable import Closable
from ..core.errors import UsageError
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array, yaw
from ..core.images.image import Image
from ..core.workers.job_server import kill_forks_at_exit
from ..policies.action_chunks import ChunkScheduler, ChunkSettings, ChunkStats
from ..policies.evaluate.observation import LazyObservation, ObservationRenderer, select_cameras
from ..policies.evaluate.policy_calls import PolicyCaller, output_on_stderr
from ..policies.evaluate.policy_choice import PolicyChoice
from ..policies.evaluate.policy_factory import ExpertPolicy, PrivilegedPolicy, make_policy
from ..policies.evaluate.policy_trial import NO_FAULT, POLICY_ERRORS, TrialEnd, describe_policy_error
from ..policies.external_policy import PolicyScene
from ..policies.policy_faults import PolicyFault
from ..policies.policy_loading import reset_policy, wanted_images, wanted_state
from ..policies.policy_protocol import OBJECTS, SCENE, VELOCITIES, WRIST, Policy, read_chunk
from .environment import ACTION_SECONDS, BIN, BOTTLES, GRIPPER_OPENING, POLICY_HZ, SIDES, PutBottles
from .expert import BottlesExpert

RIG = "abc_put_bottles"  # name in reports: ABC's own model of two YAM arms
PROMPT = "sim put the plastic bottles in the bin"  # Source: amazon-far/abc e5e1fbc, `SimEvalConfig` of config.py

# ABC's loop executes 15 actions of each of 120 chunks. Source: as above.
EXECUTED_ACTIONS = 15
MAX_ACTIONS = 1800

_TOP = "top"
# Requested image -> {key of an observation: camera of the model}.
_CAMERAS = {
    _TOP: {"top_rgb": "top"},
    SCENE: {"scene_rgb": "top"},
    **{f"{side}_{WRIST}": {f"{side}_wrist_rgb": side} for side in SIDES},
    WRIST: {f"{side}_wrist_rgb": side for side in SIDES},
}
STATION = PolicyScene(
    RIG,
    SIDES,
    7,
    (GRIPPER_OPENING,) * len(SIDES),
    {name: next(iter(keys)) for name, keys in _CAMERAS.items() if len(keys) == 1},
    {name: f"T_{name}_in_world" for name in (*BOTTLES, BIN)},
)


@dataclass(frozen=True)
class BottlesResult:
    """Result of a trial.

    Attributes:
        start_seed: seed of the start: that of the evaluation plus the trial's number, as in ABC's evaluation.
        seconds: duration of each inference, s.
        in_bin: bottles in the bin at the end.
        most_in_bin: largest number of bottles that were in the bin at the same time.
        places: object -> position (x, y), m, and heading, rad, at the start.
    """

    job: AttemptJob
    start_seed: int
    success: bool
    ended: TrialEnd
    fault: PolicyFault = NO_FAULT
    actions: int = 0
    seconds: tuple[float, ...] = ()
    in_bin: tuple[str, ...] = ()
    most_in_bin: int = 0
    places: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    chunk_stats: ChunkStats = field(default_factory=ChunkStats)
    chunking: ChunkSettings | None = None


def max_actions(choice: PolicyChoice) -> int:
    """Return the largest number of actions in a trial: from the choice's time limit, or else ABC's."""
    return MAX_ACTIONS if choice.time_limit is None else max(1, round(choice.time_limit / ACTION_SECONDS))


class BottlesTrialRunner(Closable):
    """Runs trials of one policy. The caller must close the runner.

    Args:
        folder: ABC's model files.
        size: width and height of images, px.

    Raises:
        UsageError, ResourceError: the policy does not exist, cannot be loaded, or does not fit ABC's arms.
    """

    def __init__(self, folder: Path, choice: PolicyChoice, size: tuple[int, int], locations: Locations) -> None:
        self._folder, self._choice, self._size = folder, choice, size
        with output_on_stderr(), kill_forks_at_exit():
            made = make_policy(choice, STATION, locations)
        self._policy: Policy = BottlesExpert() if isinstance(made, ExpertPolicy) else made
        self._caller = PolicyCaller(choice.call_seconds, choice.folder)
        try:
            if isinstance(self._policy, PrivilegedPolicy):
                raise UsageError(
                    f"--policy {choice.name}: no dataset of put_bottles exists, so its actions cannot be replayed; "
                    "give another --policy"
                )
            self._cameras = select_cameras(wanted_images(self._policy), _CAMERAS, "put_bottles")
            self._wanted = frozenset(wanted_state(self._policy))
            execute = choice.chunking.execute or getattr(self._policy, "execute", None) or EXECUTED_ACTIONS
            self._chunking = replace(choice.chunking, execute=execute, lead=getattr(self._policy, "lead", None))
        except BaseException:
            self.close()  # a connection that stays open would keep the process alive
            raise

    def run(self, job: AttemptJob) -> BottlesResult:
        """Run one trial, which ends when all bottles were in the bin at the same time, or at the time limit."""
        seed = job.seed + job.attempt
        seconds: list[float] = []
        hold = int(getattr(self._policy, "ticks", 1))
        with PutBottles(self._folder, seed, self._size) as scene:
            places = {name: (float(T[0, 3]), float(T[1, 3]), yaw(T)) for name, T in scene.object_poses().items()}
            scheduler = ChunkScheduler(self._chunking, 1 / POLICY_HZ, hold, scene.joints)
            renderer = ObservationRenderer(lambda qpos, camera: self._render(scene, qpos, camera))
            if isinstance(self._policy, BottlesExpert):
                self._policy.set_scene(scene)
            try:
                ended, fault = self._drive(scene, scheduler, renderer, seed, seconds)
            finally:
                renderer.finish()
            return BottlesResult(
                job,
                seed,
                scene.has_succeeded and fault is NO_FAULT,
                ended,
                fault,
                scene.actions,
                tuple(seconds),
                tuple(name for name, inside in zip(BOTTLES, scene.in_bin(), strict=True) if inside),
                scene.most_in_bin,
                places,
                scheduler.chunk_stats,
                self._chunking,
            )

    def close(self) -> None:
        """Close the policy."""
        self._caller.close(self._policy)

    def _drive(
        self,
        scene: PutBottles,
        scheduler: ChunkScheduler,
        renderer: ObservationRenderer,
        seed: int,
        seconds: list[float],
    ) -> tuple[TrialEnd, PolicyFault]:
        limit = max_actions(self._choice)
        try:
            self._caller.call(lambda: reset_policy(self._policy, seed % 2**32))
            while not scene.has_succeeded and scene.actions < limit:
                if scheduler.last_chunk_is_over(scene.actions):
                    return TrialEnd.DONE, NO_FAULT
                if scheduler.is_due(scene.actions):
                    answer = self._caller.request(self._policy, self._observe(scene, renderer), renderer)
                    seconds.append(self._caller.seconds)
                    chunk = read_chunk(answer, *scene.joints.shape)
                    scheduler.add_chunk(chunk, scene.actions, self._caller.seconds)
                command, _ = scheduler.command_at(scene.actions)
                scene.step(command)
                if scene.failure is not None:
                    return TrialEnd.UNSTABLE, NO_FAULT
        except POLICY_ERRORS as error:
            return describe_policy_error(error, self._choice.call_seconds, scene.actions)
        return (TrialEnd.SUCCESS if scene.has_succeeded else TrialEnd.TIME_LIMIT), NO_FAULT

    def _render(self, scene: PutBottles, qpos: Array, camera: str) -> Image:
        with self._caller.paused_limit():
            return scene.render(qpos, camera)

    def _observe(self, scene: PutBottles, renderer: ObservationRenderer) -> LazyObservation:
        joints = scene.joints.copy()
        # ABC's policies see shares of the opening from 0 to 1; a finger may be pressed beyond its ends.
        joints[:, -1] = np.clip(joints[:, -1], 0.0, GRIPPER_OPENING)
        numbers: dict[str, Any] = {
            "joints": joints.ravel(),
            "gripper": joints[:, -1],
            "ee_pose_world": scene.hand_poses(),
            "K_scene": scene.intrinsics(_TOP).K,
            "T_cam_in_world": scene.camera_pose(_TOP),
            "time": scene.actions * ACTION_SECONDS,
            "prompt": PROMPT,
        }
        if OBJECTS in self._wanted:
            numbers |= {STATION.things[name]: T for name, T in scene.object_poses().items()}
        if VELOCITIES in self._wanted:
            numbers["joint_velocities"] = scene.joint_velocities.ravel()
        return LazyObservation(numbers, scene.data.qpos.copy(), self._cameras, renderer)
