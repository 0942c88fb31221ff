"""Cloth in a scene: a MuJoCo flex of freely moving points, and constraints by which hands hold these points."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.objects.cloth import Cloth
from ..config.objects.object_config import ObjectConfig
from ..config.rig import RigConfig
from ..geometry.se3 import Array

_CHECKER_SQUARE_PX = 16  # px, of one square of the checker texture
_TIME_CONSTANT = 0.01  # s, of cloth contacts and grasp constraints; at least two time steps
# `solimp` of grasp constraints for cloth with `held: layers`. With 0.9 and 0.95, points of 0.1 g lag 4 cm.
_GRASP_SOLIMP = (0.999, 0.9999)
# Bits of contact masks in scenes with `release: clear`: `COMMON_BIT` of all geoms; `LEAVING_BIT` instead, of fingers
# that leave cloth; `_SHEET_BIT` of cloth, which has contacts with itself and with `COMMON_BIT`.
COMMON_BIT, LEAVING_BIT, _SHEET_BIT = 1, 2, 4
_CONDIM = 3  # normal and tangential forces
# CG solver. With MuJoCo's 1e-8, a fold of 21 x 21 points takes a third longer, for less than 0.02 mm.
_TOLERANCE = 1e-6
_INERTIA_PER_MASS = 1e-6  # m2, of a point, about the inertia of a 1 mm ball; no torque acts on points


def flat_points(cloth: Cloth) -> Array:
    """Return the points (n, 3) of a flat cloth in the cloth's frame, m, row after row; a row runs along x."""
    (x, y), (columns, rows) = cloth.size, cloth.grid
    across, along = np.meshgrid(np.linspace(-x / 2, x / 2, columns), np.linspace(-y / 2, y / 2, rows))
    points: Array = np.column_stack([across.ravel(), along.ravel(), np.zeros(columns * rows)])
    return points


@functools.cache
def grid_triangles(columns: int, rows: int) -> NDArray[np.int_]:
    """Return the point indices (m, 3) of each triangle of a grid of points, numbered row by row.

    The diagonals of neighbouring cells alternate, so that the sheet is equally stiff along both.
    """
    found = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            a = row * columns + column
            b, c, d = a + 1, a + columns, a + columns + 1
            found += [(a, b, d), (a, d, c)] if (row + column) % 2 == 0 else [(a, b, c), (b, d, c)]
    corners = np.array(found)
    corners.setflags(write=False)
    return corners


def grid_edges(columns: int, rows: int) -> NDArray[np.int_]:
    """Return the point indices (m, 2) of each edge of the triangles of `grid_triangles`."""
    corners = grid_triangles(columns, rows)
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    found: NDArray[np.int_] = np.unique(np.sort(pairs, axis=1), axis=0)
    return found


def add_cloth(spec: mujoco.MjSpec, item: ObjectConfig) -> None:
    """Add a cloth: a fixed body of the cloth's name at the origin, with a child body on three slides for each point.

    At joint positions of 0, the points are at `flat_points` in `world`.
    """
    cloth = item.cloth
    assert cloth is not None  # only called for cloth
    base = spec.worldbody.add_body(name=item.name)
    points, (columns, rows) = flat_points(cloth), cloth.grid
    for k, (place, mass) in enumerate(zip(points, _point_masses(cloth), strict=True)):
        body = base.add_body(name=f"{item.name}_{k}", pos=place)
        body.mass, body.inertia, body.explicitinertial = mass, [mass * _INERTIA_PER_MASS] * 3, True
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            body.add_joint(name=f"{item.name}_{k}_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
    sheet = spec.add_flex()
    sheet.name, sheet.dim, sheet.radius = item.name, 2, cloth.half_thickness
    sheet.vertbody = [f"{item.name}_{k}" for k in range(len(points))]
    sheet.elem = grid_triangles(columns, rows).ravel().tolist()
    sheet.young, sheet.poisson, sheet.thickness = cloth.elastic_constants
    sheet.damping = cloth.damping_s
    sheet.elastic2d = 3
    sheet.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_AUTO
    sheet.friction, sheet.condim, sheet.solref = [cloth.friction, 0.005, 0.0001], _CONDIM, [_TIME_CONSTANT, 1]
    if cloth.release == "clear":
        sheet.contype, sheet.conaffinity = _SHEET_BIT, COMMON_BIT | _SHEET_BIT
    sheet.material = _add_material(spec, item, cloth)
    if cloth.checks:
        sheet.texcoord = (points[:, :2] / cloth.size[0] + 0.5).ravel().tolist()


def _point_masses(cloth: Cloth) -> Array:
    """Return each point's mass (n,), kg: a quarter of the mass of each cell around it."""
    columns, rows = (np.where(np.isin(np.arange(n), (0, n - 1)), 0.5, 1.0) / (n - 1) for n in cloth.grid)
    shares: Array = np.outer(rows, columns).ravel() * cloth.mass
    return shares


def _add_material(spec: mujoco.MjSpec, item: ObjectConfig, cloth: Cloth) -> str:
    first, second = cloth.colours
    material = spec.add_material(name=item.name, rgba=[1, 1, 1, 1], specular=0.0, shininess=0.0)
    if not cloth.checks:
        material.rgba = [*first, 1]
        return item.name
    spec.add_texture(
        name=item.name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=first,
        rgb2=second,
        width=2 * _CHECKER_SQUARE_PX,
        height=2 * _CHECKER_SQUARE_PX,
    )
    # The texture has two checks along each side.
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = item.name
    material.texrepeat = [cloth.checks / 2, cloth.checks / 2]
    return item.name


def set_cloth_options(spec: mujoco.MjSpec, cloth: Cloth) -> None:
    """Set the integrator and the solver that a scene with this cloth needs."""
    # No other integrator supports the elasticity of flexes.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    if cloth.solver == "cg":
        spec.option.solver, spec.option.tolerance = mujoco.mjtSolver.mjSOL_CG, _TOLERANCE


def add_cloth_grasp_constraints(spec: mujoco.MjSpec, item: ObjectConfig, rig: RigConfig) -> None:
    """Add constraints by which each hand of a rig can hold each point of a cloth. They are inactive at first."""
    assert item.cloth is not None  # only called for cloth
    columns, rows = item.cloth.grid
    for arm in rig.arms:
        for k in range(columns * rows):
            added = spec.add_equality(
                name=cloth_grasp_constraint_name(arm.prefix, item.name, k),
                type=mujoco.mjtEq.mjEQ_CONNECT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1=f"{item.name}_{k}",
                name2=arm.prefix + arm.robot.flange,
                active=False,
            )
            added.solref = [_TIME_CONSTANT, 1]
            if item.cloth.held == "layers":
                added.solimp[:2] = _GRASP_SOLIMP


def cloth_grasp_constraint_name(prefix: str, cloth: str, point: int) -> str:
    """Return the name of the constraint by which the arm with `prefix` can hold a point of a cloth."""
    return f"{prefix}{cloth}_{point}_grip"
