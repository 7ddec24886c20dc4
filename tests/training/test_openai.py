"""Published policies: that they are read, observe and decide as described, play, and refuse what does not fit."""

from __future__ import annotations

import functools
import io
import json
import pickle
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from helpers import openai_oracle as oracle
from helpers import seeds
from helpers.chance import P_MIN
from helpers.openai_oracle import FULL, GAMES, PARTS, QUADRANT
from scipy import stats

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.cli import main
from maax_mjx.cli.saved import env_of
from maax_mjx.wrappers.wrapper import find

N, STEPS, HORIZON = 3, 8, 6
FAR = 1000.0
"""Metres that rays read which meet nothing, further than any that meets something."""
SMALL = 1e-5
"""Of the largest number of an array: what rounding to 32 bits may do to it."""


@functools.cache
def arrays(game):
    return oracle.draw(game, seeds.rng(0))


def read(changed):
    """The policy of a file with these variables."""
    with tempfile.TemporaryDirectory() as folder:
        return training.Policy.from_openai(oracle.write(Path(folder) / "published.npz", changed))


@functools.cache
def policy(game):
    return read(arrays(game))


@functools.cache
def worlds(game):
    """Worlds of the policy's game, with short episodes; without the full game's rooms, which take long to compile."""
    open_floor = {"scenario": "empty", "p_door_dropout": 0.0} if game == FULL else {}
    return maax.Worlds(policy(game).make_env(impl="c", horizon=HORIZON, **open_floor), N)


@functools.cache
def played(game):
    """Steps of worlds at different times of their episodes: what was observed, read, decided and remembered."""
    mine = policy(game).on(worlds(game).env)

    def play(state, key, memory, weights):
        read = mine.play.adapter.read(state.obs)
        logits, after = mine.play.network(weights, read, memory)
        return *mine.play(state, key, memory, weights), {"read": read, "logits": logits, "memory": after}

    states = worlds(game).reset(seeds.key(0), stagger=True)
    first = np.array(states.step)
    keep = ("obs", "action", "extras", "terminated", "truncated", "step")
    _, kept = worlds(game).rollout(states, play, STEPS, mine.params, keep=keep, memory=mine.memory(N))
    kept = jax.device_get(kept)
    kept["before"] = np.concatenate([first[None], kept["step"][:-1]])
    return SimpleNamespace(**kept, done=kept["terminated"] | kept["truncated"])


@functools.cache
def expected(game):
    """The oracle's observations, logits and memories of what was played, by step and world."""
    run, tower, found = played(game), oracle.Tower(game, arrays(game)), {}
    for world in range(N):
        memory = tower.memory(4)
        for t in range(STEPS):
            read = oracle.published(game, at(run.obs, t, world))
            logits, memory = tower.logits(read, memory)
            found[t, world] = read, logits, np.concatenate(memory, axis=-1)
            memory = tower.memory(4) if run.done[t, world] else memory
    return found


def at(tree, *index):
    return jax.tree.map(lambda x: x[index], tree)


@functools.cache
def far(game, **fields):
    """The game as it is by default, but with rays that go far."""
    return maax.make(GAMES[game], impl="c", **{"lidar.range": FAR}, **fields)


def drawn_obs(env, seed=0):
    """Observations of an environment's shapes, of numbers of all kinds; boxes that are absent are not zero in them."""
    rng = seeds.rng(seed)
    obs = {}
    for name, space in env.observation_space.spaces.items():
        is_mask = name.startswith(("sees_", "agent_team")) or "_mask" in name
        x = rng.random(space.shape) < 0.6 if is_mask else rng.normal(0, 2, space.shape)
        obs[name] = x.astype(space.dtype)
    obs["ramp_mask"][:], obs["box_mask"][:, -1] = True, False
    obs["sees_box"] &= obs["box_mask"]
    obs["prep_remaining"][:] = rng.random()
    rays = rng.uniform(0.1, 9.0, obs["lidar"].shape)
    obs["lidar"] = np.where(rng.random(rays.shape) < 0.3, FAR, rays).astype(np.float32)
    return obs


