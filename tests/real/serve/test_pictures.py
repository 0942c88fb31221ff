"""Pictures that a separate process renders while physics goes on."""

from __future__ import annotations

import itertools
import multiprocessing
import select
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.serve.render_process import CameraFrames, RenderProcess
from yamsim_cli.real.serve.served_arms import ServedArms, serve_arms, served_cameras

pytestmark = [pytest.mark.render, pytest.mark.slow]


@pytest.fixture(scope="module")
def session(make_config: Callable[..., RecordConfig], locations: Locations) -> Session:
    changed = {("rig",): "yam_station_linear_4310_d405", ("image", "size_px"): [48, 36]}
    return Session(make_config(changed), locations).without_meshes()


@pytest.fixture(scope="module")
def served(session: Session) -> ServedArms:
    return serve_arms(session, start="home")


@pytest.fixture
def source(session: Session, served: ServedArms) -> Iterator[RenderProcess]:
    made = RenderProcess(session, ("top", "left"), 50.0, served.scene_state, itertools.count(1).__next__)
    yield made
    made.close()


def next_shot(source: RenderProcess, after: int = -1) -> CameraFrames:
    until = time.monotonic() + 60
    while time.monotonic() < until:
        source.flush()
        source.handle(set(select.select(source.readers, [], [], 0.01)[0]))
        if source.newest_frames is not None and source.newest_frames.number > after:
            return source.newest_frames
    raise AssertionError("no shot came")


def test_images_show_the_current_state(source: RenderProcess, served: ServedArms, session: Session) -> None:
    first = next_shot(source)
    assert (first.number, first.time_ns, first.sim_time) == (0, 1, 0.0)
    np.testing.assert_equal(first.joints[0], served.followers[0].joint_pos())
    at_home = served.motor_simulation.data.qpos.copy()
    with Simulator(session) as simulator:
        own = render_cameras(simulator, Attempt(AttemptJob(0, 0)), at_home, ("top", "left"))
        pose = simulator.state_replay.T_cam_in_base("left")
    for name, picture in own.items():
        np.testing.assert_equal(first.pictures[name], picture)
    np.testing.assert_allclose(first.T_cam_in_base["left"], pose)
    assert np.array(source.K["top"]).shape == (3, 3)
    before = first.pictures["left"].copy()
    for _ in range(100):
        served.motor_simulation.step()
    # The next but one was requested after that.
    later = next_shot(source, after=2)
    assert later.sim_time == pytest.approx(served.motor_simulation.sim_time)
    assert (later.pictures["left"] != before).any()


def test_the_death_of_the_rendering_process_is_reported(source: RenderProcess) -> None:
    next_shot(source)
    (process,) = (one for one in multiprocessing.active_children() if one.name == "yamsim-pictures")
    process.kill()
    with pytest.raises(SimulationError, match="the rendering process has ended"):
        next_shot(source, after=10**6)


def test_wrists_are_drawn_that_a_recording_leaves_out(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("wrist",): False, ("image", "size_px"): [48, 36]})
    session = Session(config, locations).without_meshes()
    cameras = served_cameras(config)
    assert config.recorded_cameras == cameras[:1]
    source = RenderProcess(session, cameras, 50.0, serve_arms(session).scene_state, itertools.count(1).__next__)
    try:
        scene, wrist = next_shot(source).pictures.values()
        assert np.ptp(wrist) > 0 and not np.array_equal(scene, wrist)
    finally:
        source.close()
