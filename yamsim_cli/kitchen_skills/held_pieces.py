"""Loose pieces, and which of them a held object contains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.attempt_data import FailureCause
from ..core.config.program_task import ProgramTask
from ..core.expert.skills.planning_context import PlanningContext, SkillFailedError
from ..core.geometry.se3 import Array
from ..loose_pieces import piece_name_prefix


class LoosePieces:
    """The loose pieces of a filled object, and how many of them are in `holder` now.

    Attributes:
        length: of a piece, m.

    Args:
        filled: the object that the pieces fill at the start.
        holder: the object that a hand holds; by default `filled`.
    """

    def __init__(self, context: PlanningContext, filled: str, holder: str | None = None) -> None:
        self._context, self._world = context, context.world
        self._filled, self._holder = filled, holder or filled
        self._empty = context.object_configs[self._holder]
        model, prefix = context.model, piece_name_prefix(filled)
        self._bodies = np.array([k for k in range(model.nbody) if model.body(k).name.startswith(prefix)], dtype=int)
        if not len(self._bodies):
            raise SkillFailedError(FailureCause.UNREACHABLE, f"the {filled} has no loose pieces")
        self.length = 2 * float(model.geom_size[model.body_geomadr[self._bodies[0]]][:2].sum())

    def weigh(self) -> None:
        """Let the planning context know the mass and the centre of mass of the holder with the pieces in it now."""
        data, model = self._world.data, self._context.model
        T = self._world.pose(self._holder)
        bodies = self._bodies[self._are_inside()]
        masses = model.body_mass[bodies]
        centres = (data.xipos[bodies] - T[:3, 3]) @ T[:3, :3]
        empty = self._empty.inertia
        total = empty.mass + float(masses.sum())
        centre = (empty.mass * np.array(empty.centre) + masses @ centres) / total
        inertia = empty.model_copy(update={"mass_g": 1000 * total, "centre": tuple(float(x) for x in centre)})
        filled = self._empty.model_copy(update={"inertia": inertia})
        self._context.object_configs = {**self._context.object_configs, self._holder: filled}

    @property
    def centres(self) -> Array:
        """The centres (n, 3) of all pieces in `world`, m."""
        centres: Array = self._world.data.xipos[self._bodies]
        return centres

    @property
    def grams_each(self) -> float:
        """The mass of a piece, g; all have the same."""
        return 1000 * float(self._context.model.body_mass[self._bodies[0]])

    def grams(self, counted: NDArray[np.bool_]) -> float:
        """Return the mass of the pieces with a flag (n,), g."""
        return 1000 * float(self._context.model.body_mass[self._bodies[counted]].sum())

    def grams_in(self, container: str) -> float:
        """Return the mass of the pieces whose centres are in a container's interior, g."""
        return self._world.grams_inside(self._filled, container)

    @property
    def share_outside(self) -> float:
        """Share of the pieces that are not in the holder."""
        return 1.0 - float(self._are_inside().mean())

    def _are_inside(self) -> NDArray[np.bool_]:
        return self._world.points_inside(self._holder, self.centres)


def fault_of_pieces(task: ProgramTask, argument: str, role: str) -> tuple[str, str] | None:
    """Return a `Skill.task_fault` if a role has no loose pieces."""
    if task.things[task.role_of(role)].filled is not None:
        return None
    return argument, f"the {role} has no loose pieces; add `filled` to the role, or give another one"


def fault_of_shape(task: ProgramTask, argument: str, role: str, families: Sequence[str]) -> tuple[str, str] | None:
    """Return a `Skill.task_fault` if the `shape` of one of a role's objects has none of some families."""
    for item in task.possible_objects(role):
        if item.shape is None or item.shape.family not in families:
            wanted = " or ".join(families)
            return argument, f"the {item.name} is not suitable; give an object whose `shape` has the family {wanted}"
    return None
