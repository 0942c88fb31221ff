"""Loads a config by name or file into a checked model. Errors name the file, the key, the value and what is valid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ..documents.base import Config, ConflictError, Reference
from ..documents.document import Document, KeyPath, is_setting, parse_yaml
from ..documents.explain import dotted, explain, explain_conflict, kind_instead, mapped_to, models_in
from ..documents.units import AS_RECORDED
from ..errors import ConfigError, UsageError, suggest
from ..resources import Locations
from ..robots.dynamics import Dynamics
from ..robots.models import ArmModel, Gripper
from . import robot_names
from .cameras.camera import CameraConfig
from .older_tasks import OLDER_KINDS, upgrade_task
from .pictures import RenderConfig
from .policy import PolicyConfig
from .program_task import PROGRAM, ProgramTask
from .randomization import RandomizationConfig
from .real import RecordingNames
from .recording import RecordConfig
from .rig import RigConfig
from .scene import SceneConfig
from .things.thing import ObjectConfig

KINDS: Mapping[str, type[Config]] = {
    "rigs": RigConfig,
    "scenes": SceneConfig,
    "tasks": ProgramTask,
    "objects": ObjectConfig,
    "cameras": CameraConfig,
    "quality": RenderConfig,
    "randomization": RandomizationConfig,
    "policies": PolicyConfig,
    "record": RecordConfig,
    "recordings": RecordingNames,
    "robots": ArmModel,
    "grippers": Gripper,
    "revisions": Dynamics,
}

# The key by which an override asks for another revision of a rig's robots; between a robot's name and its gripper's.
REVISION = "revision"
# The key by which one puts how an arm moves over the arms of a rig that it is of.
ROBOT = "robot"
_JOINED = "+"
_DYNAMICS = "revisions"

C = TypeVar("C", bound=Config)

Check = Callable[[Config], None]


def model_of(kind: str) -> type[Config]:
    """The model of a kind of config.

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError(f"unknown kind of config {kind!r}; {suggest(kind, KINDS)}")
    return KINDS[kind]


