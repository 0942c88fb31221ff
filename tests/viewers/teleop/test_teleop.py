"""The teleoperated arm, its streams, and `yamsim teleop --input` as a user runs it; the page is in tests/e2e."""

from __future__ import annotations

import errno
import json
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.core.dataset.making import failed_attempt, made
from tests.viewers.teleop.demonstrated import TICK, planned_lines, write_stream
from tests.viewers.teleop.tray import CollectingReceiver
from yamsim_cli.core.attempt_data import Attempt, AttemptJob, AttemptPayload, FailureCause, Outcome
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import AttemptRecord, EpisodeRecord, to_json
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.ledger import Ledger
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.episode.episode_rules import REPLAY_RULES
from yamsim_cli.core.episode.execution import SimulatedAttempt, simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, pose, quat_from_rotation
from yamsim_cli.core.scene.build import with_mesh_descriptions
from yamsim_cli.viewers.teleop.attempt_writer import AttemptWriter, TeleopAttemptRenderer
from yamsim_cli.viewers.teleop.command_stream import StreamPlayer, read_stream
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene
from yamsim_cli.viewers.teleop.teleop_session import TickClock, TickJitter, open_teleop


@pytest.fixture
def tray() -> CollectingReceiver:
    return CollectingReceiver()


@pytest.fixture
def driven(config: RecordConfig, locations: Locations, tray: CollectingReceiver) -> TeleopScene:
    return TeleopScene(Session(config, locations), tray)


def pinch(driven: TeleopScene) -> Array:
    """Position of the hand in physics."""
    site = driven.data.site("pinch_site")
    return pose(site.xpos, site.xmat.reshape(3, 3))


def run(driven: TeleopScene, seconds: float) -> None:
    for _ in range(round(seconds / driven.tick_seconds)):
        driven.advance_tick()


def player_of(driven: TeleopScene, lines: list[dict[str, Any]], folder: Path) -> StreamPlayer:
    stream = write_stream(folder / "stream.jsonl", lines)
    return StreamPlayer(read_stream(stream, driven.config))


def play(driven: TeleopScene, lines: list[dict[str, Any]], folder: Path) -> None:
    player = player_of(driven, lines, folder)
    while not player.is_done:
        player.apply_due_commands(driven, driven.simulated_seconds)
        driven.advance_tick()


def test_the_hand_goes_to_its_target(driven: TeleopScene) -> None:
    wanted = driven.target_pose
    wanted[:3, 3] += (0.08, 0.06, -0.05)
    driven.set_target_pose(wanted)
    run(driven, 2.0)
    assert np.allclose(pinch(driven)[:3, 3], wanted[:3, 3], atol=0.01)
    assert np.allclose(pinch(driven)[:3, :3], wanted[:3, :3], atol=0.05)
    status = driven.status
    assert (status.can_follow, status.target_distance, status.at_limit, status.obstacle) == (True, 0.0, (), "")


def test_no_joint_is_asked_to_move_faster_than_its_motor_can_follow(
    driven: TeleopScene, tray: CollectingReceiver
) -> None:
    driven.start_recording()
    wanted = driven.target_pose
    wanted[:3, 3] += (0.1, 0.3, -0.1)
    driven.set_target_pose(wanted)
    run(driven, 2.0)
    driven.stop_recording()
    driven.settle()
    joints = tray.actions.joints[:, 0, :6]
    speed = np.abs(np.diff(joints, axis=0)).max(axis=0) / driven.tick_seconds
    motors = np.array([52.5] * 3 + [200] * 3) * 2 * np.pi / 60
    assert (speed <= 0.5 * motors + 1e-9).all()
    assert speed[0] > 1.0, "and it does not dawdle"


def test_a_target_out_of_reach_is_told_with_its_distance(driven: TeleopScene) -> None:
    far = driven.target_pose
    far[:3, 3] = (1.2, 0.0, 0.2)
    driven.set_target_pose(far)
    run(driven, 3.0)
    assert 0.2 < driven.status.target_distance < 0.8
    assert not driven.status.can_follow
    assert np.isfinite(driven.data.qpos).all()


def test_a_joint_at_its_stop_is_named(driven: TeleopScene) -> None:
    driven.set_joint_target(np.array([0, 1.92, 2.22, -3.0, 0, 0]))
    run(driven, 2.0)
    assert driven.status.at_limit == ("joint4",)


