from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy

from .configuration_played import PlayedConfig


class PlayedPolicy(PreTrainedPolicy):
    """Plays one trial after the other, several at once if asked; the last action stays."""

    config_class = PlayedConfig
    name = "played"

    def __init__(self, config: PlayedConfig, **_: Any) -> None:
        super().__init__(config)
        self.register_buffer("rows", torch.zeros(config.trials, config.frames, config.numbers))
        self._next, self._frame, self._asked = 0, 0, 0

    def reset(self) -> None:
        self._next, self._frame, self._asked = self._next + self._asked, 0, 0

    def select_action(self, batch: dict[str, Any], **_: Any) -> torch.Tensor:
        self._asked = len(batch["observation.state"])
        frame = min(self._frame, self.config.frames - 1)
        self._frame += 1
        return self.rows[self._next : self._next + self._asked, frame]

    def predict_action_chunk(self, batch: dict[str, Any], **_: Any) -> torch.Tensor:
        return self.select_action(batch)[:, None]

    def forward(self, batch: dict[str, Any]) -> tuple[torch.Tensor, None]:
        raise NotImplementedError("it is not trained")

    def get_optim_params(self) -> dict[str, Any]:
        return {}
