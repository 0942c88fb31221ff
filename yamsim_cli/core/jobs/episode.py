"""One attempt, from two numbers to an episode's bytes: everything meets here, but for processes and disks."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import TracebackType

import numpy as np

from ... import __version__
from ..config.record import RecordConfig
from ..dataset.layout import image_name, lowdim_name
from ..dataset.lowdim import content_hash, dump_frame, frame_data
from ..errors import ConfigError
from ..geometry.se3 import Array, yaw
from ..planning.dynamics import ArmDynamics
from ..planning.ik import IkSolver
from ..planning.path import best_plan, plan_path
from ..resources import Locations
from ..scene.build import build_scene
from ..scene.robot import arm_spec, bare_arm
from ..sim.replica import Replica
from ..sim.rollout import Rollout, roll_out
from ..tasks.pickplace import candidate_plans, judge, knocked, sample_layout
from ..tasks.randomness import Stream, generator
from ..types import Cause, EpisodeJob, EpisodePayload, Layout, Outcome
from ..vision.jpeg import encode_jpeg
from ..vision.renderer import SceneRenderer

# A plan that misses a waypoint by more than this is out of the arm's reach.
_REACH_TOLERANCE = 0.005


def versions() -> dict[str, str]:
    """Versions of what an episode's bytes depend on."""
    packages = {"mujoco": "mujoco", "mink": "mink", "numpy": "numpy", "opencv": "opencv-python-headless"}
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

    def run(self, job: EpisodeJob) -> EpisodePayload:
        """Make one attempt; draw it if it succeeded."""
        layout, outcome, rollout = self._simulate(job)
        starts = {name: _start(T) for name, T in layout.T_in_world.items()} if layout else {}
        if not outcome.success or rollout is None or not self._draw:
            return EpisodePayload(job, outcome, starts)
        renderer = self._renderer or SceneRenderer(self._scene.model, self._config.image.size_px)
        self._renderer = renderer
        files, content = self._render(rollout, renderer)
        return EpisodePayload(
            job, outcome, starts, files, len(rollout.states), content, versions(), renderer.description
        )

    def _simulate(self, job: EpisodeJob) -> tuple[Layout | None, Outcome, Rollout | None]:
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
        outcome = knocked(
            layout.T_in_world[plan.object], rollout.T_object_before_grasp, path.position_error, path.tilt
        ) or judge(
            task,
            rollout.T_in_world[task.object.name],
            rollout.T_in_world[task.target.name],
            rollout.object_speed,
            path.position_error,
            path.tilt,
        )
        return layout, outcome, rollout

    def _render(self, rollout: Rollout, renderer: SceneRenderer) -> tuple[dict[str, bytes], str]:
        """The files of an episode, and the hash of their low-dimensional content."""
        config, task = self._config, self._config.task
        intrinsics = {camera: renderer.intrinsics(camera).K for camera in self._scene.cameras}
        files: dict[str, bytes] = {}
        frames = []
        for k, state in enumerate(rollout.states):
            self._replica.show(state)
            frame = frame_data(
                joints=self._replica.joints(),
                timestamp=state.time,
                intrinsics=intrinsics,
                extrinsics={camera: self._replica.T_cam_in_base(camera) for camera in self._scene.cameras},
                object_poses={
                    item.name: self._replica.T_object_in_base(item.name) for item in (task.object, task.target)
                },
                ee_pose=self._replica.T_grasp_in_base(),
                ctrl=state.ctrl,
                action_joints=state.action_joints,
                magnet=state.magnet,
                language_task=task.language_task,
                language_prompt=task.language_prompt,
                wrist_camera=config.rig.arms[0].wrist_camera_name if config.wrist else None,
            )
            frames.append(frame)
            files[lowdim_name(k)] = dump_frame(frame)
            for camera in self._scene.cameras:
                image = renderer.draw(self._replica.data, camera)
                files[image_name(camera, k)] = encode_jpeg(image, config.image.jpeg_quality)
        return files, content_hash(frames)

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


def _start(T: Array) -> tuple[float, float, float, float]:
    return float(T[0, 3]), float(T[1, 3]), float(T[2, 3]), yaw(T)
