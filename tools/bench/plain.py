"""The plain pipeline of a simple script, one step after the other.

MuJoCo's renderer with its defaults on full meshes, a picture at a time; inverse kinematics iterated to convergence at
every control tick; physics one step at a time; OpenCV and pickle writing file by file.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.attempts import all_actions
from tools.bench.setting import setting
from yamsim_cli.core.attempt_data import ActionSequence
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.execution import SimulatedAttempt
from yamsim_cli.core.episode.grasps import set_weld_pose
from yamsim_cli.core.scene.arm_model import kinematic_model
from yamsim_cli.core.scene.compiled import CompiledScene

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


def plain_setting() -> Session:
    """The default recording with MuJoCo's defaults for rendering."""
    return setting("high").with_values(render=DEFAULTS)


class PlainPipeline:
    """Makes an episode with known actions; close it.

    Args:
        using: rendered with `DEFAULTS`.
        scene: of the same session.
    """

    def __init__(self, using: Session, scene: CompiledScene) -> None:
        self._config = using.config
        self._scene = scene
        self._arm = mink.Configuration(kinematic_model(using.config.rig.arms[0]))
        self._task = mink.FrameTask("pinch_site", "site", position_cost=1.0, orientation_cost=1.0)
        width, height = using.config.image.size_px
        self._renderer = mujoco.Renderer(self._scene.model, height, width)

    def make(self, done: SimulatedAttempt, out: Path) -> list[NDArray[np.uint8]]:
        """Solve, simulate, render and write one episode into `out`. Return the rendered pictures."""
        start, actions = done.recorded_states[0].qpos, all_actions(done.recorded_states)
        self._solve(start[self._scene.first_arm.joint_qpos], actions)
        return self._simulate_and_render(start, actions, out)

    def _solve(self, start: NDArray[np.float64], actions: ActionSequence) -> None:
        """Solve inverse kinematics for the poses that the actions lead to, tick by tick."""
        joints = start
        for wanted in actions.joints[:, 0, :6]:
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

    def _simulate_and_render(
        self, start: NDArray[np.float64], actions: ActionSequence, out: Path
    ) -> list[NDArray[np.uint8]]:
        timing = self._config.task.timing
        scene, model = self._scene, self._scene.model
        (out / "rgb").mkdir(parents=True)
        (out / "lowdim").mkdir()
        carried = model.body(self._config.task.typical_roles.object_of("object")).id
        data = mujoco.MjData(model)
        scene.reset(data, start)
        images = []
        for tick, ctrl in enumerate(actions.ctrl):
            if actions.magnet[tick, 0] and not data.eq_active[scene.first_arm.weld]:
                mujoco.mj_kinematics(model, data)
                set_weld_pose(model, scene.first_arm, data, carried)
            data.eq_active[scene.first_arm.weld] = actions.magnet[tick, 0]
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
