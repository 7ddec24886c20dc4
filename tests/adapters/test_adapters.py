"""Environments and batches as other libraries want them, by these libraries' own checkers."""

from __future__ import annotations

import contextlib
import sys
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from helpers import seeds

import maax_mjx as maax
from maax_mjx import adapters, training
from maax_mjx.adapters import rows
from maax_mjx.adapters.agents import PerAgent
from maax_mjx.training.network import Network

HORIZON = 6
OPEN = {"scenario": "empty", "p_door_dropout": 0.0, "box_placement": "uniform", "n_boxes": 1, "impl": "c"}
SMALL = OPEN | {"n_ramps": 0, "lidar": None, "rect": None, "horizon": HORIZON, "prep_fraction": 0.0}


@pytest.fixture(scope="module")
def env():
    """Split observations; bins, locks and grabs; the second seeker is in play in half of the episodes."""
    return maax.make("hide_and_seek_quadrant", observations="ego", n_seekers=(1, 2), **SMALL)


@pytest.fixture(scope="module")
def ego(env):
    """Of observations per agent, of which adapters make vectors themselves."""
    return maax.Worlds(env, 4, donate=False)


@pytest.fixture(scope="module")
def vectors(ego):
    """The batch that an adapter makes of these."""
    return adapters.gymnasium_vector(ego)


@pytest.fixture(scope="module")
def worlds(vectors):
    """Those of vectors, so that what adapters make of them are these worlds, compiled once for all tests."""
    return vectors.rows.worlds


def test_one_agents_spaces(env):
    """Bins, locks and grabs are joined in the order of their names; idle is the middle bin and no lock."""
    one = PerAgent(env)
    assert one.action_space == spaces.MultiDiscrete([2, 2, 11, 11, 11])
    assert one.idle.tolist() == [0, 0, 5, 5, 5]
    assert one.observation_space.shape == one.env.observation_space["obs"].shape[1:]
    chosen = jnp.stack([jnp.arange(5) + 5 * i for i in range(4)])
    action = one.action(chosen)
    np.testing.assert_array_equal(action["grab"], chosen[:, 0])
    np.testing.assert_array_equal(action["lock"], chosen[:, 1])
    np.testing.assert_array_equal(action["move"], chosen[:, 2:])
    drawn = np.stack([one.action_space.sample() for _ in range(4)])
    taken = {name: np.asarray(x, env.action_space[name].dtype) for name, x in one.action(drawn).items()}
    assert env.action_space.contains(taken)


def test_one_agents_spaces_of_other_games():
    mixed = PerAgent(maax.make("hide_and_seek", impl="c"))
    assert mixed.action_space == spaces.Dict({"lock": spaces.MultiBinary([2]), "move": spaces.Box(-1, 1, (3,))})
    assert {name: x.tolist() for name, x in mixed.idle.items()} == {"lock": [0, 0], "move": [0, 0, 0]}
    only = PerAgent(maax.make("tag", impl="c"))
    assert only.action_space == spaces.Box(-1, 1, (3,))
    assert only.action(jnp.zeros((4, 3)))["move"].shape == (4, 3)
    split = PerAgent(maax.make("tag", observations="ego", impl="c"), flat=False)
    assert isinstance(split.observation_space, spaces.Dict)
    with pytest.raises(ValueError, match="flat: got False"):
        PerAgent(maax.make("tag", impl="c"), flat=False)
    with pytest.raises(ValueError, match="whose agents share what is observed; takes one with SplitObservations"):
        PerAgent(maax.make("standard", impl="c"))


@pytest.mark.slow
def test_pettingzoos_own_checkers(env):
    checks = pytest.importorskip("pettingzoo.test")
    checks.parallel_api_test(adapters.pettingzoo(env), num_cycles=3 * HORIZON)
    checks.parallel_seed_test(lambda: adapters.pettingzoo(env), num_cycles=HORIZON + 2)


