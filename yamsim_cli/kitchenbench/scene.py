"""A scene of the benchmark as one of ours: its things on the station's table, at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint

from ..core.attempt.expert import sides
from ..core.attempt.simulator import Simulator
from ..core.config.program_task import PROGRAM, ProgramTask
from ..core.config.recording import RecordConfig
from ..core.config.scene import Table
from ..core.config.things.thing import ObjectConfig
from ..core.episode.episode import Episode
from ..core.geometry.se3 import Array, pose, rotation_z
from ..core.goals.cast import Cast
from ..core.planning.arm_tools import start_stands
from ..core.scene.compiled import CompiledScene
from ..core.session import Session
from ..core.sim.settle import settle
from ..core.sim.world import Region, SimWorld
from ..core.types import Layout
from .catalog import COMPARTMENT, thing_of
from .linen import CRUMPLED, FOLD, SHEETS, crumpled_start, laid, sheet_of
from .places import BESIDE, T_in_world, free_places, origin

#: Kinds of goals that are realized.
KINDS = frozenset({"place_on", "stack", "place_in", "handoff", "sort", FOLD})

# The kind of goal for which a cup goes into nothing.
_HANDED_OVER = "handoff"

#: The rate of control ticks, Hz.
TICK_HZ = 30
# Physics steps a tick, and of scenes with cloth.
_STEPS, _CLOTH_STEPS = 16, 8

# A table that a scene needs wider than it is ends so far beside its things, m.
_EDGE = 0.10
# Things are let down from so high over the table, wait for that so far apart above it, and fall the last bit, m.
_OVER, _AWAY, _GAP = 0.5, 2.0, 0.001
# The floor of our tray's compartments, m.
_TRAY_FLOOR = 0.005

# What a blueprint asks for that is a matter of how a policy does it, and what has a physics of its own here.
_UP_TO_THE_POLICY = frozenset(
    {"slot_index", "handoff_height_cm", "approach_angle_deg", "approach_tilt_deg", "release_x_cm"}
)
_REALIZED = frozenset({"slot_width_cm", CRUMPLED})


@dataclass(frozen=True)
class Realization:
    """A scene of the benchmark, compiled and at rest. Close its simulator when it is not needed any more.

    Attributes:
        blueprint: what was asked for.
        simulator: with the compiled scene.
        start: MuJoCo's positions (nq,) with everything at rest.
        regions: name -> the part of a thing that a blueprint's object is.
        offsets_mm: thing -> how far from where the blueprint asks for it it came to rest, seen from above.
        unrealized: what the blueprint asks for that is not given, as sentences.
    """

    blueprint: SceneBlueprint
    simulator: Simulator
    start: Array
    regions: Mapping[str, Region]
    offsets_mm: Mapping[str, float]
    unrealized: tuple[str, ...]

    @property
    def items(self) -> dict[str, ObjectConfig]:
        """What the blueprint's things are here, by their names."""
        return {item.name: item for item in self.simulator.config.task.objects}

    @property
    def bases(self) -> list[Array]:
        """Where the arms stand (2,), in `world`, m."""
        return [arm.T_base_in_world[:2, 3] for arm in self.simulator.scene.arms]

    @property
    def sides(self) -> tuple[str, ...]:
        """Of the scene's arms."""
        return sides(self.simulator.config)

    def episode(self) -> Episode:
        """Return a new episode, which the benchmark's checker judges."""
        scene, timing = self.simulator.scene, self.simulator.config.task.timing
        return Episode(
            scene,
            self.start,
            timing,
            self.sides,
            None,
            world=lambda data: SimWorld(
                scene.model, data, scene.arms, self.sides, scene.things, regions=self.regions, cloths=scene.cloths
            ),
        )


def realize(blueprint: SceneBlueprint, base: Session) -> Realization:
    """The scene that a blueprint asks for.

    Args:
        base: a session of the station, whose task is replaced.

    Raises:
        LookupError: the blueprint has something that is not realized.
        SimulationError: its scene cannot be compiled.
    """
    if blueprint.target_kind not in KINDS:
        raise LookupError(
            f"scene {blueprint.scene_id!r}: goals of kind {blueprint.target_kind!r} are not realized; "
            f"those are: {', '.join(sorted(KINDS))}"
        )
    things = [item for item in blueprint.objects if item.asset != COMPARTMENT]
    nests = blueprint.target_kind != _HANDED_OVER
    objects = [
        sheet_of(item, blueprint, base.locations)
        if item.asset in SHEETS or blueprint.target_kind == FOLD
        else thing_of(item, blueprint.conditions, base.locations, nests)
        for item in things
    ]
    config = base.config
    task = _task(blueprint, config, {item.name: item for item in objects})
    scene = config.scene.model_copy(update={"table": table_of(config, blueprint)})
    cast = _cast(blueprint)
    simulator = Simulator(base.with_values(task=task, scene=scene), cast)
    wanted = {item.name: T_in_world(item, blueprint) for item in things}
    start = settle(simulator.scene, _let_down(simulator, free_places(simulator, blueprint)), task.timing.timestep)
    start = crumpled_start(blueprint, simulator.scene, start, task.timing.timestep)
    offsets = {
        name: round(1000 * float(np.linalg.norm(_place(simulator.scene, start, name) - T[:2, 3])), 2)
        for name, T in wanted.items()
    }
    return Realization(blueprint, simulator, start, _regions(blueprint), offsets, _unrealized(blueprint, offsets))


