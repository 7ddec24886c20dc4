"""The one compiled program of training: play, estimate what it was worth, learn from it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.runtime import quick_on_cpu
from maax_mjx.parallel import Worlds
from maax_mjx.parallel.episodes import WorldsState
from maax_mjx.parallel.shards import AXIS
from maax_mjx.training.collect import Batch, Remembered, collect, last_value
from maax_mjx.training.config import TrainConfig, check_divides
from maax_mjx.training.league import Opponents
from maax_mjx.training.network import Network, Weights, updated
from maax_mjx.training.ppo import Mean, Updates, joined, optimiser, rows_of, update
from maax_mjx.training.returns import ValueScale, advantages
from maax_mjx.training.stages import PREFIX
from maax_mjx.training.visited import looked_at, surprise

RETURN, ENDED, WHOLE = "return_", "ended_", "whole_episodes"
"""What agents of a team got in whole episodes, of how many agents that is, and how many these episodes are."""


class Learner(struct.PyTreeNode):
    """What is learnt, the same on all devices.

    Attributes:
        weights: the networks' weights.
        moments: the optimiser's state.
        scale: the scale of the critics' predictions.
        broken: () int32, iterations in a row none of whose updates was finite.
    """

    weights: Weights
    moments: Any
    scale: ValueScale
    broken: jax.Array


def new_learner(weights: Weights, config: TrainConfig) -> Learner:
    """Returns a learner that begins with some weights."""
    moments = optimiser(config.ppo).init(joined(weights)[0])
    return Learner(weights, moments, ValueScale.new(), jnp.zeros((), jnp.int32))


Iteration = Callable[..., tuple[Learner, WorldsState, Remembered, dict[str, jax.Array]]]


def compile_iteration(worlds: Worlds, network: Network, config: TrainConfig) -> Iteration:
    """Compiles an iteration.

    Args:
        worlds: the worlds.
        network: the networks.
        config: the settings.

    Returns:
        `(learner, opponents, key, states, memory) -> (learner, states, memory, metrics)`. The learner, the states and
        the memory are donated.

    Raises:
        ValueError: minibatches that do not divide.
    """
    shards = worlds.shards
    n_devices = len(shards.devices)
    groups = check_divides(config, n_devices) // n_devices

    def mean(tree: Any) -> Any:
        return jax.lax.pmean(tree, AXIS) if shards.method == "shard_map" else tree

    return shards.compile(
        partial(iterate, worlds, network, config, groups, mean),
        (None, None, None, 0, 0),
        out_axes=(None, 0, 0, None),
        donate=(0, 3, 4),
        options=quick_on_cpu(1, shards.devices[0].platform),
    )


def iterate(
    worlds: Worlds,
    network: Network,
    config: TrainConfig,
    groups: int,
    mean: Mean,
    index: jax.Array,
    learner: Learner,
    opponents: Opponents | None,
    key: jax.Array,
    states: WorldsState,
    memory: Remembered,
) -> tuple[Learner, WorldsState, Remembered, dict[str, jax.Array]]:
    """Makes one iteration on one device.

    Args:
        worlds, network, config: what is trained, and how.
        groups: groups of this device's worlds that are shuffled apart.
        mean: averages over devices.
        index: (n,) indices of this device's worlds.
        learner, opponents: what plays.
        key: key of this iteration.
        states, memory: of this device's worlds.
    """
    ppo, weights, scale = config.ppo, learner.weights, learner.scale
    play, shuffle, pick = jax.random.split(key, 3)
    share = config.visited.share
    if share:
        look, choose = jax.random.split(jax.random.fold_in(pick, index[0]))
        n_new = len(memory.archive.there) // config.visited.stay
        seen, where = looked_at(states, n_new, look)
    states, memory, batch, before = collect(
        worlds, network, weights, opponents, index, states, memory, play, ppo, share
    )
    value = scale.denormalised(batch.value)
    nexts = jnp.concatenate([value[1:], last_value(network, weights, scale, states, memory)[None]])
    per_agent = partial(jnp.broadcast_to, shape=value.shape)
    end, last, fault = (per_agent(x[..., None]) for x in (batch.end, batch.last, batch.fault))
    after = jnp.where(last, scale.denormalised(batch.after), nexts)
    gain = advantages(batch.reward, value, after, end, last, fault, ppo.gamma, ppo.lam)
    returns = gain + value
    if share:
        score = jnp.nan_to_num(surprise(gain[0], batch.counts[0])[where], posinf=0.0)
        memory = memory.replace(archive=memory.archive.kept(seen, score, n_new, choose))
    scale, weights = _rescaled(scale, weights, returns, batch.counts, mean)
    gain = _standardised(gain, batch.acts, network, ppo.advantage, mean)
    rows = rows_of(batch, before, gain, scale.normalised(returns), ppo.chunk)
    now = Updates(weights, learner.moments, jnp.zeros((), bool), jnp.zeros_like(learner.broken))
    first_group = index[0] * groups // len(index)
    order = _order(shuffle, first_group, groups, rows.begins.shape[1], config)

    def learn(now: Updates, picked: jax.Array) -> tuple[Updates, dict[str, jax.Array]]:
        return update(now, network, ppo, rows.picked(picked), mean)

    now, info = jax.lax.scan(learn, now, order)
    norm = now.weights.norm
    weights = now.weights.replace(norm=finite_or(updated(norm, batch.features, mean), norm))
    broken = jnp.where(now.broken < len(order), 0, learner.broken + 1)
    played = metrics_of(network, batch, value, returns, mean, len(worlds.shards.devices))
    metrics = {name: x.mean() for name, x in info.items()} | played
    return Learner(weights, now.moments, scale, broken), states, memory, metrics


def finite_or(new: Any, old: Any) -> Any:
    """Returns a tree if all of it is finite, else the old one: rewards or observations of one step may be NaN."""
    fine = [jnp.isfinite(x).all() for x in jax.tree.leaves(new)]
    return jax.tree.map(lambda a, b: jnp.where(jnp.stack(fine).all(), a, b), new, old)


def _rescaled(
    scale: ValueScale, weights: Weights, returns: jax.Array, counts: jax.Array, mean: Mean
) -> tuple[ValueScale, Weights]:
    """Updates the scale, and the critics' last layers so that what they predict stays (van Hasselt et al. 2016)."""
    sums = (counts.sum(dtype=jnp.float32), *(jnp.where(counts, x, 0.0).sum() for x in (returns, returns**2)))
    n, first, second = mean(sums)
    n = jnp.maximum(n, 1.0)
    new = finite_or(scale.updated(first / n, second / n), scale)
    (mean_was, std_was), (mean_is, std_is) = scale.moments, new.moments

    def corrected(head: dict[str, jax.Array]) -> dict[str, jax.Array]:
        bias = (std_was * head["bias"] + mean_was - mean_is) / std_is
        return {"kernel": head["kernel"] * (std_was / std_is), "bias": bias}

    critic = {name: {**tower, "value": corrected(tower["value"])} for name, tower in weights.critic.items()}
    return new, weights.replace(critic=critic)


