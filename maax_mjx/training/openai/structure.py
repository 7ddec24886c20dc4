"""Which network the variables of a published file belong to, by their names and shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from maax_mjx.training.openai.network import ACTIONS, KINDS, NET, OpenAINetwork

LAYER = re.compile(r"(circ_conv1d|dense|self-attention|layernorm|lstm)(\d+)(?:-(\d+))?$")
CHAINS = {("layernorm", "dense", "layernorm", "lstm", "layernorm"): True, ("dense", "lstm", "layernorm"): False}
"""Kinds of the layers after the attention in the full game's and the quadrant's network, and whether the attention has
layer norms there."""

Arrays = Mapping[str, np.ndarray]
Shapes = dict[str, tuple[int, ...]]


def network_of(weights: Arrays) -> OpenAINetwork:
    """Returns the network that variables of these names and shapes belong to.

    Raises:
        ValueError: the network of another task, or variables that are missing or do not fit.
    """
    try:
        network = _network_of(weights)
        expected = _expected(network, weights)
    except (IndexError, KeyError, TypeError, ZeroDivisionError) as error:
        raise _unknown(f"variables that are missing or do not fit ({error})") from None
    for name in sorted(expected.keys() | {name for name in weights if name.startswith(f"{NET}/")}):
        got = weights[name].shape if name in weights else "nothing"
        if got != expected.get(name):
            raise _unknown(f"{got} as {name!r}, where {expected.get(name, 'nothing')} fits")
    return network


def _network_of(weights: Arrays) -> OpenAINetwork:
    layers: dict[str, list[tuple[int, str]]] = {}
    for name in {key.split("/")[1] for key in weights if key.startswith(f"{NET}/")}:
        if (found := LAYER.match(name)) is None:
            raise _unknown(f"a layer {name!r}")
        layers.setdefault(found[1], []).append((int(found[2]), name))
    (conv,), (attention,), (lstm,) = (_only(layers, kind) for kind in ("circ_conv1d", "self-attention", "lstm"))
    dense = sorted(layers.get("dense", []))
    embedding = sorted(name for number, name in dense if number < attention[0])
    if len(embedding) not in (len(KINDS), len(KINDS) + 1):
        raise _unknown(
            f"{len(embedding)} embeddings, where agents, boxes, ramps and oneself make {len(KINDS)}, with construction "
            f"sites {len(KINDS) + 1}"
        )
    after = sorted([*layers.get("layernorm", []), *[one for one in dense if one[0] > attention[0]], lstm])
    blocks = {key.split("/")[2] for key in weights if key.startswith(f"{NET}/{attention[1]}/")}
    own = weights["normalize_self_obs/obsfilter/mean"].shape[0]
    filters = weights[f"{NET}/{conv[1]}/conv1d/kernel"].shape[-1]
    rows = {layer: weights[f"{NET}/{layer}/kernel"].shape[0] for layer in embedding}
    # What an agent knows of itself is also before every entity's own numbers, so that its own layer has the fewest
    # rows. It comes before or after that of the construction sites.
    oneself = min(embedding, key=lambda layer: rows[layer])
    around = rows.pop(oneself)
    widths = [n - around for n in rows.values()]
    return OpenAINetwork(
        convolution=conv[1],
        embeddings=tuple(rows),
        own_embedding=oneself,
        attention=f"{attention[1]}/{min(blocks)}",
        chain=tuple(name for _, name in after),
        memory_size=weights[f"{NET}/{lstm[1]}/rnn/basic_lstm_cell/kernel"].shape[1] // 2,
        n_bins=weights[f"policy_out/{ACTIONS[0]}/dense/kernel"].shape[1] // 3,
        widths=(own, *widths),
        n_rays=(around - own) // filters,
    )


def _expected(network: OpenAINetwork, weights: Arrays) -> Shapes:
    """The shapes of all variables that such a network has."""
    kinds = tuple(str(LAYER.match(name)[1]) for name in network.chain)  # type: ignore[index]
    if kinds not in CHAINS:
        raise _unknown(f"the layers {list(network.chain)} after the attention")
    kernel = weights[f"{NET}/{network.convolution}/conv1d/kernel"].shape
    taps, filters = kernel[0], kernel[-1]
    if taps % 2 == 0:
        raise _unknown(f"a convolution of {taps} rays, which has no middle")
    own, *each = network.widths
    around = own + network.n_rays * filters
    size = weights[f"{NET}/{network.own_embedding}/kernel"].shape[1]
    shapes = _normaliser("self_obs", "obsfilter", own) | _normaliser("lidar", "obsfilter/lidar", 1)
    shapes |= {f"{NET}/{network.convolution}/conv1d/kernel": (taps, 1, filters)}
    shapes |= {f"{NET}/{network.convolution}/conv1d/bias": (filters,)}
    for layer, kind, width in zip(network.embeddings, network.masks, each, strict=True):
        shapes |= _normaliser(kind, f"obsfilter/{kind}", width)
        shapes |= _dense(f"{NET}/{layer}", around + width, size)
    shapes |= _dense(f"{NET}/{network.own_embedding}", around, size)
    scope = f"{NET}/{network.attention}"
    qkv = f"{scope}/self_attention/qkv_embed"
    shapes |= _dense(f"{qkv}/qk_embed", size, 2 * size) | _dense(f"{qkv}/v_embed", size, size)
    shapes |= _dense(f"{scope}/mlp1", size, size)
    if CHAINS[kinds]:
        shapes |= _norm(f"{qkv}/pre_sa_layer_norm", size) | _norm(f"{scope}/post_a_layernorm", size)
    width = 2 * size
    for kind, layer in zip(kinds, network.chain, strict=True):
        if kind == "layernorm":
            shapes |= _norm(f"{NET}/{layer}", width)
        elif kind == "dense":
            before, width = width, weights[f"{NET}/{layer}/kernel"].shape[1]
            shapes |= _dense(f"{NET}/{layer}", before, width)
        else:
            before, width = width, network.memory_size // 2
            shapes |= _dense(f"{NET}/{layer}/rnn/basic_lstm_cell", before + width, 4 * width)
    for action, n in zip(ACTIONS, (3 * network.n_bins, 2, 2), strict=True):
        shapes |= _dense(f"policy_out/{action}/dense", width, n)
    return shapes


def _normaliser(name: str, scope: str, width: int) -> Shapes:
    return {f"normalize_{name}/{scope}/{part}": (width,) for part in ("mean", "sq", "debiasing_term")}


def _dense(scope: str, before: int, after: int) -> Shapes:
    return {f"{scope}/kernel": (before, after), f"{scope}/bias": (after,)}


def _norm(scope: str, width: int) -> Shapes:
    return {f"{scope}/LayerNorm/{part}": (width,) for part in ("gamma", "beta")}


def _only(layers: Mapping[str, list[tuple[int, str]]], kind: str) -> list[tuple[int, str]]:
    found = layers.get(kind, [])
    if len(found) != 1:
        raise _unknown(f"{len(found)} layers {kind!r}")
    return found


def _unknown(got: str) -> ValueError:
    return ValueError(
        f"got one with {got}; takes the published policies: those of hide_and_seek_full and hide_and_seek_quadrant, "
        "hide_and_seek_quadrant_physics_exploits, the five of hide_and_seek_policy_phases, lock_and_return, "
        "sequential_lock, blueprint and shelter"
    )
