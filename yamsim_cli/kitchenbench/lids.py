"""Containers with lids that open: jars and bottles with screw lids, and food containers with a lid that snaps on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Any

from kitchenbench.sim.blueprint import SceneBlueprint

from ..core.config.objects.generated import object_from_shape
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import CapShape, ContainerShape, LidShape, VesselShape

#: Name of the lid of a container: of the link, of its joint, and the prefix of its handles' names.
LID = "lid"
#: The asset whose lid snaps on; the other lids are screwed.
SNAP_ASSET = "food_container"
#: Assets with a lid for `GoalKind.OPEN` -> config of that lid.
LID_CONFIGS = {"jar": "kitchen_jar_lid", "bottle": "kitchen_bottle_cap", SNAP_ASSET: "kitchen_lid"}
#: Conditions that lids fulfil for `GoalKind.OPEN`.
LID_CONDITIONS = frozenset({"lid_torque_nm", "cap_turns", "pry_force_n"})

# m per turn, lead of a thread. Source: glass finishes with a continuous thread have 4 to 8 threads an inch.
_PITCH = 0.004
_TURNS = 1.0  # turns from shut to off, where the scene does not give `cap_turns`
_SCREW_DAMPING = 0.02  # N m s/rad, so that a lid does not spin on when the hand lets go
_SCREW_ARMATURE = 2e-4  # kg m2, for steps of 2 ms with a large friction torque

_SNAP_TRAVEL = 0.020  # m, lift at which a snap lid's rim, 10 mm deep, is clear of the container
_SNAP_WIDTH = 0.006  # m, lift over which the clips let go
_SNAP_DAMPING, _SNAP_ARMATURE = 2.0, 0.05  # N s/m and kg

_EAR = (0.024, 0.060, 0.030)  # m, length, width and height of the ear at each end of a food container
_EAR_DROP = 0.002  # m, from the container's rim down to the ears
_EAR_OUTWARD = 0.004  # m, from an ear's centre to the pads that hold it, so that fingers clear the wall
_FLAT_AZIMUTHS = (0, 30, -30, 60, -60)  # degrees from the container's length, of hands whose fingers close vertically
_FLAT_PITCHES = (10, 20)  # degrees down from horizontal, of these hands at an ear
_BAR_LENGTH_MM = 90.0  # mm, of a snap lid's bar, along the container
_SNAP_TILTS = (0, 15, 30, 45, 60)  # degrees from vertical, of hands at an ear and at the bar; the hands lean apart
_BAR_WIDTH = 0.026  # m, of a snap lid's bar: the pads press harder on wider things

_STEADY_AZIMUTHS = 24  # directions from which a hand may steady a round container
_STEADY_TILTS = (0, 20, 40, 55, 65)  # degrees down from horizontal, of that hand
_STEADY_SHARES = (0.35, 0.5, 0.62)  # heights of that hand, as shares of the round container's height
_GRIP_TILTS = (0, 15, 25, 35)  # degrees from vertical, of a hand over a screw lid
_GRIP_AZIMUTHS = 16  # directions to which that hand leans
_GRIP_HEIGHT = 0.5  # share of a screw lid's height at which the pads hold it


def lidded_container(base: ObjectConfig, asset: str, lid: ObjectConfig, blueprint: SceneBlueprint) -> ObjectConfig:
    """Return a container with its lid on, as an articulated object with the link `LID`.

    Args:
        base: the container from its sizes.
        asset: a key of `LID_CONFIGS`.
        lid: the asset's lid, in the container's size.
        blueprint: its conditions give the torque or force at which the lid opens.
    """
    conditions = blueprint.conditions
    data = base.model_dump(mode="json", exclude_none=True)
    data.pop("grasp", None)
    if asset == SNAP_ASSET:
        # A hand that pries at one long edge turns the lid about the other one.
        assert isinstance(base.shape, ContainerShape)
        torque = conditions.get("lid_torque_nm")
        width = base.shape.size_mm[1] / 1000
        force = float(conditions["pry_force_n"]) if torque is None else float(torque) / width
        return ObjectConfig.model_validate({**data, **_snap_container(base, lid, force)})
    torque, turns = float(conditions["lid_torque_nm"]), float(conditions.get("cap_turns", _TURNS))
    return ObjectConfig.model_validate({**data, **_screw_container(base, lid, torque, turns)})


def container_with_ears(shape: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shape's data of a food container that is shorter by the ears, so that both have its size."""
    length, width, height = shape["size_mm"]
    return {**shape, "size_mm": [length - 2000 * _EAR[0], width, height]}