def _require_task_kind(document: Document) -> None:
    """Make sure that a task's `kind`, which decides the keys that it may have, is a known one."""
    kind = document.data.get("kind")
    valid = (PROGRAM, *OLDER_KINDS)
    if kind is not None and kind not in valid:
        raise ConfigError(f"{document.place(('kind',))}: kind: unknown kind {kind!r}; {suggest(str(kind), valid)}")


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON schema of a kind of config. Raises as `model_of`."""
    return model_of(kind).model_json_schema()


def load_config(
    model: type[C],
    kind: str,
    name: str,
    locations: Locations,
    overrides: Mapping[KeyPath, tuple[str, Any]] | None = None,
    check: Check | None = None,
) -> C:
    """One config, loaded, with its references filled in, and checked.

    Args:
        model: the model it must fit.
        kind: folder under `configs/`.
        name: a config's name, or the path of a file, see `Locations.config_file`.
        overrides: key path -> (what set it, value), such as `("image", "jpeg_quality"): ("--jpeg-quality", 90)`.
        check: of what only floors above know; it raises a `ConflictError`.

    Raises:
        ConfigError: it is not valid; the message has file, line, key path, value and what would be valid.
        UsageError: the same, where the value at fault came by a flag or keyword in `overrides`.
    """
    document = _named(model, kind, name, locations)
    if instead := _other_kind(model, document):
        raise ConfigError(instead)
    # References are resolved between the two passes, so that a flag may reach inside a config named by another flag.
    changes = overrides or {}
    for path, (place, value) in changes.items():
        if len(path) == 1 and path[-1] not in (REVISION, ROBOT):
            document.set(path, value, place)
    _resolve_references(model, document, (), locations)
    for path, (place, value) in changes.items():
        if path[-1] == REVISION:
            _revise(document, path[:-1], value, place, locations)
        elif path[-1] == ROBOT:
            _move_as(document, path[:-1], value, place, locations)
        elif len(path) > 1:
            document.set(path, value, place)
    flags = {path: place for path, (place, _) in changes.items() if is_setting(place)}
    return _check(model, document, locations, flags, check=check)


def validate_file(
    model: type[C], path: Path, locations: Locations, *, as_recorded: bool = False, check: Check | None = None
) -> C:
    """A file's config, checked against a model; for `as_recorded` see `parse_config`, for `check` and what it raises
    `load_config`.
    """
    return _check(model, _read(model, path), locations, as_recorded=as_recorded, check=check)


def parse_config(model: type[C], text: str, source: str, locations: Locations, *, as_recorded: bool = False) -> C:
    """The config in YAML text, checked against a model. Raises as `load_config`.

    Args:
        as_recorded: the config is a dataset's own. Its values may be implausible, since it was recorded with them.
    """
    return _check(model, parse_yaml(text, source), locations, as_recorded=as_recorded)


def _named(model: type[Config], kind: str, name: str, locations: Locations) -> Document:
    """The document that a name means. Raises as `Locations.config_file`."""
    if kind == "rigs" and _JOINED in name and not name.endswith((".yaml", ".yml")):
        return _joined(name)
    if kind == robot_names.ARMS:
        name = robot_names.model_named(name, locations)
    return _read(model, locations.config_file(kind, name))


def _joined(name: str) -> Document:
    """A rig of one arm by the names of its robot and its gripper: `yam_pro+linear_4310`."""
    robot, _, gripper = name.partition(_JOINED)
    document = parse_yaml("{}", f"rig {name}")
    arm = {"name": "arm1", "side": "right", "model": robot, "gripper": gripper}
    document.data.update({"name": f"{robot}_{gripper}", "arms": [arm]})
    return document


def _revise(document: Document, path: KeyPath, revision: str, place: str, locations: Locations) -> None:
    """Put another revision of its family in for each arm of the rig at `path`."""
    for k, (model, _) in _arms(document, path).items():
        try:
            name = robot_names.revised(model, str(revision), locations)
        except ConfigError as error:
            raise (UsageError if is_setting(place) else ConfigError)(f"{place}: {error}") from error
        document.set((*path, "arms", k, "model"), name, place)


def _move_as(document: Document, path: KeyPath, files: Sequence[str], place: str, locations: Locations) -> None:
    """Put each of one's dynamics in for the arms of the rig at `path` that it is of: by their model and their side."""
    for file in files:
        try:
            dynamics = _named(Dynamics, _DYNAMICS, file, locations)
        except ConfigError as error:
            raise (UsageError if is_setting(place) else ConfigError)(f"{place}: {error}") from error
        if instead := _other_kind(Dynamics, dynamics):
            raise ConfigError(instead)
        base, side = _base(dynamics), dynamics.data.get("side")
        arms = _arms(document, path)
        meant = [k for k, (model, on) in arms.items() if model == base and side in (None, on)]
        for k in meant:
            document.graft((*path, "arms", k, "dynamics"), dynamics)
        if not meant:
            there = " and ".join(dict.fromkeys(f"{model!r} on the {on}" for model, on in arms.values()))
            raise (UsageError if is_setting(place) else ConfigError)(
                f"{place}: {file} is of {base!r}{f' on the {side}' if side else ''}, and the rig has {there}; choose "
                "another rig"
            )


def _arms(document: Document, path: KeyPath) -> dict[int, tuple[str, Any]]:
    """Number of an arm of the rig at `path` -> its robot model, and its side."""
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


def _read(model: type[Config], path: Path) -> Document:
    document = model.read(path)
    if "name" in model.model_fields:
        document.data.setdefault("name", path.stem)
    if model is ProgramTask:
        _upgrade(document.data)
    return document


def _upgrade(task: dict[str, Any]) -> None:
    """Write a task of an older kind as one of today's, in place."""
    upgraded = upgrade_task(task)
    task.clear()
    task.update(upgraded)


def _other_kind(model: type[Config], document: Document) -> str | None:
    """An error message if, judging by its keys, the file holds another kind of config; else None."""
    kind = next((kind for kind, known in KINDS.items() if known is model), None)
    if kind is None or (instead := kind_instead(KINDS, kind, document.data)) is None:
        return None
    keys = ", ".join(sorted(set(document.data) - {"name"})[:3])
    return f"{document.source}: is of the kind {instead!r}, to judge by its keys {keys}; give one of {kind!r}"


