"""A policy from elsewhere as one of ours: what it calls things, its units and its order, by a config."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..config.policy import PictureMapping, PolicyConfig
from ..errors import UsageError, suggest
from ..geometry.se3 import Array, inverse
from ..images.fit import fitted
from .base import OBJECTS, InvalidActionError, Observation
from .bounds import period_of, rows_of
from .environment_state import joints_key, state_row


class Client(Protocol):
    """Whoever answers: a server by its protocol, or a checkpoint in this process."""

    def begin(self, seed: int) -> None:
        """A trial of this seed begins."""
        ...

    def ask(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """The answer to a message: text, numbers, arrays, and mappings of them."""
        ...

    def close(self) -> None:
        """Nothing is asked any more."""
        ...


@dataclass(frozen=True)
class Station:
    """What a policy finds.

    Attributes:
        rig: its name, for messages.
        sides: of the arms, in the order of observations and actions.
        drives: how many each arm has, its gripper last.
        openings: how far one finger of each arm opens in use, m; 0 without fingers.
        cameras: name that a policy asks for -> key of the picture in observations.
        things: name -> key of its pose in observations, in the order of a row.
        T_base_in_world: pose (4, 4) of the base in which a dataset's poses are.
    """

    rig: str
    sides: tuple[str, ...]
    drives: int
    openings: tuple[float, ...]
    cameras: Mapping[str, str]
    things: Mapping[str, str] = field(default_factory=dict)
    T_base_in_world: Array = field(default_factory=lambda: np.eye(4))


class MappedPolicy:
    """Asks a client in its own words, and understands its answers.

    Attributes:
        images: the cameras that it is shown.
        wants: what it is told besides, see `base.STATE`.
        execute: after how many actions of a chunk it is asked again, where nobody says otherwise; None for all.

    Args:
        wanted: keys of what the client asks for, of those in the config; None for all.

    Raises:
        UsageError: the config does not fit the station.
    """

    def __init__(
        self, client: Client, config: PolicyConfig, station: Station, wanted: Sequence[str] | None = None
    ) -> None:
        self._client, self._config, self._station = client, config, station
        self.execute: int | None = getattr(client, "execute", None)
        sides = station.sides if config.arms == "all" else config.arms
        if missing := [side for side in sides if side not in station.sides]:
            raise self._unfit("arms", f"there is no {missing[0]} arm; there is {' and '.join(station.sides)}")
        if unused := [side for side in station.sides if side not in sides]:
            raise self._unfit("arms", f"nobody drives the {unused[0]} arm")
        # Where each of its arms is in ours, and each of ours in its.
        self._theirs = [station.sides.index(side) for side in sides]
        self._ours = [sides.index(side) for side in station.sides]
        self._scale = np.ones((len(sides), station.drives))
        if config.gripper == "share":
            if not all(station.openings):
                raise self._unfit("gripper", "an arm has no fingers, so there are no shares")
            self._scale[:, -1] = station.openings
        self._pictures = {
            key: (picture, station.cameras[camera])
            for key, picture in config.images.items()
            if (wanted is None or key in wanted) and (camera := self._camera(key, picture, wanted)) is not None
        }
        rows = [row.key for row in (config.state, config.environment_state) if row is not None]
        known = (*config.images, *rows)
        if lacking := [key for key in wanted or () if key not in known]:
            raise self._unfit("images", f"the policy asks for {lacking[0]!r}; {suggest(lacking[0], known)}")
        things = config.environment_state
        self._tells_things = things is not None and (wanted is None or things.key in wanted)
        self.wants = (OBJECTS,) if self._tells_things else ()
        shown = {picture for _, picture in self._pictures.values()}
        self.images = tuple(name for name, key in station.cameras.items() if key in shown)
        self._seed = 0

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._seed = seed
        self._client.begin(seed)

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """The actions that the client answers with, as ours.

        Raises:
            InvalidActionError: they are none.
        """
        return self._understood(self._client.ask(self.message(observation)))

    def message(self, observation: Observation) -> dict[str, Any]:
        """An observation in the client's words."""
        config = self._config
        told: dict[str, Any] = dict(config.constants)
        if config.state is not None:
            row = (np.asarray(observation["joints"]).reshape(self._scale.shape) / self._scale)[self._theirs]
            if config.gripper == "share":
                row[:, -1] = np.clip(row[:, -1], 0.0, 1.0)
            told[config.state.key] = row.ravel().astype(config.state.dtype)
        if config.environment_state is not None and self._tells_things:
            told[config.environment_state.key] = self._things(observation).astype(config.environment_state.dtype)
        pictures = {key: _picture(how, observation[name]) for key, (how, name) in self._pictures.items()}
        told |= {config.images_under: pictures} if config.images_under else pictures
        for key, value in (
            (config.prompt, observation["prompt"]),
            (config.time, float(observation["time"])),
            (config.seed, self._seed),
        ):
            if key is not None:
                told[key] = value
        return told

    def close(self) -> None:
        """Let the client go."""
        self._client.close()

    def _understood(self, answer: Mapping[str, Any]) -> Mapping[str, Any]:
        actions = self._config.actions
        if actions.key not in answer:
            raise InvalidActionError(f"the answer has no {actions.key!r}, but {', '.join(map(str, answer))[:200]}")
        arms, drives = self._scale.shape
        rows = rows_of(answer[actions.key], actions.key, arms * (drives + actions.weld))
        told: Array = rows[:, : arms * drives].reshape(-1, arms, drives)[:, self._ours] * self._scale
        period = period_of(answer.get(actions.period_ms_key), actions.period_ms_key) if actions.period_ms_key else None
        ours: dict[str, Any] = {"ctrl": told.reshape(len(rows), -1), "period": period or 1 / actions.hz}
        if actions.weld:
            ours["magnet"] = rows[:, arms * drives :][:, self._ours] >= 0.5
        if actions.done_key is not None:
            ours["done"] = answer.get(actions.done_key, False)
        return ours

    def _things(self, observation: Observation) -> Array:
        """Where things are in the base, in a row."""
        T_world_in_base = inverse(self._station.T_base_in_world)
        return state_row(
            [
                (T_world_in_base @ observation[key], observation.get(joints_key(thing), ()))
                for thing, key in self._station.things.items()
            ]
        )

    def _camera(self, key: str, picture: PictureMapping, wanted: Sequence[str] | None) -> str | None:
        """The first of a picture's cameras that is there; None for one that is optional and not asked for."""
        found = next((name for name in picture.cameras if name in self._station.cameras), None)
        if found is None and (wanted is not None or not picture.optional):
            there = ", ".join(self._station.cameras)
            raise self._unfit(f"images.{key}", f"there is no camera {' or '.join(picture.cameras)}; there is {there}")
        return found

    def _unfit(self, key: str, problem: str) -> UsageError:
        return UsageError(f"--policy-config {self._config.name}: {key}: on rig {self._station.rig!r} {problem}")


def _picture(how: PictureMapping, image: np.ndarray) -> np.ndarray:
    shown = image if how.size_px is None else fitted(image, how.size_px, pad=how.fit == "pad")
    return np.ascontiguousarray(shown.transpose(2, 0, 1)) if how.layout == "channels" else shown
