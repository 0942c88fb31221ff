"""Read an MJCF file with one object by MuJoCo's compiler.

MuJoCo would open any path that a file names, so yamsim passes it the content of each under a new name.
"""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path, PurePosixPath
from typing import Any

import mujoco
import numpy as np

from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.mjcf_includes import expand_includes
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array, pose_from_quat

from .kinematic_tree import (
    JointDescription,
    LinkDescription,
    build_parts,
    handle_from_frame,
    joint_range,
    make_mass_properties,
)
from .mesh_headers import check_header
from .meshes import MAX_FACES
from .object_parts import ObjectDescription, Surface, SurfaceMaterial
from .primitive_shapes import collision_shape, primitive_surface
from .textures import encode_png_texture, open_image
from .untrusted_xml import Element, parse_untrusted_xml

# They run foreign code, or multiply a file's content.
_REFUSED_TAGS = ("plugin", "extension", "replicate", "composite", "flexcomp", "skin", "hfield", "attach")
_FOLDERS = {"mesh": ("meshdir", "assetdir"), "texture": ("texturedir", "assetdir")}
_MAX_BUILTIN_TEXTURE_PX = 4096  # px, side of a texture that MuJoCo generates
_VISIBLE_GEOM_GROUPS = 3  # geom groups that a viewer shows by default: 0, 1 and 2
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default, for which a geom takes its material's colour

_SHAPE_KINDS = {
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
}
# Shape -> values in MuJoCo's `geom_size`.
_SIZE_VALUE_COUNTS = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3}


def read_mjcf(data: bytes, folder: ConfinedFolder, base: Path) -> ObjectDescription:
    """Read an MJCF file. Raises `RefusedError` if it is damaged or not supported."""
    root = expand_includes(data, folder, base, parse_untrusted_xml)
    if root.tag != "mujoco":
        raise RefusedError("damaged", f"its root is <{root.tag}>, not <mujoco>, <sdf> or <robot>")
    name = root.get("model", "")
    assets = _collect_files(root, folder, base)
    for tag in ("keyframe", "sensor", "actuator", "contact"):
        for section in root.findall(tag):
            root.remove(section)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"), assets=assets)
        model = spec.compile()
    except MemoryError:
        raise RefusedError("too-much-memory", "reading it takes too much memory for a file of its size") from None
    except (ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise RefusedError("damaged", f"MuJoCo cannot read it: {reason}") from error
    return _describe_model(model, name)


def _collect_files(root: Element, folder: ConfinedFolder, base: Path) -> dict[str, bytes]:
    """Rename all named files in a document, and return new name -> content."""
    compiler: dict[str, str] = {}
    for element in root.iter("compiler"):
        compiler |= element.attrib
        for key in ("meshdir", "texturedir", "assetdir", "strippath"):
            element.attrib.pop(key, None)
    assets: dict[str, bytes] = {}
    for element in root.iter():
        if element.tag in _REFUSED_TAGS:
            raise RefusedError("damaged", f"<{element.tag}> is not supported")
        for key in [key for key in element.attrib if key.startswith("file")]:
            named = element.attrib[key]
            where = next((compiler[k] for k in _FOLDERS.get(element.tag, ()) if k in compiler), "")
            if compiler.get("strippath") == "true":
                named = PurePosixPath(named.replace("\\", "/")).name
            data = folder.read(f"{where}/{named}" if where else named, base)
            suffix = PurePosixPath(named).suffix.lower()
            if element.tag == "mesh":
                if suffix not in (".stl", ".obj", ".msh"):
                    raise RefusedError(
                        "unknown-kind", f"mesh {named}: MuJoCo cannot read {suffix!r}; valid: .stl, .obj, .msh"
                    )
                check_header(data, suffix, MAX_FACES)
                element.attrib.setdefault("name", PurePosixPath(named).stem)
            elif element.tag == "texture":
                data, suffix = encode_png_texture(open_image(data, named), named), ".png"
                element.attrib.pop("content_type", None)
            element.attrib[key] = f"{len(assets)}{suffix}"
            assets[element.attrib[key]] = data
        if element.tag == "texture":
            for key in ("width", "height"):
                text = element.get(key, "0")
                if not text.strip().isdecimal() or int(text) > _MAX_BUILTIN_TEXTURE_PX:
                    raise RefusedError(
                        "texture-too-large",
                        f"a texture is {text} pixels wide or high; at most {_MAX_BUILTIN_TEXTURE_PX}",
                    )
    return assets


def _describe_model(model: mujoco.MjModel, name: str) -> ObjectDescription:
    notes: list[str] = []
    world = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == 0]
    if model.nbody == 1 and world:
        links, joints = [_describe_link(model, 0, "base", notes)], []
    else:
        if world:
            notes.append("left out: geometry of the world body")
        links = [_describe_link(model, body, _body_name(model, body), notes) for body in range(1, model.nbody)]
        joints = [joint for body in range(1, model.nbody) if (joint := _describe_joint(model, body, notes)) is not None]
    if model.neq:
        notes.append("left out: equality constraints")
    parts, _ = build_parts(links, joints)
    touching_geoms = [geom for geom in range(model.ngeom) if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    friction = float(np.median(model.geom_friction[touching_geoms, 0])) if touching_geoms else None
    return ObjectDescription(name, parts, False, friction=friction, notes=tuple(dict.fromkeys(notes)))


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body_{body}"


def _describe_link(model: mujoco.MjModel, body: int, name: str, notes: list[str]) -> LinkDescription:
    link = LinkDescription(name, _T_in_model(model, body))
    if model.body_mass[body] > 0:
        turn = pose_from_quat((0, 0, 0), model.body_iquat[body])[:3, :3]
        tensor = turn @ np.diag(model.body_inertia[body]) @ turn.T
        link.weight = make_mass_properties(float(model.body_mass[body]), model.body_ipos[body].copy(), tensor)
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body]
    touches = [bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) for geom in geoms]
    only_seen = [
        geom
        for geom, touch in zip(geoms, touches, strict=True)
        if not touch and model.geom_group[geom] < _VISIBLE_GEOM_GROUPS
    ]
    for geom, touch in zip(geoms, touches, strict=True):
        T = pose_from_quat(model.geom_pos[geom], model.geom_quat[geom])
        kind = _SHAPE_KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
        if kind is None and model.geom_dataid[geom] < 0:
            notes.append("left out: planes and other unbounded geometry")
            continue
        size = model.geom_size[geom, : _SIZE_VALUE_COUNTS[kind]].copy() if kind else np.zeros(0)
        if geom in only_seen or not only_seen:
            surface = primitive_surface(kind, size, _geom_material(model, geom)) if kind else _mesh_surface(model, geom)
            link.visual_surfaces.append(surface.transform(T))
        if touch:
            link.shapes.append(
                collision_shape(kind, size, T) if kind else _mesh_surface(model, geom, convex=True).transform(T)
            )
    for site in range(model.nsite):
        label = model.site(site).name
        if model.site_bodyid[site] == body and label.lower().startswith("handle"):
            T = pose_from_quat(model.site_pos[site], model.site_quat[site])
            link.handles.append(handle_from_frame(label, T))
    return link


