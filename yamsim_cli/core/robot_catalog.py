"""Lists arms, grippers and stations, their combinations, and which of their meshes are in the store."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from .assets import AssetStore, load_lock
from .config.loader import load_config
from .config.rig import RigConfig
from .config.robot_names import ARMS, GRIPPERS, valid_families
from .errors import ConfigError, UsageError, suggest
from .resources import Locations
from .robots.models import ArmModel, Gripper, fit
from .scene.compose import rig_mesh_sets

ARM, GRIPPER, STATION = "arm", "gripper", "station"


def robots_there(locations: Locations) -> tuple[dict[str, Any], ...]:
    """Every arm, gripper and rig with two arms, in this order, as plain data.

    An arm or a station with an invalid file has its error as `fault`, and an empty `goes_with`.

    Raises:
        ConfigError: a gripper's file is not valid.
    """
    meshes = _meshes(locations)
    families, faults = valid_families(locations)
    arms, broken_arms = _loaded_arms(locations, faults)
    grippers = {name: load_config(Gripper, GRIPPERS, name, locations) for name in locations.config_names(GRIPPERS)}
    newest = {list(revisions.values())[-1] for revisions in families.values()}
    pairs = {(arm, gripper) for arm in arms for gripper in grippers if _fits(arms[arm], grippers[gripper])}
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
                **_common(arm.source, arm.mjcf.file, arm.mesh_sets, meshes),
            }
        )
    found += [_faulty(ARM, ARMS, name, fault, locations) for name, fault in broken_arms.items()]
    for name, gripper in grippers.items():
        fingers = gripper.fingers
        found.append(
            {
                "kind": GRIPPER,
                "name": name,
                "opens_mm": round(2000 * fingers.full_opening, 1) if fingers else 0.0,
                "pads": fingers is not None and fingers.pads,
                "goes_with": [arm for arm in arms if (arm, name) in pairs],
                **_common(gripper.source, gripper.mjcf.file, gripper.mesh_sets, meshes),
            }
        )
    return (*found, *_stations(locations, meshes))


def robot_there(name: str, locations: Locations) -> dict[str, Any]:
    """The arm, gripper or station of that name; of a family, its newest revision.

    Raises:
        UsageError: there is no such robot.
        ConfigError: its file is not valid.
    """
    items = robots_there(locations)
    for item in items:
        if name == item["name"] or (item.get("newest") and name == item["family"]):
            if "fault" in item:
                raise ConfigError(item["fault"])
            return item
    known = [*(item["name"] for item in items), *valid_families(locations)[0]]
    raise UsageError(f"unknown robot {name!r}; {suggest(name, known)}")


def _loaded_arms(
    locations: Locations, faults: Mapping[str, ConfigError]
) -> tuple[dict[str, ArmModel], dict[str, ConfigError]]:
    """Name -> arm, and name -> fault of each invalid arm; `faults` has those of `valid_families`."""
    loaded, broken = dict[str, ArmModel](), dict(faults)
    for name in locations.config_names(ARMS):
        try:
            if name not in broken:
                loaded[name] = load_config(ArmModel, ARMS, name, locations)
        except ConfigError as error:
            broken[name] = error
    return loaded, broken


def _faulty(what: str, kind: str, name: str, fault: ConfigError, locations: Locations) -> dict[str, Any]:
    path = str(locations.config_file(kind, name))
    return {"kind": what, "name": name, "goes_with": [], **_common(None, path, (), {}), "fault": str(fault)}


def _stations(locations: Locations, meshes: Mapping[str, bool]) -> Iterator[dict[str, Any]]:
    for name in locations.config_names("rigs"):
        try:
            rig = load_config(RigConfig, "rigs", name, locations)
        except ConfigError as error:
            yield _faulty(STATION, "rigs", name, error, locations)
            continue
        if len(rig.arms) > 1:
            yield {
                "kind": STATION,
                "name": name,
                "cameras": list(rig.camera_names),
                "goes_with": [f"{arm.model.name}+{arm.gripper.name}" for arm in rig.arms],
                **_common(None, str(locations.config_file("rigs", name)), rig_mesh_sets(rig), meshes),
            }


def _fits(arm: ArmModel, gripper: Gripper) -> bool:
    try:
        fit(arm, gripper)
    except ValueError:
        return False
    return True


def _meshes(locations: Locations) -> dict[str, bool]:
    """Asset set -> whether the store has it."""
    store = AssetStore(locations.assets)
    return {name: store.resolve(assets) is not None for name, assets in load_lock(locations).sets.items()}


def _common(source: str | None, path: str, sets: Iterable[str], meshes: Mapping[str, bool]) -> dict[str, Any]:
    return {"source": source, "path": path, "meshes": {name: meshes.get(name, False) for name in sets}}
