"""Where a viewer's camera is at first."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..config.rig import RigConfig
from ..geometry.se3 import Array

FOV_DEG = 45.0

# A ball that has to be in the picture for each base: its centre in the base's frame, and its radius, m. It contains an
# arm at rest and its board.
_MIDDLE = (0.12, 0.0, 0.17)
_REACH = 0.34


@dataclass(frozen=True)
class Viewpoint:
    """A camera in orbit around a point, in MuJoCo's terms.

    Attributes:
        look_at: the point (3,) in `world`, m.
        distance: distance from the point, m.
        azimuth_deg: heading of the line of sight about world z, from +x.
        elevation_deg: angle of the line of sight above the horizon; a negative one looks down.
    """

    look_at: Array
    distance: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def position(self) -> Array:
        """Where the camera is (3,) in `world`, m."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        sight = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation))
        return self.look_at - self.distance * np.array(sight)


def frame_workspace(x: float, y: float, z: float, span: float = 0.0) -> Viewpoint:
    """A view of a table and its arms, from the front, to one side and above.

    Args:
        x, y, z: the point in `world` to look at, m.
        span: distance between the outermost arms' places, m.
    """
    radius = _REACH + 0.12 + span / 2
    distance = radius / math.sin(math.radians(FOV_DEG / 2))
    return Viewpoint(np.array([x, y, z]), distance, azimuth_deg=150.0, elevation_deg=-32.0)


def frame_rig(rig: RigConfig) -> Viewpoint:
    """A view of all arms and boards of a rig, from the front, to one side and above."""
    bases = [rig.T_base_in_world(arm) for arm in range(len(rig.arms))]
    middles = np.array([(T @ (*_MIDDLE, 1.0))[:3] for T in bases])
    look_at: Array = middles.mean(axis=0)
    radius = _REACH + float(np.linalg.norm(middles - look_at, axis=1).max())
    return Viewpoint(look_at, radius / math.sin(math.radians(FOV_DEG / 2)), azimuth_deg=150.0, elevation_deg=-32.0)
