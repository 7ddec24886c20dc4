"""Pictures, films and web pages of worlds, against what the states say and what a browser shows."""

from __future__ import annotations

import asyncio
import functools
import itertools
import re
import sys

import jax
import numpy as np
import pytest
from helpers import seeds
from helpers.browser import browser, needs_browser, seen_at
from helpers.opengl import skipped_without_opengl
from PIL import Image
from scipy import ndimage
from scipy.spatial.transform import Rotation

import maax_mjx as maax
from maax_mjx.common.colours import TEAM_COLOURS
from maax_mjx.tasks.hide_and_seek import GrabConfig, LidarConfig, LockConfig
from maax_mjx.viewer import gl
from maax_mjx.viewer.between import smooth
from maax_mjx.viewer.film import Film, film, paced
from maax_mjx.viewer.scene import up
from maax_mjx.viewer.stage import Stage
from maax_mjx.worldgen import ObjFromXML
from maax_mjx.wrappers import Lidar, find

HORIZON, PREPARATION, N_STEPS = 12, 5, 30
SHOWN = [2, 0]


@pytest.fixture(scope="module")
def env():
    return maax.make(
        "hide_and_seek", impl="c", n_hiders=(1, 2), n_seekers=1, n_boxes=(1, 2), n_elongated_boxes=(1, 2), n_ramps=1,
        horizon=HORIZON, prep_fraction=PREPARATION / HORIZON, cone=2.0, lidar=LidarConfig(n_rays=7, range=3.0),
        lock=LockConfig(), grab=GrabConfig(), observations="raw", stats=False, p_door_dropout=0.5,
    )  # fmt: skip


@functools.cache
def three(env):
    """Three worlds, compiled once."""
    return maax.Worlds(env, 3)


@pytest.fixture(scope="module")
def played(env):
    """What the worlds were at first, and 30 steps of two of them, two resets among them."""
    worlds = three(env)
    first = worlds.reset(seeds.key(0))
    began = jax.device_get(first.data.qpos)

    def policy(state, key):
        action = env.sample_action(key)
        return action | {"move": action["move"].at[..., 2].set(1.0)}  # everyone turns all the time

    _, recording = maax.record(worlds, first, policy, N_STEPS, show=SHOWN, every=1)
    return began, recording


@pytest.fixture(scope="module")
def recording(played):
    return played[1]


@pytest.fixture(scope="module")
def one(env, recording):
    """A state of a single world before its preparation ends, with both boxes or with one."""
    return film(env, recording, [0]).states[2][0]


def with_mechanics(state, **changed):
    """The state whose mechanics have other values."""
    mechanics = dict(state.mechanics)
    for name, values in changed.items():
        mechanics[name] = mechanics[name].replace(**values)
    return state.replace(mechanics=mechanics)


@pytest.mark.slow
def test_a_recording_is_of_the_worlds_that_were_asked_for(played):
    began, recording = played
    np.testing.assert_array_equal(recording.states.data.qpos[0], began[SHOWN])
    steps = recording.states.step
    assert steps.shape == (N_STEPS + 1, 2)
    np.testing.assert_array_equal(steps[:, 0], np.arange(N_STEPS + 1) % HORIZON)
    assert not np.array_equal(recording.states.data.qpos[:, 0], recording.states.data.qpos[:, 1])


