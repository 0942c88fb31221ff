"""Immutable values that sampling, simulation and storage of an attempt exchange, without MuJoCo objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .config.goals.measure import GoalMeasure
from .config.goals.role_assignment import RoleAssignment
from .config.variation import RandomizationSample
from .geometry.se3 import Array, pose_from_quat, quat_from_rotation

# Recorded pose of an object in `world`: x, y, z in m, and a unit quaternion w, x, y, z.
FullPose = tuple[float, float, float, float, float, float, float]

# (ticks, arms), or (arms,) for one tick, left arm first: whether the weld between hand and object is active.
WeldStates = NDArray[np.bool_]


@dataclass(frozen=True)
class ObjectLayout:
    """The initial poses of all objects in an episode.

    Attributes:
        T_in_world: object name -> pose (4, 4) in `world`.
    """

    T_in_world: Mapping[str, Array]

    @classmethod
    def from_places(cls, places: Mapping[str, FullPose]) -> ObjectLayout:
        """Return the layout for recorded poses."""
        return cls({name: pose_from_quat(place[:3], place[3:]) for name, place in places.items()})

    @property
    def places(self) -> dict[str, FullPose]:
        """Object name -> its recorded pose."""
        return {name: _full_pose_from_matrix(T) for name, T in self.T_in_world.items()}


def _full_pose_from_matrix(T: Array) -> FullPose:
    x, y, z, qw, qx, qy, qz = (float(part) for part in (*T[:3, 3], *quat_from_rotation(T[:3, :3])))
    return x, y, z, qw, qx, qy, qz


@dataclass(frozen=True)
class ArmPosture:
    """Joints (dof,) in rad, and the opening of each finger in m, 0 if closed."""

    joints: Array
    opening: float


@dataclass(frozen=True)
class JointPath:
    """A path of one arm in joint space, for n control ticks.

    Attributes:
        joints: references (n + 1, dof) at the ticks' boundaries, rad.
        torques: torques (n, dof) that the motion needs, N m.
        gripper: opening (n,) of each finger, m.
        grip_force: closing force (n,) of each finger, N.
        weld_on: whether a weld holds the object (n,).
        tick: s.
    """

    joints: Array
    torques: Array
    gripper: Array
    grip_force: Array
    weld_on: tuple[bool, ...]
    tick: float

    @property
    def velocities(self) -> Array:
        """Mean joint velocities (n, dof) of each tick, rad/s."""
        change: Array = self.joints[1:] - self.joints[:-1]
        return change / self.tick


@dataclass(frozen=True)
class ActionSequence:
    """Commands of n control ticks. The same actions from the same start give the same states.

    Attributes:
        ctrl: drive commands (n, nu), rad and m, in MuJoCo's order.
        magnet: whether each arm's weld is active (n, arms).
        joints: planned joints and finger openings (n, arms, drives), rad and m, for records only.
    """

    ctrl: Array
    magnet: WeldStates
    joints: Array


@dataclass(frozen=True)
class StepState:
    """The state at a recorded frame, and the actions until the next frame.

    Attributes:
        time: s.
        qpos: (nq,), before the frame's first command.
        encoder_readings: delayed positions (arms, drives), rad and m; None without a sensor delay.
        intended: drive commands (nu,) of the first tick before disturbances; None if nothing disturbs them.
    """

    time: float
    qpos: Array
    actions: ActionSequence
    encoder_readings: Array | None = None
    intended: Array | None = None


class FailureCause(StrEnum):
    """Why an attempt failed. `WORKER_LOST` is no failure of the task: the worker process died or hung."""

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
    """The worst values of a motion over all joints and times.

    Attributes:
        velocity: speed of a joint, as a share of its motor's no-load speed.
        torque: torque of a drive, as a share of its limit.
        joint: distance of a joint from its nearer limit, rad; negative beyond the limit.
        slip: motion of a held object in the hand, m; None if not measured.
        tilt: rotation of a held object's vertical axis since its grasp, rad; None if not measured.
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
        step: number of the skill in the program.
        frame: first recorded frame of the new try.
    """

    step: int
    skill: str
    detail: str
    frame: int


@dataclass(frozen=True)
class Outcome:
    """The result of an attempt in numbers, so that other thresholds can be applied later.

    Attributes:
        detail: the figures behind the cause.
        dxy: final horizontal distance of the object from the target's centre, m.
        dz: final height of the object's origin above the target's, m.
        speed: final speed of the object, m/s.
        measures: by how much each condition of the goal holds or fails.
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
    """The seed and the number, which determine everything random in an attempt."""

    seed: int
    attempt: int

    def for_look(self, look: int) -> AttemptJob:
        """Return the job whose random streams vary the appearance in a look; look 0 is the recording's look."""
        return AttemptJob(self.seed + look * 2**63, self.attempt)  # seeds are below 2**63, so no two jobs are equal


@dataclass(frozen=True, eq=False)
class Attempt:
    """The random samples of one attempt. With the drives' commands, they determine its whole simulation.

    Attributes:
        layout: None if the objects have no room.
        start: MuJoCo's `qpos` (nq,) at the start, at rest.
        phrasing: the sampled instruction; empty for the task's default.
    """

    job: AttemptJob
    layout: ObjectLayout | None = None
    variation: RandomizationSample = field(default_factory=RandomizationSample)
    start: Array | None = None
    roles: RoleAssignment | None = None
    phrasing: str = ""

    @property
    def object_places(self) -> dict[str, FullPose]:
        """Object name -> its initial pose in `world`; empty without a layout."""
        return {} if self.layout is None else self.layout.places


@dataclass(frozen=True)
class AttemptPayload:
    """The result and the files that a worker process returns for one attempt.

    Attributes:
        files: relative POSIX path -> content, without `episode.json`; empty after a failure.
        content_sha256: of the episode's decoded numbers, without images.
        versions: package -> version in the worker, for packages that affect the bytes of `files`.
        renderer: the OpenGL implementation; empty without images.
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
        """The seed and the number of the attempt."""
        return self.attempt.job