def _check(
    model: type[C],
    document: Document,
    locations: Locations,
    flags: Mapping[KeyPath, str] | None = None,
    *,
    as_recorded: bool = False,
    check: Check | None = None,
) -> C:
    if instead := _other_kind(model, document):
        raise ConfigError(instead)
    if model is ProgramTask and not as_recorded:
        _require_task_kind(document)
    _resolve_references(model, document, (), locations)
    try:
        config = model.model_validate(document.data, context=AS_RECORDED if as_recorded else None)
        if check is not None:
            check(config)
        return config
    except ValidationError as error:
        place, message = explain(model, document, error, flags or {})
        cause: Exception = error
    except ConflictError as error:
        place, message = explain_conflict(document, error, flags or {})
        cause = error
    # A bad value that came by a flag is a fault of the command line, not of any config.
    kind = UsageError if is_setting(place) else ConfigError
    raise kind(f"{place}: {message}") from cause


def _references(model: type[Config]) -> Iterator[tuple[str, str, type[Config]]]:
    for name, info in model.model_fields.items():
        for mark in info.metadata:
            if isinstance(mark, Reference):
                yield name, mark.kind, KINDS[mark.kind]


def _resolve_references(model: type[Config], document: Document, path: KeyPath, locations: Locations) -> None:
    """Replace the names of other configs by their content, in place."""
    here: Any = document.data
    for key in path:
        here = here[key]
    if model is ProgramTask:
        _upgrade(here)
    for name, kind, target in _references(model):
        items = list(here[name]) if isinstance(here.get(name), list) else None
        named = {(*path, name): here.get(name)} if items is None else {(*path, name, k): v for k, v in enumerate(items)}
        for inner, value in named.items():
            if isinstance(value, str):
                _put_in(document, inner, kind, target, value, locations)
            if isinstance(value, str | dict):
                _resolve_references(target, document, inner, locations)
    for name, info in model.model_fields.items():
        if any(isinstance(mark, Reference) for mark in info.metadata):
            continue
        value = here.get(name)
        inside: dict[KeyPath, Any] = {(*path, name): value}
        parts, values = models_in(info.annotation), mapped_to(info.annotation)
        if isinstance(value, list):
            inside = {(*path, name, k): item for k, item in enumerate(value)}
        elif values is not None and isinstance(value, dict):
            inside, parts = {(*path, name, key): item for key, item in value.items()}, models_in(values)
        for inner, item in inside.items():
            for part in parts if isinstance(item, dict) else ():
                if issubclass(part, Config):
                    _resolve_references(part, document, inner, locations)


def _put_in(
    document: Document, path: KeyPath, kind: str, target: type[Config], name: str, locations: Locations
) -> None:
    """Replace the name of a config at `path` by its content."""
    if kind == robot_names.ARMS and name.endswith((".yaml", ".yml")):
        name = _with_dynamics(document, path, name, locations)
    try:
        other = _named(target, kind, name, locations)
    except ConfigError as error:
        raise ConfigError(f"{document.place(path)}: {dotted(path)}: {error}") from error
    if instead := _other_kind(target, other):
        raise ConfigError(f"{document.place(path)}: {dotted(path)}: {instead}")
    document.graft(path, other)


def _with_dynamics(document: Document, path: KeyPath, file: str, locations: Locations) -> str:
    """The robot model of a file of dynamics, which is named in its place at `path` and put in beside it."""
    key = (*path[:-1], "dynamics")
    try:
        dynamics = _named(Dynamics, _DYNAMICS, file, locations)
    except ConfigError as error:
        raise ConfigError(f"{document.place(path)}: {dotted(path)}: {error}") from error
    document.graft(key, dynamics)
    return _base(dynamics)


def _base(dynamics: Document) -> str:
    """The robot model that one's dynamics are of."""
    base = dynamics.data.get("base")
    if not isinstance(base, str):
        raise ConfigError(f"{dynamics.place(('base',))}: base: {base!r} is no robot model; name the one it is of")
    return base
