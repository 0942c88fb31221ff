"""Draw the expert in the first solved scene of each KitchenBench task, into `docs/images/kitchenbench/`.

python -m tools.kitchenbench_pictures               # all tasks but `_LEFT_OUT`
python -m tools.kitchenbench_pictures pour_pasta    # or some
python -m tools.kitchenbench_pictures recorded      # images of a recorded episode
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.core.errors import YamsimError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.session_opener import SessionOpener

_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images" / "kitchenbench"
_LEFT_OUT = ("fold_cloth",)  # a cloth has its own pictures in docs/cloth.md
_SHORT_SUCCESS = ("handoff",)  # tasks whose success lasts shorter than a motion: judged after each action
_MOMENTS = (0, 0.35, 0.7, 1)  # shares of a trial's motions; of its actions for `_SHORT_SUCCESS`
_SIZE, _FINE = (240, 180), (960, 720)  # px, of a picture, and of the rendered one before it is scaled
_QUALITY = 85  # of the JPEG files
_DISTANCE, _AZIMUTH, _ELEVATION = 0.95, 150.0, -25.0  # m and degrees, of the camera from the middle of the objects
_ABOVE = 0.1  # m, above that middle, of the point that the camera looks at
_SEED = 0
_RECORDED, _RECORDED_SCENE = "recorded", "kitchenbench/pour_pasta/narrow-cup"  # name of the picture, and its scene
_RECORDED_CAMERAS, _RECORDED_MOMENTS = ("top", "left"), (0.3, 0.6, 0.75, 1)  # cameras, and shares of the frames
_REALIZATIONS = 2  # of each scene that are tried: all first ones, then all second ones


def main(names: list[str]) -> None:
    """Draw and write."""
    opener = SessionOpener(os.environ, lambda text: print(text, file=sys.stderr), str)
    # What draws is settled before anything imports MuJoCo.
    opener.choose_gl_backend(opener.find_locations())
    _FOLDER.mkdir(exist_ok=True)
    for name in names or sorted(tasks.TASK_FACTORIES.keys() - set(_LEFT_OUT)):
        strip = recorded_strip() if name == _RECORDED else first_success(name)
        if strip is None:
            sys.stdout.write(f"{name}: the expert solves none of the first realizations\n")
            continue
        _write(name, strip)


def _write(name: str, strip: Array) -> None:
    file = _FOLDER / f"{name}.jpg"
    cv2.imwrite(str(file), strip[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    sys.stdout.write(f"{file}: {file.stat().st_size} bytes\n")


def recorded_strip() -> Array:
    """Record an episode, and return images of two of its cameras (2 * height, 4 * width, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "yamsim_cli", "record", "--n", "1", "--seed", str(_SEED)]
        subprocess.run([*command, "--task", _RECORDED_SCENE, "--out", f"{folder}/out"], check=True)
        rows = []
        for camera in _RECORDED_CAMERAS:
            files = sorted(Path(folder, "out", "ep_000000", "rgb", camera).iterdir())
            shown: list[Any] = [
                cv2.imread(str(files[round(moment * (len(files) - 1))])) for moment in _RECORDED_MOMENTS
            ]
            rows.append(np.hstack([cv2.resize(one, _SIZE, interpolation=cv2.INTER_AREA) for one in shown]))
    strip: Any = np.vstack(rows)[:, :, ::-1]
    return strip  # type: ignore[no-any-return]


def first_success(name: str) -> Array | None:
    """Return the pictures (height, 4 * width, 3) of the first realization that the expert solves; None if none."""
    task = tasks.TASK_FACTORIES[name]()
    assert task.max_steps is not None, "KitchenBench's tasks limit the number of actions"
    for number, scene in itertools.product(range(_REALIZATIONS), task.scenes):
        try:
            strip = solve(scene, number, task.max_steps)
        except YamsimError as error:
            sys.stdout.write(f"{scene.id}: {error}\n")
            continue
        if strip is not None:
            return strip
    return None


def solve(scene: Any, number: int, max_actions: int) -> Array | None:
    """Let the expert act in a realization of a scene, and return the pictures; None without success."""
    from yamsim_cli.kitchenbench.benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
    from yamsim_cli.kitchenbench.policy import PlanningScene, run_expert
    from yamsim_cli.kitchenbench.success_judges import KitchenJudge

    seed = int(derive_seed(_SEED, scene.init_seed, number))
    realized = build_benchmark_scene(build_blueprint(scene, seed), open_station_session("64x48", images=False))
    planning = PlanningScene(realized, seed, TICK_HZ // 3)
    judge: Any = KitchenJudge(realized, planning.motion)
    states = [planning.motion.data.qpos.copy()]
    if scene.metadata["task"] in _SHORT_SUCCESS:
        judge = _EachAction(planning.motion, judge, states)
    try:
        is_each = isinstance(judge, _EachAction)
        keep = (lambda: None) if is_each else lambda: states.append(planning.motion.data.qpos.copy())
        run_expert(planning, judge, max_actions, keep)
        if not judge.evaluate()[0]:
            return None
        # A hand-over is far from where the object was.
        ends = states[:: len(states) - 1] if is_each else states[:1]
        return film_strip(realized.simulator.scene, states, ends)
    finally:
        planning.close()


class _EachAction:
    """Judges after each action, as the benchmark does, and keeps the states until the first success."""

    def __init__(self, motion: Any, judge: Any, states: list[Array]) -> None:
        self._execute, self._motion, self._judge, self._states = motion.execute_action, motion, judge, states
        self._verdict: tuple[bool, str] = (False, "")
        motion.execute_action = self._execute_and_judge

    def evaluate(self) -> tuple[bool, str]:
        return self._verdict

    def _execute_and_judge(self, action: Array) -> None:
        if not self._verdict[0]:
            self._execute(action)
            self._states.append(self._motion.data.qpos.copy())
            self._verdict = self._judge.evaluate()


def film_strip(scene: Any, states: list[Array], centred: list[Array]) -> Array:
    """Return pictures of the states at `_MOMENTS`, side by side, with the objects of `centred` in the middle."""
    import mujoco

    model = scene.model
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    camera.lookat[:] = 0.0
    for state in centred:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        camera.lookat[:] += np.mean([data.body(name).xpos for name in scene.object_names], axis=0) / len(centred)
    camera.lookat[2] += _ABOVE
    camera.distance, camera.azimuth, camera.elevation = _DISTANCE, _AZIMUTH, _ELEVATION
    model.vis.global_.offwidth, model.vis.global_.offheight = _FINE
    shown = []
    with mujoco.Renderer(model, *_FINE[::-1]) as renderer:
        for moment in _MOMENTS:
            data.qpos[:] = states[round(moment * (len(states) - 1))]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            shown.append(cv2.resize(renderer.render(), _SIZE, interpolation=cv2.INTER_AREA))
    return np.hstack(shown)


if __name__ == "__main__":
    main(sys.argv[1:])
