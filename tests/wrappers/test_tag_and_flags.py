"""Tag and capture the flag against plain Python written from their rules, and two games of flags in the real physics.

A `Script` stands in for the physics: its actions say where agents are and who touches whom after the step.
"""

from __future__ import annotations

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax

N, TEAM = 5, np.array([0, 0, 0, 1, 1])
WORLDS, STEPS = 64, 200
REACH, FLOOR = 0.4, 6.0
SCALE, WINS = 2.0, 8
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


@pytest.fixture(scope="module")
def game():
    """Up to three against two, first capture wins; no boxes."""
    return maax.make(
        "capture_the_flag", teams={"blues": (0, 3), "reds": (0, 2)}, n_boxes=0, wins_at=1, observations="raw", impl="c"
    )


@pytest.fixture(scope="module")
def touching(game):
    """What the rules are wrapped around."""
    return game.env


@pytest.fixture(scope="module")
def played(game):
    """Reset and step of the game, one against one."""
    params = game.default_params.replace(n_blues=1, n_reds=1)
    reset, step = maax.jitted(game)
    return reset(seeds.key(0), params), step


class Script(maax.Wrapper):
    """Worlds in which agents are, and touch, as the action says; players, bases and floors differ between them."""

    def __init__(self, env, start):
        super().__init__(env)
        self.start = start

    def begin(self, key, params):
        keys = jax.random.split(key, 5)
        active = jax.random.bernoulli(keys[0], 0.75, (N,))
        floor = jax.random.uniform(keys[1], (), minval=4.0, maxval=8.0)
        depth = jax.random.uniform(keys[2], (2,), minval=0.05, maxval=0.45) * floor
        y = jnp.array([depth[0], floor - depth[1]])
        y = jnp.where(jax.random.bernoulli(keys[3]), y, y[::-1])
        x = jax.random.uniform(keys[4], (2,), maxval=floor)
        world = self.start.world
        world = world.replace(
            active=world.active | {"agent": active},
            sites=world.sites | {"flag": jnp.stack([x, y, jnp.full(2, 0.01)], axis=1)},
            plan=world.plan.replace(floor_size=floor),
        )
        return self.start.replace(key=key, world=world, mechanics={"contact": jnp.zeros((N, N), bool)})

    def transition(self, state, action):
        agents = self.base.agents
        data = state.data.replace(
            xpos=state.data.xpos.at[agents.body_ids, :2].set(action["xy"]),
            qpos=state.data.qpos.at[agents.qpos_ids[:, :2]].set(action["xy"]),
        )
        mechanics = state.mechanics | {"contact": action["contact"]}
        return state.replace(
            data=data, mechanics=mechanics, reward=action["reward"], terminated=action["end"], step=state.step + 1
        )


def run(env, starts, actions):
    """The states after all steps, (worlds, steps, ...), of actions (worlds, steps, ...)."""
    keep = ("obs", "reward", "terminated", "metrics", "mechanics")

    def step(state, action):
        state = env.advance(state, action)  # without the check of the action
        return state, {name: getattr(state, name) for name in keep}

    states = jax.jit(jax.vmap(lambda state, acts: jax.lax.scan(step, state, acts)[1]))(starts, actions)
    return jax.tree.map(np.asarray, states)


def contacts(rng, active, p):
    """(worlds, STEPS, N, N) symmetric, among players."""
    mask = np.triu(rng.random((len(active), STEPS, N, N)) < p, 1)
    return (mask | mask.swapaxes(-1, -2)) & (active[:, None, :, None] & active[:, None, None, :])


def fits(counts, chances):
    """Whether counts are within 5 standard deviations of what independent draws give."""
    counts, chances = np.array(counts), np.array(chances)
    return (np.abs(counts - chances * counts.sum()) < 5 * np.sqrt(counts.sum() * chances * (1 - chances))).all()


# --- tag -------------------------------------------------------------------------------------------------------


