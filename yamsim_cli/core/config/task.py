"""Tasks: where objects may start, how the arm goes about it, and what counts as success."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from .base import Config, Name, NonNegative, Positive, Range, Reference
from .scene import ObjectConfig


class Sampling(Config):
    """The box in `world` from which both objects' positions are drawn (m), and their headings (degrees).

    Attributes:
        min_separation: least distance between the two origins, m.
        clearance: least gap between their outlines seen from above, m.
    """

    x: Range
    y: Range
    object_yaw_deg: Range
    target_yaw_deg: Range
    min_separation: NonNegative
    clearance: NonNegative


class Heights(Config):
    """Heights in metres of the carried object's origin over where it lies or will lie."""

    approach: Positive
    lift: Positive
    arc: Positive
    release: NonNegative


class Timing(Config):
    """How a plan is spread over time.

    Attributes:
        ticks_per_waypoint: control ticks from one waypoint to the next.
        grip_ticks: control ticks in which the hand stands still for the fingers to close, or to open, where friction is
            to hold the object.
        settle_ticks: control ticks after the last waypoint, in which the arm goes back to where it started.
        physics_steps_per_tick, timestep: so a tick lasts 16 x 2 ms = 32 ms.
        ticks_per_frame: every how many ticks a frame is recorded.
    """

    ticks_per_waypoint: int = Field(ge=2, le=1000)
    grip_ticks: int = Field(default=8, ge=1, le=1000)
    settle_ticks: int = Field(ge=0, le=10_000)
    physics_steps_per_tick: int = Field(ge=1, le=1000)
    timestep: Annotated[float, Field(gt=0, le=0.01)]
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
        max_speed: a faster object has not come to rest, m/s.
    """

    threshold: Positive
    max_height: Positive
    max_speed: Positive


class TaskConfig(Config):
    """Something to demonstrate with `object` and `target`.

    Attributes:
        kind: what is done with them, one of `core.tasks.kinds`: pickplace picks `object` up and puts it onto `target`.
        language_task, language_prompt: how the task is called and told in the data; {object}, {target} and the target's
            {preposition} are filled in.
    """

    name: Name
    kind: Name
    object: Annotated[ObjectConfig, Reference("objects")]
    target: Annotated[ObjectConfig, Reference("objects")]
    language_task: str
    language_prompt: str
    sampling: Sampling
    start_joints: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    heights: Heights
    timing: Timing
    success: Success

    @field_validator("language_task", "language_prompt")
    @classmethod
    def _filled_in(cls, text: str, info: ValidationInfo) -> str:
        item, target = (info.data.get(key) for key in ("object", "target"))
        if item is None or target is None:
            return text  # Their own faults are told.
        words = {"object": item.name, "target": target.name, "preposition": target.preposition}
        for key, word in words.items():
            # A task's name is one word; what is said of it has several.
            said = word.replace("_", " ") if info.field_name == "language_prompt" else word
            text = text.replace(f"{{{key}}}", said)
        return text

    @model_validator(mode="after")
    def _graspable(self) -> TaskConfig:
        if self.object.grasp is None:
            raise ValueError(f"object {self.object.name!r} has no `grasp`, so it cannot be picked up")
        if self.object.name == self.target.name:
            raise ValueError(f"object and target are both {self.object.name!r}")
        if not self.target.carries:
            raise ValueError(f"target {self.target.name!r} has neither a floor nor a flat top to put something on")
        return self
