from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..core.config.rig import RigConfig
from ..core.geometry.se3 import Array

FOV_DEG = 45.0  # deg, vertical field of view
_AZIMUTH_DEG, _ELEVATION_DEG = 150.0, -32.0  # deg, from the front, to one side and above

# Sphere around an arm in its rest posture and its calibration board; the view must contain the sphere.
_ARM_SPHERE_CENTRE = (0.12, 0.0, 0.17)  # m, in the arm's base frame
_ARM_SPHERE_RADIUS = 0.34  # m
_TABLE_MARGIN = 0.12  # m, added to the radius for a task's table


@dataclass(frozen=True)
class Viewpoint:
    """A camera that orbits a point, in MuJoCo's convention.

    Attributes:
        look_at: the point (3,) in `world`, m.
        azimuth_deg: heading of the line of sight about world z, from +x.
        elevation_deg: above the horizon; negative values look down.
    """

    look_at: Array
    distance: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def position(self) -> Array:
        """Position (3,) of the camera in `world`, m."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        sight = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation))
        return self.look_at - self.distance * np.array(sight)


def workspace_viewpoint(x: float, y: float, z: float, span: float = 0.0) -> Viewpoint:
    """Return a viewpoint of a table and its arms, towards a point in `world`, m.

    `span` is the distance between the bases of the outermost arms, m.
    """
    return _sphere_viewpoint(np.array([x, y, z]), _ARM_SPHERE_RADIUS + _TABLE_MARGIN + span / 2)


def rig_viewpoint(rig: RigConfig) -> Viewpoint:
    """Return a viewpoint that shows all arms and boards of a rig."""
    bases = [rig.T_base_in_world(arm) for arm in range(len(rig.arms))]
    centres = np.array([(T @ (*_ARM_SPHERE_CENTRE, 1.0))[:3] for T in bases])
    look_at: Array = centres.mean(axis=0)
    return _sphere_viewpoint(look_at, _ARM_SPHERE_RADIUS + float(np.linalg.norm(centres - look_at, axis=1).max()))


def _sphere_viewpoint(look_at: Array, radius: float) -> Viewpoint:
    """Return a viewpoint that shows a sphere around `look_at` with this radius, m."""
    return Viewpoint(look_at, radius / math.sin(math.radians(FOV_DEG / 2)), _AZIMUTH_DEG, _ELEVATION_DEG)
