"""Lists robots, writes template files for a new arm, and checks an arm in simulation."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from .core.config.loader import load_config
from .core.config.rig import RigConfig
from .core.config.robot_families import ARMS, GRIPPERS, valid_families
from .core.config.scene import SceneConfig
from .core.errors import ConfigError, SimulationError, UsageError, suggest_similar
from .core.files.resources import Locations
from .core.files.writing import describe_refusal, write_file
from .core.robots.models import ArmModel, Gripper, find_gripper_fit
from .core.scene.assets import AssetStore, load_lock
from .core.scene.build import build_rig_scene
from .core.scene.compose import rig_mesh_sets

_VALID_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_HOLD_TEST_SECONDS = 1.0  # s, for which the arm holds its home posture: the drives settle
_MAX_SAG = 0.1  # rad, deviation of a joint after `_HOLD_TEST_SECONDS`; a weak drive exceeds it

_YAML_TEMPLATE = """\
# The arm {name}. To check it: `yamsim robots check {name}`. To use it in any command: `--rig {name}+linear_4310`.
mjcf: arm.xml
source: a skeleton, its figures are invented   # the source of your figures
base: base_link     # the body in arm.xml whose frame is the arm's base frame
flange: flange      # the last body; a gripper becomes part of it

# Joints from the base to the flange: joint limits, rad; the motor's no-load speed at the joint, revolutions a minute;
# and the largest speed that the drive can report, rad/s. Joints and drives have these names in arm.xml.
joints:
- {{name: joint1, range: [-3.0, 3.0], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint2, range: [-1.8, 1.8], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint3, range: [0.0, 2.8], motor_rpm: 52.5, reported_rad_s: 10}}
- {{name: joint4, range: [-0.5, 3.0], motor_rpm: 200, reported_rad_s: 30}}
- {{name: joint5, range: [-1.5, 1.5], motor_rpm: 200, reported_rad_s: 30}}
- {{name: joint6, range: [-3.1, 3.1], motor_rpm: 200, reported_rad_s: 30}}
home: [0, -0.4, 2.0, 1.5, 0, 0]      # joint positions of the idle arm, rad
start: [0, 0.3, 1.29, 1.55, 0, 0]    # joint positions at the start of tasks, rad

# Gripper -> how it is mounted on the flange: `mount: {{position: [x, y, z], quat: [w, x, y, z]}}`, m.
grippers:
  linear_4310: {{}}
"""

_XML_TEMPLATE = """\
<!-- From the base to the flange, with a position drive for each joint. Lengths in m, masses in kg. -->
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <default class="{name}">
      <joint axis="0 1 0" armature="0.02" frictionloss="0.1"/>
      <!-- kp in N m/rad, kv in N m s/rad, torques in N m; the range is the joint's. -->
      <position inheritrange="1" kp="80" kv="5" forcerange="-28 28"/>
      <!-- Collision geometry; masses are in the <inertial> of each body. -->
      <geom type="capsule" size="0.025" group="3" mass="0" rgba="0.5 0.5 0.5 1"/>
    </default>
  </default>
  <worldbody>
    <body name="base_link" childclass="{name}">
      <inertial mass="1" pos="0 0 0.02" diaginertia="0.002 0.002 0.002"/>
      <geom type="cylinder" size="0.05 0.02" pos="0 0 0.02"/>
      <!-- gravcomp="1": the drives compensate for the body's weight. -->
      <body name="link1" pos="0 0 0.06" gravcomp="1">
        <inertial mass="0.3" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
        <joint name="joint1" axis="0 0 1"/>
        <body name="link2" pos="0 0 0.06" gravcomp="1">
          <inertial mass="0.8" pos="0 0 0.17" diaginertia="0.008 0.008 0.0004"/>
          <joint name="joint2"/>
          <geom fromto="0 0 0 0 0 0.30"/>
          <body name="link3" pos="0 0 0.34" gravcomp="1">
            <inertial mass="0.5" pos="0 0 0.16" diaginertia="0.004 0.004 0.0003"/>
            <joint name="joint3"/>
            <geom fromto="0 0 0.06 0 0 0.24" size="0.02"/>
            <body name="link4" pos="0 0 0.30" gravcomp="1">
              <inertial mass="0.2" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
              <joint name="joint4"/>
              <body name="link5" pos="0 0 0.05" gravcomp="1">
                <inertial mass="0.2" pos="0 0 0.02" diaginertia="0.0002 0.0002 0.0002"/>
                <joint name="joint5" axis="1 0 0"/>
                <body name="flange" pos="0 0 0.04" gravcomp="1">
                  <inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>
                  <joint name="joint6" axis="0 0 1"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
{drives}
  </actuator>
