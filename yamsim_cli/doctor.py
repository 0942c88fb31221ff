"""Checks of this machine for `yamsim doctor`. A failed check names the fix."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from . import __version__
from .core.errors import ResourceError, YamsimError
from .core.files.resources import Locations
from .core.files.writing import directory_obstacle, nearest_directory, publish_directory
from .core.scene.assets import AssetSet, AssetStore, find_reduced, load_lock
from .core.scene.assets.asset_store import FileStatus
from .cpu_limits import usable_cores, usable_memory
from .filesystem_mounts import network_mount, read_mounts
from .gl import INSTALL_GL, LINUX_BACKENDS, GlBackend, probe_backend
from .photo_rendering.filament_context import MAX_BYTES, require_filament

# Packages that every command needs.
PACKAGES = ("mujoco", "mink", "daqp", "numpy", "opencv-python-headless", "pydantic", "pyyaml", "rich", "typer")
# Optional extra, as in `yamsim[extra]` -> package that it installs, and its purpose.
EXTRAS = {
    "view": ("viser", "the browser page of view and replay"),
    "video": ("av", "MP4"),
    "print": ("reportlab", "boards as PDF"),
    "lerobot": ("pyarrow", "export lerobot"),
    "rerun": ("rerun-sdk", "export rerun"),
    "gym": ("gymnasium", "the gymnasium environment"),
    "remote": ("msgpack", "policies in another process, serve-robot --portal"),
    "ray": ("ray", "record --executor ray"),
    "import": ("coacd", "assets import of glTF, SDFormat and other files"),
    "inspect": ("kitchenbench", "KitchenBench's tasks on the station"),
    "mcap": ("mcap", "import of MCAP files"),
    "mcp": ("mcp", "mcp: tools for coding agents"),
    "photo": ("mujoco-studio", "--quality photo"),
    "menagerie": ("mujoco-menagerie", "one more source of meshes"),
}

# Resident memory, bytes. Source: measured at 640x480, rounded up.
_WORKER_BYTES = 300_000_000  # of a worker process that renders, without the processes of --quality photo
_RECORDER_BYTES = 150_000_000  # of the recording process

# Typical episode with one camera at 640x480.
_FRAMES_PER_EPISODE = 57  # frames per episode
_IMAGE_BYTES = 22_000
_LOWDIM_BYTES = 2_000
_FILESYSTEM_BLOCK_BYTES = 4096  # bytes to which a filesystem rounds file sizes up

_DISK_TEST_EPISODES = 3  # to measure the speed of the disk
_MAX_EPISODE_WRITE_SECONDS = 1.0  # s to write an episode; a slower disk keeps up with one worker at most
_MIN_EPISODES_OF_SPACE = 500  # free space for fewer gives a warning

GPUS = ("/dev/nvidia0", "/dev/dri/renderD128", "/dev/kfd")  # device files that exist if the machine has a GPU


class Health(StrEnum):
    """Result of a check. Only a fault means that a part of yamsim does not work."""

    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class HealthCheck:
    """One check of the machine: a result in words, the recommended action, and figures in SI units and bytes."""

    name: str
    health: Health
    detail: str
    fix: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


def run_health_checks(
    environ: Mapping[str, str],
    locations: Locations,
    out: Path,
    on_check: Callable[[HealthCheck], None] = lambda check: None,
) -> list[HealthCheck]:
    """Run all checks. The machine is left unchanged, and every wait has a time limit. `out` need not exist."""
    checks: list[HealthCheck] = []
    for part in (
        _check_packages(),
        _check_gl(environ),
        _check_meshes(locations),
        _check_disk(out),
        _check_worker_capacity(checks),
    ):
        for check in part:
            checks.append(check)
            on_check(check)
    return checks


def _check_packages() -> Iterator[HealthCheck]:
    found = {name: _installed_version(name) for name in PACKAGES}
    text = ", ".join(f"{name} {there}" for name, there in found.items() if there)
    detail = f"yamsim {__version__}, Python {platform.python_version()}, {text}"
    missing = [name for name, there in found.items() if there is None]
    if missing:
        yield HealthCheck(
            "packages", Health.FAULT, f"not installed: {', '.join(missing)}", "install yamsim's requirements"
        )
    else:
        yield HealthCheck("packages", Health.OK, detail)
    for extra, (package, purpose) in EXTRAS.items():
        there = _installed_version(package)
        state = f"{package} {there}" if there else f"not installed: {purpose}"
        yield HealthCheck(f"extra.{extra}", Health.OK, state, "" if there else f"pip install 'yamsim[{extra}]'")


def _installed_version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _check_gl(environ: Mapping[str, str]) -> Iterator[HealthCheck]:
    wanted = environ.get("MUJOCO_GL")
    names = dict.fromkeys([*([wanted] if wanted else []), *LINUX_BACKENDS])
    found: dict[str, GlBackend | str] = {}
    for name in names:
        began = time.monotonic()
        found[name] = backend = probe_backend(name, environ)
        seconds = time.monotonic() - began
        if isinstance(backend, GlBackend):
            kind = "software" if backend.is_software else "GPU"
            detail = f"works: {backend.renderer} ({kind}), started in {seconds:.1f} s"
            yield HealthCheck(f"gl.{name}", Health.OK, detail, figures={"start_s": seconds})
        else:
            others = any(isinstance(other, GlBackend) for other in found.values())
            health = Health.OK if others and name != wanted else Health.WARNING
            yield HealthCheck(f"gl.{name}", health, f"does not work: {backend}", figures={"start_s": seconds})
    chosen = _check_chosen_gl(wanted, found)
    yield chosen
    # Quality `photo` needs OpenGL too. With an invalid MUJOCO_GL, MuJoCo's modules for images cannot be imported.
    if chosen.health is not Health.FAULT:
        yield _check_photo()


def _check_chosen_gl(wanted: str | None, found: Mapping[str, GlBackend | str]) -> HealthCheck:
    working = [backend for backend in found.values() if isinstance(backend, GlBackend)]
    if wanted and not isinstance(found[wanted], GlBackend):
        detail = f"MUJOCO_GL={wanted} is set but does not work; yamsim tries no other backend while it is set"
        return HealthCheck("gl", Health.FAULT, detail, "unset MUJOCO_GL" if working else INSTALL_GL)
    if not working:
        return HealthCheck("gl", Health.FAULT, "nothing can be rendered: no OpenGL backend works", INSTALL_GL)
    chosen = found[wanted] if wanted else working[0]
    assert isinstance(chosen, GlBackend)
    gpu = next((device for device in GPUS if Path(device).exists()), None)
    if chosen.is_software and gpu:
        fix = (
            "install the EGL part of the GPU's driver (libnvidia-gl, or libegl-mesa0), and in a container enable it "
            "(NVIDIA_DRIVER_CAPABILITIES=all)"
        )
        return HealthCheck("gl", Health.WARNING, f"{gpu} exists, but OpenGL uses {chosen.renderer}, without a GPU", fix)
    quality = "balanced" if chosen.is_software else "high"
    return HealthCheck("gl", Health.OK, f"MUJOCO_GL={chosen.name} will be used; --quality auto is {quality}")


def _check_photo() -> HealthCheck:
    try:
        device = require_filament()
    except ResourceError as error:
        # Other qualities work without it. The error names the fix.
        return HealthCheck("photo", Health.OK, f"does not work: {error}")
    memory = f"{MAX_BYTES / 1e9:.1f} GB of memory more for each renderer of a worker"
    detail = f"--quality photo works, by {device}; it takes up to {memory}"
    return HealthCheck("photo", Health.OK, detail, figures={"renderer_bytes": float(MAX_BYTES)})


def _check_meshes(locations: Locations) -> Iterator[HealthCheck]:
    try:
        lock, store = load_lock(locations), AssetStore(locations.assets)
    except YamsimError as error:
        yield HealthCheck("meshes", Health.FAULT, str(error), "reinstall yamsim")
        return
    for assets in lock.sets.values():
        name = f"meshes.{assets.name}"
        states = store.file_states(assets)
        bad = [state for state in states if state.status is not FileStatus.OK]
        changed = [state.name for state in bad if state.status is FileStatus.CHANGED]
        if changed:
            detail = f"files that differ from the lock: {', '.join(changed)} in {states[0].path.parent}"
            yield HealthCheck(name, Health.FAULT, detail, f"yamsim assets fetch {assets.name}")
        elif bad and assets.on_demand:
            detail = f"fetched on demand; until then, primitives are shown: yamsim assets fetch {assets.name}"
            yield HealthCheck(name, Health.OK, detail)
        elif bad:
            detail = f"{len(bad)} of {len(states)} files are not in {locations.assets}: primitives are shown instead"
            yield HealthCheck(name, Health.WARNING, detail, "yamsim assets fetch")
        else:
            yield _check_reduced_meshes(name, f"{len(states)} files, all with the right hash", store, assets)


def _check_reduced_meshes(name: str, detail: str, store: AssetStore, assets: AssetSet) -> HealthCheck:
    try:
        reduced = find_reduced(store, assets)
    except ResourceError as error:
        detail = f"{detail}; they cannot be reduced: {error}"
        return HealthCheck(name, Health.WARNING, detail, "install yamsim's requirements")
    if reduced is None:
        return HealthCheck(
            name, Health.WARNING, f"{detail}; they are not reduced yet", f"yamsim assets fetch {assets.name}"
        )
    return HealthCheck(name, Health.OK, f"{detail}; reduced from {reduced.source_faces} faces to {reduced.faces}")


def _check_disk(out: Path) -> Iterator[HealthCheck]:
    mount = network_mount(out, read_mounts())
    if mount is not None:
        # Do not access the mount: a file server that does not respond would block this process forever.
        detail = f"{out} is on {mount.point}, which is {mount.kind} ({mount.source}): writing there may be slow"
        yield HealthCheck("disk", Health.WARNING, detail, "yamsim record --stage DIR, with DIR on a local disk")
        return
    if (fault := directory_obstacle(out)) is not None:
        yield HealthCheck("disk", Health.FAULT, f"no dataset can be made at {out}: {fault}", "choose another --out")
        return
    place = nearest_directory(out)
    if not os.access(place, os.W_OK | os.X_OK):
        yield HealthCheck("disk", Health.FAULT, f"{place} cannot be written", "choose another --out")
        return
    try:
        seconds = write_episodes(place)
    except OSError as error:
        detail = f"writing to {place} fails: {error.strerror or error}"
        yield HealthCheck("disk", Health.FAULT, detail, "choose another --out")
        return
    free = shutil.disk_usage(place).free
    fit = free // (_FRAMES_PER_EPISODE * (_IMAGE_BYTES + _LOWDIM_BYTES + _FILESYSTEM_BLOCK_BYTES))
    detail = (
        f"{place}: {free / 1e9:.1f} GB free, room for about {fit} episodes; writing one takes {seconds * 1000:.0f} ms"
    )
    figures = {"free_bytes": float(free), "episodes": float(fit), "episode_s": seconds}
    if fit < _MIN_EPISODES_OF_SPACE:
        yield HealthCheck("disk", Health.WARNING, detail, "make room, or choose another --out", figures)
    elif seconds > _MAX_EPISODE_WRITE_SECONDS:
        yield HealthCheck(
            "disk", Health.WARNING, detail, "yamsim record --stage DIR, with DIR on a faster disk", figures
        )
    else:
        yield HealthCheck("disk", Health.OK, detail, figures=figures)


def write_episodes(place: Path) -> float:
    """Write a few dummy episodes as `record` does, and return the duration of the slowest, s. Delete the episodes.

    Raises:
        OSError: the disk refused a file.
    """
    files = {f"rgb/scene_camera/{k:06d}.jpg": bytes(_IMAGE_BYTES) for k in range(_FRAMES_PER_EPISODE)}
    files |= {f"lowdim/{k:06d}.pkl": bytes(_LOWDIM_BYTES) for k in range(_FRAMES_PER_EPISODE)}
    worst = 0.0
    with tempfile.TemporaryDirectory(prefix=".yamsim-doctor-", dir=place) as scratch:
        for k in range(_DISK_TEST_EPISODES):
            began = time.monotonic()
            publish_directory(Path(scratch, f"{k}"), files, Path(scratch, "staging"))
            worst = max(worst, time.monotonic() - began)
    return worst


def _check_worker_capacity(earlier: Sequence[HealthCheck]) -> Iterator[HealthCheck]:
    """Yield the number of workers, and another one for quality `photo` if an earlier check says that it works."""
    cores, memory = usable_cores(), usable_memory()
    fit, best = _worker_counts(cores, memory, _WORKER_BYTES)
    amount = "" if memory is None else f", {memory / 1e9:.1f} GB of memory free"
    detail = f"{cores} cores{amount}: yamsim record --workers {best}"
    figures = {"cores": float(cores), "workers": float(best)} | ({} if memory is None else {"memory": float(memory)})
    if fit < 1:
        detail = f"{detail[: detail.index(':')]}, and a worker takes {_WORKER_BYTES / 1e9:.1f}"
        yield HealthCheck("workers", Health.FAULT, detail, "give this machine or container more memory", figures)
    elif fit < cores:
        yield HealthCheck("workers", Health.WARNING, f"{detail}, limited by memory", "more memory", figures)
    else:
        yield HealthCheck("workers", Health.OK, detail, figures=figures)
    if any(check.name == "photo" and "renderer_bytes" in check.figures for check in earlier):
        yield _check_photo_workers(cores, memory)


def _worker_counts(cores: int, memory: int | None, each: int) -> tuple[int, int]:
    """Return how many workers of `each` bytes fit into memory (if unknown: `cores`), and how many to use."""
    fit = cores if memory is None else (memory - _RECORDER_BYTES) // each
    return fit, max(1, min(cores, fit))


def _check_photo_workers(cores: int, memory: int | None) -> HealthCheck:
    each = _WORKER_BYTES + MAX_BYTES
    fit, best = _worker_counts(cores, memory, each)
    amount = f"{each / 1e9:.1f} GB for each worker with one renderer"
    if fit < 1:
        detail = f"--quality photo may need more memory than is free: {amount}"
    else:
        limit = ", limited by memory" if fit < cores else ""
        detail = f"yamsim record --quality photo --workers {best}{limit}: {amount}"
    # Other qualities work with less memory.
    return HealthCheck("workers.photo", Health.OK, detail, figures={"workers": float(best)})


def failed_checks(checks: Sequence[HealthCheck]) -> list[HealthCheck]:
    """Return the checks that found a fault."""
    return [check for check in checks if check.health is Health.FAULT]
