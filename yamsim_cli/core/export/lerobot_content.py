"""What an export to LeRobot's format holds of each frame beside its pictures, of simulated and of real episodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..dataset.lowdim import ACTION, BETWEEN_BASES, STATE
from ..dataset.reader import RecordedEpisode, StoredEpisode
from ..dataset.real import RealRecord
from ..errors import DatasetError
from ..policies.environment_state import joints_key, object_pose_keys, state_names, state_row
from . import lerobot_schema as schema
from .lerobot_options import LeRobotOptions, RealOptions
from .lerobot_schema import Feature
from .real_source import RealEpisode, RealSource, actions_of
from .source import Source

Frames = Sequence[Mapping[str, Any]]

_APART = "unlike the first one: export them apart, see --episodes"


class Content(Protocol):
    """What an export holds.

    Attributes:
        pictures: whether it has videos.
        notes: for a person, after the last episode: where it is not what was recorded.
    """

    pictures: bool
    notes: list[str]

    def columns(self) -> dict[str, Feature]:
        """The features in the Parquet files, except the images and what the format itself adds."""

    def values(self, episode: Any, frames: Frames) -> dict[str, NDArray[Any]]:
        """An episode's values (frames, ...) by feature.

        Raises:
            DatasetError: it holds other things than the first one.
        """

    def origin(self, episode: Any) -> dict[str, Any]:
        """Where an episode is from."""

    def about(self) -> dict[str, Any]:
        """What else is told of the whole dataset."""


class SimulatedContent:
    """Joints, what drives and welds are told, and where things are; see `Content`."""

    def __init__(self, source: Source, options: LeRobotOptions) -> None:
        self.pictures = options.pictures
        self.notes: list[str] = []
        self._source = source
        self._things = tuple(object_pose_keys(source.config)) if options.environment_state else ()
        self._bases: dict[str, Any] = {}

    def columns(self) -> dict[str, Feature]:
        """The features. An action has all drives, then all welds."""
        source = self._source
        features = {
            schema.STATE: schema.rows(source.drives),
            schema.ACTION: schema.rows((*source.drives, *source.welds)),
        }
        if self._things:
            told = state_names(self._things, source.first.record.joints)
            features[schema.ENVIRONMENT_STATE] = schema.rows(told)
        return features | (schema.matrices(source.cameras, source.cameras) if self.pictures else {})

    def values(self, episode: StoredEpisode, frames: Frames) -> dict[str, NDArray[Any]]:
        """An episode's values.

        Raises:
            DatasetError: of its things, other parts move than of the first episode's.
        """
        mine, first = episode.record.joints, self._source.first
        if self._things and mine != first.record.joints:
            raise DatasetError(
                f"{episode.directory} has things with other joints than {first.directory.name} ({mine}, not "
                f"{first.record.joints}): export them apart, see --episodes, or without --environment-state"
            )
        if BETWEEN_BASES in frames[0]:
            self._bases = {BETWEEN_BASES: frames[0][BETWEEN_BASES].tolist()}
        states, commands = zip(*(_state_and_action(frame) for frame in frames), strict=True)
        values = {schema.STATE: np.array(states), schema.ACTION: np.array(commands)}
        if self._things:
            values[schema.ENVIRONMENT_STATE] = np.array([_things_row(frame, self._things) for frame in frames])
        return values | (_matrices(self._source.cameras, self._source.cameras, frames) if self.pictures else {})

    def origin(self, episode: StoredEpisode) -> dict[str, Any]:
        """From which numbers an episode can be made again."""
        return {"seed": episode.record.seed, "attempt": episode.record.attempt}

    def about(self) -> dict[str, Any]:
        """Where the right arm stands."""
        return self._bases


class RealContent:
    """What was measured and commanded, at which times, and what is known of the cameras; see `Content`.

    Grippers are shares of their opening, as the public sets of real stations have them.

    Raises:
        DatasetError: the first episode is damaged.
    """

    def __init__(self, source: RealSource, options: RealOptions) -> None:
        self.pictures = options.pictures
        self.notes: list[str] = []
        self._source, self._actions = source, options.actions
        frame = source.first.frames()[0]
        self._velocities = "joint_velocities" in frame
        self._lenses = tuple(frame.get("intrinsics", ())) if self.pictures else ()
        self._places = tuple(frame.get("extrinsics", ())) if self.pictures else ()

    def columns(self) -> dict[str, Feature]:
        """The features: those that were recorded, and an action unless nobody wants one."""
        source = self._source
        features = {schema.STATE: schema.rows(source.drives)}
        if self._actions != "none":
            features[schema.ACTION] = schema.rows(source.drives)
        features[schema.RECORDED_TIME] = Feature("float64", (1,))
        if self._velocities:
            features[schema.VELOCITIES] = schema.rows(self._joints())
        return features | schema.matrices(self._lenses, self._places)

    def values(self, episode: RealEpisode, frames: Frames) -> dict[str, NDArray[Any]]:
        """An episode's values.

        Raises:
            DatasetError: nobody recorded its commands, its velocities or the places of its cameras.
        """
        source, n = self._source, len(frames)
        values: dict[str, NDArray[Any]] = {schema.STATE: _flat(source.shares([frame["joints"] for frame in frames]))}
        if self._actions != "none":
            values[schema.ACTION] = _flat(actions_of(source, episode, frames, self._actions))
        values[schema.RECORDED_TIME] = np.array([frame["timestamp"] for frame in frames])
        if self._velocities:
            values[schema.VELOCITIES] = np.reshape(_each(episode, frames, "joint_velocities"), (n, -1))
        for key, cameras in (("intrinsics", self._lenses), ("extrinsics", self._places)):
            for camera in cameras:
                if not all(camera in held for held in _each(episode, frames, key)):
                    raise DatasetError(f"{episode.directory} has no {key} of {camera}, {_APART}")
        values |= _matrices(self._lenses, self._places, frames)
        if (note := source.unevenness(episode, frames)) is not None:
            self.notes.append(f"{note}, and {schema.RECORDED_TIME} the recorded times")
        return values

    def origin(self, episode: RealEpisode) -> dict[str, Any]:
        """From which file an episode was imported."""
        record: RealRecord = episode.record
        return {"imported": record.imported.model_dump()}

    def about(self) -> dict[str, Any]:
        """What actions are, and the grippers' unit."""
        source: dict[str, Any] = {"source": "real", "actions": self._actions, "gripper": "share"}
        return source

    def _joints(self) -> list[str]:
        """Names of the drives without grippers."""
        rig = self._source.rig
        named = zip(self._source.prefixes, rig.recorded, strict=True)
        return [prefix + name for prefix, k in named for name in rig.arms[k].robot.joint_drives]