def assert_near(got, wanted, what=""):
    assert np.shape(got) == np.shape(wanted), what
    np.testing.assert_allclose(got, wanted, rtol=0, atol=SMALL * np.abs(wanted).max(), err_msg=what)


def assert_all_near(got, wanted):
    assert set(got) >= set(wanted)
    for name, x in wanted.items():
        assert_near(got[name], x, name)


# Networks.


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_logits_and_memories_are_the_oracles(game):
    run = played(game)
    assert run.done.any(axis=0).all(), "every world begins anew"
    for (t, world), (_, logits, memory) in expected(game).items():
        assert_all_near(at(run.extras["logits"], t, world), logits)
        assert_near(run.extras["memory"][t, world], memory, "memory")


def test_the_files_have_the_published_numbers_of_parameters():
    towers = oracle.shapes(FULL)
    assert [sum(int(np.prod(shape)) for shape in tower.values()) for tower in towers] == [817_737, 808_485]
    used = {name for name in policy(FULL).params if not name.startswith("normalize_")}
    assert sum(policy(FULL).params[name].size for name in used) == 817_737


@pytest.mark.parametrize("game", GAMES)
def test_what_is_not_seen_is_not_known(game):
    """Whatever stands where a mask is zero, and whichever order entities of a kind are in, the logits are the same."""
    mine = policy(game).on(far(game))
    network = jax.jit(mine.play.network)
    read, other = (jax.device_get(mine.play.adapter.read(drawn_obs(far(game), seed))) for seed in (0, 1))
    memory, turned = mine.memory(1)[0], {}
    for kind, mask in zip(oracle.KINDS, oracle.MASKS, strict=True):
        mixed = np.where(read[mask][..., None] > 0, read[kind], other[kind])
        turned |= {kind: mixed[:, ::-1], mask: read[mask][:, ::-1]}
    wanted, _ = network(mine.params, read, memory)
    assert_all_near(network(mine.params, read | turned, memory)[0], wanted)
    assert np.abs(network(mine.params, other, memory)[0]["action_movement"] - wanted["action_movement"]).max() > 0.1


@pytest.mark.parametrize("prefix", ["policy", "anything"])
def test_whatever_names_begin_with_and_the_value_net_are_ignored(prefix):
    """A file of another first part, whose value net is missing or is not even of numbers."""
    tower = {name.partition("/")[2]: x for name, x in arrays(FULL).items() if "vpred" not in name}
    same = {f"{prefix}/{name}": x for name, x in tower.items()}
    same[f"{prefix}/vpred_net//dense6-0/kernel:0"] = np.full((290, 128), np.nan, np.float32)
    jax.tree.map(np.testing.assert_array_equal, read(same).params, policy(FULL).params)


# Observations.


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_what_is_read_is_the_oracles(game):
    """In a rollout, and of numbers of all kinds."""
    run = played(game)
    for (t, world), (wanted, _, _) in expected(game).items():
        assert_all_near(at(run.extras["read"], t, world), wanted)
    obs = drawn_obs(far(game))
    assert_all_near(policy(game).on(far(game)).play.adapter.read(obs), oracle.published(game, obs, FAR))


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_places_are_those_of_lower_corners(game):
    """At the beginning all stands on the floor: corners are at a height of 0."""
    read = at(played(game).extras["read"], 0)
    obs = at(played(game).obs, 0)
    for name in ("observation_self", "agent_qpos_qvel", "box_obs", "ramp_obs"):
        np.testing.assert_allclose(read[name][..., 2], 0.0, atol=0.02, err_msg=name)
    for name in ("box_obs", "ramp_obs"):
        is_there = obs[f"{name[:-4]}_mask"]
        sizes = read[name][..., 9:12] if game == FULL and name == "box_obs" else np.full(3, 0.5)
        centres = (read[name][..., :3] + sizes / 2)[is_there]
        np.testing.assert_allclose(centres, obs[name][..., :3][is_there], atol=1e-5)
        assert not read[name][~is_there].any()
    if game == FULL:
        assert read["box_obs"][..., 9:12].max() == pytest.approx(1.65), "elongated ones"


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES)
def test_hiders_know_that_they_hide_and_how_long_they_prepare(game):
    """The share rises from 0 to 1 in the steps of preparation, and stays."""
    run, env = played(game), worlds(game).env
    n_steps = int(np.ceil(0.4 * HORIZON))
    # The very first observations are of beginnings, whatever step worlds are said to be at.
    own, before = run.extras["read"]["observation_self"][1:], run.before[1:]
    prep = np.minimum(1, before / (n_steps + 1e-5))
    np.testing.assert_allclose(own[..., 9], np.broadcast_to(prep[..., None], own.shape[:-1]), atol=1e-4)
    assert set(before.ravel()) == set(range(HORIZON))
    hides = np.isin(np.arange(4), env.teams["hiders"].slots)
    np.testing.assert_array_equal(own[..., 8], np.broadcast_to(hides, own.shape[:-1]))


