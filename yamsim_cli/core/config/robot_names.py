"""Which robots there are: families of arms, their revisions, and grippers."""

from __future__ import annotations

import re
from collections.abc import Mapping

from ..documents.document import load_yaml
from ..errors import ConfigError, suggest
from ..resources import Locations

ARMS, GRIPPERS = "robots", "grippers"

# Family -> revision -> model. Revisions that are numbered come last, the newest at the end.
Families = Mapping[str, Mapping[str, str]]


def families(locations: Locations) -> Families:
    """Every family whose models say that they are of it, see `ArmModel`.

    Raises:
        ConfigError: a model cannot be read, or two of a family call their revision alike.
    """
    found: dict[str, dict[str, str]] = {}
    for model in locations.config_names(ARMS):
        document = load_yaml(locations.config_file(ARMS, model))
        family, revision = (document.data.get(key) for key in ("family", "revision"))
        if isinstance(family, str) and isinstance(revision, str):
            if other := found.setdefault(family, {}).get(revision):
                raise ConfigError(
                    f"{document.place(('revision',))}: {other} is revision {revision!r} of {family!r} too; rename one"
                )
            found[family][revision] = model
    return {family: dict(sorted(found[family].items(), key=lambda item: _age(item[0]))) for family in sorted(found)}


def model_named(name: str, locations: Locations) -> str:
    """The model that a name means: a model's own, or the newest revision of a family.

    Raises:
        ConfigError: there is neither.
    """
    models = locations.config_names(ARMS)
    if name in models:
        return name
    known = families(locations)
    if name in known:
        return list(known[name].values())[-1]
    raise ConfigError(f"unknown robot {name!r}; {suggest(name, [*known, *models])}")


def revised(model: str, revision: str, locations: Locations) -> str:
    """Another revision of a model's family.

    Raises:
        ConfigError: there is none of that name.
    """
    for family, revisions in families(locations).items():
        if model in (family, *revisions.values()):
            if revision not in revisions:
                raise ConfigError(f"{family} has no revision {revision!r}; {suggest(revision, revisions)}")
            return revisions[revision]
    raise ConfigError(f"robot {model!r} has no revisions; leave out revision {revision!r}")


def _age(revision: str) -> tuple[bool, int, str]:
    numbered = re.fullmatch(r"v(\d+)", revision)
    return numbered is not None, int(numbered[1]) if numbered else 0, revision
