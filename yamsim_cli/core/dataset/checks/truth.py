"""Checks that ground truth can be read, and that its images and arrays have the right sizes and labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ..layout import TRUTH_LABELS, truth_name
from ..records import from_json
from ..truth_files import TruthLabels, array_faults, load_depth, load_truth
from .images import ImageReader
from .problem import Problems

# Takes a file's path and content, and notes a wrong hash.
HashCheck = Callable[[str, bytes], object]
# Takes a file's path and returns its content, or None.
Read = Callable[[str], bytes | None]


class TruthChecks:
    """Checks one episode's ground truth.

    Args:
        cameras: camera -> width and height of its images.
        frames: how many frames the episode has.
        cloths: cloth -> how many points lie along its x axis and along its y axis.
        reader: decodes images.
        read: gives a file's content by its path; None where it is not there.
        hash_fits: called for each file that is whole.
    """

    def __init__(
        self,
        cameras: Mapping[str, tuple[int, int]],
        frames: int,
        cloths: Mapping[str, tuple[int, int]],
        reader: ImageReader,
        read: Read,
        hash_fits: HashCheck,
        problems: Problems,
    ) -> None:
        self._cameras = cameras
        self._frames = frames
        self._cloths = dict(cloths)
        self._reader = reader
        self._read = read
        self._hash_fits = hash_fits
        self._problems = problems
        self._labels = self._read_labels()

    def _read_labels(self) -> TruthLabels | None:
        data = self._read(TRUTH_LABELS)
        if data is None:
            return None
        try:
            labels = from_json(TruthLabels, data, TRUTH_LABELS)
        except DatasetError as error:
            self._problems.add("truth.damaged", TRUTH_LABELS, str(error).removeprefix(f"{TRUTH_LABELS}: "))
            return None
        if labels.cloths != self._cloths:
            self._problems.add("truth.cloth", TRUTH_LABELS, _grids(labels.cloths), _grids(self._cloths))
        return labels

    def check_missing(self, recorded: Mapping[str, str], present: Mapping[str, int]) -> None:
        """Note files that are neither there nor in the record. Recorded ones that are gone are noted elsewhere."""
        for name in (TRUTH_LABELS, *map(truth_name, self._cameras)):
            if name not in present and name not in recorded:
                self._problems.add("truth.missing", name)

    def check_arrays(self, camera: str) -> None:
        """Check the arrays of poses, keypoints and boxes of one camera."""
        name = truth_name(camera)
        data = self._read(name)
        if data is None:
            return
        try:
            arrays = load_truth(data)
        except DatasetError as error:
            self._problems.add("truth.damaged", name, str(error))
            return
        if self._labels is not None:
            for fault in array_faults(arrays, self._labels, self._frames):
                self._problems.add("truth.shape", name, fault)

    def check_depth(self, camera: str, name: str) -> None:
        """Check one depth image."""
        data = self._read(name)
        if data is None:
            return
        try:
            depth = load_depth(data)
        except DatasetError as error:
            self._problems.add("depth.decode", name, str(error))
            return
        self._check_size("depth.size", camera, name, depth)
        self._hash_fits(name, data)

    def check_segmentation(self, camera: str, name: str) -> None:
        """Check one segmentation image."""
        data = self._read(name)
        if data is None:
            return
        labels = self._reader.labels(data)
        if labels is None:
            self._problems.add("segmentation.decode", name, f"{len(data)} bytes")
            return
        self._check_size("segmentation.size", camera, name, labels)
        if self._labels is not None:
            known = {label.id for label in self._labels.labels}
            unknown = sorted(set(np.unique(labels).tolist()) - known)
            if unknown:
                value = ", ".join(map(str, unknown))
                self._problems.add("segmentation.label", name, value, f"0 to {max(known)}", about=camera)
        self._hash_fits(name, data)

    def _check_size(self, code: str, camera: str, name: str, image: NDArray[np.generic]) -> None:
        height, width = image.shape
        wanted = self._cameras[camera]
        if (width, height) != wanted:
            self._problems.add(code, name, f"{width}x{height}", f"{wanted[0]}x{wanted[1]}", about=(code, camera))


def _grids(cloths: Mapping[str, tuple[int, int]]) -> str:
    return ", ".join(f"{name} of {x} x {y} points" for name, (x, y) in sorted(cloths.items())) or "no cloth"