@pytest.mark.parametrize("game", GAMES)
def test_others_come_in_circulant_order(game):
    read = played(game).extras["read"]
    for i in range(4):
        for j in range(3):
            other = read["observation_self"][:, :, (i - 1 - j) % 4]
            np.testing.assert_array_equal(read["agent_qpos_qvel"][:, :, i, j], other)


def test_locks_follow_the_sizes():
    """Of boxes and ramps: by you, by your team, by anybody; ramps have no sizes."""
    env = worlds(FULL).env
    obs = {name: np.zeros_like(x) for name, x in drawn_obs(env).items()}
    obs["box_mask"][:] = obs["ramp_mask"][:] = True
    for name in ("box_obs", "ramp_obs"):
        have = env.observed[name].names()
        for value, column in enumerate(("you_lock", "team_lock", "obj_lock"), start=1):
            obs[name][..., have.index(column)] = value
    read = policy(FULL).on(env).play.adapter.read(obs)
    for name in ("box_obs", "ramp_obs"):
        np.testing.assert_array_equal(read[name][0, 0, 9:], [0, 0, 0, 1, 2, 3])


@pytest.mark.parametrize(
    ("fields", "rays"),
    [
        ({"lidar.range": FAR}, [0.4, 5.9, 7.5, FAR]),
        ({"lidar.range": FAR, "lidar.capped": False}, [0.4, 5.9, 7.5, FAR]),
        ({"published": True}, [0.4, 5.9, 7.5, 6.0]),
        ({}, [0.4, 5.9, 6.0, 6.0]),
    ],
)
def test_rays_that_hit_nothing_read_6_m(fields, rays):
    """Hits beyond 6 m stay, where rays go further."""
    env = maax.make("hide_and_seek_quadrant", impl="c", **fields)
    obs = drawn_obs(env)
    obs["lidar"][:, :4, 0] = rays
    read = policy(QUADRANT).on(env).play.adapter.read(obs)
    np.testing.assert_allclose(read["lidar"][0, :4, 0], [*rays[:3], 6.0], rtol=1e-6)


def test_more_agents_and_boxes_than_published_are_read():
    """Of 5 agents and 4 boxes: weights are shared by all entities of a kind."""
    env = far(FULL, n_hiders=3, n_boxes=4, n_elongated_boxes=3)
    mine, obs = policy(FULL).on(env), drawn_obs(env)
    assert obs["box_obs"].shape[:2] == (5, 4)
    logits, _ = jax.jit(mine.play.network)(mine.params, mine.play.adapter.read(obs), mine.memory(1)[0])
    tower = oracle.Tower(FULL, arrays(FULL))
    assert_all_near(logits, tower.logits(oracle.published(FULL, obs, FAR), tower.memory(5))[0])


def test_the_quadrants_policy_plays_the_full_game():
    """It reads no sizes and no locks of ramps; places are still those of the corners of boxes of any size."""
    read = policy(QUADRANT).on(far(FULL)).play.adapter.read(obs := drawn_obs(far(FULL)))
    wanted = oracle.published(FULL, obs, FAR)
    wanted["box_obs"] = wanted["box_obs"][..., [*range(9), 12, 13, 14]]
    wanted["ramp_obs"] = wanted["ramp_obs"][..., :9]
    assert_all_near(read, wanted)


# Playing.


