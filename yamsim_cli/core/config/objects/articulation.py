"""Links, joints and handles of articulated objects: drawers, doors, lids and screw caps."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from ...files.documents.config_base import Config, Name, Quaternion, require_ordered
from ...files.documents.units import OffsetPoint, QuantityBounds
from ...geometry.se3 import Array, pose, pose_from_quat
from .object_part import Inertia, ObjectMesh
from .primitives import CollisionPart, Primitive

_HandleGripperOpening = Annotated[FiniteFloat, QuantityBounds("m", 0, 1)]
_JointPosition = Annotated[
    FiniteFloat, QuantityBounds("m or degrees", -3600, 3600)
]  # joint position: m, or degrees of a hinge
_Damping = Annotated[FiniteFloat, QuantityBounds("N s/m or N m s/rad", 0, 1e4)]
_JointEffort = Annotated[FiniteFloat, QuantityBounds("N or N m", 0, 500)]


def _require_direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) < 1e-6:
        raise ValueError("a vector of length 0 has no direction")
    return value


Direction = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_require_direction)]


class Handle(Config):
    """A grasp of one part of an object.

    Attributes:
        position: pinch point in the part's frame, m.
        approach: the hand's direction of approach in the part's frame; its length does not matter.
        axis: axis along which the fingers close, in the part's frame; its component along `approach` does not matter.
        opening: opening of one finger when closed around the handle, m.
    """

    name: Name
    position: OffsetPoint
    approach: Direction
    axis: Direction
    opening: _HandleGripperOpening

    @model_validator(mode="after")
    def _axis_is_across(self) -> Handle:
        lengths = math.hypot(*self.approach) * math.hypot(*self.axis)
        if np.linalg.norm(np.cross(self.approach, self.axis)) < 1e-3 * lengths:
            raise ValueError("`axis` is parallel to `approach`; the fingers must close across `approach`")
        return self

    @property
    def T_pinch_in_part(self) -> Array:
        """Pose (4, 4) of the pinch frame in the part's frame: z along the approach, y along the closing axis."""
        z = np.array(self.approach) / np.linalg.norm(self.approach)
        y = np.array(self.axis) - z * (z @ np.array(self.axis))
        y /= np.linalg.norm(y)
        return pose(self.position, np.column_stack([np.cross(y, z), y, z]))


class Detent(Config):
    """A ridge of potential energy along a joint, such as a ball catch, which holds a drawer shut or a lid open.

    Attributes:
        at: joint position of the ridge's top: m, or degrees of a hinge.
        width: width of the whole ridge, in the same unit.
        effort: largest force or torque against motion over the ridge: N, or N m of a hinge.
    """

    at: _JointPosition
    width: Annotated[FiniteFloat, QuantityBounds("m or degrees", 1e-5, 360)]
    effort: Annotated[FiniteFloat, QuantityBounds("N or N m", 1e-4, 500)]


class LinkJoint(Config):
    """The joint between a part and its parent.

    Attributes:
        type: "hinge" rotates; "slide" translates; "screw" rotates, and moves along its axis by `pitch` per turn.
        axis: direction in the part's frame; its length does not matter.
        position: a point on the axis, in the part's frame, m.
        range: lower and upper joint limit: m, or degrees of a hinge or a screw. At 0, the part has its config's pose.
        start: initial position, in the same unit.
        damping: viscous damping, N s/m or N m s/rad.
        friction: dry friction, N or N m.
        stiff_friction: whether dry friction is stiffer. A load below `friction` then moves the joint more slowly, by a
            factor of 10 or more at steps of 2 ms.
        armature: added inertia, kg or kg m2.
        pitch: pitch of a screw, m per turn.
        detents: ridges that the joint has to overcome.
    """

    type: Literal["hinge", "slide", "screw"]
    axis: Direction
    position: OffsetPoint = (0.0, 0.0, 0.0)
    range: Annotated[tuple[_JointPosition, _JointPosition], AfterValidator(require_ordered)]
    start: _JointPosition = 0.0
    damping: _Damping = 0.0
    friction: _JointEffort = 0.0
    stiff_friction: Annotated[bool, Field(exclude_if=lambda stiff: not stiff)] = False
    armature: Annotated[FiniteFloat, QuantityBounds("kg or kg m2", 0, 100)] = 0.0
    pitch: Annotated[FiniteFloat, QuantityBounds("m", -0.1, 0.1)] | None = None
    detents: tuple[Detent, ...] = ()

    @field_validator("range")
    @classmethod
    def _range_fits_the_type(cls, value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
        if value[0] == value[1]:
            raise ValueError("the ends of a joint's range must differ")
        if info.data.get("type") == "slide":
            for end in value:
                QuantityBounds("m", -2, 2).check(end, info)
        return value

    @model_validator(mode="after")
    def _positions_lie_in_range(self) -> LinkJoint:
        if not self.range[0] <= self.start <= self.range[1]:
            raise ValueError(f"start {self.start:g} lies outside its range {self.range[0]:g}..{self.range[1]:g}")
        if self.stiff_friction and not self.friction:
            raise ValueError("`stiff_friction` needs `friction`; give both, or neither")
        if (self.type == "screw") != bool(self.pitch):
            raise ValueError("a screw joint needs `pitch`, and other joints must not have it")
        for detent in self.detents:
            if not self.range[0] <= detent.at <= self.range[1]:
                raise ValueError(f"detent at {detent.at:g} lies outside the range")
        return self

    @property
    def is_revolute(self) -> bool:
        """Whether positions are angles."""
        return self.type != "slide"

    def to_si(self, value: float) -> float:
        """Return a position in the config's unit, converted to m or rad."""
        return math.radians(value) if self.is_revolute else value


class Link(Config):
    """A part that moves on another part of the same object.

    Attributes:
        parent: name of the parent part; the base if left out.
        position, quat: pose of the part's frame in its parent's frame, m, with the joint at 0.
        meshes: visual meshes in the part's frame.
        collision: collision geometry; neighbouring parts of one object do not collide.
        look: additional visual primitives.
        handles: grasps of the part.
    """

    name: Name
    parent: Name | None = None
    position: OffsetPoint = (0.0, 0.0, 0.0)
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)
    joint: LinkJoint
    inertia: Inertia
    meshes: tuple[ObjectMesh, ...] = ()
    collision: tuple[CollisionPart, ...] = Field(min_length=1)
    look: tuple[Primitive, ...] = ()
    handles: tuple[Handle, ...] = ()

    @property
    def T_in_parent(self) -> Array:
        """Pose (4, 4) of the part's frame in its parent's frame, with the joint at 0."""
        quat = np.array(self.quat) / np.linalg.norm(self.quat)
        return pose_from_quat(self.position, quat)
