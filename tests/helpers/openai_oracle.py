"""The policies that Baker et al. published, in plain NumPy, written from a description of them and not from ours.

Three pieces: files of weights of the published names and shapes, what the networks make of observations in loops of
float64, and those observations from the split ones of our games.
"""

from __future__ import annotations

import io
import pickle
from math import sqrt
from pathlib import Path

import numpy as np

FULL, QUADRANT = "full", "quadrant"
GAMES = {FULL: "hide_and_seek_full", QUADRANT: "hide_and_seek_quadrant"}
FILTERS, WIDTH, HEADS, HIDDEN, RAYS = 9, 128, 4, 256, 30
KINDS = ("agent_qpos_qvel", "box_obs", "ramp_obs")
"""Kinds of entities in the order of their dense layers; the agent itself comes last."""
MAIN, SITES = "main", "construction_site_obs"
MASKS = ("mask_aa_obs", "mask_ab_obs", "mask_ar_obs")
MASK_OF = dict(zip((*KINDS, SITES), (*MASKS, "mask_acs_obs_spoof"), strict=True))
COLUMNS = {
    FULL: {"observation_self": 10, "agent_qpos_qvel": 10, "box_obs": 15, "ramp_obs": 15, "lidar": 1},
    QUADRANT: {"observation_self": 10, "agent_qpos_qvel": 10, "box_obs": 12, "ramp_obs": 9, "lidar": 1},
}
PARTS = {"action_movement": 33, "action_pull": 2, "action_glueall": 2}
OURS = {"action_movement": "move", "action_pull": "grab", "action_glueall": "lock"}
LAYERS = {FULL: {"dense": "dense12-0", "lstm": "lstm14"}, QUADRANT: {"dense": "dense11-0", "lstm": "lstm12"}}
NET, VALUE = "policy_net/", "vpred_net/"
BLOCK = "self-attention8/residual_sa_block8"
EMBED = f"{BLOCK}/self_attention/qkv_embed"
EPSILON = 1e-12
NOTHING_HIT = 6.0
AGENT_CORNER, RAMP_CORNER, CUBE_CORNER = 0.15, 0.25, 0.25
ARGUMENTS = "policy_fn_and_args"
STATISTICS = ("mean", "sq", "debiasing_term")


# Files.


def _net_shapes(game, net, kinds):
    """Shapes of a tower without its heads, by name without the first prefix."""
    columns, n_main = COLUMNS[game], COLUMNS[game]["observation_self"] + FILTERS * RAYS
    shapes = {"circ_conv1d0/conv1d/kernel": (3, 1, FILTERS), "circ_conv1d0/conv1d/bias": (FILTERS,)}

    def dense(name, n_in, n_out):
        shapes[f"{name}/kernel"], shapes[f"{name}/bias"] = (n_in, n_out), (n_out,)

    def layer_norm(name, n):
        shapes[f"{name}/LayerNorm/beta"] = shapes[f"{name}/LayerNorm/gamma"] = (n,)

    for i, kind in enumerate(_in_order(kinds)):
        dense(f"dense6-{i}", (0 if kind == MAIN else columns.get(kind, 15)) + n_main, WIDTH)
    dense(f"{EMBED}/qk_embed", WIDTH, 2 * WIDTH)
    dense(f"{EMBED}/v_embed", WIDTH, WIDTH)
    dense(f"{BLOCK}/mlp1", WIDTH, WIDTH)
    dense(LAYERS[game]["dense"], 2 * WIDTH, HIDDEN)
    dense(f"{LAYERS[game]['lstm']}/rnn/basic_lstm_cell", 2 * HIDDEN, 4 * HIDDEN)
    if game == FULL:
        layer_norm(f"{EMBED}/pre_sa_layer_norm", WIDTH)
        layer_norm(f"{BLOCK}/post_a_layernorm", WIDTH)
        layer_norm("layernorm11", 2 * WIDTH)
    layer_norm("layernorm15" if game == FULL else "layernorm13", HIDDEN)
    if game == FULL:
        layer_norm("layernorm13", HIDDEN)
    return {f"{net}/{name}:0": shape for name, shape in shapes.items()}


