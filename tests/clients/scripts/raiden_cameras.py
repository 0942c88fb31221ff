"""Served pictures by raiden's own camera class: `raiden_cameras.py CHECKOUT REPOSITORY FOLDER`.

Only the library of the real cameras, which raiden imports, is replaced.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from unittest import mock

import numpy as np

sys.path[:0] = sys.argv[1:3]

with mock.patch.dict(sys.modules, {"pyrealsense2": mock.MagicMock()}):
    from raiden.cameras.base import Camera

    from yamsim_cli.camera_reader import CameraReader
    from yamsim_cli.raiden_camera import YamsimCamera

FOLDER = sys.argv[3]

found = {}
for name, camera in (("left_wrist_camera", "left"), ("right_wrist_camera", "right")):
    one = YamsimCamera(name, camera, FOLDER)
    assert isinstance(one, Camera)
    one.open()
    file = Path(FOLDER).parent / f"{name}.{one.recording_extension}"
    one.start_recording(file)
    assert one.grab() and one.grab()
    one.stop_recording()
    frame = one.get_frame()
    K, distortion, size = one.get_intrinsics()
    with CameraReader(camera, FOLDER) as reader:
        # Nothing moves: all pictures are equal.
        straight = reader.read().image[..., ::-1]
    one.close()
    found[name] = {
        "shape": list(frame.color.shape),
        "size": list(size),
        "distorted": bool(np.any(distortion)),
        "centre": K[:2, 2].tolist(),
        "behind_s": (one.get_current_timestamp_ns() - frame.timestamp_ns) * 1e-9,
        "straight": float(np.abs(frame.color.astype(int) - straight).mean()),
        "turned": float(np.abs(frame.color[::-1, ::-1].astype(int) - straight).mean()),
        "recorded": file.stat().st_size // frame.color.size,
    }
print(json.dumps(found))
