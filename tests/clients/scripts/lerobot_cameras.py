"""Served pictures by LeRobot's own camera interface: `lerobot_cameras.py REPOSITORY FOLDER`."""

from __future__ import annotations

import json
import sys
import time

sys.path.insert(0, sys.argv[1])

import draccus
import numpy as np
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs

import yamsim_cli.lerobot_camera  # noqa: F401 - makes the type known

FOLDER = sys.argv[2]

config = draccus.decode(CameraConfig, {"type": "yamsim", "camera": "top", "folder": FOLDER})
other = draccus.decode(CameraConfig, {"type": "yamsim", "camera": "top", "folder": FOLDER, "color_mode": "bgr"})
wide = draccus.decode(CameraConfig, {"type": "yamsim", "camera": "top", "folder": FOLDER, "width": 9, "height": 9})
cameras = make_cameras_from_configs({"top": config, "bgr": other, "wide": wide})
for name in ("top", "bgr"):
    cameras[name].connect()
try:
    cameras["wide"].connect()
    refused = ""
except ValueError as error:
    refused = str(error)
top = cameras["top"]
began = time.perf_counter()
for _ in range(20):
    top.read()
rate = 20 / (time.perf_counter() - began)
try:
    for _ in range(3):
        top.async_read(timeout_ms=0.001)
    late = False
except TimeoutError:
    late = True
picture, swapped = top.read_latest(max_age_ms=5000), cameras["bgr"].read_latest(max_age_ms=5000)
again = top.async_read(timeout_ms=5000)
for name in ("top", "bgr"):
    cameras[name].disconnect()
print(
    json.dumps(
        {
            "shape": list(picture.shape),
            "of_config": [top.height, top.width, top.fps],
            "contrast": float(picture.std()),
            "swapped": float(np.abs(picture[..., ::-1].astype(int) - swapped).mean()),
            "same": float(np.abs(picture.astype(int) - again).mean()),
            "a_second": rate,
            "late": late,
            "refused": refused,
            "connected": top.is_connected,
        }
    )
)
