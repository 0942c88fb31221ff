"""Observations of policies: pictures only when read, and the state on request."""

from __future__ import annotations

import copy
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.attempts import planned
from tests.policies import sample_policies
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import frame_records, render_cameras
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image
from yamsim_cli.policies.evaluate.observation import LazyObservation, ObservationRenderer
from yamsim_cli.policies.evaluate.policy_calls import PolicyCaller, PolicyTimeoutError
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialRunner

SAMPLES = Path(sample_policies.__file__).parent
CAMERAS = {"scene_rgb": "scene_camera", "wrist_rgb": "right_wrist_camera"}


class CountingRenderer:
    """Render the first position, and record the cameras."""

    def __init__(self) -> None:
        self.rendered: list[str] = []
        self.renderer = ObservationRenderer(self.render)

    def render(self, qpos: Array, camera: str) -> Image:
        self.rendered.append(camera)
        return np.full((2, 2, 3), qpos[0], np.uint8)

    def observe(self) -> LazyObservation:
        return LazyObservation({"time": 0.5}, np.array([7.0]), CAMERAS, self.renderer)


def test_a_picture_is_rendered_when_it_is_read_and_once() -> None:
    source = CountingRenderer()
    seen = source.observe()
    assert (list(seen), len(seen), "wrist_rgb" in seen, "left" in seen) == (["time", *CAMERAS], 3, True, False)
    assert (seen["time"], seen.get("left"), repr(seen)) == (0.5, None, "LazyObservation(time, scene_rgb, wrist_rgb)")
    assert source.rendered == []
    assert seen["wrist_rgb"][0, 0, 0] == 7
    assert seen.get("wrist_rgb") is seen["wrist_rgb"]
    assert source.rendered == ["right_wrist_camera"]
    with pytest.raises(KeyError):
        seen["left"]


@pytest.mark.parametrize(
    "make", [dict, lambda seen: {**seen}, copy.copy, copy.deepcopy, lambda seen: pickle.loads(pickle.dumps(seen))]
)
def test_a_copy_is_a_dictionary_of_everything(make: Callable[[LazyObservation], object]) -> None:
    source = CountingRenderer()
    made = make(source.observe())
    assert isinstance(made, dict)
    assert (made["time"], made["scene_rgb"].shape, made["wrist_rgb"].shape) == (0.5, (2, 2, 3), (2, 2, 3))
    assert sorted(source.rendered) == sorted(CAMERAS.values())


def test_images_cannot_be_read_after_the_trial_or_in_another_thread() -> None:
    source = CountingRenderer()
    seen = source.observe()
    errors: list[Exception] = []

    def read() -> None:
        try:
            seen["scene_rgb"]
        except RuntimeError as error:
            errors.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    thread.join()
    assert "scene_rgb cannot be rendered in another thread: read observation['scene_rgb']" in str(errors[0])
    kept = seen["wrist_rgb"]
    source.renderer.finish()
    assert seen["wrist_rgb"] is kept
    with pytest.raises(RuntimeError, match=r"scene_rgb cannot be rendered once its trial is over"):
        seen["scene_rgb"]
    assert source.renderer.failure is None


def test_the_clock_stands_still_while_a_policy_waits_for_yamsim() -> None:
    caller = PolicyCaller(0.5, SAMPLES)

    def look() -> str:
        with caller.paused_limit():
            time.sleep(0.8)
        return "seen"

    assert caller.call(look) == "seen"
    assert caller.seconds < 0.3

    def look_and_dawdle() -> None:
        look()
        time.sleep(5)

    began = time.monotonic()
    with pytest.raises(PolicyTimeoutError):
        caller.call(look_and_dawdle)
    assert time.monotonic() - began < 3


RENDER = "yamsim_cli.policies.evaluate.policy_trial.render_cameras"


@contextmanager
def trial(name: str, config: RecordConfig, locations: Locations) -> Iterator[TrialRunner]:
    with TrialRunner(Session(config, locations), PolicyChoice(f"sample_policies.py:{name}", SAMPLES)) as runner:
        yield runner


def test_nothing_is_rendered_for_a_policy_without_images(
    config: RecordConfig, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RENDER, lambda *_: pytest.fail("rendered"))
    with trial("Blind", config, locations) as runner:
        assert runner.run(AttemptJob(0, 0)).ended is TrialEnd.TIME_LIMIT


