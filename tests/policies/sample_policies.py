"""Policies as users write them: good, bad and slow ones."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

HOME = np.array([0, 1.92, 2.22, -1.55, 0, 0, 0.0375])
# The arm rotated about its base, the fingers half closed.
ASIDE = np.array([0.5, 1.92, 2.22, -1.55, 0, 0, 0.0175])


class Still:
    """Stays at the start, without images."""

    images = ()

    def reset(self) -> None:
        pass

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": HOME}


class Seeing(Still):
    """Requests the wrist camera alone, and encodes the picture in its action."""

    images = ("wrist",)

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        assert "scene_rgb" not in observation
        assert observation["wrist_rgb"].dtype == np.uint8
        return {"ctrl": HOME, "done": observation["wrist_rgb"].std() > 5}


class Faulty(Still):
    """Every third trial has a fault, which the seed selects."""

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
    """Ends its process in the second trial."""

    def reset(self, seed: int) -> None:  # type: ignore[override]
        self.seed = seed

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.seed == 1:
            os._exit(3)
        return {"ctrl": HOME, "done": True}


class Random(Still):
    """Random motion that depends on its seed alone."""

    def reset(self, seed: int) -> None:  # type: ignore[override]
        self.rng = np.random.default_rng(seed)

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": HOME + self.rng.normal(0, 0.01, 7), "magnet": np.bool_(False)}


class Loaded(Random):
    """Acts as `Random` on a machine under load: its answers take unequal times."""

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        time.sleep(0.02 * (int(observation["time"] / 0.032) % 7 == 0))
        return super().__call__(observation)


class NoReset:
    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {}


class AsksWrongly(Still):
    images = "scene"  # type: ignore[assignment]


class WantsTooMuch(Still):
    wants = ("object",)


class Forker(Still):
    """Leaves a fork of its process in every trial, which goes on as if it were the original; counts its calls."""

    def reset(self) -> None:
        self.calls = 0

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        self.calls += 1
        if self.calls == 2 and os.fork() == 0:
            # In case it survives.
            signal.alarm(20)
        return {"ctrl": HOME, "done": self.calls == 3}


class Blind(Still):
    """Could render, and does not."""

    images = ("scene", "wrist")  # type: ignore[assignment]


class Knowing(Still):
    """Requests object poses and joint velocities, and keeps its observations."""

    wants = ("objects", "velocities")
    seen: ClassVar[list[Mapping[str, Any]]] = []

    def reset(self) -> None:
        self.seen.clear()

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        self.seen.append(observation)
        arms = len(observation["joints"]) // 7
        return {"ctrl": np.tile(ASIDE, arms), "done": len(self.seen) == 12}


class Remembering(Still):
    """Reads a picture only when the next one exists."""

    images = ("scene",)  # type: ignore[assignment]
    seen: ClassVar[list[Mapping[str, Any]]] = []

    def reset(self) -> None:
        self.seen.clear()

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        self.seen.append(observation)
        if len(self.seen) == 9:
            assert self.seen[0]["scene_rgb"].std() > 5
        return {"ctrl": ASIDE, "done": len(self.seen) == 9}


class Swallows(Still):
    """Ignores all exceptions of reading."""

    images = ("scene",)  # type: ignore[assignment]

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        with contextlib.suppress(Exception):
            observation["scene_rgb"]
        return {"ctrl": HOME, "done": True}


class OnGpu:
    """A tensor that cannot become an array."""

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


class Unsendable(Still):
    """Answers with unsendable values, which the time selects."""

    ANSWERS: ClassVar[list[Any]] = [
        {"ctrl": object()},
        {"ctrl": OnGpu()},
        {"ctrl": [0.0] * 6 + [None]},
        {"ctrl": np.array([object()])},
        {"ctrl": HOME, "done": 1 << 80},
        {"ctrl": HOME, 7: 1},
        HOME,
    ]

    def __call__(self, observation: Mapping[str, Any]) -> Any:
        return (*self.ANSWERS, {"ctrl": HOME})[int(observation["time"])]


class Chunked(Still):
    """Answers with a chunk of actions, each of two control ticks, that rotate the arm's base further and further."""

    def __init__(self, actions: int = 10, step: float = 0.01) -> None:
        self._actions, self.step = actions, step

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        rows = np.tile(HOME, (self._actions, 1))
        rows[:, 0] = observation["joints"][0] + self.step * np.arange(1, self._actions + 1)
        return {"ctrl": rows, "period": 0.064}
