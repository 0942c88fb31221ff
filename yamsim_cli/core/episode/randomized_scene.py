from __future__ import annotations

from ..attempt_data import Attempt
from ..config.recording import RecordConfig
from ..config.variation import RandomizationSample
from ..images.image import Image
from ..rendering.image_augmentation import ImageAugmenter
from ..rendering.renderer import SceneRenderer
from ..scene.compiled import CompiledScene
from ..scene.randomized_model import RandomizedArms, RandomizedModel


class RandomizedScene:
    """A compiled scene with the variation last given to `apply_randomization`."""

    def __init__(self, config: RecordConfig, scene: CompiledScene) -> None:
        self._config = config
        self._scene = scene
        self._randomized_model: RandomizedModel | None = None
        if config.randomization.varied_parts:
            self._randomized_model = RandomizedModel(scene.model, config.randomization, config.scene)
        self._randomized_arms = RandomizedArms(scene) if config.randomization.arm_dynamics else None
        self._applied: RandomizationSample | None = None
        self._uploaded: RandomizationSample | None = None
        self._augmenter: tuple[Attempt, ImageAugmenter] | None = None

    def apply_randomization(self, attempt: Attempt) -> CompiledScene:
        """Return the scene with an attempt's variation; valid until the next call."""
        if self._randomized_model and attempt.variation is not self._applied:
            self._randomized_model.apply_randomization(attempt.variation)
            if self._randomized_arms:
                self._scene = self._randomized_arms.apply_randomization(attempt.variation.arm_dynamics)
            self._applied = attempt.variation
        return self._scene

    def upload_textures(self, renderer: SceneRenderer) -> None:
        """Upload the variation's textures to the renderer, before it renders."""
        if self._randomized_model and self._uploaded is not self._applied:
            for texture in self._randomized_model.textures:
                renderer.upload_texture(texture)
            self._uploaded = self._applied

    def augment_image(self, attempt: Attempt, image: Image, frame: int, camera: int) -> None:
        """Add an attempt's random brightness, contrast and noise to its image (height, width, 3), in place.

        Each `frame` and `camera` has its own noise.
        """
        ranges = self._config.randomization.picture
        if ranges is None:
            return
        if self._augmenter is None or self._augmenter[0] is not attempt:
            size = self._config.image.size_px
            job = attempt.job.for_look(self._config.look)
            self._augmenter = attempt, ImageAugmenter(ranges, attempt.variation, job, size)
        self._augmenter[1].apply(image, frame, camera)
