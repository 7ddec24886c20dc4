"""Wrappers against plain NumPy written from the rules: teams, contact, preparation, rewards, splits; their order."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

HORIZON, PREP = 10, 4
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


@pytest.fixture(scope="module")
def base():
    """Up to 3 hiders and 2 seekers, a box and a ramp on an open floor."""
    return maax.make(
        "standard", scenario="empty", outer="none", impl="c", n_hiders=(0, 3), n_seekers=(0, 2), horizon=HORIZON
    )


@pytest.fixture(scope="module")
def touching(base):
    return maax.AgentAgentContactMask2D(maax.TeamMembership(base))


@pytest.fixture(scope="module")
def state(touching):
    return jax.jit(touching.reset)(seeds.key(0))


def place(env, state, xy, active, mask=None):
    """The state with agents at `xy` (5, 2), of whom some are in play, and a contact mask if given."""
    ids = env.base.agents.qpos_ids[:, :2]
    qpos = np.array(state.data.qpos)
    qpos[ids] = xy
    world = state.world.replace(active=state.world.active | {"agent": np.asarray(active)})
    mechanics = state.mechanics if mask is None else state.mechanics | {"contact": np.asarray(mask)}
    return state.replace(data=state.data.replace(qpos=qpos), world=world, mechanics=mechanics)


def reward_oracle(mask, team, active, rew_type):
    reward = np.zeros(5)
    hiders = [i for i in range(5) if team[i] == 0 and active[i]]
    seekers = [i for i in range(5) if team[i] == 1 and active[i]]
    for i in hiders:
        reward[i] = -1 if any(mask[j][i] for j in seekers) else 1
    for j in seekers:
        reward[j] = 1 if any(mask[j][i] for i in hiders) else -1
    for members, worst in ((hiders, min), (seekers, max)):
        values = [reward[i] for i in members]
        for i in members:
            if rew_type == "team_mean":
                reward[i] = sum(values) / len(values)
            elif rew_type == "team_zero_sum":
                reward[i] = worst(values)
    return reward


@pytest.mark.parametrize("rew_type", ["selfish", "team_mean", "team_zero_sum"])
def test_rewards(rew_type, touching, state):
    """Every contact between every pair of teams that can be in play, unequal ones and empty ones too."""
    env = maax.HideAndSeekReward(touching, rew_type, scale=2.0)
    reward = jax.jit(lambda s: env.reward(s))
    rng = seeds.rng(0)
    for active in itertools.product([False, True], repeat=5):
        for _ in range(20):
            mask = rng.random((5, 5)) < 0.3
            mask = (mask | mask.T) & ~np.eye(5, dtype=bool)
            here = place(env, state, np.zeros((5, 2)), np.array(active), mask).replace(
                reward=np.full(5, 0.5, np.float32)
            )
            close(reward(here) - 0.5, 2 * reward_oracle(mask, [0, 0, 0, 1, 1], active, rew_type), atol=1e-6)


@pytest.mark.parametrize("rew_type", ["selfish", "team_mean", "team_zero_sum"])
@pytest.mark.parametrize("team", [(0, 0, 0, 1, 1), (1, 0, 1, 1, 0), (0, 0, 0, 0, 1)])
def test_rewards_by_vision(team, rew_type, base, state):
    """Who sees whom is one-sided: a hider in hiding may see its seeker. All see themselves, and some their own team."""
    env = maax.HideAndSeekReward(maax.LineOfSight(maax.TeamMembership(base, team)), rew_type, by="vision", scale=2.0)
    rng = seeds.rng(0)
    active = np.array(list(itertools.product([False, True], repeat=5))).repeat(20, axis=0)
    sees = (rng.random((len(active), 5, 5)) < 0.3) | np.eye(5, dtype=bool)

    @jax.jit
    @jax.vmap
    def reward(sees, active):
        world = state.world.replace(active=state.world.active | {"agent": active})
        mechanics = state.mechanics | {"line_of_sight": {"sees_agent": sees}}
        return env.reward(state.replace(world=world, mechanics=mechanics, reward=jnp.full(5, 0.5)))

    got, want = (
        np.asarray(reward(sees, active)) - 0.5,
        [2 * reward_oracle(one, team, who, rew_type) for one, who in zip(sees, active, strict=True)],
    )
    close(got, want, atol=1e-6)


def test_contact_and_team_sizes(touching, state):
    look = jax.jit(lambda s: touching.observe(s).obs["contact_mask"])
    sizes = jax.jit(lambda s: touching.env.observation(s)["team_size"])
    far = maax.AgentAgentContactMask2D(touching.env, distance=1.0)
    look_far = jax.jit(lambda s: far.observe(s).obs["contact_mask"])
    rng = seeds.rng(1)
    for _ in range(100):
        xy, active = rng.uniform(0, 0.9, (5, 2)), rng.random(5) < 0.7
        here = place(touching, state, xy, active)
        gap = np.linalg.norm(xy[:, None] - xy, axis=-1)
        both = active & active[:, None] & ~np.eye(5, dtype=bool)
        equal(look(here), (gap <= 0.301) & both)
        equal(look_far(here), (gap <= 1.0) & both)
        members = np.array([active[:3].sum()] * 3 + [active[3:].sum()] * 2)
        equal(sizes(here)[:, 0], np.where(active, members, 0))


def test_touching_agents_are_in_contact(touching):
    """Agents driven into each other touch, and keep the mask on while they push."""
    env = maax.Base(2, impl="c")
    env.add_module(maax.Agents({"hiders": 1, "seekers": 1}))
    env = maax.AgentAgentContactMask2D(maax.TeamMembership(env))
    state, step = jax.jit(env.reset)(seeds.key(0)), jax.jit(env.step)
    xy = jnp.array([[2.0, 3.0], [4.0, 3.0]])
    state = state.replace(data=state.data.replace(qpos=state.data.qpos.at[env.base.agents.qpos_ids[:, :2]].set(xy)))
    seen = []
    for _ in range(240):
        state = step(state, {"move": jnp.array([[0.3, 0, 0], [-0.3, 0, 0]])})
        seen.append(bool(state.obs["contact_mask"][0, 1]))
    assert not seen[10]
    assert all(seen[-20:])


def test_preparation(touching):
    env = maax.PreparationPhase(maax.HideAndSeekReward(touching), PREP / HORIZON)
    assert env.n_steps == PREP
    params = env.default_params.replace(n_hiders=2, n_seekers=1)
    state, step = jax.jit(env.reset)(seeds.key(3), params), jax.jit(env.step)
    agents = env.base.agents
    active = np.asarray(state.world.active["agent"])
    equal(active, [True, True, False, True, False])
    for t in range(HORIZON):
        close(state.obs["prep_remaining"], max(1 - t / PREP, 0), atol=1e-6)
        before = np.asarray(state.data.qpos)[agents.qpos_ids]
        state = step(state, {"move": jnp.ones((5, 3))})
        moved = np.abs(np.asarray(state.data.qpos)[agents.qpos_ids] - before)[:, [0, 1, 3]].max(axis=1)
        preparing = t < PREP
        assert (moved[:3][active[:3]] > 1e-4).all()
        assert (moved[3:][active[3:]] < 1e-6).all() == preparing
        assert not np.asarray(state.reward)[~active].any()
        assert (np.asarray(state.reward)[active] == 0).all() == preparing
    assert state.truncated


def test_a_phase_that_fills_the_episode_and_one_that_is_none(touching):
    assert maax.PreparationPhase(touching, 1).n_steps == HORIZON
    none = maax.PreparationPhase(touching, 0)
    assert not none.reset(seeds.key(0)).obs["prep_remaining"].any()


def test_rectangle(touching, state):
    env = maax.RestrictAgentsRect(touching, (1, 1, 5, 4), penalty=10, penalize_objects_out=True)
    box, ramp = (env.base.modules[name].qpos_ids[0, :2] for name in ("box", "ramp"))
    reward, rng = jax.jit(lambda s: env.reward(s)), seeds.rng(2)
    outs = []
    for _ in range(100):
        xy, active = rng.uniform(0, 6, (5, 2)), rng.random(5) < 0.7
        objects = rng.uniform([0.5, 0.5], [5.5, 4.5], (2, 2))
        here = place(env, state, xy, active).replace(reward=np.arange(5, dtype=np.float32))
        here.data.qpos[box], here.data.qpos[ramp] = objects

        def outside(p):
            return (p[:, 0] < 1) | (p[:, 0] > 5) | (p[:, 1] < 1) | (p[:, 1] > 4)

        all_out = outside(objects).any()
        outs.append(all_out)
        equal(reward(here), np.where(active & (outside(xy) | all_out), -10, np.arange(5)))
    assert 0.2 < np.mean(outs) < 0.8


def test_discrete_actions(touching):
    env = maax.DiscretizeActions(touching, 11)
    assert env.action_space["move"].nvec.tolist() == [[11, 11, 11]] * 5
    bins = np.array([[0, 5, 10], [1, 2, 3], [4, 6, 7], [8, 9, 5], [-3, 12, 5]])
    forces = np.clip(bins, 0, 10) * 0.2 - 1
    close(jax.jit(lambda bins: env.action(None, {"move": bins})["move"])(bins), forces, atol=1e-6)
    for wrong, message in (
        (bins, "'move' holds -3 to 12; takes whole numbers from 0 to 10"),
        (np.zeros((5, 3), np.float32), "'move' holds float32; takes whole numbers, the bins from 0 on"),
        (np.zeros((5, 2), int), r"'move' has shape \(5, 2\); takes \(5, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(env.state_shape, {"move": wrong})
    sample = jax.jit(env.sample_action)(seeds.key(0))["move"]
    assert env.action_space.contains({"move": np.asarray(sample)})
    assert sample.dtype == jnp.int32
    state = jax.jit(env.step)(env.reset(seeds.key(0)), {"move": sample})
    assert jnp.isfinite(state.data.qpos).all()


def test_an_action_that_lacks_a_part_is_refused(touching):
    class Renamed(maax.ActionWrapper):
        def action(self, state, action):
            return {"moves": action["move"]}

    env = Renamed(touching)
    with pytest.raises(ValueError, match=r"Renamed returned an action without 'move', which it got; takes .*'move'"):
        env.step(env.state_shape, jax.jit(env.sample_action)(seeds.key(0)))


def test_split_spoof_join_flatten(touching):
    """Every array of the split observations, against the circulant order written out."""
    split = maax.SplitObservations(touching)
    spoofed = maax.SpoofEntities(split, 3, ["box_obs"], ["box_mask"])
    joined = maax.ConcatenateObservations(spoofed, {"me": ["agent_qpos_qvel_self", "agent_team_self", "team_size"]})
    chosen = maax.SelectObservations(joined, ["me", "box_obs"])
    flat = maax.FlattenObservations(chosen)

    @jax.jit
    def views(key):
        """The state of the game, and what each layer around it makes of it."""
        states = [touching.reset(key, touching.default_params.replace(n_hiders=2, n_seekers=1))]
        for layer in (split, spoofed, joined, chosen, flat):
            states.append(layer.observe(states[-1]))
        return [state.obs for state in states]

    raw, obs, padded, together, _, last = jax.device_get(views(seeds.key(5)))
    own = ["agent_qpos_qvel", "agent_team", "agent_mask"]
    for i in range(5):
        others = [(i - 1 - j) % 5 for j in range(4)]
        for key in own:
            equal(obs[f"{key}_self"][i], raw[key][i])
            equal(obs[key][i], [raw[key][j] for j in others])
        equal(obs["contact_mask"][i], [raw["contact_mask"][i, j] for j in others])
        equal(obs["team_size"][i], raw["team_size"][i])
        for key in ("box_obs", "box_mask", "ramp_obs", "ramp_mask"):
            equal(obs[key][i], raw[key])
    assert not {"agent_pos", "agent_angle"} & set(obs)
    equal(padded["box_obs"][:, :1], obs["box_obs"])
    assert padded["box_obs"].shape == (5, 3, 9)
    assert not padded["box_obs"][:, 1:].any()
    equal(padded["box_mask_spoof"], [[True, False, False]] * 5)
    equal(together["me"][:, 8:9], obs["agent_team_self"])
    vector = last["obs"]
    want = np.concatenate([np.asarray(padded["box_obs"]).reshape(5, -1), obs["agent_qpos_qvel_self"]], axis=1)
    playing = np.asarray(last["obs_mask"]).any(axis=1)
    assert playing.sum() == 3
    equal(vector[:, : want.shape[1]], np.where(playing[:, None], want, 0))
    assert flat.observation_space["obs"].shape == vector.shape == (5, 27 + 10)


def test_observations_are_of_the_state_after_the_step(touching):
    """MAax built them from the state before, and so froze them."""
    env = maax.FlattenObservations(maax.SplitObservations(touching))
    params = env.default_params.replace(n_hiders=2, n_seekers=1)
    state, step = jax.jit(env.reset)(seeds.key(3), params), jax.jit(env.step)
    columns = []
    for _ in range(3):
        state = step(state, {"move": jnp.ones((5, 3))})
        columns.append(np.asarray(state.obs["obs"]))
        position = np.asarray(state.data.qpos)[env.base.agents.qpos_ids[:, :3]]
        active = np.asarray(state.world.active["agent"])
        assert any((columns[-1][active] == x).any() for x in position[active, 0])
    assert (columns[0] != columns[1]).any()


def test_a_full_stack_is_an_environment(touching):
    env = maax.PreparationPhase(maax.HideAndSeekReward(touching, "team_zero_sum"), 0.2)
    env = maax.FlattenObservations(maax.SplitObservations(maax.DiscretizeActions(env)))
    worlds = maax.Worlds(env, 8)
    states = worlds.reset(seeds.key(0))
    for t in range(HORIZON):
        states = worlds.step(states, worlds.sample_action(seeds.key(t)))
    assert states.truncated.all()
    active = np.asarray(states.episode_length) == HORIZON
    assert active.all()
    assert (np.abs(states.episode_return).max(axis=1) == HORIZON - 2).any()


class Halved(maax.RewardWrapper):
    """A user's own."""

    def reward(self, state):
        return state.reward / 2


