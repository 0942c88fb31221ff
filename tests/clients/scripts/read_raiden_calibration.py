"""A calibration read by raiden's policy server: `read_raiden_calibration.py CHECKOUT CALIBRATION`.

Only chiral and the arms' controller are replaced, which would open sockets and hardware.
"""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest import mock

import numpy as np

sys.path.insert(0, sys.argv[1])
sys.modules["chiral"] = chiral = ModuleType("chiral")
chiral.__getattr__ = lambda name: type(name, (), {})
for name in ("chiral.types", "raiden.robot.controller"):
    sys.modules[name] = mock.MagicMock()

from raiden import server  # noqa: E402

path = Path(sys.argv[2])
names = list(json.loads(path.read_text())["cameras"])
one = server.RaidenPolicyServer.__new__(server.RaidenPolicyServer)
# A camera that is not open: its pose is read all the same.
one._raiden_cam_cfg = SimpleNamespace(list_camera_names=lambda: names)
one._cam_handles, one._resize = {}, None
one._cam_intrinsics, one._cam_extrinsics, one._T_cam2ee = {}, {}, {}
one._T_left_base_from_right_base = None
with contextlib.redirect_stdout(sys.stderr):
    one._calibration = one._load_calibration(str(path))
    one._prepare_camera_transforms()
poses = {
    "scene": {name: T for name, T in one._cam_extrinsics.items() if name not in one._T_cam2ee},
    "wrist": one._T_cam2ee,
    "bases": {"right": one._T_left_base_from_right_base},
}
print(json.dumps({kind: {name: np.asarray(T).tolist() for name, T in of.items()} for kind, of in poses.items()}))
