from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.config.policy import PolicyConfig
from ..core.errors import ResourceError, UsageError
from ..core.images.resize import resize_image

SCHEME = "lerobot"

_INSTALL_ADVICE = (
    "LeRobot is not installed: run `pip install 'lerobot>=0.4'` in an environment with yamsim and Python 3.12"
)


def check_rows(message: Mapping[str, Any], expected: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse vectors whose lengths differ from those in training.

    Args:
        expected: key of a vector -> shape of the checkpoint's input.
    """
    for key, shape in expected.items():
        if key in message and (found := np.shape(message[key])) != shape:
            raise UsageError(
                f"{key} has {found[-1]} numbers here, and {shape[-1]} in the training data of the policy: "
                "give the --task and --rig of its demonstrations"
            )


class LeRobotClient:
    """Loads a policy that LeRobot trained, and computes its actions in this process.

    A policy of one observation answers with an action chunk, and a policy of several with one action.

    Attributes:
        execute: executed actions of a chunk before the next inference; None for all.

    Args:
        checkpoint: a folder with `config.json`, weights and processors, or a repository on the hub.
    """

    def __init__(self, checkpoint: str, mapping: PolicyConfig) -> None:
        self._key = mapping.actions.key
        try:
            import torch
            from lerobot.configs.policies import PreTrainedConfig
            from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in ("lerobot", "torch"):
                raise
            raise ResourceError(f"--policy {SCHEME}:{checkpoint}: {_INSTALL_ADVICE}") from error
        self._torch = torch
        try:
            config = PreTrainedConfig.from_pretrained(checkpoint)
            if not torch.cuda.is_available():
                config.device = "cpu"
            self._policy = get_policy_class(config.type).from_pretrained(checkpoint, config=config)
            device = {"device_processor": {"device": str(config.device)}}
            self._before, self._after = make_pre_post_processors(
                config, pretrained_path=checkpoint, preprocessor_overrides=device
            )
        # LeRobot's code for a kind of policy may raise any exception.
        except Exception as error:
            text = " ".join(str(error).split())[:300]
            raise UsageError(f"--policy {SCHEME}:{checkpoint}: it cannot be loaded: {text}") from error
        self._policy.eval()
        shapes = {key: tuple(feature.shape) for key, feature in config.image_features.items()}
        self._sizes = {key: (shape[2], shape[1]) for key, shape in shapes.items()}
        self.input_keys = tuple(config.input_features)
        self._rows = {key: tuple(one.shape) for key, one in config.input_features.items() if key not in shapes}
        # Only LeRobot's select_action fills a policy's queues of earlier observations.
        kept = set(getattr(self._policy, "_queues", ())) - {"action"}
        self._needs_history = getattr(config, "n_obs_steps", 1) > 1 or bool(kept)
        self.execute: int | None = None if self._needs_history else getattr(config, "n_action_steps", None)

    def begin_trial(self, seed: int) -> None:
        """Seed torch and reset the policy."""
        self._torch.manual_seed(seed)
        self._policy.reset()

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the policy's actions, after its postprocessor."""
        check_rows(message, self._rows)
        torch = self._torch
        batch: dict[str, Any] = {}
        for key, value in message.items():
            if key in self._sizes:
                image = resize_image(value, self._sizes[key], pad=False).transpose(2, 0, 1)
                batch[key] = torch.from_numpy(image.astype(np.float32) / 255)[None]
            else:
                batch[key] = torch.from_numpy(value)[None] if isinstance(value, np.ndarray) else value
        with torch.inference_mode():
            ready = self._before(batch)
            infer = self._policy.select_action if self._needs_history else self._policy.predict_action_chunk
            actions = self._after(infer(ready))
        rows = actions.to("cpu", torch.float64).numpy()
        # A chunk is (1, actions, numbers) and an action (1, numbers): the first axis is the batch.
        return {self._key: rows[0]}

    def close(self) -> None:
        """Do nothing: no connection is open."""
