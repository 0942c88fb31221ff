"""The expert of a task that is data: its skills, run on a simulated scene."""

from __future__ import annotations

import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..planning.demonstration import ArmTools, start_stands
from ..planning.obstacles import Obstacles
from ..planning.quick_reach import QuickReach
from ..scene.compiled import CompiledScene, Kind
from ..scene.robot import bare_arm
from ..sim.world import SimWorld
from ..skills.bench import Bench
from ..skills.hand import Hand
from ..types import Stand


class ExpertTools:
    """What skills plan with in one scene, as far as it does not depend on the attempt."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: tuple[ArmTools, ...]) -> None:
        self._config, self._scene, self._tools = config, scene, tools
        fingers = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)
        geoms = [
            np.flatnonzero((scene.geom_arm == k) & np.isin(scene.geom_kind, fingers)) for k in range(len(scene.arms))
        ]
        self._obstacles = Obstacles(scene.model, scene.arms, list(scene.things), geoms)
        self._quick = [QuickReach(bare_arm(config.rig.arms[arm.number]), arm.T_base_in_world) for arm in scene.arms]

    def reaches(self, T_pinch_in_world: Array) -> bool:
        """Whether a hand that acts comes to a pose (4, 4) of its pinch frame, whatever it would touch there."""
        stands = start_stands(self._config)
        return any(
            self._quick[k].solve(T_pinch_in_world, np.array(stands[k].joints)) is not None
            for k in self._config.acting_scene_arms
        )

    def rest_height(self, qpos: Array, thing: str, T_in_world: Array, lowest: float) -> float:
        """The height at which a thing that comes straight down meets something, see `Obstacles.rest_height`."""
        return self._obstacles.rest_height(qpos, thing, T_in_world, lowest)

    def bench(self, world: SimWorld, stands: list[Stand], rng: np.random.Generator) -> Bench:
        """A bench for one attempt, whose arms stand where it starts."""
        config, scene = self._config, self._scene
        hands = [
            Hand(k, side, arm, tools.ik, quick, tools.dynamics, stand.joints, stand.opening)
            for k, (side, arm, tools, quick, stand) in enumerate(
                zip(sides(config), scene.arms, self._tools, self._quick, stands, strict=True)
            )
        ]
        items = {item.name: item for item in config.task.objects}
        acting, first = config.acting_scene_arms, config.rig.recorded.index(config.first_arm)
        return Bench(scene.model, world, hands, acting, first, items, self._obstacles, rng, config.task.timing.tick)


def sides(config: RecordConfig) -> tuple[str, ...]:
    """The sides of the scene's arms, in its order."""
    return tuple(config.rig.arms[number].side for number in config.rig.recorded)
