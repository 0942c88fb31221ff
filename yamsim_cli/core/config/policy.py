"""How a policy from elsewhere calls what it sees and what it answers, and in which units and order."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from ..documents.base import Config, ConflictError, Name
from ..documents.units import Within

# The key of a part of a message, as somebody else's program has it: `observation.images.top`.
Key = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_./]*$", max_length=100)]
Dtype = Literal["float32", "float64"]
Fit = Literal["stretch", "pad"]
Layout = Literal["rows", "channels"]

# A camera that a policy may be shown, by its name in `core.policies.base.IMAGES`, or one of a station's own.
CameraName = Name

# What a constant of a message may be.
Constant = bool | int | float | str


class PictureMapping(Config):
    """A picture as a policy wants it.

    Attributes:
        cameras: which camera it is: the first of these that the rig has.
        size_px: width and height; as it is rendered if left out.
        fit: "stretch" fills that size, whatever becomes of the sides; "pad" keeps them and adds black.
        layout: "rows" for (height, width, 3), "channels" for (3, height, width).
        optional: left out where there is no such camera, or where a checkpoint does not ask for it.
    """

    cameras: tuple[CameraName, ...] = Field(min_length=1)
    size_px: tuple[Annotated[int, Field(ge=8, le=2048)], Annotated[int, Field(ge=8, le=2048)]] | None = None
    fit: Fit = "stretch"
    layout: Layout = "rows"
    optional: bool = False


class StateMapping(Config):
    """A row of numbers: the arms' joints and grippers, or where things are."""

    key: Key
    dtype: Dtype = "float32"


class ActionsMapping(Config):
    """The rows of numbers that a policy answers with, one for each action: (actions, numbers), or one row alone.

    Attributes:
        key: of the rows in the answer.
        weld: after all drives, a number for each arm says whether its weld is to hold: from 0.5 on.
        hz: actions a second.
        period_ms_key: of a number in the answer, ms, which goes before `hz` where it is there and above 0.
        done_key: of a truth value in the answer: nothing comes after these actions.
    """

    key: Key = "actions"
    weld: bool = False
    hz: Annotated[float, Within("a second", 0.1, 1000)]
    period_ms_key: Key | None = None
    done_key: Key | None = None


class PolicyConfig(Config):
    """What a policy from elsewhere calls things, and in which units and order.

    Attributes:
        arms: the order of the arms in the state and in actions; "all" for those of any rig, the left one first. Of each
            arm come its joints in rad, and then its gripper.
        gripper: "share" for 0 closed .. 1 open, "metres" for the opening of one finger.
        environment_state: where things are, see `core.policies.environment_state`; a checkpoint that does not ask is
            not told.
        images: key -> picture.
        images_under: a key that holds all pictures; at the top of the message if left out.
        prompt: key of the task in words.
        time: key of the time since the trial's start, s.
        seed: key of the trial's seed.
        constants: key -> what is sent with every observation.
    """

    name: Name
    arms: Literal["all"] | tuple[Literal["left", "right"], ...] = "all"
    gripper: Literal["share", "metres"]
    state: StateMapping | None = None
    environment_state: StateMapping | None = None
    images: dict[Key, PictureMapping] = Field(default={}, max_length=16)
    images_under: Key | None = None
    prompt: Key | None = None
    time: Key | None = None
    seed: Key | None = None
    constants: dict[Key, Constant] = Field(default={}, max_length=32)
    actions: ActionsMapping

    @model_validator(mode="after")
    def _each_key_once(self) -> PolicyConfig:
        pictures = [] if self.images_under else [(key, ("images", key)) for key in self.images]
        places: list[tuple[str | None, tuple[str, ...]]] = [
            (self.state.key if self.state else None, ("state", "key")),
            (self.environment_state.key if self.environment_state else None, ("environment_state", "key")),
            *pictures,
            (self.images_under, ("images_under",)),
            (self.prompt, ("prompt",)),
            (self.time, ("time",)),
            (self.seed, ("seed",)),
            *((key, ("constants", key)) for key in self.constants),
        ]
        seen: dict[str, tuple[str, ...]] = {}
        for key, path in places:
            if key in seen:
                raise ConflictError(f"{key!r} is also the key of {'.'.join(seen[key])}", path, seen[key])
            if key is not None:
                seen[key] = path
        return self

    @field_validator("arms", mode="after")
    @classmethod
    def _each_once(cls, value: Any) -> Any:
        if isinstance(value, tuple) and (not value or len(set(value)) < len(value)):
            raise ValueError("name each arm once")
        return value
