"""Writes the skeleton of an arm, and checks an arm of one's own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from .config.loader import load_config
from .config.rig import RigConfig
from .config.robot_names import ARMS
from .config.scene import SceneConfig
from .errors import ConfigError, SimulationError, UsageError
from .files import refusal, write_file
from .resources import Locations
from .robots.models import ArmModel
from .robots.skeleton import arm_files
from .robots_there import robot_there
from .scene.build import build_rig_scene

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_HOLD_S = 1.0  # s, for how long the arm is to hold its home: long enough for drives to settle
_MOST_SAG = 0.1  # rad, how far a joint may then be off home: more means a drive that cannot bear the arm


def new_robot(name: str, data: Path, locations: Locations) -> tuple[Path, ...]:
    """Write the skeleton of an arm under a root of data, and return its files.

    Raises:
        UsageError: the name is not valid or taken, or the folder cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name for an arm; start with a letter, then letters, digits and underscores")
    folder = data / "robot_models" / name
    if folder.exists() or name in locations.config_names(ARMS):
        raise UsageError(f"an arm {name!r} exists and is not overwritten; give another name, or remove {folder}")
    paths = []
    try:
        folder.mkdir(parents=True)
        for file, text in arm_files(name).items():
            write_file(folder / file, text.encode())
            paths.append(folder / file)
    except OSError as error:
        raise UsageError(refusal(error, folder)) from error
    return tuple(paths)


def check_robot(name: str, locations: Locations) -> list[dict[str, Any]]:
    """Check an arm with each gripper that fits: it compiles, and its drives hold it at home.

    Returns:
        For each gripper: `gripper`, `ok` (None where the pair is no rig by itself, as without a wrist camera),
        `sag_rad` (the most that a joint is off home), `detail`.

    Raises:
        ConfigError: a file is not valid, or no gripper fits.
        UsageError: there is no arm of that name.
    """
    arm = load_config(ArmModel, ARMS, name, locations)
    grippers = robot_there(arm.name, locations)["goes_with"]
    if not grippers:
        raise ConfigError(f"{arm.mjcf.file}: no gripper fits {arm.name!r}; name one under `grippers` in its model.yaml")
    found = [_check_with(arm, gripper, locations) for gripper in grippers]
    if all(one["ok"] is None for one in found):
        raise ConfigError(f"{arm.mjcf.file}: no gripper makes a rig with {arm.name!r}: {found[0]['detail']}")
    return found


def _check_with(arm: ArmModel, gripper: str, locations: Locations) -> dict[str, Any]:
    try:
        rig = load_config(RigConfig, "rigs", f"{arm.name}+{gripper}", locations)
    except ConfigError as error:
        return {"gripper": gripper, "ok": None, "sag_rad": None, "detail": str(error)}
    try:
        scene = build_rig_scene(rig, load_config(SceneConfig, "scenes", "studio", locations), locations)
    except SimulationError as error:
        return {"gripper": gripper, "ok": False, "sag_rad": None, "detail": str(error)}
    model, addresses = scene.model, scene.arms[0]
    data = mujoco.MjData(model)
    home = np.array(arm.home)
    data.qpos[addresses.joint_qpos], data.ctrl[addresses.arm_ctrl] = home, home
    mujoco.mj_step(model, data, nstep=int(_HOLD_S / model.opt.timestep))
    off = np.abs(data.qpos[addresses.joint_qpos] - home)
    joint, sag = arm.joints[int(np.argmax(off))].name, float(off.max())
    ok = bool(np.isfinite(off).all() and sag <= _MOST_SAG)
    detail = f"{joint} is {sag:.3f} rad off home after {_HOLD_S:g} s; at most {_MOST_SAG:g} rad is right"
    return {"gripper": gripper, "ok": ok, "sag_rad": sag, "detail": detail}


def require_checked(name: str, found: list[dict[str, Any]]) -> None:
    """Make sure that an arm passed with each gripper.

    Raises:
        SimulationError: it did not with one.
    """
    for one in found:
        if one["ok"] is False:
            raise SimulationError(f"arm {name!r} with {one['gripper']}: {one['detail']}")
