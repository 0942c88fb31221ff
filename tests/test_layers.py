"""Imports go only downwards: a module may use its own floor's package and the floors below."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "yamsim_cli"

# Floors, from the bottom; packages of one floor do not use each other, so no wing uses another.
FLOORS: dict[str, int] = {
    "core.errors": 0,
    "can_site": 0,
    "core.files": 1,
    "core.geometry": 1,
    "core.closable": 1,
    "core.extras": 1,
    "http_origin": 1,
    "core.progress": 1,
    "core.statistics": 1,
    "core.images": 2,
    "core.markup": 2,
    "core.recorded_motion": 2,
    "camera_effects": 2,
    "correction_record": 2,
    "disturbances": 2,
    "least_squares": 2,
    "procedural": 2,
    "scene_photos": 2,
    "core.robots": 2,
    "core.workers": 2,
    "plots": 3,
    "video_compression": 3,
    "core.config": 3,
    "core.attempt_data": 4,
    "goal_consistency": 4,
    "loose_pieces": 4,
    "core.dataset": 5,
    "core.scene": 5,
    "core.rendering": 6,
    "photo_rendering": 6,
    "camera_rendering": 7,
    "disturbed_motion": 7,
    "core.sim": 6,
    "selection": 6,
    "recorded_settings": 6,
    "core.expert": 7,
    "core.episode": 8,
    "kitchen_skills": 8,
    "program_checks": 8,
    "cpu_limits": 8,
    "filesystem_mounts": 8,
    "gl": 8,
    "mesh_download": 8,
    "early_worker": 9,
    "session_opener": 9,
    "trials": 9,
    # Wings: tasks of users.
    "datasets": 10,
    "export": 10,
    "kitchenbench": 10,
    "objects": 10,
    "photos": 10,
    "policies": 10,
    "real": 10,
    "recording": 10,
    "review": 10,
    "training": 10,
    "viewers": 10,
    # Code that joins wings, and entry points of users.
    "agent_server": 11,
    "calibration": 11,
    "corrections": 11,
    "camera_reader": 11,
    "doctor": 11,
    "gap_photos": 11,
    "kinematics": 11,
    "kitchen_scenes": 11,
    "robot_catalog": 11,
    "task_validation": 11,
    "terminal": 11,
    "lerobot_camera": 12,
    "match": 12,
    "raiden_camera": 12,
    "abc_evaluation": 12,
    "flags": 12,
    "api": 13,
    "commands": 13,
    "gym_options": 14,
    "main": 14,
    "station_settings": 14,
    "__main__": 15,
    "gym_physics": 15,
    "gym_pictures": 15,
    "gym_task": 15,
    "station": 15,
    "gym_env": 16,
    "live_station": 16,
    "vector_env": 16,
}
WINGS = {unit for unit, floor in FLOORS.items() if floor == FLOORS["photos"]}

# Libraries that only some packages may import.
CONFINED = {
    "mink": {"core.expert.planning.ik"},
    "manifold3d": {"core.scene.assets.mesh_reduction", "objects.convex_decomposition"},
    "fast_simplification": {"core.scene.assets.mesh_reduction"},
    "cv2": {
        "calibration",
        "camera_effects",
        "camera_rendering",
        "core.images",
        "core.rendering",
        "match",
        "photos",
        "scene_photos",
        "video_compression",
    },
    "coacd": {"objects"},
    "scipy": {"calibration.exchanges", "calibration.pose_search", "core.statistics", "review.dataset_diff"},
    "defusedxml": {"objects.readers.untrusted_xml"},
    "trimesh": {"objects.readers.meshes", "viewers.scene_nodes"},
    "PIL": {"objects.readers", "viewers.scene_nodes"},
    "mujoco": {
        "abc_evaluation",
        "camera_rendering",
        "gym_physics",
        "core.episode",
        "core.expert",
        "core.rendering",
        "core.scene",
        "core.sim",
        "export",
        "program_checks",
        "kitchenbench.scene_stepper",
        "match.station_renderer",
        "objects",
        "photo_rendering",
        "photos",
        "procedural.walls",
        "scene_photos.table_texture",
        "real.gap",
        "real.identify",
        "real.serve.motor_simulation",
        "robot_catalog",
        "task_validation",
        "viewers",
    },
    "inspect_robots": {"kitchenbench"},
    "typer": {"commands", "flags", "main"},
    "rich": {"commands", "flags", "terminal"},
    "reportlab": {"photos.board_sheet"},
    "viser": {"viewers"},
    "ray": {"recording.ray_pool"},
    "av": {"core.images.video", "video_compression"},
    "pyarrow": {"export", "real.recordings.lerobot_files"},
    "mcap": {"real.recordings.mcap_file", "export.abc"},
    "rerun": {"export.rrd"},
    "msgpack": {"policies.openpi", "policies.remote_policy", "real.serve.chiral", "real.serve.portal"},
    "websockets": {"policies.openpi", "real.serve.chiral", "viewers.scene_page"},
    "lerobot": {"policies.lerobot", "lerobot_camera"},
    "raiden": {"raiden_camera"},
    "torch": {"policies.lerobot"},
    "gymnasium": {"gym_env", "gym_task", "vector_env"},
    "can": {"can_site"},
}


@functools.cache
def _modules() -> list[str]:
    paths = (path for path in PACKAGE.rglob("*.py") if "_data" not in path.parts)
    return sorted(".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__") for path in paths)


def _unit(module: str) -> str | None:
    """Return a module's floor; None for package markers."""
    return next((unit for unit in FLOORS if module == unit or module.startswith(unit + ".")), None)


@functools.cache
def _tree(module: str) -> ast.Module:
    return ast.parse(_file(module).read_text())