@functools.cache
def drawn_actions():
    """Many actions for the same observations, and the oracle's logits of them."""
    mine, obs = policy(FULL).on(worlds(FULL).env), at(played(FULL).obs, 0, 0)

    @jax.jit
    def draw(keys, weights, obs, memory):
        state = SimpleNamespace(obs=obs)
        return jax.vmap(lambda key: mine.play(state, key, memory, weights)[0])(keys)

    keys = jax.random.split(seeds.key(1), 20_000)
    return jax.device_get(draw(keys, mine.params, obs, mine.memory(1)[0])), expected(FULL)[0, 0][1]


def test_actions_are_drawn_as_their_logits_say():
    actions, logits = drawn_actions()
    for part, n_choices in (("action_movement", 3), ("action_pull", 1), ("action_glueall", 1)):
        chosen = actions[oracle.OURS[part]].reshape(-1, 4, n_choices)
        shares = oracle.softmax(logits[part].reshape(4, n_choices, -1))
        for agent in range(4):
            for i in range(n_choices):
                counts = np.bincount(chosen[:, agent, i], minlength=shares.shape[-1])
                found = stats.chisquare(counts, len(chosen) * shares[agent, i])
                assert found.pvalue > P_MIN, (part, agent, i)


def test_choices_are_drawn_independently():
    """Of all agents, parts and axes; a correlation of 6 standard deviations has a chance of 2e-9."""
    actions, _ = drawn_actions()
    choices = np.concatenate([x.reshape(len(x), -1) for x in actions.values()], axis=1)
    apart = np.corrcoef(choices.T) - np.eye(choices.shape[1])
    assert np.abs(apart).max() < 6 / np.sqrt(len(choices))


@pytest.mark.parametrize("game", GAMES)
def test_a_greedy_policy_takes_the_largest_logits(game):
    mine = policy(game).greedy().on(worlds(game).env)
    again = policy(game).on(worlds(game).env).greedy()
    assert mine.play == again.play
    assert hash(mine.play) == hash(again.play), "compiled once"
    play = jax.jit(lambda obs, *others: mine.play(SimpleNamespace(obs=obs), *others)[0])
    for world in range(N):
        action = play(at(played(game).obs, 0, world), seeds.key(world), mine.memory(1)[0], mine.params)
        assert mine.play.adapter is not None
        for part, logits in expected(game)[0, world][1].items():
            choices = logits.reshape(4, 3, 11) if part == "action_movement" else logits
            taken = np.take_along_axis(choices, np.asarray(action[oracle.OURS[part]], int)[..., None], axis=-1)[..., 0]
            np.testing.assert_allclose(taken, choices.max(axis=-1), atol=1e-3)


@pytest.mark.parametrize("game", GAMES)
def test_actions_are_in_the_space(game):
    """A check that `Worlds` makes of shapes; here of numbers."""
    env = worlds(game).env
    for t in range(STEPS):
        assert env.action_space.contains(at(played(game).action, t, 0))


@pytest.mark.slow
def test_it_plays_and_is_recorded_and_forgets_at_the_end():
    """As it is, without `on`: memory is looked after, and zero where an episode ended."""
    mine, world = policy(QUADRANT), worlds(QUADRANT)
    states, memory = world.reset(seeds.key(2)), None
    for step in range(1, HORIZON + 1):
        states, kept = world.rollout(states, mine, 1, key=seeds.key(step), memory=memory)
        memory = kept["memory"]
        assert memory.shape == (N, 4, 512)
        assert (np.abs(memory).max(axis=(1, 2)) > 0.01).all() == (step < HORIZON)
    assert not np.asarray(memory).any()
    states, recording = maax.record(world, states, mine, 2, every=1)
    assert np.asarray(states.step).tolist() == [2] * N
    assert recording.states.step.shape == (3, 1), "frames and worlds"


def test_before_it_is_given_an_environment_it_says_what_to_do():
    with pytest.raises(ValueError, match=r"^policy: .* takes policy\.on\(env\)$"):
        policy(QUADRANT).memory(1)


