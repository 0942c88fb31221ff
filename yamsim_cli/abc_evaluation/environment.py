"""Physics, images and success of `put_bottles` on MuJoCo's CPU engine.

The constants are from amazon-far/abc e5e1fbc, `abc_minimal/config.py`. Steps and verdicts are the same as in its
environment with `--vanilla-physics`.
"""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from ..core.closable import Closable
from ..core.errors import ResourceError
from ..core.geometry.camera import Intrinsics, opencv_from_mujoco
from ..core.geometry.se3 import Array, pose, pose_from_quat
from ..core.images.image import Image
from ..core.rendering.renderer import SceneRenderer
from ..core.scene.compilation import compile_spec, physics_failure
from .start import BOTTLE_COUNT, BottlesStart, sample_start

SIDES = ("left", "right")
BOTTLES = tuple(f"bottle_{k + 1}" for k in range(BOTTLE_COUNT))
BIN = "bin"

TIMESTEP = 0.002  # s, of physics
STEPS_PER_ACTION = 17
ACTION_SECONDS = TIMESTEP * STEPS_PER_ACTION  # s, simulated time of an action
# Actions per second of a policy, as ABC's loop counts them: such a policy acts once per action of the simulation, whose
# simulated time is 2 % longer.
POLICY_HZ = 30
GRIPPER_OPENING = 0.0475  # m, of one finger at the share 1
_START_JOINTS = (0.0, 1.047, 1.047, 0.0, 0.0, 0.0)  # rad, of each arm; grippers start closed

# A bottle is in the bin if its origin is in this cylinder around the bin's origin.
BIN_RADIUS = 0.155  # m, horizontal
BIN_HEIGHTS = (-0.06, 0.26)  # m, relative to the bin's origin

# MuJoCo's rendering: the scene's shadow map of 8192 texels takes twice as long on a CPU as this one.
_SHADOW_MAP = 2048  # texels
_SAMPLES = 4  # per pixel


