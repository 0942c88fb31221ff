"""One attempt, from two numbers to an episode's bytes: everything meets here, but for processes and disks."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ... import __version__
from ..config.record import RecordConfig
from ..dataset.layout import image_name, lowdim_name
from ..dataset.lowdim import SimulationData, content_hash, dump_frame, frame_data
from ..dataset.records import Pose2D
from ..errors import ConfigError
from ..geometry.se3 import Array, yaw
from ..planning.dynamics import ArmDynamics
from ..planning.ik import IkSolver
from ..planning.path import best_plan, plan_path
from ..resources import Locations
from ..scene.build import build_scene
from ..scene.compiled import CompiledScene
from ..scene.robot import arm_spec, bare_arm
from ..sim.replica import Replica
from ..sim.rollout import Rollout, object_pose, roll_out, simulate
from ..tasks.pickplace import candidate_plans, judge, knocked, sample_layout
from ..tasks.randomness import Stream, generator
from ..types import Actions, Cause, EpisodeJob, EpisodePayload, Layout, Outcome, StepState
from ..vision.jpeg import encode_jpeg
from ..vision.renderer import Image, SceneRenderer

# A plan that misses a waypoint by more than this is out of the arm's reach.
_REACH_TOLERANCE = 0.005


def versions() -> dict[str, str]:
    """Versions of what an episode's bytes depend on."""
    packages = {name: name for name in ("mujoco", "mink", "daqp", "numpy")} | {"opencv": "opencv-python-headless"}
    return {"yamsim": __version__, "python": platform.python_version()} | {
        key: version(name) for key, name in packages.items()
    }


def require_one_arm(config: RecordConfig) -> None:
    """Refuse a rig that the task's demonstrations are not made for.

    Raises:
        ConfigError: the rig has more than one arm.
    """
    if len(config.rig.arms) > 1:
        raise ConfigError(
            f"task {config.task.name!r} is demonstrated by one arm, and rig {config.rig.name!r} has "
            f"{len(config.rig.arms)}; use a rig with one, such as single"
        )


