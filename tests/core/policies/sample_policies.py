"""Policies as users write them: good, bad and slow ones."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

HOME = np.array([0, 1.92, 2.22, -1.55, 0, 0, 0.0375])


class Still:
    """Stays at the start, blind."""

    images = ()

    def reset(self) -> None:
        pass

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": HOME}


class Seeing(Still):
    """Wants the wrist camera alone, and tells what it saw by where it goes."""

    images = ("wrist",)

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        assert "scene_rgb" not in observation
        assert observation["wrist_rgb"].dtype == np.uint8
        return {"ctrl": HOME, "done": observation["wrist_rgb"].std() > 5}


class Faulty(Still):
    """Every third trial goes wrong in another way; which, it tells by its seed."""

    def reset(self, seed: int) -> None:  # type: ignore[override]
        self.seed, self.calls = seed % 5, 0

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        self.calls += 1
        print("this must not get into the report")
        if self.calls == 4:
            if self.seed == 0:
                raise KeyError("no such thing")
            if self.seed == 1:
                return {"ctrl": np.full(7, np.nan)}
            if self.seed == 2:
                return {"ctrl": np.zeros(6)}
            if self.seed == 3:
                time.sleep(30)
        return {"ctrl": HOME, "magnet": True, "done": self.calls == 6}


class Suicidal(Still):
    """Ends its process in the second trial, whoever asks."""

    def reset(self, seed: int) -> None:  # type: ignore[override]
        self.seed = seed

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.seed == 1:
            os._exit(3)
        return {"ctrl": HOME, "done": True}


class Random(Still):
    """Trembles, by its seed alone."""

    def reset(self, seed: int) -> None:  # type: ignore[override]
        self.rng = np.random.default_rng(seed)

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": HOME + self.rng.normal(0, 0.01, 7), "magnet": np.bool_(False)}


class NoReset:
    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {}


class AsksTooMuch(Still):
    images = ("scene", "floor")  # type: ignore[assignment]
