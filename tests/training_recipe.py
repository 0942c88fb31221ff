"""The recipe of docs/training.md as data: demonstrations, and the commands from there to a policy's trials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.pages import snippet

# Of recordings, and of trials: no trial starts as a demonstration.
RECORD_SEED, EVAL_SEED = 0, 1000


@dataclass(frozen=True)
class Demonstrations:
    """A set of demonstrations.

    Attributes:
        name: in figures, and of folders.
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
    """Arguments of `yamsim`: smallest pictures, since none is used."""
    small = ["--no-wrist", "--size", "64x48", "--quality", "fast", "--workers", "2"]
    given = ["--n", str(episodes), "--seed", str(RECORD_SEED), "--out", str(out)]
    return ["record", *given, *small, *kind.task, *kind.record]


def export(demos: Path, out: Path, episodes: int) -> list[str]:
    """Arguments of `yamsim`: the first demonstrations, as numbers."""
    return [
        "export",
        "lerobot",
        str(demos),
        str(out),
        *["--environment-state", "--no-pictures", "--episodes"],
        f"0-{episodes - 1}",
    ]


def write_config(path: Path) -> Path:
    """Write the page's config of `lerobot-train` as a file."""
    path.write_text(snippet("yaml", "dim_model"))
    return path


def train(config: Path, dataset: Path, out: Path, *more: str) -> list[str]:
    """Arguments of `lerobot-train`."""
    return [f"--config_path={config}", f"--dataset.root={dataset}", f"--output_dir={out}", *more]


def evaluate(kind: Demonstrations, trained: Path, trials: int = 100, seed: int = EVAL_SEED) -> list[str]:
    """Arguments of `yamsim`: a request at every second action, and overlapping answers are averaged."""
    policy = f"lerobot:{trained}/checkpoints/last/pretrained_model"
    chunks = ["--execute", "2", "--ensemble", "0.01"]
    given = ["--n", str(trials), "--seed", str(seed), "--workers", "2"]
    return ["eval", "--policy", policy, *given, *chunks, *kind.task]
