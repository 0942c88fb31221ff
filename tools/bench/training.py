"""Success by demonstrations: records, trains with LeRobot and evaluates, for several numbers and kinds of
demonstrations.

    python -m tools.bench.training --python ENV/bin/python [--runs weld:25:3000,weld:200:6000] [--out out/training]

ENV has yamsim[lerobot] and lerobot[training]==0.6.1. Finished stages in --out are not done again. A stage has wall and
CPU seconds of all its processes, the loss of `lerobot-train`, and the report of `eval`. Writes `training.json` and
`training.svg` beside them.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests import training_recipe as recipe
from tools.bench.stages import run_stage
from tools.bench.training_plot import plot_training

# `lerobot-train` logs `step:1K smpl:16K ... loss:0.123 ...`, which rounds the step.
_LOGGED = re.compile(r"ot_train\.py:\d+ step:\S+ smpl:.* loss:([0-9.]+) ")
_LOG_EVERY = 100
# Module of `lerobot-train`.
_UNMODIFIED = ["-m", "lerobot.scripts.lerobot_train"]
_REMEMBERING = Path(__file__).with_name("remembering_train.py")
_RUNS = "weld:200:6000,weld:25:3000,weld:50:3000,weld:100:3000,weld:200:3000,contact:100:3000,randomized:100:3000"


@dataclass(frozen=True)
class Bench:
    """Common settings of all runs.

    Attributes:
        python: of the environment with all programs.
        out: folder of results.
        most: kind -> recorded demonstrations; runs with fewer take the first of them.
        trials: of each policy.
        nice: niceness of the programs.
        remember: whether to train by `remembering_train.py`.
    """

    python: Path
    out: Path
    most: Mapping[str, int]
    trials: int
    nice: int
    remember: bool

    def stage(self, name: str, program: Sequence[str]) -> dict[str, float]:
        """Run a program unless its result exists, and return its seconds."""
        environ = {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "HF_HOME": str(self.out / "hf")}
        return run_stage(self.out, name, program, nice=self.nice, environ=environ)

    def yamsim(self, name: str, arguments: Sequence[str]) -> dict[str, float]:
        """Run a command of yamsim as a stage."""
        return self.stage(name, [str(self.python), "-m", "yamsim_cli", *arguments])

    def run(self, kind: recipe.Demonstrations, episodes: int, steps: int) -> dict[str, Any]:
        """Record, train and evaluate."""
        some, name = f"{kind.name}_{episodes}", f"{kind.name}_{episodes}_{steps}"
        demos, dataset, trained = self.out / kind.name, self.out / f"{some}_lerobot", self.out / f"{name}_trained"
        report, config = self.out / f"{name}.report.json", recipe.write_config(self.out / "act_states.yaml")
        trainer = [str(_REMEMBERING), "--num_workers=0"] if self.remember else _UNMODIFIED
        changed = [f"--steps={steps}", f"--log_freq={_LOG_EVERY}"]
        seconds = {
            "record": self.yamsim(f"{kind.name}.record", recipe.record(kind, self.most[kind.name], demos)),
            "export": self.yamsim(f"{some}.export", recipe.export(demos, dataset, episodes)),
            "train": self.stage(
                f"{name}.train",
                [str(self.python), *trainer, *recipe.train(config, dataset, trained, *changed)],
            ),
            "eval": self.yamsim(f"{name}.eval", [*recipe.evaluate(kind, trained, self.trials), "--out", str(report)]),
        }
        stats = json.loads(report.read_text())["stats"]
        kept = {key: stats[key] for key in ("n", "n_success", "wilson95", "dxy_m", "causes")}
        loss = [float(value) for value in _LOGGED.findall((self.out / f"{name}.train.log").read_text())]
        return {"kind": kind.name, "episodes": episodes, "steps": steps, **kept, "seconds": seconds, "loss": loss}


def main() -> None:
    """Run, print, and write the figures down."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", type=Path, required=True, help="of an environment with yamsim and LeRobot")
    parser.add_argument("--runs", default=_RUNS, help="kind:demonstrations:steps of training, and so on")
    parser.add_argument("--out", type=Path, default=Path("out/training"))
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--remember", action="store_true", help="read each frame once: the same policies, sooner")
    given = parser.parse_args()
    texts = (text.split(":") for text in given.runs.split(","))
    runs = [(kind, int(episodes), int(steps)) for kind, episodes, steps in texts]
    most = {kind: max(episodes for other, episodes, _ in runs if other == kind) for kind, _, _ in runs}
    bench = Bench(given.python.absolute(), given.out.absolute(), most, given.trials, given.nice, given.remember)
    bench.out.mkdir(parents=True, exist_ok=True)
    done = []
    for kind, episodes, steps in runs:
        done.append(one := bench.run(recipe.KINDS[kind], episodes, steps))
        low, high = one["wilson95"]
        train = one["seconds"]["train"]
        print(
            f"{kind}, {episodes}, {steps} steps: {one['n_success']} of {one['n']} ({low:.0%} to {high:.0%}), "
            f"loss {one['loss'][-1]}, training {train['wall_s']:.0f} s, {train['cpu_s']:.0f} CPU s",
            flush=True,
        )
        (bench.out / "training.json").write_text(json.dumps(done, indent=1) + "\n")
        plot_training(done, _LOG_EVERY, bench.out / "training.svg")


if __name__ == "__main__":
    main()
