"""Speed of LeRobot's plugins: `python -m tools.bench.lerobot_plugins` in an environment with both.

Frames a second of an environment and of the robot, and median and 95 % of a frame's duration, ms. The arms stay where
they are.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

_FRAMES = 150


def measured(frame: Callable[[], None], environments: int = 1) -> str:
    """A row's figures."""
    frame()
    seconds = []
    for _ in range(_FRAMES):
        begun = time.perf_counter()
        frame()
        seconds.append(time.perf_counter() - begun)
    median, most = np.percentile(seconds, (50, 95)) * 1000
    return f"{environments * _FRAMES / sum(seconds):.0f} | {median:.1f} ms | {most:.1f} ms"


def environment(size: str, pictures: bool, count: int) -> str:
    """Measure `count` environments of `pickplace`; several have a process each."""
    from lerobot.envs import make_env
    from lerobot_env_yamsim import YamsimEnvConfig

    # No trial ends meanwhile: frames after its end cost nothing.
    config = YamsimEnvConfig(size=size, pictures=pictures, max_frames=10 * _FRAMES)
    (envs,) = make_env(config, n_envs=count, use_async_envs=count > 1)["pickplace"].values()
    seen, _ = envs.reset(seed=list(range(count)))
    stay = np.concatenate([seen["agent_pos"], np.zeros((count, 1))], axis=1).astype(np.float32)
    try:
        return measured(lambda: envs.step(stay), count)
    finally:
        envs.close()


def robot(size: str, cameras: list[str]) -> str:
    """Measure the robot at full speed: an observation, and an action."""
    from lerobot_robot_yamsim import YamsimRobot, YamsimRobotConfig

    made = YamsimRobot(YamsimRobotConfig(size=size, cameras=cameras, by_clock=False))
    made.connect()

    def frame() -> None:
        seen = made.get_observation()
        made.send_action({key: seen[key] for key in made.action_features})

    try:
        return measured(frame)
    finally:
        made.disconnect()


def main() -> None:
    """Print the table."""
    print("| | frames a second | median | 95 % |\n|---|---|---|---|")
    for size, pictures, count in (
        ("640x480", False, 1),
        ("640x480", True, 1),
        ("640x480", True, 2),
        ("320x240", True, 1),
    ):
        shown = f"two cameras of {size}" if pictures else "no pictures"
        several = f"{count} at once, " if count > 1 else ""
        print(f"| environment, {several}{shown} | {environment(size, pictures, count)} |", flush=True)
    for size, cameras in (("640x480", ["scene_camera"]), ("320x240", ["scene_camera", "right_wrist_camera"])):
        print(f"| robot, {len(cameras)} of {size} | {robot(size, cameras)} |", flush=True)


if __name__ == "__main__":
    main()
