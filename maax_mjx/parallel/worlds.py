"""`Worlds`: a batch of worlds with automatic resets, with a new layout every episode, on any number of devices."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakSet

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_bool, check_count, check_key, check_not_donated, described, is_traced
from maax_mjx.common.params import DomainParams, check_params
from maax_mjx.common.runtime import is_out_of_memory, no_collection, quick_on_cpu
from maax_mjx.common.spaces import check_action
from maax_mjx.core.blame import blame
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import check_fits
from maax_mjx.parallel.episodes import Visited, WorldsState, advance, begin, stale_under
from maax_mjx.parallel.faults import FaultKeeper
from maax_mjx.parallel.memory import check_memory
from maax_mjx.parallel.policy import Playable, Policy, check_policy, is_player
from maax_mjx.parallel.rollout import check_keep, unroll
from maax_mjx.parallel.shards import Devices, Shards

ROLLOUTS = 16
"""Rollouts with different arguments that stay compiled."""


class Worlds:
    """`n_worlds` worlds of one environment, stepped together and reset one by one.

    A world depends only on its own key: not on its neighbours, their number, or the devices. Next episodes are drawn
    ahead of time in chunks, so that a step pays for about `n_worlds / horizon` resets, and no world waits for others.

    Several devices take an equal share each and never wait for each other. With "shard_map", arrays have the leading
    axis (n_worlds,), spread over the devices; with "pmap" they have the axes (n_devices, n_worlds / n_devices) of
    `jax.pmap`. `shape` has these axes. After `jax.distributed.initialize()` the devices "all" are those of all
    processes. Each process makes the same calls: with "shard_map" on arrays that span them, with "pmap" on its own.

    Args:
        env: the environment.
        n_worlds: number of worlds on all devices together.
        devices: None uses one device, JAX's default; a number the first of `jax.devices()`; "all" all of them, also
            those of other processes; or a list of devices.
        method: "jit" for one device, "shard_map" or "pmap" for any number; None is "jit" for one device, "shard_map"
            for several.
        donate: whether `step` and `rollout` reuse the memory of the states that they get, which must not be used
            again.
        keep_faults: folder in which the last states and actions of worlds with faults are kept, up to 16 of them;
            None keeps none. `faults()` lists the files, `maax.load_fault` reads one, and `maax-mjx info` and
            `maax-mjx replay` show it. It takes memory for eight states of every world, and some per cent of the speed.

    Raises:
        ValueError: an argument out of its range, numbers of worlds and devices without equal shares, or worlds whose
            states alone would fill the memory.
    """

    def __init__(
        self,
        env: Environment,
        n_worlds: int,
        devices: Devices = None,
        method: str | None = None,
        *,
        donate: bool = True,
        keep_faults: str | Path | None = None,
    ):
        self.env = check_environment(env)
        self.n_worlds = check_count("n_worlds", n_worlds, minimum=1)
        self._donate = (0,) if check_bool("donate", donate) else ()
        self.shards = Shards(self.n_worlds, devices, method)
        self.shape = self.shards.shape
        check_memory("n_worlds", self.env, self.n_worlds, self.shards.devices)
        env.base.engine.check_devices(self.shards.n_local)
        self._keeper = None if keep_faults is None else FaultKeeper(env, keep_faults)
        compiled = self.shards.compile
        # Programs that run once need not be fast.
        once, often = (quick_on_cpu(level, self.shards.devices[0].platform) for level in (0, 1))
        self._reset = compiled(self._begin, (None, 0, None), options=once)
        self._step = compiled(lambda _, *args: self.step_fn(*args), (0, 0), donate=self._donate, options=often)
        self._sample = compiled(self._sample_fn, (None,), options=once)
        self._remember = compiled(self._with_memory, (0,), options=once)
        self._stale = compiled(lambda _, *args: stale_under(*args), (0, 0, 0))
        self._options = often
        self._rollout: Callable = lru_cache(ROLLOUTS)(self._compile_rollout)
        self._ran: WeakSet[Callable] = WeakSet()
        self._saw_layouts = False

    def __repr__(self) -> str:
        devices = self.shards.devices
        on = f"{len(devices)} {devices[0].device_kind}" if len(devices) > 1 else str(devices[0])
        return f"<Worlds: {self.n_worlds} on {on} ({self.shards.method}) of {self.env!r}>"

    def __reduce__(self) -> Any:
        raise ValueError(
            "worlds: got them to be pickled or copied, and they hold devices and compiled programs; takes their "
            "environment, worlds.env, of which Worlds(env, n_worlds) are made again"
        )

    def reset(self, key: jax.Array, params: DomainParams | None = None, *, stagger: bool = False) -> WorldsState:
        """Draws all worlds.

        Args:
            key: a typed key; it and i alone determine world i.
            params: ranges with leaves (2,), or (n_worlds, 2) for a range per world; None uses the defaults.
            stagger: whether the ends of the first episodes are spread over the horizon, which keeps training batches
                and their cost even. They begin as if some steps had passed with the world at rest; `obs` and `can_act`
                before their first step are still an episode's first ones. Not in an endless game.

        Warns:
            UserWarning: at the first reset, where more than one layout in a hundred is invalid; the message has their
                share and the placements to blame.

        Raises:
            ValueError: a raw uint32 key, params out of their bounds, or `stagger` without a horizon; at the first
                reset, no layout that is valid.
            MemoryError: more worlds than fit.
        """
        check_key("key", key)
        if check_bool("stagger", stagger) and self.env.base.horizon is None:
            raise ValueError("stagger: got True with horizon=None; takes False: an endless game has no ends to spread")
        params = self.env.default_params if params is None else params
        shared = self.shards.share(key), self._per_world(params), self.shards.share(np.asarray(stagger))
        states = self.run(self._reset, *shared)
        if not self._saw_layouts and not is_traced(states):
            self._saw_layouts = True
            valid, ranges = self.shards.on_host((states.world.valid, states.params))
            if blamed := blame(self.env.base, valid, ranges):
                warnings.warn(f"Worlds: {blamed}", stacklevel=2)
        return states

    def step(self, states: WorldsState, action: Any) -> WorldsState:
        """Advances every world by one env step, and starts the next episode where one ended.

        Args:
            states: states from `reset` or `step`; donated.
            action: the env's action with the leading axes `shape`.

        Raises:
            ValueError: an action of a wrong shape or with NaN, or states of other worlds.
            RuntimeError: states that were donated to an earlier call.
            MemoryError: more worlds than fit.
        """
        self.check_states(states)
        check_action(self.env.action_space, action, self.shape)
        return self.run(self._step, states, action)

    def rollout(
        self,
        states: WorldsState,
        policy: Policy | Playable,
        n_steps: int,
        *args: Any,
        key: jax.Array | None = None,
        keep: tuple[str, ...] = (),
        memory: Any = None,
        per_world: tuple[Any, ...] = (),
    ) -> tuple[WorldsState, dict[str, Any]]:
        """Steps all worlds many times in one compiled program that keeps only the requested parts.

        Args:
            states: states from `reset`, `step` or `rollout`; donated.
            policy: `policy(state, key, *args) -> action` for one world: its `State`, a key for this world and step, and
                `args`; with a memory `policy(state, key, memory, *args) -> (action, memory)`. It may also return a dict
                of arrays, last: `(action, extras)`, `(action, memory, extras)`. Pass the same function again, or it is
                compiled again. A trained policy (`maax_mjx.training.Policy`) and a scripted player
                (`maax_mjx.training.SCRIPTED["chase"]`) bring their parameters and their memory.
            n_steps: number of env steps.
            args: further arguments of the policy, such as a network's parameters; arrays, which may change from call to
                call.
            key: key of the policy's keys; None is `jax.random.key(0)`. Worlds get the same keys on any number of
                devices.
            keep: names of what to return for every step: "action", "extras", "reward", "terminated", "truncated",
                "final_obs", "metrics", "data" and others, or a part of one such as "metrics.physics_fault" or
                "extras.value"; "obs", "active" and "can_act" are what the policy saw, everything else is from after the
                step.
            memory: a tree of arrays with the leading axes `shape`: the policy's memory in every world. It is zeroed
                where an episode ends.
            per_world: further arguments of the policy, after `args`: trees of arrays with the leading axes `shape`, of
                which the policy gets the world's own.

        Returns:
            The states after the last step, and a dict by the names of `keep`, (n_steps, n_worlds, ...) each, or with
            pmap (n_steps, n_devices, n_worlds / n_devices, ...). With a memory also `"memory"`: the one after the last
            step, to go on with.

        Raises:
            ValueError: an unknown name, states of other worlds, a policy that takes other arguments, or what it gives
                does not fit.
            RuntimeError: states that were donated to an earlier call.
            MemoryError: more worlds, or more to keep, than fit.
        """
        self.check_states(states)
        n_steps = check_count("n_steps", n_steps, minimum=1)
        if is_player(policy):
            player = policy.on(self.env)
            policy, args = player.play, (player.params, *args)
            begun = player.memory(self.n_worlds)
            memory = self.shards.put(begun) if memory is None else self._same_memory(memory, begun)
        if not isinstance(per_world, tuple):
            raise ValueError(f"per_world: got {described(per_world)}; takes a tuple of trees of arrays")
        check_policy(policy, memory is not None, (*args, *per_world))
        self._check_rows("memory", memory)
        self._check_rows("per_world", per_world)
        key = jax.random.key(0) if key is None else key
        check_key("key", key)
        program = self._rollout(policy, n_steps, check_keep(keep))
        states, kept, memory = self.run(program, states, self.shards.share(key), args, memory, per_world)
        return states, kept if memory is None else kept | {"memory": memory}

    def with_params(self, states: WorldsState, params: DomainParams) -> WorldsState:
        """Returns the states with other ranges, which hold from every world's next episode on, without recompilation.

        Args:
            states: states from `reset` or `step`.
            params: ranges with leaves (2,), or (n_worlds, 2) for a range per world.

        Raises:
            ValueError: params out of their bounds.
        """
        params = self._per_world(params)
        # Beginnings that were drawn from other ranges are drawn again.
        stale = self._stale(params, states.params, states.upcoming.stale)
        return states.replace(params=params, upcoming=states.upcoming.replace(stale=stale))

    def sample_action(self, key: jax.Array) -> dict[str, jax.Array]:
        """Draws a uniform random action for every world, the same on any number of devices."""
        check_key("key", key)
        return self._sample(self.shards.share(key))

    @cached_property
    def states_shape(self) -> WorldsState:
        """Shapes and dtypes of the states from `reset`, with the leading axis (n_worlds,)."""
        params = jax.tree.map(lambda x: jnp.broadcast_to(x, (self.n_worlds, 2)), self.env.default_params)
        return jax.eval_shape(self.reset_fn, jax.random.key(0), params, jnp.zeros((), bool))

    def flat(self, tree: Any) -> Any:
        """Returns arrays of the batch with the leading axis (n_worlds,), whatever `shape` is."""
        if len(self.shape) == 1:
            return tree
        return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]), tree)

    def reset_fn(self, key: jax.Array, params: DomainParams, stagger: jax.Array) -> WorldsState:
        """Draws worlds as `reset` does, as a pure function for use in traced code; params have leaves (n_worlds, 2)."""
        return self._begin(jnp.arange(self.n_worlds), key, params, stagger)

    def step_fn(self, states: WorldsState, action: Any, visited: Visited | None = None) -> WorldsState:
        """Steps any number of worlds as `step` does, as a pure function for use in traced code.

        Args:
            states: their states.
            action: what their agents do.
            visited: states with which the next episodes begin where one ends here, instead of what was drawn.
        """
        return advance(self.env, states, action, None if self._keeper is None else self._keeper.watch, visited)

    def with_env(self, env: Environment) -> Worlds:
        """Returns as many worlds of another environment, on the same devices and with the same settings."""
        folder = None if self._keeper is None else self._keeper.folder
        method, donate = self.shards.method, bool(self._donate)
        return Worlds(env, self.n_worlds, self.shards.devices, method, donate=donate, keep_faults=folder)

    def faults(self) -> list[Path]:
        """Returns the files of `keep_faults` that are there, once all of them are written.

        Raises:
            ValueError: worlds without `keep_faults`.
        """
        if self._keeper is None:
            raise ValueError("keep_faults: got None for these worlds; takes a folder, where their faults are kept")
        return self._keeper.files()

    def remembering(self, states: WorldsState) -> WorldsState:
        """Returns states that come from elsewhere, with an empty memory of what happened last, for `keep_faults`."""
        if self._keeper is None:
            return states.replace(recent=())
        return self._remember(states.replace(recent=()))

    def _begin(self, index: jax.Array, key: jax.Array, params: DomainParams, stagger: jax.Array) -> WorldsState:
        states = begin(self.env, self.n_worlds, index, key, params, stagger)
        return states if self._keeper is None else self._with_memory(index, states)

    def _with_memory(self, index: jax.Array, states: WorldsState) -> WorldsState:
        assert self._keeper is not None
        return states.replace(recent=self._keeper.begin(index, states))

    def _sample_fn(self, index: jax.Array, key: jax.Array) -> dict[str, jax.Array]:
        keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)
        return jax.vmap(self.env.sample_action)(keys)

    def _compile_rollout(self, policy: Policy, n_steps: int, keep: tuple[str, ...]) -> Callable:
        def rollout(index: jax.Array, states: WorldsState, *others: Any) -> Any:
            return unroll(self.env, self.step_fn, policy, n_steps, keep, index, states, *others)

        axes = (0, None, None, 0, 0)
        return self.shards.compile(rollout, axes, out_axes=(0, 1, 0), donate=self._donate, options=self._options)

    def _per_world(self, params: DomainParams) -> DomainParams:
        """Returns a range for every world, in separate memory, since states are donated."""
        check_params(params, self.env.base.parameters, (self.n_worlds,))
        return self.shards.put(jax.tree.map(lambda x: np.broadcast_to(x, (self.n_worlds, 2)), params))

    def check_states(self, states: Any) -> None:
        """Refuses what are not states of these worlds.

        Raises:
            ValueError: states of another number of worlds or another environment.
            RuntimeError: states that were donated.
        """
        if not isinstance(states, WorldsState) or jnp.shape(states.step) != self.shape:
            got = f"{jnp.size(states.step)} worlds" if isinstance(states, WorldsState) else type(states).__name__
            raise ValueError(f"states: got {got}; takes the WorldsState of {self.n_worlds} worlds that reset gives")
        check_not_donated(states.step)
        if isinstance(states.recent, tuple) != (self._keeper is None):
            raise ValueError(
                "states: got those of worlds with keep_faults for worlds without, or the other way round; takes their "
                "own, or those that `remembering` makes of others"
            )
        check_fits(states, self.env.state_shape, leading=len(self.shape))

    def _same_memory(self, memory: Any, begun: Any) -> Any:
        """Returns a player's memory, which is refused unless it has the shapes of the one that it begins with."""
        got, takes = jax.tree.map(jnp.shape, memory), jax.tree.map(lambda x: (*self.shape, *x.shape[1:]), begun)
        if got != takes:
            raise ValueError(
                f"memory: got shapes {got}; takes {takes}, such as an earlier rollout of the player returned, or None"
            )
        return memory

    def _check_rows(self, name: str, tree: Any) -> None:
        """Refuses arrays without the batch's leading axes."""
        for leaf in jax.tree.leaves(tree):
            if jnp.shape(leaf)[: len(self.shape)] != self.shape:
                raise ValueError(
                    f"{name}: got an array of shape {jnp.shape(leaf)}; takes the leading axes {self.shape}, a row for "
                    "every world"
                )

    def run(self, program: Callable, *args: Any) -> Any:
        """Runs a compiled program; its first run is waited for, since accelerators report a lack of memory late."""
        if program in self._ran:
            return self._run(program, *args)
        with no_collection():
            results = self._run(program, *args)
        if not is_traced(results):
            self._ran.add(program)
        return results

    def _run(self, program: Callable, *args: Any) -> Any:
        try:
            results = program(*args)
            if program not in self._ran and not is_traced(results):
                jax.block_until_ready(results)
            return results
        except jax.errors.JaxRuntimeError as error:
            if not is_out_of_memory(error):
                raise
            # Warp inside a program needs memory that JAX took at its start and does not give back.
            warp = "leave Warp more of it (XLA_PYTHON_CLIENT_MEM_FRACTION=0.25 in the environment), "
            raise MemoryError(
                f"Worlds: {self.shards.per_device} worlds do not fit into the memory of one "
                f"{self.shards.devices[0].device_kind}; take fewer (n_worlds), more devices (devices='all'), "
                f"{warp if self.env.base.engine.impl == 'warp' else ''}or in a rollout fewer steps or less to keep "
                f"({str(error).splitlines()[0]})"
            ) from error