ERRORS = {
    "reward without teams": (
        lambda e: maax.HideAndSeekReward(e.base),
        "HideAndSeekReward: needs TeamMembership; wrap with it first",
    ),
    "reward of one team": (
        lambda e: maax.HideAndSeekReward(maax.make("tag", impl="c")),
        "HideAndSeekReward: env has the team ['players']; takes two, hiders and seekers",
    ),
    "reward without contact": (lambda e: maax.HideAndSeekReward(e.env), "needs AgentAgentContactMask2D"),
    "preparation without teams": (lambda e: maax.PreparationPhase(e.base), "needs TeamMembership"),
    "reward after preparation": (
        lambda e: maax.HideAndSeekReward(maax.PreparationPhase(e)),
        "HideAndSeekReward: env has PreparationPhase already; wrap with HideAndSeekReward before it",
    ),
    "preparation after bins": (
        lambda e: maax.PreparationPhase(maax.DiscretizeActions(e)),
        "PreparationPhase: env has DiscretizeActions already",
    ),
    "twice": (maax.TeamMembership, "TeamMembership: env has a wrapper named 'team_membership' already"),
    "flat without split": (maax.FlattenObservations, "FlattenObservations: needs SplitObservations"),
    "not an environment": (lambda e: maax.TeamMembership("standard"), "env: got 'standard'; takes an environment"),
    "teams": (lambda e: maax.TeamMembership(e.base, [0, 1]), "team_index: got [0, 1]; takes 5 whole numbers"),
    "distance": (lambda e: maax.AgentAgentContactMask2D(e.base, 0), "distance: got 0; takes a positive number"),
    "fraction": (lambda e: maax.PreparationPhase(e, 1.5), "prep_fraction: got 1.5; takes a number in [0, 1]"),
    "type": (lambda e: maax.HideAndSeekReward(e, "joint"), "rew_type: got 'joint'; takes one of"),
    "rectangle": (lambda e: maax.RestrictAgentsRect(e, (3, 3, 1, 1)), "rect: got (3, 3, 1, 1); takes x0, y0, x1, y1"),
    "bins": (lambda e: maax.DiscretizeActions(e, 1), "n_bins: got 1"),
    "unknown observation": (lambda e: maax.SelectObservations(e, ["lidar"]), "observations: got ['lidar']; takes some"),
    "too many": (
        lambda e: maax.SpoofEntities(maax.SplitObservations(e), 2, ["agent_qpos_qvel"]),
        "agent_qpos_qvel: has shape (5, 4, 8); takes (n_agents, k, ...) with k up to total, 2",
    ),
    "unlike parts": (
        lambda e: maax.ConcatenateObservations(e, {"all": ["box_obs", "agent_pos"]}),
        "all: got parts of shapes",
    ),
}


