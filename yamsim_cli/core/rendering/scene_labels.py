"""Labels and keypoints of a scene's ground truth: a label per visible body; keypoints on arms, boards and cloths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.rig import ArmConfig, RigConfig
from ..dataset.ground_truth_files import BACKGROUND, KeypointRecord, LabelRecord, TruthLabels
from ..geometry.se3 import Array
from ..scene.compiled import ClothAddresses
from ..scene.fiducials import BOARD_BODY, MOUNT_BODY

TABLE, POSTS = "table", "posts"  # label names; the posts are the legs of the table and below the arms

_RAY_START = 0.3  # m, distance from a joint at which rays towards the joint start; larger than any link
_HIDDEN_GROUP = 3  # first geom group that images do not show; collision geoms are in this group
_MAX_LABELS = 254  # labels are rendered as one byte of a colour, where 0 means that no geom is visible


@dataclass(frozen=True)
class LabelledKeypoint:
    """A keypoint that is fixed to a body.

    Attributes:
        record: entry of the keypoint in the dataset.
        body: id of the body.
        position: position (3,) in the body's frame, m.
        normal: outward normal (3,) of the surface at the point, in the body's frame; None for a point inside the body.
        labels: labels of the bodies, one of which the point's pixel shows if the point is visible.
    """

    record: KeypointRecord
    body: int
    position: Array
    normal: Array | None
    labels: tuple[int, ...]


@dataclass(frozen=True)
class LabelledCloth:
    """A cloth of a scene with its label.

    Attributes:
        label: label of the cloth in segmentation images.
        row: index of the cloth in `T_object_in_cam`, the recorded object poses.
        scene: addresses of the cloth's points.
    """

    name: str
    label: int
    row: int
    scene: ClothAddresses

    @property
    def corner_point_indices(self) -> dict[str, int]:
        """Corner -> index of its point. Corners are named with the x axis of the flat cloth to the right."""
        columns, rows = self.scene.grid
        last = columns * rows - 1
        return {"top_left": last + 1 - columns, "top_right": last, "bottom_right": columns - 1, "bottom_left": 0}

    @property
    def corner_keypoints(self) -> Iterator[KeypointRecord]:
        """The dataset entries of the cloth's corners, in the order of `corner_point_indices`."""
        for side in self.corner_point_indices:
            yield KeypointRecord(name=f"{self.name}_{side}", body=self.name, kind="cloth")


@dataclass(frozen=True)
class SceneLabels:
    """The labels and keypoints of a compiled scene.

    Attributes:
        names: names of all labels, instances, links, objects and keypoints.
        label_of_geom, label_of_flex: label of each geom (ngeom,) and flex (nflex,) in segmentation images.
        instance_of_label: label -> index of its instance (a whole arm or object); -1 for the background.
        links, objects: ids of the bodies whose poses are recorded.
        keypoints: keypoints that are fixed to a body. In `names`, the corners of cloths follow them.
        cloths: all cloths. Their poses follow from their points, because the body of a cloth never moves.
    """

    names: TruthLabels
    label_of_geom: NDArray[np.uint8]
    label_of_flex: NDArray[np.uint8]
    instance_of_label: NDArray[np.int64]
    links: NDArray[np.int64]
    objects: NDArray[np.int64]
    keypoints: tuple[LabelledKeypoint, ...]
    cloths: tuple[LabelledCloth, ...]


