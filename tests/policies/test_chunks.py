"""Scheduling of chunks that follow each other, overlap, come late, or run out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from yamsim_cli.core.errors import UsageError
from yamsim_cli.policies.action_chunks import ChunkScheduler, ChunkSettings, ChunkStats, read_latency
from yamsim_cli.policies.policy_protocol import ActionChunk

TICK = 0.032
REST = np.full((1, 7), -1.0)


def chunk(first: float, actions: int, *, ticks: int = 1, done: bool = False, welds: bool = False) -> ActionChunk:
    """Actions that count up from a number, which identifies them."""
    ctrl = np.repeat(first + np.arange(actions, dtype=float), 7).reshape(actions, 1, 7)
    return ActionChunk(ctrl, np.full((actions, 1), welds), done, ticks * TICK)


def played(player: ChunkScheduler, ticks: int, actions: int = 5, *, per: int = 1, seconds: float = 0.0) -> list[float]:
    """Return the executed actions per tick. Each chunk's actions are its ticks, plus a thousandth for each earlier
    chunk.
    """
    acted, asked = [], 0
    for now in range(ticks):
        if player.is_due(now):
            rows = chunk(0, actions, ticks=per)
            rows.ctrl[:] = (now + per * np.arange(actions)).reshape(-1, 1, 1) + asked / 1000
            player.add_chunk(rows, now, seconds)
            asked += 1
        acted.append(float(player.command_at(now)[0][0, 0]))
    return [round(value, 6) for value in acted]


def test_all_of_a_chunk_acts_before_the_next_is_asked_for() -> None:
    player = ChunkScheduler(ChunkSettings(), TICK, 1, REST)
    assert played(player, 7) == [0, 1, 2, 3, 4, 5.001, 6.001]
    assert player.chunk_stats == ChunkStats(chunks=2, actions=10)


def test_actions_may_last_several_ticks_or_parts_of_one() -> None:
    assert played(ChunkScheduler(ChunkSettings(), TICK, 1, REST), 5, per=2) == [0, 0, 2, 2, 4]
    player = ChunkScheduler(ChunkSettings(), TICK, 1, REST)
    # At 50 a second on ticks of 32 ms: the action of the tick's beginning.
    rows = chunk(0, 5)
    player.add_chunk(ActionChunk(rows.ctrl, rows.magnet, False, 0.020), 0, 0.0)
    assert [player.command_at(now)[0][0, 0] for now in range(4)] == [0, 1, 3, 4]
    assert not player.is_due(3)
    assert player.is_due(4)


def test_without_a_period_an_action_lasts_as_long_as_the_policy_says() -> None:
    player = ChunkScheduler(ChunkSettings(), TICK, 3, REST)
    player.add_chunk(ActionChunk(np.ones((1, 1, 7)), np.zeros((1, 1), bool), False), 0, 0.0)
    assert [player.is_due(now) for now in (1, 2, 3)] == [False, False, True]


def test_the_next_chunk_takes_over_after_some_actions() -> None:
    assert played(ChunkScheduler(ChunkSettings(execute=2), TICK, 1, REST), 6) == [0, 1, 2.001, 3.001, 4.002, 5.002]
    # More than the chunk has means all.
    assert played(ChunkScheduler(ChunkSettings(execute=9), TICK, 1, REST), 6) == [0, 1, 2, 3, 4, 5.001]


def test_an_answer_that_comes_late_is_taken_up_where_it_would_be() -> None:
    """Meanwhile the arm continues with earlier actions, then stays."""
    player = ChunkScheduler(ChunkSettings(execute=3, latency=2 * TICK), TICK, 1, REST)
    #                            waits   stale 0, 1       asked at 3: 0.001 from 5 on
    assert played(player, 9) == [-1, -1, 2, 3, 4, 5.001, 6.001, 7.001, 8.002]
    assert player.chunk_stats == ChunkStats(chunks=3, actions=15, stale=6, waited=2)


def test_while_there_is_nothing_for_now_the_last_action_stays() -> None:
    player = ChunkScheduler(ChunkSettings(latency=2 * TICK), TICK, 1, REST)
    #                               asked at 0, 4 and 8, answered two ticks later
    assert played(player, 8, 4) == [-1, -1, 2, 3, 3, 3, 6.001, 7.001]
    assert player.chunk_stats.waited == 4


def test_of_a_chunk_that_is_all_too_late_the_last_action_acts() -> None:
    player = ChunkScheduler(ChunkSettings(latency=3 * TICK), TICK, 1, REST)
    assert played(player, 7, 1) == [-1, -1, -1, 0, 0, 0, 3.001]
    assert (player.chunk_stats.stale, player.chunk_stats.waited) == (3, 7)


def test_the_measured_latency_is_how_long_the_answer_took() -> None:
    player = ChunkScheduler(ChunkSettings(latency=None), TICK, 1, REST)
    assert played(player, 4, seconds=0.040) == [-1, -1, 2, 3]


def continued(player: ChunkScheduler, ticks: int, actions: int, period: float) -> tuple[list[float], list[int]]:
    """Return the executed actions per tick, which count up over all chunks, and the ticks of the requests."""
    acted, asked = [], []
    for now in range(ticks):
        if player.is_due(now):
            rows = chunk(actions * len(asked), actions)
            player.add_chunk(ActionChunk(rows.ctrl, rows.magnet, False, period), now, 0.0)
            asked.append(now)
        acted.append(float(player.command_at(now)[0][0, 0]))
    return acted, asked


def test_chunks_that_continue_each_other_are_requested_before_and_begin_after() -> None:
    acted, asked = continued(ChunkScheduler(ChunkSettings(lead=2), TICK, 1, REST), 13, 5, TICK)
    assert acted == list(range(13))
    # With the observation at the third action of five, after which two are left.
    assert asked == [0, 2, 7, 12]


def test_a_late_chunk_that_continues_begins_when_it_arrives() -> None:
    """Nothing is left out, and the last action is held meanwhile."""
    player = ChunkScheduler(ChunkSettings(lead=2, latency=4 * TICK), TICK, 1, REST)
    acted, asked = continued(player, 17, 5, TICK)
    assert acted == [-1, -1, -1, -1, 0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9, 9, 10]
    assert asked == [0, 6, 12]
    assert player.chunk_stats == ChunkStats(chunks=3, actions=15, stale=0, waited=6)


def test_a_chunk_in_time_continues_without_a_pause() -> None:
    acted, asked = continued(ChunkScheduler(ChunkSettings(lead=2, latency=3 * TICK), TICK, 1, REST), 13, 5, TICK)
    assert (acted, asked) == ([-1, -1, -1, *range(10)], [0, 5, 10])


def test_chunks_that_continue_keep_their_rate_over_many() -> None:
    """33.3 ms on ticks of 32 ms: a chunk ends between two ticks."""
    acted, _ = continued(ChunkScheduler(ChunkSettings(lead=4), TICK, 1, REST), 1000, 15, 1 / 30)
    assert acted == [math.floor(now * TICK * 30 + 1e-6) for now in range(1000)]


def test_chunks_that_overlap_are_averaged() -> None:
    player = ChunkScheduler(ChunkSettings(execute=1, ensemble=np.log(2.0)), TICK, 1, REST)
    for now, first in ((0, 0.0), (1, 10.0), (2, 100.0)):
        assert player.is_due(now)
        player.add_chunk(chunk(first, 3), now, 0.0)
        told = player.command_at(now)[0]
    # The oldest says 2, the next 11, the newest 100: with weights of 4, 2 and 1.
    np.testing.assert_allclose(told, (4 * 2 + 2 * 11 + 100) / 7)


def test_of_two_chunks_that_disagree_on_a_weld_the_weightier_wins() -> None:
    player = ChunkScheduler(ChunkSettings(execute=1, ensemble=0.1), TICK, 1, REST)
    player.add_chunk(chunk(0, 3, welds=True), 0, 0.0)
    player.add_chunk(chunk(0, 3), 1, 0.0)
    assert player.command_at(1)[1].tolist() == [True]


def test_a_last_chunk_is_played_to_its_end() -> None:
    player = ChunkScheduler(ChunkSettings(execute=1, latency=TICK), TICK, 1, REST)
    player.add_chunk(chunk(0, 3, done=True), 0, 0.0)
    assert [player.is_due(now) or player.last_chunk_is_over(now) for now in range(4)] == [False, False, False, True]
    assert player.has_ended


@pytest.mark.parametrize(
    ("text", "seconds"), [("80ms", 0.08), ("0.08s", 0.08), (".5 s", 0.5), ("0ms", 0.0), ("measured", None)]
)
def test_a_latency_is_read(text: str, seconds: float | None) -> None:
    assert read_latency(text) == seconds


@pytest.mark.parametrize("text", ["80", "-1ms", "nan", "61s", "1e9s", "measure", ""])
def test_an_invalid_latency_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="give a time such as 80ms"):
        read_latency(text)
