"""Training of agents: recurrent multi-agent PPO on any number of devices, and policies that play."""

from maax_mjx.training.config import PRESETS, LeagueConfig, NetConfig, PPOConfig, TrainConfig, preset
from maax_mjx.training.policy import Policy
from maax_mjx.training.run import Progress, Run, Trainer, train

__all__ = [
    "PRESETS",
    "LeagueConfig",
    "NetConfig",
    "PPOConfig",
    "Policy",
    "Progress",
    "Run",
    "TrainConfig",
    "Trainer",
    "preset",
    "train",
]