def _standardised(gain: jax.Array, acts: jax.Array, network: Network, over: str, mean: Mean) -> jax.Array:
    """Standardises advantages (n_steps, n_worlds, n_agents) over all agents, or each team's."""
    teams = network.team_index if over == "team" else network.team_index * 0
    result = gain
    for team in range(int(teams.max()) + 1):
        mine = acts & (teams == team)
        sums = mine.sum(dtype=jnp.float32), *(jnp.where(mine, x, 0.0).sum() for x in (gain, gain**2))
        n, first, second = mean(sums)
        n = jnp.maximum(n, 1.0)
        middle = first / n
        std = jnp.sqrt(jnp.maximum(second / n - middle**2, 0.0))
        result = jnp.where(teams == team, (gain - middle) / (std + 1e-8), result)
    return result


def _order(key: jax.Array, first: jax.Array, groups: int, n_rows: int, config: TrainConfig) -> jax.Array:
    """Returns the rows of every update: (epochs * minibatches, microbatches, rows).

    Groups of neighbouring worlds are shuffled apart, each by its own key, and give an equal share to every minibatch:
    minibatches have the same rows on any number of devices.
    """
    ppo, size = config.ppo, n_rows // groups

    def epoch(key: jax.Array) -> jax.Array:
        keys = jax.vmap(lambda g: jax.random.fold_in(key, first + g))(jnp.arange(groups))
        order = jax.vmap(lambda k: jax.random.permutation(k, size))(keys) + size * jnp.arange(groups)[:, None]
        parts = order.reshape(groups, ppo.minibatches * ppo.microbatches, -1)
        return jnp.swapaxes(parts, 0, 1).reshape(ppo.minibatches, ppo.microbatches, -1)

    return jax.vmap(epoch)(jax.random.split(key, ppo.epochs)).reshape(
        ppo.epochs * ppo.minibatches, ppo.microbatches, -1
    )


def counted_by(name: str) -> str:
    """The count of an iteration that a number of its episodes is a mean over; "" of all other numbers."""
    if name.startswith(RETURN):
        return ENDED + name.removeprefix(RETURN)
    return WHOLE if name.startswith(PREFIX) else ""


def metrics_of(
    network: Network, batch: Batch, value: jax.Array, returns: jax.Array, mean: Mean, n_devices: int
) -> dict[str, jax.Array]:
    """Numbers of an iteration's play: of steps by team, and of the episodes that ended in it, 0 where none counts."""
    over: dict[str, tuple[jax.Array, jax.Array]] = {}
    done = batch.last & ~batch.visited
    counted = {"episodes": batch.last, WHOLE: done, "faults": batch.fault}
    for i, (team, _) in enumerate(network.teams):
        mine = network.team_index == i
        acts, counts = batch.acts & mine, batch.counts & mine
        over[f"reward_{team}"] = (jnp.where(acts, batch.reward, 0.0).sum(), acts.sum())
        ended = counts & done[..., None]
        over[RETURN + team] = (jnp.where(ended, batch.total, 0.0).sum(), ended.sum())
        counted[ENDED + team] = ended
        error, spread = (jnp.where(counts, x, 0.0) for x in (returns - value, returns))
        n = counts.sum()
        for name, x in (("error", error), ("error_square", error**2), ("target", spread), ("square", spread**2)):
            over[f"{name} {team}"] = (x.sum(), n)
    for name, x in batch.metrics.items():
        if name != "physics_fault":
            x = x.reshape(*done.shape, -1).astype(jnp.float32).mean(-1)
            over[PREFIX + name] = (jnp.where(done, x, 0.0).sum(), done.sum())
    sums = mean({name: tuple(jnp.asarray(x, jnp.float32) for x in pair) for name, pair in over.items()})
    means = {name: total / jnp.maximum(n, 1e-9) for name, (total, n) in sums.items()}
    for team, _ in network.teams:
        error = means.pop(f"error_square {team}") - means.pop(f"error {team}") ** 2
        spread = means.pop(f"square {team}") - means.pop(f"target {team}") ** 2
        means[f"explained_{team}"] = 1 - error / jnp.maximum(spread, 1e-8)
    # What is counted on each device is averaged over them.
    return means | mean({name: n_devices * x.sum(dtype=jnp.float32) for name, x in counted.items()})