def test_a_target_in_the_table_is_lifted_out_of_it(driven: TeleopScene, config: RecordConfig) -> None:
    below = driven.target_pose
    below[2, 3] = -0.2
    driven.set_target_pose(below)
    assert driven.target_pose[2, 3] == pytest.approx(config.widened_table.top_height + 0.012)
    run(driven, 3.0)
    assert pinch(driven)[2, 3] > config.widened_table.top_height


def test_the_arm_stops_before_the_table_and_says_so(driven: TeleopScene, config: RecordConfig) -> None:
    # Forearm first, which no target for the hand would cause.
    driven.set_joint_target(np.array([0, 2.8, 0.8, 0.0, 0, 0]))
    run(driven, 3.0)
    assert driven.status.obstacle == "table"
    model, data = driven.model, driven.data
    table = model.geom("table").id
    deepest = min((contact.dist for contact in data.contact if table in contact.geom), default=0.0)
    assert deepest > -0.005
    driven.set_joint_target(np.array(config.task.start_joints))
    run(driven, 3.0)
    assert driven.status.obstacle == "", "it can go back"
    assert np.allclose(data.qpos[:6], config.task.start_joints, atol=0.05)


def test_the_magnet_holds_only_what_the_hand_is_at(driven: TeleopScene) -> None:
    driven.set_weld(True)
    run(driven, 0.1)
    assert not driven.status.is_weld_holding
    assert not driven.status.magnet
    assert driven.message == "no object is within reach of the magnet"


def test_a_recording_begins_where_its_attempt_does_whatever_was_done_before(driven: TeleopScene) -> None:
    start = driven.data.qpos.copy()
    driven.set_joint_target(np.zeros(6))
    run(driven, 1.0)
    assert not np.allclose(driven.data.qpos, start, atol=0.1)
    driven.start_recording()
    assert np.array_equal(driven.data.qpos, start)
    assert driven.is_recording


def test_discarded_comes_again_and_stopped_comes_next(driven: TeleopScene, tray: CollectingReceiver) -> None:
    def banana() -> Array:
        place: Array = driven.data.body("banana").xpos.copy()
        return place

    first = banana()
    driven.start_recording()
    run(driven, 0.2)
    driven.discard_recording()
    assert (tray.attempts, driven.is_recording, driven.discarded) == ([], False, 1)
    assert np.array_equal(banana(), first)
    driven.start_recording()
    run(driven, 0.2)
    driven.stop_recording()
    driven.settle()
    assert [submitted.attempt.job.attempt for submitted in tray.attempts] == [0]
    assert not np.allclose(banana(), first)
    driven.stop_recording()
    assert len(tray.attempts) == 1
    assert driven.message == "no recording was in progress"


def test_a_stop_lets_go_and_waits_whatever_is_asked_meanwhile(
    driven: TeleopScene, tray: CollectingReceiver, config: RecordConfig
) -> None:
    driven.start_recording()
    driven.toggle_gripper()
    run(driven, 0.5)
    driven.stop_recording()
    ticks = config.task.timing.settle_ticks + config.task.hold_ticks
    for k in range(ticks):
        assert driven.is_recording, k
        assert not tray.attempts
        driven.set_joint_target(np.zeros(6))
        driven.toggle_gripper()
        driven.set_weld(True)
        driven.advance_tick()
    assert not driven.is_recording
    actions = tray.actions
    assert not actions.magnet.any()
    assert (actions.joints[-ticks:] == actions.joints[-1]).all()
    assert actions.joints[-1, 0, 6] == 0.0375
    assert actions.joints[-ticks - 1, 0, 6] == 0.0165


OBJECT = ("task", "things", "object", "of")
THINGS = ["007_tuna_fish_can", "008_pudding_box", "025_mug"]


@pytest.mark.parametrize("thing", THINGS)
def test_a_wider_gripper_opens_as_wide_as_it_goes(
    thing: str, make_config: Callable[..., RecordConfig], locations: Locations, tray: CollectingReceiver
) -> None:
    """The crank's fingers end at 37.5 mm; larger objects need linear_4310."""
    config = make_config({("rig",): "single_linear", OBJECT: thing})
    grasp = config.task.things["object"].of[0].grasp
    assert grasp is not None
    assert grasp.opening > 0.0375 - 0.003
    driven = TeleopScene(Session(config, locations), tray)
    driven.set_gripper(0.0475)
    run(driven, 1.0)
    fingers = driven.attempt_scene.scene.first_arm.fingers.qpos
    assert np.abs(driven.data.qpos[fingers]) == pytest.approx(0.0475, abs=0.001)
    assert driven.status.gripper_open
    for opening, is_open in ((grasp.opening, False), (0.0475, True)):
        driven.toggle_gripper()
        run(driven, 1.0)
        assert np.abs(driven.data.qpos[fingers]) == pytest.approx(opening, abs=0.001)
        assert driven.status.gripper_open is is_open


