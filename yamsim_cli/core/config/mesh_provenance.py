"""Descriptions of the meshes in a dataset's images, one for each asset set (named folder of mesh files).

A description is `primitives`, or `full` or `reduced` meshes with a hash of the files. Meshes do not affect physics.
"""

from __future__ import annotations

from collections.abc import Mapping

PRIMITIVES_ONLY = "primitives"
FULL_MESHES = "full"
REDUCED_MESHES = "reduced"

PROVENANCE_PATTERN = rf"^({PRIMITIVES_ONLY}|({FULL_MESHES}|{REDUCED_MESHES}) [0-9a-f]{{64}})$"

_SHOWN_HASH_DIGITS = 12  # digits of a hash in messages

# Asset set -> description.
ShownMeshes = Mapping[str, str]


def describe_mesh_content(text: str | None) -> str:
    """Return a description of meshes with a shortened hash, for messages; `text` is None for an unused set."""
    if text is None:
        return "not used"
    kind, _, digest = text.partition(" ")
    return f"{kind} {digest[:_SHOWN_HASH_DIGITS]}" if digest else kind


def mesh_differences(one: ShownMeshes, other: ShownMeshes, places: tuple[str, str] = ("there", "now")) -> list[str]:
    """Return `set: description there, description now` for every set whose descriptions differ."""
    return [
        f"{name}: {describe_mesh_content(one.get(name))} {places[0]}, "
        f"{describe_mesh_content(other.get(name))} {places[1]}"
        for name in sorted({*one, *other})
        if one.get(name) != other.get(name)
    ]


def describe_remedy(recorded: ShownMeshes, now: ShownMeshes) -> str:
    """Return what a user has to do so that images show the meshes of a recorded dataset again."""
    changed = [name for name in recorded if recorded[name] != now.get(name)]
    if any(now.get(name) == PRIMITIVES_ONLY for name in changed):
        return "run `yamsim assets fetch`, or set YAMSIM_ASSETS to the folder of the meshes"
    if any(recorded[name] == PRIMITIVES_ONLY for name in changed):
        return "to continue with primitives, set YAMSIM_ASSETS to an empty folder"
    return "set YAMSIM_ASSETS to the meshes of the recording"
