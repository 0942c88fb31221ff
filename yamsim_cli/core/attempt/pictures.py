"""Pictures of an attempt: as recordings have them, with ground truth, or plain ones for whoever looks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..dataset.layout import image_name
from ..geometry.se3 import Array
from ..images.image import Image
from ..images.jpeg import encode_jpeg
from ..types import Attempt
from ..vision.frame_truth import whole_mm
from ..vision.renderer import SceneRenderer
from .ground_truth import EpisodeTruth
from .simulator import Simulator


def render(simulator: Simulator, attempt: Attempt, qpos: Array, cameras: Sequence[str]) -> dict[str, Image]:
    """Camera -> RGB image (height, width, 3) at MuJoCo's positions (nq,), without what a camera's cable adds.

    Raises:
        ResourceError: no OpenGL context could be made.
    """
    renderer = _renderer(simulator, attempt)
    simulator.replica.show(qpos)
    return {camera: renderer.render(simulator.replica.data, camera) for camera in cameras}


def recorded_pictures(
    simulator: Simulator, attempt: Attempt, positions: Iterable[Array]
) -> Iterator[tuple[int, str, Image]]:
    """Frame, camera and RGB image (height, width, 3), as recordings have them, at each of MuJoCo's positions (nq,).

    The image's memory is used again for the next one. Raises as `render`.
    """
    width, height = simulator.config.image.size_px
    image = np.empty((height, width, 3), np.uint8)
    renderer = _renderer(simulator, attempt)
    for k, qpos in enumerate(positions):
        simulator.replica.show(qpos)
        for number, camera in enumerate(simulator.scene.cameras):
            renderer.render(simulator.replica.data, camera, image)
            simulator.variations.finish(attempt, image, k, number)
            yield k, camera, image


def image_files(simulator: Simulator, attempt: Attempt, positions: Iterable[Array]) -> dict[str, bytes]:
    """Path inside the episode -> JPEG of each recorded picture, and the ground truth about it where that is wanted.

    Raises as `render`.
    """
    files: dict[str, bytes] = {}
    truth: EpisodeTruth | None = None
    if simulator.labels is not None:
        truth = EpisodeTruth(simulator.labels, simulator.scene.cameras, simulator.scene.T_base_in_world)
    for k, camera, image in recorded_pictures(simulator, attempt, positions):
        files[image_name(camera, k)] = encode_jpeg(image, simulator.config.image.jpeg_quality)
        if truth:
            truth.add(simulator.replica.data, camera, simulator.renderer)
    return files | (truth.files if truth else {})


def depth_mm(simulator: Simulator, attempt: Attempt, qpos: Array, camera: str) -> NDArray[np.uint16]:
    """A depth image (height, width) in mm at MuJoCo's positions (nq,), of a config with `truth`. Raises as `render`."""
    assert simulator.labels is not None, "depth is part of truth"
    renderer = _renderer(simulator, attempt)
    simulator.replica.show(qpos)
    # Of what has a label, as recorded truth is: the sky has none, and is at no distance.
    labels = simulator.labels
    return whole_mm(renderer.label(simulator.replica.data, camera, labels.of_geom, labels.of_flex)[1])


def _renderer(simulator: Simulator, attempt: Attempt) -> SceneRenderer:
    """The renderer, once it knows how the attempt looks."""
    simulator.varied(attempt)
    simulator.variations.upload(simulator.renderer)
    return simulator.renderer