def test_a_stream_takes_what_is_wide(
    make_config: Callable[..., RecordConfig], locations: Locations, tray: CollectingReceiver, tmp_path: Path
) -> None:
    config = make_config({("rig",): "single_linear", OBJECT: "025_mug", ("seed",): 1})
    driven = TeleopScene(Session(config, locations), tray)
    play(driven, planned_lines(config, locations, 0), tmp_path)
    driven.settle()
    (submitted,) = tray.attempts
    assert submitted.outcome.success, submitted.outcome.detail


@pytest.fixture
def varied(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("randomization",): "default", ("randomization", "distractors", "count"): [3, 3]})


@pytest.mark.slow
def test_distractors_are_out_of_the_way_and_stand_where_nothing_came(
    varied: RecordConfig, locations: Locations, tray: CollectingReceiver, tmp_path: Path
) -> None:
    driven = TeleopScene(Session(varied, locations), tray)
    others = [driven.model.body(item.name).id for item in varied.randomization.distractor_configs]
    wanted = driven.target_pose
    wanted[:3, 3] += (0.08, 0.06, -0.05)
    driven.set_target_pose(wanted)
    run(driven, 2.0)
    assert np.allclose(pinch(driven)[:3, 3], wanted[:3, 3], atol=0.01), driven.status.obstacle
    assert (driven.data.xpos[others, 2] < -1).all()

    play(driven, planned_lines(varied, locations, 0, began=driven.simulated_seconds), tmp_path)
    driven.settle()
    (submitted,) = tray.attempts
    with TeleopAttemptRenderer(Session(varied, locations), render=False) as runner:
        payload = runner.run(submitted)
        again = runner.run(submitted)
    assert payload.outcome.success, payload.outcome.detail
    variation = payload.attempt.variation
    assert variation == again.attempt.variation
    assert set(variation.mass) == {"banana", "plate"}
    places = np.array(list(variation.distractors.values()))
    assert len(places) >= 2
    assert (np.linalg.norm(places[:, :2], axis=1) > 0.2).all(), "not where the arm stands"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["config", "varied"])
def test_what_is_recorded_repeats_bit_for_bit(
    name: str, request: pytest.FixtureRequest, locations: Locations, tray: CollectingReceiver, tmp_path: Path
) -> None:
    """The recorded actions lead to the same states and verdict, also with varied masses and friction."""
    config: RecordConfig = request.getfixturevalue(name)
    driven = TeleopScene(Session(config, locations), tray)
    seen: list[Array] = []
    player = player_of(driven, planned_lines(config, locations, 0), tmp_path)
    while not player.is_done:
        player.apply_due_commands(driven, driven.simulated_seconds)
        seen.append(driven.data.qpos.copy())
        driven.advance_tick()
    driven.settle()
    (submitted,) = tray.attempts
    with Simulator(Session(config, locations)) as simulator:
        done = simulate_actions(simulator, submitted.attempt, tray.actions, REPLAY_RULES)
    assert done.outcome.success, done.outcome.detail
    assert done.outcome == submitted.outcome
    every = config.task.timing.ticks_per_frame
    for state, qpos in zip(done.recorded_states, seen[::every], strict=False):
        assert np.array_equal(state.qpos, qpos)