@pytest.mark.slow
def test_pettingzoo_has_who_is_in_play_and_what_the_environment_says(env):
    pytest.importorskip("pettingzoo")
    world = adapters.pettingzoo(env, seed=seeds.seed(0))
    absent = []
    for _ in range(12):
        observed, infos = world.reset()
        state = world._state
        here = [name for name, plays in zip(env.agent_names, state.active, strict=True) if plays]
        assert world.agents == here == list(observed) == list(infos)
        assert all(world.observation_space(name).contains(observed[name]) for name in here)
        absent += [set(env.agent_names) - set(here)]
    assert set() in absent
    assert {"seeker_1"} in absent
    world.reset(seed=seeds.seed(3))
    with pytest.raises(ValueError, match=r"actions: got none of \['hider_0'"):
        world.step({})
    for i in range(HORIZON):
        before, here = world._state, world.agents
        action = {name: world.action_space(name).sample() for name in here}
        _, rewards, terminated, truncated, _ = world.step(action)
        chosen = np.stack([action.get(name, world._of.idle) for name in env.agent_names])
        after = world._of.env.step(before, world._of.action(chosen))
        np.testing.assert_allclose([rewards[name] for name in here], np.asarray(after.reward)[: len(here)])
        assert set(truncated.values()) == {i == HORIZON - 1}
        assert set(terminated.values()) == {False}
    assert world.agents == []
    with pytest.raises(ValueError, match="step: got an episode that has ended"):
        world.step({})


@pytest.mark.slow
def test_dicts_of_arrays_are_in_their_spaces(env, ego):
    """Of PettingZoo's world, which is drawn as well, and of a batch, whose options are checked."""
    pytest.importorskip("pettingzoo")
    world = adapters.pettingzoo(env, flat=False)
    observed, _ = world.reset(seed=seeds.seed(0))
    assert all(world.observation_space(name).contains(seen) for name, seen in observed.items())
    assert "who_sees_whom" not in observed["hider_0"], "what is for critics alone"
    assert world.render().shape == (480, 640, 3)
    envs = adapters.gymnasium_vector(ego, flat=False)
    obs, _ = envs.reset(seed=seeds.seed(0), options={"stagger": True})
    assert envs.observation_space.contains(obs)
    with pytest.raises(ValueError, match=r"options: got \['reset_mask'\]; takes 'stagger'"):
        envs.reset(options={"reset_mask": np.ones(16, bool)})
    with pytest.raises(ValueError, match=r"actions: got shape \(16, 4\); takes an array \(16, 5\)"):
        envs.step(np.zeros((16, 4), int))
    # A list of rows, as Gymnasium's own batches take them.
    assert envs.step(list(envs.action_space.sample()))[1].shape == (16,)


@pytest.mark.slow
def test_supersuit_takes_it(env):
    supersuit = pytest.importorskip("supersuit")
    whole = maax.make("hide_and_seek_quadrant", observations="ego", **SMALL)
    envs = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.frame_stack_v1(adapters.pettingzoo(whole), 2))
    obs, _ = envs.reset(seed=0)
    assert np.shape(obs)[0] == 4


@pytest.mark.slow
def test_a_vector_env_is_the_worlds(worlds, vectors):
    """With the same actions, rows are the agents of the worlds; at ends they have what was observed last."""
    envs = vectors
    assert envs.num_envs == 16
    assert envs.observation_space.shape == (16, *envs.single_observation_space.shape)
    obs, infos = envs.reset(seed=seeds.seed(1))
    of = envs.rows.of
    twin = worlds
    states = twin.reset(jax.random.split(jax.random.key(seeds.seed(1)))[1])
    for i in range(HORIZON + 1):
        np.testing.assert_array_equal(obs, np.reshape(states.obs["obs"], (16, -1)))
        np.testing.assert_array_equal(infos["active"], np.ravel(states.active))
        action, active = envs.action_space.sample(), np.ravel(states.active)
        states = twin.step(states, of.action(jnp.asarray(action).reshape(4, 4, -1)))
        obs, reward, terminated, truncated, infos = envs.step(action)
        np.testing.assert_array_equal(reward, np.ravel(states.reward))
        assert not terminated.any()
        assert truncated.all() == (i == HORIZON - 1)
        assert ("final_obs" in infos) == (i == HORIZON - 1)
        if i == HORIZON - 1:
            final = np.reshape(states.final_obs["obs"], (16, -1))
            np.testing.assert_array_equal(np.stack(infos["final_obs"]), final)
            np.testing.assert_array_equal(infos["final_info"]["episode_return"], np.ravel(states.episode_return))
            assert set(infos["final_info"]["episode_length"]) == {HORIZON}
            np.testing.assert_array_equal(infos["final_info"]["active"], active)
            assert not np.array_equal(active, infos["active"]), "others are in play"
            assert not np.array_equal(final, obs), "a new episode has begun"


