"""Answers of a policy, loading of policies, and messages to another process."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from yamsim_cli.core.errors import UsageError
from yamsim_cli.policies.policy_faults import describe_fault
from yamsim_cli.policies.policy_loading import load_policy, read_arguments, reset_policy, wanted_images, wanted_state
from yamsim_cli.policies.policy_protocol import InvalidActionError, read_chunk
from yamsim_cli.policies.remote_policy import MessageError, pack_message, unpack_message

HERE = Path(__file__).parent


def test_an_action_is_read() -> None:
    action = read_chunk({"ctrl": [0, 1, 2, 3, 4, 5, 0.01], "magnet": np.float32(1), "done": np.array([False])}, 1, 7)
    np.testing.assert_array_equal(action.ctrl, [[[0, 1, 2, 3, 4, 5, 0.01]]])
    assert (action.magnet.tolist(), action.done, action.period) == ([[True]], False, None)
    assert read_chunk({"ctrl": np.zeros(7, np.float32)}, 1, 7).magnet.tolist() == [[False]]


def test_several_actions_are_a_chunk() -> None:
    chunk = read_chunk({"ctrl": (np.arange(21) / 10).reshape(3, 7), "magnet": [0, 1, 1], "period": 0.02}, 1, 7)
    np.testing.assert_array_equal(chunk.ctrl[:, 0], (np.arange(21) / 10).reshape(3, 7))
    assert (chunk.magnet.tolist(), chunk.period) == ([[False], [True], [True]], 0.02)
    two = read_chunk({"ctrl": np.zeros((2, 14)), "magnet": [[0, 1], [1, 0]]}, 2, 7)
    assert (two.ctrl.shape, two.magnet.tolist()) == ((2, 2, 7), [[False, True], [True, False]])
    # One value for all of them.
    assert read_chunk({"ctrl": np.zeros((3, 7)), "magnet": True}, 1, 7).magnet.tolist() == [[True]] * 3


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (None, "an action is a dictionary with ctrl, magnet and done, not NoneType"),
        (np.zeros(7), "not ndarray"),
        ({}, "needs ctrl"),
        ({"ctrl": np.zeros(8)}, "ctrl has the shape (8,), not (7,)"),
        ({"ctrl": np.zeros((2, 8))}, "ctrl has the shape (2, 8), not (7,), or (1 to 1000 actions, 7)"),
        ({"ctrl": np.zeros((0, 7))}, "ctrl has the shape (0, 7), not (7,)"),
        ({"ctrl": np.zeros((1001, 7))}, "ctrl has the shape (1001, 7), not (7,)"),
        ({"ctrl": np.zeros((3, 7)), "magnet": [0, 1]}, "magnet is [0, 1], not true or false"),
        ({"ctrl": np.zeros(7), "magnet": [[0], [1, 2]]}, "magnet is not an array of booleans"),
        ({"ctrl": np.zeros(7), "period": float("nan")}, "period is nan, not 0.001 to 10 s"),
        ({"ctrl": [0, 0, 0, float("nan"), 0, 0, 0]}, "ctrl is not finite"),
        ({"ctrl": [0, 0, 0, float("inf"), 0, 0, 0]}, "ctrl is not finite"),
        ({"ctrl": ["a"] * 7}, "ctrl is not an array of numbers"),
        ({"ctrl": [[0], [1, 2]]}, "ctrl is not an array of numbers"),
        ({"ctrl": np.zeros(7), "magnet": 0.5}, "magnet is 0.5, not true or false"),
        ({"ctrl": np.zeros(7), "done": "yes"}, "done is 'yes', not true or false"),
        ({"ctrl": np.zeros(7), "gripper": 1}, "and period, not gripper"),
    ],
)
def test_invalid_actions_are_refused_with_the_reason(answer: object, told: str) -> None:
    with pytest.raises(InvalidActionError, match=re.escape(told)):
        read_chunk(answer, 1, 7)


def test_actions_of_two_arms_have_values_for_both() -> None:
    action = read_chunk({"ctrl": (np.arange(14) / 10), "magnet": [False, True]}, 2, 7)
    np.testing.assert_array_equal(action.ctrl, [(np.arange(14) / 10).reshape(2, 7)])
    assert (action.magnet.tolist(), action.done) == ([[False, True]], False)
    assert read_chunk({"ctrl": np.zeros(14)}, 2, 7).magnet.tolist() == [[False, False]]
    for answer, told in (
        ({"ctrl": np.zeros(7)}, "ctrl has the shape (7,), not (14,)"),
        ({"ctrl": np.zeros(14), "magnet": True}, "magnet is True, not 2 times true or false"),
        ({"ctrl": np.zeros(14), "done": [0, 1]}, "done is [0, 1], not true or false"),
    ):
        with pytest.raises(InvalidActionError, match=re.escape(told)):
            read_chunk(answer, 2, 7)


@pytest.mark.parametrize("name", ["sample_policies.py:Still", "sample_policies:Still"])
def test_a_policy_is_found_by_file_and_by_module(name: str) -> None:
    policy = load_policy(name, HERE)
    assert type(policy).__name__ == "Still"
    assert (wanted_images(policy), wanted_state(policy)) == ((), ())


def test_a_file_with_one_policy_needs_no_class(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from helper import GAIN\nfrom collections import Counter\n\n\nclass Mine:\n"
        "    def reset(self, seed):\n        self.seed = seed\n"
        "    def __call__(self, observation):\n        return GAIN\n"
    )
    (tmp_path / "helper.py").write_text("GAIN = 3\n")
    policy = load_policy("mine.py", tmp_path)
    assert wanted_images(policy) == ("scene", "wrist")
    reset_policy(policy, 12)
    assert policy.seed == 12  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("scripted", "is not valid: give module:Class or file.py:Class"),
        ("nowhere.py", "there is no such file"),
        ("nowhere:Class", "cannot be loaded: ModuleNotFoundError"),
        ("sample_policies.py", "has the policies Still, Seeing"),
        ("sample_policies.py:Stil", "it has no 'Stil'; did you mean 'Still'?"),
        ("sample_policies.py:NoReset", "NoReset needs the methods reset() and __call__(observation)"),
        ("sample_policies.py:AsksWrongly", "images is 'scene'; give a tuple, such as ('scene',)"),
        ("sample_policies.py:WantsTooMuch", "it asks for the state 'object'; did you mean 'objects'? valid: objects, "),
        ("broken.py", "cannot be loaded: ZeroDivisionError: division by zero (broken.py:1, in <module>)"),
    ],
)
def test_policies_that_cannot_be_loaded_are_refused_in_one_line(name: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")
    (tmp_path / "sample_policies.py").write_text((HERE / "sample_policies.py").read_text())
    with pytest.raises(UsageError) as caught:
        load_policy(name, tmp_path)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


class UnprintableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (ValueError(), "ValueError"),
        (ValueError("two\n  lines"), "ValueError: two lines"),
        (ValueError("long " * 100), "ValueError: " + ("long " * 59) + "..."),
        (UnprintableError(), "UnprintableError: its message cannot be shown"),
    ],
)
def test_any_exception_of_a_policy_is_described_in_one_line(error: Exception, told: str) -> None:
    fault = describe_fault(error, HERE)
    assert fault.text == told
    assert type(error).__name__ in fault.traceback


def test_messages_come_back_as_they_went() -> None:
    pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    message = {"image": image, "T": np.eye(4), "flag": np.bool_(True), "text": "banana", "n": 3, "x": np.float32(0.5)}
    found = unpack_message(pack_message(message))
    for key in ("image", "T"):
        np.testing.assert_array_equal(found[key], message[key])
        assert found[key].dtype == message[key].dtype  # type: ignore[attr-defined]
    assert (found["flag"], found["text"], found["n"], found["x"]) == (True, "banana", 3, 0.5)
    # The array is writable.
    found["image"][0, 0, 0] = 9


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x93\x01", pytest.param(b"\xd6\x02aaaa", id="other type")])
def test_an_invalid_message_is_refused(data: bytes) -> None:
    pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
    with pytest.raises(MessageError):
        unpack_message(data)


def test_objects_are_neither_sent_nor_made() -> None:
    msgpack = pytest.importorskip("msgpack", reason="yamsim[remote] is not installed")
    with pytest.raises(TypeError):
        pack_message({"x": object()})
    for kind, shape in (("|O", [1]), ("<f8", [1 << 40]), ("|S4", [2])):
        with pytest.raises(MessageError):
            unpack_message(msgpack.packb(msgpack.ExtType(1, msgpack.packb([kind, shape, b"12345678"]))))


def test_arguments_are_keywords_and_numbers_are_numbers() -> None:
    assert read_arguments(["a=1", "b=0.5", "c=x=y", "d="]) == {"a": 1, "b": 0.5, "c": "x=y", "d": ""}
    assert (
        load_policy("sample_policies.py:Chunked", HERE, arguments={"actions": 3})({"joints": [0.0]})["ctrl"].shape[0]
        == 3
    )


@pytest.mark.parametrize(
    ("given", "told"),
    [(["a"], "'a' is not valid: give KEY=VALUE"), (["1=2"], "give KEY=VALUE"), (["a=1", "a=2"], "a is given twice")],
)
def test_an_invalid_policy_argument_is_refused(given: list[str], told: str) -> None:
    with pytest.raises(UsageError, match=f"--policy-arg .*{told}"):
        read_arguments(given)