def test_a_picture_that_cannot_be_drawn_is_not_the_policys_fault(
    config: RecordConfig, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise ResourceError("no OpenGL here")

    monkeypatch.setattr(RENDER, refuse)
    with trial("Swallows", config, locations) as runner, pytest.raises(ResourceError, match="no OpenGL here"):
        runner.run(AttemptJob(0, 0))


@pytest.mark.render
def test_an_image_shows_the_state_of_its_observation(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """The picture shows the time of the observation, whenever it is read."""
    config = make_config({("image", "size_px"): [48, 36]})
    with trial("Remembering", config, locations) as runner:
        result = runner.run(AttemptJob(0, 0))
        assert (result.ended, result.error) == (TrialEnd.DONE, "")
        seen = type(runner.policy).seen  # type: ignore[attr-defined]
        assert result.attempt.start is not None
        rendered = render_cameras(
            runner.simulators.get(AttemptJob(0, 0)), result.attempt, result.attempt.start, ("scene_camera",)
        )["scene_camera"]
    np.testing.assert_array_equal(seen[0]["scene_rgb"], rendered)
    with pytest.raises(RuntimeError, match="scene_rgb"):
        seen[8]["scene_rgb"]


@pytest.mark.parametrize("rig", ["single", "bimanual"])
def test_privileged_state_reaches_policies_that_request_it(
    rig: str, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("rig",): rig})
    with trial("Knowing", config, locations) as runner:
        assert runner.run(AttemptJob(0, 0)).ended is TrialEnd.DONE
        seen = list(type(runner.policy).seen)  # type: ignore[attr-defined]
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 0)
        frame = frame_records(simulator, done.attempt, done.recorded_states[:1])[0]
        T_base = simulator.scene.T_base_in_world
    for key, item in (("T_object_in_world", "banana"), ("T_target_in_world", "plate")):
        np.testing.assert_allclose(seen[0][key], T_base @ frame[f"{item}_pose"], atol=1e-6)
    joints, speeds = (np.array([one[key] for one in seen]) for key in ("joints", "joint_velocities"))
    assert speeds.shape == joints.shape
    np.testing.assert_array_equal(speeds[0], 0)
    # Motion of the joints equals the mean of the speeds at both ends; also of the fingers.
    moved, said = np.diff(joints, axis=0), (speeds[:-1] + speeds[1:]) / 2 * config.task.timing.tick_seconds
    for number in range(joints.shape[1] // 7):
        for joint in (7 * number, 7 * number + 6):
            assert abs(moved[:, joint].sum()) > 0.005
            assert said[:, joint].sum() == pytest.approx(moved[:, joint].sum(), rel=0.1)


def test_privileged_state_reaches_no_other_policy(config: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(
        "class Plain:\n    images = ()\n    def reset(self):\n        pass\n"
        "    def __call__(self, observation):\n"
        "        assert sorted(observation) == ['K_scene', 'T_cam_in_world', 'ee_pose_world', 'gripper', 'joints', "
        "'prompt', 'time']\n"
        "        return {'ctrl': observation['joints'], 'done': True}\n"
    )
    with TrialRunner(Session(config, locations), PolicyChoice("plain.py", tmp_path)) as runner:
        assert runner.run(AttemptJob(0, 0)).error == ""


@pytest.mark.render
def test_a_policy_may_request_a_rigs_own_camera_by_its_name(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    """Recordings of such a rig have its cameras, and not the one of `scene`."""
    values = {("rig",): "yam_station_linear_4310_d405", ("task",): "set_upright", ("image", "size_px"): [64, 48]}
    config = make_config(values)
    (tmp_path / "seeing.py").write_text(
        "class Seeing:\n    images = ('top',)\n    def reset(self):\n        pass\n"
        "    def __call__(self, observation):\n        assert observation['top_rgb'].shape == (48, 64, 3)\n"
        "        return {'ctrl': observation['joints'], 'done': True}\n"
    )
    with TrialRunner(Session(config, locations), PolicyChoice("seeing.py", tmp_path)) as runner:
        result = runner.run(AttemptJob(0, 0))
        assert (result.error, result.read_cameras) == ("", {"top"})


def test_a_policy_that_does_not_fit_the_rig_is_closed(
    config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere.py").write_text(
        "class Elsewhere:\n    images = ('scene', 'left_wrist')\n    def reset(self):\n        pass\n"
        "    def __call__(self, observation):\n        pass\n"
        f"    def close(self):\n        open({str(tmp_path / 'closed')!r}, 'w').close()\n"
    )
    with pytest.raises(UsageError, match="asks for the image 'left_wrist'"):
        TrialRunner(Session(config, locations), PolicyChoice("elsewhere.py", tmp_path))
    assert (tmp_path / "closed").exists()
