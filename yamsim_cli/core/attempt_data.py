"""Immutable results that sampling, simulation and storage of an attempt exchange; none contains MuJoCo objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .config.goals.measure import GoalMeasure
from .config.goals.role_assignment import RoleAssignment
from .config.variation import Variation
from .geometry.se3 import Array, pose_from_quat, quat_from_rotation

# Recorded pose of an object in `world`: x, y, z in m, and a unit quaternion w, x, y, z.
FullPose = tuple[float, float, float, float, float, float, float]

# Whether the weld between hand and grasped object is active: (ticks, arms), or (arms,) for one tick; left arm first.
WeldStates = NDArray[np.bool_]


@dataclass(frozen=True)
class Layout:
    """The initial poses of all objects in an episode.

    Attributes:
        T_in_world: object name -> pose (4, 4) in `world`.
    """

    T_in_world: Mapping[str, Array]

    @classmethod
    def from_places(cls, places: Mapping[str, FullPose]) -> Layout:
        """Return the layout for recorded poses."""
        return cls({name: pose_from_quat(place[:3], place[3:]) for name, place in places.items()})

    @property
    def places(self) -> dict[str, FullPose]:
        """Object name -> its recorded pose."""
        return {name: _place(T) for name, T in self.T_in_world.items()}


def _place(T: Array) -> FullPose:
    x, y, z, qw, qx, qy, qz = (float(part) for part in (*T[:3, 3], *quat_from_rotation(T[:3, :3])))
    return x, y, z, qw, qx, qy, qz


@dataclass(frozen=True)
class ArmPosture:
    """Joint positions (dof,) of an arm in rad, and the distance of one finger from its closed position in m."""

    joints: Array
    opening: float


@dataclass(frozen=True)
class JointPath:
    """A path of one arm in joint space, for n control ticks.

    Attributes:
        joints: reference positions (n + 1, dof) at the ticks' boundaries, rad; the first row is the arm's start.
        torques: torques (n, dof) that the motion needs in the middle of each tick, N m.
        gripper: distance (n,) of one finger from its closed position, m.
        grip_force: closing force (n,) of each finger, N.
        weld_on: (n,) of bool, whether a weld constraint fixes the object to the hand during each tick.
        tick: length of a tick, s.
    """

    joints: Array
    torques: Array
    gripper: Array
    grip_force: Array
    weld_on: tuple[bool, ...]
    tick: float

    @property
    def velocities(self) -> Array:
        """Mean joint velocities (n, dof) during each tick, rad/s."""
        change: Array = self.joints[1:] - self.joints[:-1]
        return change / self.tick


@dataclass(frozen=True)
class ActionSequence:
    """All commands during n control ticks. The same actions from the same start give the same states.

    Attributes:
        ctrl: drive commands (n, nu) during each tick, rad and m, in MuJoCo's order.
        magnet: (n, arms), whether each arm's weld constraint on its grasped object is active during each tick.
        joints: planned joints and finger opening of each arm (n, arms, drives) at the end of each tick, rad and m.
            The simulation does not use them.
    """

    ctrl: Array
    magnet: WeldStates
    joints: Array


@dataclass(frozen=True)
class StepState:
    """The simulation state at a recorded frame, and the actions until the next frame.

    Attributes:
        time: simulated time, s.
        qpos: MuJoCo's positions (nq,) before the frame's first command.
        actions: the actions of the ticks until the next frame.
        encoder_readings: delayed positions (arms, drives) that the encoders report now, rad and m; None without a
            sensor delay.
    """

    time: float
    qpos: Array
    actions: ActionSequence
    encoder_readings: Array | None = None


class FailureCause(StrEnum):
    """Why an attempt failed. `WORKER_LOST` has no cause in the task: the worker process died or hung."""

    NO_LAYOUT = "no_layout"
    UNREACHABLE = "unreachable"
    KNOCKED = "knocked"
    SLIPPED = "slipped"
    DROPPED = "dropped"
    COLLIDED = "collided"
    LIMITS = "limits"
    OFF_TARGET = "off_target"
    UNSTABLE = "unstable"
    GOAL = "goal"
    TIME = "time"
    WORKER_LOST = "worker_lost"


@dataclass(frozen=True)
class MotionMargins:
    """How close a simulated motion came to the limits of arm and grasp: the worst values over all joints and times.

    Attributes:
        velocity: largest speed of a joint, as a share of its motor's no-load speed.
        torque: largest torque of a drive, as a share of the drive's limit.
        joint: smallest distance of a joint from its nearer joint limit, rad; negative beyond the limit.
        slip: largest distance that a held object moved in the hand, m; None if not measured.
        tilt: largest rotation of a held object's vertical axis since its grasp, rad; None if not measured.
    """

    velocity: float
    torque: float
    joint: float
    slip: float | None
    tilt: float | None


@dataclass(frozen=True)
class Recovery:
    """A skill that failed and was tried again.

    Attributes:
        step: number of the skill in the executed program.
        skill: name of the skill.
        detail: why the skill failed, as text.
        frame: the first recorded frame of the new try.
    """

    step: int
    skill: str
    detail: str
    frame: int


@dataclass(frozen=True)
class Outcome:
    """The result of an attempt in numbers, so that other thresholds can be applied later.

    Attributes:
        success: whether the attempt succeeded by the task's own threshold.
        cause: why the attempt failed; None on success.
        detail: the figures behind the cause, as text.
        dxy: horizontal distance of the object from the target's centre at the end, m; None if never simulated.
        dz: height of the object's origin above the target's, m; None if never simulated.
        speed: speed of the object at the end, m/s; None if never simulated.
        margins: margins of the motion; None if never simulated.
        measures: by how much each condition of the goal holds or fails; empty for a task without a goal.
        recoveries: skills that failed during the attempt and were tried again.
    """

    success: bool
    cause: FailureCause | None = None
    detail: str = ""
    dxy: float | None = None
    dz: float | None = None
    speed: float | None = None
    margins: MotionMargins | None = None
    measures: tuple[GoalMeasure, ...] = ()
    recoveries: tuple[Recovery, ...] = ()


@dataclass(frozen=True)
class AttemptJob:
    """The seed and the number of an attempt, which determine everything random in the attempt."""

    seed: int
    attempt: int


@dataclass(frozen=True, eq=False)
class Attempt:
    """The random samples of one attempt. These and the commands to the drives determine its whole simulation.

    Attributes:
        job: seed and number of the attempt.
        layout: initial poses of the objects; None if the sampling found no free poses.
        variation: samples of the domain randomization.
        start: MuJoCo's `qpos` (nq,) at the start, with arms and objects at rest; None without a layout.
        roles: which objects have which roles of the task; None for a task without roles.
        phrasing: the sampled instruction; empty if the task's default instruction applies.
    """

    job: AttemptJob
    layout: Layout | None = None
    variation: Variation = field(default_factory=Variation)
    start: Array | None = None
    roles: RoleAssignment | None = None
    phrasing: str = ""

    @property
    def places(self) -> dict[str, FullPose]:
        """Object name -> its initial pose in `world`; empty without a layout."""
        return {} if self.layout is None else self.layout.places


@dataclass(frozen=True)
class AttemptPayload:
    """The result and the files that a worker process returns for one attempt.

    Attributes:
        attempt: the samples of the attempt.
        outcome: the result of the attempt.
        files: relative POSIX path -> content of each file of the episode except `episode.json`; empty after a failure.
        frames: number of frames in `files`.
        content_sha256: SHA-256 of the episode's decoded numbers (no images); independent of the pickle format.
        versions: package -> version in the worker, for each package that affects the bytes of `files`.
        renderer: the OpenGL implementation that rendered the images; empty without images.
    """

    attempt: Attempt
    outcome: Outcome
    files: Mapping[str, bytes] = field(default_factory=dict)
    frames: int = 0
    content_sha256: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    renderer: str = ""

    @property
    def job(self) -> AttemptJob:
        """Seed and number of the attempt."""
        return self.attempt.job
