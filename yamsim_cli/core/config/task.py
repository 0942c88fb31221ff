"""Tasks: where objects may start, how the arm goes about it, and what counts as success."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from ..documents.base import Config, ConflictError, Name, Reference
from ..documents.units import Distance, HeadingRange, JointAngle, ReachRange, Within
from .things.thing import GraspPoint, ObjectConfig

# The kinds of `TaskConfig`: each has its functions in `core.tasks.kinds`.
PAIR_KINDS = ("pickplace", "handover")

# A height or a distance that cannot be zero, m.
_Height = Annotated[FiniteFloat, Within("m", 1e-3, 1)]


class Sampling(Config):
    """The box in `world` from which both objects' positions are sampled (m), and their headings' ranges (degrees).

    Attributes:
        min_separation: smallest distance between the two origins, m.
        clearance: smallest gap between their outlines seen from above, m.
    """

    x: ReachRange
    y: ReachRange
    object_yaw_deg: HeadingRange
    target_yaw_deg: HeadingRange
    min_separation: Distance
    clearance: Distance

    def moved(self, y: float) -> Sampling:
        """The same box, shifted along world y by `y` metres."""
        return self.model_copy(update={"y": (self.y[0] + y, self.y[1] + y)})


class Heights(Config):
    """Heights (m) of the carried object's origin above where it lies before, or will lie after."""

    approach: _Height
    lift: _Height
    arc: _Height
    release: Distance


class Timing(Config):
    """How a plan is spread over time.

    Attributes:
        ticks_per_waypoint: control ticks from one waypoint to the next.
        grip_ticks: control ticks in which the hand stands still while the fingers close or open, where friction holds
            the object.
        settle_ticks: control ticks after the last waypoint, in which the arm goes back to where it started.
        physics_steps_per_tick, timestep: steps of physics in a control tick, and the length of a step, s. 16 steps of
            2 ms make a tick of 32 ms.
        ticks_per_frame: control ticks from one recorded frame to the next.
    """

    ticks_per_waypoint: int = Field(ge=2, le=1000)
    grip_ticks: int = Field(default=8, ge=1, le=1000)
    settle_ticks: int = Field(ge=0, le=10_000)
    physics_steps_per_tick: int = Field(ge=1, le=1000)
    timestep: Annotated[FiniteFloat, Within("s", 1e-5, 0.01)]
    ticks_per_frame: int = Field(ge=1, le=100)

    @property
    def tick(self) -> float:
        """Length of a control tick, s."""
        return self.physics_steps_per_tick * self.timestep


class Success(Config):
    """When the object counts as on the target, once everything has settled.

    Attributes:
        threshold: largest horizontal distance between the two origins, m.
        max_height: largest height of the object's origin over the target's, m.
        max_speed: largest speed at which the object counts as at rest, m/s.
    """

    threshold: Annotated[FiniteFloat, Field(gt=0), Within("m", 1e-5, 1)]
    max_height: _Height
    max_speed: Annotated[FiniteFloat, Within("m/s", 1e-4, 5)]


class Exchange(Config):
    """How one hand gives the object to another, in the air between two arms.

    Attributes:
        object: name of the object that `points` are given for.
        x: where the exchange takes place along world x, m. Along y it is in the middle between the arms.
        height: height of the object's origin above where it lies on the table, m.
        points: the two places where hands may hold the object; either hand takes either one.
        clear: distance along the object from which the taking hand comes, and to which the giving hand goes, m.
        carry_ticks: control ticks from the lift to the exchange, and from the exchange to the place.
        take_ticks: control ticks in which the taking hand moves in and closes.
        both_ticks: control ticks in which both hold, and the giving hand opens.
    """

    object: Name
    x: Annotated[FiniteFloat, Within("m", -2.5, 2.5)]
    height: _Height
    points: tuple[GraspPoint, GraspPoint]
    clear: _Height
    carry_ticks: int = Field(ge=4, le=1000)
    take_ticks: int = Field(ge=2, le=1000)
    both_ticks: int = Field(ge=2, le=1000)


class TaskConfig(Config):
    """A task with an `object` and a `target`.

    Attributes:
        kind: what is done with them, one of `core.tasks.kinds`. `pickplace` picks `object` up and puts it onto
            `target`. `handover` does the same with two arms, one of which hands it to the other.
        language_task, language_prompt: the task's name and its description in the data. {object}, {target} and the
            target's {preposition} are filled in.
        sampling: where the objects may start, for an arm at the origin. For other arms the box is moved: the object's
            to the arm that picks, the target's to the arm that places.
        start_joints: of the arms that do the task when it starts, rad; if left out, those of their robot model.
        exchange: how the right arm hands the object to the left one; only in tasks of the kind `handover`.
    """

    name: Name
    kind: Name
    object: Annotated[ObjectConfig, Reference("objects")]
    target: Annotated[ObjectConfig, Reference("objects")]
    language_task: str
    language_prompt: str
    sampling: Sampling
    start_joints: tuple[JointAngle, ...] | None = None
    heights: Heights
    timing: Timing
    success: Success
    exchange: Annotated[Exchange | None, Field(exclude_if=lambda exchange: exchange is None)] = None

    @property
    def objects(self) -> tuple[ObjectConfig, ...]:
        """All that is moved, or has something put onto it, in the order in which records name it."""
        return self.object, self.target

    def prompt_by(self, giving: str, taking: str) -> str:
        """The description, where it tells of two arms, with their sides."""
        return self.language_prompt.replace("{giving}", giving).replace("{taking}", taking)

    @field_validator("language_task", "language_prompt")
    @classmethod
    def _filled_in(cls, text: str, info: ValidationInfo) -> str:
        item, target = (info.data.get(key) for key in ("object", "target"))
        if item is None or target is None:
            return text  # They are not valid themselves, and are reported.
        words = {"object": item.name, "target": target.name, "preposition": target.preposition}
        for key, word in words.items():
            # A task's name is one word, while its description may have several.
            said = word.replace("_", " ") if info.field_name == "language_prompt" else word
            text = text.replace(f"{{{key}}}", said)
        return text

    @model_validator(mode="after")
    def _graspable(self) -> TaskConfig:
        for key, item in (("object", self.object), ("target", self.target)):
            if item.cloth is not None:
                raise ConflictError(
                    f"{item.name!r} is cloth, which only a task of the kind 'program' can have; take a stiff thing",
                    (key,),
                )
        if self.object.grasp is None:
            raise ConflictError(f"object {self.object.name!r} has no `grasp`, so it cannot be picked up", ("object",))
        if self.object.name == self.target.name:
            raise ConflictError(f"object and target are both {self.object.name!r}", ("object",), ("target",))
        if not self.target.carries:
            raise ConflictError(
                f"target {self.target.name!r} has neither a floor nor a flat top to put something on", ("target",)
            )
        if (self.kind == "handover") != (self.exchange is not None):
            raise ConflictError(
                f"kind {self.kind!r} and `exchange`: a handover needs one, and no other task may have one", ("kind",)
            )
        if self.exchange is not None and self.exchange.object != self.object.name:
            raise ConflictError(
                f"`exchange` says where two hands may hold the {self.exchange.object}, not the {self.object.name}; "
                "hand over that, or give the points in a task config of your own",
                ("object",),
                ("exchange",),
            )
        return self
