"""Adapter for policies of other programs. A config describes names, units and order of values in messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..core.config.policy import PictureMapping, PolicyConfig
from ..core.dataset.environment_state import joints_key, make_state_row
from ..core.errors import UsageError, suggest_similar
from ..core.geometry.se3 import Array, invert_pose
from ..core.images.resize import resize_image
from .policy_client import action_period, action_rows
from .policy_protocol import OBJECTS, InvalidActionError, Observation


class PolicyClient(Protocol):
    """Client of a policy server, or of a checkpoint in this process."""

    def begin_trial(self, seed: int) -> None:
        """Prepare for a new trial. `seed` seeds the policy's random numbers, if any."""

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the answer to a message of text, numbers, arrays, and mappings of these."""

    def close(self) -> None:
        """Close the connection, if any."""


@dataclass(frozen=True)
class PolicyScene:
    """Arms, cameras and objects of the scene in which a policy acts.

    Attributes:
        sides: in the order of observations and actions.
        drives: of each arm; the gripper is the last.
        openings: opening of one finger of each fully open gripper, m; 0 without fingers.
        cameras: name that a policy requests -> key of the image in observations.
        things: name of an object -> key of its pose in observations, in the order of LeRobot's environment state.
        T_base_in_world: pose (4, 4) of the base to which the poses of a dataset refer.
    """

    rig: str
    sides: tuple[str, ...]
    drives: int
    openings: tuple[float, ...]
    cameras: Mapping[str, str]
    things: Mapping[str, str] = field(default_factory=dict)
    T_base_in_world: Array = field(default_factory=lambda: np.eye(4))


class MappedPolicy:
    """Converts observations to a client's messages, and the client's answers to actions.

    Attributes:
        wants: `objects` if the messages contain poses of objects.
        execute: default of executed actions of a chunk before the next inference; None for all.
        lead: for real-time chunking: remaining actions at which the next inference is requested; None without it.

    Args:
        wanted: keys of the config whose values the client needs; None for all.

    Raises:
        UsageError: the config does not fit the station.
    """

    def __init__(
        self, client: PolicyClient, config: PolicyConfig, station: PolicyScene, wanted: Sequence[str] | None = None
    ) -> None:
        self._client, self._config, self._station = client, config, station
        self.execute: int | None = getattr(client, "execute", None)
        chunking = config.realtime_chunking
        self.lead = None if chunking is None else chunking.lead
        self._plan_end: Array | None = None  # last planned actions, as the client sent them
        sides = station.sides if config.arms == "all" else config.arms
        if missing := [side for side in sides if side not in station.sides]:
            raise self._mapping_error("arms", f"there is no {missing[0]} arm; valid: {', '.join(station.sides)}")
        if unused := [side for side in station.sides if side not in sides]:
            raise self._mapping_error("arms", f"no output drives the {unused[0]} arm")
        # Indices that reorder arms from the station to the client, and back.
        self._to_client = [station.sides.index(side) for side in sides]
        self._to_station = [sides.index(side) for side in station.sides]
        self._scale = np.ones((len(sides), station.drives))
        if config.gripper == "share":
            if not all(station.openings):
                raise self._mapping_error("gripper", "an arm has no gripper, so openings cannot be shares")
            self._scale[:, -1] = station.openings
        self._pictures = {
            key: (picture, station.cameras[camera])
            for key, picture in config.images.items()
            if (wanted is None or key in wanted) and (camera := self._find_camera(key, picture, wanted)) is not None
        }
        rows = [row.key for row in (config.state, config.environment_state) if row is not None]
        known = (*config.images, *rows)
        if lacking := [key for key in wanted or () if key not in known]:
            raise self._mapping_error(
                "images", f"the policy asks for {lacking[0]!r}; {suggest_similar(lacking[0], known)}"
            )
        things = config.environment_state
        self._has_things = things is not None and (wanted is None or things.key in wanted)
        self.wants = (OBJECTS,) if self._has_things else ()
        shown = {picture for _, picture in self._pictures.values()}
        self.images = tuple(name for name, key in station.cameras.items() if key in shown)
        self._seed = 0

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._seed, self._plan_end = seed, None
        self._client.begin_trial(seed)

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Return the client's actions, as a policy of yamsim does."""
        return self._read_actions(self._client.infer(self.make_message(observation)))

    def make_message(self, observation: Observation) -> dict[str, Any]:
        """Convert an observation to the client's message."""
        config = self._config
        message: dict[str, Any] = dict(config.constants)
        row = (np.asarray(observation["joints"]).reshape(self._scale.shape) / self._scale)[self._to_client]
        if config.gripper == "share":
            row[:, -1] = np.clip(row[:, -1], 0.0, 1.0)
        if config.state is not None:
            message[config.state.key] = row.ravel().astype(config.state.dtype)
        if (chunking := config.realtime_chunking) is not None:
            prefix = self._plan_end
            if prefix is None:
                welds = np.zeros(len(row) if config.actions.weld else 0)
                prefix = np.tile(np.append(row, welds), (chunking.length, 1))
            message |= {chunking.prefix_key: prefix.astype(np.float32), chunking.length_key: chunking.length}
        if config.environment_state is not None and self._has_things:
            message[config.environment_state.key] = self._object_poses(observation).astype(
                config.environment_state.dtype
            )
        pictures = {key: _prepare_picture(how, observation[name]) for key, (how, name) in self._pictures.items()}
        message |= {config.images_under: pictures} if config.images_under else pictures
        for key, value in (
            (config.prompt, observation["prompt"]),
            (config.time, float(observation["time"])),
            (config.seed, self._seed),
        ):
            if key is not None:
                message[key] = value
        return message

    def close(self) -> None:
        """Close the client."""
        self._client.close()

    def _read_actions(self, answer: Mapping[str, Any]) -> Mapping[str, Any]:
        actions = self._config.actions
        if actions.key not in answer:
            raise InvalidActionError(
                f"the answer has no {actions.key!r}; its keys are {', '.join(map(str, answer))[:200]}"
            )
        arms, drives = self._scale.shape
        rows = action_rows(answer[actions.key], actions.key, arms * (drives + actions.weld))
        if (chunking := self._config.realtime_chunking) is not None:
            if len(rows) <= chunking.length:
                raise InvalidActionError(
                    f"{actions.key} has {len(rows)} actions; realtime_chunking needs more than {chunking.length}, "
                    f"because the first {chunking.length} repeat the end of the previous answer"
                )
            rows = rows[chunking.length : chunking.length + chunking.execute]
            self._plan_end = rows[-chunking.length :]
        ctrl: Array = rows[:, : arms * drives].reshape(-1, arms, drives)[:, self._to_station] * self._scale
        period = (
            action_period(answer.get(actions.period_ms_key), actions.period_ms_key) if actions.period_ms_key else None
        )
        found: dict[str, Any] = {"ctrl": ctrl.reshape(len(rows), -1), "period": period or 1 / actions.hz}
        if actions.weld:
            found["magnet"] = rows[:, arms * drives :][:, self._to_station] >= 0.5
        if actions.done_key is not None:
            found["done"] = answer.get(actions.done_key, False)
        return found

    def _object_poses(self, observation: Observation) -> Array:
        """Return all objects' poses in the base, and joint positions, in the order of LeRobot exports."""
        T_world_in_base = invert_pose(self._station.T_base_in_world)
        return make_state_row(
            [
                (T_world_in_base @ observation[key], observation.get(joints_key(thing), ()))
                for thing, key in self._station.things.items()
            ]
        )

    def _find_camera(self, key: str, picture: PictureMapping, wanted: Sequence[str] | None) -> str | None:
        found = next((name for name in picture.cameras if name in self._station.cameras), None)
        if found is None and (wanted is not None or not picture.optional):
            there = ", ".join(self._station.cameras)
            raise self._mapping_error(
                f"images.{key}", f"there is no camera {' or '.join(picture.cameras)}; valid: {there}"
            )
        return found

    def _mapping_error(self, key: str, problem: str) -> UsageError:
        return UsageError(f"--policy-config {self._config.name}: {key}: on rig {self._station.rig!r} {problem}")


def _prepare_picture(how: PictureMapping, image: np.ndarray) -> np.ndarray:
    shown = image if how.size_px is None else resize_image(image, how.size_px, pad=how.fit == "pad")
    return np.ascontiguousarray(shown.transpose(2, 0, 1)) if how.layout == "channels" else shown
