"""Variations: what they change, what they must not change, and that they can be reproduced."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import asdict, replace

import mujoco
import numpy as np
import pytest

from tests.attempts import all_actions, planned
from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.config.variation import ArmDynamicsSample, RandomizationSample
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.episode.attempt_payload import frame_records, render_cameras
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions, simulate_expert, with_reserved_distractors
from yamsim_cli.core.episode.runner import AttemptRunner
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.robots.dynamics import MeasuredArmDynamics
from yamsim_cli.core.sim.encoder_readings import delayed_positions

N = 6
VISUAL = {("randomization",): "default", ("randomization", "mass"): None, ("randomization", "friction"): None}
MANY = {("randomization", "distractors", "count"): [3, 3]}
SMALL = {("image", "size_px"): [96, 72], ("render",): "fast"}


@pytest.fixture(scope="module")
def visual(make_config: Callable[..., RecordConfig], locations: Locations) -> Iterator[Simulator]:
    with Simulator(Session(make_config(VISUAL | MANY | SMALL), locations)) as simulator:
        yield simulator


@pytest.mark.slow
def test_looks_change_neither_success_nor_joints(visual: Simulator, config: RecordConfig, locations: Locations) -> None:
    with Simulator(Session(config, locations)) as plain:
        for number in range(2):
            one, other = planned(plain, 0, number), planned(visual, 0, number)
            assert one.outcome == other.outcome
            assert one.attempt.object_places == other.attempt.object_places
            assert one.recorded_states
            for state, same in zip(one.recorded_states, other.recorded_states, strict=True):
                np.testing.assert_array_equal(state.qpos, same.qpos)
                np.testing.assert_array_equal(state.actions.ctrl, same.actions.ctrl)


@pytest.mark.slow
def test_distractors_that_can_be_touched_are_not(visual: Simulator) -> None:
    """Colliding distractors in place, the same actions lead to the same states."""
    placed = 0
    for number in range(N):
        done = planned(visual, 0, number)
        model = visual.apply_randomization(done.attempt).model
        distractors = done.attempt.variation.distractors
        placed += len(distractors)
        for name in distractors:
            body = model.body(name).id
            assert model.geom_contype[model.geom_bodyid == body].any()
        again = simulate_actions(visual, done.attempt, all_actions(done.recorded_states), EXPERT_RULES)
        for one, two in zip(done.recorded_states, again.recorded_states, strict=True):
            np.testing.assert_array_equal(one.qpos, two.qpos)
    assert placed >= 10


def test_distractors_are_no_obstacles_whenever_the_expert_is_made(
    visual: Simulator, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """Before the first variation, distractors are at their compiled places."""
    with Simulator(Session(make_config(VISUAL | MANY | SMALL), locations)) as early:
        early.prepare()
        one, other = planned(early, 0), planned(visual, 0)
    assert one.attempt.object_places == other.attempt.object_places
    assert one.outcome == other.outcome


def test_distractors_stand_clear_of_everything(visual: Simulator, config: RecordConfig) -> None:
    clearance = 0.03
    rests = {item.name: item.rest_height for item in visual.config.randomization.distractor_configs}
    for number in range(3):
        done = planned(visual, 0, number)
        model = visual.apply_randomization(done.attempt).model
        distractors = done.attempt.variation.distractors
        assert distractors
        assert set(distractors) <= set(rests)
        data = mujoco.MjData(model)
        data.qpos[:] = done.recorded_states[0].qpos
        mujoco.mj_kinematics(model, data)
        solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
        for name, (x, y, z, _) in distractors.items():
            body = model.body(name).id
            np.testing.assert_allclose(data.xpos[body], (x, y, z))
            assert abs(x - config.widened_table.position[0]) < config.widened_table.half_size[0]
            assert z == config.widened_table.top_height + rests[name]
            own = [g for g in solid if model.geom_bodyid[g] == body]
            others = [
                g for g in solid
                if model.geom_bodyid[g] != body and model.geom(g).name not in ("table", "safety_plane")
            ]  # fmt: skip
            nearest = min(mujoco.mj_geomDistance(model, data, one, other, 1.0, None) for one in own for other in others)
            assert nearest >= clearance - 1e-6, name


@pytest.mark.slow
def test_a_full_table_leaves_distractors_out_and_fails_nothing(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    narrow = {("randomization", "distractors", "x"): [0.44, 0.46], ("randomization", "distractors", "y"): [-0.01, 0.01]}
    with Simulator(Session(make_config(VISUAL | MANY | narrow), locations)) as simulator:
        for number in range(3):
            done = planned(simulator, 0, number)
            assert done.outcome.success
            assert len(done.attempt.variation.distractors) <= 1


def test_masses_and_friction_change_physics(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("randomization",): "none", ("randomization", "mass"): [2.0, 3.0]})
    with Simulator(Session(config, locations)) as simulator:
        heavy = planned(simulator, 0)
        assert 2.0 <= heavy.attempt.variation.mass["banana"] <= 3.0
        actions, plain = all_actions(heavy.recorded_states), replace(heavy.attempt, variation=RandomizationSample())
        light = simulate_actions(simulator, plain, actions, EXPERT_RULES)
        assert not np.array_equal(light.recorded_states[-1].qpos, heavy.recorded_states[-1].qpos)
        again = simulate_actions(simulator, heavy.attempt, actions, EXPERT_RULES)
        np.testing.assert_array_equal(again.recorded_states[-1].qpos, heavy.recorded_states[-1].qpos)


def test_what_is_sampled_is_never_changed(visual: Simulator) -> None:
    """A distractor changes with another sampled value, and the rest of the attempt stays."""
    attempt = sample_attempt(visual, AttemptJob(0, 0))
    before = deepcopy(asdict(attempt))
    done = simulate_expert(visual, attempt)
    assert not attempt.variation.distractors
    assert done.attempt.variation.distractors
    after = asdict(attempt)
    np.testing.assert_array_equal(before.pop("start"), after.pop("start"))
    assert str(before) == str(after)
    assert replace(done.attempt.variation, distractors={}) == attempt.variation


def test_who_acts_in_an_attempt_finds_room_among_its_distractors(visual: Simulator) -> None:
    """Distractors leave room for the attempt, as in its recording; without distractors nothing is planned."""
    attempt = sample_attempt(visual, AttemptJob(0, 1))
    furnished = with_reserved_distractors(visual, attempt)
    assert furnished.variation == planned(visual, 0, 1).attempt.variation
    assert furnished.variation.distractors


@pytest.mark.slow
@pytest.mark.render
def test_an_attempt_is_the_same_whatever_was_made_before(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    session = Session(make_config({("randomization",): "default"} | MANY | SMALL | {("truth",): True}), locations)
    jobs = [AttemptJob(0, k) for k in (0, 4, 5)]
    with AttemptRunner(session, render=True) as runner:
        payloads = {job: runner.run(job) for job in jobs}
    with AttemptRunner(session, render=True) as other:
        for job in (jobs[2], jobs[0]):
            made = other.run(job)
            assert made.files == payloads[job].files
            assert made.attempt.variation == payloads[job].attempt.variation


@pytest.mark.slow
@pytest.mark.render
def test_arms_that_act_late_and_are_read_wrongly_do_the_same_again_whatever_was_made_before(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("randomization",): "arms"} | SMALL)
    with Simulator(Session(config, locations)) as simulator:
        one, other = planned(simulator, 0, 0), planned(simulator, 0, 1)
        seen = frame_records(simulator, one.attempt, one.recorded_states)
        # The scene is varied for the second attempt; the first one is reproduced from its record.
        again = simulate_actions(simulator, one.attempt, all_actions(one.recorded_states), EXPERT_RULES)
        told = frame_records(simulator, one.attempt, again.recorded_states)
    with Simulator(Session(config, locations)) as fresh:
        alone = planned(fresh, 0, 1)

    assert other.recorded_states and alone.recorded_states
    for state, same in zip(other.recorded_states, alone.recorded_states, strict=True):
        np.testing.assert_array_equal(state.qpos, same.qpos)
    for frame, same_frame in zip(seen, told, strict=True):
        np.testing.assert_array_equal(frame["joints"], same_frame["joints"])
        np.testing.assert_array_equal(frame["sim_qpos"], same_frame["sim_qpos"])
    off = np.array([frame["joints"][:6] - frame["sim_qpos"][:6] for frame in seen])
    # Delayed by milliseconds, with noise and quantization.
    assert 1e-4 < np.abs(off).max() < 0.05
    assert np.abs(off[0]).max() < 0.003


def test_an_arms_draw_is_added_to_its_own_delays(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    def told(own: float, drawn: float, most: float) -> Array:
        """Return the positions of joint 1 after a command."""
        config = make_config(
            {("randomization", "arm_dynamics"): {"command_delay_ms": [0, most], "sensor_delay_ms": [0, most]}} | SMALL
        )
        dynamics = MeasuredArmDynamics(revision="mine", base=config.rig.arms[0].model.name, command_delay_ms=own)
        arm = config.rig.arms[0].model_copy(update={"dynamics": dynamics})
        config = config.model_copy(update={"rig": config.rig.model_copy(update={"arms": (arm,)})})
        with Simulator(Session(config, locations)) as simulator:
            attempt = sample_attempt(simulator, AttemptJob(0, 0))
            by = (ArmDynamicsSample(drawn, drawn, 0.0, 0.0, (0.0,) * 6),)
            scene = simulator.apply_randomization(replace(attempt, variation=RandomizationSample(arm_dynamics=by)))
            data = mujoco.MjData(scene.model)
            assert attempt.start is not None
            scene.reset(data, attempt.start)
            data.ctrl[scene.first_arm.arm_ctrl[0]] += 0.1
            found = []
            for _ in range(30):
                scene.step(data)
                read = delayed_positions(scene, data)
                assert read is not None
                found.append([float(data.qpos[scene.first_arm.joint_qpos[0]]), float(read[0, 0])])
            return np.array(found)

    both, drawn, none = told(8.0, 6.0, 20.0), told(0.0, 14.0, 30.0), told(0.0, 0.0, 30.0)
    little = told(1.0, 0.5, 30.0)

    np.testing.assert_allclose(both[:, 0], drawn[:, 0], atol=1e-9)
    np.testing.assert_allclose(both[7:, 0], none[:-7, 0], atol=1e-5)
    np.testing.assert_allclose(both[3:, 1], both[:-3, 0], atol=1e-9)
    np.testing.assert_allclose(none[:, 1], none[:, 0], atol=1e-12)
    # A quarter of a step.
    np.testing.assert_allclose(little[1:, 1], 0.75 * little[1:, 0] + 0.25 * little[:-1, 0], atol=1e-9)


def test_a_distractor_is_seen_where_it_was_put(visual: Simulator, config: RecordConfig) -> None:
    done = planned(visual, 0)
    qpos, images = done.recorded_states[0].qpos, []
    model = visual.scene.model
    for y in (-0.25, 0.25):
        place = (0.6, y, config.widened_table.top_height, 0.0)
        moved = replace(done.attempt, variation=replace(done.attempt.variation, distractors={"apple": place}))
        images.append(render_cameras(visual, moved, qpos, ["scene_camera"])["scene_camera"].astype(int))
        numbers = visual.renderer.render_geom_ids(visual.state_replay.data, "scene_camera")
        columns = np.nonzero(np.isin(numbers, np.flatnonzero(model.geom_bodyid == model.body("apple").id)))[1]
        # The camera looks back at the arm, so that +y is on its right.
        assert len(columns) > 10
        assert (columns > 48).all() == (y > 0)
    assert np.abs(images[0] - images[1]).max() > 60


@pytest.mark.slow
@pytest.mark.render
def test_lowdim_tells_the_camera_that_was(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("randomization",): "default"} | SMALL)
    with AttemptRunner(Session(config, locations), render=True) as runner:
        one, two = (load_frame(runner.run(AttemptJob(0, k)).files["lowdim/000000.pkl"]) for k in range(2))
    for key in ("intrinsics", "extrinsics"):
        assert not np.allclose(one[key]["scene_camera"], two[key]["scene_camera"], atol=1e-3)


@pytest.mark.render
def test_pictures_of_the_same_states_differ(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    """One renderer shows each attempt correctly, in any order."""

    def seen(simulator: Simulator, attempt: Attempt) -> np.ndarray:
        assert start is not None
        return render_cameras(simulator, attempt, start, ["scene_camera"])["scene_camera"].astype(int)

    with Simulator(Session(make_config(VISUAL | SMALL), locations)) as simulator:
        attempts = [sample_attempt(simulator, AttemptJob(0, k)) for k in range(4)]
        start = attempts[0].start
        images = [seen(simulator, attempt) for attempt in attempts]
        plain = seen(simulator, replace(attempts[0], variation=RandomizationSample()))
        np.testing.assert_array_equal(seen(simulator, attempts[1]), images[1])
    for k, image in enumerate(images):
        assert np.abs(image - plain).mean() > 5
        assert all(np.abs(image - other).mean() > 5 for other in images[:k])
