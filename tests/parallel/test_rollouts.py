"""Rollouts against a loop of steps; saved runs against runs that were never stopped; too much for the memory."""

from __future__ import annotations

import asyncio
import gc
import json
import shutil
import signal
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.benchmarks import soak
from maax_mjx.parallel import shards

N, T, HORIZON = 6, 5, 4


@pytest.fixture(scope="module")
def env():
    return maax.make("standard", impl="c", scenario="empty", n_hiders=1, n_seekers=1, n_ramps=0, horizon=HORIZON)


def policy(state, key, gain):
    """Random, but for what it sees."""
    noise = jax.random.uniform(key, (2, 3), minval=-1, maxval=1)
    return {"move": gain * noise + 0.1 * (3.0 - state.obs["agent_pos"])}


KEEP = ("obs.agent_pos", "action", "reward", "truncated", "final_obs", "metrics.physics_fault", "data.qpos", "step")


@pytest.fixture(scope="module")
def rolled(worlds, start):
    return worlds.rollout(start, policy, T, jnp.float32(0.5), key=seeds.key(9), keep=KEEP)


def host(tree):
    return jax.tree.map(
        lambda x: np.asarray(jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x), tree
    )


def assert_same(a, b, exact=True):
    for x, y in zip(jax.tree.leaves(host(a)), jax.tree.leaves(host(b)), strict=True):
        np.testing.assert_array_equal(x, y) if exact else np.testing.assert_allclose(x, y, atol=1e-6)


@pytest.mark.slow
def test_a_scripted_player_is_a_policy(worlds, start, env):
    """Without parameters and memory, as a function of one world that plays the same."""
    chase = training.SCRIPTED["chase"]
    play = chase.on(env)
    _, kept = worlds.rollout(start, chase, T, keep=("action",))
    _, same = worlds.rollout(start, lambda state, key: play(state, key, (), ())[0], T, keep=("action",))
    assert np.abs(kept["action"]["move"]).max() > 0.5
    assert_same(kept["action"], same["action"])
    assert chase.on(env) == play.on(env)


@pytest.mark.slow
def test_a_rollout_is_a_loop_of_steps(worlds, start, rolled):
    """Every world gets a key of its own at every step; observations are those that the policy saw."""
    last, kept = rolled
    kept = jax.device_get(kept)
    assert set(kept) == set(KEEP)
    states = start

    @jax.jit
    def act(states, t):
        """World by world, each with a key that its number and the step's give."""
        keys = [jax.random.fold_in(jax.random.fold_in(seeds.key(9), i), t) for i in range(N)]
        views = [jax.tree.map(lambda x, i=i: x[i], states.obs) for i in range(N)]
        return [policy(states.replace(obs=view), key, 0.5)["move"] for view, key in zip(views, keys, strict=True)]

    for t in range(T):
        actions = act(states, t)
        np.testing.assert_array_equal(kept["obs.agent_pos"][t], states.obs["agent_pos"])
        np.testing.assert_allclose(kept["action"]["move"][t], np.stack(actions), atol=1e-6)
        states = worlds.step(states, {"move": kept["action"]["move"][t]})
        for name in ("reward", "truncated", "step", "final_obs"):
            assert_same(kept[name], {**kept, name: kept[name]}[name])
            assert_same(jax.tree.map(lambda x, t=t: x[t], kept[name]), getattr(states, name), exact=False)
        np.testing.assert_allclose(kept["data.qpos"][t], states.data.qpos, atol=1e-6)
        np.testing.assert_array_equal(kept["metrics.physics_fault"][t], states.metrics["physics_fault"])
    assert_same(last.counts, states.counts)
    assert (last.counts["episodes"] >= 1).all()
    assert not (kept["action"]["move"][:, 0] == kept["action"]["move"][:, 1]).any()


def test_arguments_may_change_without_compiling(worlds, start, rolled, caplog):
    with jax.log_compiles():
        other, _ = worlds.rollout(start, policy, T, jnp.float32(0.0), key=seeds.key(9), keep=KEEP)
    assert not [r for r in caplog.records if "Compiling" in r.getMessage() and "rollout" in r.getMessage()]
    assert not np.array_equal(other.data.qpos, rolled[0].data.qpos)


