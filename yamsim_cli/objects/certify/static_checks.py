"""Check size, surfaces, mass, inertia and collision geoms without physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yamsim_cli.core.config.objects.primitives import CollisionPart, HullPart, SdfPart
from yamsim_cli.core.geometry.closed_surface import (
    count_open_edges,
    depth_in_hull,
    spread_points,
    uniform_mass_properties,
)
from yamsim_cli.core.geometry.se3 import Array, pose_from_quat
from yamsim_cli.core.geometry.stl import decode_stl
from yamsim_cli.core.geometry.surface_distance import sample_surface
from yamsim_cli.core.scene.objects.object_geoms import read_asset_file

from ..primitives import signed_distance
from .check_outcome import CheckOutcome, collision_view, inertia_view, object_view, round_significant, skipped_outcome
from .tested_object import TestedObject

NO_MESHES_NOTE = "its meshes are not installed: run `yamsim assets fetch`"

_PLAUSIBLE_SIZES = (0.002, 1.5)  # m, length of an object on a table
_MAX_OPEN_SHARE = 1e-3  # of all edges; scans have some where patches meet
_PLAUSIBLE_DENSITIES = (15.0, 12_000.0)  # kg/m3, from foam and folded cloth to lead
_ROUNDING_TOLERANCE = 5e-4  # m, centre of mass outside the convex hull, for rounding
_INERTIA_TOLERANCE = 0.01  # relative error of the triangle inequality of moments of inertia
# Least ratio of a principal moment to a solid bounding box's. A banana has the lowest of YCB and kitchen objects, 0.37;
# a ball has 0.6, a shell more than 1.
_MIN_BOX_SHARE = 0.1
_VOLUME_SAMPLES, _SURFACE_SAMPLES = 30_000, 2000
_MAX_HULL_SHARE = 1.25  # collision volume over the hull's; hollows may be filled
_MIN_MESH_SHARE = 0.25  # collision volume over the visual mesh's; a few wires may represent a plate
# m, and share of the size: 95 % of the visual surface must be nearer to the collision geoms than the larger limit.
_MAX_DISTANCE, _MAX_DISTANCE_SHARE = 0.006, 0.05
_MAX_DEPTH = 0.006  # m, in the convex hull; deeper points are not compared


def check_size(tested_object: TestedObject) -> CheckOutcome:
    """Check that the length is plausible: 60 m, for example, indicates a file in mm."""
    extent = np.ptp(tested_object.surface_points, axis=0)
    longest = float(extent.max())
    figures = {f"{axis}_m": round_significant(value) for axis, value in zip("xyz", extent, strict=True)}
    fits = _PLAUSIBLE_SIZES[0] <= longest <= _PLAUSIBLE_SIZES[1]
    note = "" if fits else f"{longest:.4g} m long; valid are {_PLAUSIBLE_SIZES[0]:g} to {_PLAUSIBLE_SIZES[1]:g} m"
    return CheckOutcome(fits, figures, note, (object_view(tested_object, "as it stands"),) if fits else ())


def check_closed(tested_object: TestedObject) -> CheckOutcome:
    """Check that visual surfaces have almost no open edges."""
    if not tested_object.visual_surfaces:
        return skipped_outcome(NO_MESHES_NOTE)
    edges = sum(3 * len(faces) // 2 for _, faces in tested_object.visual_surfaces)
    open_ = sum(count_open_edges(faces) for _, faces in tested_object.visual_surfaces)
    allowed = _MAX_OPEN_SHARE * edges
    note = "" if open_ <= allowed else f"{open_} of {edges} edges are open: the surface has holes"
    views = (object_view(tested_object, "from below", steep=-0.9),)
    return CheckOutcome(open_ <= allowed, {"open_edges": open_, "edges": edges}, note, views)


def check_normals(tested_object: TestedObject) -> CheckOutcome:
    """Check that visual faces point outwards."""
    if not tested_object.visual_surfaces:
        return skipped_outcome(NO_MESHES_NOTE)
    volumes = [uniform_mass_properties(*surface).volume for surface in tested_object.visual_surfaces]
    inside_out = sum(volume <= 0 for volume in volumes)
    note = "" if not inside_out else f"{inside_out} of {len(volumes)} surfaces are inside out"
    figures = {"volume_cm3": round_significant(sum(volumes) * 1e6), "inside_out": inside_out}
    return CheckOutcome(not inside_out, figures, note, (object_view(tested_object, "from above", steep=2.0),))


def check_density(tested_object: TestedObject) -> CheckOutcome:
    """Check that mass over volume is a plausible density."""
    mass = tested_object.item.inertia.mass
    if not tested_object.visual_surfaces:
        return CheckOutcome(None, {"mass_kg": round_significant(mass)}, NO_MESHES_NOTE)
    volume = sum(abs(uniform_mass_properties(*surface).volume) for surface in tested_object.visual_surfaces)
    found = mass / volume
    figures = {
        "mass_kg": round_significant(mass),
        "volume_cm3": round_significant(volume * 1e6),
        "density_kg_m3": round_significant(found),
    }
    fits = _PLAUSIBLE_DENSITIES[0] <= found <= _PLAUSIBLE_DENSITIES[1]
    low, high = _PLAUSIBLE_DENSITIES
    note = "" if fits else f"{found:,.{0 if found > 1 else 4}f} kg/m3; valid are {low:,g} to {high:,g}"
    return CheckOutcome(fits, figures, note, (object_view(tested_object, "from the side", steep=0.1),))


def check_centre_of_mass(tested_object: TestedObject) -> CheckOutcome:
    """Check that the centre of mass lies in the convex hull."""
    deep = float(depth_in_hull(np.array([tested_object.item.inertia.centre]), tested_object.surface_points)[0])
    note = "" if deep >= -_ROUNDING_TOLERANCE else f"{-deep * 1000:.4g} mm outside its surface"
    return CheckOutcome(
        deep >= -_ROUNDING_TOLERANCE,
        {"inside_mm": round_significant(deep * 1000)},
        note,
        (inertia_view(tested_object, block=False),),
    )


def check_inertia(tested_object: TestedObject) -> CheckOutcome:
    """Check that mass and size allow the moments of inertia."""
    found = tested_object.item.inertia
    moments = np.array(found.diagonal)
    along = (tested_object.surface_points - np.array(found.centre)) @ pose_from_quat((0, 0, 0), found.quat)[:3, :3]
    squares, edges = along**2, np.ptp(along, axis=0) ** 2
    # No mass is farther from an axis than the farthest point.
    most = found.mass * (squares.sum(axis=1, keepdims=True) - squares).max(axis=0)
    filled = found.mass / 12 * (edges.sum() - edges)
    a, b, c = sorted(found.diagonal)
    figures = {
        "least_kg_m2": round_significant(a),
        "middle_kg_m2": round_significant(b),
        "largest_kg_m2": round_significant(c),
        "triangle": round_significant((a + b) / c),
        "of_possible": round_significant((moments / most).max()),
        "of_filled_box": round_significant((moments / filled).min()),
    }
    views = (inertia_view(tested_object, block=True),)
    if a + b < c * (1 - _INERTIA_TOLERANCE):
        return CheckOutcome(
            False, figures, f"the sum of {a:.3g} and {b:.3g} is less than {c:.3g} kg m2, which no body has"
        )
    if (moments > most).any():
        axis = int((moments / most).argmax())
        note = (
            f"{moments[axis]:.3g} kg m2 is more than {most[axis]:.3g}, the moment if all mass were at its farthest "
            "point"
        )
        return CheckOutcome(False, figures, note, views)
    if (moments < _MIN_BOX_SHARE * filled).any():
        axis = int((moments / filled).argmin())
        note = (
            f"{moments[axis]:.3g} kg m2 is less than {_MIN_BOX_SHARE:.0%} of {filled[axis]:.3g}, the moment "
            "if its mass filled its bounding box evenly"
        )
        return CheckOutcome(False, figures, note, views)
    return CheckOutcome(True, figures, views=views)


def check_collision_geometry(tested_object: TestedObject) -> CheckOutcome:
    """Check that collision geoms match the visual surfaces in volume and position."""
    if not tested_object.visual_surfaces:
        return skipped_outcome(NO_MESHES_NOTE)
    parts = tested_object.item.collision
    if any(isinstance(part, SdfPart) for part in parts):
        return skipped_outcome("it collides by a distance field of its own surface")
    surface = tested_object.merged_visual_surface
    points = np.concatenate([surface[0], tested_object.collision_points])
    low, high = points.min(axis=0), points.max(axis=0)
    filled = spread_points(low, high, _VOLUME_SAMPLES)
    block = float(np.prod(high - low))
    touches = _collision_distances(tested_object, parts, filled) <= 0
    volume = block * float(touches.mean())
    hull = block * float((depth_in_hull(filled, surface[0]) > 0).mean())
    mesh = sum(uniform_mass_properties(*each).volume for each in tested_object.visual_surfaces)
    seen = sample_surface(surface, _SURFACE_SAMPLES, np.random.default_rng(0))[0]
    # Deep points are out of reach, or in a hollow, which `check_hollow` tests. Scans of hollows are poor.
    seen = seen[depth_in_hull(seen, surface[0]) < _MAX_DEPTH]
    out = np.maximum(_collision_distances(tested_object, parts, seen), 0)
    reach = float(np.linalg.norm(np.ptp(surface[0], axis=0)))
    most, allowed = float(np.percentile(out, 95)), max(_MAX_DISTANCE, _MAX_DISTANCE_SHARE * reach)
    figures = {
        "collision_cm3": round_significant(volume * 1e6, 3),
        "mesh_cm3": round_significant(mesh * 1e6, 3),
        "hull_cm3": round_significant(hull * 1e6, 3),
        "of_hull": round_significant(volume / hull, 3),
        "sticks_out_mm": round_significant(most * 1000, 3),
    }
    views = (collision_view(tested_object),)
    if volume > _MAX_HULL_SHARE * hull:
        return CheckOutcome(
            False, figures, f"the collision parts have {volume / hull:.2f} times the volume of its hull", views
        )
    if volume < _MIN_MESH_SHARE * mesh:
        return CheckOutcome(
            False, figures, f"the collision parts have {volume / mesh:.2f} times the visible volume", views
        )
    if most > allowed:
        return CheckOutcome(False, figures, f"it sticks out of its collision parts by {most * 1000:.3g} mm", views)
    return CheckOutcome(True, figures, views=views)


def collision_kinds(parts: Sequence[CollisionPart]) -> str:
    """Return the kinds: "primitives", "hulls", "distance", joined by "and"."""
    names = {"hull": "hulls", "sdf": "distance"}
    return " and ".join(sorted({names.get(part.type, "primitives") for part in parts}))


def _collision_distances(tested_object: TestedObject, parts: Sequence[CollisionPart], points: Array) -> Array:
    """Return signed distances (n,) of points (n, 3), m; underestimated near edges of hulls."""
    nearest = np.full(len(points), np.inf)
    primitives = [part for part in parts if not isinstance(part, HullPart | SdfPart)]
    if primitives:
        nearest = signed_distance(primitives, points)
    folder = tested_object.meshes.get(tested_object.item.mesh.set)
    for part in parts:
        if isinstance(part, HullPart) and folder is not None:
            vertices, _ = decode_stl(read_asset_file(folder, part.file))
            nearest = np.minimum(nearest, -depth_in_hull(points, vertices))
    return nearest
