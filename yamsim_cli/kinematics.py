"""Forward and inverse kinematics of an arm of any rig.

    from yamsim_cli.kinematics import Kinematics

    arm = Kinematics("russet", arm="left")
    T_pinch_in_base = arm.fk(joints)
    joints = arm.ik(T_pinch_in_base, start=joints)

The module needs no OpenGL, no meshes and no scene.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from .core.config.loader import load_config
from .core.config.rig import RigConfig
from .core.errors import UsageError, suggest_similar
from .core.expert.planning.arm_kinematics import ArmKinematics, OutOfReachError, solve_ik_or_raise
from .core.expert.planning.ik import IkSolver
from .core.files.resources import Locations
from .core.geometry.se3 import Array, pose
from .core.robots.joint_limits import describe_limit_violation
from .core.scene.arm_model import kinematic_model

__all__ = ["KinematicSite", "Kinematics", "OutOfReachError"]

KinematicSite = Literal["pinch_site", "grasp_site"]

# Searches from random start joints, for an arm without analytic inverse kinematics. Source: 1,000 poses of uniformly
# sampled joints needed at most 29 searches.
_RESTARTS = 50
# The same after analytic inverse kinematics. Source: for 25 poses out of reach, 50 searches solved no more than 10 did.
_RESTARTS_ANALYTIC = 10
# Cost of a rotation error of 1 rad about each axis. 1 m costs 10, so 1 rad counts as 0.1 m, about the length of the
# hand. If the arm cannot reach the whole pose, the position decides.
_ROTATION_COSTS = (1.0, 1.0, 1.0)
_LIMIT_TOLERANCE = 0.1  # rad, by which real and simulated arms may exceed joint limits
_ORTHONORMAL_TOLERANCE = 1e-4  # largest accepted element of |R^T R - 1|


class Kinematics:
    """Forward and inverse kinematics of one arm.

    Joints (dof,) are in rad; a YAM has six. The gripper is not included, and its opening has no effect. A pose (4, 4),
    in m, is the pose of `site` in the base frame of the arm (x forward, y left, z up).

    Args:
        rig: a name from `configs/rigs/`, or a YAML file.
        arm: "left" or "right"; optional for a rig with one arm.
        site: "pinch_site", the point where the finger tips meet, or "grasp_site", a point on the axis of the gripper.
            `ee_pose_world` in observations and `ee_pose` in datasets are poses of `grasp_site`. In both frames, z
            points along the fingers, and the fingers close along y.

    Raises:
        ConfigError: the rig does not exist, or is not valid.
        UsageError: the rig has no such arm, or the arm has no such site.
    """

    def __init__(self, rig: str = "single", arm: str | None = None, *, site: KinematicSite = "pinch_site") -> None:
        where = Locations.from_environment(os.environ)
        config = load_config(RigConfig, "rigs", rig, where, {})
        sides = [one.side for one in config.arms]
        if arm is None and len(sides) > 1:
            raise UsageError(f"rig {config.name!r} has two arms: give arm='left' or arm='right'")
        if arm is not None and arm not in sides:
            raise UsageError(f"rig {config.name!r} has no arm {arm!r}; {suggest_similar(str(arm), sides)}")
        if site not in get_args(KinematicSite):
            raise UsageError(f"there is no site {site!r}; {suggest_similar(str(site), get_args(KinematicSite))}")
        number = sides.index(arm) if arm in sides else 0
        self._arm = config.arms[number]
        model = kinematic_model(self._arm)
        if site not in [model.site(k).name for k in range(model.nsite)]:
            raise UsageError(f"{self._arm.name} of rig {config.name!r} has no {site}: its gripper has no fingers")
        self._site = site
        self._range: Array = model.jnt_range.copy()
        self._T_base_in_world = config.T_base_in_world(number)
        self._forward = ArmKinematics(model)
        self._solvers = (IkSolver(model, np.eye(4), _ROTATION_COSTS), IkSolver(model, np.eye(4)))
        self._home = np.array(self._arm.robot.home)
        for solver in self._solvers:
            solver.set_held_object_frame(self._forward.T_site_in_pinch(site))

    @property
    def T_base_in_world(self) -> Array:
        """Pose (4, 4) of the base of the arm: `T_site_in_world = T_base_in_world @ fk(joints)`."""
        return self._T_base_in_world.copy()

    @property
    def joint_range(self) -> Array:
        """Lower and upper limit of each joint (dof, 2), rad."""
        return self._range.copy()

    def fk(self, joints: ArrayLike) -> Array:
        """Return the pose (4, 4) of the site in the base of the arm.

        Raises:
            UsageError: `joints` are not one number for each joint, or exceed the joint limits.
        """
        return self._forward.T_site_in_base(self._require_valid_joints(joints, "joints"), self._site)

    def ik(
        self,
        T_site_in_base: ArrayLike,
        start: ArrayLike | None = None,
        *,
        position_tolerance: float = 1e-3,
        rotation_tolerance: float = np.radians(1.0),
    ) -> Array:
        """Return joints (dof,), rad, within their limits that bring the site to a pose (4, 4) in the base of the arm.

        The same arguments give the same result. Every YAM has analytic inverse kinematics: the result is the solution
        nearest to `start`, exact to 1e-6 m and rad. If no solution exists, numerical searches look for joints within
        the tolerances. An arm without analytic inverse kinematics has only the searches; the first begins at `start`.
        `core.expert.planning.analytic_ik.find_analytic_ik` decides which arms have analytic inverse kinematics.

        Args:
            start: present joints (dof,), rad; by default the home posture.
            position_tolerance, rotation_tolerance: m and rad. A larger rotation tolerance lets the hand tilt where the
                arm is too short for the exact pose.

        Raises:
            UsageError: `T_site_in_base` is no pose, or `start` has no valid joints.
            OutOfReachError: no joints within the tolerances were found. The attribute `nearest` has the nearest joints
                found, and their errors.
        """
        T = _finite_array(T_site_in_base, (4, 4), "T_site_in_base")
        if np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max() > _ORTHONORMAL_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
            raise UsageError(
                f"T_site_in_base is not a pose: its upper left 3 x 3 part is not a rotation: {T[:3, :3].tolist()}"
            )
        # Replace R by the nearest rotation, since other programs often pass rounded poses.
        left, _, right = np.linalg.svd(T[:3, :3])
        T = pose(T[:3, 3], left @ right)
        first = self._home if start is None else self._require_valid_joints(start, "start")
        return solve_ik_or_raise(
            self._solvers, T, self._start_joints(first), position_tolerance, rotation_tolerance
        ).joints

    def _require_valid_joints(self, values: ArrayLike, name: str) -> Array:
        joints = _finite_array(values, self._home.shape, name)
        if fault := describe_limit_violation(self._arm.name, self._arm.robot, joints, _LIMIT_TOLERANCE):
            raise UsageError(f"{name}: {fault}")
        return joints

    def _start_joints(self, first: Array) -> Iterator[Array]:
        """Yield start joints of searches: `first`, clipped to the limits, then random joints of a fixed seed."""
        low, high = self._range.T
        yield np.clip(first, low, high)
        rng = np.random.default_rng(0)
        for _ in range(_RESTARTS_ANALYTIC if self._solvers[0].has_analytic_ik else _RESTARTS):
            yield rng.uniform(low, high)


def _finite_array(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} is not an array of numbers: {error}") from error
    if found.shape != shape:
        raise UsageError(f"{name} has the shape {found.shape}, and needs {shape}")
    if not np.isfinite(found).all():
        raise UsageError(f"{name} is not finite: {found.tolist()}")
    return found