class PutBottles(Closable):
    """The scene of a seed, at its start. Close it after use.

    Joints and commands are (2, 7): of the left and of the right arm, six joints, rad, and the opening of one finger, m.

    Attributes:
        model, data: MuJoCo's model and state.
        start: sampled sizes and poses.
        actions: number of executed actions.
        most_in_bin: largest number of bottles that were in the bin at the same time, after the start or an action.
        has_succeeded: whether all bottles were in the bin at the same time.
        failure: MuJoCo's reason why the simulation became unstable, which ends the trial; None without one.

    Args:
        folder: model files, see `model_files.find_model_folder`.
        size: width and height of images, px.

    Raises:
        ResourceError: the model files cannot be compiled.
    """

    def __init__(self, folder: Path, seed: int, size: tuple[int, int] = (224, 168)) -> None:
        self.start = sample_start(seed)
        self.model = _compile_model(folder, self.start)
        self._size = size
        self.model.opt.timestep = TIMESTEP
        quality, buffer = self.model.vis.quality, self.model.vis.global_
        quality.shadowsize, quality.offsamples = _SHADOW_MAP, _SAMPLES
        buffer.offwidth, buffer.offheight = size
        self.data, self._shown = mujoco.MjData(self.model), mujoco.MjData(self.model)
        drives = [[*(f"{side}_joint{k}" for k in range(1, 7)), f"{side}_left_finger"] for side in SIDES]
        actuators = [[*(f"{side}_joint{k}" for k in range(1, 7)), f"{side}_gripper"] for side in SIDES]
        self._qpos = np.array([[self.model.joint(name).qposadr[0] for name in arm] for arm in drives])
        self._qvel = np.array([[self.model.joint(name).dofadr[0] for name in arm] for arm in drives])
        self._ctrl = np.array([[self.model.actuator(name).id for name in arm] for arm in actuators])
        self._bottles = np.array([self.model.joint(f"{name}_joint").qposadr[0] for name in BOTTLES])
        self._bin = int(self.model.joint(f"{BIN}_joint").qposadr[0])
        self._renderer: SceneRenderer | None = None
        self.actions = self.most_in_bin = 0
        self.has_succeeded = False
        self.failure: str | None = None
        self._set_start()

    def step(self, command: Array) -> None:
        """Execute an action: command joints and finger openings (2, 7), rad and m, for 34 ms."""
        # ABC's actions are float32.
        self.data.ctrl[self._ctrl] = np.asarray(command, dtype=np.float32)
        for _ in range(STEPS_PER_ACTION):
            mujoco.mj_step(self.model, self.data)
        self.actions += 1
        # MuJoCo resets an unstable state, which is then no result of the actions.
        self.failure = physics_failure(self.data)
        if self.failure is None:
            self._judge()

    @property
    def joints(self) -> Array:
        """Joint angles, rad, and finger openings, m, of both arms (2, 7)."""
        found: Array = self.data.qpos[self._qpos]
        return found

    @property
    def joint_velocities(self) -> Array:
        """Velocities of `joints` (2, 7), rad/s and m/s."""
        found: Array = self.data.qvel[self._qvel]
        return found

    def in_bin(self) -> np.ndarray:
        """Return whether each bottle is in the bin (6,)."""
        # In float32, as ABC judges.
        qpos = self.data.qpos.astype(np.float32)
        offsets = qpos[self._bottles[:, None] + np.arange(3)] - qpos[self._bin : self._bin + 3]
        low, high = BIN_HEIGHTS
        near = BIN_RADIUS - np.linalg.norm(offsets[:, :2], axis=1) >= 0.0
        found: np.ndarray = near & (offsets[:, 2] - low >= 0.0) & (high - offsets[:, 2] >= 0.0)
        return found

    def object_poses(self) -> dict[str, Array]:
        """Return the pose (4, 4) in `world` of each bottle and of the bin."""
        addresses = dict(zip(BOTTLES, self._bottles, strict=True)) | {BIN: self._bin}
        qpos = self.data.qpos
        return {name: pose_from_quat(qpos[k : k + 3], qpos[k + 3 : k + 7]) for name, k in addresses.items()}

    def hand_poses(self) -> Array:
        """Return the poses (2, 4, 4) of both `grasp_site`s in `world`."""
        self._show(self.data.qpos)
        return np.array([self._shown_hand(side) for side in SIDES])

    def hand_pose_at(self, arm: int, joints: Array) -> Array:
        """Return the pose (4, 4) of an arm's `grasp_site` in `world` at joints (6,), rad."""
        qpos = self.data.qpos.copy()
        qpos[self._qpos[arm, :6]] = joints
        self._show(qpos)
        return self._shown_hand(SIDES[arm])

    def base_pose(self, side: str) -> Array:
        """Return the pose (4, 4) of an arm's base in `world`."""
        base = self.data.body(f"{side}_arm")
        return pose(base.xpos, base.xmat.reshape(3, 3))

    def camera_pose(self, camera: str) -> Array:
        """Return the pose (4, 4) of a camera in `world`, in OpenCV's convention."""
        self._show(self.data.qpos)
        found = self._shown.camera(camera)
        return pose(found.xpos, opencv_from_mujoco(found.xmat))

    def intrinsics(self, camera: str) -> Intrinsics:
        """Return the pinhole intrinsics of a camera's images."""
        return Intrinsics.from_fovy(*self._size, float(np.radians(self.model.camera(camera).fovy[0])))

    def render(self, qpos: Array, camera: str) -> Image:
        """Render an image (height, width, 3) of a camera at MuJoCo's positions (nq,)."""
        if self._renderer is None:
            self._renderer = SceneRenderer(self.model, self._size)
        self._show(qpos)
        return self._renderer.render(self._shown, camera)

    def close(self) -> None:
        """Release the memory of the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _set_start(self) -> None:
        qpos = self.data.qpos
        # Only the fingers that the grippers drive are set; an equality constraint moves the other ones.
        qpos[self._qpos[:, :6]] = np.array(_START_JOINTS, dtype=np.float32)
        qpos[self._bottles[:, None] + np.arange(7)] = self.start.bottles
        qpos[self._bin : self._bin + 7] = self.start.bin_pose
        mujoco.mj_forward(self.model, self.data)
        self._judge()

    def _judge(self) -> None:
        count = int(self.in_bin().sum())
        self.most_in_bin = max(self.most_in_bin, count)
        self.has_succeeded = self.has_succeeded or count == BOTTLE_COUNT

    def _shown_hand(self, side: str) -> Array:
        site = self._shown.site(f"{side}_grasp_site")
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def _show(self, qpos: Array) -> None:
        self._shown.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._shown)
        mujoco.mj_comPos(self.model, self._shown)
        mujoco.mj_camlight(self.model, self._shown)


def _compile_model(folder: Path, start: BottlesStart) -> mujoco.MjModel:
    """Compile ABC's model with the start's sizes. As there, a mesh's name decides its size.

    Meshes of the sixth bottle are named `bottle_7_...`, and no size is sampled for that name.
    """
    path = folder / "put_bottle.xml"
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise ResourceError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    for mesh in spec.meshes:
        found = re.match(r"bottle_(\d)_", mesh.name)
        if found and int(found[1]) < BOTTLE_COUNT:
            factor = float(start.bottle_scales[int(found[1])])
        elif mesh.name.startswith("water_bottle_"):
            factor = start.bin_scale
        else:
            continue
        # ABC writes the size into XML with eight digits.
        mesh.scale = [float(f"{float(value * factor):.8g}") for value in mesh.scale]
    return compile_spec(spec, str(path), ResourceError)
