"""The recipe of docs/training.md as data: what is demonstrated, and the commands from there to a policy's trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# A small network and few steps, for two cores without a GPU. ACT's own sizes are for pictures and many cores.
NETWORK = (
    "--policy.dim_model=128",
    "--policy.n_heads=4",
    "--policy.dim_feedforward=512",
    "--policy.n_encoder_layers=2",
    "--policy.use_vae=false",
    "--policy.dropout=0",
    "--policy.chunk_size=32",
    "--policy.n_action_steps=8",
    # Without this ACT takes where things are as it is, in metres.
    '--policy.normalization_mapping={"STATE": "MEAN_STD", "ENV": "MEAN_STD", "ACTION": "MEAN_STD"}',
)
# ACT's preset has no schedule. A rate that falls to nothing makes the last actions exact.
SCHEDULE = (
    "--use_policy_training_preset=false",
    "--optimizer.type=adamw",
    "--optimizer.lr=1e-3",
    "--optimizer.weight_decay=1e-4",
    "--scheduler.type=cosine_annealing_with_warmup",
    "--scheduler.num_warmup_steps=100",
)
# What keeps it on this machine, and off the hub.
HERE = (
    "--policy.device=cpu",
    "--policy.push_to_hub=false",
    "--policy.pretrained_backbone_weights=null",
    "--num_workers=1",
)
BATCH = 32
STEPS = 6000
# Of recordings, and of trials: no trial starts as a demonstration did.
RECORD_SEED, EVAL_SEED = 0, 1000


@dataclass(frozen=True)
class Demonstrations:
    """What is demonstrated.

    Attributes:
        name: of the figures, and of folders.
        task: flags that `record` and `eval` share.
        record: flags of `record` alone.
    """

    name: str
    task: tuple[str, ...] = ()
    record: tuple[str, ...] = ()


KINDS = {
    one.name: one
    for one in (
        Demonstrations("weld"),
        Demonstrations("contact", task=("--rig", "single_linear", "--grasp", "contact")),
        Demonstrations("randomized", record=("--randomize",)),
    )
}


def record(kind: Demonstrations, episodes: int, out: Path) -> list[str]:
    """Arguments of `yamsim`: pictures as small as can be, since none is used."""
    small = ["--no-wrist", "--size", "64x48", "--quality", "fast", "--workers", "2"]
    given = ["--n", str(episodes), "--seed", str(RECORD_SEED), "--out", str(out)]
    return ["record", *given, *small, *kind.task, *kind.record]


def export(demos: Path, out: Path, episodes: int) -> list[str]:
    """Arguments of `yamsim`: the first of the demonstrations, as numbers."""
    return [
        "export",
        "lerobot",
        str(demos),
        str(out),
        *["--environment-state", "--no-pictures", "--episodes"],
        f"0-{episodes - 1}",
    ]


def train(dataset: Path, out: Path, steps: int = STEPS, more: Sequence[str] = ()) -> list[str]:
    """Arguments of `lerobot-train`."""
    return [
        "--dataset.repo_id=local/demos",
        f"--dataset.root={dataset}",
        f"--output_dir={out}",
        "--policy.type=act",
        *NETWORK,
        *SCHEDULE,
        *HERE,
        f"--batch_size={BATCH}",
        f"--steps={steps}",
        *more,
    ]


def evaluate(kind: Demonstrations, trained: Path, trials: int = 100) -> list[str]:
    """Arguments of `yamsim`: it is asked at every second action, and answers that overlap are averaged."""
    policy = f"lerobot:{trained}/checkpoints/last/pretrained_model"
    chunks = ["--execute", "2", "--ensemble", "0.01"]
    given = ["--n", str(trials), "--seed", str(EVAL_SEED), "--workers", "2"]
    return ["eval", "--policy", policy, *given, *chunks, *kind.task]