def test_an_end_effector_stream_is_the_frames_own_ee_pose(driven: TeleopScene, tmp_path: Path) -> None:
    grasp = driven.data.site("grasp_site")
    T = pose(grasp.xpos, grasp.xmat.reshape(3, 3))
    T[:3, 3] += (0.05, -0.05, -0.03)
    as_quaternion = {"position": T[:3, 3].tolist(), "quaternion": quat_from_rotation(T[:3, :3]).tolist()}
    for k, ee in enumerate((T.tolist(), as_quaternion)):
        driven.reset()
        began = driven.simulated_seconds
        play(driven, [{"t": began, "ee": ee}, {"t": began + 2.0}], tmp_path)
        assert np.allclose(driven.data.site("grasp_site").xpos, T[:3, 3], atol=0.01), k


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([{"t": 0, "joints": [0, 0]}], "stream.jsonl:1: joints"),
        ([{"t": 0, "jonts": [0] * 6}], "stream.jsonl:1: jonts"),
        ([{"t": 0}, {"t": -1}], "stream.jsonl:2: t"),
        ([{"t": 2}, {"t": 1}], "t 1 is before 2 of the line above"),
        ([{"t": 0, "event": "pause"}], "stream.jsonl:1: event"),
        ([{"t": 0, "joints": [0] * 6, "ee": np.eye(4).tolist()}], "give joints or ee, not both"),
        ([{"t": 0, "ee": np.zeros((4, 4)).tolist()}], "is not a rotation"),
        ([{"t": 0, "joints": [float("nan")] * 6}], "stream.jsonl:1: joints"),
        ([{"t": 0, "joints": [0] * 7}], "joints: 7 numbers; give 6 of the right arm$"),
        ([{"t": 0, "joints": [0] * 14}], "joints: 14 numbers; give 6 of the right arm$"),
        ([{"t": 0, "arm": "left"}], "stream.jsonl:1: arm: the rig has only a right arm"),
        (
            [{"t": 0}, {"t": 1, "joints": [0, 106, 109, -78, 0, 0]}],
            r"stream.jsonl:2: joints: arm1.joint2: 106 rad lies outside 0..3.665; is it in degrees\? Then give 1.85",
        ),
        ([{"t": 0, "joints": [0, 4.6, 1, 0, 0, 0]}], r"arm1.joint2: 4.6 rad lies outside 0..3.665$"),
        ([{"t": 0, "gripper": 37.5}], r"stream.jsonl:1: gripper: must lie in 0..0.1 m; is it in mm\? Then give 0.0375"),
        (
            [{"t": 0, "ee": {"position": [400, 0, 200], "quaternion": [1, 0, 0, 0]}}],
            r"stream.jsonl:1: ee.position.0: must lie in -10..10 m; is it in mm\? Then give 0.4",
        ),
        ([{"t": 1.7e12}], "stream.jsonl:1: t: must lie in 0..86400 s"),
        ([], "is empty"),
    ],
)
def test_a_faulty_stream_is_named_by_line(
    lines: list[dict[str, Any]], message: str, tmp_path: Path, config: RecordConfig, locations: Locations
) -> None:
    with pytest.raises(ConfigError, match=message):
        read_stream(write_stream(tmp_path / "stream.jsonl", lines), config)


def test_a_leader_that_turns_a_little_farther_is_believed(
    tmp_path: Path, config: RecordConfig, locations: Locations
) -> None:
    lines = [{"t": 0, "joints": [0, -0.4, 1, 0, 0, 0]}]
    assert read_stream(write_stream(tmp_path / "stream.jsonl", lines), config)


