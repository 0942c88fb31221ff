"""A simulated station for programs of real ones: rows of joints, pictures and commands, frame by frame.

    from yamsim_cli.station import Station, StationSettings

    with Station(StationSettings(task="pickplace", grasp="contact", action="joints", fps=30)) as station:
        station.begin(seed=0, trial=3)
        station.command(station.state())
        station.advance()
        pictures = station.pictures()

Rows and cameras have the names and units of `yamsim export lerobot`.
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
    """The simulated arms of a rig with a task's things. Close it, or use it as a context manager.

    Time passes only in `advance` and `tick`. Until the first command, arms hold their start.

    Attributes:
        form: names and shapes of its rows and pictures.

    Args:
        pictures: whether pictures can be rendered; otherwise OpenGL is not set up.
        end: who ends a trial: with "success" the trial ends once its goal has held for its hold time, with "actor" only
            the caller ends it.

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
            where = opener.locations()
            session = Session(opener.config(settings.config, where, **settings.given), where)
        config = session.config
        self.form = StationForm.of_config(config)
        self._timing = config.task.timing
        self._rows, self._task = RowFormat.from_config(config), SteppedTask(session, EndRule(end))
        self._command: Row = np.zeros(len(self.form.action), np.float32)

    @property
    def trial(self) -> int:
        """Number of the trial."""
        return self._task.attempt.job.attempt

    @property
    def time(self) -> float:
        """Time since the trial's start, s."""
        return self._task.episode.seconds

    @property
    def prompt(self) -> str:
        """The trial's task in words."""
        return self._task.attempt.phrasing or self.form.prompt

    @property
    def tick_s(self) -> float:
        """Duration of a control tick, s; a frame has one or more ticks."""
        return self._timing.tick

    def begin(self, seed: int = 0, trial: int = 0) -> int:
        """Put everything to the start of a trial, as in `yamsim trials --seed SEED`.

        Returns:
            The trial's number: the first from `trial` on that has a start.

        Raises:
            SimulationError: none of many trials has a start.
        """
        from .core.attempt_data import AttemptJob

        self._task.begin(AttemptJob(seed, trial))
        self._hold()
        return self.trial

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Put everything to the start of an episode, as in `yamsim record --seed SEED`; `trial` has its number then.

        Returns:
            The commands of the task's expert, (frames, numbers of a command).

        Raises:
            SimulationError: the expert succeeds in none of many trials.
        """
        from .core.attempt_data import AttemptJob

        actions = self._task.begin_demonstrated(AttemptJob(seed, trial))
        self._hold()
        drives = self._task.simulator.scene.drives
        first = range(0, len(actions.ctrl), self._timing.ticks_per_frame)
        return np.array([self._rows.action(actions.ctrl[k][drives], actions.magnet[k]) for k in first])

    def state(self) -> Row:
        """Present joints and grippers, (numbers of a state,)."""
        return self._rows.state(self._task.episode.readings(self._task.attempt.job))

    def environment(self) -> Row:
        """Present poses of things, (numbers of `form.environment`,), in the base of the only arm, or of the left one.

        A thing has its position (m), the first two axes of its frame, and the joints (m, rad) of its moving parts.

        Raises:
            SimulationError: this trial's things have other joints than the task's typical ones.
        """
        from .core.dataset.environment_state import object_pose_keys, state_row

        simulator = self._task.simulator
        replica, config = simulator.replica, simulator.config
        replica.show(self._task.episode.data.qpos)
        moving = {item.name: item for item in config.task.objects if item.links}
        row = state_row(
            [
                (replica.T_object_in_base(name), replica.object_joints(moving[name]) if name in moving else ())
                for name in object_pose_keys(config)
            ]
        )
        if len(row) != len(self.form.environment):
            raise SimulationError(
                f"task {config.task.name!r}: trial {self.trial} has things with other joints than usual, and so "
                f"{len(row)} numbers for where they are and not {len(self.form.environment)}"
            )
        return row.astype(np.float32)

    def command(self, row: NDArray[np.floating] | Sequence[float]) -> None:
        """Set the command that acts from now on.

        Raises:
            UsageError: the row is not a finite number for each of `form.action`.
        """
        values = np.asarray(row, dtype=np.float32)
        if values.shape != (len(self.form.action),) or not np.isfinite(values).all():
            raise UsageError(f"a command is {len(self.form.action)} finite numbers, not {values.shape} {values}")
        self._command = values

    def advance(self) -> bool:
        """Let a frame's time pass; whether the trial is a success. Time stops when the trial ends."""
        for _ in range(self._timing.ticks_per_frame):
            self.tick()
        return self._task.succeeded

    def tick(self) -> None:
        """Let one control tick pass, unless the trial has ended."""
        self._task.episode.step(*self._rows.command(self._command))

    def judge(self) -> str:
        """Why the trial is no success at present, in words; empty if it is a success."""
        return self._task.failure_reason()

    def positions(self) -> Array:
        """A copy of MuJoCo's present positions (nq,), from which `pictures` can render later."""
        positions: Array = self._task.episode.data.qpos.copy()
        return positions

    def pictures(
        self, cameras: Sequence[str] | None = None, positions: NDArray[np.float64] | None = None
    ) -> dict[str, Image]:
        """Camera -> RGB picture (height, width, 3) of the present state, or of MuJoCo's positions (nq,) in this trial.

        Args:
            cameras: by default all of `form.cameras`.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        return self._task.render(tuple(self.form.cameras) if cameras is None else cameras, positions)

    def close(self) -> None:
        """Free the renderers."""
        self._task.close()

    def _hold(self) -> None:
        """Command the present joints, without encoders' errors."""
        replica = self._task.simulator.replica
        replica.show(self._task.episode.data.qpos)
        self._command = self._rows.action(replica.joints(), np.zeros(self._rows.arms, bool))
