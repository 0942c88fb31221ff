"""Real recordings: how others call an arm's joints in them, and what a dataset of imported ones says of itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..documents.base import Config, ConflictError, Name, Reference
from .rig import RigConfig

GripperUnit = Literal["metres", "share", "closed_share"]

_Side = Annotated[str, Field(pattern="^(left|right|only)$")]
_Called = Annotated[str, Field(min_length=1, max_length=200)]


class ArmNames(Config):
    """An arm's columns, as somebody else calls them.

    Attributes:
        joints: from the base to the flange, rad.
        gripper: left out where there is none.
    """

    joints: Annotated[tuple[_Called, ...], Field(min_length=1)]
    gripper: _Called | None = None


class ArmTopics(Config):
    """An arm's topics in a file of messages, as somebody else calls them; fields are `<topic>.<field>`.

    Attributes:
        state, action: whose field `field` has the joints, as measured and as commanded, rad.
        gripper_state, gripper_action: whose field `field` begins with the gripper.
    """

    state: _Called
    action: _Called | None = None
    gripper_state: _Called | None = None
    gripper_action: _Called | None = None


class RecordingNames(Config):
    """How a family of recordings calls its arms.

    Attributes:
        arms: `left` and `right`, or `only` of one arm -> names of its columns, measured and commanded alike.
        topics: the same -> its topics, of files of messages; one of the two.
        field: the field of a topic's messages that has the numbers.
        prompt_topic, prompt_field: where the task is told in words.
        cameras: topic of compressed video -> what the camera is called here.
        gripper: `metres` of one finger, `share` 0 closed .. 1 open, or `closed_share` 0 open .. 1 closed.
    """

    name: Name
    arms: dict[_Side, ArmNames] = Field(default_factory=dict)
    topics: dict[_Side, ArmTopics] = Field(default_factory=dict)
    field: _Called = "position"
    prompt_topic: _Called | None = None
    prompt_field: _Called = "text"
    cameras: dict[_Called, Name] = Field(default_factory=dict)
    gripper: GripperUnit = "share"

    @model_validator(mode="after")
    def _one_of_two(self) -> RecordingNames:
        if bool(self.arms) == bool(self.topics):
            raise ConflictError("give either the columns of arms or their topics", ("arms",), ("topics",))
        return self


class RealConfig(Config):
    """`config.yaml` of a dataset of imported recordings.

    Attributes:
        source: that nothing of it was simulated.
        rig: whose arms were recorded.
        imported: from which format.
        gripper: the unit in which the recordings had grippers; here they are metres.
    """

    source: Literal["real"]
    rig: Annotated[RigConfig, Reference("rigs")]
    imported: Name
    gripper: GripperUnit
