"""What the stages of a recording hand to each other: plain frozen data, no simulator types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .config.goals.measure import GoalMeasure
from .config.goals.role_assignment import RoleAssignment
from .config.variation import Variation
from .geometry.se3 import Array, UprightPose, pose, pose_from_quat, quat_from_rotation, rotation_z, yaw

# A pose as records hold it where things need not stand upright: x, y, z in m, and a unit quaternion w, x, y, z.
FullPose = tuple[float, float, float, float, float, float, float]

# Whether each arm's weld holds, on each of some ticks: (ticks, arms) or (arms,), the left arm's first.
WeldStates = NDArray[np.bool_]


@dataclass(frozen=True)
class Layout:
    """Where the objects stand at the start of an episode.

    Attributes:
        T_in_world: object name -> pose (4, 4) in `world`.
        upright: whether all of them stand upright, so that records need but their headings.
    """

    T_in_world: Mapping[str, Array]
    upright: bool = True

    @classmethod
    def from_places(cls, places: Mapping[str, UprightPose | FullPose]) -> Layout:
        """From what `places` gave."""
        return cls({name: _pose(place) for name, place in places.items()}, all(len(p) == 4 for p in places.values()))

    @property
    def places(self) -> dict[str, UprightPose | FullPose]:
        """Object name -> where it is, in `world`, as records hold it."""
        return {name: self._place(T) for name, T in self.T_in_world.items()}

    def _place(self, T: Array) -> UprightPose | FullPose:
        x, y, z = (float(part) for part in T[:3, 3])
        if self.upright:
            return x, y, z, yaw(T)
        qw, qx, qy, qz = (float(part) for part in quat_from_rotation(T[:3, :3]))
        return x, y, z, qw, qx, qy, qz


def _pose(place: UprightPose | FullPose) -> Array:
    return pose(place[:3], rotation_z(place[3])) if len(place) == 4 else pose_from_quat(place[:3], place[3:])


@dataclass(frozen=True)
class ArmPosture:
    """Where an arm stands: its joints (dof,) in rad, and the opening of one finger in m."""

    joints: Array
    opening: float


@dataclass(frozen=True)
class JointPath:
    """A path of one arm in joint space, for n control ticks.

    Attributes:
        joints: reference positions (n + 1, dof) at the ticks' boundaries, rad; the first row is where the arm starts.
        torques: the torques (n, dof) that this motion takes, in the middle of each tick, N m.
        gripper: opening (n,) of one finger, m.
        grip_force: how hard each finger presses (n,), N.
        weld_on: whether the weld holds during each tick, (n,) of bool.
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
    """All that acts on the scene during n control ticks. The same actions from the same start give the same states.

    Attributes:
        ctrl: what the drives are told during each tick (n, nu), rad and m, in MuJoCo's order.
        magnet: whether each arm's weld holds during each tick (n, arms).
        joints: the joints and the finger opening of each arm (n, arms, drives) that the plan asks for at the end of
            each tick, rad and m. Nothing in physics depends on them.
    """

    ctrl: Array
    magnet: WeldStates
    joints: Array


@dataclass(frozen=True)
class StepState:
    """The simulation at a recorded frame, and what acts from there until the next one.

    Attributes:
        time: simulated time, s.
        qpos: MuJoCo's positions (nq,), before the frame's first command acts.
        actions: of the ticks until the next frame.
        sensed: where the joints and fingers (arms, drives) were when what is read now was measured; None where encoders
            read at once.
    """

    time: float
    qpos: Array
    actions: ActionSequence
    sensed: Array | None = None


class FailureCause(StrEnum):
    """Why an attempt failed. `WORKER_LOST` alone is never the task's doing: the worker died, or hung."""

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
    """How near an attempt's simulated motion came to what the arm can do: the worst over all joints and all times.

    Attributes:
        velocity: largest speed of a joint, as a share of its motor's no-load speed.
        torque: largest torque of a drive, as a share of the most that it gives.
        joint: smallest distance of a joint from its nearer stop, rad; negative beyond it.
        slip: largest distance that a thing moved in a hand that held it, m; None if that was not measured.
        tilt: largest angle between a thing's vertical axis when it was taken and while it was held, rad; likewise.
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
        step: its number in the program as run.
        skill: its name.
        detail: what had gone wrong.
        frame: the first recorded frame of the new try.
    """

    step: int
    skill: str
    detail: str
    frame: int


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended, in numbers, so that any other threshold can be applied later.

    Attributes:
        success: whether it succeeded by the task's own threshold.
        cause: why it failed; None on success.
        detail: the figures behind the cause, as text for a person.
        dxy: horizontal distance of the object from the target's centre at the end, m; None if never simulated.
        dz: height of the object's origin above the target's, m; None if never simulated.
        speed: speed of the object at the end, m/s; None if never simulated.
        margins: of the motion; None if never simulated.
        measures: of everything that a goal asks for; none where a task has no goal of its own.
        recoveries: of a program: what had to be tried again.
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
    """What a worker is asked for: an attempt, in which everything random follows from these two numbers."""

    seed: int
    attempt: int


@dataclass(frozen=True, eq=False)
class Attempt:
    """What was sampled for one attempt. What happens in it follows from this value and from what acts.

    Attributes:
        job: its numbers.
        layout: where things stand; None where there was no room for them.
        variation: what differs from other attempts beside the layout.
        start: MuJoCo's positions (nq,) at the beginning, when everything is at rest; None without a layout.
        roles: who plays which role, in a task that has roles.
        phrasing: what is said to have it done; empty where the task's own prompt is.
    """

    job: AttemptJob
    layout: Layout | None = None
    variation: Variation = field(default_factory=Variation)
    start: Array | None = None
    roles: RoleAssignment | None = None
    phrasing: str = ""

    @property
    def places(self) -> dict[str, UprightPose | FullPose]:
        """Object name -> where it is at the start, in `world`; empty without a layout."""
        return {} if self.layout is None else self.layout.places


@dataclass(frozen=True)
class AttemptPayload:
    """What a worker gives back for one attempt.

    Attributes:
        attempt: what was sampled for it.
        outcome: how it ended.
        files: relative POSIX path -> content of the episode, without `episode.json`; empty unless it succeeded.
        frames: how many frames `files` holds.
        content_sha256: hash of the decoded lowdim values, so that it does not depend on the pickle format.
        versions: package -> version, of those that the bytes depend on, where they were made.
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
        """The attempt's numbers."""
        return self.attempt.job