</mujoco>
"""

ARM, GRIPPER, STATION = "arm", "gripper", "station"  # values of `kind` in entries


def robot_entries(locations: Locations) -> tuple[dict[str, Any], ...]:
    """Return one dictionary for each arm, gripper and station (rig with two arms), in this order.

    An invalid arm or station has the error as `fault`, and no parts in `goes_with`.
    """
    meshes = _present_mesh_sets(locations)
    families, faults = valid_families(locations)
    arms, broken_arms = _loaded_arms(locations, faults)
    grippers = {name: load_config(Gripper, GRIPPERS, name, locations) for name in locations.config_names(GRIPPERS)}
    newest = {list(revisions.values())[-1] for revisions in families.values()}
    pairs = {(arm, gripper) for arm in arms for gripper in grippers if _can_mount(arms[arm], grippers[gripper])}
    found: list[dict[str, Any]] = []
    for name, arm in arms.items():
        found.append(
            {
                "kind": ARM,
                "name": name,
                "family": arm.family,
                "revision": arm.revision,
                "newest": name in newest,
                "joints": len(arm.joints),
                "goes_with": [gripper for gripper in grippers if (name, gripper) in pairs],
                **_common_fields(arm.source, arm.mjcf.file, arm.mesh_sets, meshes),
            }
        )
    found += [_invalid_entry(ARM, ARMS, name, fault, locations) for name, fault in broken_arms.items()]
    for name, gripper in grippers.items():
        fingers = gripper.fingers
        found.append(
            {
                "kind": GRIPPER,
                "name": name,
                "opens_mm": round(2000 * fingers.full_opening, 1) if fingers else 0.0,
                "pads": fingers is not None and fingers.pads,
                "goes_with": [arm for arm in arms if (arm, name) in pairs],
                **_common_fields(gripper.source, gripper.mjcf.file, gripper.mesh_sets, meshes),
            }
        )
    return (*found, *_station_entries(locations, meshes))


def robot_entry(name: str, locations: Locations) -> dict[str, Any]:
    """Return the dictionary of an arm, gripper or station. A family of arms gives its newest version."""
    items = robot_entries(locations)
    for item in items:
        if name == item["name"] or (item.get("newest") and name == item["family"]):
            if "fault" in item:
                raise ConfigError(item["fault"])
            return item
    known = {*(item["name"] for item in items), *valid_families(locations)[0]}
    raise UsageError(f"unknown robot {name!r}; {suggest_similar(name, known)}")


def _loaded_arms(
    locations: Locations, faults: Mapping[str, ConfigError]
) -> tuple[dict[str, ArmModel], dict[str, ConfigError]]:
    loaded, broken = dict[str, ArmModel](), dict(faults)
    for name in locations.config_names(ARMS):
        try:
            if name not in broken:
                loaded[name] = load_config(ArmModel, ARMS, name, locations)
        except ConfigError as error:
            broken[name] = error
    return loaded, broken


def _invalid_entry(what: str, kind: str, name: str, fault: ConfigError, locations: Locations) -> dict[str, Any]:
    path = str(locations.config_file(kind, name))
    return {"kind": what, "name": name, "goes_with": [], **_common_fields(None, path, (), {}), "fault": str(fault)}


def _station_entries(locations: Locations, meshes: Mapping[str, bool]) -> Iterator[dict[str, Any]]:
    for name in locations.config_names("rigs"):
        try:
            rig = load_config(RigConfig, "rigs", name, locations)
        except ConfigError as error:
            yield _invalid_entry(STATION, "rigs", name, error, locations)
            continue
        if len(rig.arms) > 1:
            yield {
                "kind": STATION,
                "name": name,
                "cameras": list(rig.camera_names),
                "goes_with": [f"{arm.model.name}+{arm.gripper.name}" for arm in rig.arms],
                **_common_fields(None, str(locations.config_file("rigs", name)), rig_mesh_sets(rig), meshes),
            }


def _can_mount(arm: ArmModel, gripper: Gripper) -> bool:
    try:
        find_gripper_fit(arm, gripper)
    except ValueError:
        return False
    return True


def _present_mesh_sets(locations: Locations) -> dict[str, bool]:
    store = AssetStore(locations.assets)
    return {name: store.find_verified_folder(assets) is not None for name, assets in load_lock(locations).sets.items()}


def _common_fields(source: str | None, path: str, sets: Iterable[str], meshes: Mapping[str, bool]) -> dict[str, Any]:
    return {"source": source, "path": path, "meshes": {name: meshes.get(name, False) for name in sets}}


def write_robot_template(name: str, data: Path, locations: Locations) -> tuple[Path, ...]:
    """Write the template files of a new arm below the data directory `data`, and return their paths."""
    if not _VALID_NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is not a valid name for an arm; use letters, digits and underscores, and begin with a letter"
        )
    folder = data / "robot_models" / name
    if folder.exists() or name in locations.config_names(ARMS):
        raise UsageError(f"an arm {name!r} exists and is not overwritten; give another name, or remove {folder}")
    paths = []
    try:
        folder.mkdir(parents=True)
        for file, text in _arm_files(name).items():
            write_file(folder / file, text.encode())
            paths.append(folder / file)
    except OSError as error:
        raise UsageError(describe_refusal(error, folder)) from error
    return tuple(paths)


def _arm_files(name: str) -> Mapping[str, str]:
    names = [f"joint{k}" for k in range(1, 7)]
    drives = "\n".join(f'    <position name="{one}" joint="{one}" class="{name}"/>' for one in names)
    return {"model.yaml": _YAML_TEMPLATE.format(name=name), "arm.xml": _XML_TEMPLATE.format(name=name, drives=drives)}


def check_robot(name: str, locations: Locations) -> list[dict[str, Any]]:
    """Check an arm with each gripper that fits: the scene compiles, and the drives hold the home posture.

    Returns:
        For each gripper: `gripper`, `ok` (None if the pair makes no rig, for example without a wrist camera), `sag_rad`
        (largest deviation of a joint from home), `detail`.
    """
    if name in locations.config_names(GRIPPERS):
        arms = ", ".join(robot_entry(name, locations)["goes_with"]) or "none"
        raise UsageError(f"{name!r} is a gripper; check an arm that carries it, which tries the gripper too: {arms}")
    arm = load_config(ArmModel, ARMS, name, locations)
    grippers = robot_entry(arm.name, locations)["goes_with"]
    if not grippers:
        raise ConfigError(f"{arm.mjcf.file}: no gripper fits {arm.name!r}; name one under `grippers` in its model.yaml")
    # If two arms in one folder have the same revision, `valid_families` may blame the other arm: check this one's file.
    file = str(locations.config_file(ARMS, arm.name))
    for fault in valid_families(locations)[1].values():
        if file in str(fault):
            raise fault
    found = [_check_arm_with_gripper(arm, gripper, locations) for gripper in grippers]
    if all(one["ok"] is None for one in found):
        # A fault of the arm is the same with most grippers; a gripper without a wrist camera is a separate fault.
        details = [one["detail"] for one in found]
        fault_text = max(details, key=details.count)
        raise ConfigError(f"{arm.mjcf.file}: no gripper makes a rig with {arm.name!r}: {fault_text}")
    return found


def _check_arm_with_gripper(arm: ArmModel, gripper: str, locations: Locations) -> dict[str, Any]:
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
    mujoco.mj_step(model, data, nstep=int(_HOLD_TEST_SECONDS / model.opt.timestep))
    off = np.abs(data.qpos[addresses.joint_qpos] - home)
    joint, sag = arm.joints[int(np.argmax(off))].name, float(off.max())
    ok = bool(np.isfinite(off).all() and sag <= _MAX_SAG)
    detail = f"{joint} is {sag:.3f} rad off home after {_HOLD_TEST_SECONDS:g} s; at most {_MAX_SAG:g} rad is allowed"
    return {"gripper": gripper, "ok": ok, "sag_rad": sag, "detail": detail}


def require_checked(name: str, found: list[dict[str, Any]]) -> None:
    """Raise SimulationError if an arm failed the check with any gripper."""
    for one in found:
        if one["ok"] is False:
            raise SimulationError(f"arm {name!r} with {one['gripper']}: {one['detail']}")