def _in_order(kinds):
    """Kinds of entities and the agent itself, in the order of their dense layers."""
    return kinds if MAIN in kinds else (*kinds, MAIN)


def _head_shapes(heads):
    shapes = {}
    for name, n in heads.items():
        shapes[f"{name}/dense/kernel:0"], shapes[f"{name}/dense/bias:0"] = (HIDDEN, n), (n,)
    return shapes


def shapes(game, kinds=KINDS):
    """Shapes of the trained variables of the policy and of the value net, two dicts."""
    heads = {f"policy_out/{name}": n for name, n in PARTS.items()}
    return (
        _net_shapes(game, NET, kinds) | _head_shapes(heads),
        _net_shapes(game, VALUE, kinds) | _head_shapes({"vpred_out0": 1}),
    )


def _trained(rng, name, shape):
    """Numbers of a size that leaves every layer's outputs about as large as its inputs."""
    if name.endswith("kernel:0"):
        return rng.normal(size=shape) * sqrt(1.5 / np.prod(shape[:-1]))
    if name.endswith("gamma:0"):
        return rng.uniform(0.5, 1.5, shape)
    return 0.3 * rng.normal(size=shape)


def _filter(rng, columns, centre=0.0, n_steady=0):
    """Averages so far, which debiasing divides; `n_steady` columns at random have a variance below 0.01."""
    debiasing = rng.uniform(0.3, 0.9, columns)
    mean, variance = rng.normal(centre, size=columns), rng.uniform(1.0, 9.0, columns)
    steady = rng.choice(columns, n_steady, replace=False)
    variance[steady] = rng.uniform(0.0, 0.009, n_steady)
    return {"mean": mean * debiasing, "sq": (mean**2 + variance) * debiasing, "debiasing_term": debiasing}


def filter_name(key, statistic):
    """The name of a normaliser's variable, without the first prefix."""
    if key == "observation_self":
        return f"normalize_self_obs/obsfilter/{statistic}:0"
    return f"normalize_{key}/obsfilter/{key}/{statistic}:0"


def draw(game, rng, prefix="policy", kinds=KINDS):
    """Draws all variables of a published file, by full name: both towers and all normalisers, as float32."""
    found = {}
    for tower in shapes(game, kinds):
        found |= {name: _trained(rng, name, shape) for name, shape in tower.items()}
    for key, columns in (COLUMNS[game] | {kind: 15 for kind in kinds if kind not in (*KINDS, MAIN)}).items():
        # Rays as they are in small rooms, so that few of them are clipped.
        statistics = _filter(rng, columns, centre=3.0) if key == "lidar" else _filter(rng, columns, n_steady=3)
        found |= {filter_name(key, statistic): x for statistic, x in statistics.items()}
    found |= {f"vpred_out0/value0filter/{statistic}:0": x for statistic, x in _filter(rng, 1).items()}
    return {f"{prefix}/{name}": np.asarray(x, np.float32) for name, x in found.items()}


class Trap:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


def traps(path):
    """What creates a file when it is unpickled: an object array, and the bytes of a pickle, as published."""
    return {"objects": np.array(Trap(path), dtype=object), "bytes": np.array(pickle.dumps(Trap(path)))}


def write(path, arrays):
    """Writes a published file; the arguments of the network in it are an object array, which is pickled."""
    buffer = io.BytesIO()
    np.savez(buffer, **{ARGUMENTS: np.array({"scope": "policy"}, dtype=object)} | arrays)
    Path(path).write_bytes(buffer.getvalue())
    return Path(path)


# Networks.


