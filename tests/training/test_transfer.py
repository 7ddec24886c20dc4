"""Weights of one game for another: by name, column by column, so that what both have means the same."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds, toys

from maax_mjx import training
from maax_mjx.training.actions import Head
from maax_mjx.training.begin import critic_left, taken_over
from maax_mjx.training.config import NetConfig
from maax_mjx.training.network import Moments, Network
from maax_mjx.training.spec import Kind, Part, Spec
from maax_mjx.training.transfer import _rows, transferred

T, N = 4, 3
GROUP = "agents"


def part(name, *columns):
    return Part(name, 1, columns, (1.0,) * len(columns), (False,) * len(columns))


def kind(name, n, *columns):
    return Kind(name, n, (part(f"{name}s", *columns),), None, None, None)


LIDAR = part("lidar", "distance")
OLD = Spec(
    own=(part("me", "x", "y"), part("preparation", "left")),
    rays=(LIDAR,),
    critic=(part("time", "left"),),
    kinds=(kind("box", 3, "x", "y", "size"), kind("other", 2, "x", "y")),
    n_rays=5,
)
# Without others and preparation; with a mark, the columns of boxes in another order, and one of them new.
NEW = Spec(
    own=(part("me", "y", "x"), part("score", "mine")),
    rays=(LIDAR,),
    critic=(part("time", "left"),),
    kinds=(kind("box", 2, "size", "weight", "x", "y"), kind("mark", 2, "x", "y")),
    n_rays=5,
)
HEADS = (Head("move", 3, 5, (3,)), Head("turn", 1, 0, (1,)))
TEAMS = ((GROUP, (0, 1)),)


def networks(encoder="pool", core="lstm", norm="scales", heads=HEADS):
    net = NetConfig(encoder=encoder, core=core, norm=norm, width=8, heads=2, hidden=8)
    return Network(OLD, HEADS, net, TEAMS), Network(NEW, heads, net, TEAMS)


def drawn(network, seed):
    """Weights, with biases and scales that are not those of the beginning."""
    rng = seeds.rng(seed)
    shapes = jax.eval_shape(network.draw, seeds.key(seed))
    return jax.tree.map(lambda x: (0.3 * rng.normal(size=x.shape)).astype(x.dtype), shapes)


def alike():
    """Features of the new game in which nothing is only of that game, and the same in the old one's columns."""
    rng = seeds.rng(5)

    def random(x):
        return jnp.asarray(rng.random((T, N, *x.shape)) < 0.6 if x.dtype == bool else rng.normal(size=(T, N, *x.shape)))

    new = jax.tree.map(random, NEW.shapes(2))
    none = {"mark": jnp.zeros((T, N, 2, 2), bool)}
    new = new.replace(own=new.own.at[..., 2].set(0.0), seen=new.seen | none, known=new.known | none)
    box = new.entities["box"].at[..., 1].set(0.0)
    new = new.replace(entities=new.entities | {"box": box})
    # The old game has a third box, which is not there, and others, who are not seen.
    padded = jnp.pad(box[..., jnp.array([2, 3, 0])], [(0, 0)] * 3 + [(0, 1), (0, 0)])
    others = jnp.ones((T, N, 2, 2, 2))

    def masks(x):
        return {"box": jnp.pad(x["box"], [(0, 0)] * 3 + [(0, 1)]), "other": jnp.zeros((T, N, 2, 2), bool)}

    own = jnp.concatenate([new.own[..., 1::-1], jnp.zeros((T, N, 2, 1))], axis=-1)
    entities = {"box": padded, "other": others}
    return new.replace(own=own, entities=entities, seen=masks(new.seen), known=masks(new.known)), new


