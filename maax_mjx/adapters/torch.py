"""A batch in PyTorch's tensors, on the device where it is stepped, without a copy through the host."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.adapters.rows import Rows, Step
from maax_mjx.common.checks import described
from maax_mjx.common.errors import MissingLibraryError
from maax_mjx.parallel import Worlds


class TorchAgents:
    """Agents of a batch, whose observations, rewards and actions are tensors; `torch` makes it.

    Attributes:
        observation_space, action_space: of one agent.
        n_rows: number of agents: those of a world follow each other.
        device: where the worlds are.
    """

    def __init__(self, rows: Rows, library: Any):
        self._rows, self._torch = rows, library
        self.observation_space, self.action_space = rows.of.observation_space, rows.of.action_space
        self.n_rows = rows.n_rows
        (first,) = rows.worlds.shards.devices
        self.device = self._tensor(jax.device_put(jnp.zeros(1), first)).device

    def reset(self, seed: int | None = None, stagger: bool = False) -> Any:
        """Draws all worlds, and returns what is observed, (n_rows, ...).

        Args:
            seed: None goes on from the last draw.
            stagger: see `Worlds.reset`.
        """
        return self._tensors(self._rows.reset(seed, stagger).obs)

    def step(self, actions: Any) -> Step:
        """Steps all worlds, and returns a `Step` of tensors.

        Args:
            actions: a tensor (n_rows, ...), or a dict of them, as `action_space` has them.
        """
        is_dict = isinstance(actions, Mapping)
        given = {name: self._array(x) for name, x in actions.items()} if is_dict else self._array(actions)
        return self._tensors(self._rows.step(given))

    def _array(self, tensor: Any) -> jax.Array:
        if not isinstance(tensor, self._torch.Tensor):
            raise ValueError(f"actions: got {described(tensor)}; takes a tensor on {self.device}, where the worlds are")
        if tensor.device != self.device or tensor.layout != self._torch.strided:
            kind = "" if tensor.layout == self._torch.strided else f"{tensor.layout} "
            raise ValueError(f"actions: got a {kind}tensor on {tensor.device}; takes a dense one on {self.device}")
        # DLPack takes no tensors with gradients; JAX has no integers of 64 bits.
        tensor = tensor.detach().contiguous()
        return jnp.from_dlpack(tensor.int() if tensor.dtype == self._torch.int64 else tensor)

    def _tensors(self, tree: Any) -> Any:
        return jax.tree.map(self._tensor, tree)

    def _tensor(self, array: jax.Array) -> Any:
        if array.dtype == bool:
            # Bools travel as bytes.
            return self._torch.from_dlpack(array.astype(jnp.uint8)).bool()
        return self._torch.from_dlpack(array)


def torch(
    worlds: Worlds, team: str | None = None, policy: Any = None, *, flat: bool = True, seed: int = 0
) -> TorchAgents:
    """Makes a batch of tensors, by DLPack, whose rows are the agents of a team, or all agents.

    Example:
        ```python
        agents = adapters.torch(maax.Worlds(env, 4096))
        obs = agents.reset(seed=0)  # (n_rows, d), on the device of the worlds
        step = agents.step(actions)  # step.obs, step.reward, step.terminated, step.truncated, step.final_obs, ...
        ```

    Args:
        worlds, team, policy, flat, seed: as for `gymnasium_vector`; worlds on one device.

    Raises:
        MissingLibraryError: without PyTorch.
        ValueError: what `gymnasium_vector` refuses, or worlds on several devices.
    """
    try:
        import torch as library
    except ImportError as error:
        raise MissingLibraryError(
            "torch: needs PyTorch; https://pytorch.org/get-started says how to install it"
        ) from error
    if isinstance(worlds, Worlds) and len(worlds.shards.devices) > 1:
        raise ValueError("worlds: got worlds on several devices; takes those of one: a tensor lies on one")
    return TorchAgents(Rows(worlds, team, policy, flat, seed), library)