class Tower:
    """The policy of a file: `logits(published observations of one world, memory)`.

    Args:
        game: FULL or QUADRANT.
        arrays: all variables, by full name.
        prefix: what the names begin with.
        kinds: of entities, in the order of their dense layers.
    """

    def __init__(self, game, arrays, prefix="policy", kinds=KINDS):
        self.game = game
        self.kinds = _in_order(kinds)
        self.w = {name.removeprefix(f"{prefix}/"): np.float64(x) for name, x in arrays.items()}

    def memory(self, n_agents):
        """What agents remember at the beginning of an episode: c and h, (n_agents, 256) each."""
        return np.zeros((n_agents, HIDDEN)), np.zeros((n_agents, HIDDEN))

    def logits(self, obs, memory):
        """The numbers (n_agents, n) for every part of an action, and the memory after it."""
        cells, hidden = (x.copy() for x in memory)
        out = {name: [] for name in PARTS}
        for agent in range(len(cells)):
            x = self._seen_and_pooled({name: x[agent] for name, x in obs.items()})
            cells[agent], hidden[agent] = self._lstm(x, cells[agent], hidden[agent])
            last = self._layer_norm("layernorm15" if self.game == FULL else "layernorm13", hidden[agent])
            for name in PARTS:
                kernel, bias = (self.w[f"policy_out/{name}/dense/{which}:0"] for which in ("kernel", "bias"))
                out[name].append(last @ kernel + bias)
        return {name: np.stack(x) for name, x in out.items()}, (cells, hidden)

    def _seen_and_pooled(self, obs):
        """What one agent's LSTM gets."""
        obs = {name: x if name.startswith("mask") else self._normalised(name, x) for name, x in obs.items()}
        main = np.concatenate([obs["observation_self"], self._circular(obs["lidar"]).ravel()])
        rows, mask = [], []
        for i, kind in enumerate(self.kinds):
            if kind == MAIN:
                myself = _relu(self._dense(f"dense6-{i}", main))
                continue
            for row, is_seen in zip(obs[kind], obs[MASK_OF[kind]], strict=True):
                rows.append(_relu(self._dense(f"dense6-{i}", np.concatenate([main, row]))))
                mask.append(float(is_seen))
        rows, mask = np.stack([*rows, myself]), np.array([*mask, 1.0])
        rows = self._attention(rows, mask)
        pooled = np.zeros(WIDTH)
        for row, is_seen in zip(rows, mask, strict=True):
            pooled += row * is_seen
        x = np.concatenate([myself, pooled / (mask.sum() + 1e-5)])
        if self.game == FULL:
            x = self._layer_norm("layernorm11", x)
        x = _relu(self._dense(LAYERS[self.game]["dense"], x))
        return self._layer_norm("layernorm13", x) if self.game == FULL else x

    def _normalised(self, key, x):
        mean, square, debiasing = (self.w[filter_name(key, statistic)] for statistic in STATISTICS)
        mean, square = mean / debiasing, square / debiasing
        std = np.sqrt(np.maximum(square - mean**2, 0.01))
        return np.clip((np.float64(x) - mean) / std, -5.0, 5.0)

    def _circular(self, rays):
        kernel, bias = (self.w[f"{NET}/circ_conv1d0/conv1d/{which}:0"] for which in ("kernel", "bias"))
        out = np.zeros((len(rays), kernel.shape[-1]))
        for i in range(len(rays)):
            for tap in range(3):
                out[i] += rays[(i + tap - 1) % len(rays)] @ kernel[tap]
        return _relu(out + bias)

    def _attention(self, x, mask):
        y = self._layer_norm(f"{EMBED}/pre_sa_layer_norm", x) if self.game == FULL else x
        each = WIDTH // HEADS
        both = self._dense(f"{EMBED}/qk_embed", y).reshape(len(x), HEADS, each, 2)
        values = self._dense(f"{EMBED}/v_embed", y).reshape(len(x), HEADS, each)
        found = np.zeros((len(x), HEADS, each))
        for head in range(HEADS):
            for i in range(len(x)):
                logits = np.array([both[i, head, :, 0] @ both[j, head, :, 1] for j in range(len(x))]) / sqrt(each)
                logits = logits - 1e10 * (1 - mask)
                weights = np.exp(logits - logits.max()) * mask
                weights = weights / (weights.sum() + 1e-10) * mask
                for j in range(len(x)):
                    found[i, head] += weights[j] * values[j, head]
        x = x + self._dense(f"{BLOCK}/mlp1", found.reshape(len(x), WIDTH))
        return self._layer_norm(f"{BLOCK}/post_a_layernorm", x) if self.game == FULL else x

    def _lstm(self, x, cell, hidden):
        parts = self._dense(f"{LAYERS[self.game]['lstm']}/rnn/basic_lstm_cell", np.concatenate([x, hidden]))
        i, j, forget, o = np.split(parts, 4)
        cell = _sigmoid(forget + 1.0) * cell + _sigmoid(i) * np.tanh(j)
        return cell, _sigmoid(o) * np.tanh(cell)

    def _dense(self, name, x):
        return x @ self.w[f"{NET}/{name}/kernel:0"] + self.w[f"{NET}/{name}/bias:0"]

    def _layer_norm(self, name, x):
        beta, gamma = (self.w[f"{NET}/{name}/LayerNorm/{which}:0"] for which in ("beta", "gamma"))
        mean = x.mean(axis=-1, keepdims=True)
        variance = ((x - mean) ** 2).mean(axis=-1, keepdims=True)
        return gamma * (x - mean) / np.sqrt(variance + EPSILON) + beta


