"""Sessions of the two-arm YAM station, and KitchenBench's scenes on its table, with all objects at rest."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject

from ..core.attempt_data import ObjectLayout
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.program_task import PROGRAM_KIND, ProgramTask
from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.config.task_objects import Filling, Region, TableArea
from ..core.episode.episode import Episode
from ..core.episode.expert import arm_sides
from ..core.episode.simulator import Simulator
from ..core.expert.planning.arm_solvers import start_postures
from ..core.geometry.se3 import Array, pose
from ..core.scene.compiled import CompiledScene
from ..core.sim.settling import settle_objects
from ..session_opener import SessionOpener, parse_size
from .asset_configs import (
    CLOTH_CONFIGS,
    COMPARTMENT,
    CRUMPLE_CONDITION,
    cloth_config_of,
    container_config_of,
    crumpled_start,
    object_config_of,
)
from .goal_kinds import GoalKind
from .lids import LID_CONDITIONS
from .object_poses import BESIDE, T_in_world, feasible_poses, origin_in_world
from .pasta import (
    STRAND_CONDITION,
    describe_coarse_pieces,
    describe_pile,
    describe_tool,
    fillings_of,
    is_body,
    is_pile,
    pasta_config_of,
)

STATION_RIG = "yam_station_linear_4310_d405"  # name of the rig's config
TICK_HZ = 30  # Hz, control ticks

_PASTA_KINDS = (GoalKind.POUR, GoalKind.SCOOP)  # kinds of goals with loose pieces

_PLACEHOLDER_TASK = "tower"  # replaced by a scene of KitchenBench
_PHYSICS_STEPS, _CLOTH_PHYSICS_STEPS = 16, 8  # per control tick, without and with cloth

_TABLE_MARGIN = 0.10  # m, from objects to the edge of a widened table
_CLOTH_MARGIN = 0.05  # m, border of the table around flat cloth
_DROP_HEIGHT = 0.5  # m over the table, where the search for the resting height starts
_SPARE_HEIGHT = 2.0  # m, between objects that wait above the table
_SPAWN_GAP = 0.001  # m, between a placed object and its support
_TRAY_FLOOR_THICKNESS = 0.005  # m, of the tray's compartments
_MAX_OFFSET_MM = 5.0  # mm; an object that rests farther from its required place is reported in `unrealized`

# Conditions of a blueprint that depend on how a policy acts, and conditions that built scenes fulfil.
_POLICY_CONDITIONS = frozenset(
    {
        "slot_index",
        "handoff_height_cm",
        "approach_angle_deg",
        "approach_tilt_deg",
        "release_x_cm",
        "brace_force_n",
        "pour_height_cm",
        "pour_angle_deg",
        "steadying_force_n",
        "transfer_height_cm",
    }
)
_REALIZED_CONDITIONS = frozenset({"slot_width_cm", CRUMPLE_CONDITION, STRAND_CONDITION})

_LOGGER = logging.getLogger("yamsim")
_SESSION_OPENER = SessionOpener(os.environ, _LOGGER.warning, "{}=".format)


def open_station_session(size: str, *, images: bool, quality: str = "fast", task: str = _PLACEHOLDER_TASK) -> Session:
    """Open a session of the station. A KitchenBench scene replaces `task`."""
    given: dict[str, Any] = {"rig": STATION_RIG, "task": task, "size": parse_size(size), "quality": quality}
    where = _SESSION_OPENER.find_locations()
    if "contact" in _SESSION_OPENER.load_record_config("default", where, **given).task.valid_grasps:
        # Actions of Inspect Robots cannot command a weld.
        given["grasp"] = "contact"
    if images:
        return _SESSION_OPENER.open("default", parallel=False, **given)
    return Session(_SESSION_OPENER.load_record_config("default", where, **given), where).without_meshes()


@dataclass(frozen=True)
class BenchmarkScene:
    """A scene of KitchenBench, compiled and at rest. Close its simulator after use.

    Attributes:
        start: MuJoCo's positions (nq,) at rest.
        offsets_mm: object -> horizontal distance from its required place to its resting place, mm.
        unrealized: requirements of the blueprint that the built scene does not fulfil, as sentences.
    """

    blueprint: SceneBlueprint
    simulator: Simulator
    start: Array
    offsets_mm: Mapping[str, float]
    unrealized: tuple[str, ...]

    @property
    def substances(self) -> dict[str, str]:
        """Name of a blueprint's substance -> the object that its pieces fill at the start; a pile fills its dish."""
        filled = self.simulator.scene.pieces
        places = {item.name: item.parent or item.name for item in self.blueprint.objects}
        return {name: place for name, place in places.items() if place in filled}

    @property
    def object_configs(self) -> dict[str, ObjectConfig]:
        """Name of a blueprint's object -> its config."""
        return {item.name: item for item in self.simulator.config.task.objects}

    @property
    def base_positions(self) -> list[Array]:
        """Positions (2,) of the arms' bases in `world`, m."""
        return [arm.T_base_in_world[:2, 3] for arm in self.simulator.scene.arms]

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides of the scene's arms."""
        return arm_sides(self.simulator.config)

    def new_episode(self) -> Episode:
        """Return a new episode without a goal: KitchenBench's checker decides."""
        return Episode(self.simulator.scene, self.start, self.simulator.config.task.timing, self.sides, None)


