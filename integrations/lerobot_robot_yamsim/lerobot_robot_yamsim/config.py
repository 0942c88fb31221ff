"""What `--robot.type=yamsim` and `--teleop.type=yamsim_expert` take."""

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
        fps: control ticks a second: the `--dataset.fps` of what is recorded.
        size: width and height of pictures, px.
        cameras: names of those that are shown, in order.
        seed, trial: where things start: as in that trial of `yamsim trials --seed SEED`, and in the next ones.
        by_clock: whether time passes by the clock; otherwise a frame passes with each action, so that a busy machine
            changes nothing in what happens.
        episode_time_s, reset_time_s: how long LeRobot records an episode, and lets people set up the next one: at the
            beginning of that, the scene is set up. Unless given, they are what the command line says in
            `--dataset.episode_time_s` and `--dataset.reset_time_s`. Where it says nothing, the scene is never set up
            again.
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
            ValueError: one is not valid.
        """
        # Not theirs, which asks for the sizes of cameras one by one.
        if self.episode_time_s is None:
            self.episode_time_s = _said("dataset.episode_time_s")
        if self.reset_time_s is None:
            self.reset_time_s = _said("dataset.reset_time_s")
        try:
            self.form = StationForm.of(self.settings)
        except YamsimError as error:
            raise ValueError(str(error)) from None

    @property
    def settings(self) -> StationSettings:
        """Those of the station."""
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
    """The expert of the task, which knows where everything is. It drives the simulated robot of the same process.

    Attributes:
        robot_id: that robot's `--robot.id`.
    """

    robot_id: str | None = None


def _said(name: str) -> float | None:
    """What the command line says of a number of seconds; None where it says nothing."""
    value = parser.parse_arg(name)
    try:
        return None if value is None else float(value)
    except ValueError:
        return None  # LeRobot says so.
