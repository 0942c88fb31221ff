"""Where a policy grasped and left the task's object. A mean far from the expert's shows a bias."""

from __future__ import annotations

from collections.abc import Mapping

from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose


def _object_and_target(simulator: Simulator) -> tuple[str, str] | None:
    """Return the names of the object and the surface whose distance scores the task; None for other goals."""
    target, roles = simulator.config.task.target_predicate, simulator.roles
    return None if target is None else (roles.object_of(target.thing), roles.object_of(target.surface))


def final_offset(simulator: Simulator, T_at_end: Mapping[str, Array]) -> tuple[float, float] | None:
    """Return the position (x, y) of the task's object minus its target's, in `world`, m; None without a target."""
    names = _object_and_target(simulator)
    if names is None:
        return None
    x, y, _ = (float(value) for value in T_at_end[names[0]][:3, 3] - T_at_end[names[1]][:3, 3])
    return x, y


class GraspOffsetMonitor:
    """Measures where the task's object is in the hand at the tick of each grasp.

    Attributes:
        offset: position (x, y, z) of the object's origin in the hand's `pinch_site` at the last grasp, m; None before.
    """

    def __init__(self, simulator: Simulator, episode: Episode) -> None:
        names = _object_and_target(simulator)
        self._object = None if names is None or names[0] in simulator.scene.cloths else names[0]
        self._scene, self._episode = simulator.scene, episode
        self._holders: tuple[str, ...] = ()
        self.offset: tuple[float, float, float] | None = None

    def measure_tick(self) -> None:
        """Measure the state after a control tick, if a hand has just grasped the object."""
        if self._object is None:
            return
        world = self._episode.world
        holders = world.holders_since_rest(self._object)
        if len(holders) > len(self._holders):
            arm = self._scene.arms[world.sides.index(holders[-1])]
            site = self._episode.data.site(f"{arm.prefix}pinch_site")
            T = invert_pose(pose(site.xpos, site.xmat.reshape(3, 3))) @ world.pose(self._object)
            x, y, z = (float(value) for value in T[:3, 3])
            self.offset = x, y, z
        self._holders = holders
