"""Output of raiden's code, unmodified, for an exported dataset: `read_raiden.py CHECKOUT EXPORT OUT ARMS`.

ARMS is `bimanual`, or `single` for arrays of one arm, as in `rd replay --arms`. Only the arms' controller and rerun are
replaced, which would open hardware or a window.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import sys
import tarfile
import types
from collections import Counter
from pathlib import Path
from typing import Any, ClassVar
from unittest import mock

import cv2
import numpy as np

CHECKOUT, EXPORT, OUT = (Path(argument) for argument in sys.argv[1:4])
ARMS = sys.argv[4]

# raiden keeps its configuration below the home.
os.environ["HOME"] = str(OUT)
sys.path[:0] = [str(CHECKOUT), str(CHECKOUT / "third_party" / "i2rt")]


class Arm:
    """An arm at home that records its commands."""

    def __init__(self) -> None:
        self.told: list[np.ndarray] = []

    def get_joint_pos(self) -> np.ndarray:
        return np.zeros(7)

    def command_joint_pos(self, joints: np.ndarray) -> None:
        self.told.append(np.array(joints, dtype=np.float64))


class Controller:
    """Replaces raiden's controller, which opens CAN buses."""

    made: ClassVar[list[Controller]] = []

    def __init__(self, *, use_right_follower: bool, use_left_follower: bool, **_: Any) -> None:
        self.follower_l = Arm() if use_left_follower else None
        self.follower_r = Arm() if use_right_follower else None
        self.made.append(self)

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: None


controller = types.ModuleType("raiden.robot.controller")
controller.__getattr__ = lambda name: Controller if name == "RobotController" else (lambda *_, **__: None)  # type: ignore[method-assign]
sys.modules["raiden.robot.controller"] = controller
sys.modules["raiden.robot.footpedal"] = mock.MagicMock()
sys.modules["rerun"] = rerun = mock.MagicMock()

from raiden import converter, shardify, visualizer  # noqa: E402
from raiden.robot import replay  # noqa: E402


def frames_of(episode: Path) -> list[dict[str, Any]]:
    return [pickle.loads(file.read_bytes()) for file in sorted((episode / "lowdim").iterdir())]


def sharded(episodes: list[Path]) -> dict[str, Any]:
    """Return the content of the tars of `rd shardify` with its defaults, with depth if there is any."""
    depth = (episodes[0] / "depth").is_dir()
    config = shardify.ShardifyConfig(output_dir=OUT / "shards", resize_images_size=(384, 384), use_depth=depth)
    shardify.run_shardify(episodes, config)
    kinds: Counter[str] = Counter()
    anchors: Counter[str] = Counter()
    sizes, controls, said = set(), set(), set()
    for tar in sorted((OUT / "shards" / "shards").glob("*.tar")):
        with tarfile.open(tar) as archive:
            for member in archive:
                data = archive.extractfile(member).read()  # type: ignore[union-attr]
                kind = member.name.partition(".")[2]
                kinds[kind] += 1
                if kind.endswith(".jpg"):
                    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
                    sizes.add(picture.shape)
                elif kind == "metadata.json":
                    sample = json.loads(data)
                    controls.add(sample["control"])
                    anchors[sample["episode_id"]] += 1
                elif kind == "language_instructions.json":
                    said.update(json.loads(data)["original"])
    stats = json.loads((OUT / "shards" / "shards" / "stats.json").read_text())
    still = sorted(key for key, of in stats.items() if np.max(of["std"]) < 1e-9)
    widths = {key: len(of["mean"]) for key, of in stats.items()}
    listed = (OUT / "shards" / "shards" / "manifest.jsonl").read_text().splitlines()
    return {
        "kinds": dict(kinds),
        "sizes": sorted(sizes),
        "controls": sorted(controls),
        "said": sorted(said),
        "anchors": dict(anchors),
        "still": still,
        "widths": widths,
        "sequences": sum(json.loads(line)["num_sequences"] for line in listed),
    }


