"""Fake pictures of a scene for servers."""

from __future__ import annotations

from typing import Any

import numpy as np

from yamsim_cli.real.serve.render_process import CameraFrames

SIZE = (8, 6)


class FakeRenderProcess:
    """Replaces a `RenderProcess`: each shot has pictures of one grey level, its number."""

    cameras = ("top", "left")
    size = SIZE
    fps = 30.0
    K = dict.fromkeys(cameras, np.diag([7.0, 7.0, 1.0]))

    def __init__(self, joints: tuple[Any, ...] = ()) -> None:
        self.newest_frames: CameraFrames | None = None
        self.joints = joints

    def take(self, number: int, sim_time: float = 0.0) -> None:
        width, height = self.size
        pictures = {name: np.full((height, width, 3), number, np.uint8) for name in self.cameras}
        poses = dict.fromkeys(self.cameras, np.eye(4))
        self.newest_frames = CameraFrames(number, 1_000_000_000 + number, sim_time, self.joints, poses, pictures)
