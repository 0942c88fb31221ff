"""Convert KitchenBench scenes to yamsim tasks, which can be recorded without KitchenBench."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from inspect_robots import Scene
from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint
from kitchenbench.sim.blueprint import SceneBlueprint
from kitchenbench.sim.success import CONTACT_TOL_M, CONTAIN_FRACTION

from ..core.config.goals.world import TABLE
from ..core.config.program_task import PROGRAM_KIND
from ..core.errors import UsageError, suggest_similar
from ..core.expert.skills.program import skill_name
from ..core.expert.skills.skill import Skill
from .benchmark_scene import STATION_RIG, build_benchmark_scene, open_station_session, table_for_scene
from .object_poses import feasible_poses
from .skill_programs import build_scene_program

_MAX_ARRANGEMENTS, _EPOCHS = 100, 600
_HOLD_SECONDS = 0.5  # s; KitchenBench's checkers require a single state
_SUPPORTED_GOAL_KINDS = (
    "place_on",
    "stack",
    "place_in",
    "handoff",
)  # without sorting: compartments are not objects of a task


def scene_task_data(name: str) -> dict[str, Any]:
    """Return the task of a scene, as the data of a task's YAML.

    The name is `TASK/INSTANCE`, such as `stack/cups`; with `@K`, of the scene's epoch K instead of 0. That epoch gives
    objects, instruction and expert. It has one arrangement for each of up to 100 epochs with the same objects.
    """
    scene, epoch = _parse_scene_and_realization(name)
    first = _scene_blueprint(scene, epoch)
    if first.target_kind not in _SUPPORTED_GOAL_KINDS:
        raise UsageError(
            f"kitchenbench/{name}: goals of kind {first.target_kind!r} cannot be recorded; "
            f"valid: {', '.join(_SUPPORTED_GOAL_KINDS)}"
        )
    base = open_station_session("64x48", images=False)
    if table_for_scene(base.config, first) != base.config.scene.table:
        raise UsageError(
            f"kitchenbench/{name}: its things do not fit onto the station's table; try another realization, such "
            f"as {name.partition('@')[0]}@{epoch + 1}"
        )
    realized = build_benchmark_scene(first, base)
    try:
        arrangements = []
        for number in _epochs_from(epoch):
            blueprint = _scene_blueprint(scene, number)
            if _scene_requirements(blueprint) == _scene_requirements(first):
                places = feasible_poses(realized.simulator, blueprint)
                arrangements.append(
                    {"seed": _scene_seed(scene, number), "places": dict(map(_rounded_place, places.items()))}
                )
            if len(arrangements) == _MAX_ARRANGEMENTS:
                break
    finally:
        realized.simulator.close()
    items, timing = realized.object_configs, realized.simulator.config.task.timing
    return {
        "name": f"kitchenbench_{first.scene_id.replace('-', '_')}",
        "kind": PROGRAM_KIND,
        "rig": STATION_RIG,
        "things": {name: {"of": [item.model_dump(mode="json", exclude_defaults=True)]} for name, item in items.items()},
        "starts": {name: _start_region(name, arrangements) for name in items},
        "arrangements": arrangements,
        "phrasings": {"training": [first.instruction]},
        "goal": {"all": [_goal_data(first)], "for_s": _HOLD_SECONDS},
        "expert": [_skill_data(skill) for skill in build_scene_program(first, items, realized.base_positions)],
        "timing": {"physics_steps_per_tick": timing.physics_steps_per_tick, "timestep": timing.timestep},
    }


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
    slot = blueprint.conditions.get("slot_width_cm")
    return (slot, blueprint.instruction, *((item.name, item.asset, item.size_cm) for item in blueprint.objects))


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


def _goal_data(blueprint: SceneBlueprint) -> Mapping[str, Any]:
    """Return data of a task's YAML for a goal that is equivalent to KitchenBench's checker."""
    roles = blueprint.roles
    match blueprint.target_kind:
        case "place_on":
            return {"over": {"thing": roles["item"][0], "surface": roles["surface"][0], "gap": CONTACT_TOL_M}}
        case "stack":
            return {"piled": {"things": list(roles["stack"]), "gap": CONTACT_TOL_M}}
        case "place_in":
            return {"in": {"thing": roles["item"][0], "container": roles["rack"][0], "share": CONTAIN_FRACTION}}
    receiving = str(blueprint.success_params.get("receiving_arm", "either"))
    return {"handed_over": {"thing": roles["item"][0], "to": receiving}}


def _skill_data(skill: Skill) -> dict[str, Any]:
    return {skill_name(skill): skill.model_dump(mode="json", exclude_defaults=True)}
