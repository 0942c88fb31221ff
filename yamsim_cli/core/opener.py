"""Settle what has to be known before anything runs: a config, where files are, the meshes, and what renders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, MutableMapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import ConfigError, ResourceError, UsageError
from .session import Session

if TYPE_CHECKING:
    from .assets import AssetLock, AssetStore, FetchProgress
    from .config.pictures import RenderConfig
    from .config.program_task import ProgramTask, ProgramTiming
    from .config.recording import RecordConfig
    from .config.rig import RigConfig
    from .documents.base import Config
    from .documents.document import KeyPath
    from .resources import Locations

# What MuJoCo and OpenCV can be asked for without a machine running out of memory.
_SIZES = range(16, 4097)

# What `Opener.skip_gl` writes. MuJoCo takes it as it takes "disabled", which a user may have set and which is then
# kept to.
_NO_GL = "off"

# The environment variable that keeps meshes from being fetched at first use, unless it is empty or 0.
_OFFLINE = "YAMSIM_OFFLINE"


def _show_no_progress() -> AbstractContextManager[FetchProgress]:
    return nullcontext(lambda label, done, total: None)


# What each setting sets. A task comes before its parts.
_SETS: dict[str, tuple[str, ...]] = {
    "rig": ("rig",),
    "revision": ("rig", "revision"),
    "robot": ("rig", "robot"),
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
    "camera": ("cameras",),
    "boards": ("boards",),
    "truth": ("truth",),
    "size": ("image", "size_px"),
    "jpeg_quality": ("image", "jpeg_quality"),
    "action": ("action",),
    "quality": ("render",),
    "randomization": ("randomization",),
    "randomize": ("randomization",),
}


# Those that are of a part of the task.
_WITHIN_TASK = ("object", "target", "threshold")


@dataclass(frozen=True)
class Opener:
    """Opens sessions, for the command line or for a program.

    Attributes:
        environ: the process's environment. What renders is settled in it: MuJoCo reads it when it is imported.
        notify: told what a user should read, a sentence at a time.
        spell: a setting's name -> how whoever asks writes it, for messages.
        thing: makes a config of what names a thing otherwise, such as by its file, and gives its place.
        task: a task's name, or its config as plain data where the name is that of a scene elsewhere.
        fetch_bar: opens what shows how far the fetching of missing meshes is.
        remind: told what is to be said again when all is done.
    """

    environ: MutableMapping[str, str]
    notify: Callable[[str], None]
    spell: Callable[[str], str]
    thing: Callable[[str, Locations, Callable[[str], None]], str] = lambda name, where, notify: name
    task: Callable[[str], str | dict[str, Any]] = lambda name: name
    fetch_bar: Callable[[], AbstractContextManager[FetchProgress]] = _show_no_progress
    remind: Callable[[str], None] = lambda text: None

    def open(
        self, name: str, *, renders: bool = True, parallel: bool = True, resumes: Path | None = None, **given: Any
    ) -> Session:
        """A session of a record config with settings put over it.

        Args:
            renders: whether anything is rendered; otherwise neither OpenGL nor meshes are looked for.
            parallel: whether several processes render, see `use_gl`.
            resumes: the dataset that is continued; what it shows as primitives stays primitives.
            given: see `config`.

        Raises:
            ConfigError, UsageError: a value is not valid. It is told before OpenGL is tried, which takes seconds.
            ResourceError: nothing can render here.
        """
        from .attempt.first_starts import check_starts

        where = self.locations()
        for setting in ("object", "target"):
            if isinstance(named := given.get(setting), str):
                given[setting] = self.thing(named, where, self.notify)
        if isinstance(named := given.get("task"), str):
            given["task"] = self.task(named)
        session = Session(self.config(name, where, lambda config: check_starts(Session(config, where)), **given), where)
        if not renders:
            self.skip_gl()
            return session
        where = self.use_gl(where, workers=parallel)
        from .dataset.writing.same_config import shown_in

        # What the config of another dataset says of its meshes does not bind this one.
        session = Session(self.config(name, where, **given), where)
        return self.with_meshes(session.with_values(meshes=shown_in(resumes) if resumes else None))

    def locations(self) -> Locations:
        """Where configs, models and meshes are, from the environment."""
        from .resources import Locations

        return Locations.find(self.environ)

    def config(
        self, name: str, where: Locations, check: Callable[[RecordConfig], None] = lambda config: None, **given: Any
    ) -> RecordConfig:
        """The named record config with settings put over it.

        Args:
            check: of what takes longer to find out, once all else is right; it raises a `ConflictError`.
            given: settings by their names; None for those that were not given. `randomize` keeps the ranges that a
                config has of its own, or that `randomization` names.

        Raises:
            ConfigError, UsageError: a value is not valid; what cannot be demonstrated is told before anything is made.
        """
        from .config.loader import load_config
        from .config.recording import RecordConfig
        from .skills.checked import check_config

        if isinstance(task := given.get("task"), str):
            given["task"] = self.task(task)
        if isinstance(size := given.get("size"), str):
            given["size"] = parse_size(size)
        if (randomize := given.get("randomize")) is not None:
            if not randomize and given.get("randomization"):
                named, no = self.spell("randomization"), self.spell("no_randomize")
                raise UsageError(f"{named} says how things vary, and {no} that nothing does; leave one of them out")
            own = self.config(name, where, **(given | {"randomize": None})).randomization.parts
            given["randomize"] = (None if own else "default") if randomize else "none"
        fps = given.pop("fps", None)
        sets = {
            setting: path for setting, path in _SETS.items() if given.get(setting) is not None and given[setting] != []
        }
        within = [setting for setting in _WITHIN_TASK if setting in sets]
        overrides: dict[KeyPath, tuple[str, Any]] = {
            path: (self.spell(setting), given[setting]) for setting, path in sets.items() if setting not in within
        }
        if (
            given.get("task") is not None
            and given.get("rig") is None
            and (own_rig := self._own_rig(given["task"], where))
        ):
            overrides["rig",] = own_rig
        if within:
            # Where a task has them depends on what it is.
            task = load_config(RecordConfig, "record", name, where, overrides).task
            overrides |= {self._within(task, setting): (self.spell(setting), given[setting]) for setting in within}
        if fps is not None:
            overrides |= self._at_rate(fps, self.config(name, where, **given).task.timing)

        def check_all(config: Config) -> None:
            check_config(config)
            assert isinstance(config, RecordConfig)  # asked for here
            check(config)

        return load_config(RecordConfig, "record", name, where, overrides, check_all)

    def _within(self, task: ProgramTask, setting: str) -> KeyPath:
        """Return where a recording's config has a setting of its task.

        Raises:
            UsageError: the task has no such thing.
        """
        from .documents.base import ConflictError

        if setting == "threshold":
            try:
                return ("task", *task.radius_path)
            except ConflictError as error:
                raise UsageError(f"{self.spell(setting)}: {error}; leave it out") from None
        if setting not in task.things:
            raise UsageError(
                f"{self.spell(setting)}: task {task.name!r} has no role {setting!r} whose object could be another; its "
                f"roles: {', '.join(task.things)}"
            )
        return ("task", "things", setting, "of")

    def _at_rate(self, fps: float, timing: ProgramTiming) -> dict[KeyPath, tuple[str, Any]]:
        try:
            changed = timing.at_rate(fps)
        except ValueError as error:
            raise UsageError(f"{self.spell('fps')}: {error}") from None
        return {("task", "timing", key): (self.spell("fps"), value) for key, value in changed.items()}

    def _own_rig(self, task: str | dict[str, Any], where: Locations) -> tuple[str, str] | None:
        """Return where a task names the rig that it is done on, and the rig; None if it names none."""
        from .config.loader import model_of
        from .config.program_task import PROGRAM
        from .documents.document import Document

        try:
            read = model_of("tasks").read
            document = read(where.config_file("tasks", task)) if isinstance(task, str) else Document(task, "task")
        except ConfigError:
            return None  # Loading the whole config says so, and who asked for it.
        rig = document.data.get("rig") if document.data.get("kind") == PROGRAM else None
        return (document.place(("rig",)), rig) if isinstance(rig, str) else None

    def rig(
        self,
        name: str,
        where: Locations,
        margin: float | None = None,
        revision: str | None = None,
        robot: Sequence[str] | None = None,
    ) -> RigConfig:
        """The named rig, with another margin, another revision of its robots, or one's dynamics, if one was given."""
        from .config.loader import load_config
        from .config.rig import RigConfig

        overrides: dict[KeyPath, tuple[str, Any]] = {}
        if margin is not None:
            overrides["margin",] = (self.spell("margin"), margin)
        if revision is not None:
            overrides["revision",] = (self.spell("revision"), revision)
        if robot:
            overrides["robot",] = (self.spell("robot"), robot)
        return load_config(RigConfig, "rigs", name, where, overrides)

    def use_gl(self, where: Locations, *, workers: bool = False) -> Locations:
        """Settle on an OpenGL backend that works, for this process and its workers; rather before mujoco is imported.

        Args:
            workers: several processes render, so that none may take more than one core: Mesa's software renderer would
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
        """Keep MuJoCo from loading any OpenGL: nothing will be rendered."""
        self.environ.setdefault("MUJOCO_GL", _NO_GL)

    def stay_offline(self) -> None:
        """Fetch no meshes: primitives stand in for what is missing."""
        self.environ[_OFFLINE] = "1"

    def with_meshes(self, session: Session) -> Session:
        """The same session with the meshes of everything that its scene shows.

        Sets that the config says were recorded as primitives stay primitives, and are not looked for.
        """
        from .scene.blueprint import recording_blueprint
        from .scene.compose import mesh_sets
        from .shown_meshes import PRIMITIVES

        names = mesh_sets(recording_blueprint(session.config))
        recorded = session.config.meshes or {}
        kept = [name for name in names if recorded.get(name) == PRIMITIVES]
        where = self.find_meshes(session.locations, set(names).difference(kept), session.config.render)
        return replace(session, locations=replace(where, meshes={**where.meshes, **dict.fromkeys(kept)}))

    def find_meshes(self, where: Locations, names: Iterable[str], quality: RenderConfig | None = None) -> Locations:
        """`where`, with the folder of each mesh set. Missing sets are fetched; the user is told of what cannot be had.

        Args:
            quality: rather the meshes that it asks for: reduced ones are made when they are not there yet.
        """
        from .assets import AssetStore, is_own, load_lock, resolve_own
        from .resources import IMPORTED

        lock, store = load_lock(where), AssetStore(where.assets)
        wanted = set(names)
        own = {name for name in wanted if is_own(name)}
        locked = wanted - own - {IMPORTED}
        meshes = {assets.name: store.resolve(assets) for assets in (lock.select(locked) if locked else ())}
        if missing := [name for name, folder in meshes.items() if folder is None]:
            meshes |= self._fetch(where, lock, store, missing)
        if quality is not None and quality.reduced_meshes:
            meshes |= {name: self._reduced(lock, store, name, folder) for name, folder in meshes.items() if folder}
        meshes |= {name: resolve_own(store, name) for name in sorted(own)}
        if lost := [name for name in sorted(own) if meshes[name] is None]:
            self.notify(
                f"The files of {' and '.join(lost)} are not here, or not as they were imported: copy the folder of "
                f"that name into {where.assets}, or import the thing again."
            )
        if IMPORTED in wanted:
            meshes[IMPORTED] = where.assets / IMPORTED
        return replace(where, meshes=meshes)

    def _fetch(
        self, where: Locations, lock: AssetLock, store: AssetStore, missing: Sequence[str]
    ) -> dict[str, Path | None]:
        """The folders of sets that were not here, after fetching them unless the user asked for primitives."""
        from .assets import fetch_missing

        asked = "".join(f" {name}" for name in missing if lock.sets[name].on_demand)
        why = f"run `yamsim assets fetch{asked}`, or `yamsim doctor`"
        if not self._asks_for_primitives(where):
            self.notify(f"The meshes of {' and '.join(missing)} are being fetched, which is done once.")
            try:
                with self.fetch_bar() as progress:
                    fetch_missing(lock, missing, store, progress)
            except ResourceError as error:
                why = str(error)
        found = {name: store.resolve(lock.sets[name]) for name in missing}
        if lacking := [name for name, folder in found.items() if folder is None]:
            notice = f"The meshes of {' and '.join(lacking)} are not here, so primitives are shown: {why}."
            self.notify(notice)
            self.remind(notice)
        return found

    def _asks_for_primitives(self, where: Locations) -> bool:
        """Whether missing meshes are not to be fetched: offline, or YAMSIM_ASSETS names an empty folder or a file."""
        if self.environ.get(_OFFLINE, "0") not in ("", "0"):
            return True
        if not self.environ.get("YAMSIM_ASSETS") or not where.assets.exists():
            return False
        return not where.assets.is_dir() or not any(where.assets.iterdir())

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
            self.notify(f"The meshes of {name} are shown in full, which takes longer: {error}")
            return folder
        return found.directory


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
