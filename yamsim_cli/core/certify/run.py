"""Certify a thing: make every check, in order, and say which could not be made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config.things.thing import ObjectConfig
from ..resources import Locations
from .codes import CHECKS
from .matching import kinds
from .outcome import Outcome, unchecked
from .subject import Subject, subject

# Told of checks done, of how many, and which is next.
CheckDone = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Certified:
    """What all checks found: code -> outcome."""

    looked: Subject
    outcomes: Mapping[str, Outcome]

    @property
    def ok(self) -> bool:
        """Whether no check failed; some may not have been made."""
        return not self.failed

    @property
    def failed(self) -> tuple[str, ...]:
        """Codes of those that failed."""
        return tuple(code for code, outcome in self.outcomes.items() if outcome.ok is False)

    def plain(self) -> dict[str, Any]:
        """As JSON holds it, always the same for the same thing."""
        item = self.looked.item
        return {
            "ok": self.ok,
            "thing": item.name,
            "checks": [
                {"code": code, "ok": outcome.ok, "figures": dict(outcome.figures), "note": outcome.note}
                for code, outcome in self.outcomes.items()
            ],
            "mass_kg": round(item.inertia.mass + sum(link.inertia.mass for link in item.links), 6),
            "collision": {
                "kind": kinds(item.collision),
                "parts": len(item.collision) + sum(len(link.collision) for link in item.links),
            },
        }


def certify(
    item: ObjectConfig,
    meshes: Mapping[str, Path | None],
    locations: Locations,
    progress: CheckDone = lambda done, total, code: None,
) -> Certified:
    """Make every check of a thing.

    Args:
        meshes: asset set -> folder; without one, what is seen is not checked.

    Raises:
        ResourceError: it cannot be read at all.
    """
    looked = subject(item, meshes, locations)
    outcomes: dict[str, Outcome] = {}
    for number, (code, check) in enumerate(CHECKS.items()):
        progress(number, len(CHECKS), code)
        failed = [other for other in check.needs if outcomes[other].ok is False]
        if failed:
            outcomes[code] = unchecked(f"means nothing before {', '.join(failed)} is mended")
        else:
            outcomes[code] = check.make(looked)
    return Certified(looked, outcomes)