def test_frames_show_what_the_states_say_over_resets(env, recording):
    """Every frame of both worlds: what is there, where, how large; the walls are those of the running episode."""
    stage = Stage(env)
    shown = film(env, recording, None)
    layouts = set()
    for states in shown.states:
        for state in states:
            frame = stage.frame(state)
            parts = {part.name: part for part in frame.parts}
            for module in env.base.movables:
                for slot, name in enumerate(module.names):
                    assert (name in parts) == state.world.active[module.kind][slot], name
                    if name in parts and module.kind != "ramp":
                        body = module.body_ids[slot]
                        np.testing.assert_allclose(parts[name].position, state.data.xpos[body], atol=1e-6)
            plan = state.world.plan
            walls = frame.named("wall") + frame.named("high_wall")
            drawn = [[*(w.position - w.shape.size)[:2], *(w.position + w.shape.size)[:2]] for w in walls]
            expected = plan.walls[plan.wall_mask]
            np.testing.assert_allclose(sorted(np.round(drawn, 2).tolist()), sorted(np.round(expected, 2).tolist()))
            doors = [(*door.position[:2], 2 * max(door.shape.size)) for door in frame.named("door")]
            np.testing.assert_allclose(doors, plan.doors[plan.door_mask], atol=1e-5)
            assert len(frame.named("high_wall")) == 4
            layouts.add(tuple(np.round(plan.walls, 3).ravel()))
    assert len(layouts) > 2, "layouts change at resets"


def test_ramps_have_their_corners_and_point_uphill(env, one):
    stage = Stage(env)
    frame = stage.frame(one)
    (ramp,) = (part for part in frame.parts if part.name == "ramp0")
    vertices, faces = stage.meshes[ramp.shape.mesh]
    corners = vertices @ ramp.rotation.T + ramp.position
    body = one.data.xpos[env.base.modules["ramp"].body_ids[0]]
    np.testing.assert_allclose(corners.min(axis=0), body - 0.25, atol=2e-3)
    np.testing.assert_allclose(corners.max(axis=0), body + 0.25, atol=2e-3)
    assert faces.max() < len(vertices)
    (slope,) = (line for line in frame.lines if line.role == "slope")
    foot, tip = slope.points[0]
    assert tip[2] - foot[2] == pytest.approx(0.3, abs=0.01)
    assert foot[1] - tip[1] == pytest.approx(0.3, abs=0.01), "ramps rise towards -y"


def test_sizes_are_those_of_the_world(env, recording):
    """Elongated boxes have extents of their own, which the compiled model does not have."""
    stage = Stage(env)
    compiled = 2 * env.base.model.geom("box0").size
    for states in film(env, recording, None).states[::HORIZON]:
        for state in states:
            assert not np.allclose(state.world.extents["box"][0], compiled, atol=0.1), "the first is elongated"
            parts = {part.name: part for part in stage.frame(state).parts}
            for slot in np.flatnonzero(state.world.active["box"]):
                size = parts[f"box{slot}"].shape.size
                np.testing.assert_allclose(2 * np.array(size), state.world.extents["box"][slot], atol=1e-3)


def test_locks_are_marked_with_their_owners(env, one):
    stage = Stage(env)
    n = env.action_space["lock"].shape[1]
    owner = np.full(n, -1)
    owner[0], owner[-1] = 2, 0
    locked = with_mechanics(one, locks={"owner": owner, "locked": owner >= 0})
    frame = stage.frame(locked)
    locks = {label.name: label for label in frame.labels if label.role == "lock"}
    assert set(locks) == {"locks:box0", "locks:ramp0"}
    for name, kind, agent in (("locks:box0", "box", 2), ("locks:ramp0", "ramp", 0)):
        above = one.data.xpos[env.base.modules[kind].body_ids[0]] + up(0.25)
        np.testing.assert_allclose(locks[name].position[:2], above[:2], atol=2e-3)
        assert locks[name].rgba == pytest.approx(env.base.agents.colours[agent])
        assert locks[name].text == "0", "the first hider and the first seeker"
        (padlock,) = (part for part in frame.parts if part.name == f"{name}:body")
        assert padlock.shape.rgba == locks[name].rgba
        np.testing.assert_allclose(padlock.position, above + up(0.03 + padlock.shape.size[2]), atol=2e-3)
    free = {part.name: part.shape.rgba for part in stage.frame(one).parts}
    now = {part.name: part.shape.rgba for part in frame.parts}
    assert free["box0"] != now["box0"]
    assert not stage.frame(one).named("lock")


