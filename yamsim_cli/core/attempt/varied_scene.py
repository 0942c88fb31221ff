"""The one place where an attempt's variation acts: on the scene, on the renderer's copy of it, and on pictures."""

from __future__ import annotations

from ..config.recording import RecordConfig
from ..images.image import Image
from ..scene.compiled import CompiledScene
from ..scene.varied_model import VariedArms, VariedModel
from ..types import Attempt
from ..variation import Variation
from ..vision.augment import PictureAugmenter
from ..vision.renderer import SceneRenderer


class VariedScene:
    """A compiled scene, varied as the attempt that was last asked for. Without any randomization nothing is changed.

    Args:
        scene: as it was compiled.
    """

    def __init__(self, config: RecordConfig, scene: CompiledScene) -> None:
        self._config = config
        self._scene = scene
        self._varied: VariedModel | None = None
        if config.randomization.parts:
            self._varied = VariedModel(scene.model, config.randomization, config.scene)
        self._arms = VariedArms(scene) if config.randomization.arm_dynamics else None
        # What the model has now, and what the renderer was told of.
        self._applied: Variation | None = None
        self._uploaded: Variation | None = None
        self._augmenter: tuple[Attempt, PictureAugmenter] | None = None

    def of(self, attempt: Attempt) -> CompiledScene:
        """The scene as it is in an attempt, until another one is asked for."""
        if self._varied and attempt.variation is not self._applied:
            self._varied.apply(attempt.variation)
            if self._arms:
                self._scene = self._arms.apply(attempt.variation.arm_dynamics)
            self._applied = attempt.variation
        return self._scene

    def upload(self, renderer: SceneRenderer) -> None:
        """Tell the renderer what it keeps a copy of, as the scene has it now; before anything is rendered."""
        if self._varied and self._uploaded is not self._applied:
            for texture in self._varied.textures:
                renderer.upload_texture(texture)
            self._uploaded = self._applied

    def finish(self, attempt: Attempt, image: Image, frame: int, camera: int) -> None:
        """Change an attempt's picture (height, width, 3) in place, as its camera and cable would.

        Args:
            frame, camera: their numbers, from which all that is random about one picture follows.
        """
        ranges = self._config.randomization.picture
        if ranges is None:
            return
        if self._augmenter is None or self._augmenter[0] is not attempt:
            size = self._config.image.size_px
            self._augmenter = attempt, PictureAugmenter(ranges, attempt.variation, attempt.job, size)
        self._augmenter[1].apply(image, frame, camera)
