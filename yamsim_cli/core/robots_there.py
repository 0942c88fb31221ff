"""Which arms, grippers and stations there are, what goes together, and which of their meshes are here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from .assets import AssetStore, load_lock
from .config.loader import load_config
from .config.rig import RigConfig
from .config.robot_names import ARMS, GRIPPERS, families
from .errors import UsageError, suggest
from .resources import Locations
from .robots.models import ArmModel, Gripper, fit
from .scene.compose import rig_mesh_sets

ARM, GRIPPER, STATION = "arm", "gripper", "station"


def robots_there(locations: Locations) -> tuple[dict[str, Any], ...]:
    """Every arm, gripper and station as plain data: first the arms, then the grippers, then the rigs with two arms.

    Raises:
        ConfigError: one of them is not valid.
    """
    meshes = _meshes(locations)
    arms = {name: load_config(ArmModel, ARMS, name, locations) for name in locations.config_names(ARMS)}
    grippers = {name: load_config(Gripper, GRIPPERS, name, locations) for name in locations.config_names(GRIPPERS)}
    newest = {list(revisions.values())[-1] for revisions in families(locations).values()}
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
        UsageError: there is none.
    """
    items = robots_there(locations)
    for item in items:
        if name == item["name"] or (item.get("newest") and name == item["family"]):
            return item
    known = [*(item["name"] for item in items), *families(locations)]
    raise UsageError(f"unknown robot {name!r}; {suggest(name, known)}")


def _stations(locations: Locations, meshes: Mapping[str, bool]) -> Iterator[dict[str, Any]]:
    for name in locations.config_names("rigs"):
        rig = load_config(RigConfig, "rigs", name, locations)
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
    """Asset set -> whether it is here."""
    store = AssetStore(locations.assets)
    return {name: store.resolve(assets) is not None for name, assets in load_lock(locations).sets.items()}


def _common(source: str | None, path: str, sets: Iterable[str], meshes: Mapping[str, bool]) -> dict[str, Any]:
    return {"source": source, "path": path, "meshes": {name: meshes.get(name, False) for name in sets}}
