"""Ground truth of whole recorded episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tests.attempts import planned
from yamsim_cli.core.attempt_data import AttemptJob, AttemptPayload
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import TRUTH_LABELS_FILE, depth_path, segmentation_path, truth_path
from yamsim_cli.core.dataset.ground_truth_files import TruthLabels, array_faults, load_depth, load_truth
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.dataset.records import from_json
from yamsim_cli.core.episode.runner import AttemptRunner
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.png import decode_labels

pytestmark = [pytest.mark.render, pytest.mark.slow]

CAMERAS = ("scene_camera", "right_wrist_camera")
CHANGES = {("truth",): True, ("wrist",): True, ("render",): "fast", ("image", "size_px"): [64, 48]}


@pytest.fixture(scope="module")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config(CHANGES)


@pytest.fixture(scope="module")
def runner(config: RecordConfig, locations: Locations) -> Iterator[AttemptRunner]:
    with AttemptRunner(Session(config, locations), render=True) as runner:
        yield runner


@pytest.fixture(scope="module")
def payload(runner: AttemptRunner) -> AttemptPayload:
    return runner.run(AttemptJob(0, 0))


def test_every_image_has_its_depth_and_segmentation(payload: AttemptPayload) -> None:
    labels = from_json(TruthLabels, payload.files[TRUTH_LABELS_FILE], TRUTH_LABELS_FILE)
    known = {label.id for label in labels.labels}
    for camera in CAMERAS:
        for k in range(payload.frames):
            assert load_depth(payload.files[depth_path(camera, k)]).shape == (48, 64)
            numbers = decode_labels(payload.files[segmentation_path(camera, k)])
            assert numbers is not None
            assert numbers.shape == (48, 64)
            assert set(np.unique(numbers)) <= known
        assert array_faults(load_truth(payload.files[truth_path(camera)]), labels, payload.frames) == []


def test_truth_agrees_with_lowdim(payload: AttemptPayload) -> None:
    labels = from_json(TruthLabels, payload.files[TRUTH_LABELS_FILE], TRUTH_LABELS_FILE)
    banana = labels.objects.index("banana")
    for camera in CAMERAS:
        truth = load_truth(payload.files[truth_path(camera)])
        for k in (0, 20, payload.frames - 1):
            frame = load_frame(payload.files[f"lowdim/{k:06d}.pkl"])
            np.testing.assert_allclose(truth["intrinsics"], frame["intrinsics"][camera], rtol=1e-6)
            np.testing.assert_allclose(truth["T_cam_in_base"][k], frame["extrinsics"][camera], atol=1e-6)
            T = truth["T_cam_in_base"][k] @ truth["T_object_in_cam"][k, banana]
            np.testing.assert_allclose(T, frame["banana_pose"], atol=1e-5)


def test_boxes_and_segmentation_are_of_the_same_frame(payload: AttemptPayload) -> None:
    labels = from_json(TruthLabels, payload.files[TRUTH_LABELS_FILE], TRUTH_LABELS_FILE)
    parts = [label.id for label in labels.labels if label.instance == "arm1"]
    truth = load_truth(payload.files[truth_path("scene_camera")])
    for k in range(payload.frames):
        numbers = decode_labels(payload.files[segmentation_path("scene_camera", k)])
        assert np.isin(numbers, parts).sum() == truth["pixels"][k, labels.instances.index("arm1")]


def test_another_worker_gives_the_same_bytes(
    payload: AttemptPayload, config: RecordConfig, locations: Locations
) -> None:
    """Whatever it made before."""
    with AttemptRunner(Session(config, locations), render=True) as other:
        other.run(AttemptJob(0, 1))
        assert other.run(AttemptJob(0, 0)).files == payload.files


def test_truth_changes_nothing_else(
    payload: AttemptPayload, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    with AttemptRunner(Session(make_config(CHANGES | {("truth",): False}), locations), render=True) as plain:
        files = plain.run(AttemptJob(0, 0)).files
    assert {name: payload.files[name] for name in files} == files
    assert {name.split("/")[0] for name in payload.files.keys() - files.keys()} == {"depth", "segmentation", "truth"}


def test_boards_change_no_physics(
    payload: AttemptPayload, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    with Simulator(Session(make_config({("boards",): True}), locations)) as simulator:
        states = planned(simulator, 0).recorded_states
        assert states
        for k, state in enumerate(states):
            np.testing.assert_array_equal(state.qpos, load_frame(payload.files[f"lowdim/{k:06d}.pkl"])["sim_qpos"])