@pytest.mark.slow
def test_gymnasiums_wrappers_take_it(worlds):
    envs = RecordEpisodeStatistics(adapters.gymnasium_vector(worlds, "seekers", "still"))
    envs.reset(seed=0)
    for _ in range(HORIZON):
        *_, infos = envs.step(envs.action_space.sample())
    assert envs.episode_count == 8
    assert set(infos["episode"]["l"]) == {HORIZON}


class Counts:
    """A player who remembers how many steps of the episode it has played, and moves the more, the more there were."""

    def play(self, state, key, memory, params):
        jax.debug.callback(lambda *x: self.seen.append(tuple(map(int, x))), state.step, memory[0])
        bins = jnp.full((4, 3), 5, jnp.int32)
        return {"move": bins, "lock": jnp.zeros(4, jnp.int8), "grab": jnp.zeros(4, jnp.int8)}, memory + 1

    def memory(self, n):
        return np.zeros((n, 1), np.int32)

    seen, params = [], ()


@pytest.mark.slow
def test_others_are_played_by_a_policy_whose_memory_begins_with_the_episode(worlds, monkeypatch):
    """Rows are the team's agents alone; what others do does not come from the rows."""
    player = Counts()
    monkeypatch.setattr(rows, "seated", lambda *_: player)
    envs = adapters.gymnasium_vector(worlds, "hiders", "still")
    assert envs.num_envs == 8
    envs.reset(seed=seeds.seed(2))
    seekers = np.asarray(worlds.env.teams["seekers"].slots)
    for _ in range(HORIZON + 3):
        envs.step(envs.action_space.sample())
    jax.effects_barrier()
    assert len(player.seen) == 4 * (HORIZON + 3)
    assert all(step == played for step, played in player.seen)
    states = envs.rows._states
    columns = worlds.env.base.agents.qvel_ids[:, :2]
    speed = np.linalg.norm(np.asarray(states.data.qvel)[:, columns], axis=-1)
    assert speed[:, :2].max() > 0.5
    assert np.median(speed[:, seekers]) < 0.05


@pytest.mark.slow
def test_a_trained_policy_plays_the_others(env, tmp_path):
    """It reads the arrays beside the vectors; one of another game is refused. Faults are kept as worlds keep them."""
    network = Network.of(env, training.NetConfig(encoder="pool", core="lstm", width=8, heads=2, hidden=8))
    policy = training.Policy(network, network.draw(seeds.key(0)))
    worlds = maax.Worlds(env, 2, keep_faults=tmp_path)
    envs = adapters.gymnasium_vector(worlds, "hiders", policy)
    obs, _ = envs.reset(seed=0)
    assert envs.rows.worlds.faults() == []
    moved, _, _, _, infos = envs.step(envs.action_space.sample())
    assert moved.shape == obs.shape == (4, *envs.single_observation_space.shape)
    assert infos["active"].all()
    with pytest.raises(ValueError, match="takes an environment with the same columns"):
        adapters.gymnasium_vector(maax.Worlds(maax.make("tag", observations="ego", impl="c"), 2), "players", policy)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"team": "seekers", "policy": "self"}, "policy: got 'self'"),
        ({"team": "seekers"}, "policy: got None with the team 'seekers'"),
        ({"policy": "random"}, "policy: got 'random' with the team None"),
        ({"team": "seeker"}, "team: got 'seeker'"),
        ({"team": "seeker", "policy": "random"}, "team: got 'seeker'; did you mean 'seekers'"),
        (
            {"team": "seekers", "policy": "rando"},
            r"policy: got 'rando', and nothing is there \(did you mean 'random'\?\)",
        ),
    ],
)
def test_what_does_not_fit_is_refused(arguments, said, worlds):
    with pytest.raises(ValueError, match=said):
        adapters.gymnasium_vector(worlds, **arguments)
    with pytest.raises(ValueError, match=r"takes maax\.Worlds"):
        adapters.gymnasium_vector(worlds.env)