class TagOracle:
    """Who is it, written from the rules. Draws are given and checked."""

    def __init__(self, it, immunity):
        self.it, self.immunity = it, immunity
        self.before, self.step_of_tag, self.t, self.tags = None, None, 0, 0

    def touched(self, contact):
        """Who can be tagged in this step."""
        self.t += 1
        immune = self.before is not None and self.t <= self.step_of_tag + self.immunity
        return [j for j in range(N) if contact[self.it][j] and not (immune and j == self.before)]

    def tag(self, who):
        self.before, self.it, self.step_of_tag = self.it, who, self.t
        self.tags += 1

    def reward(self, active):
        others = active.sum() - 1
        return np.array([(-1 if i == self.it else 1 / others) if active[i] else 0 for i in range(N)])


@pytest.mark.slow
@pytest.mark.parametrize("immunity", [0, 1, 7])
def test_tag(immunity, touching, played):
    """Random touches between random players: who is it, whose turn is not yet back, what it costs, who is drawn."""
    env = maax.Tag(Script(touching, played[0]), immunity, SCALE)
    starts = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(immunity), WORLDS))
    active = np.asarray(starts.world.active["agent"])
    rng = seeds.rng(immunity)
    mask = contacts(rng, active, 0.5)
    inner = rng.normal(size=(WORLDS, STEPS, N)).astype(np.float32)
    flags = np.zeros((WORLDS, STEPS), bool)
    after = run(env, starts, {"xy": np.zeros((WORLDS, STEPS, N, 2)), "contact": mask, "reward": inner, "end": flags})
    drawn, refused = Counter(), 0
    for w in range(WORLDS):
        first = np.flatnonzero(starts.obs["is_it"][w, :, 0])
        assert len(first) == 1
        assert active[w][first[0]] or not active[w].any()
        assert starts.metrics["tags"][w] == 0
        oracle, ranks, wanted = TagOracle(first[0], immunity), set(), []
        for t in range(STEPS):
            can = oracle.touched(mask[w, t])
            refused += mask[w, t, oracle.it].sum() > len(can)
            now = np.flatnonzero(after["obs"]["is_it"][w, t, :, 0])
            assert len(now) == 1
            if can:
                assert now[0] in can
                oracle.tag(now[0])
                drawn[len(can), can.index(now[0])] += 1
                ranks |= {can.index(now[0])} if len(can) == 2 else set()
            assert now[0] == oracle.it
            assert after["metrics"]["tags"][w, t] == oracle.tags
            wanted.append(oracle.reward(active[w]))
        gained = (after["reward"][w] - inner[w]) / SCALE
        close(gained, wanted, atol=1e-6)
        assert active[w].sum() < 2 or np.abs(gained.sum(axis=1)).max() < 1e-5
        assert len(ranks) == 2 or active[w].sum() < 5
    assert refused > 200 if immunity else refused == 0
    for n in (2, 3):
        counts = [drawn[n, i] for i in range(n)]
        assert sum(counts) > 200
        assert fits(counts, [1 / n] * n)


def test_who_is_it_first(touching, played):
    """Drawn uniformly from the players; and a reset in the real world draws too."""
    env = maax.Tag(Script(touching, played[0]))
    starts = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(9), 4000))
    active, it = np.asarray(starts.world.active["agent"]), np.asarray(starts.mechanics["tag"].it)
    for n in range(1, N + 1):
        of = active.sum(axis=1) == n
        ranks = (active[of].cumsum(axis=1) - 1)[np.arange(of.sum()), it[of]]
        assert active[of, it[of]].all()
        counts = np.bincount(ranks, minlength=n)
        assert n == 1 or fits(counts, [1 / n] * n)


# --- capture the flag ------------------------------------------------------------------------------------------


