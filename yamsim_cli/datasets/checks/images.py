"""Check that images and ground truth decode and have the expected sizes, and that images change when the arm moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.dataset.dataset_paths import TRUTH_LABELS_FILE, truth_path
from yamsim_cli.core.dataset.ground_truth_files import TruthLabels, array_faults, load_depth, load_truth
from yamsim_cli.core.dataset.records import EpisodeRecord, from_json
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array

if TYPE_CHECKING:
    from yamsim_cli.core.images.jpeg import JpegReader

_MAX_PIXELS = 2**26  # a header can declare gigabytes

# Both are measured on a downscaled image, which suppresses noise and single bad pixels.
_UNIFORM_CONTRAST = 2.0  # 0 to 255, largest contrast of a uniform image
_BLACK_BRIGHTNESS = 16.0  # 0 to 255, largest brightness of a black image

# A camera is frozen if `_MIN_FROZEN_RUN` images are equal while a joint moves by `_MIN_FROZEN_MOTION`. That moves the
# hand, half a metre away, by 10 mm or 5 pixels in the task's camera.
_MIN_FROZEN_RUN = 3  # images
_MIN_FROZEN_MOTION = 0.02  # rad; images of a slower arm may be equal

CheckFileHash = Callable[[str, bytes], object]  # gets path and content of a file, and reports a wrong hash
ReadFileFunction = Callable[[str], bytes | None]  # path of a file -> content, or None


class CameraChecks:
    """Checks the images of one camera, one by one.

    Args:
        size: expected (width, height); None expects the first image's size.
    """

    def __init__(
        self, camera: str, size: tuple[int, int] | None, reader: JpegReader, problems: ProblemCollector
    ) -> None:
        self._camera = camera
        self._stated = size
        self._reader = reader
        self._problems = problems
        self.size = size
        self.fingerprints: dict[int, int] = {}

    def check(self, number: int, name: str, data: bytes) -> bool:
        """Check one image; return False if it is damaged."""
        header = self._reader.header(data)
        if header is None:
            self._problems.add("image.decode", name, f"{len(data)} bytes")
            return False
        size = (header.width, header.height)
        if header.width * header.height > _MAX_PIXELS:
            self._add("image.size", name, _format_size(size), f"at most {_MAX_PIXELS} pixels")
            return True
        if self.size is None:
            self.size = size
        if size != self.size:
            self._add(
                "image.size",
                name,
                _format_size(size),
                _format_size(self.size) + ("" if self._stated else ", as the first image"),
            )
        if header.channels != 3:
            self._add("image.colour", name, f"{header.channels} channel", "3 channels")
        look = self._reader.compute_stats(data)
        if look is None or look.decoder_warning:
            self._problems.add("image.decode", name, look.decoder_warning if look else f"{len(data)} bytes")
            return False
        if look.contrast < _UNIFORM_CONTRAST:
            code = "image.black" if look.brightness < _BLACK_BRIGHTNESS else "image.uniform"
            self._add(code, name, f"brightness {look.brightness:.0f} of 255, contrast {look.contrast:.1f}")
        self.fingerprints[number] = look.fingerprint
        return True

    def _add(self, code: str, name: str, value: str, valid: str = "") -> None:
        self._problems.add(code, name, value, valid, about=self._camera)


def check_frozen_images(
    fingerprints: Mapping[int, int], names: Mapping[int, str], joints: Mapping[int, Array], problems: ProblemCollector
) -> None:
    """Report runs of equal images during which the arm moves.

    Args:
        fingerprints, names, joints: by frame number; joints in rad.
    """
    for run in _equal_runs(fingerprints):
        known = [joints[k] for k in run if k in joints]
        if len(run) < _MIN_FROZEN_RUN or len(known) < 2:
            continue
        motion = float(np.max(np.ptp(np.array(known), axis=0)))
        if motion > _MIN_FROZEN_MOTION:
            value = f"frames {run[0]} to {run[-1]} are the same image while a joint moves {motion:.2f} rad"
            problems.add("image.frozen", names[run[0]], value)


def _equal_runs(fingerprints: Mapping[int, int]) -> list[Sequence[int]]:
    runs: list[list[int]] = []
    for number in sorted(fingerprints):
        last = runs[-1][-1] if runs else None
        if last == number - 1 and fingerprints[number] == fingerprints[last]:
            runs[-1].append(number)
        else:
            runs.append([number])
    return list(runs)


def _format_size(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


class TruthChecks:
    """Checks the ground truth of one episode against its `record`."""

    def __init__(
        self,
        record: EpisodeRecord,
        reader: JpegReader,
        read: ReadFileFunction,
        hash_fits: CheckFileHash,
        problems: ProblemCollector,
    ) -> None:
        self._record = record
        self._reader = reader
        self._read = read
        self._hash_fits = hash_fits
        self._problems = problems
        self._labels = self._read_labels()

    def _read_labels(self) -> TruthLabels | None:
        data = self._read(TRUTH_LABELS_FILE)
        if data is None:
            return None
        try:
            labels = from_json(TruthLabels, data, TRUTH_LABELS_FILE)
        except DatasetError as error:
            self._problems.add("truth.damaged", TRUTH_LABELS_FILE, str(error).removeprefix(f"{TRUTH_LABELS_FILE}: "))
            return None
        if labels.cloths != self._record.cloths:
            self._problems.add(
                "truth.cloth",
                TRUTH_LABELS_FILE,
                _cloth_grids_text(labels.cloths),
                _cloth_grids_text(self._record.cloths),
            )
        return labels

    def check_missing_files(self, present: Mapping[str, int]) -> None:
        """Report ground truth files that are neither in `present` (path -> bytes) nor in the record."""
        for name in (TRUTH_LABELS_FILE, *map(truth_path, self._record.cameras)):
            if name not in present and name not in self._record.files:
                self._problems.add("truth.missing", name)

    def check_arrays(self, camera: str) -> None:
        """Check keys, dtypes and shapes of one camera's poses, keypoints and boxes."""
        name = truth_path(camera)
        data = self._read(name)
        if data is None:
            return
        try:
            arrays = load_truth(data)
        except DatasetError as error:
            self._problems.add("truth.damaged", name, str(error))
            return
        if self._labels is not None:
            for fault in array_faults(arrays, self._labels, self._record.frames):
                self._problems.add("truth.shape", name, fault)

    def check_depth(self, camera: str, name: str) -> None:
        """Check that a depth image decodes, with the recorded size and hash."""
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
        """Check that a segmentation image decodes, with the recorded size and hash, and that each value has a label."""
        data = self._read(name)
        if data is None:
            return
        labels = self._reader.read_labels(data)
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
        wanted = self._record.cameras[camera]
        if (width, height) != wanted:
            self._problems.add(code, name, f"{width}x{height}", f"{wanted[0]}x{wanted[1]}", about=(code, camera))


def _cloth_grids_text(cloths: Mapping[str, tuple[int, int]]) -> str:
    return ", ".join(f"{name} of {x} x {y} points" for name, (x, y) in sorted(cloths.items())) or "no cloth"