def test_holds_are_lines_and_reaching_hands(env, one):
    stage = Stage(env)
    held = with_mechanics(one, grabs={"held": np.array([0, -1, -1])})
    frame = stage.frame(held)
    (hold,) = (line for line in frame.lines if line.role == "hold")
    agent = one.data.xpos[env.base.agents.body_ids[0]]
    box = one.data.xpos[env.base.modules["box"].body_ids[0]]
    np.testing.assert_allclose(hold.points[0, :, :2], [agent[:2], box[:2]], atol=1e-5)
    hands = np.array([part.position for part in frame.parts if part.name.startswith("agent0:hand")])
    to = (box - agent)[:2] / np.linalg.norm((box - agent)[:2])
    np.testing.assert_allclose((hands.mean(axis=0) - agent)[:2], 0.19 * to, atol=1e-5)
    free = with_mechanics(one, grabs={"held": np.full(3, -1)})
    assert not [line for line in stage.frame(free).lines if line.role == "hold"]


def test_preparation_is_said_and_seen(env, recording):
    stage = Stage(env)
    shown = film(env, recording, [0])
    for (state,), (returns,) in zip(shown.states, shown.returns, strict=True):
        frame = stage.frame(state, returns)
        on = int(state.step) < PREPARATION
        assert ("preparation" in frame.text[0]) == on
        assert frame.text[0].startswith(f"{int(state.step) * 0.005:.2f} s")
        colours = {part.name: part.shape.rgba for part in frame.named("agent")}
        assert colours["agent0"] == pytest.approx(env.base.agents.colours[0])
        assert (colours["agent2"] != pytest.approx(env.base.agents.colours[2])) == on


def test_rewards_are_summed_by_team_and_episode(env, recording):
    stage = Stage(env)
    reward, step = recording.states.reward[:, 0], recording.states.step[:, 0]
    shown = film(env, recording, [0])
    alone = film(env, recording.states, [0])
    total = np.zeros(3)
    for t, ((state,), (known,), (summed,)) in enumerate(zip(shown.states, shown.returns, alone.returns, strict=True)):
        total = np.zeros(3) if step[t] == 0 else total + reward[t]
        np.testing.assert_allclose(known, total, atol=1e-5)
        np.testing.assert_allclose(summed, total, atol=1e-5)
        seekers = stage.frame(state, known).text[-1]
        assert seekers == f"seekers {reward[t][2] + 0.0:+g}   sum {total[2] + 0.0:+g}"
    assert np.abs(total).sum() > 0
    every_other = jax.tree.map(lambda x: x[::2], recording.states)
    assert film(env, every_other, [0]).returns[3] == [None]
    assert film(env, every_other, [0]).times[3] == pytest.approx(6 * stage.dt)


def test_states_in_every_form_are_the_same_film(env, recording):
    states = recording.states
    expected = film(env, recording, [1])
    listed = [jax.tree.map(lambda x, t=t: x[t], states) for t in range(N_STEPS + 1)]
    single = [jax.tree.map(lambda x: x[1], state) for state in listed]
    alone = jax.tree.map(lambda x: x[:, 1], states)
    for given, worlds in ((states, 1), (states, [-1]), (listed, 1), (iter(listed), [1]), (single, None), (alone, None)):
        made = film(env, given, worlds)
        assert len(made.states) == N_STEPS + 1
        for a, b in zip(made.states, expected.states, strict=True):
            np.testing.assert_array_equal(a[0].data.qpos, b[0].data.qpos)
        np.testing.assert_allclose(made.times, np.arange(N_STEPS + 1) * 0.005)
    assert len(film(env, recording, None).states[0]) == 2
    assert paced(expected.times, 30) == [0, 7, 14, 21, 28, 30]


def test_states_of_other_rules_are_refused(env, recording):
    """As many agents and things are in them, and what the pictures read is not."""
    other = maax.make(
        "hide_and_seek", impl="c", n_hiders=(1, 2), n_seekers=1, n_boxes=(1, 2), n_elongated_boxes=(0, 2), n_ramps=1,
        horizon=HORIZON, lock=None, stats=False,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"another environment: state\.mechanics\.\S+ has .*, and in env nothing"):
        maax.render(other, recording_frame(recording))


