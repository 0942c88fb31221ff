"""Loads configs by name or file. Error messages contain the file, the key, the value and the valid values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ...camera_effects.config import CameraEffects
from ..errors import ConfigError, UsageError, suggest_similar
from ..files.documents.config_base import Config, ConfigReference, ConflictError
from ..files.documents.units import SKIP_BOUNDS_CONTEXT
from ..files.documents.validation_messages import (
    detect_other_kind,
    explain_conflict,
    explain_validation_error,
    format_key_path,
    mapping_value_type,
    models_in,
)
from ..files.documents.yaml_document import Document, KeyPath, is_setting, parse_yaml
from ..files.resources import Locations
from ..robots.dynamics import MeasuredArmDynamics
from ..robots.models import ArmModel, Gripper
from . import robot_families as robot_names
from .cameras.camera import CameraConfig
from .objects.object_config import ObjectConfig
from .policy import PolicyConfig
from .program_task import PROGRAM_KIND, ProgramTask
from .randomization import RandomizationConfig
from .real_recordings import RecordingNames
from .recording import RecordConfig
from .rendering import RenderConfig
from .rig import RigConfig
from .scene import SceneConfig
from .task_migration import OLDER_KINDS, upgrade_task

CONFIG_KINDS: Mapping[str, type[Config]] = {
    "rigs": RigConfig,
    "scenes": SceneConfig,
    "tasks": ProgramTask,
    "objects": ObjectConfig,
    "cameras": CameraConfig,
    "camera_effects": CameraEffects,
    "quality": RenderConfig,
    "randomization": RandomizationConfig,
    "policies": PolicyConfig,
    "record": RecordConfig,
    "recordings": RecordingNames,
    "robots": ArmModel,
    "grippers": Gripper,
    "revisions": MeasuredArmDynamics,
}

REVISION_KEY = "revision"  # last key of an override path below a rig: the version of its arm models to use
DYNAMICS_KEY = "robot"  # last key of an override path below a rig: files with measured dynamics of its arms
_ARM_GRIPPER_SEPARATOR = "+"  # separator of arm and gripper in the name of a rig, such as `yam_pro+linear_4310`
_DYNAMICS_CONFIG_KIND = "revisions"

C = TypeVar("C", bound=Config)

ConfigCheck = Callable[[Config], None]
UpgradeFunction = Callable[[dict[str, Any]], dict[str, Any]]


def config_model(kind: str) -> type[Config]:
    """Return the class of a kind of config, such as `rigs`. Raises ConfigError if no kind has that name."""
    if kind not in CONFIG_KINDS:
        raise ConfigError(f"unknown kind of config {kind!r}; {suggest_similar(kind, CONFIG_KINDS)}")
    return CONFIG_KINDS[kind]


def _require_task_kind(document: Document) -> None:
    kind = document.data.get("kind")
    valid = (PROGRAM_KIND, *OLDER_KINDS)
    if kind is not None and kind not in valid:
        raise ConfigError(
            f"{document.place_of(('kind',))}: kind: unknown kind {kind!r}; {suggest_similar(str(kind), valid)}"
        )


def load_config(
    model: type[C],
    kind: str,
    name: str,
    locations: Locations,
    overrides: Mapping[KeyPath, tuple[str, Any]] | None = None,
    check: ConfigCheck | None = None,
) -> C:
    """Read a config, insert the configs that it names, apply overrides, and return the validated result.

    Args:
        kind: folder under `configs/`.
        name: a config's name, or the path of its file.
        overrides: key path -> (flag or keyword, value), such as `("image", "jpeg_quality"): ("--jpeg-quality", 90)`.
        check: an additional check, which raises a `ConflictError` for a config that is not valid.

    Raises:
        ConfigError: the config is not valid; the message has file, line, key path, value and valid values.
        UsageError: the same for a value from a flag or keyword in `overrides`.
    """
    document = _load_named(model, kind, name, locations)
    if instead := _explain_other_kind(model, document):
        raise ConfigError(instead)
    # Override top-level keys first, then insert named configs, then override other keys, also of inserted configs.
    changes = overrides or {}
    for path, (place, value) in changes.items():
        if len(path) == 1 and path[-1] not in (REVISION_KEY, DYNAMICS_KEY):
            document.override_value(path, value, place)
    _resolve_references(model, document, (), locations)
    for path, (place, value) in changes.items():
        if path[-1] == REVISION_KEY:
            _set_robot_revision(document, path[:-1], value, place, locations)
        elif path[-1] == DYNAMICS_KEY:
            _add_dynamics(document, path[:-1], value, place, locations)
        elif len(path) > 1:
            document.override_value(path, value, place)
    flags = {path: place for path, (place, _) in changes.items() if is_setting(place)}
    return _validate_document(model, document, locations, flags, check=check)


def validate_file(model: type[C], path: Path, locations: Locations, *, check: ConfigCheck | None = None) -> C:
    """Return the validated config in a file; for arguments and errors, see `parse_config` and `load_config`."""
    return _validate_document(model, _read_config_document(model, path), locations, check=check)


def parse_config(
    model: type[C], text: str, source: str, locations: Locations, *, upgrade: UpgradeFunction | None = None
) -> C:
    """Return the validated config in YAML text. Raises as `load_config`.

    Args:
        upgrade: for the config of a recorded dataset, a function that returns its content in the present form. Values
            out of plausible bounds are then accepted.
    """
    document = parse_yaml(text, source)
    if upgrade is not None:
        document.data = upgrade(document.data)
    return _validate_document(model, document, locations, recorded=upgrade is not None)


def _load_named(model: type[Config], kind: str, name: str, locations: Locations) -> Document:
    if kind == "rigs" and _ARM_GRIPPER_SEPARATOR in name and not name.endswith((".yaml", ".yml")):
        return _single_arm_rig(name)
    if kind == robot_names.ARMS:
        name = robot_names.resolve_model_name(name, locations)
    return _read_config_document(model, locations.config_file(kind, name))


def _single_arm_rig(name: str) -> Document:
    """Return a rig of one arm from the names of robot and gripper: `yam_pro+linear_4310`."""
    robot, _, gripper = name.partition(_ARM_GRIPPER_SEPARATOR)
    document = parse_yaml("{}", f"rig {name}")
    arm = {"name": "arm1", "side": "right", "model": robot, "gripper": gripper}
    document.data.update({"name": f"{robot}_{gripper}", "arms": [arm]})
    return document


def _set_robot_revision(document: Document, path: KeyPath, revision: str, place: str, locations: Locations) -> None:
    for k, (model, _) in _arm_models_and_sides(document, path).items():
        try:
            name = robot_names.other_revision(model, str(revision), locations)
        except ConfigError as error:
            raise (UsageError if is_setting(place) else ConfigError)(f"{place}: {error}") from error
        document.override_value((*path, "arms", k, "model"), name, place)


def _add_dynamics(document: Document, path: KeyPath, files: Sequence[str], place: str, locations: Locations) -> None:
    """Add the dynamics in each file to the arms with the same model and side in the rig at `path`."""
    for file in files:
        try:
            dynamics = _load_named(MeasuredArmDynamics, _DYNAMICS_CONFIG_KIND, file, locations)
        except ConfigError as error:
            raise (UsageError if is_setting(place) else ConfigError)(f"{place}: {error}") from error
        if instead := _explain_other_kind(MeasuredArmDynamics, dynamics):
            raise ConfigError(instead)
        base, side = _base_model_name(dynamics), dynamics.data.get("side")
        arms = _arm_models_and_sides(document, path)
        matching = [k for k, (model, on) in arms.items() if model == base and side in (None, on)]
        for k in matching:
            document.insert_document((*path, "arms", k, "dynamics"), dynamics)
        if not matching:
            there = " and ".join(dict.fromkeys(f"{model!r} on the {on}" for model, on in arms.values()))
            raise (UsageError if is_setting(place) else ConfigError)(
                f"{place}: {file} is for {base!r}{f' on the {side}' if side else ''}, but the rig has {there}; "
                "choose another rig"
            )


def _arm_models_and_sides(document: Document, path: KeyPath) -> dict[int, tuple[str, Any]]:
    rig: Any = document.data
    for key in path:
        rig = rig[key]
    arms = rig.get("arms") if isinstance(rig, dict) else None
    found: dict[int, tuple[str, Any]] = {}
    for k, arm in enumerate(arms if isinstance(arms, list) else ()):
        model = arm.get("model") if isinstance(arm, dict) else None
        name = model.get("name") if isinstance(model, dict) else model
        if isinstance(name, str):
            found[k] = name, arm.get("side")
    return found


def _read_config_document(model: type[Config], path: Path) -> Document:
    document = model.read_document(path)
    if "name" in model.model_fields:
        document.data.setdefault("name", path.stem)
    if model is ProgramTask:
        _upgrade_task_in_place(document.data)
    return document


def _upgrade_task_in_place(task: dict[str, Any]) -> None:
    upgraded = upgrade_task(task)
    task.clear()
    task.update(upgraded)


def _explain_other_kind(model: type[Config], document: Document) -> str | None:
    """Return an error message if the file has the keys of another kind of config; else None."""
    kind = next((kind for kind, known in CONFIG_KINDS.items() if known is model), None)
    if kind is None or (instead := detect_other_kind(CONFIG_KINDS, kind, document.data)) is None:
        return None
    keys = ", ".join(sorted(set(document.data) - {"name"})[:3])
    return f"{document.source}: has keys of the kind {instead!r} ({keys}); give a file of the kind {kind!r}"


def _validate_document(
    model: type[C],
    document: Document,
    locations: Locations,
    flags: Mapping[KeyPath, str] | None = None,
    *,
    recorded: bool = False,
    check: ConfigCheck | None = None,
) -> C:
    if instead := _explain_other_kind(model, document):
        raise ConfigError(instead)
    if model is ProgramTask and not recorded:
        _require_task_kind(document)
    _resolve_references(model, document, (), locations)
    try:
        config = model.model_validate(document.data, context=SKIP_BOUNDS_CONTEXT if recorded else None)
        if check is not None:
            check(config)
        return config
    except ValidationError as error:
        place, message = explain_validation_error(model, document, error, flags or {})
        cause: Exception = error
    except ConflictError as error:
        place, message = explain_conflict(document, error, flags or {})
        cause = error
    kind = UsageError if is_setting(place) else ConfigError
    raise kind(f"{place}: {message}") from cause


def _config_references(model: type[Config]) -> Iterator[tuple[str, str, type[Config]]]:
    for name, info in model.model_fields.items():
        for mark in info.metadata:
            if isinstance(mark, ConfigReference):
                yield name, mark.kind, CONFIG_KINDS[mark.kind]


def _resolve_references(model: type[Config], document: Document, path: KeyPath, locations: Locations) -> None:
    """Replace names of other configs, in the data at `path` and below, by the content of those configs."""
    here: Any = document.data
    for key in path:
        here = here[key]
    if model is ProgramTask:
        _upgrade_task_in_place(here)
    for name, kind, target in _config_references(model):
        items = list(here[name]) if isinstance(here.get(name), list) else None
        named = {(*path, name): here.get(name)} if items is None else {(*path, name, k): v for k, v in enumerate(items)}
        for inner, value in named.items():
            if isinstance(value, str):
                _insert_referenced_config(document, inner, kind, target, value, locations)
            if isinstance(value, str | dict):
                _resolve_references(target, document, inner, locations)
    for name, info in model.model_fields.items():
        if any(isinstance(mark, ConfigReference) for mark in info.metadata):
            continue
        value = here.get(name)
        inside: dict[KeyPath, Any] = {(*path, name): value}
        parts, values = models_in(info.annotation), mapping_value_type(info.annotation)
        if isinstance(value, list):
            inside = {(*path, name, k): item for k, item in enumerate(value)}
        elif values is not None and isinstance(value, dict):
            inside, parts = {(*path, name, key): item for key, item in value.items()}, models_in(values)
        for inner, item in inside.items():
            for part in parts if isinstance(item, dict) else ():
                if issubclass(part, Config):
                    _resolve_references(part, document, inner, locations)


def _insert_referenced_config(
    document: Document, path: KeyPath, kind: str, target: type[Config], name: str, locations: Locations
) -> None:
    if kind == robot_names.ARMS and name.endswith((".yaml", ".yml")):
        name = _with_dynamics(document, path, name, locations)
    try:
        other = _load_named(target, kind, name, locations)
    except ConfigError as error:
        raise ConfigError(f"{document.place_of(path)}: {format_key_path(path)}: {error}") from error
    if instead := _explain_other_kind(target, other):
        raise ConfigError(f"{document.place_of(path)}: {format_key_path(path)}: {instead}")
    document.insert_document(path, other)


def _with_dynamics(document: Document, path: KeyPath, file: str, locations: Locations) -> str:
    """Add the dynamics in a file beside the `model` at `path`, and return the name of the robot model."""
    key = (*path[:-1], "dynamics")
    try:
        dynamics = _load_named(MeasuredArmDynamics, _DYNAMICS_CONFIG_KIND, file, locations)
    except ConfigError as error:
        raise ConfigError(f"{document.place_of(path)}: {format_key_path(path)}: {error}") from error
    document.insert_document(key, dynamics)
    return _base_model_name(dynamics)


def _base_model_name(dynamics: Document) -> str:
    base = dynamics.data.get("base")
    if not isinstance(base, str):
        raise ConfigError(
            f"{dynamics.place_of(('base',))}: base: {base!r} is not a robot model; "
            f"give the model that has these dynamics"
        )
    return base
