"""Randomized attempts: what they change, what they must not, and that they can be made again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.attempt.runner import EpisodeRunner
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.randomized import Randomized
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.types import EpisodeJob

JOBS = [EpisodeJob(0, k) for k in range(6)]
VISUAL = {("randomization",): "default", ("randomization", "mass"): None, ("randomization", "friction"): None}
MANY = {("randomization", "distractors", "count"): [3, 3]}
SMALL = {("image", "size_px"): [96, 72], ("render",): "fast"}


@pytest.fixture(scope="module")
def visual(make_config: Callable[..., RecordConfig], locations: Locations) -> Iterator[EpisodeRunner]:
    with EpisodeRunner(make_config(VISUAL | MANY | SMALL), locations, {}, draw=False) as runner:
        yield runner


def test_looks_change_neither_success_nor_joints(
    visual: EpisodeRunner, config: RecordConfig, locations: Locations
) -> None:
    with EpisodeRunner(config, locations, {}, draw=False) as plain:
        for job in JOBS:
            layout, outcome, rollout = plain.simulate(job)
            other_layout, other_outcome, other_rollout = visual.simulate(job)
            assert outcome == other_outcome
            assert layout is not None
            assert other_layout is not None
            np.testing.assert_array_equal(layout.T_in_world["banana"], other_layout.T_in_world["banana"])
            assert rollout is not None
            assert other_rollout is not None
            for one, two in zip(rollout.states, other_rollout.states, strict=True):
                np.testing.assert_array_equal(one.qpos, two.qpos)
                np.testing.assert_array_equal(one.actions.ctrl, two.actions.ctrl)


def test_distractors_that_can_be_touched_are_not(visual: EpisodeRunner) -> None:
    """With them in place and colliding, the same actions lead to the same states."""
    placed = 0
    for job in JOBS:
        rollout = visual.simulate(job)[2]
        assert rollout is not None
        drawn = visual.randomized
        placed += len(drawn.distractors)
        for name in drawn.distractors:
            body = visual.scene.model.body(name).id
            assert visual.scene.model.geom_contype[visual.scene.model.geom_bodyid == body].any()
        frames = visual.frames(rollout.states)
        again = visual.repeat(frames[0]["sim_qpos"], _actions(frames), 0.0, 0.0)[1]
        for one, two in zip(rollout.states, again.states, strict=True):
            np.testing.assert_array_equal(one.qpos, two.qpos)
    assert placed >= 10


def _actions(frames: list[dict]) -> object:
    from yamsim_cli.core.dataset.actions import recorded_actions

    found = recorded_actions(frames, len(frames[0]["sim_qpos"]), frames[0]["sim_ctrl"].shape[1])
    assert found is not None
    return found[1]


def test_distractors_stand_clear_of_everything(visual: EpisodeRunner, config: RecordConfig) -> None:
    model, clearance = visual.scene.model, 0.03
    rests = {item.name: item.rest_height for item in _extras(visual)}
    data = mujoco.MjData(model)
    for job in JOBS[:3]:
        rollout = visual.simulate(job)[2]
        assert rollout is not None
        drawn = visual.randomized.distractors
        assert drawn
        assert set(drawn) <= set(rests)
        mujoco.mj_resetData(model, data)
        data.qpos[:] = rollout.states[0].qpos
        mujoco.mj_kinematics(model, data)
        solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
        for name, (x, y, z, _) in drawn.items():
            body = model.body(name).id
            np.testing.assert_allclose(data.xpos[body], (x, y, z))
            assert abs(x - config.table.position[0]) < config.table.half_size[0]
            assert z == config.table.top + rests[name]
            own = [g for g in solid if model.geom_bodyid[g] == body]
            others = [
                g for g in solid
                if model.geom_bodyid[g] != body and model.geom(g).name not in ("table", "safety_plane")
            ]  # fmt: skip
            nearest = min(mujoco.mj_geomDistance(model, data, one, other, 1.0, None) for one in own for other in others)
            assert nearest >= clearance - 1e-6, name


def _extras(runner: EpisodeRunner) -> tuple:
    return runner._config.randomization.extras


def test_a_full_table_leaves_distractors_out_and_fails_nothing(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    narrow = {("randomization", "distractors", "x"): [0.44, 0.46], ("randomization", "distractors", "y"): [-0.01, 0.01]}
    with EpisodeRunner(make_config(VISUAL | MANY | narrow), locations, {}, draw=False) as runner:
        for job in JOBS[:3]:
            assert runner.simulate(job)[1].success
            assert len(runner.randomized.distractors) <= 1


def test_masses_and_friction_change_physics(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("randomization",): "none", ("randomization", "mass"): [2.0, 3.0]})
    with EpisodeRunner(config, locations, {}, draw=False) as runner:
        heavy = runner.simulate(JOBS[0])[2]
        assert 2.0 <= runner.randomized.mass["banana"] <= 3.0
        runner.vary(JOBS[0], Randomized())
        assert heavy is not None
        frames = runner.frames(heavy.states)
        light = runner.repeat(frames[0]["sim_qpos"], _actions(frames), 0.0, 0.0)[1]
        assert not np.array_equal(light.states[-1].qpos, heavy.states[-1].qpos)
        runner.vary(JOBS[0], replace(Randomized(), mass=_masses(config, runner)))
        again = runner.repeat(frames[0]["sim_qpos"], _actions(frames), 0.0, 0.0)[1]
        np.testing.assert_array_equal(again.states[-1].qpos, heavy.states[-1].qpos)


def _masses(config: RecordConfig, runner: EpisodeRunner) -> dict[str, float]:
    runner.simulate(JOBS[0])
    return dict(runner.randomized.mass)


@pytest.mark.render
def test_an_attempt_is_the_same_whatever_was_made_before(
    visual: EpisodeRunner, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("randomization",): "default"} | MANY | SMALL | {("truth",): True})
    with EpisodeRunner(config, locations, {}, draw=True) as runner:
        payloads = {job: runner.run(job) for job in (JOBS[0], JOBS[4], JOBS[5])}
    with EpisodeRunner(config, locations, {}, draw=True) as other:
        for job in (JOBS[5], JOBS[0]):
            made = other.run(job)
            assert made.files == payloads[job].files
            assert made.randomized == payloads[job].randomized


@pytest.mark.render
def test_a_distractor_is_seen_where_it_was_put(visual: EpisodeRunner, config: RecordConfig) -> None:
    rollout = visual.simulate(JOBS[0])[2]
    assert rollout is not None
    qpos, images = rollout.states[0].qpos, []
    model = visual.scene.model
    for y in (-0.25, 0.25):
        place = (0.6, y, config.table.top, 0.0)
        visual.vary(JOBS[0], replace(visual.randomized, distractors={"apple": place}))
        images.append(visual.draw(qpos, ["scene_camera"])["scene_camera"].astype(int))
        numbers = visual.renderer.segment(visual._replica.data, "scene_camera")
        columns = np.nonzero(np.isin(numbers, np.flatnonzero(model.geom_bodyid == model.body("apple").id)))[1]
        # The camera looks back at the arm, so that +y is on its right.
        assert len(columns) > 10
        assert (columns > 48).all() == (y > 0)
    assert np.abs(images[0] - images[1]).max() > 60


@pytest.mark.render
def test_lowdim_tells_the_camera_that_was(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("randomization",): "default"} | SMALL)
    with EpisodeRunner(config, locations, {}, draw=True) as runner:
        one, two = (load_frame(runner.run(job).files["lowdim/000000.pkl"]) for job in JOBS[:2])
    for key in ("intrinsics", "extrinsics"):
        assert not np.allclose(one[key]["scene_camera"], two[key]["scene_camera"], atol=1e-3)


@pytest.mark.render
def test_pictures_of_the_same_states_differ(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config(VISUAL | SMALL)
    with EpisodeRunner(config, locations, {}, draw=True) as runner:
        rollout = runner.simulate(JOBS[0])[2]
        assert rollout is not None
        start = rollout.states[0].qpos
        seen = []
        for job in JOBS[:4]:
            runner.simulate(job)
            seen.append(runner.draw(start, ["scene_camera"])["scene_camera"].astype(int))
        runner.vary(JOBS[0], Randomized())
        plain = runner.draw(start, ["scene_camera"])["scene_camera"].astype(int)
    for k, image in enumerate(seen):
        assert np.abs(image - plain).mean() > 5
        assert all(np.abs(image - other).mean() > 5 for other in seen[:k])
