"""Policies of other programs in trials: observations, arm order, and robustness against servers."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.policies.servers import act_server, openpi_server, raw_server, read_request
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config, validate_file
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.action_chunks import ChunkSettings
from yamsim_cli.policies.evaluate.evaluation import Evaluation, describe_objects, evaluation_report
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_factory import make_policy, policy_station
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialResult, TrialRunner
from yamsim_cli.policies.external_policy import MappedPolicy, PolicyScene
from yamsim_cli.policies.openpi import pack_openpi, unpack_openpi
from yamsim_cli.policies.policy_protocol import InvalidActionError

pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
pytest.importorskip("websockets", reason="yamsim[remote] is not installed")

HERE = Path(__file__).parent

# Mapping with further values for the served expert: trial and time.
EXPERT = "gripper: share\nstate: {key: state, dtype: float64}\nprompt: instruction\ntime: time\nseed: seed\n"
ONE = EXPERT + "actions: {key: actions, hz: 31.25, weld: true}\n"


class RecordingClient:
    """A client with given answers, which records its messages."""

    def __init__(self, **answer: Any) -> None:
        self.answer = answer
        self.asked: list[Mapping[str, Any]] = []

    def begin_trial(self, seed: int) -> None:
        self.seed = seed

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        self.asked.append(message)
        return self.answer

    def close(self) -> None:
        pass


STATION = PolicyScene(
    "station", ("left", "right"), 7, (0.05, 0.04),
    {"left_wrist": "left_wrist_rgb", "right_wrist": "right_wrist_rgb", "top": "top_rgb", "scene": "scene_rgb"},
)  # fmt: skip
OBSERVED = {
    "joints": np.array([0, 1, 2, 3, 4, 5, 0.025, 10, 11, 12, 13, 14, 15, 0.04]),
    "prompt": "do it",
    "time": 1.5,
    **{
        f"{name}_rgb": np.full((48, 64, 3), k, np.uint8)
        for k, name in enumerate(("top", "left_wrist", "right_wrist"), start=1)
    },
}


@pytest.fixture
def mapped(locations: Locations) -> Callable[..., tuple[Any, MappedPolicy]]:
    def make(name: str, **answer: Any) -> tuple[RecordingClient, MappedPolicy]:
        client = RecordingClient(**answer)
        return client, MappedPolicy(client, load_config(PolicyConfig, "policies", name, locations), STATION)

    return make


def test_molmoact2_is_told_what_its_own_client_tells_it(mapped: Callable[..., tuple[Any, MappedPolicy]]) -> None:
    rows = np.tile(np.array([*range(6), 1.0, *range(10, 16), 0.5]), (30, 1))
    client, policy = mapped("molmoact2_yam", actions=rows, dt_ms=40)
    assert set(policy.images) == {"top", "left_wrist", "right_wrist"}
    policy.reset(7)
    told = policy(OBSERVED)
    message = client.asked[0]
    assert set(message) == {"top_cam", "left_cam", "right_cam", "instruction", "state", "num_steps"}
    for key, value in (("top_cam", 1), ("left_cam", 2), ("right_cam", 3)):
        assert (message[key].shape, message[key].dtype) == ((224, 224, 3), np.uint8)
        assert (message[key] == value).all()
    assert message["state"].dtype == np.float32
    np.testing.assert_allclose(message["state"], [*range(6), 0.5, *range(10, 16), 1.0])
    assert (message["instruction"], message["num_steps"]) == ("do it", 10)
    np.testing.assert_allclose(told["ctrl"][29], [*range(6), 0.05, *range(10, 16), 0.02])
    assert (told["period"], "magnet" in told) == (0.04, False)
    client.answer = {"actions": rows}
    assert policy(OBSERVED)["period"] == 1 / 30


def test_openpi_is_told_what_its_aloha_policy_expects(mapped: Callable[..., tuple[Any, MappedPolicy]]) -> None:
    client, policy = mapped("openpi_aloha", actions=np.zeros((50, 14)))
    told = policy(OBSERVED)
    message = client.asked[0]
    assert set(message) == {"images", "state", "prompt"}
    assert set(message["images"]) == {"cam_high", "cam_left_wrist", "cam_right_wrist"}
    high = message["images"]["cam_high"]
    assert (high.shape, high.dtype) == ((3, 224, 224), np.uint8)
    # 64 x 48 becomes 224 x 168, with black above and below.
    assert (high[:, :28] == 0).all() and (high[:, 28:196] == 1).all() and (high[:, 196:] == 0).all()
    assert (told["ctrl"].shape, told["period"]) == ((50, 14), 0.02)


def test_the_makers_servers_are_told_what_its_client_tells_them(
    mapped: Callable[..., tuple[Any, MappedPolicy]],
) -> None:
    client, policy = mapped("maker", actions=np.zeros((30, 14)))
    assert (policy(OBSERVED)["ctrl"].shape, policy.lead) == ((30, 14), None)
    message = client.asked[0]
    assert set(message) == {"images", "state", "prompt"}
    for role, value in (("top", 1), ("left", 2), ("right", 3)):
        image = message["images"].pop(role)
        assert (image.shape, image.dtype) == ((48, 64, 3), np.uint8)
        assert (image == value).all()
    assert message["images"] == {}


def test_real_time_chunking_sends_the_end_of_the_plan(mapped: Callable[..., tuple[Any, MappedPolicy]]) -> None:
    rows = np.arange(30.0)[:, None] / 30 + np.zeros(14)
    client, policy = mapped("maker_rtc", actions=rows)
    policy.reset(0)
    state = np.array([*range(6), 0.5, *range(10, 16), 1.0], np.float32)
    for _ in range(2):
        for wanted in (np.tile(state, (4, 1)), rows[15:19], rows[15:19]):
            told = policy(OBSERVED)
            message = client.asked[-1]
            assert set(message) == {"images", "state", "prompt", "action_prefix", "prefix_length"}
            prefix = message["action_prefix"]
            assert (prefix.dtype, message["prefix_length"]) == (np.float32, 4)
            np.testing.assert_allclose(prefix, wanted, atol=1e-6)
            # Without the repeated ones, fifteen.
            np.testing.assert_allclose(told["ctrl"][:, 0], rows[4:19, 0])
        policy.reset(1)
    client.answer = {"actions": rows[:4]}
    with pytest.raises(InvalidActionError, match="has 4 actions; realtime_chunking needs more than 4"):
        policy(OBSERVED)


REALTIME = ONE.replace("hz: 31.25", "hz: 30") + "realtime_chunking: {length: 2, execute: 8, lead: 3}\n"


def serve_continued(pause: float) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Serve a plan that goes on from its given end, after a real pause (s)."""

    def infer(message: Mapping[str, Any]) -> dict[str, Any]:
        assert set(message) == {"state", "instruction", "time", "seed", "action_prefix", "prefix_length"}
        prefix = message["action_prefix"].astype(float)
        assert (len(prefix), message["prefix_length"]) == (2, 2)
        time.sleep(pause)
        further = prefix[-1] + 0.01 * np.arange(1, 11)[:, None] * (np.arange(8) == 0)
        return {"actions": np.concatenate([prefix, further]), "observed": message["state"]}

    return infer


