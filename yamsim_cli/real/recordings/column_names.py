"""Namings: configs that assign columns of another program's recordings to joints and grippers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.real_recordings import ArmNames, RecordingNames
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion

from .recording import motion_sides

CONFIG_KIND = "recordings"  # folder of namings in configs/


def candidate_namings(mapping: str | None, locations: Locations) -> list[RecordingNames]:
    """Return the naming `mapping`, or if None, all of `configs/recordings/`."""
    names = locations.config_names(CONFIG_KIND) if mapping is None else [mapping]
    return [load_config(RecordingNames, CONFIG_KIND, name, locations) for name in names]


def arm_keys(rig: RigConfig) -> list[str]:
    """Return arm keys in a naming: `left` and `right`, or `only`."""
    return [side or "only" for side in motion_sides(rig)]


def find_naming(
    columns: Sequence[str], rig: RigConfig, mapping: str | None, source: str, locations: Locations
) -> RecordingNames:
    """Return the naming `mapping`, or if None, the first that fits columns and rig.

    `configs/recordings/` comes first, then the rig's names of drives and joints.

    Raises:
        ConfigError: `mapping` does not exist or does not fit.
        DatasetError: no naming fits.
    """
    candidates = candidate_namings(mapping, locations)
    if mapping is not None:
        (requested,) = candidates
        missing = _first_missing_column(requested, columns, rig)
        if missing is not None:
            raise ConfigError(f"--mapping {mapping}: {source} has no {missing!r}; its columns are {', '.join(columns)}")
        return requested
    for names in [*candidates, *_drive_names(rig)]:
        if names.arms and _first_missing_column(names, columns, rig) is None:
            return names
    raise DatasetError(
        f"{source}: its columns are {', '.join(columns)}, and no config in configs/{CONFIG_KIND}/ fits these columns "
        f"and rig {rig.name!r}; name each arm's columns in a file for --mapping, or give another --rig"
    )


def arm_motions_from_columns(
    names: RecordingNames, rig: RigConfig, measured: Mapping[str, Array], commanded: Mapping[str, Array] | None
) -> tuple[ArmMotion, ...]:
    """Return each arm's motion, the left first, from named columns (n,); openings keep their unit."""
    motions = []
    for side, key in zip(motion_sides(rig), arm_keys(rig), strict=True):
        joints, gripper = names.arms[key].joints, names.arms[key].gripper
        motions.append(
            ArmMotion(
                side,
                np.column_stack([measured[name] for name in joints]),
                None if commanded is None else np.column_stack([commanded[name] for name in joints]),
                measured.get(gripper) if gripper else None,
                commanded.get(gripper) if commanded is not None and gripper else None,
            )
        )
    return tuple(motions)


def arm_columns(arm: ArmNames) -> tuple[str, ...]:
    """Return the columns of an arm's joints, and last of any gripper."""
    return arm.joints if arm.gripper is None else (*arm.joints, arm.gripper)


def _first_missing_column(names: RecordingNames, columns: Sequence[str], rig: RigConfig) -> str | None:
    keys = arm_keys(rig)
    if set(keys) != set(names.arms):
        return " and ".join(f"arm {key!r} in it" for key in keys)
    for key, k in zip(keys, rig.recording_order, strict=True):
        dof = rig.arms[k].robot.dof
        if len(names.arms[key].joints) != dof:
            return f"{dof} joints of arm {key!r}"
        for name in arm_columns(names.arms[key]):
            if name not in columns:
                return name
    return None


def _drive_names(rig: RigConfig) -> list[RecordingNames]:
    """Return the namings of yamsim's exports, with the side as prefix for two arms."""
    by_drive, by_joint = {}, {}
    for side, key, k in zip(motion_sides(rig), arm_keys(rig), rig.recording_order, strict=True):
        robot, prefix = rig.arms[k].robot, f"{side}_" if side else ""
        gripper = prefix + robot.drive_names[-1] if robot.fingers else None
        by_drive[key] = ArmNames(joints=tuple(prefix + name for name in robot.joint_drives), gripper=gripper)
        by_joint[key] = ArmNames(joints=tuple(prefix + name for name in robot.joint_names), gripper=gripper)
    return [RecordingNames(name="drives", arms=arms, gripper="metres") for arms in (by_drive, by_joint)]
