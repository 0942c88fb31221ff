"""A simulated station for programs that control real stations: states, commands and pictures of each frame.

    from yamsim_cli.station import Station, StationSettings

    with Station(StationSettings(task="pickplace", grasp="contact", action="joints", fps=30)) as station:
        station.begin(seed=0, trial=3)
        station.command(station.state())
        station.advance()
        pictures = station.pictures()

The numbers of a row and the cameras have the names and units of `yamsim export lerobot`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from .core.closable import Closable
from .core.config.session import Session
from .core.errors import SimulationError, UsageError
from .station_settings import StationForm, StationSettings

if TYPE_CHECKING:
    from .core.geometry.se3 import Array
    from .core.images.image import Image

__all__ = ["Station", "StationForm", "StationSettings"]

Row = NDArray[np.float32]


class Station(Closable):
    """The simulated arms of a rig, with the objects of a task. Close the station, or use it as a context manager.

    Only `advance` and `tick` step the simulation. Until the first command, the arms hold their start posture.

    Attributes:
        form: names and shapes of states, commands and pictures.

    Args:
        pictures: without, OpenGL is not set up.
        end: "success" ends a trial once its goal has held for its hold time; with "actor" only the caller ends a trial.

    Raises:
        ConfigError, UsageError: a setting is not valid.
        ResourceError: nothing can be rendered here.
    """

    def __init__(
        self, settings: StationSettings, *, pictures: bool = True, end: Literal["success", "actor"] = "success"
    ) -> None:
        from .core.dataset.row_format import RowFormat
        from .core.episode.episode_rules import EndRule
        from .policies.evaluate.stepped_task import SteppedTask

        opener = settings.opener
        if pictures:
            session = opener.open(settings.config, parallel=False, **settings.given)
        else:
            where = opener.find_locations()
            session = Session(opener.load_record_config(settings.config, where, **settings.given), where)
        config = session.config
        self.form = StationForm.of_config(config)
        self._timing = config.task.timing
        self._rows, self._task = RowFormat.from_config(config), SteppedTask(session, EndRule(end))
        self._command: Row = np.zeros(len(self.form.action), np.float32)

    @property
    def trial(self) -> int:
        """Number of the present trial."""
        return self._task.attempt.job.attempt

    @property
    def time(self) -> float:
        """Simulated time since the start of the trial, s."""
        return self._task.episode.simulated_seconds

    @property
    def prompt(self) -> str:
        """The instruction of the trial, in words."""
        return self._task.attempt.phrasing or self.form.prompt

    @property
    def tick_s(self) -> float:
        """Duration of a control tick, s. A frame has one or more ticks."""
        return self._timing.tick_seconds

    def begin(self, seed: int = 0, trial: int = 0) -> int:
        """Reset the scene to the start of a trial, as in `yamsim trials --seed SEED`.

        Returns:
            The number of the trial. Trials without a valid start are skipped.

        Raises:
            SimulationError: no trial within a limit has a valid start.
        """
        from .core.attempt_data import AttemptJob

        self._task.begin_trial(AttemptJob(seed, trial))
        self._hold_joints()
        return self.trial

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Reset the scene to the start of an episode, as in `yamsim record --seed SEED`. Skip trials that fail.

        Returns:
            The commands of the expert planner (frames, numbers), one row per frame, with the names in `form.action`.

        Raises:
            SimulationError: the expert succeeds in no trial within a limit.
        """
        from .core.attempt_data import AttemptJob

        actions = self._task.begin_demonstrated(AttemptJob(seed, trial))
        self._hold_joints()
        drives = self._task.simulator.scene.recorded_drive_ctrl
        first = range(0, len(actions.ctrl), self._timing.ticks_per_frame)
        return np.array([self._rows.make_action_row(actions.ctrl[k][drives], actions.magnet[k]) for k in first])

    def state(self) -> Row:
        """Return the present joints and grippers, with encoder errors, as one number per name in `form.state`."""
        return self._rows.make_state_row(self._task.episode.simulated_encoder_readings(self._task.attempt.job))

    def environment(self) -> Row:
        """Return the object poses in the base of the left or only arm, one number per name in `form.environment`.

        Each object has its position (m), the first two axes of its frame, and the joints (m, rad) of its moving parts.

        Raises:
            SimulationError: the objects of this trial have other joints than the typical objects of the task.
        """
        from .core.dataset.environment_state import make_state_row, object_pose_keys

        simulator = self._task.simulator
        replica, config = simulator.state_replay, simulator.config
        replica.set_state(self._task.episode.data.qpos)
        moving = {item.name: item for item in config.task.objects if item.links}
        row = make_state_row(
            [
                (replica.T_object_in_base(name), replica.object_joints(moving[name]) if name in moving else ())
                for name in object_pose_keys(config)
            ]
        )
        if len(row) != len(self.form.environment):
            raise SimulationError(
                f"task {config.task.name!r}: trial {self.trial} has objects with other joints than usual, so its "
                f"environment state has {len(row)} numbers, not {len(self.form.environment)}"
            )
        return row.astype(np.float32)

    def command(self, row: NDArray[np.floating] | Sequence[float]) -> None:
        """Set the command, a row with the names in `form.action`, which acts until the next command.

        Raises:
            UsageError: the row does not have one finite number for each name in `form.action`.
        """
        values = np.asarray(row, dtype=np.float32)
        if values.shape != (len(self.form.action),) or not np.isfinite(values).all():
            raise UsageError(f"a command is {len(self.form.action)} finite numbers, not {values.shape} {values}")
        self._command = values

    def advance(self) -> bool:
        """Simulate one frame, and return whether the trial is successful. Time stops when the trial ends."""
        for _ in range(self._timing.ticks_per_frame):
            self.tick()
        return self._task.trial.is_successful

    def tick(self) -> None:
        """Simulate one control tick, unless the trial has ended."""
        self._task.episode.step(*self._rows.split_action_row(self._command))

    def judge(self) -> str:
        """Return why the trial is not successful at present; "" on success."""
        return self._task.trial.failure_reason()

    def positions(self) -> Array:
        """Return the present `qpos` (nq,), from which `pictures` can render later."""
        positions: Array = self._task.episode.data.qpos.copy()
        return positions

    def pictures(
        self, cameras: Sequence[str] | None = None, positions: NDArray[np.float64] | None = None
    ) -> dict[str, Image]:
        """Return camera -> RGB picture (height, width, 3).

        Args:
            positions: `qpos` (nq,) of a state in this trial; by default the present one.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        return self._task.trial.render(tuple(self.form.cameras) if cameras is None else cameras, positions)

    def close(self) -> None:
        """Free the renderers."""
        self._task.close()

    def _hold_joints(self) -> None:
        """Set the present joints, without encoder errors, as the command."""
        replica = self._task.simulator.state_replay
        replica.set_state(self._task.episode.data.qpos)
        self._command = self._rows.make_action_row(replica.joint_positions(), np.zeros(self._rows.arms, bool))
