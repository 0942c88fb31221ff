"""Which of somebody else's columns are an arm's joints and its gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..config.loader import load_config
from ..config.real import ArmNames, RecordingNames
from ..config.rig import RigConfig
from ..errors import ConfigError, DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion
from ..resources import Locations
from .columns import sides

KIND = "recordings"
_ONLY = "only"


def known_names(locations: Locations) -> list[RecordingNames]:
    """All namings that there are, in the order of their names."""
    return [load_config(RecordingNames, KIND, name, locations) for name in locations.config_names(KIND)]


def naming_of(
    columns: Sequence[str], rig: RigConfig, mapping: str | None, source: str, locations: Locations
) -> RecordingNames:
    """The naming that fits some columns: the one that was asked for, or else the first that does; then the drives' own.

    Raises:
        ConfigError: the one that was asked for is none, or does not fit.
        DatasetError: none fits.
    """
    if mapping is not None:
        asked = load_config(RecordingNames, KIND, mapping, locations)
        lacking = _lacking(asked, columns, rig)
        if lacking is not None:
            raise ConfigError(f"--mapping {mapping}: {source} has no {lacking!r}; its columns are {', '.join(columns)}")
        return asked
    for names in [*known_names(locations), *_own_names(rig)]:
        if names.arms and _lacking(names, columns, rig) is None:
            return names
    raise DatasetError(
        f"{source}: its columns are {', '.join(columns)}, and no naming in configs/{KIND}/ fits those and rig "
        f"{rig.name!r}; say which is whose with --mapping names.yaml, or give another --rig"
    )


def arms_of(
    names: RecordingNames, rig: RigConfig, measured: Mapping[str, Array], told: Mapping[str, Array] | None
) -> tuple[ArmMotion, ...]:
    """The arms' motions in columns (n,) by their names, the left arm's first; openings in the naming's own unit."""
    motions = []
    for side in sides(rig):
        arm = names.arms[_key(side)]
        motions.append(
            ArmMotion(
                side,
                np.column_stack([measured[name] for name in arm.joints]),
                None if told is None else np.column_stack([told[name] for name in arm.joints]),
                measured.get(arm.gripper) if arm.gripper else None,
                told.get(arm.gripper) if told is not None and arm.gripper else None,
            )
        )
    return tuple(motions)


def _key(side: str) -> str:
    return side or _ONLY


def _lacking(names: RecordingNames, columns: Sequence[str], rig: RigConfig) -> str | None:
    """What a naming needs for the rig's arms that is not among the columns; None if nothing."""
    if {_key(side) for side in sides(rig)} != set(names.arms):
        return " and ".join(f"arm {_key(side)!r} in it" for side in sides(rig))
    for side, k in zip(sides(rig), rig.recorded, strict=True):
        arm = names.arms[_key(side)]
        if len(arm.joints) != rig.arms[k].robot.dof:
            return f"{rig.arms[k].robot.dof} joints of arm {_key(side)!r}"
        for name in (*arm.joints, *([arm.gripper] if arm.gripper else [])):
            if name not in columns:
                return name
    return None


def _own_names(rig: RigConfig) -> list[RecordingNames]:
    """As yamsim's own export names what it measured: the drives, the arm's side before them where there are two."""
    arms, plain = {}, {}
    for side, k in zip(sides(rig), rig.recorded, strict=True):
        robot, prefix = rig.arms[k].robot, f"{side}_" if side else ""
        gripper = prefix + robot.drives[-1] if robot.fingers else None
        arms[_key(side)] = ArmNames(joints=tuple(prefix + name for name in robot.joint_drives), gripper=gripper)
        plain[_key(side)] = ArmNames(joints=tuple(prefix + name for name in robot.joint_names), gripper=gripper)
    return [
        RecordingNames.model_validate({"name": "drives", "arms": named, "gripper": "metres"}) for named in (arms, plain)
    ]