def test_moments_between_frames_are_on_the_way(env, recording):
    """Frames 75 ms apart: at a third of the way things are a third of the way, and turns are turns."""
    shown = film(env, recording, [1])
    sparse = Film(
        [shown.states[i] for i in (0, 9, 13, 15)],
        [shown.returns[i] for i in (0, 9, 13, 15)],
        np.array([0, 0.1, 0.2, 0.5]),
    )
    made = smooth(sparse, 30)
    np.testing.assert_allclose(made.times, [0, 0.1 / 3, 0.2 / 3, 0.1, 0.4 / 3, 0.5 / 3, 0.2, 0.5])
    first, second, after = (made.states[i][0] for i in (0, 1, 3))
    for name in ("geom_xpos", "xpos", "qpos"):
        a, b = getattr(first.data, name), getattr(after.data, name)
        np.testing.assert_allclose(getattr(second.data, name), a + (b - a) / 3, atol=1e-5)
    turns = second.data.geom_xmat.reshape(-1, 3, 3)
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-5)
    ways = [Rotation.from_matrix(s.data.geom_xmat.reshape(-1, 3, 3)) for s in (first, second, after)]
    whole = (ways[2] * ways[0].inv()).magnitude()
    np.testing.assert_allclose((ways[1] * ways[0].inv()).magnitude(), whole / 3, rtol=0.02, atol=1e-3)
    assert whole.max() > 0.01
    # An episode ended in the second gap: nothing is between.
    resets = [i for i in range(1, len(made.times)) if int(made.states[i][0].step) < int(made.states[i - 1][0].step)]
    assert resets == [6]
    for i in (4, 5):
        np.testing.assert_array_equal(made.states[i][0].data.geom_xpos, made.states[3][0].data.geom_xpos)


def test_senses_are_drawn_as_they_are(env, one):
    frame = Stage(env, vision=True, lidar=True).frame(one)
    playing = np.flatnonzero(one.world.active["agent"])
    cones = {part.name: part for part in frame.named("cone")}
    rays = {line.name: line for line in frame.lines if line.role == "ray"}
    assert set(cones) == {f"line_of_sight:agent{i}" for i in playing}
    distances = jax.jit(find(env, Lidar).rays)(one)[1]
    for i in playing:
        assert cones[f"line_of_sight:agent{i}"].shape.size[1] == pytest.approx(1.0)
        yaw = one.data.qpos[env.base.agents.qpos_ids[i, 3]]
        ahead = [np.cos(yaw - np.pi / 2), np.sin(yaw - np.pi / 2)]
        np.testing.assert_allclose(cones[f"line_of_sight:agent{i}"].rotation[:2, 0], ahead, atol=1e-5)
        points = rays[f"lidar:agent{i}"].points
        lengths = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        np.testing.assert_allclose(lengths, distances[i], atol=1e-4)
        assert lengths.max() <= 3.0 + 1e-5
    assert not Stage(env).frame(one).named("cone")


def recording_frame(recording, t=PREPARATION + 1, world=1):
    return jax.tree.map(lambda x: x[t, world], recording.states)


def unlocked(state):
    """The state without locks, which have the colours of agents."""
    return with_mechanics(state, locks={"owner": np.full_like(state.mechanics["locks"].owner, -1)})


def centre_of(image, colour, size):
    """(x, y) from the lower left, as shares of the picture, of the pixels that look most like a colour."""
    red, green, blue = np.moveaxis(image.astype(float), -1, 0)
    # Doors are green, and bluish.
    want = (blue - red > 60) & (blue > green + 15) if colour == "blue" else (red - blue > 110) & (green < 120)
    y, x = np.nonzero(want)
    assert len(x) > 20, f"no {colour}"
    return np.array([x.mean() / size, 1 - y.mean() / size])


