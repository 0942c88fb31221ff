"""One attempt, from two numbers to an episode's bytes: everything meets here, but for processes and disks."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ..config.record import RecordConfig
from ..dataset.layout import image_name, lowdim_name
from ..dataset.lowdim import SimulationData, content_hash, dump_frame, frame_data
from ..dataset.records import Pose2D
from ..drawn import differences
from ..errors import ResourceError
from ..geometry.se3 import Array, inverse, yaw
from ..planning.demonstration import start_stand
from ..planning.planners import make_planner
from ..randomized import Randomized
from ..resources import Locations
from ..scene.build import build_scene
from ..scene.compiled import CompiledScene
from ..sim.replica import Replica
from ..sim.rollout import Rollout, roll_out, simulate
from ..sim.watch import object_pose
from ..tasks.kinds import draw_layout, kind_of
from ..tasks.pickplace import Poses
from ..tasks.plans import phases_of
from ..types import Actions, Cause, EpisodeJob, EpisodePayload, Layout, Outcome, StepState
from ..vision.jpeg import encode_jpeg
from ..vision.labels import SceneLabels, scene_labels
from ..vision.renderer import Image, SceneRenderer
from ..vision.truth import whole_mm
from .truth import EpisodeTruth
from .variation import Variation

# Where meshes are drawn, when a worker's are not the recorder's.
_PLACES = ("for the recorder", "there")

# A plan that misses a waypoint by more than this is out of the arm's reach.
_REACH_TOLERANCE = 0.005


def versions() -> dict[str, str]:
    """Versions of what an episode's bytes depend on."""
    packages = {name: name for name in ("mujoco", "mink", "daqp", "numpy")} | {"opencv": "opencv-python-headless"}
    return {"yamsim": __version__, "python": platform.python_version()} | {
        key: version(name) for key, name in packages.items()
    }