def replayed(episode: Path) -> dict[str, Any]:
    """Return the largest commanded speed of each arm's joints in `rd replay` of the poses, rad/s."""
    Controller.made.clear()
    rate = 150
    with mock.patch("time.sleep"):
        replay.run_replay(episode, arms=ARMS, control_hz=rate)
    robot = Controller.made[0]
    told = [np.array(arm.told) for arm in (robot.follower_l, robot.follower_r) if arm]
    asked = np.array([frame["action_joints"] for frame in frames_of(episode)])
    off = [np.abs(rows[:: rate // 30, :6] - asked[:, 7 * k : 7 * k + 6]) for k, rows in enumerate(told)]
    return {
        "commands": len(told[0]),
        "peak": [(np.abs(np.diff(rows[:, :6], axis=0)).max(axis=0) * rate).tolist() for rows in told],
        # Distance of the result of inverse kinematics from the recorded joints.
        "off": [rows.max(axis=1).tolist() for rows in off],
    }


def converted(episode: Path) -> dict[str, float]:
    """Convert the frames again by `rd convert`'s code, from joints and calibration. Return the difference by key."""
    frames = frames_of(episode)
    calibration = json.loads((EXPORT / "calibration_results.json").read_text())
    cameras = json.loads((episode / "metadata.json").read_text())["cameras"]
    times = np.load(episode / "rgb" / cameras[0] / "timestamps.npy")
    robot: dict[str, np.ndarray] = {"timestamps": times}
    sides = "l" if ARMS == "single" else "lr"
    for k, side in enumerate(sides):
        joints, command = (
            np.array([frame[key][7 * k : 7 * k + 7] for frame in frames]) for key in ("joints", "action_joints")
        )
        robot |= {
            f"follower_{side}_joint_pos": joints[:, :6],
            f"follower_{side}_joint_pos_7d": joints,
            f"follower_{side}_joint_cmd": command,
        }
    infos = {}
    for entry in cameras:
        K = frames[0]["intrinsics"][entry]
        width, height = calibration["cameras"][entry]["intrinsics"]["image_size"]
        infos[entry] = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "width": width, "height": height}
    between = calibration.get("bimanual_transform")
    roles = {"left_wrist_camera": "follower_l_joint_pos", "right_wrist_camera": "follower_r_joint_pos"}
    converter._build_lowdim(
        seq_dir=OUT / "converted",
        cameras=cameras,
        n_frames=len(frames),
        camera_infos=infos,
        calib=calibration,
        robot_data=robot,
        rec_meta={"task_name": str(frames[0]["language_task"]), "task_instruction": str(frames[0]["language_prompt"])},
        flip_cameras=converter._FLIP_CAMERAS,
        # As `convert_recording` reads it.
        right_base_to_left_base=between
        and np.linalg.inv(np.array(between["right_base_to_left_base"], dtype=np.float32)),
        cam_timestamps=dict.fromkeys(cameras, times),
        wrist_camera_joint_keys={name: key for name, key in roles.items() if name in cameras},
    )
    again = frames_of(OUT / "converted")
    found: dict[str, float] = {}
    for one, other in zip(frames, again, strict=True):
        assert list(one) == list(other), (list(one), list(other))
        for key, value in one.items():
            if isinstance(value, dict):
                parts = {f"{key}.{name}": (value[name], other[key][name]) for name in value}
            else:
                parts = {key: (value, other[key])}
            for name, (a, b) in parts.items():
                assert (a.dtype, a.shape) == (b.dtype, b.shape), (name, a.dtype, a.shape, b.dtype, b.shape)
                if a.dtype == object:
                    assert a == b, name
                elif name.startswith("extrinsics"):
                    turned = f"{name}.rotation"
                    found[name] = max(found.get(name, 0.0), float(np.linalg.norm(a[:3, 3] - b[:3, 3])))
                    found[turned] = max(found.get(turned, 0.0), float(np.abs(a[:3, :3] - b[:3, :3]).max()))
                else:
                    found[name] = max(found.get(name, 0.0), float(np.abs(a - b).max()))
    return found


def visualized(episode: Path) -> dict[str, Any]:
    """Return the number of pictures in `rd visualize`, and the right hand's position in the left base."""
    rerun.reset_mock()
    visualizer.visualize_recording(str(EXPORT), episode.name, image_scale=0.5)
    shown = [call.args for call in rerun.log.call_args_list]
    lines = [np.asarray(call.args[0][0]) for call in rerun.LineStrips3D.call_args_list]
    return {
        "pictures": sum(name.endswith("/rgb") for name, *_ in shown),
        "right_hand": lines[0].tolist(),
    }


def main() -> None:
    episodes = sorted(path for path in EXPORT.iterdir() if (path / "metadata.json").exists())
    # Their prints are not part of the answer.
    with contextlib.redirect_stdout(sys.stderr):
        found = {
            "shards": sharded(episodes),
            "replay": {episode.name: replayed(episode) for episode in episodes},
            "converted": converted(episodes[0]),
            # It cannot show arrays of one arm, its own included.
            "visualized": visualized(episodes[0]) if ARMS == "bimanual" else None,
        }
    print(json.dumps(found))


main()