def test_joints_of_both_arms_in_a_row_are_checked(
    tmp_path: Path, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    russet = make_config({("rig",): "russet"})
    still = [0, 1, 1, 0, 0, 0]
    for row, fault in (
        ([*still, 0.03, *np.rad2deg(still), 0.03], r"joints: arm1.joint2: 57.3 rad .*degrees"),
        ([*np.rad2deg(still), 0.03, *still, 0.03], r"joints: arm2.joint2: 57.3 rad .*degrees"),
        ([*still, 0.03, *still, 37.5], r"joints: must lie in -0.02..0.1 m; is it in mm\? Then give 0.0375"),
    ):
        stream = write_stream(tmp_path / "stream.jsonl", [{"t": 0, "joints": list(map(float, row))}])
        with pytest.raises(ConfigError, match=fault):
            read_stream(stream, russet)


def pace_of(slow: tuple[float, ...], monkeypatch: pytest.MonkeyPatch) -> tuple[TickJitter, float]:
    """Return the jitter of a loop whose turns take given times, s, and the start of its last turn."""
    now = [0.0]
    monkeypatch.setattr("yamsim_cli.viewers.teleop.teleop_session.time.monotonic", lambda: now[0])
    monkeypatch.setattr(
        "yamsim_cli.viewers.teleop.teleop_session.time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds)
    )
    pace, began = TickClock(TICK), 0.0
    for seconds in slow:
        pace.wait()
        began = now[0]
        now[0] += seconds
    assert pace.jitter
    return pace.jitter, began


def test_pace_tells_how_far_off_the_ticks_were(monkeypatch: pytest.MonkeyPatch) -> None:
    jitter, began = pace_of((0.0, 0.0, 0.04, 0.0, 0.0), monkeypatch)
    assert jitter.ticks == 5
    assert jitter.rate_hz == pytest.approx(31.25)
    # One tick is 8 ms late, and the next one earlier by the same: the clock is kept.
    assert began == pytest.approx(4 * TICK)
    assert jitter.max == pytest.approx(8.0)
    assert jitter.p50 == pytest.approx(4.0)
    assert (jitter.late, jitter.lost) == (0, 0)


def test_pace_catches_up_unless_it_is_far_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    # Due at 32, 64, 96 and 128 ms: begun at 100, 100, 100 and 128 ms.
    jitter, began = pace_of((0.1, 0.0, 0.0, 0.0, 0.0), monkeypatch)
    assert (jitter.late, jitter.lost) == (2, 0)
    assert began == pytest.approx(4 * TICK)
    # Due at 32 ms, begun at 400 ms, and on the clock from there.
    jitter, began = pace_of((0.4, 0.0, 0.0), monkeypatch)
    assert jitter.late == 1
    assert jitter.lost == pytest.approx(400 - 32)
    assert began == pytest.approx(0.4 + TICK)


class FullDiskDataset:
    """A dataset on a full disk."""

    path = Path("full")
    episodes = 0
    missing: ClassVar[list[AttemptRecord]] = []

    def __init__(self) -> None:
        self.attempts: list[AttemptRecord] = []
        self.asked: list[int] = []

    def publish_episode(self, record: EpisodeRecord, files: dict[str, bytes]) -> None:
        raise AssertionError("nothing succeeded")

    def log_attempt(self, attempt: AttemptRecord) -> None:
        self.asked.append(attempt.attempt)
        raise TimeoutError(errno.ETIMEDOUT, "the server does not answer")


class Failing:
    """An executor whose jobs all fail."""

    def __init__(self) -> None:
        self.jobs: list[SimulatedAttempt] = []

    def submit(self, job: SimulatedAttempt) -> None:
        self.jobs.append(job)

    def next_result(self, timeout: float | None = None) -> tuple[SimulatedAttempt, AttemptPayload]:
        job = self.jobs.pop()
        return job, AttemptPayload(job.attempt, Outcome(False, FailureCause.OFF_TARGET))


def test_what_the_disk_refuses_is_raised_and_nothing_after_it_is_written(config: RecordConfig) -> None:
    sink = FullDiskDataset()
    with AttemptWriter(config, sink, Failing()) as writer:  # type: ignore[arg-type]
        for number in range(2):
            assert writer.next_attempt == number
            writer.submit(
                SimulatedAttempt(Attempt(AttemptJob(0, number)), Outcome(False, FailureCause.OFF_TARGET), None)
            )
        with pytest.raises(TimeoutError, match="does not answer"):
            writer.next_written(timeout=5)
        time.sleep(0.1)  # s, in which the writer's thread reaches the second attempt
    assert sink.asked == [0]


@pytest.mark.render
def test_a_damaged_ledger_line_loses_its_attempt_alone(
    config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    """A demonstration cannot be repeated; its line states so."""
    out = tmp_path / "out"
    with DatasetWriter(
        out, with_mesh_descriptions(Session(config, locations)).config.data_config(), ExistingDatasetMode.NEW
    ) as writer:
        for k in range(3):
            writer.log_attempt(failed_attempt(k))
    lines = (out / "attempts.jsonl").read_bytes().splitlines(keepends=True)
    (out / "attempts.jsonl").write_bytes(b"{\n" + b"".join(lines[1:]) + to_json(made(0, 3).attempt))
    said: list[str] = []
    for _ in range(2):
        with open_teleop(Session(config, locations), out, ExistingDatasetMode.RESUME, said.append) as session:
            assert session.attempts.next_attempt == 4
    assert said[0].startswith("attempts.jsonl was damaged (line 1: ")
    assert said[1:] == [
        "the line of attempt 0 in attempts.jsonl is lost",
        *["ep_000000 is missing, and a teleoperated episode cannot be recorded again."] * 2,
    ]
    assert [attempt.outcome.cause for attempt in Ledger(out).known_attempts.values()] == [
        "line_lost",
        *["off_target"] * 2,
        None,
    ]


@pytest.mark.slow
def test_a_stream_makes_a_dataset_that_summarize_and_verify_accept(
    config: RecordConfig, locations: Locations, tmp_path: Path
) -> None:
    lines = [{"t": 0, "event": "start"}, {"t": 0.5, "event": "discard"}, *planned_lines(config, locations, 0, 1.0)]
    # Another attempt without actions, and one that is unfinished at the end.
    after = lines[-1]["t"] + 0.5
    lines += [{"t": after, "event": "start"}, {"t": after + 0.5, "event": "stop"}]
    lines += [{"t": after + 1, "event": "start"}, {"t": after + 1.2}]
    stream, out = write_stream(tmp_path / "stream.jsonl", lines), tmp_path / "d"
    small = ("--size", "64x48", "--quality", "fast", "--wrist")
    done = yamsim("teleop", "--input", str(stream), "--out", str(out), "--json", *small)
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert (report["episodes"], report["attempts"], report["discarded"]) == (1, 3, 1)
    assert [trial["episode"] for trial in report["trials"]] == [0, None, None]
    record = json.loads((out / "ep_000000" / "episode.json").read_text())
    assert (record["source"], record["attempt"], set(record["cameras"])) == (
        "teleop",
        0,
        {"scene_camera", "right_wrist_camera"},
    )
    summary = yamsim("summarize", str(out), "--strict", "--json")
    assert summary.code == 0, summary.out
    assert json.loads(summary.out)["problems"] == []
    verified = yamsim("verify", str(out), "--json")
    assert verified.code == 0, verified.out
    assert json.loads(verified.out)["max_error"] == 0

    # The same stream again gives the same data; longer streams only add data.
    again = tmp_path / "again"
    assert yamsim("teleop", "--input", str(stream), "--out", str(again), *small).code == 0
    assert json.loads((again / "ep_000000" / "episode.json").read_text())["files"] == record["files"]
    assert yamsim("teleop", "--input", str(stream), "--out", str(out), *small).code == 2
    last = write_stream(tmp_path / "more.jsonl", planned_lines(config, locations, 3))
    more = yamsim("teleop", "--input", str(last), "--out", str(out), "--resume", "--realtime", "--json", *small)
    report = json.loads(more.out)
    assert (report["episodes"], report["attempts"], report["trials"][0]["attempt"]) == (2, 4, 3)
    assert report["jitter_ms"]["rate_hz"] == pytest.approx(31.25)
    assert yamsim("summarize", str(out), "--strict").code == 0


@pytest.mark.slow
@pytest.mark.render
def test_a_signal_ends_the_page_with_what_there_is(tmp_path: Path, repository: Path) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    command = [sys.executable, "-m", "yamsim_cli", "teleop", "--port", "0", "--out", str(tmp_path / "d"), "--json"]
    process = subprocess.Popen(
        command, cwd=repository, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    )
    try:
        assert process.stderr is not None
        said = ""
        while not (found := re.search(r"^http://127\.0\.0\.1:(\d+) ", said, re.MULTILINE)):
            line = process.stderr.readline()
            assert line, said
            said += line
        with urllib.request.urlopen(f"http://127.0.0.1:{found[1]}", timeout=10) as answer:
            assert answer.status == 200
        # Some ticks, whose jitter is reported.
        time.sleep(2)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, err.count("\n")) == (0, 1), err
    report = json.loads(out)
    assert (report["episodes"], report["attempts"], report["trials"]) == (0, 0, [])
    assert report["jitter_ms"]["rate_hz"] == pytest.approx(31.25)
    assert {"ticks", "p50", "p95", "max", "late", "lost"} < report["jitter_ms"].keys()
    assert (tmp_path / "d" / "manifest.json").is_file()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(found[1]))) != 0


@pytest.mark.render
def test_faults_are_one_line(tmp_path: Path) -> None:
    missing = yamsim("teleop", "--input", str(tmp_path / "none.jsonl"))
    assert (missing.code, "cannot be read" in missing.message) == (3, True)
    assert yamsim("teleop", "--realtime").code == 2
    assert yamsim("teleop", "--input", "s.jsonl", "--port", "1").code == 2
    out = tmp_path / "d"
    stream = str(write_stream(tmp_path / "s.jsonl", [{"t": 0}]))
    left = yamsim("teleop", "--arm", "left", "--input", stream, "--out", str(out))
    assert (left.code, "--arm: arm 'left': rig 'single' has only a right arm" in left.message) == (2, True)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = yamsim("teleop", "--port", str(taken.getsockname()[1]), "--out", str(out))
    assert (busy.code, "cannot be used" in busy.err) == (4, True)
    assert not out.exists(), "nothing is in the way of the next try"
