"""What a dataset says of the meshes that it shows: one text for each asset set, to be compared and told.

`primitives`, or `full` or `reduced` with a hash over the files in use. Meshes are only looks: a dataset that mixes them
has the same physics throughout, and shows two robots.
"""

from __future__ import annotations

from collections.abc import Mapping

PRIMITIVES = "primitives"
FULL = "full"
REDUCED = "reduced"

# What such a text can be.
PATTERN = rf"^({PRIMITIVES}|({FULL}|{REDUCED}) [0-9a-f]{{64}})$"

# Digits of a hash that are enough to tell two apart.
_SHOWN = 12

# Asset set -> the text on what is shown of it.
ShownMeshes = Mapping[str, str]


def shown(text: str | None) -> str:
    """What is shown of a set, for a message; `text` is None where the set is not used."""
    if text is None:
        return "not used"
    kind, _, digest = text.partition(" ")
    return f"{kind} {digest[:_SHOWN]}" if digest else kind


def differences(one: ShownMeshes, other: ShownMeshes, places: tuple[str, str] = ("there", "now")) -> list[str]:
    """`set: what is shown there, what is shown now` for every set of which these differ."""
    return [
        f"{name}: {shown(one.get(name))} {places[0]}, {shown(other.get(name))} {places[1]}"
        for name in sorted({*one, *other})
        if one.get(name) != other.get(name)
    ]


def remedy(recorded: ShownMeshes, now: ShownMeshes) -> str:
    """What to do where a dataset shows other meshes than it would now."""
    changed = [name for name in recorded if recorded[name] != now.get(name)]
    if any(now.get(name) == PRIMITIVES for name in changed):
        return "`yamsim assets fetch` brings the meshes, or set YAMSIM_ASSETS to where they are"
    if any(recorded[name] == PRIMITIVES for name in changed):
        return "to go on with primitives, set YAMSIM_ASSETS to an empty folder"
    return "set YAMSIM_ASSETS to the meshes that it was recorded with"
