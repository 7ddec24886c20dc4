"""Masks, blind preparation and statistics, against plain NumPy over recorded states."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.handled import handled

import maax_mjx as maax

N_WORLDS, N_STEPS, HORIZON, PREP, SEEKERS = 24, 60, 100, 12, [2, 3]
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


class Given(maax.Wrapper):
    """Starts from one of given states, by its key; so that only one reset is compiled."""

    def __init__(self, env, states):
        super().__init__(env)
        self.states = states

    def begin(self, key, params):
        return jax.tree.map(lambda x: x[jax.random.key_data(key)[-1]], self.states)


@pytest.fixture(scope="module")
def sensing():
    """1 or 2 hiders, up to 2 seekers, 1 or 2 boxes and a ramp on an open floor, with all that can be told of them."""
    env = maax.Base(4, impl="c", n_frames=5, horizon=HORIZON)
    env.add_module(maax.Agents({"hiders": (1, 2), "seekers": (0, 2)}))
    env.add_module(maax.Boxes((1, 2)))
    env.add_module(maax.Ramps((0, 1)))
    env = maax.AgentAgentContactMask2D(maax.TeamMembership(env), 0.7)
    return maax.LockObjects(maax.Lidar(maax.LineOfSight(env), 5), lock_type="any", radius=0.5)


@pytest.fixture(scope="module")
def start(sensing):
    """Worlds with agents around a box, close to each other."""
    states = jax.jit(jax.vmap(sensing.reset))(jax.random.split(seeds.key(0), N_WORLDS))
    qpos = np.array(states.data.qpos)
    spots = {
        "agent": [[2.5, 2.5], [3.5, 3.5], [2.5, 3.5], [3.5, 2.5]],
        "box": [[3.0, 3.0], [4.2, 3.0]],
        "ramp": [[3.0, 3.8]],
    }
    rng = seeds.rng(0)
    for name, xy in spots.items():
        module = sensing.base.modules[name]
        there = np.asarray(states.world.active[module.kind])
        qpos[:, module.qpos_ids[:, :2]] = np.where(
            there[..., None], xy + rng.uniform(-0.05, 0.05, (N_WORLDS, len(xy), 2)), qpos[:, module.qpos_ids[:, :2]]
        )
        qpos[:, module.qpos_ids[:, 3]] = rng.uniform(-np.pi, np.pi, there.shape) * (name == "agent")
    pose = jax.jit(jax.vmap(sensing.base.engine.pose))
    return states.replace(data=pose(states.world.fields, states.data.replace(qpos=jnp.asarray(qpos))))


def play(env):
    """The states of an episode under forces that change every 6 steps, locking the boxes at times, from reset on."""
    step = jax.jit(jax.vmap(env.step))
    states = [jax.jit(jax.vmap(env.reset))(jax.vmap(jax.random.key)(jnp.arange(N_WORLDS)))]
    rng, moves = seeds.rng(1), []
    for t in range(N_STEPS + 1):
        if t % 6 == 0:
            move = (rng.choice([-1.0, 0.0, 1.0], (N_WORLDS, 4, 3)) * [0.4, 0.4, 0.1]).astype(np.float32)
            lock = rng.random((N_WORLDS, 4, 3)) < 0.2
        moves.append(move)
        states.append(step(states[-1], {"move": jnp.asarray(move), "lock": jnp.asarray(lock)}))
    keep = [
        {"obs": s.obs, "metrics": s.metrics, "mechanics": s.mechanics, "qpos": s.data.qpos, "ctrl": s.data.ctrl}
        for s in states[:-1]
    ]
    return jax.tree.map(lambda *x: np.stack(x), *jax.device_get(keep)) | {"move": np.stack(moves)}


@pytest.fixture(scope="module")
def blind(sensing, start):
    """What happens in a game whose seekers are blind in the preparation phase, with statistics."""
    env = maax.PreparationPhase(Given(sensing, start), PREP / HORIZON, blind=True)
    assert env.n_steps == PREP
    return play(maax.TrackStats(env))


@pytest.fixture(scope="module")
def seeing(sensing, start):
    """The same without a phase, where masks keep seekers from acting for as long."""

    def mask(state):
        return jnp.array([True, True, state.step >= PREP, state.step >= PREP])

    env = maax.TrackStats(Given(sensing, start))
    return play(maax.MaskActions(maax.MaskActions(env, "move", mask), "lock", mask))


def test_shares_of_an_episode_that_began_later_are_of_its_own_steps():
    """With staggered ends; counted from the rewards, which are 1 for hiders who are not seen and -1 for seen ones."""
    env = maax.make(
        "hide_and_seek_quadrant", impl="c", horizon=30, prep_fraction=0.4, rect=None, n_frames=10, tools=True
    )
    worlds = maax.Worlds(env, 10)
    keep = ("reward", "truncated", "metrics.caught", "metrics.seen")
    states = worlds.reset(seeds.key(2), stagger=True)
    begun = np.asarray(states.step)
    _, kept = worlds.rollout(states, lambda state, key: env.sample_action(key), 30, key=seeds.key(3), keep=keep)
    reward, ended, caught, seen = (np.asarray(kept[name]) for name in keep)
    shares = []
    for world, step in enumerate(begun):
        last = int(ended[:, world].argmax())
        played = np.arange(step + 1, step + last + 2) > 12
        shares.append((reward[: last + 1, world, 0] < 0)[played].mean())
        close([caught[last, world], seen[last, world]], shares[-1], atol=1e-6)
    assert len(set(shares)) > 2


# --- senses and preparation ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_blind_seekers(blind, seeing):
    """Nothing of what they sense is left before step `PREP`, and all of it from then on; hiders sense as ever."""
    some = 0
    for key in ("sees_agent", "sees_box", "sees_ramp", "lidar"):
        want = seeing["obs"][key].copy()
        some += int(want[:PREP, :, SEEKERS].any()) + int(want[PREP:, :, SEEKERS].any())
        want[:PREP, :, SEEKERS] = 0
        equal(blind["obs"][key], want)
        if key != "lidar":
            equal(blind["mechanics"]["line_of_sight"][key], want)
    assert some == 8
    for key in set(seeing["obs"]) - {"sees_agent", "sees_box", "sees_ramp", "lidar"}:
        equal(blind["obs"][key], seeing["obs"][key])
    equal(blind["qpos"], seeing["qpos"])


# --- statistics ----------------------------------------------------------------------------------------------------


def stats_oracle(env, told, start, prep_steps):
    """By name (t, n_worlds, ...), from the positions, locks and contacts at every time."""
    out, n_times = {}, N_STEPS + 1
    active = {kind: np.asarray(there) for kind, there in start.world.active.items()}
    locked = told["locked"] if "locked" in told else handled(told["obs"])["obj_lock"][..., 0] > 0
    modules = env.base.modules
    for kind, name, locks in (("box", "boxes", locked[..., :2]), ("ramp", "ramps", locked[..., 2:])):
        xy = told["qpos"][:, :, modules[kind].qpos_ids[:, :2]]
        way = np.sqrt(((xy - xy[0]) ** 2).sum(axis=-1))
        out[f"max_{kind}_move"] = np.max(way * active[kind], axis=-1)
        out[f"{name}_locked"] = np.sum(locks, axis=-1)
    for name, values in list(out.items()) if prep_steps is not None else ():
        at_end = [np.zeros_like(values[0]) if t < prep_steps else values[prep_steps] for t in range(n_times)]
        out[f"{name}_prep"] = np.stack(at_end)
    xy = told["qpos"][:, :, modules["agent"].qpos_ids[:, :2]]
    run, catches = np.zeros((n_times, N_WORLDS, 4)), np.zeros((n_times, N_WORLDS), int)
    for t in range(1, n_times):
        run[t] = run[t - 1] + np.sqrt(((xy[t] - xy[t - 1]) ** 2).sum(axis=-1)) * active["agent"]
        now, before = told["obs"]["contact_mask"][t], told["obs"]["contact_mask"][t - 1]
        new = [now[:, s, h] & ~before[:, s, h] for s in SEEKERS for h in (0, 1)]
        catches[t] = catches[t - 1] + (np.sum(new, axis=0) if t > (prep_steps or 0) else 0)
    return out | {"distance_run": run, "catches": catches}


def check_stats(env, told, start, prep_steps):
    want = stats_oracle(env, told, start, prep_steps)
    assert set(told["metrics"]) == set(want) | {"physics_fault", "layout_invalid", "contact_overflow"}
    for name, values in want.items():
        assert told["metrics"][name].shape == values.shape, name
        close(told["metrics"][name], values, atol=2e-4, err_msg=name)
    for name in ("catches", "boxes_locked", "ramps_locked"):
        assert told["metrics"][name].dtype == np.int32
    return want


@pytest.mark.slow
def test_stats_of_games(sensing, blind, seeing, start):
    """At every step, with a preparation phase and without."""
    for told, prep_steps in ((blind, PREP), (seeing, None)):
        want = check_stats(sensing, told, start, prep_steps)
        for name in ("max_box_move", "max_ramp_move", "boxes_locked", "distance_run", "catches"):
            assert want[name].any(), name
        assert not told["metrics"]["physics_fault"].any()
    assert (seeing["metrics"]["catches"][-1] > blind["metrics"]["catches"][-1]).any()


@pytest.mark.parametrize("prep_steps", [PREP, None])
def test_stats_of_anything(prep_steps, sensing, start):
    """Of everything moving anywhere and back, absent things too, in contact and locked at random."""
    env = Given(sensing, start)
    env = maax.TrackStats(env if prep_steps is None else maax.PreparationPhase(env, PREP / HORIZON))
    look, rng = jax.jit(jax.vmap(env.observe)), seeds.rng(5)
    state = jax.jit(jax.vmap(env.reset))(jax.vmap(jax.random.key)(jnp.arange(N_WORLDS)))
    there = {kind: np.asarray(x) for kind, x in start.world.active.items()}
    both = there["agent"][:, :, None] & there["agent"][:, None]
    lockable = np.concatenate([there["box"], there["ramp"]], axis=1)
    contact, locked = np.asarray(start.obs["contact_mask"]), np.zeros(lockable.shape, bool)
    seen = []
    for t in range(N_STEPS + 1):
        if t:
            qpos = start.data.qpos + jnp.asarray(rng.uniform(-1, 1, start.data.qpos.shape), jnp.float32)
            contact = (rng.random((N_WORLDS, 4, 4)) < 0.2) & both
            contact |= contact.transpose(0, 2, 1)
            locked = (rng.random(lockable.shape) < 0.4) & lockable
            locks = state.mechanics["locks"].replace(locked=jnp.asarray(locked))
            mechanics = state.mechanics | {"contact": jnp.asarray(contact), "locks": locks}
            state = look(
                state.replace(
                    data=state.data.replace(qpos=qpos), mechanics=mechanics, step=jnp.full(N_WORLDS, t, jnp.int32)
                )
            )
        obs = {"contact_mask": contact}
        seen.append({"qpos": state.data.qpos, "obs": obs, "locked": locked, "metrics": state.metrics})
    told = jax.tree.map(lambda *x: np.stack(x), *jax.device_get(seen))
    want = check_stats(sensing, told, start, prep_steps)
    assert all(values[-1].any() for values in want.values())
    assert (want["catches"][-1] > 3).any()
    assert (want["max_box_move"].max(axis=0) > want["max_box_move"][-1] + 0.1).any(), "it is how far now"


# --- masks of actions ----------------------------------------------------------------------------------------------


def test_masked_actions_do_not_reach_the_world(sensing, blind, seeing, start):
    """What the motors are told at each step is what the mask of the state before it allows."""
    there = np.asarray(start.world.active["agent"])[:, :, None]
    want = seeing["move"][:-1] * there
    assert want[:PREP, :, SEEKERS].any()
    want[:PREP, :, SEEKERS] = 0
    equal(seeing["ctrl"][1:][:, :, sensing.base.agents.ctrl_ids], want)
    equal(blind["ctrl"], seeing["ctrl"])


def test_mask_actions(sensing, start):
    """By what was seen, object by object, and by a function of the state, agent by agent."""
    env, rng = Given(sensing, start), seeds.rng(2)
    seen = {"sees_box": rng.random((4, 2)) < 0.5, "sees_ramp": rng.random((4, 1)) < 0.5}
    state = maax.world_of(start, 0)
    sight = state.mechanics["line_of_sight"] | seen
    state = state.replace(mechanics=state.mechanics | {"line_of_sight": sight}, step=np.int32(2))
    action = {"move": rng.uniform(-1, 1, (4, 3)).astype(np.float32), "lock": rng.integers(0, 2, (4, 3), np.int8)}

    by_sight = maax.MaskActions(env, "lock", ["sees_box", "sees_ramp"]).action(state, action)
    equal(by_sight["lock"], action["lock"] * np.concatenate([seen["sees_box"], seen["sees_ramp"]], axis=1))
    equal(by_sight["move"], action["move"])
    other = maax.MaskActions(env, "lock", ["sees_ramp", "sees_box"]).action(state, action)
    equal(other["lock"], action["lock"] * np.concatenate([seen["sees_ramp"], seen["sees_box"]], axis=1))
    by_agent = maax.MaskActions(env, "move", lambda s: jnp.arange(4) < s.step).action(state, action)
    equal(by_agent["move"], action["move"] * [[1], [1], [0], [0]])
    equal(by_agent["lock"], action["lock"])
    by_part = maax.MaskActions(env, "move", lambda s: jnp.arange(12).reshape(4, 3) % s.step == 0)
    equal(by_part.action(state, action)["move"], action["move"] * (np.arange(12).reshape(4, 3) % 2 == 0))
    assert by_part.action_space == env.action_space


def test_mask_unseen_action(sensing, start):
    """Every way in which 2 hiders and 2 seekers see each other; seekers that see seekers do not count."""
    state = maax.world_of(start, 0)
    rng = seeds.rng(3)
    action = {"move": np.ones((4, 3), np.float32), "lock": np.ones((4, 3), np.int8)}
    envs = [maax.MaskUnseenAction(sensing, "lock"), maax.MaskUnseenAction(sensing, "lock", team=1)]
    for case in range(16):
        sees = rng.random((4, 4)) < 0.5
        sees[2:, :2] = [[case & 1, case & 2], [case & 4, case & 8]]
        sight = state.mechanics["line_of_sight"] | {"sees_agent": jnp.asarray(sees)}
        here = state.replace(mechanics=state.mechanics | {"line_of_sight": sight})
        for team, env in enumerate(envs):
            told = env.action(here, action)
            equal(told["lock"], [[0 if case and i // 2 == team else 1] * 3 for i in range(4)])
            equal(told["move"], action["move"])


# --- observations --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def split(sensing):
    return maax.SplitObservations(sensing)


@pytest.fixture(scope="module")
def told(split, start):
    """The split observations, with random masks of what is seen."""
    states = jax.jit(jax.vmap(split.observe))(start)
    rng = seeds.rng(4)
    masks = {k: rng.random(states.obs[k].shape) < 0.5 for k in ("sees_agent", "sees_box", "sees_ramp")}
    return states.replace(obs=states.obs | masks)


def test_mask_observations(split, told):
    masks = {"box_obs": "sees_box", "agent_qpos_qvel": "sees_agent", "agent_team": "sees_agent"}
    obs = jax.device_get(jax.jit(jax.vmap(maax.MaskObservations(split, masks).observe))(told).obs)
    before = jax.device_get(told.obs)
    assert set(obs) == set(before)
    for key, x in before.items():
        want = x.copy()
        if key in masks:
            assert x[before[masks[key]]].any()
            for w, i, k in zip(*np.nonzero(~before[masks[key]]), strict=True):
                want[w, i, k] = 0
        equal(obs[key], want)


def test_masks_are_those_that_are_declared(split):
    assert maax.MaskObservations(split).masks == {
        "box_obs": "sees_box", "ramp_obs": "sees_ramp", "agent_qpos_qvel": "sees_agent", "agent_team": "sees_agent",
    }  # fmt: skip


# --- mistakes ------------------------------------------------------------------------------------------------------

ERRORS = {
    "action": (
        lambda e, s: maax.MaskActions(e, "grab", lambda s: s.step),
        "action: got 'grab'; takes one of ['lock', 'move']",
    ),
    "mask name": (lambda e, s: maax.MaskActions(e, "lock", ["sees_boxes"]), "mask: got 'sees_boxes'; did you mean"),
    "mask too short": (
        lambda e, s: maax.MaskActions(e, "lock", ["sees_box"]),
        "mask: has shape (4, 2); takes (4,) or (4, 3), as action 'lock'",
    ),
    "mask of one": (lambda e, s: maax.MaskActions(e, "move", lambda s: s.step > 1), "mask: has shape (); takes (4,)"),
    "mask without sight": (
        lambda e, s: maax.MaskActions(maax.make("standard", impl="c"), "move", ["sees_agent"]),
        "MaskActions: needs LineOfSight",
    ),
    "mask after bins": (
        lambda e, s: maax.MaskActions(maax.DiscretizeActions(e), "move", lambda s: s.step),
        "MaskActions: env has DiscretizeActions already; wrap with MaskActions before it",
    ),
    "unseen action": (lambda e, s: maax.MaskUnseenAction(e, "pull"), "action: got 'pull'; takes one of"),
    "unseen team": (
        lambda e, s: maax.MaskUnseenAction(e, "move", 2),
        "team: got 2; takes one of ['hiders', 'seekers'], or its number",
    ),
    "unseen without teams": (
        lambda e, s: maax.MaskUnseenAction(maax.make("standard", impl="c"), "move"),
        "MaskUnseenAction: needs TeamMembership",
    ),
    "unseen without sight": (
        lambda e, s: maax.MaskUnseenAction(maax.TeamMembership(maax.make("standard", impl="c")), "move"),
        "MaskUnseenAction: needs LineOfSight",
    ),
    "unseen after bins": (
        lambda e, s: maax.MaskUnseenAction(maax.DiscretizeActions(e), "move"),
        "MaskUnseenAction: env has DiscretizeActions already",
    ),
    "masked observation": (
        lambda e, s: maax.MaskObservations(s, {"boxes_obs": "sees_box"}),
        "masks: got 'boxes_obs'; did you mean 'box_obs'",
    ),
    "masked by": (
        lambda e, s: maax.MaskObservations(s, {"box_obs": "sees_boxes"}),
        "masks: got 'sees_boxes'; did you mean 'sees_box'",
    ),
    "masked by others": (
        lambda e, s: maax.MaskObservations(s, {"box_obs": "sees_agent"}),
        "masks: 'sees_agent' has shape (4, 3); takes (4, 2) for 'box_obs'",
    ),
    "blind without senses": (
        lambda e, s: maax.PreparationPhase(maax.TeamMembership(maax.make("standard", impl="c")), blind=True),
        "blind: got True without a sense inside; takes LineOfSight or Lidar inside",
    ),
    "blind to what is hidden": (
        lambda e, s: maax.PreparationPhase(maax.SelectObservations(e, ["sees_agent", "sees_box"]), blind=True),
        "blind: 'lidar' of Lidar is not observed any more; put what blinds inside what hid it",
    ),
    "blind to what others sense": (
        lambda e, s: maax.PreparationPhase(maax.SplitObservations(e), blind=True),
        "blind: 'sees_agent' of LineOfSight has shape (4, 3), and had (4, 4); put what blinds inside what changed it",
    ),
    "blind": (lambda e, s: maax.PreparationPhase(e, blind=1), "blind: got 1; takes True or False"),
    "stats twice": (
        lambda e, s: maax.TrackStats(maax.TrackStats(e)),
        "TrackStats: env has a wrapper named 'stats' already; takes one of each",
    ),
}


@pytest.mark.parametrize(("call", "message"), ERRORS.values(), ids=ERRORS)
def test_mistakes(call, message, sensing, split):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(sensing, split)
    assert message in str(error.value)


@pytest.mark.slow
def test_caught_is_the_share_of_steps_in_which_seekers_are_paid():
    few = {"scenario": "empty", "n_boxes": 0, "n_ramps": 0, "horizon": 20, "prep_fraction": 0.25, "lock": None}
    rule = {"by": "vision", "cone": 2.0, "rew_type": "team_zero_sum"}
    env = maax.make("hide_and_seek", impl="c", **few, **rule)
    worlds = maax.Worlds(env, 16)

    def policy(state, key):
        return env.sample_action(key)

    keep = ("reward", "metrics.caught", "truncated")
    _, kept = worlds.rollout(worlds.reset(seeds.key(0)), policy, 20, keep=keep)
    paid = np.asarray(kept["reward"])[..., env.teams["seekers"].slots[0]] > 0
    assert np.asarray(kept["truncated"])[-1].all()
    assert not paid[:5].any()
    assert not np.asarray(kept["metrics.caught"])[:5].any()
    np.testing.assert_allclose(kept["metrics.caught"][-1], paid[5:].mean(axis=0), atol=1e-6)
    assert 0 < paid[5:].mean() < 1


def test_padding_hides_what_was_hidden():
    """Masks are padded along; where there is none of what is in play, padding gets one."""
    env = maax.make("hide_and_seek_quadrant", impl="c", observations="split", n_boxes=2, n_ramps=0, horizon=20)
    padded = maax.SpoofEntities(env, 4, ["box_obs"])
    assert set(padded.mask_keys) == {"box_mask", "sees_box"}
    one = padded.observed["box_obs"]
    assert (one.present, one.seen) == ("box_mask", "sees_box")
    with pytest.raises(ValueError, match=r"mask_keys: got \['box_mask'\]; takes 'sees_box', of these keys, as well"):
        maax.SpoofEntities(env, 4, ["box_obs"], ["box_mask"])
    flat, whole = maax.FlattenObservations(padded), maax.FlattenObservations(env)
    state = jax.jit(env.reset)(seeds.key(0))
    wide = flat.observe(padded.observe(state)).obs["obs"]
    narrow = whole.observe(state).obs["obs"]
    columns, known = flat.observed["obs"].names(), whole.observed["obs"].names()
    for name in known:
        np.testing.assert_array_equal(wide[:, columns.index(name)], narrow[:, known.index(name)])
    assert not wide[:, [i for i, name in enumerate(columns) if name.startswith(("box_obs[2]", "box_obs[3]"))]].any()


def test_padding_without_a_mask_gets_one():
    chosen = maax.SelectObservations(
        maax.make("tag", impl="c", observations="split", n_boxes=1, n_ramps=0, horizon=20),
        ["agent_qpos_qvel_self", "box_obs"],
    )

    class Unmasked(maax.ObservationWrapper):
        """As of a module that has no masks."""

        def observation(self, state):
            return state.obs

        def declared(self):
            table = self.env.declared()
            return table | {"box_obs": replace(table["box_obs"], present=None, seen=None)}

    padded = maax.SpoofEntities(Unmasked(chosen), 4, ["box_obs"])
    assert padded.observed["box_obs"].present == "box_obs_spoof"
    state = padded.reset(seeds.key(0))
    np.testing.assert_array_equal(state.obs["box_obs_spoof"], np.tile([True, False, False, False], (4, 1)))
    ego = maax.EgocentricObservations(padded)
    assert not ego.observe(state).obs["box_obs"][:, 1:].any()


def test_a_name_is_no_list_of_names():
    env = maax.make("tag", impl="c", observations="split", n_boxes=1, n_ramps=0)
    for wrap in (lambda: maax.SpoofEntities(env, 5, "box_obs"), lambda: maax.SelectObservations(env, "box_obs")):
        with pytest.raises(ValueError, match="observations: got 'box_obs'; takes a list of names"):
            wrap()


def test_vectors_are_made_once_and_masked_inside():
    env = maax.make("tag", impl="c", observations="split", n_boxes=1, n_ramps=0)
    flat = maax.FlattenObservations(env)
    with pytest.raises(ValueError, match="FlattenObservations: got an environment with one; takes it once"):
        maax.FlattenObservations(flat)
    with pytest.raises(ValueError, match="MaskObservations: env has FlattenObservations already; wrap with Mask"):
        maax.MaskObservations(flat)