MISTAKES = {
    "unknown": (
        dict(keep=("rewards",)),
        "keep: got 'rewards' (did you mean 'reward'?); takes names that begin with one of obs, active, can_act, action",
    ),
    "text": (dict(keep="reward"), "keep: got 'reward'; takes a tuple"),
    "inner": (
        dict(keep=("obs.nothing",)),
        "keep: got 'obs.nothing'; has no 'nothing': takes one of agent_angle, agent_mask",
    ),
    "array": (dict(keep=("reward.x",)), "there is an array without parts"),
    "steps": (dict(n_steps=0), "n_steps: got 0"),
    "policy": (dict(policy=3), "policy: got 3"),
    "name of a policy": (dict(policy="chase"), "(state, key), or a player: training.Policy.load(name) or"),
    "action": (dict(policy=lambda state, key: {"move": jnp.zeros((3, 3))}), "'move' has shape (3, 3); takes (2, 3)"),
    "key": (dict(key=jnp.zeros(2, jnp.uint32)), "key: got an array of uint32"),
}


@pytest.mark.parametrize(("changed", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes(changed, message, worlds, start):
    arguments = {"policy": lambda state, key: {"move": jnp.zeros((2, 3))}, "n_steps": 1} | changed
    with pytest.raises(ValueError) as error:  # noqa: PT011
        worlds.rollout(start, **arguments)
    assert message in str(error.value)


DEVICES = {
    "none": (dict(devices=0), "devices: got 0; takes None, 'all', or a number from 1 to 1"),
    "too many": (dict(devices=2), "devices: got 2; takes None, 'all', or a number from 1 to 1, as JAX has 1"),
    "text": (dict(devices="some"), "devices: got 'some'; takes None, 'all', a number"),
    "list": (dict(devices=[0]), "takes None, 'all', a number, or a list of different jax.Device"),
    "method": (dict(method="vmap"), "It takes one of ['jit', 'pmap', 'shard_map']"),
}


@pytest.mark.parametrize(("options", "message"), DEVICES.values(), ids=DEVICES)
def test_devices_that_there_are_not(options, message, env):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        maax.Worlds(env, 4, **options)
    assert message in str(error.value)


def test_several_devices_on_c_need_threads(env, monkeypatch):
    monkeypatch.setenv("NPROC", "3")
    with pytest.raises(ValueError, match=r"devices: got 2 with impl='c', which needs 8 threads .* NPROC=8"):
        env.engine.check_devices(2)
    monkeypatch.setenv("NPROC", "8")
    env.engine.check_devices(2)


@pytest.mark.parametrize(
    ("version", "n", "older"), [((0, 11, 2), 2, True), ((0, 11, 2), 1, False), ((0, 12, 0), 2, False)]
)
def test_the_partitioner_that_does_not_crash(version, n, older, monkeypatch):
    """`docs/upstream/shard_map.md`; where jaxlib is 0.11, the tests of several devices crash without it."""
    changed = {}
    monkeypatch.setattr(jax, "__version_info__", version)
    monkeypatch.setattr(type(jax.config), "update", lambda config, name, value: changed.update({name: value}))
    monkeypatch.setattr(shards, "_select", lambda devices: tuple(jax.devices()) * devices)
    shards.Shards(4, n, None if n == 1 else "pmap")
    assert changed == ({"jax_use_shardy_partitioner": False} if older else {})


@pytest.mark.parametrize(
    ("impl", "told"),
    [
        ("jax", "RESOURCE_EXHAUSTED: Out of memory while trying to allocate 9 bytes."),
        ("warp", "UNKNOWN: FFI callback error: RuntimeError: Failed to allocate 9 bytes."),
    ],
)
@pytest.mark.parametrize("late", [False, True], ids=["called", "ran"])
def test_too_much_for_the_memory(env, start, monkeypatch, impl, told, late):
    """Accelerators run what they are called for later, and raise in what waits for it."""
    worlds = maax.Worlds(env, N, donate=False)

    class Promised:
        def block_until_ready(self):
            raise jax.errors.JaxRuntimeError(f"{told}\nmore")

    def fails(*_):
        return Promised() if late else Promised().block_until_ready()

    monkeypatch.setattr(worlds, "_step", fails)
    monkeypatch.setattr(type(env.engine), "impl", impl)
    with pytest.raises(MemoryError, match=r"6 worlds do not fit .* take fewer \(n_worlds\).*9 bytes\.\)$") as refused:
        worlds.step(start, worlds.sample_action(seeds.key(0)))
    assert ("MEM_FRACTION" in str(refused.value)) == (impl == "warp")


@pytest.mark.slow
def test_a_restored_run_goes_on_bit_for_bit(worlds, start, rolled, tmp_path):
    states, others = rolled[0], {"params": {"w": jnp.arange(3.0)}, "key": seeds.key(5), "n": jnp.asarray(7)}
    checkpoints = maax.Checkpoints(tmp_path / "run", keep=2)
    assert checkpoints.latest is None
    with pytest.raises(FileNotFoundError, match="has no saves yet"):
        checkpoints.restore(worlds)
    for number in (1, 2):
        checkpoints.save(number, worlds, start)
    checkpoints.save(5, worlds, states, **others)
    again = maax.Checkpoints(tmp_path / "run")
    assert again.latest == 5
    restored, found = again.restore(worlds, **jax.tree.map(jnp.zeros_like, others | {"key": seeds.key(0)}))
    assert_same(restored, states)
    assert_same(found, others)
    after = [worlds.rollout(s, policy, T, jnp.float32(1.0), key=seeds.key(1))[0] for s in (states, restored)]
    assert_same(*after)
    assert_same(again.restore(worlds, 2)[0], start)
    with pytest.raises(FileNotFoundError, match=r"number: got 1, and .* has the saves \[2, 5\]"):
        again.restore(worlds, 1)
    with pytest.raises(ValueError, match="number: got 5; takes one greater than that of the latest save, 5"):
        again.save(5, worlds, states)


def test_a_save_of_other_worlds_is_refused(worlds, start, tmp_path, monkeypatch):
    checkpoints = maax.Checkpoints(tmp_path)
    checkpoints.save(0, worlds, start)
    assert checkpoints.fits(worlds)
    assert not checkpoints.fits(maax.Worlds(worlds.env, 3))
    with pytest.raises(ValueError, match=r"worlds: got 3, and .* has 6; takes as many as were saved, or resize=True"):
        checkpoints.restore(maax.Worlds(worlds.env, 3))
    other = maax.make("standard", impl="c", n_hiders=1, n_seekers=1, n_boxes=2)
    assert not checkpoints.fits(maax.Worlds(other, N))
    with pytest.raises(
        ValueError, match=r"has worlds of another environment, env\.horizon=4, not .*takes worlds of the"
    ):
        checkpoints.restore(maax.Worlds(other, N))
    other.made = None  # an environment that is no game
    with pytest.raises(
        ValueError, match=r"another environment, game=standard, not one's own; takes worlds of the same"
    ):
        checkpoints.restore(maax.Worlds(other, N))
    monkeypatch.setattr("maax_mjx.parallel.checkpoint.difference", lambda *_, **__: "")
    with pytest.raises(ValueError, match=r"has .* of shape .*, these worlds .* takes worlds of the same environment"):
        checkpoints.restore(maax.Worlds(other, N))


def test_a_save_says_what_it_is_of(worlds, start, tmp_path):
    checkpoints = maax.Checkpoints(tmp_path)
    checkpoints.save(0, worlds, start)
    about = maax.Checkpoints(tmp_path).about()
    assert about.pop("defaults")["floor_size"] == maax.config_of("standard").floor_size
    assert about == {
        "game": "standard",
        "config": {"impl": "c", "scenario": "empty", "n_hiders": 1, "n_seekers": 1, "n_ramps": 0, "horizon": HORIZON},
        "layers": [],
        "n_worlds": N,
        "engine": "c",
    }
    assert maax.config_of(maax.make(about["game"], **about["config"])) == maax.config_of(worlds.env)


def test_a_save_without_worlds(worlds, start, tmp_path):
    checkpoints = maax.Checkpoints(tmp_path)
    checkpoints.save(3, params={"w": jnp.arange(4.0)})
    states, others = checkpoints.restore(params={"w": jnp.zeros(4)})
    assert states is None
    assert_same(others["params"], {"w": jnp.arange(4.0)})
    assert checkpoints.about() == {}
    assert checkpoints.fits(params={"w": jnp.zeros(4)})
    assert not checkpoints.fits(params={"w": jnp.zeros(5)})
    assert not checkpoints.fits(params={"w": jnp.zeros(4), "b": jnp.zeros(4)})
    assert not checkpoints.fits(weights={"w": jnp.zeros(4)})
    assert not checkpoints.fits(worlds, params={"w": jnp.zeros(4)})
    with pytest.raises(ValueError, match=r"worlds: got some, and save 3 of .* has none; takes None"):
        checkpoints.restore(worlds)
    with pytest.raises(ValueError, match="others: got nothing to save; takes states"):
        checkpoints.save(4)
    with pytest.raises(ValueError, match="states: got worlds or states alone; takes both"):
        checkpoints.save(4, worlds)
    with pytest.raises(ValueError, match="others: got nothing to read"):
        checkpoints.restore()
    with pytest.raises(ValueError, match="others: got the name 'about'; takes others than"):
        checkpoints.save(4, worlds, start, about={"w": jnp.zeros(1)})
    with pytest.raises(ValueError, match="others: got 'fast' at 'mode' of 'params'; takes arrays"):
        checkpoints.save(4, params={"mode": "fast"})
    with pytest.raises(ValueError, match=r"worlds: got 3; takes maax\.Worlds"):
        checkpoints.save(4, 3, start)
    with pytest.raises(ValueError, match="states: got State; takes the WorldsState of 6 worlds"):
        checkpoints.save(4, worlds, worlds.env.state_shape)


@pytest.mark.slow
@pytest.mark.parametrize("n", [4, 8])
def test_a_save_goes_on_with_more_or_fewer_worlds(worlds, start, rolled, tmp_path, n):
    checkpoints = maax.Checkpoints(tmp_path)
    checkpoints.save(0, worlds, rolled[0])
    resized = maax.Worlds(worlds.env, n, donate=False)
    states, _ = checkpoints.restore(resized, resize=True)
    kept = min(n, N)
    assert_same(*(jax.tree.map(lambda x: x[:kept], host(x)) for x in (states, rolled[0])))
    assert (np.asarray(states.step)[kept:] == 0).all()
    keys = {tuple(row) for row in np.asarray(jax.random.key_data(states.seed))}
    assert len(keys) == n, "every world has draws of its own"
    if n < N:
        return
    after, before = (
        w.step(s, {"move": np.ones((w.n_worlds, 2, 3), np.float32)})
        for w, s in ((resized, states), (worlds, rolled[0]))
    )
    assert_same(after.data.qpos[:kept], before.data.qpos[:kept])


@pytest.mark.usefixtures("little_garbage")
def test_a_damaged_save_is_refused_in_one_sentence(worlds, start, tmp_path, capfd, caplog, recwarn):
    """Each file in turn is noise, cut off and missing: the save loads all the same, or a sentence is all there is."""
    folder, bad = tmp_path / "good", tmp_path / "bad"
    maax.Checkpoints(folder).save(3, worlds, start, runs=np.ones(3))
    files = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    # The rest is not read again.
    files = [file for file in files if "ocdbt.process_0" not in file.parts and file.name != "commit_success.txt"]
    rng, refused = seeds.rng(0), 0
    capfd.readouterr()
    caplog.clear()
    shutil.copytree(folder, bad)
    for file in files:
        data = (bad / file).read_bytes()
        for damage in (rng.bytes(len(data)), data[: len(data) // 2], None):
            (bad / file).unlink() if damage is None else (bad / file).write_bytes(damage)
            try:
                maax.Checkpoints(bad).restore(worlds, runs=np.zeros(3))
            except ValueError as error:
                refused += 1
                assert str(error).startswith(f"number: got 3 of {bad}, which is damaged")  # noqa: PT017
                assert str(error).endswith("there is no other save in it")  # noqa: PT017
                assert error.__context__ is None  # noqa: PT017
            (bad / file).write_bytes(data)
    maax.Checkpoints(bad).restore(worlds, runs=np.zeros(3))
    gc.collect()
    # All but the checksums when they are missing, as in saves of earlier versions.
    assert refused > 2 * len(files)
    (bad / ".3.sums").write_text("[]")
    with pytest.raises(ValueError, match=r"damaged \(.3.sums is not as it was written\)"):
        maax.Checkpoints(bad).restore(worlds, runs=np.zeros(3))
    assert capfd.readouterr() == ("", "")
    assert not caplog.records
    assert not [str(w.message) for w in recwarn if "never awaited" in str(w.message)]
    with pytest.raises(ValueError, match=r"others: got \['params'\], which are not in save 3"):
        maax.Checkpoints(folder).restore(worlds, params=np.zeros(3))


def test_empty_arrays_and_keys_come_back(tmp_path):
    """Networks without a memory have one of no numbers, which Orbax does not take."""
    tree = {"memory": np.zeros((3, 0), np.float32), "key": jax.random.key(1), "n": np.arange(2)}
    saves = maax.Checkpoints(tmp_path)
    saves.save(1, learner=tree)
    _, found = saves.restore(learner=jax.tree.map(lambda x: x, tree))
    back = found["learner"]
    assert (back["memory"].shape, back["memory"].dtype) == ((3, 0), np.float32)
    assert (jax.random.key_data(back["key"]) == jax.random.key_data(tree["key"])).all()
    np.testing.assert_array_equal(back["n"], [0, 1])


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        (
            {"w": np.zeros((3, 3)), "n": [np.ones(4), 2]},
            r"got 'net' with w of shape \(3, 3\), and save 1 .* has \(3, 2\)",
        ),
        ({"w": np.zeros((3, 2))}, r"got 'net' with n.0 of shape none, and save 1 .* has \(4,\)"),
        ({"w": np.zeros((3, 2)), "n": [np.ones(4), 2], "b": 1}, r"with b of shape \(\), and save 1 .* has none"),
        (np.zeros(2), r"got 'net' with shape \(2,\), and save 1 .* has none; takes a tree like the one"),
        ({"w": np.zeros((3, 2), int), "n": [np.ones(4), 2]}, r"with w of whole numbers, and save 1 .* has floats"),
        ({"w": np.zeros((3, 2)), "n": [np.ones(4, bool), 2]}, r"with n.0 of booleans, and save 1 .* has floats"),
    ],
)
def test_trees_of_other_shapes_are_named(tree, said, tmp_path):
    saves = maax.Checkpoints(tmp_path)
    saves.save(1, net={"w": np.zeros((3, 2)), "n": [np.ones(4), 2]})
    with pytest.raises(ValueError, match=said):
        saves.restore(net=tree)
    with pytest.raises(ValueError, match="folder: got 3; takes a path"):
        maax.Checkpoints(3)


@pytest.mark.usefixtures("little_garbage")
def test_reads_that_fail_side_by_side_are_not_logged(worlds, start, tmp_path, monkeypatch, caplog):
    """Which of a damaged save's arrays fail after the first depends on the threads; asyncio logs them as they go."""

    async def fail():
        raise OSError("no such file")

    async def fail_all():
        others = [asyncio.ensure_future(fail()) for _ in range(2)]
        await asyncio.sleep(0.01)
        assert all(task.done() for task in others)
        await fail()

    checkpoints = maax.Checkpoints(tmp_path)
    checkpoints.save(1, worlds, start)
    monkeypatch.setattr(checkpoints._manager, "restore", lambda *_, **__: asyncio.run(fail_all()))
    with pytest.raises(ValueError, match=r"damaged.*no such file"):
        checkpoints.restore(worlds)
    gc.collect()
    assert not caplog.records


@pytest.mark.slow
@pytest.mark.usefixtures("made_once")
def test_a_killed_run_loses_its_last_interval_at_most(tmp_path):
    """The soak, killed in the middle and begun again in this process, comes to the same as one that was left alone."""

    def options(name, steps):
        here = {"folder": tmp_path / name, "out": tmp_path / f"{name}.json"}
        return {"env": "standard", "impl": "c", "worlds": 4, "chunk": 10, "every": 1, "physics_steps": 4 * steps} | here

    def row(name):
        return json.loads((tmp_path / f"{name}.json").read_text())["rows"][0]

    words = [f"--{name.replace('_', '-')}={value}" for name, value in options("killed", 10**6).items()]
    command = [sys.executable, "-m", "maax_mjx.benchmarks.soak", *words]
    killed = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    until = time.monotonic() + 300
    while not (tmp_path / "killed.json").exists() or row("killed")["env_steps"] < 4 * 20:
        assert killed.poll() is None, killed.stdout.read()
        assert time.monotonic() < until
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    saved = max(int(path.name) for path in (tmp_path / "killed").iterdir() if path.name.isdigit())
    assert saved >= row("killed")["env_steps"] // 4, "what was told was saved"
    for name in ("killed", "alone"):
        soak.main(soak.Config(**options(name, saved + 10)))
    assert row("killed")["env_steps"] == row("alone")["env_steps"] == 4 * (saved + 10)
    assert row("killed")["runs"] == 2
    worlds = maax.Worlds(maax.make("standard", impl="c"), 4)
    ends = [maax.Checkpoints(tmp_path / name).restore(worlds)[0] for name in ("alone", "killed")]
    assert_same(*ends)
