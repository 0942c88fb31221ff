"""Writes a small ACT policy of LeRobot with random weights and its processors, and the actions of LeRobot's own
inference: folder, observed.npz, actions.npy.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
from lerobot.common.control_utils import predict_action
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

folder, observed, out = sys.argv[1:]
torch.manual_seed(0)
STATE, SCENE, ACTION = "observation.state", "observation.images.scene_camera", "action"
config = ACTConfig(
    input_features={
        STATE: PolicyFeature(FeatureType.STATE, (7,)),
        SCENE: PolicyFeature(FeatureType.VISUAL, (3, 48, 64)),
    },
    output_features={ACTION: PolicyFeature(FeatureType.ACTION, (8,))},
    device="cpu",
    pretrained_backbone_weights=None,
    chunk_size=8,
    n_action_steps=4,
    dim_model=32,
    n_heads=2,
    dim_feedforward=64,
    n_encoder_layers=1,
    n_vae_encoder_layers=1,
    latent_dim=8,
)
stats = {
    STATE: {"mean": torch.full((7,), 0.5), "std": torch.full((7,), 2.0)},
    ACTION: {"mean": torch.tensor([0, 1.5, 1.5, -1, 0, 0, 0.02, 0.5]), "std": torch.full((8,), 0.05)},
    SCENE: {"mean": torch.full((3, 1, 1), 0.4), "std": torch.full((3, 1, 1), 0.2)},
}
policy = ACTPolicy(config)
before, after = make_pre_post_processors(config, dataset_stats=stats)
policy.eval()
policy.save_pretrained(folder)
before.save_pretrained(folder)
after.save_pretrained(folder)

told = np.load(observed)
rows = [
    predict_action(
        {STATE: told["state"], SCENE: told["scene"]}, policy, torch.device("cpu"), before, after, False, task="a task"
    )
    for _ in range(config.n_action_steps)
]
np.save(out, torch.cat(rows).numpy())
print(json.dumps({"files": sorted(path.name for path in Path(folder).iterdir())}))
