"""A policy in another process: the same answers, and every fault reported to the client."""

from __future__ import annotations

import http.client
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.policies.sample_policies import Unsendable
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.evaluate.evaluation import evaluate, evaluation_report
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd, TrialRunner
from yamsim_cli.policies.policy_client import RemoteError
from yamsim_cli.policies.policy_loading import load_policy
from yamsim_cli.policies.policy_protocol import InvalidActionError
from yamsim_cli.policies.policy_server import PolicyServer
from yamsim_cli.policies.remote_policy import RemotePolicy

pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")

HERE = Path(__file__).parent


@contextmanager
def served(name: str) -> Iterator[str]:
    with PolicyServer(lambda: load_policy(f"sample_policies.py:{name}", HERE), port=0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.url
        finally:
            server.shutdown()
            thread.join()


def test_it_listens_on_this_machine_alone() -> None:
    with served("Still") as url:
        assert url.startswith("http://127.0.0.1:")


@pytest.mark.slow
def test_a_remote_policy_does_what_it_does_here(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("episodes",): 3, ("workers",): 2})
    with served("Random") as url:
        there = evaluate(Session(config, locations), PolicyChoice(url, HERE, time_limit=0.5), lambda *_: None)
    here = evaluate(
        Session(config, locations),
        PolicyChoice("sample_policies.py:Random", HERE, time_limit=0.5),
        lambda *_: None,
    )
    for one, other in zip(there.results, here.results, strict=True):
        assert one.actions is not None
        assert other.actions is not None
        np.testing.assert_array_equal(one.actions.ctrl, other.actions.ctrl)
        assert one.outcome == other.outcome
    assert evaluation_report(there, config, ())["policy"].startswith("http://")


def test_images_and_ticks_are_the_servers_policys() -> None:
    with served("Seeing") as url:
        policy = RemotePolicy(url, 5.0)
        assert (policy.images, policy.ticks) == (("wrist",), 1)
        policy.reset(seed=1)
        image = np.random.default_rng(0).integers(0, 255, (8, 8, 3), dtype=np.uint8)
        assert policy({"wrist_rgb": image})["done"] is True
        with pytest.raises(RemoteError, match="KeyError"):
            policy({})
        # The server goes on.
        assert policy({"wrist_rgb": np.zeros((8, 8, 3), np.uint8)})["done"] is False
        policy.close()


def test_faults_are_told_as_those_of_a_policy_here(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    # One after the other: the server answers nobody else while it hangs in the last one.
    config = make_config({("episodes",): 4, ("workers",): 1})
    with served("Faulty") as url:
        found = evaluate(Session(config, locations), PolicyChoice(url, HERE, call_seconds=2.0), lambda *_: None)
    told = {result.attempt.job.attempt: (result.ended.value, result.error) for result in found.results}
    assert told[0][0] == "policy_raised"
    assert re.fullmatch(
        r"KeyError: 'no such thing' \(.*sample_policies.py:\d+, in __call__\), after 3 ticks", told[0][1]
    )
    # The server's whole traceback.
    assert found.results[0].traceback.startswith("Traceback (most recent call last):")
    assert 'raise KeyError("no such thing")' in found.results[0].traceback
    assert "yamsim_cli" not in found.results[0].traceback
    assert [told[k][0] for k in (1, 2)] == ["policy_invalid"] * 2
    assert told[3][0] == "policy_slow"


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (0, "ctrl of the answer: object cannot be sent: only numbers, text, plain containers and arrays can"),
        (1, "ctrl of the answer: OnGpu cannot be sent: can't convert cuda:0 device type tensor to numpy"),
        (3, "ctrl of the answer: an array of dtype object cannot be sent: only numbers"),
        (4, "done of the answer: "),
        (5, "7 of the answer: "),
        (6, "an action is a dictionary with ctrl, magnet and done, not ndarray"),
    ],
)
def test_an_answer_that_cannot_be_sent_is_told_and_the_server_goes_on(number: int, told: str) -> None:
    with served("Unsendable") as url:
        policy = RemotePolicy(url, 5.0)
        with pytest.raises(InvalidActionError, match=re.escape(told)):
            policy({"time": number})
        assert len(policy({"time": len(Unsendable.ANSWERS)})["ctrl"]) == 7
        policy.close()


