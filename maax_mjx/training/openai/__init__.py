"""The policies that Baker et al. published, as they play the hide-and-seek games."""

from maax_mjx.training.openai.policy import OpenAIPolicy

__all__ = ["OpenAIPolicy"]