def _relu(x):
    return np.maximum(x, 0.0)


def _sigmoid(x):
    return 1 / (1 + np.exp(-x))


def softmax(x):
    """Probabilities along the last axis."""
    x = np.exp(x - x.max(axis=-1, keepdims=True))
    return x / x.sum(axis=-1, keepdims=True)


# Observations.


def published(game, obs, far=np.inf):
    """Published observations of one world from its split ones.

    Args:
        game: FULL or QUADRANT.
        obs: split observations by name, (n_agents, ...) each.
        far: metres that our rays read where they hit nothing; infinity where they read the same as the published ones.
    """
    obs = {name: np.asarray(x) for name, x in obs.items()}
    n_agents = len(obs["agent_qpos_qvel_self"])
    out = {"observation_self": [], **{kind: [] for kind in KINDS}, "lidar": []}
    for agent in range(n_agents):
        prep = 1 - obs["prep_remaining"][agent, 0]
        out["observation_self"].append(
            _agent(obs["agent_qpos_qvel_self"][agent], obs["agent_team_self"][agent, 0], prep)
        )
        others = zip(obs["agent_qpos_qvel"][agent], obs["agent_team"][agent, :, 0], strict=True)
        out["agent_qpos_qvel"].append([_agent(row, team, prep) for row, team in others])
        boxes = zip(obs["box_obs"][agent], obs["box_mask"][agent], strict=True)
        out["box_obs"].append([_box(game, row, is_there) for row, is_there in boxes])
        out["ramp_obs"].append([_ramp(game, row) for row in obs["ramp_obs"][agent]])
        out["lidar"].append([[NOTHING_HIT if ray >= far else ray] for ray in obs["lidar"][agent, :, 0]])
    out = {name: np.array(x, np.float64) for name, x in out.items()}
    for mask, sees in zip(MASKS, ("sees_agent", "sees_box", "sees_ramp"), strict=True):
        out[mask] = np.float64(obs[sees])
    return out


def _agent(row, team, prep):
    x, y, z, *rest = row
    return [x - AGENT_CORNER, y - AGENT_CORNER, z - AGENT_CORNER, *rest, 1 - team, prep]


def _box(game, row, is_there):
    """The lower corner, then the rest; the quadrant's are cubes, whose size nobody is told."""
    columns = COLUMNS[game]["box_obs"]
    if not is_there:
        return [0.0] * columns
    halves = row[9:12] / 2 if game == FULL else [CUBE_CORNER] * 3
    return [*(row[:3] - halves), *row[3:columns]]


def _ramp(game, row):
    corner = [*(row[:3] - RAMP_CORNER), *row[3:9]]
    return [*corner, 0.0, 0.0, 0.0, *row[9:12]] if game == FULL else corner