def test_seeds_and_actions_that_are_none_are_refused(env, worlds):
    envs, world = adapters.gymnasium_vector(worlds), adapters.pettingzoo(env)
    for reset in (envs.reset, world.reset):
        for seed in ("a", -1, [1, 2]):
            with pytest.raises(ValueError, match="seed: got"):
                reset(seed=seed)
    with pytest.raises(ValueError, match="seed: got 'x'"):
        adapters.gymnasium_vector(worlds, seed="x")
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions: got None; takes what action_space\.sample"):
        envs.step(None)
    for wrong in ([[0, 1], [0]], "x"):
        with pytest.raises(ValueError, match=r"actions: got (list|'x'); takes what action_space\.sample"):
            envs.step(wrong)
    world.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions: got \['bob'\]; takes those of"):
        world.step({agent: world.action_space(agent).sample() for agent in world.agents} | {"bob": 0})
    with pytest.raises(ValueError, match="agent: got 'bob'"):
        world.action_space("bob")


def test_actions_of_one_agent_that_are_none_are_refused(env):
    world = adapters.pettingzoo(env)
    with pytest.raises(ValueError, match="step: got no world yet; takes one that reset begins"):
        world.step({})
    with pytest.raises(ValueError, match="render: got no world yet"):
        world.render()
    world.reset(seed=seeds.seed(0))
    whole = {agent: world.action_space(agent).sample() for agent in world.agents}
    first = world.agents[0]
    named = rf"actions\['{first}'\]: "
    for wrong, said in (
        (None, named + r"got None; takes what action_space"),
        ([1, 1, 5, 5], named + r"got shape \(4,\)"),
        ([0.0, 0.0, 5.0, 5.0, 5.0], named + "got float64; takes whole numbers"),
        ([0, 0, 11, 5, 5], named + "'move' holds 5 to 11; takes whole numbers from 0 to 10"),
        ([[0, 1], [0]], named + "got list; takes what action_space"),
        ({"move": [5, 5, 5]}, named + r"got dict; takes an array \(5,\)"),
    ):
        with pytest.raises(ValueError, match=said):
            world.step(whole | {first: wrong})
    with pytest.raises(ValueError, match="actions: got list; takes a dict with the action of every agent"):
        world.step([*whole.values()])
    world.step({agent: action.tolist() for agent, action in whole.items()})  # lists are numbers as well


def test_actions_of_rows_are_whole_numbers_where_there_are_choices(worlds):
    envs = adapters.gymnasium_vector(worlds, team="seekers", policy="random")
    envs.reset(seed=seeds.seed(0))
    actions = envs.action_space.sample()
    for wrong, said in ((actions + 0.5, "float64|float32"), (actions > 1, "bool")):
        with pytest.raises(ValueError, match=rf"actions: got ({said}); takes whole numbers"):
            envs.step(wrong)