def test_late_chunks_are_late_by_simulated_time(locations: Locations, config: RecordConfig, tmp_path: Path) -> None:
    """At any speed of the server, a fixed latency gives the same trial; the plan goes on without a jump."""
    (tmp_path / "one.yaml").write_text(REALTIME)
    chunking = ChunkSettings(latency=0.2)
    found = []
    for pause in (0.0, 0.03):
        infer = serve_continued(pause)
        with openpi_server(lambda data, infer=infer: pack_openpi(infer(unpack_openpi(data)))) as url:  # type: ignore[misc]
            choice = PolicyChoice(url, HERE, time_limit=1.6, mapping=str(tmp_path / "one.yaml"), chunking=chunking)
            with TrialRunner(Session(config, locations), choice) as runner:
                found.append(runner.run(AttemptJob(0, 0)))
    assert [trial.error for trial in found] == ["", ""]
    first, second = (trial.actions for trial in found)
    assert first is not None and second is not None
    np.testing.assert_array_equal(first.ctrl, second.ctrl)
    assert found[0].chunk_stats == found[1].chunk_stats
    # Seven ticks until the first chunk. Three actions and a half tick are shorter than the latency.
    count = found[0].chunk_stats
    assert (count.stale, count.waited > 7) == (0, True)
    moved = np.diff(first.ctrl[7:, 0])
    assert set(np.round(moved, 6)) == {0.0, 0.01}