@pytest.mark.parametrize(("call", "message"), ERRORS.values(), ids=ERRORS)
def test_wrong_orders_and_arguments(call, message, touching):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(touching)
    assert message in str(error.value)


def test_ones_own_wrapper(touching):
    env = Halved(maax.HideAndSeekReward(touching))
    state = env.reset(seeds.key(3))
    active = np.asarray(state.world.active["agent"])
    state = env.step(state, {"move": jnp.zeros((5, 3))})
    equal(np.abs(state.reward), 0.5 * active)


@pytest.mark.parametrize(
    ("later", "message"),
    [
        (jnp.zeros(4), r"got float32\[4\] as the memory of Forgetful, which was float32\[3\] before; takes the same"),
        (jnp.zeros(3, jnp.int32), r"got int32\[3\] as the memory of Forgetful, which was float32\[3\] before"),
        ({"a": jnp.zeros(3)}, r"got nothing as the memory of Forgetful, which was float32\[3\] before"),
    ],
)
def test_a_memory_that_changes_its_form_is_refused_by_name(base, later, message):
    class Forgetful(maax.Wrapper):
        name = "forgetful"

        def begin(self, key, params):
            return self.remember(self.env.begin(key, params), jnp.zeros(3))

        def transition(self, state, action):
            return self.remember(self.env.advance(state, action), later)

    env = Forgetful(base)
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(env.step, env.state_shape, env.sample_action(seeds.key(0)))
