"""Flags of commands that run a policy: how it is called, and for how long."""

from __future__ import annotations

from typing import Annotated

import typer

PolicyConfig = Annotated[
    str | None,
    typer.Option(
        help="Names that a policy of another program uses: a config of the kind policies.  "
        "[default: by the policy's protocol]"
    ),
]
Execute = Annotated[
    int | None,
    typer.Option(
        min=1, metavar="K", help="Actions of a chunk to execute before the policy is called again.  [default: all]"
    ),
]
Ensemble = Annotated[
    float | None,
    typer.Option(
        min=0,
        max=100,
        metavar="DECAY",
        help="Average chunks that overlap; each newer chunk weighs less by exp(-DECAY).",
    ),
]
Latency = Annotated[
    str,
    typer.Option(
        help="Simulated time from an observation until the policy's answer acts: 80ms, 0.08s, or measured.",
        metavar="TIME",
    ),
]
PolicyTimeout = Annotated[float, typer.Option(min=0.001, help="Real seconds that one answer of the policy may take.")]
TrialTimeout = Annotated[float, typer.Option(min=1, help="Real seconds after which a trial's worker counts as hung.")]