class CaptureOracle:
    """The four rules, one agent after the other."""

    def __init__(self, active, base, floor, reach=REACH):
        self.active, self.base, self.floor, self.reach = active, base[:, :2], floor, reach
        self.carrier, self.out, self.score = [None, None], [False] * N, [0, 0]
        self.seen = Counter()

    def in_half_of(self, team, at):
        return (at[1] < self.floor / 2) == (self.base[team][1] < self.floor / 2)

    def step(self, xy, contact):
        """What every agent gains."""
        players = [i for i in range(N) if self.active[i]]

        def away(i, team):
            return np.linalg.norm(np.float32(xy[i] - self.base[team]))

        def taggers(i):
            return [j for j in players if contact[i][j] and TEAM[j] != TEAM[i] and not self.out[j]]

        tagged = [i for i in players if self.in_half_of(1 - TEAM[i], xy[i]) and taggers(i)]
        for i in tagged:
            self.out[i] = True
            for flag in range(2):
                if self.carrier[flag] == i:
                    self.carrier[flag] = None
                    self.seen["lost"] += 1
        self.seen["mutual"] += any(contact[i][j] for i in tagged for j in tagged)
        for i in players:
            if self.out[i] and away(i, TEAM[i]) <= self.reach:
                self.out[i] = False
                self.seen["in again"] += 1
        for flag in range(2):
            near = [i for i in players if TEAM[i] != flag and away(i, flag) <= self.reach]
            takers = [i for i in near if not self.out[i] and i not in self.carrier]
            if self.carrier[flag] is None and takers:
                self.carrier[flag] = min(takers, key=lambda i: away(i, flag))
                self.seen["contested"] += len(takers) > 1 and takers[0] != self.carrier[flag]
                self.seen["refused"] += len(takers) < len(near)
        captured = []
        for flag in range(2):
            i = self.carrier[flag]
            if i is not None and away(i, TEAM[i]) <= self.reach:
                if self.carrier[TEAM[i]] is None:
                    captured.append(flag)
                else:
                    self.seen["must wait"] += 1
        gained = np.zeros(N)
        for flag in captured:
            self.carrier[flag] = None
            self.score[1 - flag] += 1
            self.seen["captured"] += 1
            for i in players:
                gained[i] += 1 if TEAM[i] != flag else -1
        return gained

    def told(self, base, at):
        """What is to be observed, and the scores; `base` (2, 3) is where flags are at first, `at` (N, 3) agents."""
        own = [[[float(team == 0)], [float(team == 1)]] for team in TEAM]
        return {
            "flag_base": np.column_stack([self.base, base[:, 2]]),
            "flag_pos": np.array([base[flag] if i is None else at[i] for flag, i in enumerate(self.carrier)]),
            "carries": np.array([[float(i in self.carrier)] for i in range(N)]),
            "is_out": np.float32(self.out)[:, None],
            "score": np.float32(self.score)[:, None],
            "flag_is_own": np.array(own),
            "score_is_own": np.array(own),
        }, list(self.score)

    def check(self, obs, metrics, at):
        """Compares what is told with what is so; `at` (N, 3) is where agents are."""
        compare(obs, metrics, *self.told(obs["flag_base"], at))


def compare(obs, metrics, wanted, scores):
    """Of a state, or of all of a world with a leading axis."""
    for name, x in wanted.items():
        close(obs[name], x, rtol=1e-7, atol=1e-6 if name == "flag_pos" else 0, err_msg=name)
    equal(np.stack([value for name, value in metrics.items() if name.startswith("score_")], axis=-1), scores)


def walks(rng, base, floor):
    """(worlds, STEPS, N, 2): agents stay, or jump to a base or to anywhere."""
    xy = np.zeros((WORLDS, STEPS, N, 2))
    for w in range(WORLDS):
        here = rng.uniform(0, floor[w], (N, 2))
        for t in range(STEPS):
            near = base[w, rng.integers(0, 2, N), :2] + rng.uniform(-0.35, 0.35, (N, 2))
            to = np.where(rng.random((N, 1)) < 0.6, near, rng.uniform(0, floor[w], (N, 2)))
            here = np.where(rng.random((N, 1)) < 0.5, here, to)
            xy[w, t] = here
    return xy.astype(np.float32)