def _state_and_action(frame: Mapping[str, Any]) -> tuple[Any, Any]:
    """A frame's state, and its action: joints alone where it has those, else what drives and welds are told."""
    if ACTION in frame:
        return frame[STATE], frame[ACTION]
    return frame["joints"], np.append(frame["ctrl"], np.asarray(frame["magnet"], np.float32))


def _things_row(frame: Mapping[str, Any], things: Sequence[str]) -> NDArray[Any]:
    """Where things are in a frame; see `core.policies.environment_state`."""
    return state_row([(frame[f"{thing}_pose"], frame.get(joints_key(thing), ())) for thing in things])


def _matrices(lenses: Iterable[str], places: Iterable[str], frames: Frames) -> dict[str, NDArray[Any]]:
    """The cameras' matrices, row by row."""
    lens = {
        schema.intrinsics_key(camera): [np.ravel(frame["intrinsics"][camera]) for frame in frames] for camera in lenses
    }
    place = {
        schema.extrinsics_key(camera): [np.ravel(frame["extrinsics"][camera]) for frame in frames] for camera in places
    }
    return {key: np.array(rows) for key, rows in (lens | place).items()}


def _each(episode: RecordedEpisode, frames: Frames, key: str) -> list[Any]:
    """What each frame has under a key.

    Raises:
        DatasetError: one has nothing there.
    """
    if not all(key in frame for frame in frames):
        raise DatasetError(f"{episode.directory} has no {key}, {_APART}")
    return [frame[key] for frame in frames]


def _flat(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return rows.reshape(len(rows), -1)
