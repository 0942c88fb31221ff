"""Convert KitchenBench scenes to yamsim tasks, which can be recorded without KitchenBench."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from inspect_robots import Scene
from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint
from kitchenbench.sim.blueprint import SceneBlueprint

from ..core.config.goals.world import TABLE
from ..core.config.program_task import PROGRAM_KIND
from ..core.config.task_objects import Region
from ..core.errors import UsageError, suggest_similar
from ..core.expert.skills.program import skill_name
from ..core.files.documents.config_base import Config
from ..core.sim.sim_world import make_sim_world
from .asset_configs import start_extras
from .benchmark_scene import STATION_RIG, BenchmarkScene, build_benchmark_scene, open_station_session, table_area
from .goal_kinds import GoalKind
from .object_poses import feasible_poses
from .scene_goals import goal_data, rack_region
from .skill_programs import build_scene_program

_MAX_ARRANGEMENTS, _EPOCHS = 100, 600


def scene_task_data(name: str) -> dict[str, Any]:
    """Return the task of a scene, as the data of a task's YAML.

    The name is `TASK/INSTANCE`, such as `stack/cups`; with `@K`, of the scene's epoch K instead of 0. That epoch gives
    objects, instruction, goal and expert. It has one arrangement for each of up to 100 epochs with the same objects.
    """
    scene, epoch = _parse_scene_and_realization(name)
    first = _scene_blueprint(scene, epoch)
    base = open_station_session("64x48", images=False)
    realized = build_benchmark_scene(first, base)
    try:
        arrangements, blueprints = [], []
        for number in _epochs_from(epoch):
            blueprint = _scene_blueprint(scene, number)
            if _scene_requirements(blueprint) == _scene_requirements(first):
                places = feasible_poses(realized.simulator, blueprint)
                arrangements.append(
                    {"seed": _scene_seed(scene, number), "places": dict(map(_rounded_place, places.items()))}
                )
                blueprints.append(blueprint)
            if len(arrangements) == _MAX_ARRANGEMENTS:
                break
        racks = _rack_regions(realized)
    finally:
        realized.simulator.close()
    task = realized.simulator.config.task
    program = build_scene_program(first, realized.object_configs, realized.base_positions)
    data = {
        "name": f"kitchenbench_{first.scene_id.replace('-', '_')}",
        "kind": PROGRAM_KIND,
        "rig": STATION_RIG,
        "things": {role: _json(played) for role, played in task.things.items()},
        "regions": {region: _json(config) for region, config in {**task.regions, **racks}.items()},
        "starts": {role: {**_start_region(role, arrangements), **start_extras(first)} for role in task.things},
        "arrangements": arrangements,
        "phrasings": {"training": [first.instruction]},
        "goal": goal_data(first),
        "expert": [{skill_name(skill): _json(skill)} for skill in program],
        "timing": task.timing.model_dump(include={"physics_steps_per_tick", "timestep"}),
    }
    area = table_area(base.config, blueprints)
    return data if area is None else {**data, "table_area": _json(area)}


def _rack_regions(realized: BenchmarkScene) -> dict[str, Region]:
    """Return the bounding boxes of racks: for KitchenBench, a dish in the box is in the rack."""
    simulator = realized.simulator
    world = make_sim_world(simulator.scene, simulator.state_replay.data, ())
    found = {}
    for rack in realized.blueprint.roles.get("rack", ()):
        low, high = world.local_box(rack)
        x, y, _ = (low + high) / 2
        length, width, height = (float(side) for side in high - low)
        position = (float(x), float(y), float(low[2]))
        found[rack_region(rack)] = Region(of=rack, position=position, size=(length, width, height))
    return found


def _json(config: Config) -> dict[str, Any]:
    return config.model_dump(mode="json", exclude_defaults=True)


def _parse_scene_and_realization(name: str) -> tuple[Scene, int]:
    path, _, epoch = name.partition("@")
    task, _, instance = path.partition("/")
    if task not in tasks.TASK_FACTORIES:
        raise UsageError(f"kitchenbench/{name}: unknown task {task!r}; {suggest_similar(task, tasks.TASK_FACTORIES)}")
    before = f"{task.replace('_', '-')}-"
    scenes = {scene.id.removeprefix(before): scene for scene in tasks.TASK_FACTORIES[task]().scenes}
    if instance not in scenes:
        raise UsageError(f"kitchenbench/{name}: {task} has no scene {instance!r}; {suggest_similar(instance, scenes)}")
    if epoch and not epoch.isdecimal():
        raise UsageError(f"kitchenbench/{name}: {epoch!r} is not a realization; give a whole number, 0 or more")
    return scenes[instance], int(epoch or 0)


def _epochs_from(first: int) -> Iterator[int]:
    yield first
    yield from (number for number in range(_EPOCHS) if number != first)


def _scene_seed(scene: Scene, epoch: int) -> int:
    return int(derive_seed(0, scene.init_seed, epoch))


def _scene_blueprint(scene: Scene, epoch: int) -> SceneBlueprint:
    return build_blueprint(scene, _scene_seed(scene, epoch))


def _scene_requirements(blueprint: SceneBlueprint) -> tuple[object, ...]:
    """Return what realizations of one task have in common.

    The amount of pasta, a lid's torque and the required area are those of the task's first realization.
    """
    slot = blueprint.conditions.get("slot_width_cm")
    text = blueprint.instruction if blueprint.target_kind != GoalKind.SCOOP else ""  # it contains the amount
    return (slot, text, *((item.name, item.asset, item.size_cm) for item in blueprint.objects))


def _rounded_place(place: tuple[str, np.ndarray]) -> tuple[str, list[float]]:
    """Round an object's place in `world`: x and y to 0.01 mm, the heading to 0.01 degrees."""
    name, T = place
    turn = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    return name, [round(float(T[0, 3]), 5), round(float(T[1, 3]), 5), round(turn, 2)]


def _start_region(name: str, arrangements: list[dict[str, Any]]) -> dict[str, Any]:
    x, y, turn = np.array([one["places"][name] for one in arrangements]).T
    return {
        "on": TABLE,
        **{key: [float(row.min()), float(row.max())] for key, row in (("x", x), ("y", y), ("yaw_deg", turn))},
    }
