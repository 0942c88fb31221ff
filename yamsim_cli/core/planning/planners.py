"""The planners of the kinds of task."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..config.recording import RecordConfig
from ..scene.compiled import CompiledScene
from .demonstration import ArmTools, OneArmPlanner, Planner, arm_tools
from .handover import HandoverPlanner

# Kind of task -> its planner, for kinds that one arm cannot do.
_PLANNERS: dict[str, Callable[[RecordConfig, CompiledScene, Sequence[ArmTools]], Planner]] = {
    "handover": HandoverPlanner,
}


def make_planner(config: RecordConfig, scene: CompiledScene) -> Planner:
    """The planner of a recording's task."""
    return _PLANNERS.get(config.pair.kind, OneArmPlanner)(config, scene, arm_tools(config, scene))