@pytest.mark.parametrize("view", ["3d", "plan"])
def test_agents_are_where_they_are_and_not_mirrored(env, recording, view):
    """From the hiders to the seeker, in four layouts: shares of the picture by metres, along x and along y."""
    ways, metres = [], []
    for t, world in itertools.product((PREPARATION + 1, HORIZON + PREPARATION + 1), (0, 1)):
        state = unlocked(recording_frame(recording, t, world))
        with skipped_without_opengl():
            image = maax.render(env, state, camera="top" if view == "3d" else "default", size=(300, 300), view=view)
        assert image.shape == (300, 300, 3)
        assert image.dtype == np.uint8
        xpos = state.data.xpos[env.base.agents.body_ids]
        metres.append((xpos[2] - xpos[:2][state.world.active["agent"][:2]].mean(axis=0))[:2])
        ways.append(centre_of(image, "orange", 300) - centre_of(image, "blue", 300))
    slope = np.sum(np.array(ways) * metres, axis=0) / np.sum(np.square(metres), axis=0)
    # A floor of 6 m takes most of the picture.
    assert ((slope > 0.08) & (slope < 0.17)).all(), slope


def test_worlds_are_side_by_side(env, recording):
    both = maax.render(env, jax.tree.map(lambda x: x[3], recording.states), worlds=[0, 1], size=(400, 200), view="plan")
    ones = [maax.render(env, recording_frame(recording, 3), size=(400, 200), view="plan")]
    assert both[:, :200].std() > 10
    assert both[:, 200:].std() > 10
    assert not np.array_equal(both, ones[0])


LYING = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="annotation:outer_bound"><geom type="box" size="0.9 0.7 0.3" pos="0 0 0.3"/></body>
  <body name="main" pos="0 0 0.3">
    <joint name="x" type="slide" axis="1 0 0"/> <joint name="y" type="slide" axis="0 1 0"/>
    <joint name="z" type="slide" axis="0 0 1"/> <joint name="yaw" type="hinge" axis="0 0 1"/>
    <geom name="main" type="sphere" size="0.05"/>
    <geom name="egg" type="ellipsoid" size="0.3 0.1 0.15" pos="-0.5 0 0" euler="0 0.7 0"/>
    <geom name="pill" type="capsule" size="0.1 0.15" pos="0.5 0 0" euler="0 1.57 0"/>
    <geom name="ball" type="sphere" size="0.12" pos="0 0.5 0"/>
    <geom name="disc" type="cylinder" size="0.12 0.1" pos="0 -0.5 0"/>
  </body>
