"""Policies of other programs, by the protocol that they speak."""

from __future__ import annotations

from collections.abc import Callable

from ..config.loader import load_config
from ..config.policy import PolicyConfig
from ..config.recording import RecordConfig
from ..policies import act, lerobot, openpi
from ..policies.environment_state import things_told
from ..policies.mapped import Client, MappedPolicy, Station
from ..session import Session
from .choice import PolicyChoice
from .observation import offered_cameras

# What a name begins with -> the config by which its messages are understood unless another one is named.
_CONFIGS = {act.SCHEME: "molmoact2_yam", openpi.SCHEME: "openpi_aloha", lerobot.SCHEME: "lerobot_export"}


def make_elsewhere(choice: PolicyChoice, session: Session) -> MappedPolicy:
    """A policy of another program. Raises as `make_policy`."""
    kind, _, rest = choice.name.partition(":")
    mapping = load_config(PolicyConfig, "policies", choice.mapping or _CONFIGS[kind], session.locations)
    where = station(session.config)
    if kind == lerobot.SCHEME:
        local = choice.folder / rest
        checkpoint = lerobot.LeRobotClient(str(local) if local.is_dir() else rest, mapping)
        return MappedPolicy(checkpoint, mapping, where, checkpoint.asks)
    servers: dict[str, Callable[[str, float], Client]] = {act.SCHEME: act.ActClient, openpi.SCHEME: openpi.OpenpiClient}
    return MappedPolicy(servers[kind](choice.name, choice.call_seconds), mapping, where)


def station(config: RecordConfig) -> Station:
    """What a policy finds on the rig, in the task."""
    arms = [config.rig.arms[k] for k in config.rig.recorded]
    cameras = {name: next(iter(keys)) for name, keys in offered_cameras(config).items() if len(keys) == 1}
    return Station(
        config.rig.name,
        tuple(arm.side for arm in arms),
        len(arms[0].robot.joints) + 1,
        tuple(arm.robot.fingers.full_opening if arm.robot.fingers else 0.0 for arm in arms),
        cameras,
        things_told(config),
        config.rig.T_base_in_world(config.rig.recorded[0]),
    )
