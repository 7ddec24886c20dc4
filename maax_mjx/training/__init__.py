"""Training of agents: recurrent multi-agent PPO on any number of devices, and policies that play."""

from maax_mjx.training.bar import Bar
from maax_mjx.training.begin import environment_of
from maax_mjx.training.config import PRESETS, LeagueConfig, NetConfig, PPOConfig, TrainConfig, VisitedConfig, preset
from maax_mjx.training.evaluate import Estimate, Evaluation, Match, as_json, evaluate, player_of
from maax_mjx.training.interventions import INTERVENTIONS, intervened
from maax_mjx.training.openai import OpenAIPolicy
from maax_mjx.training.opponents import SCRIPTED, Scripted
from maax_mjx.training.policy import Policy
from maax_mjx.training.ratings import Rating, Result, rate
from maax_mjx.training.run import Progress, Run, Trainer
from maax_mjx.training.shipped import policies
from maax_mjx.training.train import train
from maax_mjx.training.trained import TrainedPolicy

__all__ = [
    "INTERVENTIONS",
    "PRESETS",
    "SCRIPTED",
    "Bar",
    "Estimate",
    "Evaluation",
    "LeagueConfig",
    "Match",
    "NetConfig",
    "OpenAIPolicy",
    "PPOConfig",
    "Policy",
    "Progress",
    "Rating",
    "Result",
    "Run",
    "Scripted",
    "TrainConfig",
    "TrainedPolicy",
    "Trainer",
    "VisitedConfig",
    "as_json",
    "environment_of",
    "evaluate",
    "intervened",
    "player_of",
    "policies",
    "preset",
    "rate",
    "train",
]