def _T_in_model(model: mujoco.MjModel, body: int) -> Array:
    T = np.eye(4)
    while body:
        T = pose_from_quat(model.body_pos[body], model.body_quat[body]) @ T
        body = int(model.body_parentid[body])
    return T


def _describe_joint(model: mujoco.MjModel, body: int, notes: list[str]) -> JointDescription | None:
    name, parent = _body_name(model, body), int(model.body_parentid[body])
    count, first = int(model.body_jntnum[body]), int(model.body_jntadr[body])
    if parent == 0:
        free = count == 1 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE
        if count and not free:
            raise RefusedError("joint-kind", f"body {name!r} moves relative to the world: give it a base body")
        return None
    above = _body_name(model, parent)
    if count == 0:
        return JointDescription(name, above, name, None)
    kinds = {mujoco.mjtJoint.mjJNT_HINGE: "hinge", mujoco.mjtJoint.mjJNT_SLIDE: "slide"}
    kind = kinds.get(mujoco.mjtJoint(model.jnt_type[first]))
    if count > 1 or kind is None:
        raise RefusedError("joint-kind", f"body {name!r} has a joint other than one hinge or slide")
    if model.jnt_stiffness[first]:
        notes.append("left out: springs of joints")
    low, high = model.jnt_range[first] - model.qpos0[model.jnt_qposadr[first]]
    if not model.jnt_limited[first]:
        low, high = -math.inf, math.inf
    dof = int(model.jnt_dofadr[first])
    moves: dict[str, Any] = {
        "type": kind,
        "axis": model.jnt_axis[first].tolist(),
        "position": model.jnt_pos[first].tolist(),
        "range": joint_range(float(low), float(high), turns=kind == "hinge", name=name),
        "damping": float(model.dof_damping[dof]),
        "friction": float(model.dof_frictionloss[dof]),
        "armature": float(model.dof_armature[dof]),
    }
    return JointDescription(name, above, name, moves)


def _mesh_surface(model: mujoco.MjModel, geom: int, *, convex: bool = False) -> Surface:
    mesh = int(model.geom_dataid[geom])
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count].astype(np.float64)
    first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    triangles = model.mesh_face[first : first + faces].copy()
    uv = None
    material = SurfaceMaterial() if convex else _geom_material(model, geom)
    if material.texture is not None and model.mesh_texcoordadr[mesh] >= 0:
        at = int(model.mesh_texcoordadr[mesh])
        coordinates = model.mesh_texcoord[at : at + int(model.mesh_texcoordnum[mesh])]
        uv = coordinates[model.mesh_facetexcoord[first : first + faces]].astype(np.float64)
        # MuJoCo measures v from the upper edge.
        uv[..., 1] = 1 - uv[..., 1]
    elif material.texture is not None:
        material = SurfaceMaterial(material.rgba)
    return Surface(vertices, triangles.astype(np.int32), material, uv, convex)


def _geom_material(model: mujoco.MjModel, geom: int) -> SurfaceMaterial:
    number, rgba = int(model.geom_matid[geom]), model.geom_rgba[geom]
    texture = None
    specular, shininess = 0.2, 0.3
    if number >= 0:
        if np.allclose(rgba, _DEFAULT_RGBA):
            rgba = model.mat_rgba[number]
        specular, shininess = float(model.mat_specular[number]), float(model.mat_shininess[number])
        place = int(model.mat_texid[number, mujoco.mjtTextureRole.mjTEXROLE_RGB])
        if place >= 0 and model.tex_type[place] == mujoco.mjtTexture.mjTEXTURE_2D:
            texture = _texture_png(model, place)
    red, green, blue, alpha = (float(min(1.0, max(0.0, value))) for value in rgba)
    return SurfaceMaterial((red, green, blue, alpha), texture, min(1.0, specular), min(1.0, shininess))


def _texture_png(model: mujoco.MjModel, texture: int) -> bytes:
    from PIL import Image

    shape = int(model.tex_height[texture]), int(model.tex_width[texture]), int(model.tex_nchannel[texture])
    start = int(model.tex_adr[texture])
    pixels = model.tex_data[start : start + math.prod(shape)].reshape(shape)
    out = io.BytesIO()
    Image.fromarray(pixels[..., :3] if shape[2] >= 3 else pixels[..., 0]).convert("RGB").save(out, format="PNG")
    return out.getvalue()
