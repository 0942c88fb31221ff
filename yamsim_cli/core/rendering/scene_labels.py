"""What a scene's ground truth names: a label for every visible body, and keypoints on arms, boards and cloths."""

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

TABLE, POSTS = "table", "posts"

_OUTSIDE = 0.3  # m from a joint, start of the ray back along its axis to the arm's surface; no link is as wide
_SEEN_GROUPS = 3  # geoms of lower groups are visible, see `scene.things.looks`
_MOST_LABELS = 254  # labels are rendered as one byte of a colour, in which 0 stands for nothing


@dataclass(frozen=True)
class LabelledKeypoint:
    """A point of a body.

    Attributes:
        position: in the body's frame (3,), m.
        normal: the surface's outward normal there, in the body's frame (3,); None for a point inside.
        labels: the labels that the point's pixel may show if nothing hides the point.
    """

    record: KeypointRecord
    body: int
    position: Array
    normal: Array | None
    labels: tuple[int, ...]


@dataclass(frozen=True)
class LabelledCloth:
    """A cloth of a scene, and how segmentation images show it.

    Attributes:
        label: the cloth's number in segmentation images.
        row: the cloth's index among the objects that have poses.
        scene: where the cloth's points are.
    """

    name: str
    label: int
    row: int
    scene: ClothAddresses

    @property
    def corners(self) -> dict[str, int]:
        """Corner -> number of the point there. Corners are named with the x axis of the flat cloth to the right."""
        columns, rows = self.scene.grid
        last = columns * rows - 1
        return {"top_left": last + 1 - columns, "top_right": last, "bottom_right": columns - 1, "bottom_left": 0}

    @property
    def keypoints(self) -> Iterator[KeypointRecord]:
        """The records of the corners."""
        for side in self.corners:
            yield KeypointRecord(name=f"{self.name}_{side}", body=self.name, kind="cloth")


@dataclass(frozen=True)
class SceneLabels:
    """The labels and keypoints of a compiled scene.

    Attributes:
        of_geom, of_flex: label in segmentation images of each geom (ngeom,) and flex (nflex,).
        instance_of: label -> index of its instance, -1 for the background.
        links, objects: ids of the bodies whose poses are recorded.
        keypoints: the keypoints that are fixed to a body. In `names`, the corners of cloths follow.
        cloths: the cloths. Their bodies never move, see `scene.cloth.add_cloth`.
    """

    names: TruthLabels
    of_geom: NDArray[np.uint8]
    of_flex: NDArray[np.uint8]
    instance_of: NDArray[np.int64]
    links: NDArray[np.int64]
    objects: NDArray[np.int64]
    keypoints: tuple[LabelledKeypoint, ...]
    cloths: tuple[LabelledCloth, ...]


def scene_labels(
    model: mujoco.MjModel,
    rig: RigConfig,
    objects: Sequence[str],
    *,
    boards: bool,
    cloths: Mapping[str, ClothAddresses] | None = None,
) -> SceneLabels:
    """The labels of a scene: one for each link, object, board and mount, for the table, and for all posts together.

    Args:
        objects: names of the bodies that stand on the table.
        boards: whether the scene has its rig's boards and mounts.
        cloths: which of the objects are cloths, and where their points are.
    """
    links = {body: arm.name for arm in rig.arms for body in _subtree(model, model.body(arm.prefix + arm.robot.base).id)}
    others = {model.body(name).id: name for name in objects}
    printed = {model.body(name).id: name for arm in rig.arms for name in _board_bodies(arm)} if boards else {}
    bodies = links | others | printed
    names = [LabelRecord(id=BACKGROUND, name="background", instance="background")]
    names += [LabelRecord(id=k, name=name, instance=name) for k, name in enumerate((TABLE, POSTS), start=1)]
    number = {body: len(names) + k for k, body in enumerate(bodies)}
    names += [LabelRecord(id=number[b], name=model.body(b).name, instance=i) for b, i in bodies.items()]
    assert len(names) <= _MOST_LABELS, len(names)

    of_geom = np.zeros(model.ngeom, np.uint8)
    for geom in range(model.ngeom):
        name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
        if body not in number:
            # A moving part belongs to its thing.
            body = int(model.body_rootid[body])
        of_geom[geom] = number.get(body, {"table": 1}.get(name, 2 if name.startswith("post_") else BACKGROUND))
    sheets = [
        LabelledCloth(name, number[body], list(others).index(body), cloths[name])
        for body, name in others.items()
        if cloths and name in cloths
    ]
    of_flex = np.zeros(model.nflex, np.uint8)
    for sheet in sheets:
        of_flex[sheet.scene.flex] = sheet.label
    instances = list(dict.fromkeys(label.instance for label in names[1:]))
    keypoints = (*_joints(model, rig, number), *(_corners(model, rig, number) if boards else ()))
    return SceneLabels(
        names=TruthLabels(
            labels=names,
            instances=instances,
            links=[model.body(body).name for body in links],
            objects=[model.body(body).name for body in others | printed],
            keypoints=[*(point.record for point in keypoints), *(point for one in sheets for point in one.keypoints)],
            cloths={sheet.name: sheet.scene.grid for sheet in sheets},
        ),
        of_geom=of_geom,
        of_flex=of_flex,
        instance_of=np.array([-1, *(instances.index(label.instance) for label in names[1:])]),
        links=np.array(list(links)),
        objects=np.array(list(others | printed), dtype=np.int64),
        keypoints=keypoints,
        cloths=tuple(sheets),
    )


def _subtree(model: mujoco.MjModel, root: int) -> list[int]:
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


def _joints(model: mujoco.MjModel, rig: RigConfig, number: dict[int, int]) -> Iterator[LabelledKeypoint]:
    """Each joint's centre, and the points on either side where its axis leaves the two links that it joins."""
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
            hit = _first_hit(model, data, pair, anchor + _OUTSIDE * away, -away)
            if hit is None:
                continue
            body, point, normal = hit
            R = data.xmat[body].reshape(3, 3)
            record = KeypointRecord(name=f"{name}_{side}", body=model.body(body).name, kind="axis")
            yield LabelledKeypoint(record, body, R.T @ (point - data.xpos[body]), R.T @ normal, (number[body],))


def _first_hit(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Sequence[int], start: Array, direction: Array
) -> tuple[int, Array, Array] | None:
    """Body, point and normal in `world` where a ray first hits a visible geom of some bodies; None if it hits none."""
    best, nearest = None, _OUTSIDE
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body not in bodies or model.geom_group[geom] >= _SEEN_GROUPS:
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


def _corners(model: mujoco.MjModel, rig: RigConfig, number: dict[int, int]) -> Iterator[LabelledKeypoint]:
    for arm in rig.arms:
        if arm.board is None:
            continue
        name = f"{arm.prefix}{BOARD_BODY}"
        body, T, board = model.body(name).id, arm.T_board_in_base, arm.board.board
        for side, x, y in (("top_left", -1, 1), ("top_right", 1, 1), ("bottom_right", 1, -1), ("bottom_left", -1, -1)):
            record = KeypointRecord(name=f"{name}_{side}", body=name, kind="corner")
            position = (T @ (x * board.width / 2, y * board.height / 2, 0.0, 1.0))[:3]
            yield LabelledKeypoint(record, body, position, T[:3, 2].copy(), (number[body],))