@pytest.mark.slow
@pytest.mark.parametrize(("encoder", "core"), [("pool", "lstm"), ("pool", "none"), ("attend", "gru")])
def test_what_both_games_have_means_the_same(encoder, core):
    """With the old last layers put back, both networks say the same of the same things."""
    old, new = networks(encoder, core)
    was, fresh = drawn(old, 1), drawn(new, 2)
    now = transferred(was, old, new, fresh)
    before, after = alike()
    begins = jnp.zeros((T, N), bool).at[2, 1].set(True)
    last = ("norm hidden" if core == "none" else "norm out", "move", "turn", "turn log std", "value")

    def restored(known, tower):
        return {GROUP: tower[GROUP] | {name: known[GROUP][name] for name in last if name in known[GROUP]}}

    back = now.replace(actor=restored(was.actor, now.actor), critic=restored(was.critic, now.critic))
    memory = old.memory(N)
    for play in ("actor", "critic"):
        given = getattr(memory, play)
        one, _ = jax.jit(getattr(old, play))(was, before, given, begins)
        other, _ = jax.jit(getattr(new, play))(back, after, given, begins)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-5), one, other)


def test_last_layers_and_what_is_new_are_as_drawn():
    old, new = networks(heads=(*HEADS, Head("lock", 1, 2, ())))
    was, fresh = drawn(old, 1), drawn(new, 2)
    now = transferred(was, old, new, fresh)
    for tower, names in ((("actor"), ("move", "turn", "lock")), (("critic"), ("value",))):
        mine, drew = getattr(now, tower)[GROUP], getattr(fresh, tower)[GROUP]
        for name in (*names, "norm out", "embed mark", "embed own for mark"):
            jax.tree.map(np.testing.assert_array_equal, mine[name], drew[name])
        kernel = mine["embed box"]["kernel"]
        assert (kernel[1] == 0).all(), "a new column counts for nothing"
        np.testing.assert_array_equal(kernel[0], getattr(was, tower)[GROUP]["embed box"]["kernel"][2])
        assert "embed other" not in mine
    assert jax.tree.map(jnp.shape, now) == jax.tree.map(jnp.shape, fresh)


def test_moments_go_with_their_columns():
    old, new = networks(norm="running")
    was, fresh = drawn(old, 1), drawn(new, 2)
    was = was.replace(norm=was.norm.replace(weight=jnp.asarray(0.5)))
    now = transferred(was, old, new, fresh).norm
    assert isinstance(now, Moments)
    for mean, other in ((now.mean, was.norm.mean), (now.square, was.norm.square)):
        np.testing.assert_array_equal(mean["own"][:2], other["own"][jnp.array([1, 0])])
        np.testing.assert_array_equal(
            mean["entities box"][jnp.array([0, 2, 3])], other["entities box"][jnp.array([2, 0, 1])]
        )
        np.testing.assert_array_equal(mean["rays"], other["rays"])
    # What is new has a mean of 0 and a variance of 1.
    np.testing.assert_array_equal(now.mean["entities mark"], 0)
    np.testing.assert_array_equal(now.square["entities mark"] / now.weight, 1)


def counted(name, n):
    """A plain array of n by n numbers."""
    return Part(name, 2, tuple(f"{name} {i}" for i in range(n * n)), (1.0,) * n * n, (False,) * n * n)


@pytest.mark.parametrize("same", [True, False])
def test_numbers_that_are_counted_through_are_taken_over_in_arrays_of_the_same_size(same):
    """The fourth of two by two numbers is in another row and column than the fourth of three by three."""
    old, new = networks()
    old = replace(old, spec=replace(OLD, critic=(counted("who", 2),)))
    new = replace(new, spec=replace(NEW, critic=(counted("who", 2 if same else 3),)))
    was, fresh = drawn(old, 1), drawn(new, 2)
    kernel = transferred(was, old, new, fresh).critic[GROUP]["embed own"]["kernel"]
    rows = [i for i, (name, _) in enumerate(_rows(new, critic=True)["embed own"]) if name == "who"]
    known = [i for i, (name, _) in enumerate(_rows(old, critic=True)["embed own"]) if name == "who"]
    expected = was.critic[GROUP]["embed own"]["kernel"][np.array(known)] if same else 0.0
    np.testing.assert_array_equal(np.broadcast_to(expected, (len(rows), 8)), kernel[np.array(rows)])


