"""The expert of a task that is data: its skills, run on a simulated scene."""

from __future__ import annotations

import math

import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..planning.demonstration import ArmTools, start_stands
from ..planning.ik import Tolerance
from ..planning.obstacles import Obstacles
from ..scene.compiled import CompiledScene, Kind
from ..sim.world import SimWorld
from ..skills.bench import Bench
from ..skills.hand import Hand
from ..types import Stand

# m and rad; whether a place can be reached at all, its margin to a stop does not matter.
_ANYHOW = Tolerance(3e-3, math.radians(4.0), margin=0.0)


class ExpertTools:
    """What skills plan with in one scene, as far as it does not depend on the attempt."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: tuple[ArmTools, ...]) -> None:
        self._config, self._scene, self._tools = config, scene, tools
        fingers = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)
        geoms = [
            np.flatnonzero((scene.geom_arm == k) & np.isin(scene.geom_kind, fingers)) for k in range(len(scene.arms))
        ]
        self._obstacles = Obstacles(scene.model, scene.arms, list(scene.things), geoms)

    def reaches(self, T_pinch_in_world: Array) -> bool:
        """Whether some hand comes to a pose (4, 4) of its pinch frame, whatever it would touch there."""
        for tools, stand in zip(self._tools, start_stands(self._config), strict=True):
            tools.ik.hold(np.eye(4))
            if tools.ik.reach(T_pinch_in_world, [stand.joints], _ANYHOW) is not None:
                return True
        return False

    def rest_height(self, qpos: Array, thing: str, T_in_world: Array, lowest: float) -> float:
        """The height at which a thing that comes straight down meets something, see `Obstacles.rest_height`."""
        return self._obstacles.rest_height(qpos, thing, T_in_world, lowest)

    def bench(self, world: SimWorld, stands: list[Stand], rng: np.random.Generator) -> Bench:
        """A bench for one attempt, whose arms stand where it starts."""
        config, scene = self._config, self._scene
        hands = [
            Hand(k, side, arm, tools.ik, tools.dynamics, stand.joints, stand.opening)
            for k, (side, arm, tools, stand) in enumerate(
                zip(sides(config), scene.arms, self._tools, stands, strict=True)
            )
        ]
        items = {item.name: item for item in config.task.objects}
        return Bench(scene.model, world, hands, items, self._obstacles, rng, config.task.timing.tick)


def sides(config: RecordConfig) -> tuple[str, ...]:
    """The sides of the scene's arms, in its order."""
    return tuple(config.rig.arms[number].side for number in config.rig.recorded)
