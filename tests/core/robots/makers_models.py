"""The manufacturer's models of the YAM family, from its SDK's wheel, each arm and gripper combined as the SDK does.

    python -m tests.core.robots.makers_models WHEEL > tests/data/family_reference.json

Source: dreamscale-i2rt 1.3.6.post1 (MIT), `combine_arm_and_gripper_xml` of i2rt/robots/utils.py. Nothing of it is
imported.
"""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from yamsim_cli.core.geometry.se3 import Array, pose, pose_from_quat, quat_from_rotation

Element = ElementTree.Element

# yamsim's model -> the manufacturer's arm and its version.
ARMS: Mapping[str, tuple[str, int]] = {
    "yam_v1": ("yam", 1),
    "yam_pro_v1": ("yam_pro", 1),
    "yam_ultra_v1": ("yam_ultra", 1),
    "yam_ultra_v2": ("yam_ultra", 2),
    "big_yam_v1": ("big_yam", 1),
}


@dataclass(frozen=True)
class Fingers:
    """Mapping of the manufacturer's fingers to yamsim's.

    Attributes:
        bodies, joints: the manufacturer's, of yamsim's left and right finger.
        closed: the manufacturer's joint positions at yamsim's 0, m.
    """

    bodies: tuple[str, str]
    joints: tuple[str, str]
    closed: float = 0.0


_TIPS = Fingers(("tip_left", "tip_right"), ("joint7", "joint8"))
GRIPPERS: Mapping[str, Fingers | None] = {
    "crank_4310": Fingers(_TIPS.bodies, _TIPS.joints, 0.00205),
    "linear_4310": _TIPS,
    "linear_3507": _TIPS,
    # The manufacturer's second finger opens to the left.
    "flexible_4310": Fingers(("linear_module_2", "linear_module"), ("joint8", "joint7")),
    "no_gripper": None,
    "yam_teaching_handle": None,
}

# Half a turn about z from the manufacturer's flange to yamsim's.
T_FLANGE = pose_from_quat((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))

# Poses in the file; the test with the wheel takes 200.
_STORED = 6


@dataclass(frozen=True)
class ReferencePose:
    """One pose with yamsim's joints, then fingers (n,), rad and m, and its values in the manufacturer's model.

    Attributes:
        bodies: pose (4, 4) of each of yamsim's bodies in the base frame.
        mass_matrix: (n, n), without armature.
    """

    q: Array
    bodies: Mapping[str, Array]
    mass_matrix: Array


class MakersModel:
    """The manufacturer's model of an arm with a gripper."""

    def __init__(self, wheel: Path, arm: str, gripper: str) -> None:
        with zipfile.ZipFile(wheel) as archive:
            self._model = mujoco.MjModel.from_xml_string(_merged(archive, *ARMS[arm], gripper))
        self._fingers = GRIPPERS[gripper]
        names = [f"joint{k}" for k in range(1, 7)] + list(self._fingers.joints if self._fingers else ())
        joints = [self._model.joint(name) for name in names]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._closed = np.array([0.0] * 6 + [self._fingers.closed] * 2 if self._fingers else [0.0] * 6)
        self._range = np.array([joint.range for joint in joints])

    def random(self, rng: np.random.Generator) -> Array:
        """Random joints and fingers (n,) within their limits."""
        return np.round(rng.uniform(*self._range.T) - self._closed, 6)

    def sample(self, q: Array) -> ReferencePose:
        """Return the model's values for joints and fingers (n,)."""
        model, data = self._model, mujoco.MjData(self._model)
        data.qpos[self._qpos] = q + self._closed
        mujoco.mj_forward(model, data)
        bodies = {"link_6": _pose(data, "gripper") @ T_FLANGE}
        if self._fingers:
            for side, name in zip(("left", "right"), self._fingers.bodies, strict=True):
                bodies[f"link_{side}_finger"] = _pose(data, name)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return ReferencePose(q, bodies, full[np.ix_(self._dof, self._dof)])


def _pose(data: mujoco.MjData, name: str) -> Array:
    body = data.body(name)
    return pose(body.xpos, body.xmat.reshape(3, 3))


def _merged(archive: zipfile.ZipFile, arm: str, version: int, gripper: str) -> str:
    """The arm's MJCF with the gripper's body in its last one, without visual parts."""
    models = "i2rt/robot_models"
    root = _without_looks(archive.read(f"{models}/arm/{arm}/v{version}/{arm}.xml"))
    hand = _without_looks(archive.read(f"{models}/gripper/{gripper}/{gripper}.xml"))
    mount = yaml.safe_load(archive.read(f"i2rt/robots/config/{gripper}.yml"))["last_joint_mount"][arm][f"v{version}"]
    flange = _part(root, ".//body[@name='gripper']")
    flange.set("pos", mount["pos"])
    flange.set("quat", mount["quat"])
    _part(flange, "joint").set("axis", mount["axis"])
    frame = _part(hand, ".//body[@name='gripper']")
    T = _placed(frame)
    inside = ElementTree.SubElement(flange, "frame", {key: frame.get(key, "") for key in ("pos", "quat")})
    flange.remove(_part(flange, "inertial"))
    for element in frame:
        if element.tag == "inertial":
            placed = T @ _placed(element)
            element.set("pos", _text(placed[:3, 3]))
            element.set("quat", _text(quat_from_rotation(placed[:3, :3])))
            flange.insert(0, element)
        else:
            inside.append(element)
    root.extend(hand.findall("equality"))
    return ElementTree.tostring(root, encoding="unicode")


def _without_looks(xml: bytes) -> Element:
    root = ElementTree.fromstring(xml)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("mesh", "geom"):
                parent.remove(child)
    return root


def _part(element: Element, path: str) -> Element:
    found = element.find(path)
    assert found is not None, path
    return found


def _placed(element: Element) -> Array:
    place, turn = (
        [float(number) for number in element.get(key, default).split()]
        for key, default in (("pos", "0 0 0"), ("quat", "1 0 0 0"))
    )
    return pose_from_quat(place, turn)


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def reference(wheel: Path) -> dict[str, Any]:
    """Values of the manufacturer's models for a few random poses, of every arm with every gripper."""
    rng, found = np.random.default_rng(20261122), []
    for arm in ARMS:
        for gripper in GRIPPERS:
            makers = MakersModel(wheel, arm, gripper)
            samples = [_plain(makers.sample(makers.random(rng))) for _ in range(_STORED)]
            found.append({"arm": arm, "gripper": gripper, "samples": samples})
    return {"source": "dreamscale-i2rt 1.3.6.post1", "pairs": found}


def _plain(sample: ReferencePose) -> dict[str, Any]:
    upper = np.triu_indices(len(sample.q))
    return {
        "q": sample.q.tolist(),
        "bodies": {name: np.round(T[:3], 9).ravel().tolist() for name, T in sample.bodies.items()},
        "mass_matrix": np.round(sample.mass_matrix[upper], 9).tolist(),
    }


def stored(plain: Mapping[str, Any]) -> ReferencePose:
    """Rebuild a sample from plain data."""
    q = np.array(plain["q"])
    matrix = np.zeros((len(q), len(q)))
    matrix[np.triu_indices(len(q))] = plain["mass_matrix"]
    bodies = {name: np.vstack([np.reshape(T, (3, 4)), (0, 0, 0, 1)]) for name, T in plain["bodies"].items()}
    return ReferencePose(q, bodies, np.triu(matrix) + np.triu(matrix, 1).T)


if __name__ == "__main__":
    json.dump(reference(Path(sys.argv[1])), sys.stdout)