def _place(scene: CompiledScene, qpos: Array, name: str) -> Array:
    """Where the middle of a thing is (2,) at MuJoCo's positions (nq,), m."""
    if name in scene.cloths:
        middle: Array = scene.cloths[name].points(qpos)[:, :2].mean(axis=0)
        return middle
    address = scene.object_qpos[name]
    return qpos[address : address + 2]


def _task(blueprint: SceneBlueprint, config: RecordConfig, objects: Mapping[str, ObjectConfig]) -> ProgramTask:
    """The scene as a task of ours. Its goal and its expert are never asked: the benchmark's checker judges."""
    first = next(iter(objects))
    folds = objects[first].cloth is not None
    steps = _CLOTH_STEPS if any(item.cloth is not None for item in objects.values()) else _STEPS
    place = {"x": (0.0, 0.0), "y": (0.0, 0.0)}
    return ProgramTask.model_validate(
        {
            "name": blueprint.scene_id.replace("-", "_"),
            "kind": PROGRAM,
            "rig": config.rig.name,
            "things": {name: {"of": (item,)} for name, item in objects.items()},
            "starts": dict.fromkeys(objects, place),
            "phrasings": {"training": (blueprint.instruction,)},
            "goal": {"all": [{"folded" if folds else "upright": {"thing": first}}]},
            "expert": ({"fold" if folds else "pick": {"thing": first}},),
            "timing": {"physics_steps_per_tick": steps, "timestep": 1.0 / (TICK_HZ * steps)},
            "start_joints": config.start_joints,
        }
    )


def table_of(config: RecordConfig, blueprint: SceneBlueprint) -> Table:
    """The table, wide enough for all that a scene puts onto it: some ask for more than the arms reach."""
    things = [item for item in blueprint.objects if item.asset != COMPARTMENT]
    table = config.scene.table
    assert table is not None  # checked when the config was loaded
    if blueprint.target_kind == FOLD:
        for item in things:
            table = laid(table, item, origin(blueprint))
        return table
    reach = (
        max(abs(item.x_cm - 100 * BESIDE) + (item.size_cm or ASSETS[item.asset].footprint_w_cm) / 2 for item in things)
        / 100
    )
    wide = table.half_size[1] + config.rig.span / 2
    return table.widened(max(0.0, 2 * (reach + _EDGE - wide)))


def _cast(blueprint: SceneBlueprint) -> Cast:
    kinds = {item.name: item.asset for item in blueprint.objects}
    return Cast({**{name: (name,) for name in kinds}, **blueprint.roles}, kinds)


def _regions(blueprint: SceneBlueprint) -> dict[str, Region]:
    found = {}
    for item in blueprint.objects:
        if item.asset == COMPARTMENT:
            assert item.parent is not None, "a compartment is part of a tray"
            asset = ASSETS[item.asset]
            size = np.array([asset.footprint_w_cm, asset.footprint_h_cm, asset.height_cm]) / 100
            T = pose((item.x_cm / 100, item.y_cm / 100, _TRAY_FLOOR), rotation_z(math.radians(item.yaw_deg)))
            found[item.name] = Region(item.parent, T, size)
    return found


def _let_down(simulator: Simulator, wanted: Mapping[str, Array]) -> Array:
    """MuJoCo's positions (nq,) with everything let down on what is below it, one thing after the other."""
    scene, top = simulator.scene, simulator.config.table.top
    # Until its turn comes, each thing is where nothing else is.
    away = {name: pose((0.0, 0.0, top + _AWAY * (k + 1))) for k, name in enumerate(wanted)}
    qpos = scene.start_qpos(Layout(away), start_stands(simulator.config))
    for name, T_wanted in wanted.items():
        T = T_wanted.copy()
        if name in scene.cloths:
            T[2, 3] = top + scene.cloths[name].radius + _GAP
            scene.put(qpos, name, T)
            continue
        T[2, 3] = top + _OVER
        T[2, 3] = simulator.expert_tools.rest_height(qpos, name, T, top - _OVER) + _GAP
        scene.put(qpos, name, T)
    return qpos


# From here on, a thing does not lie where it was asked for, mm.
_OFF = 5.0


def _unrealized(blueprint: SceneBlueprint, offsets: Mapping[str, float]) -> tuple[str, ...]:
    """What a blueprint asks for, and is not given: sentences for a log."""
    said = []
    for name, value in blueprint.conditions.items():
        if name in _UP_TO_THE_POLICY:
            said.append(f"{name}={value}: up to the policy; nothing holds it to that")
        elif name not in _REALIZED:
            said.append(f"{name}={value}: not realized")
    for item in blueprint.objects:
        if item.amount_g is not None:
            said.append(f"{item.name}: amount_g={item.amount_g:g}: not realized")
        if (off := offsets.get(item.name, 0.0)) > _OFF:
            said.append(f"{item.name}: came to rest {off:.0f} mm from where it was asked for")
    return tuple(said)
