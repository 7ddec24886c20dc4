"""Adapters: environments and batches as other libraries want them. Each imports its library when it is called."""

from maax_mjx.adapters.brax import brax
from maax_mjx.adapters.gymnasium import gymnasium_vector
from maax_mjx.adapters.jaxmarl import jaxmarl
from maax_mjx.adapters.pettingzoo import pettingzoo
from maax_mjx.adapters.playground import playground
from maax_mjx.adapters.stable_baselines3 import stable_baselines3
from maax_mjx.adapters.torch import torch

__all__ = ["brax", "gymnasium_vector", "jaxmarl", "pettingzoo", "playground", "stable_baselines3", "torch"]
