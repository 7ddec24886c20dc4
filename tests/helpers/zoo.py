"""An environment with everything at once, and worlds of it to read."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

import maax_mjx as maax
from helpers import seeds
from helpers.chance import P_MIN

N, FEW = 1_000, 100


def make(n_agents, *modules, **base):
    env = maax.Base(n_agents, impl="c", **base)
    for module in modules:
        env.add_module(module)
    return env


@functools.cache
def zoo_env():
    """Everything at once, every parameter a range. Boxes and agents draw one by one, cylinders together."""
    return make(
        6,
        maax.WallScenarios(
            ("quad", "random"),
            p_door_dropout=(0.0, 0.5),
            n_rooms=(1, 4),
            prob_outside_walls=(0.5, 1),
            friction=(0.1, 0.9),
        ),
        maax.FloorAttributes(friction=(0.1, 0.9)),
        maax.WorldConstants(gravity=(-20.0, -5.0)),
        maax.Agents(
            {"hiders": (1, 3), "seekers": (1, 3)}, friction=(0.1, 0.9), damping=(5, 15), gear=(50, 150), polar_obs=True
        ),
        maax.Boxes(
            (0, 4),
            n_elongated_boxes=(0, 4),
            box_size=(0.3, 0.5),
            box_mass=(0.5, 3.0),
            box_friction=(0.1, 0.9),
            boxid_obs=True,
        ),
        maax.Ramps((0, 2), ramp_friction=(0.1, 0.9)),
        maax.Cylinders((0, 2), (0.3, 0.6), (0.2, 0.6), friction=(0.1, 0.9), per_object=False),
        maax.Food((0, 3)),
        maax.ConstructionSites((0, 3), n_elongated_sites=(0, 3)),
        floor_size=(5.0, 7.0),
    )


@functools.cache
def reset_of(env):
    return jax.jit(jax.vmap(env.reset, in_axes=(0, 0)))


def draw(env, seed=0, **ranges):
    """N worlds; a range of shape (N, 2) is one per world. Every draw of an environment is one compiled function."""
    params = env.default_params.replace(**ranges)
    params = jax.tree.map(lambda x: x if x.ndim == 2 else jnp.broadcast_to(x, (N, 2)), params)
    return reset_of(env)(jax.random.split(seeds.key(seed), N), params)


@jax.jit
def few(states):
    return jax.tree.map(lambda x: x[:FEW], states)


def field(env, state, name, ids):
    """(N, n, ...) rows `ids` of a model field: overlaid where worlds differ in them, else the compiled model's."""
    rows, own = list(env.overlay.get(name, ())), getattr(env.model, name)
    values = np.asarray(state.world.fields[name]) if rows else None
    n = len(np.asarray(state.world.valid))
    ids = np.asarray(ids).ravel()
    columns = [values[:, rows.index(i)] if i in rows else np.broadcast_to(own[i], (n, *own[i].shape)) for i in ids]
    return np.stack(columns, axis=1)


def active(state, kind):
    return np.asarray(state.world.active[kind])


def wall_rects(env, state):
    ids = [i for i in range(env.model.ngeom) if env.model.geom(i).name.startswith("wall")]
    pos, half = field(env, state, "geom_pos", ids), field(env, state, "geom_size", ids)
    rects = np.concatenate([(pos - half)[..., :2], (pos + half)[..., :2]], axis=-1)
    return np.where((pos + half)[..., 2:] > 0, rects, np.nan)


def uniform(x, low, high):
    return (
        low - 1e-5 <= np.min(x)
        and np.max(x) <= high + 1e-5
        and stats.kstest(x, "uniform", (low, high - low)).pvalue > P_MIN
    )
