"""Put a screw lid onto its jar."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.expert.skills.hand import Hand
from ..core.expert.skills.place import Place, pose_raised_by
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext
from ..core.geometry.se3 import Array


class PlaceScrewLid(Place):
    """Put a screw lid onto its jar without turning it.

    Around the lid, the fingers are 3 mm beside the jar's neck, and the planner keeps 4 mm. Contacts are therefore
    checked `drop` (m) above the goal. The hand then lowers the lid until it is seated: a lid that falls tilts.
    """

    def _lower_and_release(
        self, context: PlanningContext, hand: Hand, thing: str, T_goal: Array
    ) -> Iterator[MotionSegment]:
        yield from super()._lower_and_release(context, hand, thing, pose_raised_by(T_goal, -self.drop))
