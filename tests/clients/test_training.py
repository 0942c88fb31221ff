"""The recipe of docs/training.md in miniature, with LeRobot's own training."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests import training_recipe as recipe
from tests.clients.environments import Interpreter, yamsim_beside

pytestmark = pytest.mark.render

# Enough to learn one demonstration.
STEPS = 600
# s; the machine may be busy
PATIENCE = 1800


@pytest.mark.client_heavy
def test_what_is_demonstrated_once_is_learnt_and_done_again(
    client: Callable[[str], Interpreter], tmp_path: Path
) -> None:
    """From the same start, since one demonstration teaches no other."""
    both, _ = yamsim_beside(client("lerobot"), tmp_path / "both")

    def call(*arguments: str) -> str:
        done = both.call(["-m", *arguments], timeout_s=PATIENCE, cwd=tmp_path)
        assert done.returncode == 0, f"{' '.join(arguments)}:\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    kind, config = recipe.KINDS["weld"], recipe.write_config(tmp_path / "act_states.yaml")
    demos, dataset, trained = (tmp_path / name for name in ("demos", "demos_lerobot", "trained"))
    call("yamsim_cli", *recipe.record(kind, 1, demos))
    call("yamsim_cli", *recipe.export(demos, dataset, 1))
    call("lerobot.scripts.lerobot_train", *recipe.train(config, dataset, trained, f"--steps={STEPS}"))
    checkpoint = json.loads((trained / "checkpoints/last/pretrained_model/config.json").read_text())
    inputs = {key: feature["shape"] for key, feature in checkpoint["input_features"].items()}
    assert inputs == {"observation.state": [7], "observation.environment_state": [18]}
    words = recipe.evaluate(kind, trained, trials=1, seed=recipe.RECORD_SEED)
    report = json.loads(call("yamsim_cli", *words, "--json"))
    assert (report["stats"]["n"], report["stats"]["n_success"]) == (1, 1), report["trials"]