@pytest.mark.slow
def test_capture_the_flag(touching, played):
    """Random positions and touches of random players, on floors of all sizes, either team's half below."""
    env = maax.CaptureTheFlag(Script(touching, played[0]), REACH, WINS, SCALE)
    starts = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(1), WORLDS))
    active, base = np.asarray(starts.world.active["agent"]), np.asarray(starts.world.sites["flag"])
    floor = np.asarray(starts.world.plan.floor_size)
    assert 0.2 < (base[:, 0, 1] < base[:, 1, 1]).mean() < 0.8
    rng = seeds.rng(1)
    xy, mask = walks(rng, base, floor), contacts(rng, active, 0.12)
    inner = rng.normal(size=(WORLDS, STEPS, N)).astype(np.float32)
    end = rng.random((WORLDS, STEPS)) < 0.1
    after = run(env, starts, {"xy": xy, "contact": mask, "reward": inner, "end": end})
    z = np.asarray(played[0].data.xpos)[env.base.agents.body_ids, 2:]
    seen = Counter()
    for w in range(WORLDS):
        oracle, gained, told, scores = CaptureOracle(active[w], base[w], floor[w]), [], [], []
        for t in range(STEPS):
            gained.append(oracle.step(xy[w, t], mask[w, t]))
            now, score = oracle.told(base[w], np.concatenate([xy[w, t], z], axis=1))
            told.append(now)
            scores.append(score)
        obs, metrics = ({name: x[w] for name, x in after[part].items()} for part in ("obs", "metrics"))
        compare(obs, metrics, {name: np.stack([now[name] for now in told]) for name in told[0]}, scores)
        close(after["reward"][w], inner[w] + SCALE * np.array(gained), atol=1e-5)
        equal(after["terminated"][w], end[w] | (np.max(scores, axis=1) >= WINS))
        seen += oracle.seen
        seen["won by 0"] += oracle.score[0] >= WINS
        seen["won by 1"] += oracle.score[1] >= WINS
        seen["not won"] += max(oracle.score) < WINS
    events = ("lost", "mutual", "in again", "contested", "refused", "must wait", "captured")
    assert {name: seen[name] for name in events if seen[name] < 20} == {}
    assert min(seen[name] for name in ("won by 0", "won by 1", "not won")) > 2


def test_a_game_starts_with_everything_at_home(played):
    state, _ = played
    oracle = CaptureOracle(np.asarray(state.world.active["agent"]), np.asarray(state.world.sites["flag"]), FLOOR)
    oracle.check(state.obs, state.metrics, None)


BASES = np.array([[2.0, 1.0], [4.0, 5.0]], np.float32)
FAR = [[0.5, 2.5], [1.0, 2.5], [1.5, 2.5], [0.5, 3.5], [1.0, 3.5]]
SITUATIONS = {
    # what the five agents do, who touches whom, and then: who carries either flag, who is out, the score
    "in reach exactly": ({0: (4.0, 4.5)}, [], (None, 0), [], (0, 0)),
    "out of reach": ({0: (4.0, 4.49)}, [], (None, None), [], (0, 0)),
    "one's own flag is not taken": ({0: (2.0, 1.0), 3: (4.0, 5.0)}, [], (None, None), [], (0, 0)),
    "touched in the other's half": ({0: (3.0, 3.2)}, [(0, 3)], (None, None), [0], (0, 0)),
    "touched in one's own half": ({0: (3.0, 2.8), 3: (3.0, 3.1)}, [(0, 3)], (None, None), [], (0, 0)),
    "both beyond the line": ({0: (3.0, 3.1), 3: (3.0, 2.9)}, [(0, 3)], (None, None), [0, 3], (0, 0)),
    "touched by one's own": ({0: (3.0, 3.2), 1: (3.0, 3.4)}, [(0, 1)], (None, None), [], (0, 0)),
    "tagged on the flag": ({0: (4.0, 5.0)}, [(0, 4)], (None, None), [0], (0, 0)),
    "the nearest takes": ({0: (4.3, 5.0), 1: (4.0, 5.2), 2: (3.7, 5.0)}, [], (None, 1), [], (0, 0)),
    "both flags at once": ({2: (4.0, 5.0), 3: (2.0, 1.0)}, [], (3, 2), [], (0, 0)),
}


@pytest.fixture(scope="module")
def situations(touching, played):
    """A game with known bases, and its step without physics."""
    env = maax.CaptureTheFlag(Script(touching, played[0]), reach=0.5, wins_at=2)
    state = env.reset(seeds.key(0))
    world = state.world
    world = world.replace(
        active=world.active | {"agent": jnp.ones(N, bool)},
        sites=world.sites | {"flag": jnp.asarray(np.pad(BASES, ((0, 0), (0, 1))))},
        plan=world.plan.replace(floor_size=jnp.float32(FLOOR)),
    )
    step = jax.jit(env.advance)  # without the check of the action

    def go(state, moves, touches=()):
        xy, mask = np.array(FAR, np.float32), np.zeros((N, N), bool)
        for i, at in moves.items():
            xy[i] = at
        for i, j in touches:
            mask[i, j] = mask[j, i] = True
        return step(state, {"xy": xy, "contact": mask, "reward": np.zeros(N, np.float32), "end": np.array(False)})

    return state.replace(world=world), go