def build_benchmark_scene(blueprint: SceneBlueprint, base: Session) -> BenchmarkScene:
    """Build the scene of a blueprint, which replaces the task of `base`, a session of the station.

    Raise LookupError for a kind of goal or an object that yamsim does not have.
    """
    if blueprint.target_kind not in list(GoalKind):
        raise LookupError(
            f"scene {blueprint.scene_id!r}: goals of kind {blueprint.target_kind!r} are not supported; "
            f"valid: {', '.join(sorted(GoalKind))}"
        )
    things = [item for item in blueprint.objects if is_body(item)]
    objects = [_config_of(item, blueprint, base) for item in things]
    config = base.config
    fillings = fillings_of(blueprint, base.locations) if blueprint.target_kind in _PASTA_KINDS else {}
    task = _make_task(blueprint, config, {item.name: item for item in objects}, fillings)
    simulator = Simulator(base.with_values(task=task), _role_assignment(blueprint))
    wanted = {item.name: T_in_world(item, blueprint) for item in things}
    start = settle_objects(
        simulator.scene, _lower_objects(simulator, feasible_poses(simulator, blueprint)), task.timing.timestep
    ).qpos
    start = crumpled_start(blueprint, simulator.scene, start, task.timing.timestep)
    offsets = {
        name: round(1000 * float(np.linalg.norm(_horizontal_position(simulator.scene, start, name) - T[:2, 3])), 2)
        for name, T in wanted.items()
    }
    differences = [describe_coarse_pieces(name, one, blueprint, base.locations) for name, one in fillings.items()]
    differences += [describe_pile(item, blueprint) for item in things if is_pile(item)]
    differences += [describe_tool(item, blueprint, base.locations) for item in things]
    unrealized = (*_unrealized_conditions(blueprint, offsets), *differences)
    return BenchmarkScene(blueprint, simulator, start, offsets, tuple(filter(None, unrealized)))


def _config_of(item: SceneObject, blueprint: SceneBlueprint, base: Session) -> ObjectConfig:
    if item.asset in CLOTH_CONFIGS or blueprint.target_kind == GoalKind.FOLD:
        return cloth_config_of(item, blueprint, base.locations)
    if blueprint.target_kind in (GoalKind.OPEN, GoalKind.SEAL):
        return container_config_of(item, blueprint, base.locations)
    if blueprint.target_kind in _PASTA_KINDS:
        return pasta_config_of(item, blueprint, base.locations)
    kind = blueprint.target_kind
    return object_config_of(
        item, blueprint.conditions, base.locations, nests=kind != GoalKind.HANDOFF, is_stacked=kind == GoalKind.STACK
    )


def _horizontal_position(scene: CompiledScene, qpos: Array, name: str) -> Array:
    if name in scene.cloths:
        middle: Array = scene.cloths[name].points(qpos)[:, :2].mean(axis=0)
        return middle
    address = scene.object_qpos[name]
    return qpos[address : address + 2]


def _make_task(
    blueprint: SceneBlueprint,
    config: RecordConfig,
    objects: Mapping[str, ObjectConfig],
    fillings: Mapping[str, Filling],
) -> ProgramTask:
    """Return the scene as a task, without goal and expert: KitchenBench's checker decides."""
    first = next(iter(objects))
    folds = objects[first].cloth is not None
    steps = _CLOTH_PHYSICS_STEPS if any(item.cloth is not None for item in objects.values()) else _PHYSICS_STEPS
    place = {"x": (0.0, 0.0), "y": (0.0, 0.0)}
    return ProgramTask.model_validate(
        {
            "name": blueprint.scene_id.replace("-", "_"),
            "kind": PROGRAM_KIND,
            "rig": config.rig.name,
            "things": {name: {"of": (item,), "filled": fillings.get(name)} for name, item in objects.items()},
            "regions": container_regions(blueprint),
            "table_area": table_area(config, [blueprint]),
            "starts": dict.fromkeys(objects, place),
            "phrasings": {"training": (blueprint.instruction,)},
            "goal": {"all": [{"folded" if folds else "upright": {"thing": first}}]},
            "expert": ({"fold" if folds else "pick": {"thing": first}},),
            "timing": {"physics_steps_per_tick": steps, "timestep": 1.0 / (TICK_HZ * steps)},
            "start_joints": config.start_joints,
        }
    )