@pytest.fixture
def file(tmp_path, monkeypatch, made_once):
    """The file of a policy in a folder of its own, and options for short episodes."""
    monkeypatch.chdir(tmp_path)
    oracle.write("published.npz", arrays(QUADRANT))
    return "published.npz", ["--impl", "c", "--env.horizon", str(HORIZON), "--json"]


@pytest.mark.slow
def test_a_command_plays_it_in_the_published_game(file, capsys):
    path, short = file
    main(["rollout", "hide_and_seek_quadrant", "--policy", path, "--worlds", str(N), "--steps", "8", *short])
    told = json.loads(capsys.readouterr().out)
    assert (told["policy"], told["env"]) == (path, "hide_and_seek_quadrant")
    assert told["episodes"] >= N
    made = env_of(Path("maax-out") / "rollout.npz", "c").made
    assert (made.config.published, made.config.horizon) == (True, HORIZON)


@pytest.mark.slow
def test_it_is_evaluated(file, capsys, monkeypatch):
    """By a command, which prints what `training.evaluate` found: each team against agents that act at random."""
    path, short = file
    evaluate, found = training.evaluate, []
    monkeypatch.setattr(training, "evaluate", lambda *args, **named: found.append(evaluate(*args, **named)) or found[0])
    main(["evaluate", path, "--against", "random", "--episodes", str(N), *short])
    assert json.loads(capsys.readouterr().out) == training.as_json(found[0])
    matches = found[0].matches
    assert [(match.team, match.opponent) for match in matches] == [("hiders", "random"), ("seekers", "random")]
    assert all(match.episodes == N and np.isfinite(match.score.mean) for match in matches)


def test_commands_refuse_in_a_sentence(file, capsys):
    path, _ = file
    Path("broken.npz").write_bytes(b"broken")
    for words, said in (
        (["rollout", "hide_and_seek_full", "--policy", path], "one of hide_and_seek_quadrant, to play hide"),
        (["rollout", "tag", "--policy", path], "takes one of the same game"),
        (["rollout", "hide_and_seek_quadrant", "--policy", "broken.npz"], "policy: got broken.npz, which is no .npz"),
        (["rollout", "hide_and_seek_quadrant", "--policy", "none.npz"], "policy: got 'none.npz', and nothing is there"),
        (["evaluate", "none.npz"], "got 'none.npz', and nothing is there"),
        (["evaluate", path, "--env.n_bins", "5"], "policy: it decides"),
        (["train", "hide_and_seek_quadrant", "--from", path, "--steps", "8"], "from: got <OpenAIPolicy"),
    ):
        with pytest.raises(SystemExit) as error:
            main(words)
        assert error.value.code == 2
        told = capsys.readouterr().err
        assert said in told, (words, told)
        assert "Traceback" not in told
    assert not Path("runs").exists() or not any(Path("runs").rglob("policy"))


# Files and environments that do not fit.


def refused(path):
    """The sentence with which a file is refused."""
    with pytest.raises(ValueError, match=r"^path: got ") as error:
        training.Policy.from_openai(path)
    told = str(error.value)
    assert "takes" in told
    assert len(told.splitlines()) == 1
    return told


