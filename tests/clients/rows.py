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
ROWS: dict[str, Row] = {}