def test_worlds_of_pmap_are_refused(env):
    with pytest.raises(ValueError, match="worlds: got those of pmap"):
        adapters.gymnasium_vector(maax.Worlds(env, 2, devices=1, method="pmap"))


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("pettingzoo", "pettingzoo"),
        ("torch", "torch"),
        ("jaxmarl", "jaxmarl.environments"),
        ("brax", "brax.envs.base"),
        ("playground", "mujoco_playground"),
        ("stable_baselines3", "stable_baselines3.common.vec_env"),
    ],
)
def test_missing_libraries_are_named(name, module, env, worlds, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(maax.MissingLibraryError, match=rf"^{name}: needs"):
        getattr(adapters, name)(worlds if name in ("torch", "stable_baselines3") else env)


class Space(NamedTuple):
    """What JaxMARL's spaces have."""

    kind: str
    arguments: tuple


class Theirs:
    """What JaxMARL's MultiAgentEnv has that is asked for."""

    def __init__(self, num_agents):
        self.num_agents = num_agents

    def action_space(self, agent):
        return self.action_spaces[agent]


@pytest.fixture
def jaxmarl(monkeypatch):
    """The library if it is there, else what the adapter asks of it."""
    with contextlib.suppress(ImportError):
        import jaxmarl

        return jaxmarl
    spaces_, base, environments = (ModuleType(f"jaxmarl.environments{x}") for x in (".spaces", ".multi_agent_env", ""))
    spaces_.Box, spaces_.Discrete = (lambda *x, kind=kind: Space(kind, x) for kind in ("Box", "Discrete"))
    base.MultiAgentEnv, environments.spaces, environments.multi_agent_env = Theirs, spaces_, base
    for module in (ModuleType("jaxmarl"), environments, spaces_, base):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return None


@pytest.mark.slow
def test_jaxmarls_interface(jaxmarl):
    """Choices are numbered as NumPy ravels them; where an episode ends, the next one begins."""
    few = {"n_boxes": 0, "n_ramps": 0, "scenario": "empty", "n_frames": 10, "horizon": 3, "impl": "c"}
    game = adapters.jaxmarl(maax.DiscretizeActions(maax.make("tag", **few), 3))
    assert game.agents == [f"player_{i}" for i in range(4)]
    space = game.action_space("player_0")
    with pytest.raises(ValueError, match="agent: got 'bob'"):
        game.observation_space("bob")
    assert (space.arguments[0] if jaxmarl is None else space.n) == 27
    reset, step = jax.jit(game.reset), jax.jit(game.step)
    _, state = reset(jax.random.PRNGKey(seeds.seed(0)))
    bins = np.random.default_rng(seeds.seed(0)).integers(0, 3, (4, 3))
    numbers = np.ravel_multi_index(bins.T, (3, 3, 3))
    chosen = dict(zip(game.agents, jnp.asarray(numbers), strict=True))
    wanted = jax.jit(game.env.step)(state, {"move": jnp.asarray(bins)})
    with pytest.raises(ValueError, match=r"actions: got those of \['player_0'\]; takes one of each of"):
        game.step(jax.random.PRNGKey(0), state, {"player_0": chosen["player_0"]})
    with pytest.raises(ValueError, match=r"actions: got ArrayImpl; takes a dict with one of each of"):
        game.step(jax.random.PRNGKey(0), state, jnp.zeros(4, int))
    with pytest.raises(ValueError, match=r"actions: got \[27, .*; takes whole numbers from 0 to 26"):
        game.step(jax.random.PRNGKey(0), state, chosen | {"player_0": jnp.asarray(27)})
    with pytest.raises(ValueError, match="actions: got float32; takes whole numbers from 0 to 26"):
        game.step(jax.random.PRNGKey(0), state, dict.fromkeys(game.agents, jnp.asarray(2.7)))
    with pytest.raises(ValueError, match=r"actions: got shape \(3,\) of player_0; takes \(\)"):
        game.step(jax.random.PRNGKey(0), state, chosen | {"player_0": jnp.zeros(3, int)})
    with pytest.raises(ValueError, match=r"key: got 0; takes a key, such as"):
        game.reset(0)
    for i in range(3):
        obs, state, reward, done, _ = step(jax.random.PRNGKey(i), state, chosen)
        if i == 0:
            np.testing.assert_allclose(jnp.stack([*obs.values()]), wanted.obs["obs"], atol=1e-6)
            np.testing.assert_allclose(jnp.stack([*reward.values()]), wanted.reward, atol=1e-6)
        assert set(done) == {*game.agents, "__all__"}
        assert bool(done["__all__"]) == (i == 2)
        assert int(state.step) == (0 if i == 2 else i + 1)


def test_actions_that_jaxmarls_scripts_do_not_know_are_refused(jaxmarl, env):
    with pytest.raises(ValueError, match="as numbers and choices; takes one with bins"):
        adapters.jaxmarl(maax.make("hide_and_seek", impl="c"))
    wide = maax.make("hide_and_seek_quadrant", n_bins=21, impl="c")
    with pytest.raises(ValueError, match=r"have 37,044 choices; takes up to 10,000"):
        adapters.jaxmarl(wide)


@pytest.mark.slow
def test_stable_baselines3_learns_from_dicts(ego):
    """Whose single numbers are vectors of one, as its networks take no others."""
    library = pytest.importorskip("stable_baselines3")
    envs = adapters.stable_baselines3(ego, flat=False)
    obs = envs.reset()
    assert obs["agent_mask_self"].shape == (envs.num_envs, 1)
    single = {name: x[0] for name, x in obs.items()}
    assert envs.observation_space.contains(single)
    learner = library.PPO("MultiInputPolicy", envs, n_steps=HORIZON, batch_size=16, device="cpu")
    learner.learn(2 * envs.num_envs * HORIZON)
    assert learner.num_timesteps == 2 * envs.num_envs * HORIZON


class Paid(maax.RewardWrapper):
    """One a step, so that an episode's return is its length."""

    def reward(self, state):
        return jnp.ones(self.n_agents)


def test_stable_baselines3_evaluates_whole_episodes(env):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.evaluation import evaluate_policy

    worlds = maax.Worlds(Paid(env), 4)
    envs = adapters.stable_baselines3(worlds)

    class Still:
        """Anything that acts."""

        def predict(self, obs, **_):
            return np.stack([envs.action_space.sample() for _ in range(envs.num_envs)]), None

    returns, lengths = evaluate_policy(Still(), envs, n_eval_episodes=envs.num_envs, return_episode_rewards=True)
    assert set(returns) == set(lengths) == {HORIZON}
    spread = adapters.stable_baselines3(worlds, stagger=True)
    assert len(set(evaluate_policy(Still(), spread, envs.num_envs, return_episode_rewards=True)[1])) > 1
    with pytest.raises(ValueError, match="stagger: got True for a game without a horizon"):
        adapters.stable_baselines3(maax.Worlds(maax.make("tag", impl="c", horizon=None, n_boxes=0), 2), stagger=True)


@pytest.mark.slow
def test_stable_baselines3_learns(worlds):
    library = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecMonitor

    envs = VecMonitor(adapters.stable_baselines3(worlds, "seekers", "still", stagger=True))
    learner = library.PPO("MlpPolicy", envs, n_steps=HORIZON, batch_size=16, device="cpu")
    learner.learn(4 * 8 * HORIZON)
    assert len(learner.ep_info_buffer) >= 8
    envs.seed(4)
    first = envs.reset()
    envs.seed(4)
    np.testing.assert_array_equal(envs.reset(), first)
    assert not np.array_equal(envs.reset(), first)
    for _ in range(HORIZON):
        *_, done, infos = envs.step(np.stack([envs.action_space.sample() for _ in range(8)]))
        assert all(("terminal_observation" in info) == ended for info, ended in zip(infos, done, strict=True))
        assert all(info["TimeLimit.truncated"] for info, ended in zip(infos, done, strict=True) if ended)
    assert {info["l"] for info in learner.ep_info_buffer if info["l"] > 0} <= set(range(1, HORIZON + 1))


@pytest.mark.slow
def test_tensors_are_the_arrays(worlds):
    library = pytest.importorskip("torch")
    agents, envs = adapters.torch(worlds), adapters.gymnasium_vector(worlds)
    tensors, (obs, _) = agents.reset(seed=5), envs.reset(seed=5)
    kept = tensors.clone()
    for _ in range(HORIZON + 1):
        np.testing.assert_array_equal(tensors.numpy(), obs)
        action = envs.action_space.sample()
        step, (obs, reward, _, truncated, _) = agents.step(library.as_tensor(action)), envs.step(action)
        np.testing.assert_array_equal(step.reward.numpy(), reward)
        np.testing.assert_array_equal(step.truncated.numpy(), truncated)
        tensors = step.obs
    again = agents.reset(seed=5)
    assert library.equal(again, kept), "what was given before is not written over"
    with pytest.raises(ValueError, match=r"actions: got .*; takes a tensor on cpu"):
        agents.step(envs.action_space.sample())
    with pytest.raises(ValueError, match=r"actions: got list; takes a tensor on cpu"):
        agents.step(envs.action_space.sample().tolist())
    with pytest.raises(ValueError, match=r"got a torch.sparse_coo tensor on cpu; takes a dense one"):
        agents.step(library.as_tensor(envs.action_space.sample()).to_sparse())
    with pytest.raises(ValueError, match=r"actions: got float32; takes whole numbers"):
        agents.step(library.as_tensor(envs.action_space.sample()).float())