def make_scene_labels(
    model: mujoco.MjModel,
    rig: RigConfig,
    objects: Sequence[str],
    *,
    boards: bool,
    cloths: Mapping[str, ClothAddresses] | None = None,
) -> SceneLabels:
    """Return the labels of a scene: one each per link, object, board, mount and table, and one for all posts.

    Args:
        objects: names of the bodies on the table.
        boards: whether the scene has the rig's boards and mounts.
        cloths: name -> addresses of the points, for each object that is a cloth.
    """
    links = {
        body: arm.name
        for arm in rig.arms
        for body in _subtree_bodies(model, model.body(arm.prefix + arm.robot.base).id)
    }
    others = {model.body(name).id: name for name in objects}
    printed = {model.body(name).id: name for arm in rig.arms for name in _board_bodies(arm)} if boards else {}
    bodies = links | others | printed
    names = [LabelRecord(id=BACKGROUND, name="background", instance="background")]
    names += [LabelRecord(id=k, name=name, instance=name) for k, name in enumerate((TABLE, POSTS), start=1)]
    number = {body: len(names) + k for k, body in enumerate(bodies)}
    names += [LabelRecord(id=number[b], name=model.body(b).name, instance=i) for b, i in bodies.items()]
    assert len(names) <= _MAX_LABELS, len(names)

    label_of_geom = np.zeros(model.ngeom, np.uint8)
    for geom in range(model.ngeom):
        name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
        if body not in number:
            # A moving part has the label of its object.
            body = int(model.body_rootid[body])
        label_of_geom[geom] = number.get(body, {"table": 1}.get(name, 2 if name.startswith("post_") else BACKGROUND))
    sheets = [
        LabelledCloth(name, number[body], list(others).index(body), cloths[name])
        for body, name in others.items()
        if cloths and name in cloths
    ]
    label_of_flex = np.zeros(model.nflex, np.uint8)
    for sheet in sheets:
        label_of_flex[sheet.scene.flex] = sheet.label
    instances = list(dict.fromkeys(label.instance for label in names[1:]))
    keypoints = (*_joint_keypoints(model, rig, number), *(_board_keypoints(model, rig, number) if boards else ()))
    return SceneLabels(
        names=TruthLabels(
            labels=names,
            instances=instances,
            links=[model.body(body).name for body in links],
            objects=[model.body(body).name for body in others | printed],
            keypoints=[
                *(point.record for point in keypoints),
                *(point for one in sheets for point in one.corner_keypoints),
            ],
            cloths={sheet.name: sheet.scene.grid for sheet in sheets},
        ),
        label_of_geom=label_of_geom,
        label_of_flex=label_of_flex,
        instance_of_label=np.array([-1, *(instances.index(label.instance) for label in names[1:])]),
        links=np.array(list(links)),
        objects=np.array(list(others | printed), dtype=np.int64),
        keypoints=keypoints,
        cloths=tuple(sheets),
    )


def _subtree_bodies(model: mujoco.MjModel, root: int) -> list[int]:
    found = [root]
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in found:
            found.append(body)
    return found


def _board_bodies(arm: ArmConfig) -> Iterator[str]:
    if arm.board is not None:
        yield f"{arm.prefix}{BOARD_BODY}"
    if arm.mount is not None:
        yield f"{arm.prefix}{MOUNT_BODY}"


def _joint_keypoints(model: mujoco.MjModel, rig: RigConfig, number: dict[int, int]) -> Iterator[LabelledKeypoint]:
    """Yield each joint's centre, and the two points where the joint axis leaves the links that the joint connects."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in (arm.prefix + joint for arm in rig.arms for joint in arm.robot.joint_names):
        joint = model.joint(name)
        link = int(model.jnt_bodyid[joint.id])
        pair = (link, int(model.body_parentid[link]))
        centre = KeypointRecord(name=name, body=model.body(link).name, kind="joint")
        yield LabelledKeypoint(centre, link, joint.pos.copy(), None, tuple(number[body] for body in pair))
        anchor, axis = data.xanchor[joint.id], data.xaxis[joint.id]
        for side, away in (("plus", axis), ("minus", -axis)):
            hit = _first_ray_hit(model, data, pair, anchor + _RAY_START * away, -away)
            if hit is None:
                continue
            body, point, normal = hit
            R = data.xmat[body].reshape(3, 3)
            record = KeypointRecord(name=f"{name}_{side}", body=model.body(body).name, kind="axis")
            yield LabelledKeypoint(record, body, R.T @ (point - data.xpos[body]), R.T @ normal, (number[body],))


def _first_ray_hit(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int], start: Array, direction: Array
) -> tuple[int, Array, Array] | None:
    """Return the body, point and normal in `world` of a ray's first hit on visible geoms of bodies; None for a miss."""
    best, nearest = None, _RAY_START
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body not in bodies or model.geom_group[geom] >= _HIDDEN_GROUP:
            continue
        normal = np.zeros(3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            distance = mujoco.mj_rayMesh(model, data, geom, start, direction, normal)
        else:
            place = data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom]
            distance = mujoco.mju_rayGeom(*place, start, direction, int(model.geom_type[geom]), normal)
        if 0 <= distance < nearest:
            nearest, best = distance, (body, start + distance * direction, normal)
    return best


def _board_keypoints(model: mujoco.MjModel, rig: RigConfig, number: dict[int, int]) -> Iterator[LabelledKeypoint]:
    for arm in rig.arms:
        if arm.board is None:
            continue
        name = f"{arm.prefix}{BOARD_BODY}"
        body, T, board = model.body(name).id, arm.T_board_in_base, arm.board.board_in_metres
        for side, x, y in (("top_left", -1, 1), ("top_right", 1, 1), ("bottom_right", 1, -1), ("bottom_left", -1, -1)):
            record = KeypointRecord(name=f"{name}_{side}", body=name, kind="corner")
            position = (T @ (x * board.width / 2, y * board.height / 2, 0.0, 1.0))[:3]
            yield LabelledKeypoint(record, body, position, T[:3, 2].copy(), (number[body],))