def lid_between_ears(shape: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shape's data of the lid of `container_with_ears`, with a bar for a firm grasp."""
    length, width, height = shape["size_mm"]
    return {**shape, "size_mm": [length - 2000 * _EAR[0], width, height], "bar_mm": [1000 * _BAR_WIDTH, _BAR_LENGTH_MM]}


def _screw_container(base: ObjectConfig, lid: ObjectConfig, torque: float, turns: float) -> dict[str, Any]:
    assert isinstance(base.shape, VesselShape) and isinstance(lid.shape, CapShape)
    height, radius = base.shape.height_mm / 1000, base.shape.diameter_mm / 2000
    tall, lid_radius = lid.shape.height_mm / 1000, lid.shape.diameter_mm / 2000
    shoulder = base.shape.shoulder_mm / 1000 or height
    joint = {
        "type": "screw", "axis": [0, 0, 1], "range": [0, 360 * turns], "pitch": _PITCH, "friction": torque,
        "stiff_friction": True, "damping": _SCREW_DAMPING, "armature": _SCREW_ARMATURE,
    }  # fmt: skip
    at = [0.0, 0.0, height - tall + lid.shape.wall_mm / 1000]
    return {
        "links": [_lid_link(lid, at, joint, list(_screw_lid_handles(lid_radius, tall)))],
        "handles": list(_round_handles(radius, shoulder)),
    }


def _handle(
    name: str, position: list[float], azimuth: float, outwards: float, down: float, opening: float
) -> dict[str, Any]:
    """Return a handle whose fingers close horizontally.

    Args:
        azimuth: direction about the vertical, rad.
        outwards, down: components of the unit vector of approach, in that direction and down.
    """
    x, y = math.cos(azimuth), math.sin(azimuth)
    return {
        "name": name,
        "position": position,
        "approach": [x * outwards, y * outwards, -down],
        "axis": [-y, x, 0.0],
        "opening": opening,
    }


def _screw_lid_handles(radius: float, height: float) -> Iterator[dict[str, Any]]:
    """Yield handles over a screw lid, for hands that point down or lean; fingers close horizontally."""
    for tilt in _GRIP_TILTS:
        lean = math.radians(tilt)
        for k in range(_GRIP_AZIMUTHS):
            turn = 2 * math.pi * k / _GRIP_AZIMUTHS
            yield _handle(
                f"{LID}_{tilt}_{k}", [0.0, 0.0, _GRIP_HEIGHT * height], turn, math.sin(lean), math.cos(lean), radius
            )


def _round_handles(radius: float, height: float) -> Iterator[dict[str, Any]]:
    """Yield handles around an upright cylinder, for hands that come from the side, or from above at a slant."""
    for share in _STEADY_SHARES:
        for tilt in _STEADY_TILTS:
            down = math.radians(tilt)
            for k in range(_STEADY_AZIMUTHS):
                turn = 2 * math.pi * k / _STEADY_AZIMUTHS
                name, at = f"side_{round(100 * share)}_{tilt}_{k}", [0.0, 0.0, share * height]
                yield _handle(name, at, turn, -math.cos(down), math.sin(down), radius)


def _snap_container(base: ObjectConfig, lid: ObjectConfig, force: float) -> dict[str, Any]:
    assert isinstance(base.shape, ContainerShape) and isinstance(lid.shape, LidShape)
    length, _, height = (side / 1000 for side in base.shape.size_mm)
    rgba = base.shape.materials["body"].rgba
    ears: list[dict[str, Any]] = []
    handles: list[dict[str, Any]] = []
    for side in (1.0, -1.0):
        centre = [side * (length + _EAR[0]) / 2, 0.0, height - _EAR_DROP - _EAR[2] / 2]
        ears.append({"type": "box", "centre": centre, "half_size": [size / 2 for size in _EAR], "rgba": rgba})
        grasped = [centre[0] + side * _EAR_OUTWARD, *centre[1:]]
        handles += _flat_ear_handles(side, grasped)
        for tilt in _SNAP_TILTS:
            # The hand leans away from the lid.
            lean, name = math.radians(tilt), f"ear_{'front' if side > 0 else 'back'}_{tilt}"
            handles.append(_handle(name, grasped, 0.0, -side * math.sin(lean), math.cos(lean), _EAR[1] / 2))
    joint = {
        "type": "slide", "axis": [0, 0, 1], "range": [0, _SNAP_TRAVEL], "damping": _SNAP_DAMPING,
        "armature": _SNAP_ARMATURE,
        "detents": [{"at": _SNAP_WIDTH / 2, "width": _SNAP_WIDTH, "effort": force}],
    }  # fmt: skip
    low, top = lid.shape.size_mm[2] / 1000 * 0.33, lid.shape.size_mm[2] / 1000  # the rim reaches a third down
    middle = (low + lid.shape.plate_mm / 1000 + top) / 2
    grips = []
    for tilt, side, x in itertools.product(_SNAP_TILTS, (1, -1), (0.035, -0.035, 0.02, -0.02, 0.0)):
        if tilt == 0 and side < 0:
            continue
        lean = side * math.radians(tilt)
        name = f"{LID}_bar_{round(side * tilt)}_{round(1000 * x)}".replace("-", "minus_")
        grips.append(_handle(name, [x, 0.0, middle], 0.0, -math.sin(lean), math.cos(lean), _BAR_WIDTH / 2))
    data = base.model_dump(mode="json", exclude_none=True)
    return {
        "collision": [*data["collision"], *ears],
        "look": [*data["look"], *ears],
        "handles": handles,
        "links": [_lid_link(lid, [0.0, 0.0, height - low], joint, grips)],
    }


def _flat_ear_handles(side: float, position: list[float]) -> Iterator[dict[str, Any]]:
    """Yield handles at an ear, for hands that come from the side and whose fingers close from above and below."""
    for pitch, azimuth in itertools.product(_FLAT_PITCHES, _FLAT_AZIMUTHS):
        turn, down = math.radians(azimuth), math.radians(pitch)
        x, y = -side * math.cos(turn), -math.sin(turn)
        name = f"ear_{'front' if side > 0 else 'back'}_flat_{azimuth}_{pitch}".replace("-", "minus_")
        yield {
            "name": name,
            "position": position,
            "approach": [x * math.cos(down), y * math.cos(down), -math.sin(down)],
            "axis": [-x * math.sin(down), -y * math.sin(down), -math.cos(down)],
            "opening": _EAR[2] / 2,
        }


def _lid_link(lid: ObjectConfig, at: list[float], joint: dict[str, Any], handles: list[dict[str, Any]]) -> Any:
    assert lid.shape is not None
    made, rgba = object_from_shape(lid.name, lid.shape), lid.shape.materials["body"].rgba
    return {
        "name": LID,
        "position": at,
        "joint": joint,
        "inertia": made["inertia"],
        # A link has no generated mesh, so its primitives are visible.
        "collision": [{**part, "rgba": rgba} for part in made["collision"]],
        "handles": handles,
    }