</worldbody></mujoco>"""


class Toys(maax.Entities):
    """A body with one of every kind of solid, in magenta."""

    name, kind, count_name, friction_name = "toys", "toy", "n_toys", "toy_friction"

    def __init__(self, path):
        super().__init__(1, (1.8, 1.4, 0.6), maax.centre_placement)
        path.write_text(LYING)
        self.path = path

    def make(self, name):
        return ObjFromXML(self.path, name, rgba=(1.0, 0.0, 1.0, 1.0))


@pytest.mark.parametrize("view", ["3d", "plan"])
def test_every_kind_of_solid_is_drawn(tmp_path, view):
    """As wide and as deep from above as the trigonometry of its half axes says."""
    env = maax.Base(1, impl="c")
    env.add_module(maax.WallScenarios("empty", outer="none"))
    env.add_module(maax.Agents(1, maax.uniform_placement))
    env.add_module(Toys(tmp_path / "toys.xml"))
    with skipped_without_opengl():
        image = maax.render(env, env.reset(seeds.key(0)), view=view, camera="top", size=(600, 600)).astype(int)
    blobs, n = ndimage.label((image[..., 0] > 100) & (image[..., 1] < 80) & (image[..., 2] > 100))
    assert n == 5
    # From left to right: the egg, then from the front to the back the ball, the middle and the disc, then the pill.
    found = sorted(ndimage.find_objects(blobs), key=lambda at: (at[1].start // 30, at[0].start))
    widths = [2 * np.hypot(0.3 * np.cos(0.7), 0.15 * np.sin(0.7)), 0.24, 0.1, 0.24, 0.5]
    depths = [0.2, 0.24, 0.1, 0.24, 0.2]
    scale = found[1][1].stop - found[1][1].start
    for at, width, depth in zip(found, widths, depths, strict=True):
        assert at[1].stop - at[1].start == pytest.approx(width / 0.24 * scale, abs=2.5)
        assert at[0].stop - at[0].start == pytest.approx(depth / 0.24 * scale, abs=2.5)


def test_without_opengl_the_message_says_what_brings_it(env, recording, monkeypatch):
    monkeypatch.setattr(gl, "LIBRARIES", {"egl": "libno_such_egl.so", "osmesa": "libno_such_osmesa.so"})
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    state = recording_frame(recording)
    with pytest.raises(maax.MissingLibraryError, match=r"libegl1.*libosmesa6.*MUJOCO_GL=egl.*view='plan'"):
        maax.render(env, state, view="3d")
    assert maax.render(env, state, size=(64, 64)).shape == (64, 64, 3)
    monkeypatch.setenv("MUJOCO_GL", "off")
    with pytest.raises(maax.MissingLibraryError, match="MUJOCO_GL=off"):
        maax.render(env, state, view="3d")


def test_films_last_as_long_as_the_play(env, recording, tmp_path):
    av = pytest.importorskip("av")
    shown = N_STEPS * 0.005 / 0.1
    slow = dict(size=(96, 80), view="plan", speed=0.1)
    made = Image.open(maax.video(env, recording, tmp_path / "a.gif", fps=10, **slow))
    assert made.n_frames == round(shown * 10) + 1
    durations = []
    for i in range(made.n_frames):
        made.seek(i)
        durations.append(made.info["duration"])
    assert sum(durations) == made.n_frames * 100
    maax.video(env, recording, tmp_path / "a.mp4", fps=8, worlds=[0], **slow)
    with av.open(str(tmp_path / "a.mp4")) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert file.streams.video[0].average_rate == 8
    assert len(frames) == round(shown * 8) + 1
    assert frames[0].shape == (80, 96, 3)
    assert np.abs(frames[0].astype(float) - frames[-1]).max() > 50


@pytest.fixture(scope="module")
def shown(env, recording):
    """The world whose seeker is further off at step 20, in its second episode, than it was at step 8, in its first."""
    seeker = recording.states.data.xpos[:, :, env.base.agents.body_ids[2], :2]
    return int(np.linalg.norm(seeker[20] - seeker[8], axis=-1).argmax())


@pytest.fixture(scope="module")
def page(env, recording, shown):
    return maax.replay(env, recording, worlds=[shown], speed=0.05)


def test_the_page_holds_all_it_needs(page, tmp_path):
    # Of its 0.1 s from frame to frame, with two moments in between.
    assert page.n_frames == 3 * N_STEPS + 1
    assert page.seconds == pytest.approx(N_STEPS * 0.005 / 0.05)
    assert not re.search(r"""(src|href|url)\s*[=(]\s*["']?(https?:)?//""", page.html)
    assert set(re.findall(r"https?://[\w.]+", page.html)) <= {"http://www.w3.org"}
    assert len(page.html) < 2e6
    assert re.findall("<title>.*</title>", page.html) == ["<title>hide_and_seek</title>"]
    assert page.save(tmp_path / "x.html").read_text() == page.html
    cell = page._repr_html_()
    assert cell.startswith("<iframe srcdoc=")
    assert "<script" not in cell


def test_a_page_is_made_inside_a_running_event_loop(env, recording, capfd):
    async def cell():
        return maax.replay(env, jax.tree.map(lambda x: x[:3], recording))

    assert asyncio.run(cell()).n_frames == 2
    assert capfd.readouterr().out == ""


@pytest.mark.slow
@needs_browser
def test_a_browser_without_network_shows_the_page_moving(env, recording, shown, page, tmp_path):
    """The page from a file, and in the frame of a notebook's cell: both show the seeker where it is at other times."""
    page.save(tmp_path / "page.html")
    (tmp_path / "cell.html").write_text(f"<!DOCTYPE html><body>{page._repr_html_()}</body>")
    agents = recording.states.data.xpos[:, shown][:, env.base.agents.body_ids, :2]
    seeker = agents[:, 2]
    with browser(tmp_path / "profile") as driver:
        for name in ("page", "cell"):
            driver.get((tmp_path / f"{name}.html").as_uri())
            if name == "cell":
                driver.switch_to.frame(0)
            # 50 ms of the play are a second of the page: these are the steps 8 and 20, after the preparation of the
            # first and of the second episode.
            early, late = seen_at(driver, "0.8"), seen_at(driver, "2.0")
            moved = seeker_in(late) - seeker_in(early)
            expected = seeker[20] - seeker[8]
            assert np.linalg.norm(expected) > 0.3
            # Seen from the south and above, lengths along y are shorter, and y points up.
            away = expected * [1.0, -np.sin(np.radians(55))]
            assert moved @ away > 0.95 * np.linalg.norm(moved) * np.linalg.norm(away), name
            for image, step in ((early, 8), (late, 20)):
                hiders = recording.states.world.active["agent"][step, shown, :2].sum()
                # Two that are close to each other may be one spot.
                apart = hiders == 1 or np.linalg.norm(agents[step, 0] - agents[step, 1]) > 1
                assert (hiders if apart else 1) <= hiders_in(image) <= hiders, (name, step)
            if name == "page":
                np.testing.assert_allclose(seeker_in(seen_at(driver, "0.8")), seeker_in(early), atol=2)


def seeker_in(image):
    """(2,) pixels from the upper left where the orange of the seekers is."""
    red, green, blue = np.moveaxis(image.astype(float), -1, 0)
    y, x = np.nonzero((red - blue > 130) & (green < 0.75 * red))
    assert len(x) > 8, "no seeker"
    assert np.hypot(x.std(), y.std()) < 20, "something else is orange"
    return np.array([x.mean(), y.mean()])


def hiders_in(image):
    """How many spots of the blue of the hiders there are."""
    red, green, blue = np.moveaxis(image.astype(float), -1, 0)
    # Doors are green, and bluish.
    mask = (blue - red > 60) & (blue > green + 15)
    spots, n = ndimage.label(ndimage.binary_dilation(mask, iterations=3))
    return sum((mask & (spots == i + 1)).sum() > 8 for i in range(n))


def test_missing_libraries_are_named(env, recording, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(maax.MissingLibraryError, match=r'viser.*pip install -e "\.\[viewer\]"'):
        maax.replay(env, recording)
    with pytest.raises(maax.MissingLibraryError, match=r'PyAV.*pip install -e "\.\[viewer\]"'):
        maax.video(env, recording, tmp_path / "a.mp4", view="plan")


def test_colours_of_teams_are_told_apart():
    """Of Okabe and Ito's, the lightness of the first two differs even without colour."""
    light = [0.299 * r + 0.587 * g + 0.114 * b for r, g, b, _ in TEAM_COLOURS[:2]]
    assert abs(light[0] - light[1]) > 0.1
    assert len(set(TEAM_COLOURS)) == len(TEAM_COLOURS)


WRONG = {
    "env": (lambda env, rec: maax.render(None, rec), "env: got None"),
    "state": (lambda env, rec: maax.render(env, 3), "state: got int"),
    "batch as state": (lambda env, rec: maax.render(env, rec), "state: got Recording"),
    "worlds beyond": (lambda env, rec: maax.replay(env, rec, worlds=2), "worlds: got 2; takes a number below 2"),
    "worlds text": (lambda env, rec: maax.replay(env, rec, worlds="all"), "worlds: got 'all'"),
    "one world": (lambda env, rec: maax.render(env, recording_frame(rec), worlds=1), "worlds: got 1; the states are"),
    "view": (lambda env, rec: maax.render(env, recording_frame(rec), view="4d"), "view: got '4d'"),
    "size": (lambda env, rec: maax.render(env, recording_frame(rec), size=64), "size: got 64"),
    "camera": (lambda env, rec: maax.replay(env, rec, camera="side"), "camera: got 'side'"),
    "suffix": (lambda env, rec: maax.video(env, rec, "x.avi"), "path: got 'x.avi'"),
    "path": (lambda env, rec: maax.video(env, rec, 3), "path: got 3; takes the name of a file that ends in .mp4 or"),
    "folder": (lambda env, rec: maax.replay(env, rec, "no/x.html"), "path: got 'no/x.html', and no folder"),
    "page suffix": (lambda env, rec: maax.replay(env, rec, "x.mp4"), "path: got 'x.mp4'; takes a file that"),
    "huge": (lambda env, rec: maax.render(env, recording_frame(rec), size=(9000, 64)), "size: got .* at most 8192"),
    "camera words": (lambda env, rec: maax.replay(env, rec, camera={"azimuth": "north"}), "camera: got .*north"),
    "swapped": (lambda env, rec: maax.replay(rec, env), "env: got Recording; takes an environment"),
    "odd": (lambda env, rec: maax.video(env, rec, "x.mp4", size=(65, 64)), r"size: got \(65, 64\)"),
    "gif fps": (lambda env, rec: maax.video(env, rec, "x.gif", fps=60), "fps: got 60"),
    "speed": (lambda env, rec: maax.replay(env, rec, speed=0), "speed: got 0"),
    "states": (lambda env, rec: maax.replay(env, 3), "states: got int"),
    "batch": (
        lambda env, rec: maax.replay(env, jax.tree.map(lambda x: np.stack([x[0, 0]] * 2), rec.states)),
        "states: got 2 frames, all at step",
    ),
    "empty": (lambda env, rec: maax.replay(env, []), "states: got an empty list"),
    "not states": (lambda env, rec: maax.replay(env, [1, 2]), "states: got a list with int"),
    "one state": (lambda env, rec: maax.video(env, recording_frame(rec), "x.gif"), "states: got one state"),
    "other env": (lambda env, rec: maax.render(maax.make("tag"), recording_frame(rec)), "states: got states of"),
    "vision": (
        lambda env, rec: maax.render(maax.make("tag", impl="c"), recording_frame(rec), vision=True), "vision: got True"
    ),
    "lidar": (
        lambda env, rec: maax.render(maax.make("tag", impl="c"), recording_frame(rec), lidar=True), "lidar: got True"
    ),
    "record worlds": (lambda env, rec: maax.record(env, None, None, 1), "worlds: got"),
    "record swapped": (
        lambda env, rec: maax.record(maax.Worlds(env, 2), lambda state, key: None, rec, 1), "states: got function"
    ),
    "record key": (
        lambda env, rec: (w := three(env)) and maax.record(w, w.reset(seeds.key(0)), None, 1, key=0),
        "key: got 0",
    ),
    "plan's camera": (
        lambda env, rec: maax.render(env, recording_frame(rec), view="plan", camera="side"), "camera: got 'side'"
    ),
    "mixed": (
        lambda env, rec: maax.replay(env, [jax.tree.map(lambda x: x[0], rec.states), recording_frame(rec)]),
        "states: got states of different numbers of worlds",
    ),
    "record policy": (
        lambda env, rec: (w := three(env))
        and maax.record(w, w.reset(seeds.key(0)), lambda state, key: None, 1),
        "policy's action: got NoneType; takes a dict",
    ),
    "record show": (lambda env, rec: maax.record(maax.Worlds(env, 2), None, None, 1, show=5), "show: got 5"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_refused(env, recording, case):
    call, message = WRONG[case]
    with pytest.raises(ValueError, match=message):
        call(env, recording)
