"""Ground truth of one episode, frame by frame and camera by camera, as files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..dataset.layout import TRUTH_LABELS, depth_name, segmentation_name, truth_name
from ..dataset.records import to_json
from ..dataset.truth_files import array_forms, dump_arrays, dump_depth
from ..geometry.se3 import Array
from ..images.png import encode_labels
from ..vision.frame_truth import measure_frame
from ..vision.labels import SceneLabels
from ..vision.renderer import SceneRenderer


class EpisodeTruth:
    """Gathers an episode's truth: `add` every frame of every camera in order, then take `files`."""

    def __init__(self, labels: SceneLabels, cameras: Sequence[str], T_base_in_world: Array) -> None:
        self._labels = labels
        self._T_base_in_world = T_base_in_world
        self._rows: dict[str, list[dict[str, NDArray[Any]]]] = {camera: [] for camera in cameras}
        self._intrinsics: dict[str, Array] = {}
        self._files: dict[str, bytes] = {}

    def add(self, data: mujoco.MjData, camera: str, renderer: SceneRenderer) -> None:
        """Measure the picture that a camera takes now."""
        truth = measure_frame(data, camera, renderer, self._labels, self._T_base_in_world)
        frame = len(self._rows[camera])
        self._rows[camera].append(truth.arrays)
        self._intrinsics[camera] = renderer.intrinsics(camera).K
        self._files[depth_name(camera, frame)] = dump_depth(truth.depth_mm)
        self._files[segmentation_name(camera, frame)] = encode_labels(truth.labels)

    @property
    def files(self) -> dict[str, bytes]:
        """Path inside the episode -> content."""
        files = dict(self._files)
        for camera, rows in self._rows.items():
            forms = array_forms(self._labels.names, len(rows))
            arrays = {"intrinsics": self._intrinsics[camera]} | {
                key: np.stack([row[key] for row in rows]).astype(dtype)
                for key, (dtype, _) in forms.items()
                if key in rows[0]
            }
            files[truth_name(camera)] = dump_arrays(arrays)
        files[TRUTH_LABELS] = to_json(self._labels.names, indent=1)
        return files