def test_flags_that_real_time_chunking_decides_are_refused(
    locations: Locations, config: RecordConfig, tmp_path: Path
) -> None:
    (tmp_path / "one.yaml").write_text(REALTIME)
    with openpi_server(lambda data: b"\x80") as url:
        choice = PolicyChoice(url, HERE, mapping=str(tmp_path / "one.yaml"), chunking=ChunkSettings(execute=4))
        with pytest.raises(UsageError, match="not for real-time chunking, which --policy-config one asks for"):
            TrialRunner(Session(config, locations), choice)


def test_arms_come_in_the_order_of_the_config(locations: Locations, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "arms: [right, left]\ngripper: metres\nstate: {key: s, dtype: float64}\nactions: {key: a, hz: 10, weld: true}\n"
    )
    config = validate_file(PolicyConfig, tmp_path / "mine.yaml", locations)
    client = RecordingClient(a=[*range(100, 107), *range(200, 207), 0, 1])
    told = MappedPolicy(client, config, STATION)(OBSERVED)
    np.testing.assert_array_equal(client.asked[0]["s"], [10, 11, 12, 13, 14, 15, 0.04, 0, 1, 2, 3, 4, 5, 0.025])
    np.testing.assert_array_equal(told["ctrl"], [[*range(200, 207), *range(100, 107)]])
    assert told["magnet"].tolist() == [[True, False]]


MAPPING = """\
gripper: metres
arms: [right, left]
actions: {key: a, hz: 10}
images: {a: {cameras: [top], size_px: [64, 64]}}
prompt: p
"""


@pytest.mark.parametrize(
    ("good", "wrong", "told"),
    [
        ("metres", "metre", "mine.yaml:1: gripper: 'metre' is not valid"),
        ("hz: 10", "hz: 0", "mine.yaml:3: actions.hz"),
        ("[right, left]", "[right, right]", "mine.yaml:2: arms"),
        ("[64, 64]", "[4, 4]", "mine.yaml:4: images.a"),
        ("prompt: p", "prompt: a", "mine.yaml:5: prompt: 'a' is also the key of images.a"),
    ],
)
def test_a_mapping_that_is_wrong_is_told_with_its_line(
    good: str, wrong: str, told: str, locations: Locations, tmp_path: Path
) -> None:
    (tmp_path / "mine.yaml").write_text(MAPPING.replace(good, wrong))
    with pytest.raises(ConfigError) as caught:
        validate_file(PolicyConfig, tmp_path / "mine.yaml", locations)
    assert str(caught.value).startswith(f"{tmp_path}/{told}"), str(caught.value)


def test_a_mapping_that_does_not_fit_the_rig_is_told(config: RecordConfig, locations: Locations) -> None:
    with act_server(lambda _: {}) as url, pytest.raises(UsageError) as caught:
        make_policy(PolicyChoice(url, HERE), policy_station(config), locations)
    assert str(caught.value) == (
        "--policy-config molmoact2_yam: arms: on rig 'single' there is no left arm; valid: right"
    )
    lone = PolicyScene("lone", ("left", "right"), 7, (0.05, 0.04), {"scene": "scene_rgb"})
    mapping = load_config(PolicyConfig, "policies", "openpi_aloha", locations)
    with pytest.raises(
        UsageError, match=r"images.cam_left_wrist: on rig 'lone' there is no camera left_wrist; valid: "
    ):
        MappedPolicy(RecordingClient(), mapping, lone)


