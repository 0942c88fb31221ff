"""How one attempt differs from the next beside its layout: drawn from its numbers, or taken from its record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..images.image import Image
from ..randomized import Randomized
from ..scene.build import SCENE_CAMERA
from ..scene.compiled import CompiledScene
from ..scene.randomize import SceneRandomizer
from ..sim.placement import place_distractors
from ..tasks.randomization import draw
from ..types import EpisodeJob
from ..vision.augment import PictureAugmenter
from ..vision.renderer import SceneRenderer


class Variation:
    """What is randomized in a scene now; without any randomization it changes nothing.

    Attributes:
        drawn: what the scene was last given.
    """

    def __init__(self, config: RecordConfig, scene: CompiledScene) -> None:
        self._config = config
        self._scene = scene
        self._randomizer: SceneRandomizer | None = None
        if config.randomization.parts:
            self._randomizer = SceneRandomizer(scene.model, config.randomization, config.scene, SCENE_CAMERA)
        self._augmenter: PictureAugmenter | None = None
        self._shown = True
        self.drawn = Randomized()

    def begin(self, job: EpisodeJob) -> None:
        """Draw for an attempt; distractors come later."""
        if self._randomizer:
            task = self._config.task
            objects = (task.object, task.target)
            self.apply(job, draw(self._config.randomization, job, len(self._config.scene.lights), objects))

    def apply(self, job: EpisodeJob, drawn: Randomized) -> None:
        """Give the scene what was drawn for an attempt, then or now."""
        self.drawn = drawn
        if not self._randomizer:
            return
        self._randomizer.apply(drawn)
        self._shown = False
        picture = self._config.randomization.picture
        size = self._config.image.size_px
        self._augmenter = PictureAugmenter(picture, drawn, job, size) if picture else None

    def place(self, job: EpisodeJob, states: Sequence[Array]) -> None:
        """Put distractors where they are clear of everything at all of MuJoCo's positions (nq,) of an attempt."""
        config = self._config.randomization.distractors
        if self._randomizer and config:
            placed = place_distractors(self._scene, self._randomizer, config, self._config.table, job, states)
            self.drawn = replace(self.drawn, distractors=placed)

    def show(self, renderer: SceneRenderer) -> None:
        """Tell the renderer what it keeps a copy of; before anything is drawn."""
        if self._randomizer and not self._shown:
            for texture in self._randomizer.textures:
                renderer.upload_texture(texture)
            self._shown = True

    def finish(self, image: Image, frame: int, camera: int) -> None:
        """Change a picture in place as its camera and cable would."""
        if self._augmenter:
            self._augmenter.apply(image, frame, camera)