def _file(module: str) -> Path:
    path = PACKAGE / Path(*module.split("."))
    package = path / "__init__.py"
    return package if package.exists() else path.with_suffix(".py")


@functools.cache
def _imports(module: str) -> tuple[str, ...]:
    """Absolute names of a module's imports: yamsim's own without `yamsim_cli.`, libraries unchanged."""
    return tuple(_find_imports(module))


def _find_imports(module: str) -> Iterator[str]:
    is_package = _file(module).name == "__init__.py"
    package = module.split(".") if is_package else module.split(".")[:-1]
    for node in ast.walk(_tree(module)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
            names = [".".join([*base, alias.name]) for alias in node.names]
            yield from names
            continue
        else:
            continue
        yield from (name.removeprefix("yamsim_cli.") for name in names)


def test_every_module_has_a_floor() -> None:
    markers = {"__init__", "", "core", "commands"}
    assert [module for module in _modules() if _unit(module) is None and module not in markers] == []


def test_imports_go_only_downwards() -> None:
    upwards = [
        f"{module} (floor {FLOORS[own]}) imports {name} (floor {FLOORS[unit]})"
        for module in _modules()
        for name in _imports(module)
        if (own := _unit(module)) and (unit := _unit(name)) and unit != own and FLOORS[unit] >= FLOORS[own]
    ]
    assert upwards == []


def test_no_module_is_imported_by_what_it_imports() -> None:
    """Modules inside a package are ordered too."""
    modules = set(_modules())
    below = {module: {name for name in _needs(module) if name in modules} - {module} for module in modules}
    while free := {module for module, needs in below.items() if not needs}:
        below = {module: needs - free for module, needs in below.items() if module not in free}
    assert below == {}, f"in a circle, or above one: {sorted(below)}"


def _needs(module: str) -> Iterator[str]:
    """Modules that a module's imports name."""
    for name in _imports(module):
        yield name
        yield name.rpartition(".")[0]


def test_libraries_stay_where_they_belong() -> None:
    users = {(name.split(".")[0], module) for module in _modules() for name in _imports(module)}
    used = {library for library, _ in users}
    assert CONFINED.keys() - used == set(), "nothing imports these any more: drop them from the list"
    assert [
        (library, user)
        for library, user in users
        if library in CONFINED and not any(user == unit or user.startswith(f"{unit}.") for unit in CONFINED[library])
    ] == []


# The wall clock may be set back, which would change data or end a wait: core uses only time.monotonic.
OUTSIDE = {
    *("os.environ", "os.getenv", "sys.argv", "sys.exit", "sys.stdout", "time.time", "time.time_ns"),
    *("datetime.now", "datetime.today", "date.today", "print", "input", "exit"),
}


# Programs of their own: other programs start them, and communicate over their own channels.
OUTSIDERS = {"policies.policy_server"}


def test_core_and_wings_do_not_reach_outside() -> None:
    """Core and the wings never print, exit, or read the command line, the environment or the wall clock.

    `kitchenbench` may: Inspect Robots starts it, so no command of yamsim sets its environment.
    """
    reached = []
    for module in _modules():
        inside = module.partition(".")[0] in {"core", *WINGS} - {"kitchenbench"} and module not in OUTSIDERS
        for node in ast.walk(_tree(module)) if inside else ():
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                name = f"{node.value.id}.{node.attr}"
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                name = node.func.id
            else:
                continue
            if name in OUTSIDE:
                reached.append(f"{module}:{node.lineno}: {name}")
    assert reached == []


ARCHITECTURE = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_page_on_architecture_has_the_floors() -> None:
    rows = re.findall(r"^\| (\d+) \| (.*?) \|", ARCHITECTURE, re.MULTILINE)
    assert {unit: int(floor) for floor, units in rows for unit in re.findall(r"`(.*?)`", units)} == FLOORS


def test_core_fits_in_one_head() -> None:
    packages = {path.parent.name for path in (PACKAGE / "core").glob("*/__init__.py")}
    lines = sum(len(_file(module).read_text().splitlines()) for module in _modules() if module.startswith("core"))
    assert len(packages) <= 12
    assert lines <= 30_000


def test_the_page_on_architecture_names_modules_that_exist() -> None:
    named = set(re.findall(r"`((?:core|commands|flags|terminal)\.[\w.]+)`", ARCHITECTURE))
    assert named and named - set(_modules()) == set()


# Started or imported by other programs: the command, plugins of other tools, and the public API.
ENTRIES = {
    *("__main__", "can_site.yamsim_can", "gym_env", "kinematics", "kitchenbench.own_tasks", "kitchenbench.policy"),
    *("lerobot_camera", "live_station", "main", "raiden_camera", "vector_env"),
    *("training.chunk_windows", "training.shuffled_batches"),
}


def test_every_module_is_used() -> None:
    used = {name for module in _modules() for name in _needs(module)}
    packages = {module.rpartition(".")[0] for module in _modules()} | {"__init__"}
    assert set(_modules()) - used - packages - ENTRIES == set()


def test_scripts_import_names_that_exist() -> None:
    """No other test reads shell scripts."""
    scripts = [path for path in (PACKAGE.parent / "tools").rglob("*") if path.suffix in (".py", ".sh")]
    imports = [
        (module, name.split()[0])
        for path in scripts
        for module, names in re.findall(r"from yamsim_cli\.([\w.]+) import ([\w, ]+)", path.read_text(encoding="utf-8"))
        for name in names.split(",")
    ]
    assert ("gl", "find_backend") in imports
    assert [
        (module, name) for module, name in imports if not re.search(rf"\b{name}\b", _file(module).read_text())
    ] == []
