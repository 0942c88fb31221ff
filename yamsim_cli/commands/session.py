"""What several commands need before they can start: where things are, a GL backend, meshes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import ResourceError, UsageError

from .console import note

if TYPE_CHECKING:
    from yamsim_cli.core.assets import AssetLock, AssetStore
    from yamsim_cli.core.config.document import KeyPath
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.resources import Locations

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
RigName = Annotated[str, typer.Option("--rig", help="Rig: a name from configs/rigs/ or a YAML file.")]
Margin = Annotated[float | None, typer.Option(help="Distance between the arms, m, in place of the rig's own.")]


def locations() -> Locations:
    """Where configs, models and meshes are, from the environment."""
    from yamsim_cli.core.resources import Locations

    return Locations.find(os.environ)


def rig_config(name: str, where: Locations, margin: float | None = None) -> RigConfig:
    """The named rig, with another margin if one was given."""
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rig import RigConfig

    overrides: dict[KeyPath, tuple[str, Any]] = {} if margin is None else {("margin",): ("--margin", margin)}
    return load_config(RigConfig, "rigs", name, where, overrides)


# What MuJoCo and OpenCV can be asked for without a machine running out of memory.
_SIZES = range(16, 4097)


def parse_size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT as two numbers of pixels.

    Raises:
        UsageError: it is not of that form, or out of range.
    """
    width, cross, height = text.lower().partition("x")
    if not cross or not width.isdecimal() or not height.isdecimal():
        raise UsageError(f"--size {text!r} is not valid: give WIDTHxHEIGHT in pixels, such as 640x480")
    if int(width) not in _SIZES or int(height) not in _SIZES:
        raise UsageError(f"--size {text!r} is not valid: width and height must lie in {_SIZES[0]}..{_SIZES[-1]} pixels")
    return int(width), int(height)


# What `skip_gl` writes. MuJoCo takes it as it takes "disabled", which a user may have set and which is then kept to.
_NO_GL = "off"


def use_gl(where: Locations, *, workers: bool = False) -> Locations:
    """Settle on an OpenGL backend that works, for this process and its workers; rather before mujoco is imported.

    Args:
        workers: several processes draw, so that none may take more than one core: Mesa's software renderer would start
            a thread a core in each.

    Returns:
        `where`, with the quality that suits the backend as `auto`.
    """
    from yamsim_cli.core.gl import bind_backend, find_backend

    environ = {name: value for name, value in os.environ.items() if (name, value) != ("MUJOCO_GL", _NO_GL)}
    backend = find_backend(environ)
    if backend.name is not None:
        os.environ["MUJOCO_GL"] = backend.name
        bind_backend(backend.name)
    if workers and backend.software:
        os.environ.setdefault("LP_NUM_THREADS", "0")
    return replace(where, auto_quality="balanced" if backend.software else "high")


def skip_gl() -> None:
    """Keep MuJoCo from loading any OpenGL: nothing will be drawn."""
    os.environ.setdefault("MUJOCO_GL", _NO_GL)


def resolve_meshes(names: Iterable[str], where: Locations, *, reduced: bool = False) -> dict[str, Path | None]:
    """Folder of each mesh set; None, with a word to the user, where a set is not here.

    Args:
        reduced: rather the meshes with fewer faces, which are made when they are not there yet.
    """
    from yamsim_cli.core.assets import AssetStore, load_lock
    from yamsim_cli.core.resources import IMPORTED

    lock, store = load_lock(where), AssetStore(where.assets)
    wanted = set(names)
    locked = wanted - {IMPORTED}
    meshes = {assets.name: store.resolve(assets) for assets in (lock.select(locked) if locked else ())}
    if missing := [name for name, folder in meshes.items() if folder is None]:
        note(
            f"The meshes of {' and '.join(missing)} are not here, so primitives are drawn: run `yamsim assets fetch`, "
            "or `yamsim doctor`."
        )
    if reduced:
        meshes |= {name: _reduced(lock, store, name, folder) for name, folder in meshes.items() if folder}
    if IMPORTED in wanted:
        meshes[IMPORTED] = where.assets / IMPORTED
    return meshes


def _reduced(lock: AssetLock, store: AssetStore, name: str, folder: Path) -> Path:
    """The set's reduced meshes; its own, with a word to the user, where there are none and none can be made."""
    from yamsim_cli.core.assets import find_reduced, make_reduced

    assets = lock.sets[name]
    try:
        found = find_reduced(store, assets)
        if found is None:
            note(f"The meshes of {name} are being reduced, which is done once.")
            found = make_reduced(store, assets, folder, lock.notices[assets.notice])
    except ResourceError as error:
        note(f"The meshes of {name} are drawn in full, which takes longer: {error}")
        return folder
    return found.directory


def scene_meshes(config: RecordConfig, where: Locations) -> dict[str, Path | None]:
    """The meshes of everything that a recording shows, see `resolve_meshes`."""
    from yamsim_cli.core.scene.compose import mesh_sets

    names = mesh_sets(config.rig, (config.task.object, config.task.target, *config.randomization.extras))
    return resolve_meshes(names, where, reduced=config.render.reduced_meshes)
