"""Finds robot models by product (family) and version (revision), such as `yam_ultra` and `v2`."""

from __future__ import annotations

import re
from collections.abc import Mapping

from ..errors import ConfigError, suggest_similar
from ..files.documents.yaml_document import load_yaml
from ..files.resources import Locations

ARMS, GRIPPERS = "robots", "grippers"

# Family -> revision -> model. Numbered revisions come last, the newest at the end.
Families = Mapping[str, Mapping[str, str]]


def find_families(locations: Locations) -> Families:
    """Return the families of all robot models, each with its revisions.

    Raises ConfigError if a model cannot be read, or two models of a family have the same revision.
    """
    found, faults = valid_families(locations)
    for fault in faults.values():
        raise fault
    return found


def valid_families(locations: Locations) -> tuple[Families, Mapping[str, ConfigError]]:
    """Return the families of all valid models, and a mapping of each invalid model to its error.

    Of two models with the same revision, the one in the later data root is valid, so that the error names the user's
    file, not the built-in one.
    """
    found: dict[str, dict[str, str]] = {}
    faults: dict[str, ConfigError] = {}
    files = {model: locations.config_file(ARMS, model) for model in locations.config_names(ARMS)}
    roots = list(locations.data)
    for model in sorted(
        files, key=lambda model: -next(k for k, root in enumerate(roots) if root in files[model].parents)
    ):
        try:
            document = load_yaml(files[model])
        except ConfigError as error:
            faults[model] = error
            continue
        family, revision = (document.data.get(key) for key in ("family", "revision"))
        if not (isinstance(family, str) and isinstance(revision, str)):
            continue
        if other := found.setdefault(family, {}).get(revision):
            place = document.place_of(("revision",))
            faults[model] = ConfigError(
                f"{place}: {files[other]} is revision {revision!r} of {family!r} too; give the new one another revision"
            )
            continue
        found[family][revision] = model
    return {
        family: dict(sorted(found[family].items(), key=lambda item: _revision_order(item[0])))
        for family in sorted(found)
    }, faults


def resolve_model_name(name: str, locations: Locations) -> str:
    """Return the model with a name, or the newest revision of the family with that name.

    Raises ConfigError if no model or family has the name.
    """
    models = locations.config_names(ARMS)
    if name in models:
        return name
    known = find_families(locations)
    if name in known:
        return list(known[name].values())[-1]
    raise ConfigError(f"unknown robot {name!r}; {suggest_similar(name, {*known, *models})}")


def other_revision(model: str, revision: str, locations: Locations) -> str:
    """Return the model that is version `revision` of the family of `model`. Raises ConfigError if none is."""
    for family, revisions in find_families(locations).items():
        if model in (family, *revisions.values()):
            if revision not in revisions:
                raise ConfigError(f"{family} has no revision {revision!r}; {suggest_similar(revision, revisions)}")
            return revisions[revision]
    raise ConfigError(f"robot {model!r} has no revisions; leave out revision {revision!r}")


def _revision_order(revision: str) -> tuple[bool, int, str]:
    numbered = re.fullmatch(r"v(\d+)", revision)
    return numbered is not None, int(numbered[1]) if numbered else 0, revision
