"""Networks: what they may know, what they remember, and the published one's size."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.training import nets
from maax_mjx.training.actions import Head
from maax_mjx.training.config import NetConfig
from maax_mjx.training.network import Network
from maax_mjx.training.policy import check_fits
from maax_mjx.training.spec import Features, Kind, Part, Spec

T, N, A = 6, 3, 4
CHUNK = 3
ENCODERS = ("flat", "pool", "attend")
HEADS = (Head("lock", 5, 2, (5,), (("box", 3), ("ramp", 2))), Head("move", 3, 11, (3,)), Head("turn", 1, 0, (1,)))


def part(name, n, axes=1):
    return Part(name, axes, tuple(f"{name} {i}" for i in range(n)), (1.0,) * n, (False,) * n)


SPEC = Spec(
    own=(part("self", 4),),
    rays=(part("lidar", 1),),
    critic=(part("time", 2),),
    kinds=(
        Kind("other", 3, (part("others", 5),), None, None, None),
        Kind("box", 3, (part("boxes", 6),), None, None, None),
        Kind("ramp", 2, (part("ramps", 3),), None, None, None),
    ),
    n_rays=8,
)
TEAMS = (("hiders", (0, 2)), ("seekers", (1, 3)))


def network(encoder="pool", core="lstm", share="all", norm="scales"):
    net = NetConfig(encoder=encoder, core=core, share=share, norm=norm, width=16, heads=4, hidden=16)
    return Network(SPEC, HEADS, net, TEAMS)


def draw_features(seed=0):
    rng, shapes = seeds.rng(seed), SPEC.shapes(A)

    def one(x):
        shape = (T, N, *x.shape)
        return jnp.asarray(rng.random(shape) < 0.5 if x.dtype == bool else rng.normal(size=shape), x.dtype)

    features = jax.tree.map(one, shapes)
    # What is seen is there.
    return features.replace(seen={k: x & features.known[k] for k, x in features.seen.items()})


def loud(weights, seed=1):
    """Weights of some size everywhere: last layers begin near zero, where nothing could be told apart."""
    rng = seeds.rng(seed)
    return jax.tree.map(lambda x: np.asarray(x) + (rng.normal(size=x.shape) * 0.3).astype(x.dtype), weights)


def begins(*at):
    return jnp.zeros((T, N), bool).at[tuple(zip(*at, strict=True))].set(True) if at else jnp.zeros((T, N), bool)


def both(net, weights, features, memory=None, begun=None):
    memory = net.memory(N) if memory is None else memory
    begun = begins() if begun is None else begun
    return applied(net, weights, features, memory, begun)


@partial(jax.jit, static_argnums=0)
def applied(net, weights, features, memory, begun):
    out, actor = net.actor(weights, features, memory.actor, begun)
    value, critic = net.critic(weights, features, memory.critic, begun)
    return (out, value), (actor, critic)


def rounding(net, weights, features, begun=None):
    """What rounding does to every agent's outputs at every step, and to its memory: (T, N, A) and (N, A).

    Layer normalisation of numbers that hardly differ multiplies their rounding by up to a thousand.
    """
    rng = seeds.rng(7)

    def nudged(x):
        return x if x.dtype == bool else x * (1 + 1e-6 * rng.choice([-1, 1], x.shape).astype(x.dtype))

    plain, other = (both(net, weights, x, begun=begun) for x in (features, jax.tree.map(nudged, features)))
    apart = jax.tree.map(lambda x, y: np.abs(x - y), plain, other)

    def most(part, shape):
        return 1e-5 + 3 * np.max([x.reshape(*shape, -1).max(-1, initial=0) for x in jax.tree.leaves(part)], axis=0)

    return most(apart[0], (T, N, A)), most(apart[1], (N, A))


def assert_close(a, b, atol=1e-5):
    """Asserts that arrays are equal to a tolerance, a number or one for every row of the last axis."""

    def check(x, y):
        slack = np.asarray(atol)
        slack = slack.reshape(slack.shape + (1,) * (x.ndim - slack.ndim))
        np.testing.assert_array_less(np.abs(x - y), np.broadcast_to(slack, x.shape))

    jax.tree.map(check, a, b)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoder", "core", "share"),
    # Encoders see one step at a time, whatever the core: every one of both is here.
    [("flat", "none", "all"), ("pool", "gru", "all"), ("attend", "lstm", "all"), ("flat", "lstm", "team")],
)
def test_in_chunks_or_at_once_is_the_same(encoder, core, share):
    net, features, begun = network(encoder, core, share), draw_features(), begins((0, 1), (2, 0), (4, 1), (4, 2))
    weights = loud(net.draw(seeds.key(0)))
    whole, after = both(net, weights, features, begun=begun)
    memory, parts = net.memory(N), []
    for t in range(0, T, CHUNK):
        cut = jax.tree.map(lambda x, t=t: x[t : t + CHUNK], features)
        found, (actor, critic) = both(net, weights, cut, memory, begun[t : t + CHUNK])
        memory = memory.replace(actor=actor, critic=critic)
        parts.append(found)
    outputs, memories = rounding(net, weights, features, begun)
    assert_close(whole, jax.tree.map(lambda *x: jnp.concatenate(x), *parts), outputs)
    assert_close(after, (memory.actor, memory.critic), memories)


@pytest.mark.parametrize("core", ["gru", "lstm"])
def test_memory_is_zeroed_where_an_episode_begins_and_nowhere_else(core):
    net, features = network("pool", core), draw_features()
    weights = loud(net.draw(seeds.key(0)))
    fresh = jax.tree.map(lambda x: x[-CHUNK:], features)
    (begun, _), _ = both(net, weights, features, begun=begins((3, 1)))
    (plain, _), _ = both(net, weights, features)
    (alone, _), _ = both(net, weights, fresh, begun=begins()[-CHUNK:])
    for name in begun:
        # The world whose episode begins is as if nothing had been before; the others go on.
        np.testing.assert_allclose(begun[name][3:, 1], alone[name][:, 1], atol=1e-5)
        np.testing.assert_array_equal(begun[name][:, [0, 2]], plain[name][:, [0, 2]])
        np.testing.assert_array_equal(begun[name][:3], plain[name][:3])
    assert not np.allclose(begun["move"][3:, 1], plain["move"][3:, 1], atol=1e-3), "it remembers"


def unseen(features, seed=5):
    """Features whose hidden entities are others, for actors and critics."""
    other = draw_features(seed)
    entities = {k: jnp.where(features.seen[k][..., None], x, other.entities[k]) for k, x in features.entities.items()}
    absent = {k: jnp.where(features.known[k][..., None], x, other.entities[k]) for k, x in features.entities.items()}
    return features.replace(entities=entities, critic=other.critic), features.replace(entities=absent)


@pytest.mark.parametrize("encoder", ENCODERS)
def test_policies_do_not_know_what_they_do_not_see(encoder):
    net, features = network(encoder), draw_features()
    weights = loud(net.draw(seeds.key(0)))
    hidden, absent = unseen(features)
    (out, value), _ = both(net, weights, features)
    (out_hidden, value_hidden), _ = both(net, weights, hidden)
    (_, value_absent), _ = both(net, weights, absent)
    assert_close(out, out_hidden)
    assert not np.allclose(value, value_hidden, atol=1e-3), "critics see all"
    assert_close(value, value_absent)


@pytest.mark.parametrize("encoder", ["pool", "attend"])
def test_entities_of_a_kind_have_no_order(encoder):
    net, features = network(encoder), draw_features()
    weights = loud(net.draw(seeds.key(0)))
    order = np.array([2, 0, 1])

    def moved(tree, axis):
        return tree | {"box": jnp.take(tree["box"], order, axis=axis)}

    mixed = features.replace(
        entities=moved(features.entities, -2), seen=moved(features.seen, -1), known=moved(features.known, -1)
    )
    (out, value), _ = both(net, weights, features)
    (other, other_value), _ = both(net, weights, mixed)
    slack, _ = rounding(net, weights, features)
    assert_close((out["move"], value), (other["move"], other_value), slack)
    locks, other_locks = (x["lock"].reshape(T, N, A, 5, 2) for x in (out, other))
    assert_close(locks[..., np.array([*order, 3, 4]), :], other_locks, slack)
    assert not np.allclose(locks[..., :3, :], other_locks[..., :3, :], atol=1e-3), "boxes differ"


@pytest.mark.parametrize("encoder", ["pool", "attend"])
def test_another_number_of_entities_is_read_by_the_same_parameters(encoder):
    """With two boxes and an agent more, which nobody sees: all decides as without; a seen one changes it."""
    net, features = network(encoder), draw_features()
    weights = loud(net.draw(seeds.key(0)))
    kinds = tuple(replace(kind, n=kind.n + (2 if kind.name == "box" else 1)) for kind in SPEC.kinds)
    heads = (replace(HEADS[0], n=8, shape=(8,), kinds=(("box", 5), ("ramp", 3))), *HEADS[1:])
    wider = Network(replace(SPEC, kinds=kinds), heads, net.net, net.teams)
    check_fits(net, wider)

    def more(tree, fill):
        added = {"other": 1, "box": 2, "ramp": 1}
        pads = {k: [(0, 0)] * 3 + [(0, n)] + [(0, 0)] * (tree[k].ndim - 4) for k, n in added.items()}
        return {k: jnp.pad(x, pads[k], constant_values=fill) for k, x in tree.items()}

    others = features.replace(
        entities=more(features.entities, 0.7), seen=more(features.seen, False), known=more(features.known, False)
    )
    (out, value), _ = both(net, weights, features)
    (same, same_value), _ = both(wider, weights, others)
    slack, _ = rounding(net, weights, features)
    assert_close((out["move"], value), (same["move"], same_value), slack)
    locks, same_locks = out["lock"].reshape(T, N, A, 5, 2), same["lock"].reshape(T, N, A, 8, 2)
    assert_close(locks, same_locks[..., np.array([0, 1, 2, 5, 6]), :], slack)
    seen = others.replace(seen=more(features.seen, True), known=more(features.known, True))
    (changed, _), _ = both(wider, weights, seen)
    assert not np.allclose(out["move"], changed["move"], atol=1e-3)


def test_a_flat_encoder_takes_as_many_entities_as_it_learnt_with():
    net = network("flat")
    kinds = tuple(replace(kind, n=kind.n + 1) for kind in SPEC.kinds)
    wider = Network(replace(SPEC, kinds=kinds), HEADS, net.net, net.teams)
    with pytest.raises(ValueError, match="its encoder is 'flat' and reads 3 entities of 'other', and env has 4"):
        check_fits(net, wider)


def test_teams_may_have_parameters_of_their_own():
    net, features = network("flat", share="team"), draw_features()
    weights = loud(net.draw(seeds.key(0)))
    assert set(weights.actor) == set(weights.critic) == {"hiders", "seekers"}
    (out, _), _ = both(net, weights, features)
    changed = weights.replace(actor=weights.actor | {"seekers": loud(weights.actor["seekers"], seed=2)})
    (other, _), _ = both(net, changed, features)
    np.testing.assert_array_equal(out["move"][:, :, [0, 2]], other["move"][:, :, [0, 2]])
    assert not np.allclose(out["move"][:, :, [1, 3]], other["move"][:, :, [1, 3]], atol=1e-3)


def test_the_published_network_has_as_many_parameters():
    """Baker et al.'s 1.6 million, counted from the published shapes of the full game's observations and actions."""
    kinds = (("other", 3, 10), ("box", 9, 15), ("ramp", 2, 15))
    spec = Spec(
        own=(part("self", 10),),
        rays=(part("lidar", 1),),
        critic=(),
        kinds=tuple(Kind(name, n, (part(name, columns),), None, None, None) for name, n, columns in kinds),
        n_rays=30,
    )
    heads = (Head("grab", 1, 2, ()), Head("lock", 1, 2, ()), Head("move", 3, 11, (3,)))
    net = Network(spec, heads, NetConfig(encoder="attend", core="lstm"), TEAMS)
    weights = jax.eval_shape(net.draw, jax.random.key(0))
    sizes = [sum(x.size for x in jax.tree.leaves(tree)) for tree in (weights.actor, weights.critic)]
    assert sizes == [817_737, 808_485]
    assert sum(sizes) == 1_626_222


def test_features_are_what_the_spec_says():
    assert isinstance(SPEC.shapes(A), Features)
    obs = {
        "self": np.arange(16.0).reshape(A, 4), "lidar": np.ones((A, 8, 1)), "time": np.zeros((A, 2)),
        "others": np.ones((A, 3, 5)), "boxes": np.ones((A, 3, 6)), "ramps": np.ones((A, 2, 3)),
    }  # fmt: skip
    features = SPEC.features({name: jnp.asarray(x) for name, x in obs.items()})
    wanted = SPEC.shapes(A)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), features) == jax.tree.map(lambda x: (x.shape, x.dtype), wanted)


def test_the_greatest_is_of_those_that_are_there_and_passes_its_gradient_to_it():
    x = jax.random.normal(seeds.key(7), (50, 6, 8))
    there = jax.random.bernoulli(seeds.key(8), 0.5, (50, 6)).at[:, 0].set(True)
    weigh = jax.random.normal(seeds.key(9), (50, 8))
    shown = np.where(there[..., None], x, -np.inf)
    expected = np.where(np.arange(6)[:, None] == shown.argmax(1)[:, None], weigh[:, None], 0)
    np.testing.assert_array_equal(nets._greatest(x, there), shown.max(1))
    np.testing.assert_array_equal(jax.grad(lambda x: (nets._greatest(x, there) * weigh).sum())(x), expected)
