"""Cloth: its start, how hands hold and release it, and its record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.programs import FOLD, changed, first_attempt, session_of, started
from yamsim_cli.core.attempt_data import ActionSequence, FailureCause
from yamsim_cli.core.config.objects.cloth import object_keys_from_cloth
from yamsim_cli.core.dataset.checks.lowdim import expected_specs, frame_faults
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES, REPLAY_RULES
from yamsim_cli.core.episode.execution import simulate_actions, simulate_expert
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.geometry.cloth_contacts import count_self_intersections
from yamsim_cli.core.geometry.cloth_folding import outline_area
from yamsim_cli.core.scene.cloth import grid_edges, grid_triangles
from yamsim_cli.core.sim import cloth as crumple
from yamsim_cli.core.sim.cloth import ClothGraspConstraints, moving_points, simulate_pull
from yamsim_cli.core.sim.geom_shapes import geom_aabb
from yamsim_cli.core.sim.sim_world import make_sim_world


def test_cloth_starts_flat_and_turned_on_the_table_and_at_rest(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, attempt, data = started(simulators)
        scene = simulator.scene
        assert attempt.layout is not None
        world = make_sim_world(scene, data, arm_sides(simulator.config))
        points = world.cloth_points("napkin")
        assert points.shape == (9, 9, 3)
        assert world.are_touching("napkin", "table") and not world.holding_sides("napkin")
        # It sinks in by less than a tenth of its thickness.
        assert np.allclose(points[..., 2], simulator.config.widened_table.top_height + 0.0025, atol=5e-4)
        along = points[0, -1] - points[0, 0]
        assert np.linalg.norm(along) == pytest.approx(0.2, rel=1e-3)
        T = attempt.layout.T_in_world["napkin"]
        assert np.allclose(T[:3, 0], along / np.linalg.norm(along), atol=1e-3)
        assert np.allclose(T[:3, 3], points.reshape(-1, 3).mean(axis=0), atol=1e-9)
        assert scene.model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE


@pytest.mark.slow
def test_crumpled_cloth_starts_at_rest_and_differs_by_seed_alone(tmp_path: Path) -> None:
    crumpled = changed({("starts", "napkin", "crumpled"): [0.3, 0.6]}, FOLD)
    with SimulatorCache(session_of(tmp_path, crumpled)) as simulators:
        starts = []
        # Regression: dropped this way, cloth went through itself, or was flat.
        for number in (0, 1, 0):
            simulator, attempt = first_attempt(simulators, number)
            assert attempt.start is not None
            starts.append(attempt.start)
            points = simulator.scene.cloths["napkin"].points(attempt.start)
            # Flat, it is 200 mm wide, and no higher than a layer.
            assert np.ptp(points[:, 2]) > 0.015
            assert points[:, 2].min() > simulator.config.widened_table.top_height
            grid = simulator.scene.cloths["napkin"].grid
            assert not count_self_intersections(points, grid_edges(*grid), grid_triangles(*grid))
        assert np.array_equal(starts[0], starts[2])
        assert np.abs(starts[0] - starts[1]).max() > 0.01


def test_cloth_that_fell_into_the_table_is_taken_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, attempt, _ = started(simulators)
        assert attempt.start is not None
        height = simulator.scene.cloths["napkin"].qpos[0, 2]
        sunk, standing = attempt.start.copy(), attempt.start.copy()
        sunk[height] -= 0.017
        standing[height] += 0.017
        falls = iter([sunk, standing])
        monkeypatch.setattr(crumple, "drop_cloth", lambda *given: next(falls))
        rng = np.random.default_rng(0)
        again = crumple.crumple_cloth(
            simulator.scene, attempt.start, "napkin", rng, 0.3, simulator.config.task.timing.timestep
        )
        assert np.array_equal(again, standing)


def test_a_finger_under_cloth_would_lift_it_and_one_on_it_would_not(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, _, data = started(simulators)
        scene, model = simulator.scene, simulator.scene.model
        world = make_sim_world(scene, data, arm_sides(simulator.config))
        cloth = scene.cloths["napkin"]
        assert not world.sides_with_finger_under_cloth("napkin")
        # Around the tip that is lowest now.
        tips = [k for k in range(model.ngeom) if "finger_collide" in model.geom(k).name]
        tip = min((geom_aabb(model, data, k)[0][2], k) for k in tips)
        for over, expected in ((0.001, 1), (-0.001, 0)):
            data.qpos[cloth.qpos] = [*(data.geom_xpos[tip[1], :2] + 0.005), tip[0] + over]
            mujoco.mj_forward(model, data)
            assert (data.contact.flex >= 0).any()
            assert len(world.sides_with_finger_under_cloth("napkin")) == expected


@pytest.mark.parametrize("release", ["clear", "touching"])
def test_contacts_of_fingers_that_release_cloth(tmp_path: Path, release: str) -> None:
    """With `clear`, they are off until the fingers close, have left the cloth, or the next attempt begins."""
    napkin = {"name": "napkin", "cloth": {"size_mm": [200, 200], "grid": [9, 9], "mass_g": 12, "release": release}}
    napkin |= object_keys_from_cloth(napkin)
    with SimulatorCache(session_of(tmp_path, changed({("things", "napkin", "of"): napkin}, FOLD))) as simulators:
        simulator, attempt, data = started(simulators)
        scene, model = simulator.scene, simulator.scene.model
        cloth, clear = scene.cloths["napkin"], release == "clear"
        constraints = ClothGraspConstraints(scene)
        fingers, pinch = scene.arms[0].fingers, data.site(f"{scene.arms[0].prefix}pinch_site").xpos.copy()
        assert fingers is not None and attempt.start is not None

        def command(opening: float) -> None:
            data.ctrl[fingers.ctrl] = opening
            assert constraints.update_grasps(data, data.ctrl) == [False, False]

        def are_touching(height: float = 0.0) -> bool:
            """Whether fingers touch the cloth if it lies flat at a height over the pinch frame."""
            data.qpos[cloth.qpos] = [*pinch[:2], pinch[2] + height]
            mujoco.mj_forward(model, data)
            with_cloth = data.contact.geom[(data.contact.flex >= 0).any(axis=1)].max(axis=1)
            return any("finger" in model.body(model.geom_bodyid[geom]).name for geom in with_cloth if geom >= 0)

        def release_cloth() -> None:
            data.eq_active[cloth.constraints[0, 0]] = True
            command(fingers.ctrl_range[1])

        assert are_touching()
        release_cloth()
        assert are_touching() != clear
        command(fingers.ctrl_range[1] - 0.001)
        assert are_touching() != clear
        command(fingers.ctrl_range[1] - 0.003)  # fingers close slowly
        assert are_touching()

        release_cloth()
        assert not are_touching(0.3)
        command(fingers.ctrl_range[1])  # the cloth is away
        assert are_touching()

        release_cloth()
        scene.reset(data, attempt.start)
        assert are_touching()


def test_what_a_pull_would_lead_to_changes_nothing(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, _, data = started(simulators)
        scene = simulator.scene
        cloth, before = scene.cloths["napkin"], data.qpos.copy()
        points = cloth.points(before).reshape(9, 9, 3)
        inwards = points[4, 4] - points[0, 0]
        after = simulate_pull(data, scene.model, cloth, [np.array([0])], [0.5 * inwards], arch=0.4, seconds=0.8)
        assert np.array_equal(data.qpos, before) and data.time == 0.0
        # The corner lies on the rest where it was brought; the opposite corner stays.
        assert np.allclose(after[0, 0, :2], (points[0, 0] + 0.5 * inwards)[:2], atol=0.01)
        assert 0.003 < after[0, 0, 2] - points[0, 0, 2] < 0.02
        assert np.allclose(after[8, 8], points[8, 8], atol=0.005)


def test_a_point_that_is_led_takes_the_cloth_along(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, _, data = started(simulators)
        model, cloth = simulator.scene.model, simulator.scene.cloths["napkin"]
        masses, inertias = model.body_mass.copy(), model.dof_M0.copy()
        corner, ends = np.array([0]), grid_edges(*cloth.grid)
        at, most = cloth.points(data.qpos)[corner], 0.0
        rest = np.linalg.norm(np.diff(cloth.flat_points[ends], axis=1)[:, 0], axis=1)
        with moving_points(model, data, cloth, corner) as lead:
            for _ in range(250):
                at[:, 2] += 0.3 * model.opt.timestep
                lead(at)
                lengths = np.linalg.norm(np.diff(cloth.points(data.qpos)[ends], axis=1)[:, 0], axis=1)
                most = max(most, float((lengths / rest).max()) - 1)
        points = cloth.points(data.qpos)
        # At 0.3 m, more than the napkin's length, the napkin hangs without stretching.
        assert np.allclose(points[corner], at) and points[:, 2].min() > 0.003
        assert most < 0.08
        assert np.array_equal(model.body_mass, masses) and np.array_equal(model.dof_M0, inertias)


@pytest.mark.slow
def test_crumpled_cloth_is_spread_out_by_hands_that_close_on_it(tmp_path: Path) -> None:
    spread = changed(
        {
            ("starts", "napkin", "crumpled"): [0.1, 0.3],
            ("expert",): [{"flatten": {"thing": "napkin"}}, {"fold": {"thing": "napkin", "how": "half"}}],
        },
        FOLD,
    )
    with SimulatorCache(session_of(tmp_path, spread)) as simulators:
        simulator, attempt = first_attempt(simulators)
        cloth = simulator.scene.cloths["napkin"]
        assert attempt.start is not None and np.ptp(cloth.points(attempt.start)[:, 2]) > 0.015
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        states = [cloth.points(state.qpos) for state in done.recorded_states]
        assert any(np.ptp(points[:, 2]) < 0.01 and _area(points) > 0.95 * 0.2**2 for points in states)


ONTO: dict[str, Any] = changed(
    {
        ("things", "cube"): {"of": "cube_red"},
        ("starts", "cube"): {"x": [0.34, 0.36], "y": [0.20, 0.22], "yaw_deg": [0, 10]},
        ("goal",): {"all": [{"on": {"thing": "cube", "surface": "napkin"}}], "for_s": 0.2},
        ("expert",): [{"pick": {"thing": "cube"}}, {"place": {"thing": "cube", "on": "napkin"}}],
    },
    FOLD,
)


@pytest.mark.slow
def test_what_is_put_onto_cloth_lies_on_it_as_high_as_it_is_thick(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, ONTO)) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        ended = done.recorded_states[-1].qpos
        assert attempt.start is not None
        address = simulator.scene.model.joint("cube").qposadr[0]
        higher = ended[address + 2] - attempt.start[address + 2]
        assert higher == pytest.approx(0.005, abs=0.0015)
        cloth = simulator.scene.cloths["napkin"]
        assert np.ptp(cloth.points(ended)[:, 2]) < 0.01


@pytest.mark.slow
def test_thirds_lie_on_each_other_and_what_is_folded_in_part_is_folded_on(tmp_path: Path) -> None:
    thirds = changed(
        {
            ("goal",): {"all": [{"folded": {"thing": "napkin", "how": "thirds"}}], "for_s": 0.2},
            ("expert",): [{"fold": {"thing": "napkin", "how": "thirds"}}],
        },
        FOLD,
    )
    with SimulatorCache(session_of(tmp_path, thirds)) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        assert len(done.recorded_states) > 100
        cloth = simulator.scene.cloths["napkin"]
        # The first third, two cells of 25 mm, was folded alone; from there, the last third is folded.
        halfway = next(
            state.qpos
            for state in done.recorded_states[40:]
            if np.ptp(cloth.points(state.qpos)[:, 2]) < 0.007
            and not state.actions.magnet.any()
            and _area(cloth.points(state.qpos)) < 0.8 * _area(cloth.points(attempt.start))
        )
        start = attempt.start.copy()
        start[cloth.qpos] = halfway[cloth.qpos]
        on = simulate_expert(simulator, replace(attempt, start=start))
        assert on.outcome.success, on.outcome
        assert len(on.recorded_states) < 0.7 * len(done.recorded_states)


def _area(points: np.ndarray) -> float:
    return outline_area(points[:, :2])


@pytest.mark.slow
def test_hands_hold_cloth_only_while_they_close_on_it(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        states = done.recorded_states
        acting = ActionSequence(
            *(np.concatenate([getattr(state.actions, key) for state in states]) for key in ("ctrl", "magnet", "joints"))
        )
        held = np.flatnonzero(acting.magnet.all(axis=1))
        assert held[0] > 0 and held[-1] < len(acting.magnet) - 1
        assert not acting.magnet[[0, -1]].any()

        again = simulate_actions(simulator, attempt, replace(acting, magnet=np.zeros_like(acting.magnet)), EXPERT_RULES)
        for one, other in zip(states, again.recorded_states, strict=True):
            assert np.array_equal(one.qpos, other.qpos)
            assert np.array_equal(one.actions.magnet, other.actions.magnet)

        recorded = frame_records(simulator, attempt, states[:2])
        cameras = list(simulator.scene.cameras)
        assert not frame_faults(recorded[0], expected_specs(["napkin"], cameras, 2, 7, cloths={"napkin": (9, 9)}))
        assert recorded[0]["grasp"] == "cloth_constraint"

        ctrl = acting.ctrl.copy()
        for arm in simulator.scene.arms:
            assert arm.fingers is not None
            ctrl[(held[0] + held[-1]) // 2 :, arm.fingers.ctrl] = arm.fingers.ctrl_range[1]
        dropped = simulate_actions(simulator, attempt, replace(acting, ctrl=ctrl), REPLAY_RULES)
        assert not dropped.outcome.success
        assert simulate_expert(simulator, attempt, grips=False).outcome.cause is FailureCause.SLIPPED


@pytest.mark.parametrize(
    ("task", "given", "said"),
    [
        (changed({("things", "napkin", "of"): "soft_nakin"}, FOLD), {}, "soft_napkin"),
        (changed({("expert",): [{"pick": {"thing": "napkin"}}]}, FOLD), {}, "it can only be folded"),
        (changed({("things", "napkin", "of"): "cube_red"}, FOLD), {}, "is not cloth"),
        (
            changed(
                {
                    ("things", "napkin", "of"): "soft_dish_towel",
                    ("expert",): [{"fold": {"thing": "napkin", "how": "diagonal"}}],
                },
                FOLD,
            ),
            {},
            "equally many points along both sides, not 9 x 13",
        ),
        (
            changed({("expert",): [{"fold": {"thing": "napkin", "how": "quarters"}}]}, FOLD),
            {},
            "'diagonal' or 'thirds'",
        ),
        (changed({("rig",): "single_linear"}, FOLD), {}, "needs two arms"),
        (changed({("starts", "napkin", "attitudes"): ["lying"]}, FOLD), {}, "starts flat"),
        (changed({("starts", "cube", "crumpled"): [0.3, 0.6]}, ONTO), {}, "cannot crumple"),
        (changed({("starts", "napkin", "crumpled"): [0.6, 0.3]}, FOLD), {}, "must not be above"),
        (changed({("starts", "napkin", "crumpled"): [0.0, 0.3]}, FOLD), {}, "greater than or equal to 0.1"),
        (changed({("starts", "napkin", "open"): {"lid": [0, 1]}}, FOLD), {}, "no part"),
    ],
)
def test_impossible_uses_of_cloth_are_refused(
    tmp_path: Path, task: dict[str, Any], given: dict[str, Any], said: str
) -> None:
    with pytest.raises((ConfigError, UsageError), match=said):
        session_of(tmp_path, task, **given)