def table_area(config: RecordConfig, blueprints: Iterable[SceneBlueprint]) -> TableArea | None:
    """Return the area that the objects of blueprints need, with a margin; None if the station's table is enough."""
    station = config.widened_table
    needed = station
    for blueprint in blueprints:
        for item in filter(is_body, blueprint.objects):
            asset = ASSETS[item.asset]
            if blueprint.target_kind == GoalKind.FOLD:
                # Cloth lies flat at any angle.
                factor = (item.size_cm or asset.footprint_w_cm) / asset.footprint_w_cm
                reach = math.hypot(asset.footprint_w_cm, asset.footprint_h_cm) * factor / 200 + _CLOTH_MARGIN
                x, y = origin_in_world(blueprint)
                needed = needed.covering((x - reach, x + reach), (y - reach, y + reach))
            else:
                width = item.size_cm or asset.footprint_w_cm
                reach = (abs(item.x_cm - 100 * BESIDE) + width / 2) / 100 + _TABLE_MARGIN
                needed = needed.covering((station.position[0],) * 2, (-reach, reach))
    if needed == station:
        return None
    (x, y, _), (length, width, _) = needed.position, needed.half_size
    return TableArea(x=(x - length, x + length), y=(y - width, y + width))


def _role_assignment(blueprint: SceneBlueprint) -> RoleAssignment:
    kinds = {item.name: item.asset for item in blueprint.objects}
    return RoleAssignment({**{name: (name,) for name in kinds}, **blueprint.roles}, kinds)


def container_regions(blueprint: SceneBlueprint) -> dict[str, Region]:
    """Return the compartments of a blueprint's trays."""
    asset = ASSETS[COMPARTMENT]
    size = (asset.footprint_w_cm / 100, asset.footprint_h_cm / 100, asset.height_cm / 100)
    return {
        item.name: Region(
            of=item.parent,
            position=(item.x_cm / 100, item.y_cm / 100, _TRAY_FLOOR_THICKNESS),
            yaw_deg=item.yaw_deg,
            size=size,
        )
        for item in blueprint.objects
        if item.asset == COMPARTMENT and item.parent is not None
    }


def _lower_objects(simulator: Simulator, wanted: Mapping[str, Array]) -> Array:
    """Return MuJoCo's positions (nq,) after all objects have been placed in turn on those below them."""
    scene, top = simulator.scene, simulator.config.widened_table.top_height
    # Objects that are not placed yet are far from all others.
    away = {name: pose((0.0, 0.0, top + _SPARE_HEIGHT * (k + 1))) for k, name in enumerate(wanted)}
    qpos = scene.start_qpos(ObjectLayout(away), start_postures(simulator.config))
    for name, T_wanted in wanted.items():
        T = T_wanted.copy()
        if name in scene.cloths:
            T[2, 3] = top + scene.cloths[name].half_thickness + _SPAWN_GAP
            scene.set_object_pose(qpos, name, T)
            continue
        T[2, 3] = top + _DROP_HEIGHT
        T[2, 3] = simulator.expert_planner.rest_height(qpos, name, T, top - _DROP_HEIGHT) + _SPAWN_GAP
        scene.set_object_pose(qpos, name, T)
    return qpos


def _unrealized_conditions(blueprint: SceneBlueprint, offsets: Mapping[str, float]) -> tuple[str, ...]:
    lines = []
    realized = _REALIZED_CONDITIONS | (LID_CONDITIONS if blueprint.target_kind == GoalKind.OPEN else frozenset())
    for name, value in blueprint.conditions.items():
        if name in _POLICY_CONDITIONS:
            lines.append(f"{name}={value}: up to the policy, and not enforced")
        elif name not in realized:
            lines.append(f"{name}={value}: not simulated")
    for item in blueprint.objects:
        if item.amount_g is not None and blueprint.target_kind != GoalKind.POUR:
            lines.append(f"{item.name}: amount_g={item.amount_g:g}: not simulated")
        if (off := offsets.get(item.name, 0.0)) > _MAX_OFFSET_MM:
            lines.append(f"{item.name}: came to rest {off:.0f} mm from its requested place")
    return tuple(lines)
