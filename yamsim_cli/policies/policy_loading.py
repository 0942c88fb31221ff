from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from ..core.errors import UsageError, suggest_similar
from ..core.files.documents.yaml_document import number_or_text
from .policy_faults import describe_fault
from .policy_protocol import SCENE, STATE_REQUESTS, WRIST, Policy

_USER_POLICY_FORMS = "module:Class or file.py:Class"
# Policies of other programs: MolmoAct2's and GR00T's servers, openpi's, and LeRobot's checkpoints.
EXTERNAL_FORMS = ("act://HOST:PORT", "ws://HOST:PORT", "lerobot:CHECKPOINT")
POLICY_FORMS = (
    f"give scripted, hold_still, replay:DATASET, {', '.join(EXTERNAL_FORMS)}, http://HOST:PORT, {_USER_POLICY_FORMS}"
)

_POLICIES_WITHOUT_IMAGES = ("scripted", "hold_still", "replay")  # policies that need no rendering


def may_read_images(name: str) -> bool:
    """Whether the policy may read images, so that the machine must be able to render."""
    return name.partition(":")[0] not in _POLICIES_WITHOUT_IMAGES


def is_external(name: str) -> bool:
    """Whether `name` is a policy of another program: it starts with `act:`, `ws:` or `lerobot:`."""
    kind, colon, _ = name.partition(":")
    return bool(colon) and kind in (form.partition(":")[0] for form in EXTERNAL_FORMS)


def takes_keywords(name: str) -> bool:
    """Whether `name` is a class of the user, whose constructor may get keyword arguments."""
    return name.partition(":")[0] not in (*_POLICIES_WITHOUT_IMAGES, "http", "https") and not is_external(name)


def load_policy(
    name: str,
    folder: Path,
    forms: str = f"give {_USER_POLICY_FORMS}",
    arguments: Mapping[str, Any] | None = None,
    *,
    ignore_unknown_arguments: bool = False,
) -> Policy:
    """Load a policy of the user by `module:Class`, `file.py:Class`, or `file.py` with a single callable class.

    Modules and files are first searched in `folder`. With `ignore_unknown_arguments`, keywords that the class does not
    accept are dropped.
    """
    place, _, attribute = name.partition(":")
    is_file = place.endswith(".py")
    if not is_file and not attribute:
        raise UsageError(f"--policy {name!r} is not valid: {forms}")
    try:
        module = _load_file(folder / place) if is_file else _load_module(place, folder)
        found, keywords = _find_policy_class(module, attribute, name), dict(arguments or {})
        made = found(**(_accepted_keywords(found, keywords) if ignore_unknown_arguments else keywords))
    except UsageError:
        raise
    # Code of the user may raise any exception.
    except Exception as error:
        raise UsageError(f"--policy {name}: it cannot be loaded: {describe_fault(error, folder).text}") from error
    return check_policy(made, name)


def _accepted_keywords(function: Callable[..., Any], keywords: Mapping[str, Any]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters
    if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return dict(keywords)
    return {key: value for key, value in keywords.items() if key in parameters}


def read_arguments(given: Sequence[str]) -> dict[str, int | float | str]:
    """Parse texts `KEY=VALUE` to keywords. Numeric values become numbers."""
    arguments: dict[str, int | float | str] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.isidentifier():
            raise UsageError(f"--policy-arg {text!r} is not valid: give KEY=VALUE")
        if key in arguments:
            raise UsageError(f"--policy-arg {text!r}: {key} is given twice")
        arguments[key] = number_or_text(value)
    return arguments


def _load_module(name: str, folder: Path) -> ModuleType:
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return importlib.import_module(name)


def _load_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"yamsim_policy_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise UsageError(f"--policy {path}: there is no such file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    # Like a script, the file can import modules from its folder.
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    spec.loader.exec_module(module)
    return module


def _find_policy_class(module: ModuleType, attribute: str, name: str) -> Any:
    own = {key: value for key, value in vars(module).items() if inspect.isclass(value)}
    classes = {
        key: value
        for key, value in own.items()
        if value.__module__ == module.__name__ and any("__call__" in vars(base) for base in value.__mro__)
    }
    if attribute:
        if not hasattr(module, attribute):
            raise UsageError(f"--policy {name}: it has no {attribute!r}; {suggest_similar(attribute, classes)}")
        return getattr(module, attribute)
    if len(classes) != 1:
        found = f"has the policies {', '.join(classes)}" if classes else "has no class that can be called"
        raise UsageError(f"--policy {name} {found}: name one, as in {name}:{next(iter(classes), 'Class')}")
    return next(iter(classes.values()))


def check_policy(policy: Any, name: str) -> Policy:
    """Return the object if it is callable, has `reset`, and its `images`, `wants` and `ticks` are valid."""
    if not callable(policy) or not callable(getattr(policy, "reset", None)):
        raise UsageError(
            f"--policy {name}: {type(policy).__name__} needs the methods reset() and __call__(observation)"
        )
    for attribute, example in (("images", SCENE), ("wants", STATE_REQUESTS[0])):
        requested = getattr(policy, attribute, ())
        if not isinstance(requested, tuple | list | set | frozenset) or not all(
            isinstance(one, str) for one in requested
        ):
            raise UsageError(f"--policy {name}: {attribute} is {requested!r}; give a tuple, such as ({example!r},)")
    # The rig determines which images exist, see `evaluate.observation.policy_cameras`.
    for one in getattr(policy, "wants", ()):
        if one not in STATE_REQUESTS:
            raise UsageError(f"--policy {name}: it asks for the state {one!r}; {suggest_similar(one, STATE_REQUESTS)}")
    ticks = getattr(policy, "ticks", 1)
    if not isinstance(ticks, int) or ticks < 1:
        raise UsageError(f"--policy {name}: ticks is {ticks!r}; give a whole number, at least 1")
    made: Policy = policy
    return made


def wanted_images(policy: Any) -> tuple[str, ...]:
    """Return the images that a policy requests, by default `scene` and `wrist`."""
    return tuple(getattr(policy, "images", (SCENE, WRIST)))


def wanted_state(policy: Any) -> tuple[str, ...]:
    """Return the requested values other than images, from `STATE`; by default none."""
    return tuple(getattr(policy, "wants", ()))


def reset_policy(policy: Any, seed: int) -> None:
    """Reset a policy, with the seed if its `reset` has a parameter `seed`."""
    if "seed" in inspect.signature(policy.reset).parameters:
        policy.reset(seed=seed)
    else:
        policy.reset()