def check_game(state, carriers, out, score):
    game = state.mechanics["capture_the_flag"]
    equal(game.carrier, [-1 if i is None else i for i in carriers])
    equal(np.flatnonzero(game.out), out)
    equal(game.score, score)


@pytest.mark.parametrize(("moves", "touches", "carriers", "out", "score"), SITUATIONS.values(), ids=SITUATIONS)
def test_one_step(moves, touches, carriers, out, score, situations):
    state, go = situations
    check_game(go(state, moves, touches), carriers, out, score)


def test_a_game_by_hand(situations):
    """Capturing waits for one's own flag; who is out tags nobody; the second capture wins."""
    state, go = situations
    there, home = {0: (4.0, 5.0)}, {0: (2.0, 1.0)}
    state = go(state, there | {3: (2.0, 1.0)})
    check_game(state, (3, 0), [], (0, 0))
    state = go(state, home | {3: (4.0, 3.5)})
    check_game(state, (3, 0), [], (0, 0))
    state = go(state, home | {3: (4.0, 2.5)}, [(3, 1)])
    check_game(state, (None, None), [3], (1, 0))
    equal(state.reward, [1, 1, 1, -1, -1])
    assert not state.terminated
    state = go(state, {0: (3.0, 3.2), 3: (3.0, 3.3)}, [(0, 3)])
    check_game(state, (None, None), [3], (1, 0))
    assert not state.reward.any()
    state = go(state, there | {3: (2.0, 1.0)})
    check_game(state, (None, 0), [3], (1, 0))
    state = go(state, home | {3: (4.0, 4.8)})
    check_game(state, (None, None), [], (2, 0))
    assert state.terminated


# --- in the real physics ---------------------------------------------------------------------------------------


def towards(at, goal, force):
    """(3,) an action: a push to a point, soft at the end."""
    gap = np.asarray(goal) - at
    push = gap / max(np.linalg.norm(gap), 1e-6) * force * min(np.linalg.norm(gap) / 0.2, 1)
    return [*push, 0.0]


def door_of(played):
    """(2,) the middle of the door between the halves."""
    return np.asarray(played[0].world.plan.doors)[0, :2]


def beside_the_flag(played):
    """(2,) a place by the upper wall, 1.5 m to that side of the door on which there is more room."""
    x = door_of(played)[0]
    return (x + 1.5 if x < FLOOR / 2 else x - 1.5, 5.6)


def play(game, played, seeker_from, seeker_goes):
    """Agent 0 walks through the door, to the flag, and back; yields every state, checked against the oracle.

    The flags are straight below and above the door.
    """
    state, step = played
    agents, door = game.base.agents, door_of(played)
    base = np.array([[door[0], 1.0], [door[0], 5.0]], np.float32)
    flags = state.world.sites["flag"].at[:, :2].set(base)
    qpos = state.data.qpos.at[agents.qpos_ids[[0, 3], :2]].set(jnp.array([[door[0], 1.5], seeker_from]))
    world = state.world.replace(sites=state.world.sites | {"flag": flags})
    state = state.replace(world=world, data=state.data.replace(qpos=qpos))
    active = np.asarray(state.world.active["agent"])
    equal(active, [True, False, False, True, False])
    oracle = CaptureOracle(active, np.asarray(flags), FLOOR)
    step_off = np.array([0, 0.4])
    low, high = door - step_off, door + step_off
    goals = [low, high, base[1], high, low, base[0]]
    while goals:
        at = np.asarray(state.data.qpos)[agents.qpos_ids[:, :2]]
        if np.linalg.norm(at[0] - goals[0]) < 0.1:
            goals.pop(0)
            continue
        move = np.zeros((N, 3), np.float32)
        move[0] = towards(at[0], goals[0], 0.3)
        move[3] = seeker_goes(state, at)
        state = step(state, {"move": move})
        at = np.asarray(state.data.xpos)[agents.body_ids]
        close(state.reward, oracle.step(at[:, :2], np.asarray(state.mechanics["contact"])))
        oracle.check(state.obs, state.metrics, at)
        yield state
        if state.terminated or state.truncated:
            return


