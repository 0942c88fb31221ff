"""What the stages of a recording hand to each other: plain frozen data, no simulator types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from .geometry.se3 import Array
from .randomized import Randomized

# Whether the weld holds; of two arms, whether each one's does, the left one's first.
Holds = bool | tuple[bool, ...]


@dataclass(frozen=True)
class Layout:
    """Where the objects stand at the start of an episode.

    Attributes:
        T_in_world: object name -> pose (4, 4) in `world`.
    """

    T_in_world: Mapping[str, Array]


@dataclass(frozen=True)
class Waypoint:
    """One pose the plan passes through.

    Attributes:
        name: for messages and figures.
        T_object_in_world: where the grasped object is, or would be were it already held, (4, 4).
        ticks: control ticks on the way to this waypoint.
        stop: whether the motion comes to rest here.
        gripper: opening of one finger there, m.
        grip: how hard each finger presses there, N.
        fingers_from: part of the way (0..1) after which the fingers begin to move.
    """

    name: str
    T_object_in_world: Array
    ticks: int
    stop: bool
    gripper: float
    grip: float = 0.0
    fingers_from: float = 0.0


@dataclass(frozen=True)
class Phases:
    """When, in control ticks, an arm has the object in hand.

    Attributes:
        reached: the first tick by which the hand must not have moved the object.
        held: the ticks during which the object is to move with the hand.
        arm: which arm's hand: 0 of a lone arm or of the left one, 1 of the right one.
    """

    reached: int
    held: range
    arm: int = 0


@dataclass(frozen=True)
class Plan:
    """What the hand is to do, in terms of the object it holds.

    Every waypoint is a pose of the object's frame as held, before the grasp too: so "over the plate's centre" means the
    object and not the gripper.

    Attributes:
        object: name of the object to carry.
        T_object_in_pinch: the object's pose (4, 4) in the pinch frame between the fingers once it is held.
        waypoints: in order.
        grasp, release: indices of the waypoints at which the hand takes the object and lets go of it.
        weld: whether a weld holds the object, or friction alone.
        phases: when it is held.
        settle_ticks: control ticks after the last waypoint, in which the arm goes back to where it started.
    """

    object: str
    T_object_in_pinch: Array
    waypoints: tuple[Waypoint, ...]
    grasp: int
    release: int
    weld: bool
    phases: Phases
    settle_ticks: int


@dataclass(frozen=True)
class JointPath:
    """A plan in joint space, for n control ticks.

    Attributes:
        joints: reference positions (n + 1, 6) at the ticks' boundaries, rad; the first row is where the arm starts.
        torques: what moving so takes (n, 6), in the middle of each tick, N m.
        gripper: opening (n,) of one finger, m.
        grip: how hard each finger presses (n,), N.
        magnet: whether the weld holds during each tick, (n,) of bool.
        tick: length of a tick, s.
        position_error: largest distance in metres between the planned and the reached object position at a waypoint.
        tilt: largest angle in radians of the gripper from straight down at the grasp and the release.
    """

    joints: Array
    torques: Array
    gripper: Array
    grip: Array
    magnet: tuple[bool, ...]
    tick: float
    position_error: float
    tilt: float

    @property
    def velocities(self) -> Array:
        """Mean joint velocities (n, 6) during each tick, rad/s."""
        change: Array = self.joints[1:] - self.joints[:-1]
        return change / self.tick


@dataclass(frozen=True)
class Actions:
    """All that acts on the scene during n control ticks: from the same start, the same actions give the same states.

    Attributes:
        ctrl: what the drives are told during each tick (n, nu), rad and m.
        magnet: whether the weld holds during each tick, n of them.
        joints: the six joints and the finger opening of each arm (n, 7 or 14), the left one first, that the plan asks
            for at the end of each tick, rad and m. Nothing in physics depends on them.
    """

    ctrl: Array
    magnet: tuple[Holds, ...]
    joints: Array


@dataclass(frozen=True)
class StepState:
    """The simulation at a recorded frame, and what acts from there until the next one.

    Attributes:
        time: simulated time, s.
        qpos: MuJoCo's positions (nq,), before the frame's first command acts.
        actions: of the ticks until the next frame.
    """

    time: float
    qpos: Array
    actions: Actions


class Cause(StrEnum):
    """Why an attempt failed. `WORKER_LOST` is the one that the machine can have a part in, and never the task."""

    NO_LAYOUT = "no_layout"
    UNREACHABLE = "unreachable"
    KNOCKED = "knocked"
    SLIPPED = "slipped"
    DROPPED = "dropped"
    COLLIDED = "collided"
    LIMITS = "limits"
    OFF_TARGET = "off_target"
    UNSTABLE = "unstable"
    WORKER_LOST = "worker_lost"


@dataclass(frozen=True)
class Margins:
    """How near an attempt's motion came to what the arm can do, as simulated: the worst of all joints and all time.

    Attributes:
        velocity: of a joint, as a share of its motor's no-load speed.
        torque: of a drive, as a share of the most that it gives.
        joint: distance of a joint from its nearer stop, rad; negative beyond it.
        slip: how far the object moved in the hand while it was held, m.
        tilt: of the object while it was held, against how it lay, rad.
    """

    velocity: float
    torque: float
    joint: float
    slip: float
    tilt: float


@dataclass(frozen=True)
class Motion:
    """What was seen of an attempt's motion.

    Attributes:
        margins: how near it came to what the arm can do.
        lost: when the fingers first did not both touch the object that they were to hold, s; None if they always did.
        collision: what touched what it must not, and when; None if nothing did.
        breakdown: what broke physics, and when; None if nothing did.
    """

    margins: Margins
    lost: float | None
    collision: str | None
    breakdown: str | None = None


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended, in numbers, so that any other threshold can be applied later.

    Attributes:
        success: against the threshold of the task.
        cause: why not; None on success.
        detail: the figures behind the cause, for a person.
        dxy: horizontal distance of the object from the target's centre at the end, m; None if never simulated.
        dz: height of the object's origin above the target's, m; None if never simulated.
        speed: speed of the object at the end, m/s; None if never simulated.
        position_error, tilt: of the plan's inverse kinematics, m and rad; None if there is no plan.
        margins: of the motion; None if never simulated.
    """

    success: bool
    cause: Cause | None = None
    detail: str = ""
    dxy: float | None = None
    dz: float | None = None
    speed: float | None = None
    position_error: float | None = None
    tilt: float | None = None
    margins: Margins | None = None


@dataclass(frozen=True)
class EpisodeJob:
    """What a worker is told: everything random in the attempt follows from these two numbers."""

    seed: int
    attempt: int


@dataclass(frozen=True)
class EpisodePayload:
    """What a worker gives back for one attempt.

    Attributes:
        job: the attempt.
        outcome: how it ended.
        layout: object name -> start pose `[x, y, z, yaw]` in `world`, m and rad; empty without a layout.
        files: relative POSIX path -> content of the episode, without `episode.json`; empty unless it succeeded.
        frames: how many frames `files` holds.
        content_sha256: hash of the decoded lowdim values, which outlives changes of the pickle format.
        versions: of what the bytes depend on, where they were made.
        renderer: the OpenGL implementation that drew the images; empty without images.
        randomized: what was drawn beside the layout.
    """

    job: EpisodeJob
    outcome: Outcome
    layout: Mapping[str, tuple[float, float, float, float]]
    files: Mapping[str, bytes] = field(default_factory=dict)
    frames: int = 0
    content_sha256: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    renderer: str = ""
    randomized: Randomized = field(default_factory=Randomized)
