"""Names, units and order of the observations and actions of a policy in another program."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from ..files.documents.config_base import Config, ConflictError, Name
from ..files.documents.units import QuantityBounds

# A key in a message of another program, such as `observation.images.top`.
MessageKey = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_./]*$", max_length=100)]
Dtype = Literal["float32", "float64"]
AspectRatioMode = Literal["stretch", "pad"]
ImageAxisOrder = Literal["rows", "channels"]

CameraName = Name  # "scene", "wrist", "left_wrist", "right_wrist", or the name of a station's camera
_CHUNKING_KEYS = ("prefix_key", "length_key")
ScalarConstant = bool | int | float | str


class PictureMapping(Config):
    """An image in the format of a policy.

    Attributes:
        cameras: candidate cameras; the image is from the first one that the rig has.
        size_px: width and height; as rendered if left out.
        fit: "stretch" changes the aspect ratio to fill the size; "pad" keeps the aspect ratio and adds black.
        layout: "rows" for (height, width, 3), "channels" for (3, height, width).
        optional: whether the image is left out if the rig has no such camera, or a checkpoint has no such input.
    """

    cameras: tuple[CameraName, ...] = Field(min_length=1)
    size_px: tuple[Annotated[int, Field(ge=8, le=2048)], Annotated[int, Field(ge=8, le=2048)]] | None = None
    fit: AspectRatioMode = "stretch"
    layout: ImageAxisOrder = "rows"
    optional: bool = False


class StateMapping(Config):
    """A row of numbers: the arms' joints and grippers, or the poses of objects."""

    key: MessageKey
    dtype: Dtype = "float32"


class ActionsMapping(Config):
    """Actions in the answer of a policy: an array (actions, numbers), or one row.

    Attributes:
        key: key of the array in the answer.
        weld: whether each row has, after all drives, a number for each arm. At least 0.5 activates the weld constraint
            that fixes an object to the hand.
        hz: actions per second.
        period_ms_key: key of the action period in the answer, ms; a period above 0 overrides `hz`.
        done_key: key of a boolean in the answer that ends the trial after these actions.
    """

    key: MessageKey = "actions"
    weld: bool = False
    hz: Annotated[float, QuantityBounds("a second", 0.1, 1000)]
    period_ms_key: MessageKey | None = None
    done_key: MessageKey | None = None


class RealtimeChunking(Config):
    """Real-time chunking: a request has the end of the current plan, from which the next chunk continues.

    A chunk begins when the one before it is over. The first request has the current state, repeated.

    Attributes:
        prefix_key: key of the last planned actions (length, numbers), float32.
        length_key: key of their number.
        length: number of these actions. An answer begins with them, and they are not executed again.
        execute: number of actions of an answer that are executed after these.
        lead: actions of the current chunk that are left when the next chunk is requested.
    """

    prefix_key: MessageKey = "action_prefix"
    length_key: MessageKey = "prefix_length"
    length: Annotated[int, Field(ge=1, le=100)] = 4
    execute: Annotated[int, Field(ge=1, le=1000)] = 15
    lead: Annotated[int, Field(ge=0, le=999)] = 4

    @model_validator(mode="after")
    def _fits_a_chunk(self) -> RealtimeChunking:
        for key in ("length", "lead"):
            if getattr(self, key) > self.execute:
                raise ConflictError(f"{getattr(self, key)} actions are more than execute, {self.execute}", (key,))
        return self


class PolicyConfig(Config):
    """Names, units and order of a policy's observations and actions.

    Attributes:
        arms: order of the arms in the state and in actions; "all" for all arms of a rig, the left one first. Each arm
            has its joints in rad, and then its gripper.
        gripper: "share" for 0 closed .. 1 open, "metres" for the opening of one finger.
        environment_state: row with the poses of objects; not sent to a checkpoint without this input.
        images: key -> image.
        images_under: key of a mapping with all images; if left out, images are at the top level of the message.
        prompt: key of the prompt.
        time: key of the time since the trial's start, s.
        seed: key of the trial's seed.
        constants: key -> constant value in every observation.
        realtime_chunking: how a chunk continues the chunk before; if left out, it depends only on its observation.
        trained_on: dataset or export that the policy was trained on; `eval` uses its image size and quality.
    """

    name: Name
    arms: Literal["all"] | tuple[Literal["left", "right"], ...] = "all"
    gripper: Literal["share", "metres"]
    state: StateMapping | None = None
    environment_state: StateMapping | None = None
    images: dict[MessageKey, PictureMapping] = Field(default={}, max_length=16)
    images_under: MessageKey | None = None
    prompt: MessageKey | None = None
    time: MessageKey | None = None
    seed: MessageKey | None = None
    constants: dict[MessageKey, ScalarConstant] = Field(default={}, max_length=32)
    actions: ActionsMapping
    realtime_chunking: RealtimeChunking | None = None
    trained_on: str | None = Field(default=None, min_length=1, max_length=1000)

    @model_validator(mode="after")
    def _keys_are_unique(self) -> PolicyConfig:
        pictures = [] if self.images_under else [(key, ("images", key)) for key in self.images]
        places: list[tuple[str | None, tuple[str, ...]]] = [
            (self.state.key if self.state else None, ("state", "key")),
            (self.environment_state.key if self.environment_state else None, ("environment_state", "key")),
            *pictures,
            (self.images_under, ("images_under",)),
            (self.prompt, ("prompt",)),
            (self.time, ("time",)),
            (self.seed, ("seed",)),
            *((getattr(self.realtime_chunking, key, None), ("realtime_chunking", key)) for key in _CHUNKING_KEYS),
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
    def _arms_are_unique(cls, value: Any) -> Any:
        if isinstance(value, tuple) and (not value or len(set(value)) < len(value)):
            raise ValueError("name each arm once")
        return value