def test_a_critic_that_does_not_fit_is_told():
    """Without `transfer` a new one is drawn, where only critics read other columns."""
    old, _ = networks()
    wider = replace(old, spec=replace(OLD, critic=(*OLD.critic, counted("who", 2))))
    policy = training.Policy(old, drawn(old, 1))
    assert critic_left(policy, old) == ""
    assert critic_left(policy, wider) == (
        "the policy's critic reads other columns of who: the run begins with a new one"
    )
    weights = taken_over(policy, wider, seeds.key(3))
    jax.tree.map(np.testing.assert_array_equal, weights.actor, policy.params.actor)
    jax.tree.map(np.testing.assert_array_equal, weights.critic, wider.draw(seeds.key(3)).critic)
    # As many columns, of something else.
    other = replace(old, spec=replace(OLD, critic=(part("clock", "left"),)))
    assert critic_left(policy, other).startswith("the policy's critic reads other columns of time, clock: ")
    fresh = taken_over(policy, other, seeds.key(3)).critic
    jax.tree.map(np.testing.assert_array_equal, fresh, other.draw(seeds.key(3)).critic)
    without = training.Policy(old, policy.params.replace(critic={}))
    assert critic_left(without, wider) == ""


def test_other_teams_are_refused():
    old, new = networks()
    per_team = replace(new, net=replace(new.net, share="team"), teams=(("cats", (0,)), ("mice", (1,))))
    with pytest.raises(ValueError, match=r"parameters for \['agents'\], and the run has \['cats', 'mice'\]; takes"):
        transferred(drawn(old, 1), old, per_team, drawn(per_team, 2))


@pytest.mark.slow
@pytest.mark.usefixtures("made_once")
def test_a_run_begins_with_a_policy_of_another_game(tmp_path):
    """Which is refused without being asked for."""
    small = {"net.encoder": "pool", "net.hidden": 16, "net.width": 16, "net.share": "all", "ppo.minibatches": 1}
    tiny = {"impl": "c", "scenario": "empty", "n_boxes": 1, "horizon": 20}

    echo = toys.echo()

    def untrained(**changed):
        network = Network.of(echo, training.preset("laptop", small | changed).net)
        return training.Policy(network, network.draw(seeds.key(0)))

    def trainer(folder, given, **changed):
        asked = {"begin_from": given, "env": tiny, "transfer": True} | small | changed
        return training.Trainer("lock_and_return", tmp_path / folder, "laptop", 4, **asked)

    given = untrained()
    with pytest.raises(ValueError, match=r"with the same columns, or transfer=True \(--transfer\)"):
        trainer("a", given, transfer=False)
    run = trainer("b", given)
    was, now = given.params.actor[GROUP]["hidden"], run.learner.weights.actor[GROUP]["hidden"]
    jax.tree.map(np.testing.assert_array_equal, was, now)
    assert run.folder.about()["begun_from"]["transfer"] is True
    with pytest.raises(ValueError, match="transfer: got True without begin_from"):
        trainer("c", None)
    given.save(tmp_path / "given")
    again = trainer("e", str(tmp_path / "given"))
    jax.tree.map(np.testing.assert_array_equal, was, again.learner.weights.actor[GROUP]["hidden"])
    with pytest.raises(ValueError, match=r"^begin_from: got 'quadrant/fort', which is not there \(did you mean"):
        trainer("f", "quadrant/fort")
    with pytest.raises(ValueError, match=r"transfer: got True with net\.encoder=flat"):
        trainer("d", untrained(**{"net.encoder": "flat"}), **{"net.encoder": "flat"})
