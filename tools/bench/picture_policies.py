"""Success of policies from images, by number of demonstrations and by look, in training and in trials.

    python -m tools.bench.picture_policies demos_images --counts 25 50 100 200
    python -m tools.bench.picture_policies demos_images --looks demos_looks/look_1 demos_looks/look_2 \
        --trials photo=25

`demos_images` is the dataset that docs/training.md records. With `--counts`, `tools.picture_policy` is trained with the
first demonstrations. With `--looks`, it is trained with the demonstrations alone and with the datasets of `yamsim draw`
too, and each policy is evaluated in all looks of `LOOKS`. It needs PyTorch. Stages in --out are not done again:
use another folder for other datasets, steps or numbers of trials.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.bench.stages import run_stage
from tools.bench.training_plot import plot_training

_SEED = 2000  # of the trials
_LOG_EVERY = 100  # steps between two losses that `tools.picture_policy` prints
_PRINTED_LOSS = re.compile(r"^step \d+: loss ([0-9.]+)", re.MULTILINE)
_RECIPE = ("--execute", "2", "--ensemble", "0.01")

# Look of trials -> what its file has, and the flag of `eval` that takes it. A text is a name from configs.
LOOKS: Mapping[str, tuple[str, str | Mapping[str, Any]] | None] = {
    "demonstrations": None,
    "heldout": ("--randomization", "heldout"),
    "default": ("--randomization", "default"),
    # By up to 2 cm along each axis, and 3 degrees.
    "moved_camera": ("--randomization", {"camera": {"position": 0.02, "rotation_deg": 3}}),
    # Another focal length: the vertical field of view differs by up to 5 degrees.
    "lens": ("--randomization", {"lens_deg": [-5, 5]}),
    "photo": ("--quality", "photo"),
}


@dataclass(frozen=True)
class Training:
    """A policy to train: its name, the datasets, how many episodes of each (None: all), and the number of steps."""

    name: str
    datasets: tuple[Path, ...]
    episodes: int | None
    steps: int


@dataclass(frozen=True)
class Bench:
    """Folder of results, the dataset of demonstrations, and trials by look (others: `trials`)."""

    out: Path
    demos: Path
    trials: int
    special_trials: Mapping[str, int]

    def train(self, training: Training) -> list[float]:
        """Train a policy. Return the losses, one for each `_LOG_EVERY` steps."""
        episodes = () if training.episodes is None else ("--episodes", str(training.episodes))
        weights = str(self.out / f"{training.name}.pt")
        command = ("tools.picture_policy", *map(str, training.datasets), weights, *episodes)
        self._stage(training.name, [*command, "--steps", str(training.steps)])
        return [float(loss) for loss in _PRINTED_LOSS.findall((self.out / f"{training.name}.log").read_text())]

    def evaluate(self, name: str, look: str) -> dict[str, Any]:
        """Evaluate a policy in a look, and return the statistics of the report."""
        report = self.out / f"{name}.{look}.json"
        command = (
            "yamsim_cli", "eval", "--policy", "tools/picture_policy.py:PicturePolicy",
            "--policy-arg", f"weights={self.out / name}.pt", "--trained-on", str(self.demos),
            "--n", str(self.special_trials.get(look, self.trials)), "--seed", str(_SEED), *_RECIPE,
        )  # fmt: skip
        self._stage(f"{name}.{look}", [*command, *self._flags(look), "--out", str(report)])
        stats: dict[str, Any] = json.loads(report.read_text())["stats"]
        return stats

    def _stage(self, name: str, module_and_arguments: Sequence[str]) -> None:
        seconds = run_stage(self.out, name, [sys.executable, "-m", *module_and_arguments])
        print(f"{name}: {seconds['wall_s']:.0f} s, {seconds['cpu_s']:.0f} CPU s", flush=True)

    def _flags(self, look: str) -> tuple[str, ...]:
        given = LOOKS[look]
        if given is None:
            return ()
        flag, content = given
        if isinstance(content, str):
            return (flag, content)
        file = self.out / f"{look}.yaml"
        # JSON is YAML.
        file.write_text(json.dumps(content))
        return (flag, str(file))


def describe(stats: Mapping[str, Any]) -> str:
    """Return successes with their interval and the median distance."""
    low, high = stats["wilson95"]
    median = 1000 * stats["dxy_m"]["median"]
    return f"{stats['n_success']} of {stats['n']} ({low:.0%} to {high:.0%}), median {median:.0f} mm"


def main() -> None:
    """Train, evaluate, print, and write the figures and a plot of the learning curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demos", type=Path)
    parser.add_argument("--counts", type=int, nargs="*", default=[], help="numbers of demonstrations")
    parser.add_argument("--looks", type=Path, nargs="*", default=[], help="datasets of `yamsim draw`, from demos")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--look-steps", type=int, default=8000, help="steps with the datasets of --looks")
    parser.add_argument("--n", type=int, default=100, help="trials of a policy in a look")
    parser.add_argument("--trials", nargs="*", default=[], metavar="LOOK=N", help="another number for a look")
    parser.add_argument("--out", type=Path, default=Path("out/picture_policies"))
    given = parser.parse_args()
    special = {look: int(n) for look, n in (text.split("=") for text in given.trials)}
    if unknown := special.keys() - LOOKS.keys():
        parser.error(f"--trials: {', '.join(sorted(unknown))}: no such look; valid: {', '.join(LOOKS)}")
    bench = Bench(given.out, given.demos, given.n, special)
    bench.out.mkdir(parents=True, exist_ok=True)
    curve, matrix = [], []
    for count in given.counts:
        training = Training(f"first_{count}", (given.demos,), count, given.steps)
        loss = bench.train(training)
        stats = bench.evaluate(training.name, "demonstrations")
        print(f"{count} demonstrations: {describe(stats)}, loss {loss[-1] if loss else 'unknown'}", flush=True)
        curve.append({"kind": "images", "episodes": count, "steps": given.steps, "loss": loss, **stats})
    if curve:
        plot_training(curve, _LOG_EVERY, bench.out / "learning_curve.svg")
    if given.looks:
        for training in (
            Training("one_look", (given.demos,), None, given.steps),
            Training("many_looks", (given.demos, *given.looks), None, given.look_steps),
        ):
            bench.train(training)
            for look in LOOKS:
                stats = bench.evaluate(training.name, look)
                print(f"{training.name}, trials in {look}: {describe(stats)}", flush=True)
                matrix.append({"training": training.name, "look": look, **stats})
    (bench.out / "picture_policies.json").write_text(json.dumps({"curve": curve, "matrix": matrix}, indent=1) + "\n")


if __name__ == "__main__":
    main()
