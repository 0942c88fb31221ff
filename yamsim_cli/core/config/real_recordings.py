"""Real recordings: names of joints in other programs, and the config of a dataset of imported recordings."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..files.documents.config_base import Config, ConfigReference, ConflictError, Name
from .rig import RigConfig

GripperUnit = Literal["metres", "share", "closed_share"]

_ArmSide = Annotated[str, Field(pattern="^(left|right|only)$")]
_ForeignName = Annotated[str, Field(min_length=1, max_length=200)]


class ArmNames(Config):
    """Names of an arm's columns in another program.

    Attributes:
        joints: columns of the joints (rad) from the base to the flange.
        gripper: column of the gripper; None for an arm without a gripper.
    """

    joints: Annotated[tuple[_ForeignName, ...], Field(min_length=1)]
    gripper: _ForeignName | None = None


class ArmTopics(Config):
    """Names of an arm's topics in another program's file of messages.

    Attributes:
        state, action: topics whose messages have the measured and the commanded joints, rad, in `RecordingNames.field`.
        gripper_state, gripper_action: topics whose messages have the gripper as first number in `RecordingNames.field`.
    """

    state: _ForeignName
    action: _ForeignName | None = None
    gripper_state: _ForeignName | None = None
    gripper_action: _ForeignName | None = None


class RecordingNames(Config):
    """Names in recordings of another program.

    Attributes:
        arms: `left` and `right`, or `only` for one arm -> names of its columns, both measured and commanded.
        topics: instead of `arms`, for files of messages: the same keys -> the arm's topics.
        field: field of the messages with the numbers.
        prompt_topic, prompt_field: topic and field of the prompt.
        cameras: topic of compressed video -> name of the camera in yamsim.
        gripper: unit: `metres` of one finger, `share` 0 closed .. 1 open, or `closed_share` 0 open .. 1 closed.
    """

    name: Name
    arms: dict[_ArmSide, ArmNames] = Field(default_factory=dict)
    topics: dict[_ArmSide, ArmTopics] = Field(default_factory=dict)
    field: _ForeignName = "position"
    prompt_topic: _ForeignName | None = None
    prompt_field: _ForeignName = "text"
    cameras: dict[_ForeignName, Name] = Field(default_factory=dict)
    gripper: GripperUnit = "share"

    @model_validator(mode="after")
    def _require_arms_or_topics(self) -> RecordingNames:
        if bool(self.arms) == bool(self.topics):
            raise ConflictError("give either the columns of arms or their topics", ("arms",), ("topics",))
        return self


class RealConfig(Config):
    """`config.yaml` of a dataset of imported recordings.

    Attributes:
        source: `real`, for data that is not simulated.
        rig: the arms, with grippers and cameras, that were recorded.
        imported: name of the format from which the recordings were imported.
        gripper: the unit of grippers in the recordings; the dataset has metres.
    """

    source: Literal["real"]
    rig: Annotated[RigConfig, ConfigReference("rigs")]
    imported: Name
    gripper: GripperUnit