class EpisodeRunner:
    """Makes attempts, each a pure function of its job. The scene is compiled once, a renderer made when first needed.

    Args:
        config: the recording.
        locations: where robot models are.
        meshes: asset set -> folder of its files, or None for primitives.
        draw: whether successes are rendered; without, a payload has no files.

    Raises:
        ResourceError: it would draw other meshes than the config says.
    """

    def __init__(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], *, draw: bool
    ) -> None:
        self._config = config
        self._kind = kind_of(config.task)
        self._draw = draw
        self._scene = build_scene(config, locations, meshes)
        if draw and config.meshes is not None and (others := differences(config.meshes, self._scene.drawn, _PLACES)):
            raise ResourceError(
                f"a worker on {platform.node()} would draw other meshes than the recorder: {'; '.join(others)}; they "
                "changed meanwhile, or yamsim is another one there: mend that, and go on with --resume"
            )
        self._planner = make_planner(config, self._scene, locations)
        self._phases = self._kind.phases(config)
        self._replica = Replica(self._scene)
        self._renderer: SceneRenderer | None = None
        self._labels: SceneLabels | None = None
        if config.truth:
            objects = (config.task.object, config.task.target, *config.randomization.extras)
            names = [item.name for item in objects]
            self._labels = scene_labels(self._scene.model, config.rig, names, boards=config.boards)
        self._variation = Variation(config, self._scene)
        bases = [arm.T_base_in_world for arm in self._scene.arms]
        self._T_right_base_in_left_base = inverse(bases[0]) @ bases[1] if len(bases) > 1 else None

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
            return EpisodePayload(job, outcome, starts, randomized=self.randomized)
        frames = self.frames(rollout.states)
        files = {lowdim_name(k): dump_frame(frame) for k, frame in enumerate(frames)}
        files |= self.images([state.qpos for state in rollout.states])
        made = (files, len(frames), content_hash(frames), versions(), self.renderer.description)
        return EpisodePayload(job, outcome, starts, *made, self.randomized)

    def simulate(self, job: EpisodeJob) -> tuple[Layout | None, Outcome, Rollout | None]:
        """One attempt in physics alone: where things stood, how it ended, and what happened, if anything moved."""
        config, task = self._config, self._config.task
        self._variation.begin(job)
        layout = draw_layout(config, job)
        if layout is None:
            detail = f"no free place for the {task.target.name} in the sampling box"
            return None, Outcome(False, Cause.NO_LAYOUT, detail), None

        plan = self._planner.plan(layout)
        if plan.position_error > _REACH_TOLERANCE:
            detail = (
                f"the hand ends {plan.position_error * 1000:.0f} mm from where it should be "
                f"(at most {_REACH_TOLERANCE * 1000:.0f}): out of the arm's reach"
            )
            outcome = Outcome(False, Cause.UNREACHABLE, detail, position_error=plan.position_error, tilt=plan.tilt)
            return layout, outcome, None

        rollout = roll_out(self._scene, layout, plan.paths, task.object.name, task.timing, self._phases)
        outcome = self._judge(rollout, layout.T_in_world[task.object.name], plan.position_error, plan.tilt)
        if outcome.success:
            self._variation.place(job, [state.qpos for state in rollout.states])
        return layout, outcome, rollout

    def start(self, layout: Layout, rollout: Rollout | None) -> Array:
        """MuJoCo's positions (nq,) that an attempt begins with: its plan's, or without one the task's own."""
        if rollout:
            return rollout.states[0].qpos
        stand = start_stand(self._config)
        return self._scene.start_qpos(layout, stand[:, :6], stand[:, 6])

    @property
    def randomized(self) -> Randomized:
        """What was drawn for the attempt that was last simulated, or given by `vary`."""
        return self._variation.drawn

    def vary(self, job: EpisodeJob, drawn: Randomized) -> None:
        """Let the scene be as it was drawn for an attempt; `simulate` does so by itself."""
        self._variation.apply(job, drawn)

    def repeat(
        self,
        start: Array,
        actions: Actions,
        plan_error: float,
        tilt: float,
        *,
        planned: bool = True,
        see: Callable[[mujoco.MjData], None] | None = None,
    ) -> tuple[Outcome, Rollout]:
        """Let recorded actions act again, in physics alone, without any plan, in the scene as it is varied now.

        Args:
            start: MuJoCo's positions (nq,) of the first frame.
            plan_error, tilt: of the plan that the actions came from, m and rad; they are passed on to the outcome.
            planned: whether they came from a plan, which says when the object is to be in hand; else the weld does. See
                also `judge`.
            see: see `sim.rollout.simulate`.
        """
        task = self._config.task
        held = self._phases if planned else phases_of(actions.magnet)
        rollout = simulate(self._scene, start, actions, task.object.name, task.timing, held, see)
        self._replica.show(start)
        T_at_start = object_pose(self._replica.data, task.object.name)
        return self._judge(rollout, T_at_start, plan_error, tilt, planned=planned), rollout

    def demonstrate(self, job: EpisodeJob, start: Array, actions: Actions) -> tuple[Outcome, Rollout]:
        """Let the actions of a person or a leader arm act again, the scene varied as an attempt's numbers say.

        Args:
            start: MuJoCo's positions (nq,) at the beginning.
        """
        self._variation.begin(job)
        outcome, rollout = self.repeat(start, actions, 0.0, 0.0, planned=False)
        if outcome.success:
            self._variation.place(job, [state.qpos for state in rollout.states])
        return outcome, rollout

    def _judge(
        self, rollout: Rollout, T_at_start: Array, plan_error: float, tilt: float, *, planned: bool = True
    ) -> Outcome:
        task = self._config.task
        poses = Poses(
            T_at_start,
            rollout.T_object_before_grasp,
            rollout.T_in_world[task.object.name],
            rollout.T_in_world[task.target.name],
        )
        speed, grasp = rollout.object_speed, self._config.grasp
        return self._kind.judge(task, grasp, poses, speed, rollout.motion, plan_error, tilt, planned=planned)

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
            ctrl=acting.ctrl[0][self._scene.drives],
            action_joints=acting.joints[0],
            magnet=acting.magnet[0],
            language_task=task.language_task,
            language_prompt=task.language_prompt,
            wrist_camera=config.wrist_arms[0].wrist_camera_name if len(config.wrist_arms) == 1 else None,
            T_right_base_in_left_base=self._T_right_base_in_left_base,
            simulation=SimulationData(state.qpos, acting.ctrl, acting.magnet),
        )

    def images(self, positions: Iterable[Array]) -> dict[str, bytes]:
        """Path inside the episode -> JPEG, of every camera for each of MuJoCo's positions (nq,), and the truth on it.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        files: dict[str, bytes] = {}
        truth = EpisodeTruth(self._labels, self._scene.cameras, self._scene.T_base_in_world) if self._labels else None
        for k, camera, image in self.pictures(positions):
            files[image_name(camera, k)] = encode_jpeg(image, self._config.image.jpeg_quality)
            if truth:
                truth.add(self._replica.data, camera, self.renderer)
        return files | (truth.files if truth else {})

    def pictures(self, positions: Iterable[Array]) -> Iterator[tuple[int, str, Image]]:
        """Frame, camera and RGB image (height, width, 3), as recordings have them, of each of MuJoCo's positions (nq,).

        The image's memory is used again for the next one. Raises as `images`.
        """
        width, height = self._config.image.size_px
        image = np.empty((height, width, 3), np.uint8)
        self._variation.show(self.renderer)
        for k, qpos in enumerate(positions):
            self._replica.show(qpos)
            for number, camera in enumerate(self._scene.cameras):
                self.renderer.draw(self._replica.data, camera, image)
                self._variation.finish(image, k, number)
                yield k, camera, image

    def depth(self, qpos: Array, camera: str) -> NDArray[np.uint16]:
        """A depth image (height, width) in mm at MuJoCo's positions (nq,), given `truth`. Raises as `images`."""
        assert self._labels, "depth is part of truth"
        self._replica.show(qpos)
        # Of what has a label, as recorded truth is: the sky has none, and is at no distance.
        return whole_mm(self.renderer.label(self._replica.data, camera, self._labels.of_geom)[1])

    def draw(self, qpos: Array, cameras: Sequence[str]) -> dict[str, Image]:
        """Camera -> RGB image (height, width, 3) at MuJoCo's positions (nq,). Raises as `images`."""
        self._variation.show(self.renderer)
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
