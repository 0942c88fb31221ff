"""Opens sessions: loads the config, and finds model files, meshes and an OpenGL backend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .core.config.session import Session
from .core.errors import ConfigError, ResourceError, UsageError

if TYPE_CHECKING:
    from .core.config.program_task import ProgramTask, ProgramTiming
    from .core.config.recording import RecordConfig
    from .core.config.rendering import RenderConfig
    from .core.config.rig import RigConfig
    from .core.files.documents.config_base import Config
    from .core.files.documents.yaml_document import KeyPath
    from .core.files.resources import Locations
    from .core.scene.assets import AssetLock, AssetStore, FetchProgress
    from .gl import BackendProbe

_VALID_SIDES_PX = range(16, 4097)  # px, of images
_GL_DISABLED = "off"  # MUJOCO_GL without OpenGL; `choose_gl_backend` may replace it, but not a user's "disabled"
_OFFLINE_VARIABLE = "YAMSIM_OFFLINE"  # environment variable that prevents downloads of meshes, unless empty or 0


# Setting (flag or keyword) -> key path in a record config; the task comes before the settings within it.
_KEY_PATH_OF_SETTING: dict[str, tuple[str, ...]] = {
    "rig": ("rig",),
    "revision": ("rig", "revision"),
    "robot": ("rig", "robot"),
    "margin": ("rig", "margin"),
    "task": ("task",),
    "object": ("task", "object"),
    "target": ("task", "target"),
    "threshold": ("task", "success", "threshold"),
    "scene": ("scene",),
    "n": ("episodes",),
    "workers": ("workers",),
    "seed": ("seed",),
    "grasp": ("grasp",),
    "arm": ("arm",),
    "wrist": ("wrist",),
    "camera": ("cameras",),
    "boards": ("boards",),
    "truth": ("truth",),
    "camera_effects": ("camera_effects",),
    "disturb": ("disturb",),
    "size": ("image", "size_px"),
    "jpeg_quality": ("image", "jpeg_quality"),
    "action": ("action",),
    "quality": ("render",),
    "randomization": ("randomization",),
    "randomize": ("randomization",),
}

# Settings whose key path depends on the task; see `_task_key_path`.
_TASK_SETTINGS = ("object", "target", "threshold")


@dataclass(frozen=True)
class SessionOpener:
    """Opens sessions (a record config with the locations of its files), for the command line or a program.

    Attributes:
        environ: MuJoCo reads its OpenGL backend from these variables at its import.
        setting_label: name of a setting -> flag or keyword in messages.
        resolve_object: converts the name of an object to the name of its config; imports files of other formats.
        resolve_task: converts the name of a task to a name, or to a config as plain data.
        notify_at_end: shows a sentence when the command ends.
    """

    environ: MutableMapping[str, str]
    notify: Callable[[str], None]
    setting_label: Callable[[str], str]
    resolve_object: Callable[[str, Locations, Callable[[str], None]], str] = lambda name, where, notify: name
    resolve_task: Callable[[str], str | dict[str, Any]] = lambda name: name
    fetch_bar: Callable[[], AbstractContextManager[FetchProgress]] = lambda: nullcontext(
        lambda label, done, total: None
    )
    notify_at_end: Callable[[str], None] = lambda text: None

    def open(
        self, name: str, *, renders: bool = True, parallel: bool = True, resumes: Path | None = None, **given: Any
    ) -> Session:
        """Open a session of a record config with settings.

        Args:
            renders: without, OpenGL and meshes are not needed.
            resumes: dataset that the session resumes. Mesh sets that it shows as primitives stay primitives.
        """
        # The probe imports MuJoCo meanwhile.
        with self._start_gl_probe() if renders else nullcontext() as probe:
            from .core.episode.sampling import require_start

            where = self.find_locations()
            for setting in ("object", "target"):
                if isinstance(named := given.get(setting), str):
                    given[setting] = self.resolve_object(named, where, self.notify)
            if isinstance(named := given.get("task"), str):
                given["task"] = self.resolve_task(named)
            session = Session(
                self.load_record_config(name, where, lambda config: require_start(Session(config, where)), **given),
                where,
            )
            if not renders:
                self.disable_gl()
                return session
            where = self.choose_gl_backend(where, workers=parallel, started=probe)
        from .core.dataset.writing.directory_claim import recorded_meshes

        if where != session.locations:
            # The quality `auto` is another one.
            session = Session(self.load_record_config(name, where, **given), where)
        # The config may come from another dataset, whose meshes do not matter here.
        return self.with_scene_meshes(session.with_values(meshes=recorded_meshes(resumes) if resumes else None))

    def find_locations(self) -> Locations:
        """Return the locations of configs, models and meshes that the environment defines."""
        from .core.files.resources import Locations

        return Locations.from_environment(self.environ)

    def load_record_config(
        self, name: str, locations: Locations, check: Callable[[RecordConfig], None] = lambda config: None, **given: Any
    ) -> RecordConfig:
        """Load a record config with settings.

        Args:
            check: called last with the config; raises a `ConflictError` if settings contradict each other.
            given: values of settings by name; None for settings that are not given. `randomize` keeps the ranges of the
                config or of `randomization`.
        """
        from .core.config.loader import load_config
        from .core.config.recording import RecordConfig
        from .program_checks import check_task_config

        if isinstance(task := given.get("task"), str):
            given["task"] = self.resolve_task(task)
        if isinstance(size := given.get("size"), str):
            given["size"] = parse_size(size)
        if effects := given.get("camera_effects"):
            given["camera_effects"] = parse_camera_effects(effects)
        randomize, disturb = given.get("randomize"), given.pop("disturb", None)
        if randomize is False and given.get("randomization"):
            named, no = self.setting_label("randomization"), self.setting_label("no_randomize")
            raise UsageError(f"{named} and {no} contradict each other; leave one out")
        if randomize is not None or disturb:
            own = self.load_record_config(name, locations, **(given | {"randomize": None}))
            if randomize is not None:
                given["randomize"] = (None if own.randomization.varied_parts else "default") if randomize else "none"
            if disturb and own.disturb is None:
                given["disturb"] = {}
        fps = given.pop("fps", None)
        paths = {
            setting: path
            for setting, path in _KEY_PATH_OF_SETTING.items()
            if given.get(setting) is not None and given[setting] != []
        }
        within = [setting for setting in _TASK_SETTINGS if setting in paths]
        overrides: dict[KeyPath, tuple[str, Any]] = {
            path: (self.setting_label(setting), given[setting])
            for setting, path in paths.items()
            if setting not in within
        }
        if (
            given.get("task") is not None
            and given.get("rig") is None
            and (own_rig := self._rig_named_by_task(given["task"], locations))
        ):
            overrides["rig",] = own_rig
        if within:
            task = load_config(RecordConfig, "record", name, locations, overrides).task
            overrides |= {
                self._task_key_path(task, setting): (self.setting_label(setting), given[setting]) for setting in within
            }
        if fps is not None:
            overrides |= self._at_rate(fps, self.load_record_config(name, locations, **given).task.timing)

        def check_task_and_fingers(config: Config) -> None:
            check_task_config(config)
            assert isinstance(config, RecordConfig)
            check(config)

        return load_config(RecordConfig, "record", name, locations, overrides, check_task_and_fingers)

    def _task_key_path(self, task: ProgramTask, setting: str) -> KeyPath:
        """Return the key path of a setting within the task, which must have this key."""
        from .core.files.documents.config_base import ConflictError

        if setting == "threshold":
            try:
                return ("task", *task.radius_path)
            except ConflictError as error:
                raise UsageError(f"{self.setting_label(setting)}: {error}; leave it out") from None
        if setting not in task.things:
            raise UsageError(
                f"{self.setting_label(setting)}: task {task.name!r} has no role {setting!r}; "
                f"its roles: {', '.join(task.things)}"
            )
        return ("task", "things", setting, "of")

    def _at_rate(self, fps: float, timing: ProgramTiming) -> dict[KeyPath, tuple[str, Any]]:
        try:
            changed = timing.at_rate(fps)
        except ValueError as error:
            raise UsageError(f"{self.setting_label('fps')}: {error}") from None
        return {("task", "timing", key): (self.setting_label("fps"), value) for key, value in changed.items()}

    def _rig_named_by_task(self, task: str | dict[str, Any], locations: Locations) -> tuple[str, str] | None:
        """Return file position and name of the rig in a task's config, if any."""
        from .core.config.loader import config_model
        from .core.config.program_task import PROGRAM_KIND
        from .core.files.documents.yaml_document import Document

        try:
            read = config_model("tasks").read_document
            document = read(locations.config_file("tasks", task)) if isinstance(task, str) else Document(task, "task")
        except ConfigError:
            return None  # `load_config` reports the error
        rig = document.data.get("rig") if document.data.get("kind") == PROGRAM_KIND else None
        return (document.place_of(("rig",)), rig) if isinstance(rig, str) else None

    def load_rig(
        self,
        name: str,
        locations: Locations,
        margin: float | None = None,
        revision: str | None = None,
        robot: Sequence[str] | None = None,
    ) -> RigConfig:
        """Load a rig, with another arm distance `margin` (m), arm `revision` and dynamics files `robot` if given."""
        from .core.config.loader import load_config
        from .core.config.rig import RigConfig

        given = {"margin": margin, "revision": revision, "robot": robot or None}
        overrides: dict[KeyPath, tuple[str, Any]] = {
            (key,): (self.setting_label(key), value) for key, value in given.items() if value is not None
        }
        return load_config(RigConfig, "rigs", name, locations, overrides)

    @contextmanager
    def _start_gl_probe(self) -> Iterator[BackendProbe | None]:
        from .gl import start_probe

        probe = start_probe(self._environ_for_gl)
        with probe or nullcontext():
            yield probe

    @property
    def _environ_for_gl(self) -> dict[str, str]:
        return {name: value for name, value in self.environ.items() if (name, value) != ("MUJOCO_GL", _GL_DISABLED)}

    def choose_gl_backend(
        self, locations: Locations, *, workers: bool = False, started: BackendProbe | None = None
    ) -> Locations:
        """Find an OpenGL backend, set `MUJOCO_GL`, and return `locations` with the quality that `auto` stands for
        there.

        With several `workers`, Mesa's software renderer uses one core in each. `started` is a try of the first backend
        that runs already.
        """
        from .gl import bind_backend, find_backend

        backend = find_backend(self._environ_for_gl, started=started)
        if backend.name is not None:
            self.environ["MUJOCO_GL"] = backend.name
            bind_backend(backend.name)
        if workers and backend.is_software:
            self.environ.setdefault("LP_NUM_THREADS", "0")
        return replace(locations, auto_quality="balanced" if backend.is_software else "high")

    def disable_gl(self) -> None:
        """Set `MUJOCO_GL` so that MuJoCo does not load OpenGL."""
        self.environ.setdefault("MUJOCO_GL", _GL_DISABLED)

    def stay_offline(self) -> None:
        """Show primitives for missing meshes instead of fetching them."""
        self.environ[_OFFLINE_VARIABLE] = "1"

    def with_scene_meshes(self, session: Session) -> Session:
        """Find or fetch all meshes of a scene, and return the session with their folders.

        Sets that the config records as primitives stay primitives.
        """
        from .core.config.mesh_provenance import PRIMITIVES_ONLY
        from .core.scene.blueprint import recording_blueprint
        from .core.scene.compose import visual_mesh_sets

        names = visual_mesh_sets(recording_blueprint(session.config))
        recorded = session.config.meshes or {}
        kept = [name for name in names if recorded.get(name) == PRIMITIVES_ONLY]
        where = self.with_mesh_folders(session.locations, set(names).difference(kept), session.config.render)
        return replace(session, locations=replace(where, meshes={**where.meshes, **dict.fromkeys(kept)}))

    def with_mesh_folders(
        self, locations: Locations, names: Iterable[str], quality: RenderConfig | None = None
    ) -> Locations:
        """Return `locations` with the folder of each asset set. Fetch missing sets; failures are only a note.

        The render quality decides whether meshes are reduced, now if necessary. Raises ResourceError if Filament is
        missing, which the quality `photo` needs.
        """
        if quality is not None and quality.photo_samples:
            from .photo_rendering.filament_context import require_filament

            require_filament()
        from .core.files.resources import IMPORTED_MESH_FOLDER
        from .core.scene.assets import AssetStore, is_user_set, load_lock, resolve_user_set

        lock, store = load_lock(locations), AssetStore(locations.assets)
        wanted = set(names)
        own = {name for name in wanted if is_user_set(name)}
        locked = wanted - own - {IMPORTED_MESH_FOLDER}
        meshes = {
            assets.name: store.find_verified_folder(assets) for assets in (lock.select_sets(locked) if locked else ())
        }
        if missing := [name for name, folder in meshes.items() if folder is None]:
            meshes |= self._fetch_missing_sets(locations, lock, store, missing)
        if quality is not None and quality.reduced_meshes:
            meshes |= {
                name: self._reduced_mesh_folder(lock, store, name, folder) for name, folder in meshes.items() if folder
            }
        meshes |= {name: resolve_user_set(store, name) for name in sorted(own)}
        if lost := [name for name in sorted(own) if meshes[name] is None]:
            self.notify(
                f"The files of {' and '.join(lost)} are missing, or changed since the import: copy the folder of "
                f"that name into {locations.assets}, or import the object again."
            )
        if IMPORTED_MESH_FOLDER in wanted:
            meshes[IMPORTED_MESH_FOLDER] = locations.assets / IMPORTED_MESH_FOLDER
        return replace(locations, meshes=meshes)

    def _fetch_missing_sets(
        self, locations: Locations, lock: AssetLock, store: AssetStore, missing: Sequence[str]
    ) -> dict[str, Path | None]:
        """Fetch missing asset sets, unless the user chose primitives."""
        from yamsim_cli.mesh_download.fetch import fetch_missing

        on_demand = "".join(f" {name}" for name in missing if lock.sets[name].on_demand)
        why = f"run `yamsim assets fetch{on_demand}`, or `yamsim doctor`"
        if not self._wants_primitives(locations):
            self.notify(f"The meshes of {' and '.join(missing)} are being fetched, which is done once.")
            try:
                with self.fetch_bar() as progress:
                    fetch_missing(lock, missing, store, progress)
            except ResourceError as error:
                why = str(error)
        found = {name: store.find_verified_folder(lock.sets[name]) for name in missing}
        if lacking := [name for name, folder in found.items() if folder is None]:
            notice = f"The meshes of {' and '.join(lacking)} are not here, so primitives are shown: {why}."
            self.notify(notice)
            self.notify_at_end(notice)
        return found

    def _wants_primitives(self, locations: Locations) -> bool:
        """Whether missing meshes are not fetched: offline, or YAMSIM_ASSETS is an empty folder or a file."""
        if self.environ.get(_OFFLINE_VARIABLE, "0") not in ("", "0"):
            return True
        if not self.environ.get("YAMSIM_ASSETS") or not locations.assets.exists():
            return False
        return not locations.assets.is_dir() or not any(locations.assets.iterdir())

    def _reduced_mesh_folder(self, lock: AssetLock, store: AssetStore, name: str, folder: Path) -> Path:
        """Return the folder of a set's simplified meshes, made if missing; on failure, return `folder`."""
        from .core.scene.assets import find_reduced, make_reduced

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


def parse_camera_effects(given: Sequence[str]) -> list[dict[str, str | None]]:
    """Convert texts `[CAMERA=]NAME|FILE` to entries of the key `camera_effects` of a record config."""
    split = [text.rpartition("=") for text in given]
    return [{"camera": camera or None, "effects": effects} for camera, _, effects in split]


def parse_size(text: str) -> tuple[int, int]:
    """Convert a text WIDTHxHEIGHT to width and height, px."""
    width, cross, height = text.lower().partition("x")
    if not cross or not width.isdecimal() or not height.isdecimal():
        raise UsageError(f"--size {text!r} is not valid: give WIDTHxHEIGHT in pixels, such as 640x480")
    if int(width) not in _VALID_SIDES_PX or int(height) not in _VALID_SIDES_PX:
        raise UsageError(
            f"--size {text!r} is not valid: width and height must lie in "
            f"{_VALID_SIDES_PX[0]}..{_VALID_SIDES_PX[-1]} pixels"
        )
    return int(width), int(height)