def test_lerobot_that_is_not_installed_is_told(config: RecordConfig, locations: Locations) -> None:
    with pytest.raises(ResourceError, match=r"--policy lerobot:\S+: LeRobot is not installed: run `pip install"):
        make_policy(PolicyChoice("lerobot:nowhere", HERE), policy_station(config), locations)


@pytest.mark.parametrize(
    ("choice", "told"),
    [
        (PolicyChoice("scripted", HERE, arguments={"a": 1}), "--policy-arg is for a policy of your own"),
        (PolicyChoice("act://127.0.0.1:9", HERE, arguments={"a": 1}), "--policy-arg"),
        (PolicyChoice("hold_still", HERE, mapping="openpi_aloha"), "--policy-config is for policies of other programs"),
    ],
)
def test_flags_of_other_policies_are_refused(
    choice: PolicyChoice, told: str, config: RecordConfig, locations: Locations
) -> None:
    with pytest.raises(UsageError, match=told):
        make_policy(choice, policy_station(config), locations)


@pytest.mark.parametrize(
    ("other", "arguments", "mapping"),
    [
        ("act://127.0.0.1:9", {}, "mine"),
        ("lerobot:checkpoint", {}, "mine"),
        ("mine.py:Policy", {"gain": 2}, None),
        ("scripted", {}, None),
        ("http://127.0.0.1:9", {}, None),
    ],
)
def test_a_compared_policy_gets_the_same_config_and_keywords_where_it_takes_them(
    other: str, arguments: dict[str, int], mapping: str | None
) -> None:
    compared = PolicyChoice("a:B", HERE, 3.0, 4.0, arguments={"gain": 2}, mapping="mine").compared_with(other)
    assert (compared.name, compared.arguments, compared.mapping) == (other, arguments, mapping)
    assert (compared.folder, compared.call_seconds, compared.time_limit) == (HERE, 3.0, 4.0)


def test_a_compared_class_is_made_with_the_keywords_that_it_has(config: RecordConfig, locations: Locations) -> None:
    choice = PolicyChoice("a:B", HERE, arguments={"step": 0.5})
    samples = "tests.policies.sample_policies"
    made: Any = make_policy(choice.compared_with(f"{samples}:Chunked"), policy_station(config), locations)
    assert made.step == 0.5
    make_policy(choice.compared_with(f"{samples}:Still"), policy_station(config), locations)
    with pytest.raises(UsageError, match=r"Still\(\) takes no arguments"):
        make_policy(PolicyChoice(f"{samples}:Still", HERE, arguments={"step": 0.5}), policy_station(config), locations)