class EpisodeRunner:
    """Makes attempts, each a pure function of its job. The scene is compiled once, a renderer made when first needed.

    Args:
        config: the recording.
        locations: where robot models are.
        meshes: asset set -> folder of its files, or None for primitives.
        draw: whether successes are rendered; without, a payload has no files.
    """

    def __init__(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], *, draw: bool
    ) -> None:
        self._config = config
        self._draw = draw
        self._scene = build_scene(config, locations, meshes)
        arm = config.rig.arms[0]
        self._ik = IkSolver(bare_arm(arm, locations), self._scene.T_base_in_world)
        self._dynamics = ArmDynamics(arm_spec(arm, locations, None).compile())
        self._start_joints = np.array(config.task.start_joints)
        self._replica = Replica(self._scene)
        self._renderer: SceneRenderer | None = None

    @property
    def scene(self) -> CompiledScene:
        """What the attempts are made in."""
        return self._scene

    @property
    def renderer(self) -> SceneRenderer:
        """The process's one renderer, made when first asked for.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        if self._renderer is None:
            size = self._config.image.size_px
            self._renderer = SceneRenderer(self._scene.model, size, self._config.render.fine_size(size))
        return self._renderer

    def run(self, job: EpisodeJob) -> EpisodePayload:
        """Make one attempt; draw it if it succeeded."""
        layout, outcome, rollout = self.simulate(job)
        return self.payload(job, start_poses(layout), outcome, rollout)

    def payload(
        self, job: EpisodeJob, starts: Mapping[str, Pose2D], outcome: Outcome, rollout: Rollout | None
    ) -> EpisodePayload:
        """An attempt's bytes from what happened in it; without files unless it succeeded, and this runner draws."""
        if not outcome.success or rollout is None or not self._draw:
            return EpisodePayload(job, outcome, starts)
        frames = self.frames(rollout.states)
        files = {lowdim_name(k): dump_frame(frame) for k, frame in enumerate(frames)}
        files |= self.images([state.qpos for state in rollout.states])
        return EpisodePayload(
            job, outcome, starts, files, len(frames), content_hash(frames), versions(), self.renderer.description
        )

    def simulate(self, job: EpisodeJob) -> tuple[Layout | None, Outcome, Rollout | None]:
        """One attempt in physics alone: where things stood, how it ended, and what happened, if anything moved."""
        task = self._config.task
        T_base = self._scene.T_base_in_world
        layout = sample_layout(task, self._config.table, generator(job, Stream.LAYOUT))
        if layout is None:
            detail = f"no free place for the {task.target.name} in the sampling box"
            return None, Outcome(False, Cause.NO_LAYOUT, detail), None

        plan = best_plan(self._ik, task, candidate_plans(task, layout, T_base), layout, T_base)
        path = plan_path(self._ik, self._dynamics, plan, self._start_joints, task.timing)
        if path.position_error > _REACH_TOLERANCE:
            detail = (
                f"the hand ends {path.position_error * 1000:.0f} mm from where it should be "
                f"(at most {_REACH_TOLERANCE * 1000:.0f}): out of the arm's reach"
            )
            outcome = Outcome(False, Cause.UNREACHABLE, detail, position_error=path.position_error, tilt=path.tilt)
            return layout, outcome, None

        rollout = roll_out(self._scene, layout, path, plan.object, task.timing)
        outcome = self._judge(rollout, layout.T_in_world[plan.object], path.position_error, path.tilt)
        return layout, outcome, rollout

    def repeat(self, start: Array, actions: Actions, plan_error: float, tilt: float) -> tuple[Outcome, Rollout]:
        """Let recorded actions act again, in physics alone, without any plan.

        Args:
            start: MuJoCo's positions (nq,) of the first frame.
            plan_error, tilt: of the plan that the actions came from, m and rad; they are passed on to the outcome.
        """
        task = self._config.task
        rollout = simulate(self._scene, start, actions, task.object.name, task.timing)
        self._replica.show(start)
        T_at_start = object_pose(self._replica.data, task.object.name)
        return self._judge(rollout, T_at_start, plan_error, tilt), rollout

    def _judge(self, rollout: Rollout, T_at_start: Array, plan_error: float, tilt: float) -> Outcome:
        task = self._config.task
        return knocked(T_at_start, rollout.T_object_before_grasp, plan_error, tilt) or judge(
            task,
            rollout.T_in_world[task.object.name],
            rollout.T_in_world[task.target.name],
            rollout.object_speed,
            plan_error,
            tilt,
        )

    def frames(self, states: Sequence[StepState]) -> list[dict[str, Any]]:
        """The low-dimensional data of recorded states, see `dataset.lowdim`; nothing is drawn for it."""
        return [self._frame(state) for state in states]

    def _frame(self, state: StepState) -> dict[str, Any]:
        config, task, replica = self._config, self._config.task, self._replica
        replica.show(state.qpos)
        acting = state.actions
        return frame_data(
            joints=replica.joints(),
            timestamp=state.time,
            intrinsics={name: replica.intrinsics(name, config.image.size_px).K for name in self._scene.cameras},
            extrinsics={name: replica.T_cam_in_base(name) for name in self._scene.cameras},
            object_poses={item.name: replica.T_object_in_base(item.name) for item in (task.object, task.target)},
            ee_pose=replica.T_grasp_in_base(),
            ctrl=acting.ctrl[0],
            action_joints=acting.joints[0],
            magnet=acting.magnet[0],
            language_task=task.language_task,
            language_prompt=task.language_prompt,
            wrist_camera=config.rig.arms[0].wrist_camera_name if config.wrist else None,
            simulation=SimulationData(state.qpos, acting.ctrl, acting.magnet),
        )

    def images(self, positions: Iterable[Array]) -> dict[str, bytes]:
        """Path inside the episode -> JPEG, of every camera for each of MuJoCo's positions (nq,).

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        width, height = self._config.image.size_px
        image = np.empty((height, width, 3), np.uint8)
        files: dict[str, bytes] = {}
        for k, qpos in enumerate(positions):
            self._replica.show(qpos)
            for camera in self._scene.cameras:
                self.renderer.draw(self._replica.data, camera, image)
                files[image_name(camera, k)] = encode_jpeg(image, self._config.image.jpeg_quality)
        return files

    def draw(self, qpos: Array, cameras: Sequence[str]) -> dict[str, Image]:
        """Camera -> RGB image (height, width, 3) at MuJoCo's positions (nq,). Raises as `images`."""
        self._replica.show(qpos)
        return {camera: self.renderer.draw(self._replica.data, camera) for camera in cameras}

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> EpisodeRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def start_poses(layout: Layout | None) -> dict[str, Pose2D]:
    """Object -> start pose `[x, y, z, yaw]` in `world`, m and rad; empty without a layout."""
    if layout is None:
        return {}
    return {name: (float(T[0, 3]), float(T[1, 3]), float(T[2, 3]), yaw(T)) for name, T in layout.T_in_world.items()}