def test_a_fork_of_the_server_answers_nobody() -> None:
    with served("Forker") as url:
        policy = RemotePolicy(url, 5.0)
        policy.reset(seed=0)
        # A second answer to the second call would be taken for the third one's.
        assert [bool(policy({})["done"]) for _ in range(5)] == [False, False, True, False, False]
        policy.close()


def test_pictures_and_state_reach_a_policy_elsewhere(
    make_config: Callable[..., RecordConfig], locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (8, 8, 3), dtype=np.uint8)
    render = "yamsim_cli.policies.evaluate.policy_trial.render_cameras"
    monkeypatch.setattr(render, lambda simulator, attempt, qpos, cameras: dict.fromkeys(cameras, picture))
    config = make_config({("episodes",): 1})
    with served("Remembering") as url, TrialRunner(Session(config, locations), PolicyChoice(url, HERE)) as runner:
        assert runner.policy.images == ("scene",)  # type: ignore[attr-defined]
        result = runner.run(AttemptJob(0, 0))
        assert (result.ended, result.error) == (TrialEnd.DONE, "")
    with served("Knowing") as url, TrialRunner(Session(config, locations), PolicyChoice(url, HERE)) as runner:
        assert runner.policy.wants == ("objects", "velocities")  # type: ignore[attr-defined]
        assert runner.run(AttemptJob(0, 0)).ended is TrialEnd.DONE


def test_clients_do_not_share_a_policy() -> None:
    with served("Random") as url:
        one, other = RemotePolicy(url, 5.0), RemotePolicy(url, 5.0)
        one.reset(seed=4)
        first = one({})["ctrl"]
        other.reset(seed=4)
        one({})
        np.testing.assert_array_equal(other({})["ctrl"], first)
        one.close()
        other.close()


def test_an_address_without_a_server_is_refused() -> None:
    with pytest.raises(ResourceError, match="no policy answers there"):
        RemotePolicy("http://127.0.0.1:9", 2.0)
    for url in ("https://127.0.0.1:9", "http://", "http://host/path"):
        with pytest.raises(UsageError, match="give http://HOST:PORT"):
            RemotePolicy(url, 2.0)


def test_a_lost_server_raises_a_remote_error() -> None:
    with served("Still") as url:
        policy = RemotePolicy(url, 5.0)
    policy.close()
    with pytest.raises(RemoteError, match=r"^http://"):
        policy({})


def test_an_invalid_message_does_not_stop_the_server() -> None:
    with served("Still") as url:
        connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=5)
        connection.request("POST", "/act", b"\xc1")
        assert b"not a message" in connection.getresponse().read()
        connection.putrequest("POST", "/act")
        connection.putheader("Content-Length", "99999999999")
        connection.endheaders()
        assert connection.getresponse().status == 413
        connection.close()
        connection.request("POST", "/nonsense", b"\x81\xa7session\x01")
        assert b"error" in connection.getresponse().read()
        connection.close()
        assert RemotePolicy(url, 5.0).images == ()


def test_a_port_that_is_taken_is_told() -> None:
    with served("Still") as url, pytest.raises(ResourceError, match="try another --port"):
        PolicyServer(object, port=int(url.rpartition(":")[2]))


@pytest.mark.parametrize(("error", "told"), [(ConnectionResetError(), False), (ZeroDivisionError(), True)])
def test_a_disconnect_is_not_printed_but_a_bug_is(
    error: Exception, told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with PolicyServer(object, port=0) as server:
        try:
            raise error
        except (ConnectionResetError, ZeroDivisionError):
            server.handle_error(None, ("127.0.0.1", 1))
    assert (type(error).__name__ in capsys.readouterr().err) == told