@pytest.mark.parametrize("rig", ["single", "single_linear", "russet", "yam_station_linear_4310_d405"])
def test_every_picture_of_an_export_is_known(
    rig: str, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    task = {"russet": "handover", "yam_station_linear_4310_d405": "tower"}.get(rig, "pickplace")
    config = make_config({("rig",): rig, ("task",): task, ("wrist",): True})
    wanted = [f"observation.images.{name}" for name in config.recorded_cameras]
    for name in ("lerobot_export", "lerobot_joints"):
        mapping = load_config(PolicyConfig, "policies", name, locations)
        policy = MappedPolicy(RecordingClient(), mapping, policy_station(config), wanted)
        assert len(policy.images) == len(wanted)


def expert_plans(config: RecordConfig, locations: Locations) -> tuple[list[TrialResult], dict[int, np.ndarray]]:
    """Return the scripted policy's trials, and its actions by the trial's seed: grippers as shares, welds last."""
    where, results, plans = policy_station(config), [], {}
    with TrialRunner(Session(config, locations), PolicyChoice("scripted", HERE)) as runner:
        for attempt in range(config.episodes):
            job = AttemptJob(config.seed, attempt)
            results.append(result := runner.run(job))
            assert result.actions is not None
            told = result.actions.ctrl[:, runner.simulators.get(job).scene.recorded_drive_ctrl].copy()
            told[:, :, -1] /= np.array(where.openings)
            rows = np.concatenate([told.reshape(len(told), -1), result.actions.magnet], axis=1)
            plans[(job.seed * 1_000_003 + job.attempt) % 2**32] = rows
    return results, plans


def serve_plans(plans: Mapping[int, np.ndarray], actions: int) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Serve the expert: the next actions of the trial's plan, and after its end the last one."""

    def infer(message: Mapping[str, Any]) -> dict[str, Any]:
        plan, now = plans[int(message["seed"])], round(float(message["time"]) / 0.032)
        return {"actions": plan[np.minimum(now + np.arange(actions), len(plan) - 1)]}

    return infer


@pytest.fixture(scope="module")
def experts(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> tuple[RecordConfig, list[TrialResult], dict[int, np.ndarray]]:
    config = make_config({("episodes",): 2, ("seed",): 2})
    return config, *expert_plans(config, locations)


@pytest.fixture(params=["act", "ws"])
def serve(request: pytest.FixtureRequest) -> Callable[[Callable[[Mapping[str, Any]], Any]], Any]:
    """Serve a function by a protocol."""
    if request.param == "act":
        return act_server
    return lambda infer: openpi_server(lambda data: pack_openpi(infer(unpack_openpi(data))))


@pytest.fixture
def mapping(tmp_path: Path) -> str:
    (tmp_path / "one.yaml").write_text(ONE)
    return str(tmp_path / "one.yaml")


@pytest.mark.parametrize(
    "chunking",
    [
        ChunkSettings(execute=8),
        pytest.param(ChunkSettings(execute=10, latency=0.1, ensemble=0.01), marks=pytest.mark.slow),
    ],
)
def test_the_served_expert_does_what_the_local_one_does(
    experts: tuple[RecordConfig, list[TrialResult], dict[int, np.ndarray]],
    serve: Callable[..., Any],
    mapping: str,
    chunking: ChunkSettings,
    locations: Locations,
) -> None:
    """Its plan states times, so chunks and latency change no command after the first ones."""
    config, local, plans = experts
    with serve(serve_plans(plans, 16)) as url:
        choice = PolicyChoice(url, HERE, mapping=mapping, chunking=chunking)
        with TrialRunner(Session(config, locations), choice) as runner:
            for own in local:
                served = runner.run(own.attempt.job)
                assert (served.ended, served.error, own.ended) == (TrialEnd.SUCCESS, "", TrialEnd.SUCCESS)
                assert served.outcome.success == own.outcome.success is True
                assert own.actions is not None
                assert served.actions is not None
                late = 4 if chunking.latency else 0
                np.testing.assert_allclose(
                    served.actions.ctrl[late : own.ticks], own.actions.ctrl[late:], rtol=0, atol=1e-12
                )
                np.testing.assert_array_equal(served.actions.magnet[: own.ticks], own.actions.magnet)
                assert served.chunk_stats.waited == late
                assert served.chunk_stats.stale == late * served.chunk_stats.chunks


def answers(attempt: int, calls: int) -> Any:
    """Return the faults of a server's answers in a trial, from its third request on."""
    good = {"actions": np.zeros((8, 8))}
    if calls < 3:
        return good
    if attempt == 1:
        return {"actions": np.full((8, 8), np.nan)}
    if attempt == 2:
        return {"actions": np.zeros((8, 13))}
    if attempt == 3:
        return {"actions": np.zeros((100_000, 8))}
    if attempt == 4:
        time.sleep(3.0)
    if attempt == 5:
        return {"none": 1}
    if attempt == 6:
        return {"actions": ["a", {"b": None}]}
    return good


@pytest.fixture
def hostile(serve: Callable[..., Any]) -> Iterator[str]:
    calls: dict[int, int] = {}

    def infer(message: Mapping[str, Any]) -> Any:
        attempt = int(message["seed"]) % 1_000_003 % 8
        calls[attempt] = calls.get(attempt, 0) + 1
        return answers(attempt, calls[attempt])

    with serve(infer) as url:
        yield url


def test_a_hostile_server_fails_its_trials_and_not_the_run(
    hostile: str, mapping: str, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("episodes",): 8, ("workers",): 1})
    choice = PolicyChoice(hostile, HERE, call_seconds=1.5, time_limit=1.2, mapping=mapping)
    with TrialRunner(Session(config, locations), choice) as runner:
        results = [runner.run(AttemptJob(0, attempt)) for attempt in range(8)]
    told = [result.ended for result in results]
    assert told[0] is told[7] is TrialEnd.TIME_LIMIT
    # An answer that is too long is refused before it is read.
    assert set(told[1:4]) | {told[5], told[6]} <= {TrialEnd.INVALID, TrialEnd.RAISED}
    assert told[4] is TrialEnd.SLOW
    assert "is not finite" in results[1].error
    assert "not (actions, 8)" in results[2].error
    assert "longer than" in results[3].error
    assert "no 'actions'; its keys are none" in results[5].error
    assert "not an array" in results[6].error


def test_a_server_that_is_gone_costs_the_trials_that_it_misses(
    serve: Callable[..., Any], mapping: str, config: RecordConfig, locations: Locations
) -> None:
    is_there = True

    def infer(_: Mapping[str, Any]) -> Any:
        if not is_there:
            raise ConnectionResetError("the connection ends")
        return {"actions": np.zeros((1, 8))}

    with serve(infer) as url:
        runner = TrialRunner(Session(config, locations), PolicyChoice(url, HERE, time_limit=0.5, mapping=mapping))
        assert runner.run(AttemptJob(0, 0)).ended is TrialEnd.TIME_LIMIT
        is_there = False
    with runner:
        results = [runner.run(AttemptJob(0, attempt)) for attempt in (1, 2)]
    for result in results:
        assert result.ended is TrialEnd.RAISED
        assert result.error


def test_a_server_that_trickles_is_too_slow(mapping: str, config: RecordConfig, locations: Locations) -> None:
    """The limit applies to the whole answer, however often a part arrives."""

    def trickle(connection: socket.socket) -> None:
        read_request(connection)
        for _ in range(100):
            connection.sendall(b"H")
            time.sleep(0.05)

    with raw_server(trickle) as port:
        choice = PolicyChoice(f"act://127.0.0.1:{port}", HERE, call_seconds=0.4, mapping=mapping)
        with TrialRunner(Session(config, locations), choice) as runner:
            result = runner.run(AttemptJob(0, 0))
    assert (result.ended, result.ticks) == (TrialEnd.SLOW, 0)


def test_a_chunks_fate_is_reported(config: RecordConfig, locations: Locations) -> None:
    choice = PolicyChoice(
        "sample_policies.py:Chunked", HERE.parent, time_limit=1.28, arguments={"actions": 5},
        chunking=ChunkSettings(execute=4, latency=0.09),
    )  # fmt: skip
    session = Session(config, locations)
    with TrialRunner(session, choice) as runner:
        results = tuple(runner.run(AttemptJob(0, attempt)) for attempt in range(2))
    names = tuple(describe_objects(session, result.attempt.job) for result in results)
    report = evaluation_report(Evaluation(choice, results, 2.0, names), config, ())
    # Requested every eight ticks, in forty. Three ticks later one of the five actions, each of two ticks, has passed,
    # and the previous chunk ended a tick before; at the first time, there was none.
    chunks = report["stats"]["chunks"]
    assert chunks.pop("waited_s") == pytest.approx(2 * (3 + 4) * 0.032)
    assert chunks == {"chunks": 10, "actions": 50, "stale": 10}
    (one,) = report["stats"]["by_instance"]
    assert (one["instance"], one["n"], one["n_success"]) == ("banana, plate", 2, 0)
    assert {trial["instance"] for trial in report["trials"]} == {"banana, plate"}
    assert report["ticks_per_second"] == 40
