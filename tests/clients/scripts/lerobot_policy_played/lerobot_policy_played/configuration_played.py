from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs.policies import PreTrainedConfig


@PreTrainedConfig.register_subclass("played")
@dataclass
class PlayedConfig(PreTrainedConfig):
    """Numbers of trials and frames in the weights, and width of an action."""

    trials: int = 1
    frames: int = 1
    numbers: int = 1
    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None

    def get_optimizer_preset(self) -> None:
        raise NotImplementedError("it is not trained")

    def get_scheduler_preset(self) -> None:
        raise NotImplementedError("it is not trained")

    def validate_features(self) -> None:
        """Whatever it is shown."""
