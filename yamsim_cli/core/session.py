"""What is settled once before anything runs: a config, where things are, the meshes, and what draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, MutableMapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import ResourceError, UsageError

if TYPE_CHECKING:
    from .assets import AssetLock, AssetStore
    from .config.document import KeyPath
    from .config.recording import RecordConfig
    from .config.rig import RigConfig
    from .resources import Locations

# What MuJoCo and OpenCV can be asked for without a machine running out of memory.
_SIZES = range(16, 4097)

# What `Opener.skip_gl` writes. MuJoCo takes it as it takes "disabled", which a user may have set and which is then
# kept to.
_NO_GL = "off"

# What each setting sets. A task comes before its parts.
_SETS: dict[str, tuple[str, ...]] = {
    "rig": ("rig",),
    "margin": ("rig", "margin"),
    "task": ("task",),
    "object": ("task", "object"),
    "target": ("task", "target"),
    "threshold": ("task", "success", "threshold"),
    "n": ("episodes",),
    "workers": ("workers",),
    "seed": ("seed",),
    "grasp": ("grasp",),
    "arm": ("arm",),
    "wrist": ("wrist",),
    "boards": ("boards",),
    "truth": ("truth",),
    "size": ("image", "size_px"),
    "jpeg_quality": ("image", "jpeg_quality"),
    "quality": ("render",),
    "randomize": ("randomization",),
}


@dataclass(frozen=True)
class Session:
    """What runs need.

    Attributes:
        config: what is run, checked.
        locations: where configs, models and meshes are, with the quality that suits what draws as `auto`.
        meshes: asset set -> folder of its files, or None where primitives stand in.
    """

    config: RecordConfig
    locations: Locations
    meshes: Mapping[str, Path | None]

    @property
    def parts(self) -> tuple[RecordConfig, Locations, Mapping[str, Path | None]]:
        """All three, for what takes them one by one."""
        return self.config, self.locations, self.meshes


@dataclass(frozen=True)
class Opener:
    """Opens sessions, for the command line or for a program.

    Attributes:
        environ: the process's environment. What draws is settled in it, since MuJoCo reads it when it is imported.
        notify: told what a user should read, a sentence at a time.
        spell: a setting's name -> how whoever asks writes it, for messages.
    """

    environ: MutableMapping[str, str]
    notify: Callable[[str], None]
    spell: Callable[[str], str]

    def open(self, name: str, *, draws: bool = True, parallel: bool = True, **given: Any) -> Session:
        """A session of a record config with settings put over it.

        Args:
            draws: whether anything is drawn; without, no OpenGL is looked for.
            parallel: several processes draw, see `use_gl`.
            given: see `config`.

        Raises:
            ConfigError, UsageError: a value is not valid. It is told before OpenGL is tried, which takes seconds.
            ResourceError: nothing can draw here.
        """
        config, where = self.settle(name, draws=draws, parallel=parallel, **given)
        return Session(config, where, self.scene_meshes(config, where))

    def settle(
        self, name: str, *, draws: bool = True, parallel: bool = True, **given: Any
    ) -> tuple[RecordConfig, Locations]:
        """The config of a session and where things are; its meshes are looked for later, if at all. See `open`."""
        where = self.locations()
        config = self.config(name, where, **given)
        if not draws:
            self.skip_gl()
            return config, where
        where = self.use_gl(where, workers=parallel)
        return self.config(name, where, **given), where

    def locations(self) -> Locations:
        """Where configs, models and meshes are, from the environment."""
        from .resources import Locations

        return Locations.find(self.environ)

    def config(self, name: str, where: Locations, **given: Any) -> RecordConfig:
        """The named record config with settings put over it.

        Args:
            given: settings by their names; None for those that were not given. `randomize` keeps the ranges that a
                config has of its own.

        Raises:
            ConfigError, UsageError: a value is not valid; what cannot be demonstrated is told before anything is made.
        """
        from .config.limits import check_start
        from .config.loader import load_config
        from .config.recording import RecordConfig
        from .tasks.kinds import kind_of

        if isinstance(size := given.get("size"), str):
            given["size"] = parse_size(size)
        if (randomize := given.get("randomize")) is not None:
            own = self.config(name, where, **(given | {"randomize": None})).randomization.parts
            given["randomize"] = (None if own else "default") if randomize else "none"
        overrides: dict[KeyPath, tuple[str, Any]] = {
            path: (self.spell(setting), given[setting])
            for setting, path in _SETS.items()
            if given.get(setting) is not None
        }
        config = load_config(RecordConfig, "record", name, where, overrides)
        kind_of(config.task)
        check_start(config, where)
        return config

    def rig(self, name: str, where: Locations, margin: float | None = None) -> RigConfig:
        """The named rig, with another margin if one was given."""
        from .config.loader import load_config
        from .config.rig import RigConfig

        overrides: dict[KeyPath, tuple[str, Any]] = {}
        if margin is not None:
            overrides["margin",] = (self.spell("margin"), margin)
        return load_config(RigConfig, "rigs", name, where, overrides)

    def use_gl(self, where: Locations, *, workers: bool = False) -> Locations:
        """Settle on an OpenGL backend that works, for this process and its workers; rather before mujoco is imported.

        Args:
            workers: several processes draw, so that none may take more than one core: Mesa's software renderer would
                start a thread a core in each.

        Returns:
            `where`, with the quality that suits the backend as `auto`.
        """
        from .gl import bind_backend, find_backend

        asked = {name: value for name, value in self.environ.items() if (name, value) != ("MUJOCO_GL", _NO_GL)}
        backend = find_backend(asked)
        if backend.name is not None:
            self.environ["MUJOCO_GL"] = backend.name
            bind_backend(backend.name)
        if workers and backend.software:
            self.environ.setdefault("LP_NUM_THREADS", "0")
        return replace(where, auto_quality="balanced" if backend.software else "high")

    def skip_gl(self) -> None:
        """Keep MuJoCo from loading any OpenGL: nothing will be drawn."""
        self.environ.setdefault("MUJOCO_GL", _NO_GL)

    def meshes(self, names: Iterable[str], where: Locations, *, reduced: bool = False) -> dict[str, Path | None]:
        """Folder of each mesh set; None, with a word to the user, where a set is not here.

        Args:
            reduced: rather the meshes with fewer faces, which are made when they are not there yet.
        """
        from .assets import AssetStore, load_lock
        from .resources import IMPORTED

        lock, store = load_lock(where), AssetStore(where.assets)
        wanted = set(names)
        locked = wanted - {IMPORTED}
        meshes = {assets.name: store.resolve(assets) for assets in (lock.select(locked) if locked else ())}
        if missing := [name for name, folder in meshes.items() if folder is None]:
            self.notify(
                f"The meshes of {' and '.join(missing)} are not here, so primitives are drawn: run `yamsim assets "
                "fetch`, or `yamsim doctor`."
            )
        if reduced:
            meshes |= {name: self._reduced(lock, store, name, folder) for name, folder in meshes.items() if folder}
        if IMPORTED in wanted:
            meshes[IMPORTED] = where.assets / IMPORTED
        return meshes

    def _reduced(self, lock: AssetLock, store: AssetStore, name: str, folder: Path) -> Path:
        """The set's reduced meshes; its own, with a word to the user, where there are none and none can be made."""
        from .assets import find_reduced, make_reduced

        assets = lock.sets[name]
        try:
            found = find_reduced(store, assets)
            if found is None:
                self.notify(f"The meshes of {name} are being reduced, which is done once.")
                found = make_reduced(store, assets, folder, lock.notices[assets.notice])
        except ResourceError as error:
            self.notify(f"The meshes of {name} are drawn in full, which takes longer: {error}")
            return folder
        return found.directory

    def scene_meshes(self, config: RecordConfig, where: Locations) -> dict[str, Path | None]:
        """The meshes of everything that a recording shows, see `meshes`."""
        from .scene.compose import mesh_sets

        names = mesh_sets(config.rig, (config.task.object, config.task.target, *config.randomization.extras))
        return self.meshes(names, where, reduced=config.render.reduced_meshes)


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
