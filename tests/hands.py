"""A gripper alone, its flange fixed in the world, and an object between its fingers."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.robots.finray.finger import FinRay
from yamsim_cli.core.robots.finray.segment_chain import add_fingers

GRIPPERS = Path(__file__).resolve().parents[1] / "robot_models" / "grippers"

# Time step of contact grasps, see `core.scene.build`.
TIME_STEP = 0.002
_IMPRATIO = 10

# m, below which a point counts as in contact
TOUCH = 1e-4

Fill = Callable[[mujoco.MjsBody], None]


def finger(name: str = "finray", **changes: float) -> FinRay:
    """The fingers of a gripper, optionally with other figures."""
    return FinRay.model_validate(_said(name)["finray"] | changes)


def hand(name: str, soft: FinRay | None = None) -> mujoco.MjSpec:
    """A gripper without its meshes."""
    said = _said(name)
    root = ElementTree.parse(GRIPPERS / name / "gripper.xml").getroot()
    if "finray" in said:
        add_fingers(root, name, soft or finger(name))
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == "mesh" or "mesh" in child.attrib:
                parent.remove(child)
    for joint in root.iter("joint"):
        if joint.get("name") in said["fingers"]["joints"]:
            joint.set("range", " ".join(map(str, said["fingers"]["range"])))
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _IMPRATIO
    spec.option.gravity = (0, 0, 0)
    # On an arm, MuJoCo lets parts that are fixed to the flange pass through moving ones, but not through the world's.
    if spec.body("wrist_camera") is not None:
        for name in said["fingers"]["bodies"]:
            spec.add_exclude(bodyname1="wrist_camera", bodyname2=name)
    return spec


def _said(name: str) -> dict:
    return yaml.safe_load((GRIPPERS / name / "gripper.yaml").read_text())


@dataclass(frozen=True)
class GripResult:
    """Result of a grasp.

    Attributes:
        data: state at the end.
        forces: of the left finger after each step (n,), N.
        most: largest force of a single contact at the end, N.
        area: of the left finger's pads nearer than `TOUCH` to the object at the end, m2.
    """

    data: mujoco.MjData
    forces: Array
    most: float
    area: float


def grip(
    name: str, fill: Fill, command: float, *, start: float, height: float | None = None, seconds: float = 1.0
) -> GripResult:
    """Close a gripper on an object that is free to move along the closing axis.

    Args:
        fill: adds the object's geoms to its body, whose origin lies between the fingers; x is the closing axis, z to
            the tips.
        command: to the drive, m of a finger's opening.
        start: opening at the beginning, m.
        height: of the object over the flange, m; that of `pinch_site` if not given.
    """
    spec = hand(name)
    x, y, z = spec.site("pinch_site").pos
    body = spec.worldbody.add_body(name="thing", pos=(x, y, z if height is None else height))
    body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1, 0, 0))
    fill(body)
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint in _said(name)["fingers"]["joints"]:
        data.qpos[model.joint(joint).qposadr[0]] = start
    data.ctrl[0] = command
    forces = []
    for _ in range(round(seconds / TIME_STEP)):
        mujoco.mj_step(model, data)
        forces.append(sum(_presses(model, data)))
    return GripResult(data, np.array(forces), max(_presses(model, data), default=0.0), _touching(model, data))


def _presses(model: mujoco.MjModel, data: mujoco.MjData) -> list[float]:
    """Normal force of each contact between the left finger and the object, N."""
    force, found = np.zeros(6), []
    for k, pair in enumerate(data.contact.geom):
        names = [model.body(model.geom_bodyid[geom]).name for geom in pair]
        if "thing" in names and any("left" in name for name in names):
            mujoco.mj_contactForce(model, data, k, force)
            found.append(float(force[0]))
    return found


def _touching(model: mujoco.MjModel, data: mujoco.MjData, grain: float = 2.5e-4) -> float:
    """Contact area of the left finger's pads, by probing their faces on a grid, m2."""
    things = [geom for geom in range(model.ngeom) if model.body(model.geom_bodyid[geom]).name == "thing"]
    area = 0.0
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        if "left" not in name or "pad" not in name:
            continue
        half, R, at = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        # Pads are thin along the axis that points to the object.
        facing = int(np.argmin(half))
        toward = np.sign((data.body("thing").xpos - at) @ R[:, facing])
        u, v = (k for k in range(3) if k != facing)
        rows, columns = (_middles(half[k], grain) for k in (u, v))
        face = np.full((len(rows), len(columns), 3), toward * half[facing])
        face[..., u], face[..., v] = rows[:, None], columns[None]
        points = at + face.reshape(-1, 3) @ R.T
        near = np.min([_distances(model, data, thing, points) for thing in things], axis=0) < TOUCH
        area += float(near.mean()) * 4 * half[u] * half[v]
    return area


def _middles(half: float, grain: float) -> Array:
    """Middles of equal parts of a length from -half to half, at most about `grain` long."""
    count = max(1, round(2 * half / grain))
    return ((np.arange(count) + 0.5) / count * 2 - 1) * half


def _distances(model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: Array) -> Array:
    """Distances of points (n, 3) from a cylinder's side or a ball (n,), m."""
    size, R = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3)
    local = (points - data.geom_xpos[geom]) @ R
    match model.geom_type[geom]:
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return np.linalg.norm(local, axis=1) - size[0]
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            across = np.linalg.norm(local[:, :2], axis=1) - size[0]
            return np.where(np.abs(local[:, 2]) <= size[1], across, np.inf)
    raise NotImplementedError
