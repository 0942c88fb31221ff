"""A camchain read by Kalibr's own classes: `read_camchain.py CHECKOUT CAMCHAIN`.

Only Kalibr's compiled modules are replaced: `sm.Transformation` keeps its matrix, and `aslam_cv` keeps the arguments.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np


class Transformation:
    """A pose (4, 4), which must be a rotation and a shift."""

    def __init__(self, matrix):
        assert np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3)) and np.linalg.det(matrix[:3, :3]) > 0
        self.matrix = matrix

    def T(self):
        return self.matrix


checkout, path = Path(sys.argv[1]), sys.argv[2]
sys.modules |= {"sm": SimpleNamespace(Transformation=Transformation), "aslam_cv_backend": mock.MagicMock()}
sys.modules["aslam_cv"] = cv = mock.MagicMock()
source = checkout / "aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py"
spec = importlib.util.spec_from_file_location("ConfigReader", source)
reader = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reader)

chain = reader.CameraChainParameters(path)
cameras = []
for number in range(chain.numCameras()):
    parameters = chain.getCameraParameters(number)
    cv.reset_mock()
    # What Kalibr's validator and its calibration of cameras with an IMU work with.
    geometry = reader.AslamCamera.fromParameters(parameters).geometry
    assert geometry is cv.DistortedPinholeCameraGeometry.return_value
    cameras.append(
        {
            "topic": parameters.getRosTopic(),
            "projection": list(cv.DistortedPinholeProjection.call_args.args[:6]),
            "lens": list(cv.RadialTangentialDistortion.call_args.args),
            "from_previous": chain.getExtrinsicsLastCamToHere(number).T().tolist() if number else None,
        }
    )
print(json.dumps({"cameras": cameras}))
