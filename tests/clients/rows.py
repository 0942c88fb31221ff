"""The programs that read what yamsim writes: one row of README's table each, with the test that runs it."""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.clients.environments import Environment


@dataclass(frozen=True)
class Row:
    """A client.

    Attributes:
        client: its name, as the table has it.
        distribution: whose version the table tells.
        opens: what it is given, and what it does with that.
        environment: where it runs.
        heavy: takes many minutes or gigabytes: `make test-clients-heavy` runs it, by hand.
    """

    client: str
    distribution: str
    opens: str
    environment: Environment = field(default_factory=Environment)
    heavy: bool = False


# Key, as tests give it to the fixture `client` -> row.
ROWS: dict[str, Row] = {
    "av-15": Row(
        "PyAV 15",
        "av",
        "the tests of videos and of their exports, with it in place of the newest",
        Environment("av-15", beside=True),
    ),
    "av-16": Row(
        "PyAV 16",
        "av",
        "the tests of videos and of their exports, with it in place of the newest",
        Environment("av-16", beside=True),
    ),
    "av-17": Row(
        "PyAV 17",
        "av",
        "the tests of videos and of their exports, with it in place of the newest",
        Environment("av-17", beside=True),
    ),
    "lerobot": Row(
        "LeRobot 0.6",
        "lerobot",
        "reads every frame of `export lerobot`; deletes, splits, merges, removes features; trains on the outcome; "
        "shares an environment with `yamsim[lerobot,video]`",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
    "lerobot-0.4": Row(
        "LeRobot 0.4",
        "lerobot",
        "reads every frame of `export lerobot`; deletes, splits, merges, removes features; trains on the outcome",
        Environment("lerobot-0.4", "3.11"),
        heavy=True,
    ),
    "lerobot-doctor": Row(
        "lerobot-doctor",
        "lerobot-doctor",
        "checks `export lerobot` and finds no failure",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
}
