"""The configs of `--robot.type=yamsim` and `--teleop.type=yamsim_expert`."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs import parser
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

from yamsim_cli import YamsimError
from yamsim_cli.station import StationForm, StationSettings


@RobotConfig.register_subclass("yamsim")
@dataclass(kw_only=True)
class YamsimRobotConfig(RobotConfig):
    """Simulated arms with a task's things. Joints are in rad, grippers shares from 0, closed, to 1, open.

    Attributes:
        fps: control ticks a second, equal to `--dataset.fps`.
        size: width and height of pictures, px.
        cameras: names, in order.
        seed, trial: the first trial, as in `yamsim trials --seed SEED`; the next episodes have the next trials.
        by_clock: whether time passes by the clock; otherwise a frame passes with each action, independent of the
            machine's load.
        episode_time_s, reset_time_s: durations of LeRobot's episodes and of its phases to set up the next episode, at
            whose beginning the scene is set up. By default those of the command line's `--dataset.episode_time_s` and
            `--dataset.reset_time_s`; without them, the scene is set up only once.
        rig, arm, grasp, quality, randomize, config: as the flags of `yamsim record`.
    """

    task: str = "pickplace"
    rig: str | None = "single_linear"
    arm: str | None = None
    grasp: str = "contact"
    fps: float = 30.0
    size: str = "640x480"
    quality: str | None = None
    cameras: list[str] | None = None
    randomize: bool | None = None
    config: str = "default"
    seed: int = 0
    trial: int = 0
    by_clock: bool = True
    episode_time_s: float | None = None
    reset_time_s: float | None = None

    def __post_init__(self) -> None:
        """Look the settings up.

        Raises:
            ValueError: a setting is not valid.
        """
        # LeRobot's own method is not called, since it requires the sizes of cameras one by one.
        if self.episode_time_s is None:
            self.episode_time_s = _seconds_of_flag("dataset.episode_time_s")
        if self.reset_time_s is None:
            self.reset_time_s = _seconds_of_flag("dataset.reset_time_s")
        try:
            self.form = StationForm.from_settings(self.settings)
        except YamsimError as error:
            raise ValueError(str(error)) from None

    @property
    def settings(self) -> StationSettings:
        """The settings of the station."""
        return StationSettings(
            task=self.task,
            rig=self.rig,
            arm=self.arm,
            grasp=self.grasp,
            action="joints",
            fps=self.fps,
            size=self.size,
            quality=self.quality,
            cameras=tuple(self.cameras) if self.cameras else None,
            randomize=self.randomize,
            config=self.config,
            spelling="--robot.{}",
        )


@TeleoperatorConfig.register_subclass("yamsim_expert")
@dataclass
class YamsimExpertConfig(TeleoperatorConfig):
    """The task's expert, which drives the simulated robot of the same process.

    Attributes:
        robot_id: the robot's `--robot.id`.
    """

    robot_id: str | None = None


def _seconds_of_flag(name: str) -> float | None:
    """The command line's value of a flag, s; None without the flag."""
    value = parser.parse_arg(name)
    try:
        return None if value is None else float(value)
    except ValueError:
        return None  # LeRobot reports the error.
