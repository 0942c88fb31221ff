"""Put what varies of arms into a compiled scene: how late they act, how they are read, how their weight is borne."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..variation import ArmVariation
from .compiled import CompiledScene, SceneArm


class VariedArms:
    """A compiled scene whose arms differ from attempt to attempt. Its model has room for the longest delays.

    Args:
        scene: as it was compiled; its arms say their own delays.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        # It was compiled with the longest.
        self.apply(())

    def apply(self, variations: Sequence[ArmVariation]) -> CompiledScene:
        """The scene with arms that vary so, or with its own where there are no variations; its model is changed."""
        arms, model = self._scene.arms, self._scene.model
        if variations:
            arms = tuple(_varied(arm, one) for arm, one in zip(arms, variations, strict=True))
        for arm in arms:
            model.actuator_delay[arm.drives] = arm.command_delay
            if arm.sensors is not None:
                model.sensor_delay[arm.sensors] = arm.sensor_delay
        return replace(self._scene, arms=arms)


def _varied(arm: SceneArm, by: ArmVariation) -> SceneArm:
    gravity = by.gravity if arm.gravity is None else arm.gravity + by.gravity
    return replace(
        arm,
        gravity=np.array(gravity) if np.any(gravity) else None,
        command_delay=arm.command_delay + by.command_delay_ms / 1000,
        sensor_delay=arm.sensor_delay + by.sensor_delay_ms / 1000,
        sensor_noise=arm.sensor_noise + by.sensor_noise_rad,
        encoder_step=arm.encoder_step + by.encoder_step_rad,
    )
