"""A station in simulation, as a program meets a real one: rows of joints, pictures and commands, a frame at a time.

    from yamsim_cli.station import Station, StationSettings

    with Station(StationSettings(task="pickplace", grasp="contact", action="joints", fps=30)) as station:
        station.begin(seed=0, trial=3)
        station.command(station.state())
        station.advance()
        pictures = station.pictures()

Rows and cameras are called as `yamsim export lerobot` calls them, and have the same units.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from .core.closing import Closing
from .core.errors import SimulationError, UsageError
from .core.session import Session
from .station_settings import StationForm, StationSettings

if TYPE_CHECKING:
    from .core.geometry.se3 import Array
    from .core.images.image import Image

__all__ = ["Station", "StationForm", "StationSettings"]

Row = NDArray[np.float32]


class Station(Closing):
    """The arms of a rig with a task's things, simulated. Close it, or use it as a context manager.

    Nothing moves by itself: time passes in `advance`. Until something else is commanded, arms stay where they began.

    Attributes:
        form: what its rows and pictures are.

    Args:
        pictures: whether there are any; without, OpenGL is left as it is.
        end: who ends a trial: "success" ends it once its goal has held for its hold time, "actor" leaves it to whoever
            acts.

    Raises:
        ConfigError, UsageError: a setting is not valid.
        ResourceError: nothing can render here.
    """

    def __init__(
        self, settings: StationSettings, *, pictures: bool = True, end: Literal["success", "actor"] = "success"
    ) -> None:
        from .core.dataset.rows import Rows
        from .core.episode.rules import EndRule
        from .core.evaluate.stepped import SteppedTask

        opener = settings.opener
        if pictures:
            session = opener.open(settings.config, parallel=False, **settings.given)
        else:
            where = opener.locations()
            session = Session(opener.config(settings.config, where, **settings.given), where)
        config = session.config
        self.form = StationForm.of_config(config)
        self._timing = config.task.timing
        self._rows, self._task = Rows.of(config), SteppedTask(session, EndRule(end))
        self._told: Row = np.zeros(len(self.form.action), np.float32)

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
        """The task in words, as the trial says it."""
        return self._task.attempt.phrasing or self.form.prompt

    @property
    def tick_s(self) -> float:
        """Length of a control tick, s; a frame is one or several of them."""
        return self._timing.tick

    def begin(self, seed: int = 0, trial: int = 0) -> int:
        """Put everything to the start of a trial, that of `yamsim trials --seed SEED`.

        Returns:
            Its number: the first from `trial` on that has a start.

        Raises:
            SimulationError: none of many has one.
        """
        from .core.types import EpisodeJob

        self._task.begin(EpisodeJob(seed, trial))
        self._hold()
        return self.trial

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Put everything to the start of an episode as `yamsim record --seed SEED` has it, see `trial` for its number.

        Returns:
            What the task's expert commands in each frame, (frames, numbers of a command).

        Raises:
            SimulationError: its expert succeeds in none of many.
        """
        from .core.types import EpisodeJob

        actions = self._task.begin_demonstrated(EpisodeJob(seed, trial))
        self._hold()
        drives = self._task.simulator.scene.drives
        first = range(0, len(actions.ctrl), self._timing.ticks_per_frame)
        return np.array([self._rows.action(actions.ctrl[k][drives], actions.magnet[k]) for k in first])

    def state(self) -> Row:
        """Joints and grippers now, (numbers of a state,)."""
        return self._rows.state(self._task.episode.readings(self._task.attempt.job))

    def environment(self) -> Row:
        """Where things are now, (numbers of `form.environment`,), in the base of the only arm, or of the left one.

        Of each thing come its position (m), the first two axes of its frame, and its joints (m, rad) if it has some.

        Raises:
            SimulationError: things of this trial have other joints than those that the task usually has.
        """
        from .core.policies.environment_state import object_pose_keys, state_row

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
        """Tell the arms what to do from now on.

        Raises:
            UsageError: it is not a finite number for each of `form.action`.
        """
        values = np.asarray(row, dtype=np.float32)
        if values.shape != (len(self.form.action),) or not np.isfinite(values).all():
            raise UsageError(f"a command is {len(self.form.action)} finite numbers, not {values.shape} {values}")
        self._told = values

    def advance(self) -> bool:
        """Let a frame's time pass, or what of it is left until the trial is a success, and say whether it is one."""
        for _ in range(self._timing.ticks_per_frame):
            self.tick()
        return self._task.succeeded

    def tick(self) -> None:
        """Let one control tick pass; a trial that has ended stands still."""
        self._task.episode.step(*self._rows.command(self._told))

    def judge(self) -> str:
        """Return why the trial is no success as it stands, in words; empty if it is one."""
        return self._task.why_not()

    def positions(self) -> Array:
        """MuJoCo's positions (nq,) now, a copy, from which pictures can be drawn later."""
        positions: Array = self._task.episode.data.qpos.copy()
        return positions

    def pictures(
        self, cameras: Sequence[str] | None = None, positions: NDArray[np.float64] | None = None
    ) -> dict[str, Image]:
        """Camera -> RGB picture (height, width, 3) now, or at MuJoCo's positions (nq,) in this trial.

        Args:
            cameras: which; all of `form.cameras` unless given.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        return self._task.render(tuple(self.form.cameras) if cameras is None else cameras, positions)

    def close(self) -> None:
        """Free what renders."""
        self._task.close()

    def _hold(self) -> None:
        """Command what the arms do now: where their joints are, whatever encoders read."""
        replica = self._task.simulator.replica
        replica.show(self._task.episode.data.qpos)
        self._told = self._rows.action(replica.joints(), np.zeros(self._rows.arms, bool))