def refused_with(changed):
    """The sentence for a file of the full policy in which some variables differ; None leaves one out."""
    every = {f"policy/{name}": arrays(FULL)[f"policy/{name}"] for name in USED}
    every |= {f"policy/{name}": x for name, x in changed.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "published.npz"
        return refused(oracle.write(path, {name: x for name, x in every.items() if x is not None}))


USED = [name.partition("/")[2] for name in oracle.draw(FULL, np.random.default_rng(0)) if "vpred" not in name]
"""Names of the variables that a policy plays with."""
KERNEL = "policy_net//dense12-0/kernel:0"
FITS = (
    r'takes a hide-and-seek game as published, observations="split", such as policy\.make_env\(\), or a transfer task '
    r"with made_up=True$"
)


@pytest.mark.parametrize("kind", ["objects", "bytes"])
def test_nothing_is_unpickled(kind, tmp_path):
    """Not the network's arguments, nor what pretends to be a variable."""
    sprung = tmp_path / "sprung"
    trap = oracle.traps(sprung)[kind]
    path = oracle.write(tmp_path / "trap.npz", arrays(FULL) | {oracle.ARGUMENTS: trap})
    training.Policy.from_openai(path)
    training.player_of("policy", str(path))
    assert not sprung.exists()
    vpred = "policy/vpred_net//dense6-0/kernel:0"
    training.Policy.from_openai(oracle.write(path, arrays(FULL) | {vpred: trap}))
    refused(oracle.write(path, arrays(FULL) | {f"policy/{KERNEL}": trap}))
    assert not sprung.exists()
    # It would have sprung.
    with np.load(path, allow_pickle=True) as file:
        found = file[f"policy/{KERNEL}"]
    if kind == "bytes":
        pickle.loads(found).close()
    assert sprung.exists()


def test_other_files_are_refused(tmp_path):
    path = oracle.write(tmp_path / "published.npz", arrays(FULL))
    good = path.read_bytes()
    assert "which is not there" in refused(tmp_path / "none.npz")
    assert "which is not there" in refused(tmp_path)
    plain = io.BytesIO()
    np.save(plain, np.zeros(3))
    middle = len(good) // 2
    flipped = good[:middle] + bytes([good[middle] ^ 255]) + good[middle + 1 :]
    for bad in (b"", b"PK", b"no file of arrays", good[:middle], flipped, plain.getvalue(), pickle.dumps([1, 2])):
        path.write_bytes(bad)
        told = refused(path)
        assert str(path) in told
        assert "damaged" in told
    for other in ({"x": np.zeros(3)}, {"policy/x": np.zeros(3)}, {}):
        assert "without the variables of a policy" in refused(oracle.write(path, other))
    training.Policy.load("quadrant/forts").save(path)
    refused(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize(
    "name", [KERNEL, "normalize_lidar/obsfilter/lidar/mean:0", "policy_out/action_pull/dense/bias:0"]
)
def test_numbers_that_are_none_are_refused(name, bad):
    changed = arrays(FULL)[f"policy/{name}"].copy()
    changed.flat[-1] = bad
    assert "is not of finite numbers" in refused_with({name: changed})


def test_numbers_of_other_types_are_refused():
    for dtype in (bool, int, complex, "U8"):
        assert KERNEL.removesuffix(":0").replace("//", "/") in refused_with({KERNEL: np.ones((256, 256), dtype)})


@pytest.mark.parametrize(
    "names",
    [
        *[pytest.param([x], id=x) for x in USED],
        pytest.param([x for x in USED if "dense12-0" in x], id="a layer"),
        pytest.param([x for x in USED if "pre_sa_layer_norm" in x], id="a layer norm"),
    ],
)
def test_every_variable_is_needed(names):
    refused_with(dict.fromkeys(names))


@pytest.mark.parametrize("name", USED)
def test_variables_of_other_shapes_are_refused(name):
    x = arrays(FULL)[f"policy/{name}"]
    # Convolutions may reach as far as they like.
    for axis in range(name.startswith("policy_net//circ"), x.ndim):
        refused_with({name: np.concatenate([x, x.take([0], axis=axis)], axis=axis)})


@pytest.mark.parametrize(
    "changed",
    [
        {KERNEL.replace("kernel", "bias"): np.ones(1, np.float32)},
        {"normalize_box_obs/obsfilter/box_obs/mean:0": np.ones(1, np.float32)},
        {"normalize_self_obs/obsfilter/mean:0": np.float32(1)},
        {"policy_out/action_movement/dense/kernel:0": np.float32(1)},
        {"policy_net//lstm14/rnn/basic_lstm_cell/kernel:0": np.ones(1024, np.float32)},
    ],
    ids=str,
)
def test_variables_of_fewer_axes_or_of_one_number_are_refused(changed):
    """Instead of being repeated, or of errors of other kinds."""
    refused_with(changed)


@pytest.mark.parametrize("kind", ["compressed", "encrypted", "with another file"])
def test_archives_of_other_kinds_are_refused(kind, tmp_path):
    path = tmp_path / "published.npz"
    if kind == "compressed":
        np.savez_compressed(path, **arrays(FULL))
        data = bytearray(path.read_bytes())
        # Within the first array, which is the convolution's.
        data[100:200] = bytes(100)
    else:
        data = bytearray(oracle.write(path, arrays(FULL)).read_bytes())
        if kind == "encrypted":
            # A flag among the 46 bytes before the name in the list of what is in it.
            data[data.rindex(f"policy/{KERNEL}.npy".encode()) - 38] |= 1
    path.write_bytes(bytes(data))
    if kind == "with another file":
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(f"policy/{KERNEL}.txt", "no array")
    refused(path)


def test_other_numbers_of_embeddings_are_refused():
    """Three, and six: those of agents, boxes, ramps and construction sites, oneself, and of something else."""
    for kinds, said in (
        ((*oracle.KINDS, oracle.SITES, "food_obs"), "6 embeddings"),
        (oracle.KINDS[:2], "3 embeddings"),
    ):
        with tempfile.TemporaryDirectory() as folder:
            path = oracle.write(Path(folder) / "other.npz", oracle.draw(FULL, seeds.rng(0), kinds=kinds))
            told = refused(path)
        assert said in told
        assert "hide_and_seek_full" in told
        assert "blueprint" in told


@pytest.mark.parametrize(
    ("game", "fields", "named"),
    [
        ("hide_and_seek_full", {"observations": "ego"}, "agent_qpos_qvel_self"),
        ("hide_and_seek_full", {"observations": "flat"}, "agent_qpos_qvel_self"),
        ("hide_and_seek_full", {"observations": "raw"}, "agent_qpos_qvel_self"),
        ("hide_and_seek_full", {"n_bins": 5}, r"MultiDiscrete.*'move'.*MultiDiscrete"),
        ("hide_and_seek_full", {"n_bins": None}, r"MultiDiscrete.*'move'.*Box"),
        ("hide_and_seek_full", {"lidar.n_rays": 20}, "30 rays .* env has .*20"),
        ("hide_and_seek_full", {"lidar.frame": "agent"}, "world's frame, and env has .*agent"),
        ("hide_and_seek_full", {"lidar": None}, "'lidar'"),
        ("hide_and_seek_full", {"lock": None}, "lock"),
        ("hide_and_seek_full", {"grab": None}, "grab"),
        ("hide_and_seek_full", {"lock.per_object": True}, "'lock'"),
        ("hide_and_seek_full", {"n_boxes": 0, "n_elongated_boxes": 0}, "sees_box"),
        ("hide_and_seek_quadrant", {}, "size x.*'box_obs'"),
        ("hide_and_seek", {"observations": "split"}, "policy"),
        ("tag", {}, "agent_qpos_qvel_self"),
        ("tag", {"observations": "split"}, "policy"),
    ],
)  # fmt: skip
def test_environments_that_do_not_fit_are_refused(game, fields, named):
    """With a sentence of what is read or decided, and what the environment has."""
    with pytest.raises(ValueError, match=f"(?s)^policy: it (reads|decides) .*, and env .*; {FITS}") as error:
        policy(FULL).on(maax.make(game, impl="c", **fields))
    assert error.match(f"(?s){named}")


def test_it_does_not_learn_on(tmp_path):
    with pytest.raises(ValueError, match=r"OpenAIPolicy.*; takes a training\.Policy"):
        training.Trainer(worlds(QUADRANT).env, tmp_path / "run", "laptop", 4, begin_from=policy(QUADRANT))
    assert not (tmp_path / "run" / "policy").exists()


# Its game.


@pytest.mark.parametrize(("game", "name"), GAMES.items())
def test_it_makes_the_game_that_it_learnt(game, name):
    """With all details as published; fields of it can be changed."""
    made = policy(game).make_env(impl="c", horizon=12).made
    assert made.name == name == policy(game).game["game"]
    assert made.config == replace(maax.config_of(name), impl="c", horizon=12, published=True)
    assert not find(worlds(game).env, maax.Lidar).capped


def test_parts_of_actions_are_the_published_ones():
    """Three movements of 11 bins, of which the middle one is rest, holding and locking."""
    for game in GAMES:
        got = {part: policy(game).params[f"policy_out/{part}/dense/bias"].shape[0] for part in PARTS}
        assert got == PARTS
