"""The planner of each kind of task."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..config.record import RecordConfig
from ..resources import Locations
from ..scene.compiled import CompiledScene
from .demonstration import ArmTools, OneArmPlanner, Planner, arm_tools
from .handover import HandoverPlanner

_PLANNERS: dict[str, Callable[[RecordConfig, CompiledScene, Sequence[ArmTools]], Planner]] = {
    "pickplace": OneArmPlanner,
    "handover": HandoverPlanner,
}


def make_planner(config: RecordConfig, scene: CompiledScene, locations: Locations) -> Planner:
    """The planner of a recording's task."""
    return _PLANNERS[config.task.kind](config, scene, arm_tools(config, scene, locations))
