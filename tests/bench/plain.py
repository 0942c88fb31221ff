"""The pipeline that is compared with: what a script of an afternoon does, one thing after the other.

MuJoCo's own renderer with MuJoCo's defaults on the real meshes, a picture at a time; inverse kinematics iterated to
convergence at every control tick; physics stepped one step at a time; OpenCV and pickle writing file by file.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.bench.floor import actions_of
from tests.bench.setting import Setting, setting
from yamsim_cli.core.attempt.runner import EpisodeRunner
from yamsim_cli.core.config.recording import RenderConfig
from yamsim_cli.core.scene.robot import bare_arm
from yamsim_cli.core.sim.rollout import Rollout, attach
from yamsim_cli.core.types import Actions

# Source: MuJoCo 4's XML reference, visual/quality and visual/global, and light/castshadow. Nothing reflects there.
DEFAULTS = RenderConfig(
    name="mujoco",
    multisamples=4,
    supersampling=1,
    shadow_map_px=4096,
    shadow_lights=8,
    reduced_meshes=False,
    reflections=False,
    slices=28,
)

_IK_ITERATIONS = 200
_IK_CONVERGED_M = 1e-4
_IK_CONVERGED_RAD = 1e-3


def plain_setting() -> Setting:
    """The default recording with MuJoCo's defaults for drawing."""
    high = setting("high")
    return Setting(high.config.model_copy(update={"render": DEFAULTS}), high.locations, high.meshes)


class PlainPipeline:
    """Makes an episode again whose actions are known; close it.

    Args:
        runner: whose scene it is; drawn with `DEFAULTS`.
    """

    def __init__(self, using: Setting, runner: EpisodeRunner) -> None:
        self._config = using.config
        self._scene = runner.scene
        self._arm = mink.Configuration(bare_arm(using.config.rig.arms[0], using.locations))
        self._task = mink.FrameTask("pinch_site", "site", position_cost=1.0, orientation_cost=1.0)
        width, height = using.config.image.size_px
        self._renderer = mujoco.Renderer(self._scene.model, height, width)

    def make(self, rollout: Rollout, out: Path) -> list[NDArray[np.uint8]]:
        """Solve, simulate, draw and write one episode into `out`; the pictures as they were drawn."""
        actions = actions_of(rollout)
        self._solve(rollout.states[0].qpos[self._scene.arm.joint_qpos], actions)
        return self._simulate_and_draw(rollout.states[0].qpos, actions, out)

    def _solve(self, start: NDArray[np.float64], actions: Actions) -> None:
        """Inverse kinematics to where the actions lead, tick by tick."""
        joints = start
        for wanted in actions.joints[:, :6]:
            self._arm.update(wanted)
            self._task.set_target(self._arm.get_transform_frame_to_world("pinch_site", "site"))
            self._arm.update(joints)
            for _ in range(_IK_ITERATIONS):
                change = mink.solve_ik(self._arm, [self._task], 1.0, "daqp", damping=1e-6)
                self._arm.integrate_inplace(change, 1.0)
                error = self._task.compute_error(self._arm)
                if np.linalg.norm(error[:3]) < _IK_CONVERGED_M and np.linalg.norm(error[3:]) < _IK_CONVERGED_RAD:
                    break
            joints = self._arm.q

    def _simulate_and_draw(self, start: NDArray[np.float64], actions: Actions, out: Path) -> list[NDArray[np.uint8]]:
        timing, carried = self._config.task.timing, self._config.task.object.name
        scene, model = self._scene, self._scene.model
        (out / "rgb").mkdir(parents=True)
        (out / "lowdim").mkdir()
        data = mujoco.MjData(model)
        scene.reset(data, start)
        images = []
        for tick, ctrl in enumerate(actions.ctrl):
            if actions.magnet[tick] and not data.eq_active[scene.arm.weld]:
                mujoco.mj_kinematics(model, data)
                attach(model, scene.arm, data, carried)
            data.eq_active[scene.arm.weld] = actions.magnet[tick]
            data.ctrl[:] = ctrl
            if tick % timing.ticks_per_frame == 0:
                mujoco.mj_forward(model, data)
                frame = tick // timing.ticks_per_frame
                self._renderer.update_scene(data, scene.cameras[0])
                images.append(self._renderer.render())
                quality = [cv2.IMWRITE_JPEG_QUALITY, self._config.image.jpeg_quality]
                assert cv2.imwrite(f"{out}/rgb/{frame:06d}.jpg", cv2.cvtColor(images[-1], cv2.COLOR_RGB2BGR), quality)
                with (out / "lowdim" / f"{frame:06d}.pkl").open("wb") as file:
                    pickle.dump({"qpos": data.qpos.copy(), "ctrl": ctrl}, file)
            for _ in range(timing.physics_steps_per_tick):
                mujoco.mj_step(model, data)
        return images

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()