def test_a_flag_is_carried_home(game, played):
    """The other team's agent stands by."""
    states = list(play(game, played, beside_the_flag(played), lambda state, at: np.zeros(3)))
    carries = np.array([float(s.obs["carries"][0, 0]) for s in states])
    equal(np.flatnonzero(np.diff(carries)), [carries.argmax() - 1, len(states) - 2])
    assert 50 < carries.sum() < len(states) - 50
    assert not any(s.terminated for s in states[:-1])
    equal(states[-1].reward, [1, 0, 0, -1, 0])
    assert states[-1].terminated
    assert not states[-1].truncated


def test_a_carrier_is_tagged(game, played):
    """The other team's agent waits until its flag is taken, and hunts."""

    def hunt(state, at):
        taken = state.obs["carries"][0, 0] and not state.obs["is_out"][0, 0]
        return towards(at[3], at[0], 0.9) if taken else np.zeros(3)

    states = list(play(game, played, beside_the_flag(played), hunt))
    carries, out = (np.array([float(s.obs[name][0, 0]) for s in states]) for name in ("carries", "is_out"))
    tagged = int(out.argmax())
    assert carries[tagged - 1]
    assert not carries[tagged]
    assert states[tagged].data.xpos[game.base.agents.body_ids[0], 1] > FLOOR / 2
    equal(states[tagged].obs["flag_pos"], states[tagged].obs["flag_base"])
    assert out[tagged:-1].all() or not out[-1]
    assert not out[-1]
    assert not any(s.reward.any() or s.terminated for s in states)


def plain(n_agents, *modules, teams=None):
    env = maax.Base(2, impl="c")
    for module in (maax.Agents(n_agents), *modules):
        env.add_module(module)
    return maax.AgentAgentContactMask2D(maax.TeamMembership(env, teams))


TEAMS = {"hiders": 1, "seekers": 1}
ERRORS = {
    "no flags": (lambda e: maax.CaptureTheFlag(plain(TEAMS)), "CaptureTheFlag: needs flags; add_module(Flags(...))"),
    "one team": (lambda e: maax.CaptureTheFlag(plain(2, maax.Flags())), "CaptureTheFlag: got 1 teams; takes 2"),
    "a gap": (lambda e: plain(2, maax.Flags(), teams=[0, 2]), "teams: got 'team_1' without agents"),
    "flags without teams": (lambda e: maax.CaptureTheFlag(e.base), "CaptureTheFlag: needs TeamMembership"),
    "flags without contact": (lambda e: maax.CaptureTheFlag(e.env), "needs AgentAgentContactMask2D; wrap with it"),
    "reach": (lambda e: maax.CaptureTheFlag(e, reach=0), "reach: got 0; takes a positive number"),
    "wins": (lambda e: maax.CaptureTheFlag(e, wins_at=0), "wins_at: got 0; takes a whole number of at least 1"),
    "scale of flags": (lambda e: maax.CaptureTheFlag(e, scale=-1.0), "scale: got -1.0; takes a positive number"),
    "twice": (lambda e: maax.CaptureTheFlag(maax.CaptureTheFlag(e)), "a wrapper named 'capture_the_flag' already"),
    "base size": (lambda e: maax.Flags(base_size=0), "base_size: got 0; takes a positive number"),
    "one placement": (lambda e: maax.Flags([maax.uniform_placement]), "placement_fn: got a list of 1"),
    "tag without contact": (lambda e: maax.Tag(e.env), "Tag: needs AgentAgentContactMask2D; wrap with it first"),
    "immunity": (lambda e: maax.Tag(e, -1), "immunity: got -1; takes a whole number of at least 0"),
    "half a step": (lambda e: maax.Tag(e, 1.5), "immunity: got 1.5; takes a whole number"),
    "scale of tag": (lambda e: maax.Tag(e, scale=0), "scale: got 0; takes a positive number"),
}


@pytest.mark.parametrize(("call", "message"), ERRORS.values(), ids=ERRORS)
def test_refused(call, message, touching):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        call(touching)
    assert message in str(error.value)
