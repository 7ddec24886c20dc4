"""What is no entity is drawn as it is: the door of `docs/extending/modules.md`, and other things of users."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from helpers.opengl import skipped_without_opengl
from helpers.pages import run
from helpers.plain_mujoco import in_plain_mujoco
from PIL import Image, ImageSequence

import maax_mjx as maax
from maax_mjx.viewer.stage import Stage
from maax_mjx.worldgen import Geom, Material

N_STEPS = 30
ANGLES = (0.4, 1.1)
TALL = 1.2


@pytest.fixture(scope="module")
def game():
    """The page's environment, whose door is taller than any inner wall, and a state of one world."""
    names = run("modules-0")
    return names["env"], maax.world_of(names["states"], 0)


@functools.cache
def pose(env):
    return jax.jit(env.engine.pose)


def at(env, state, angle):
    """The state with the door at an angle."""
    door = env.modules["door"]
    data = state.data.replace(qpos=jnp.asarray(state.data.qpos).at[door.angle].set(angle))
    return state.replace(data=pose(env)(state.world.fields, data))


def brown(image):
    """Pixels of the door, (n, 2) to the right and up."""
    r, g, b = np.moveaxis(np.asarray(image, int), -1, 0)
    y, x = np.nonzero((r > 1.5 * g) & (g > 1.5 * b) & (r > 50))
    return np.stack([x, -y], axis=1).astype(float)


def direction(points):
    """Angle in [0, pi) of the longest extent of points (n, 2)."""
    ways = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    return np.arctan2(ways[1], ways[0]) % np.pi


@pytest.mark.slow
def test_the_door_hangs_in_its_opening_and_moves_as_in_plain_mujoco(game):
    env, state = game
    x, y, width = np.asarray(state.world.plan.doors[0])
    door = env.modules["door"]
    closed = at(env, state, 0.0).data.geom_xpos[env.model.geom("door").id]
    np.testing.assert_allclose(closed, [x, y, TALL / 2 + 0.02], atol=1e-6)
    assert width > 2 * env.model.geom("door").size[0]
    # An agent before the far end of the door, which it pushes open, and the other one out of its way.
    places = jnp.array([[x + 0.15, y - 0.3], [1.0, 1.0]])
    qpos = jnp.asarray(state.data.qpos).at[env.agents.qpos_ids[:, :2]].set(places).at[door.angle].set(0.0)
    state = state.replace(data=state.data.replace(qpos=qpos))
    action = {"move": jnp.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0]])}
    model, data = in_plain_mujoco(env, state)
    step = jax.jit(env.step)
    for _ in range(N_STEPS):
        state = step(state, action)
        data.ctrl[:] = np.ravel(action["move"])
        mujoco.mj_step(model, data, nstep=env.n_frames)
    assert 0.3 < float(state.obs["door_angle"][0]) < np.pi
    np.testing.assert_allclose(state.obs["door_angle"], data.joint("door:hinge").qpos, atol=1e-4)


def test_a_turned_tall_door_is_no_wall(game):
    env, state = game
    for angle in ANGLES:
        frame = Stage(env).frame(jax.device_get(at(env, state, angle)))
        (door,) = (part for part in frame.parts if part.name == "door")
        assert door.role == "object"
        assert door.shape.size == pytest.approx((0.3, 0.03, TALL / 2))
        assert door.shape.rgba == pytest.approx((0.6, 0.3, 0.1, 1.0))
        np.testing.assert_allclose(door.rotation[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-5)
        assert door.position[2] == pytest.approx(TALL / 2 + 0.02)
        assert len(frame.named("high_wall")) == 4
        assert len(frame.named("wall")) == 2


@pytest.mark.parametrize("view", ["plan", "3d"])
def test_its_pixels_lie_as_it_stands(game, view):
    env, state = game
    for angle in ANGLES:
        with skipped_without_opengl():
            image = maax.render(env, at(env, state, angle), view=view, camera="top", size=(400, 400))
        points = brown(image)
        assert len(points) > 40
        assert direction(points) == pytest.approx(angle, abs=0.15)


def test_a_film_shows_it_swinging(game, tmp_path):
    env, state = game
    frames = [at(env, state, angle).replace(step=state.step + i) for i, angle in enumerate(np.linspace(*ANGLES, 5))]
    path = maax.video(env, frames, tmp_path / "door.gif", view="plan", size=(300, 300), fps=50, speed=0.1)
    with Image.open(path) as film:
        shown = [direction(brown(image.convert("RGB"))) for image in ImageSequence.Iterator(film)]
    assert shown[0] == pytest.approx(ANGLES[0], abs=0.15)
    assert shown[-1] == pytest.approx(ANGLES[1], abs=0.15)
    assert len(shown) > 5
    assert (np.diff(shown) > -0.1).all(), "it swings one way"


def test_a_page_shows_it_swinging(game, monkeypatch):
    viser = pytest.importorskip("viser")
    env, state = game
    made = {}
    add = viser.SceneApi.add_box

    def kept(scene, name, **options):
        made[name] = add(scene, name, **options), options
        return made[name][0]

    monkeypatch.setattr(viser.SceneApi, "add_box", kept)
    maax.replay(env, [at(env, state, a).replace(step=state.step + 60 * i) for i, a in enumerate(ANGLES)])
    node, options = made["/world0/door"]
    assert options["dimensions"] == pytest.approx((0.6, 0.06, TALL))
    assert options["color"] == (153, 77, 26)
    # It was made at the first angle, and moved to the last.
    assert 2 * np.arctan2(node.wxyz[3], node.wxyz[0]) == pytest.approx(ANGLES[-1], abs=1e-3)


class Exhibits(maax.Module):
    """A turned crate of two colours, one painted by its material, one that cannot be seen, a marked body, a picture."""

    name = "exhibits"

    def __init__(self, picture):
        self.picture = picture

    def build_step(self, floor, grid_size):
        poster = Geom("box", (0.8, 0.8, 1.2), name="poster").mark_static()
        floor.append(poster.set_material(Material(texture=self.picture)), placement_xy=(0.5, 0.1))

    def spec_step(self, spec):
        spec.add_texture(
            name="chess", type=mujoco.mjtTexture.mjTEXTURE_CUBE, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=(1, 0, 0), rgb2=(0, 0, 1), width=64, height=64,
        )  # fmt: skip
        chess = spec.add_material(name="chess")
        chess.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "chess"
        spec.add_material(name="moss", rgba=(0.1, 0.6, 0.1, 1))
        box = dict(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.4, 0.4, 0.6))
        world = spec.worldbody
        world.add_geom(name="crate", pos=(1.5, 3, 0.6), quat=(0.924, 0, 0, 0.383), material="chess", **box)
        world.add_geom(name="hedge", pos=(3, 3, 0.6), material="moss", **box)
        world.add_geom(name="glass", pos=(4.5, 3, 0.6), rgba=(1, 1, 1, 0), **box)
        body = world.add_body(name="pole", pos=(4.5, 4.5, 0.0), quat=(0.707, 0, 0, 0.707))
        body.add_site(name="tip", pos=(0.5, 0, 0.3), size=(0.1, 0.1, 0.1), rgba=(1, 0, 1, 1))
        spec.geom("floor").rgba = (0.2, 0.2, 0.3, 1)


@pytest.fixture(scope="module")
def exhibits(tmp_path_factory):
    picture = tmp_path_factory.mktemp("pictures") / "halves.png"
    Image.fromarray(np.repeat([[[255, 255, 0]], [[0, 255, 255]]], 32, axis=0).repeat(64, axis=1).astype(np.uint8)).save(
        picture
    )
    env = maax.Base(1, impl="c")
    env.add_module(maax.Agents(1))
    env.add_module(Exhibits(picture))
    return env, env.reset(seeds.key(0))


def test_colours_are_those_of_materials_and_textures(exhibits):
    env, state = exhibits
    frame = Stage(env).frame(jax.device_get(state))
    parts = {part.name: part for part in frame.parts}
    assert "glass" not in parts
    assert parts["hedge"].shape.rgba == pytest.approx((0.1, 0.6, 0.1, 1.0))
    assert parts["crate"].shape.rgba == pytest.approx((0.5, 0.0, 0.5, 1.0), abs=0.01)
    assert parts["poster"].shape.rgba == pytest.approx((0.5, 1.0, 0.5, 1.0), abs=0.01)
    assert frame.floor == pytest.approx((0.2, 0.2, 0.3, 1.0))
    np.testing.assert_allclose(parts["tip:site"].position, [4.5, 5.0, 0.3], atol=1e-3)


def test_an_exported_world_finds_its_picture_from_anywhere(exhibits, monkeypatch, tmp_path):
    env, state = exhibits
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, state))
    assert model.tex_data.tobytes() == env.model.tex_data.tobytes()
    assert model.material("poster").texid.tolist() == env.model.material("poster").texid.tolist()


@pytest.mark.parametrize("view", ["plan", "3d"])
def test_what_is_painted_is_in_the_pixels(exhibits, view):
    """The texture in three dimensions, its mean in a plan; the site, and the floor's own colour, in both."""
    env, state = exhibits
    with skipped_without_opengl():
        image = maax.render(env, state, view=view, camera="top", size=(300, 300)).astype(int)
    r, g, b = np.moveaxis(image, -1, 0)
    reds, blues = ((r > 90) & (g < 40) & (b < 40)).sum(), ((b > 90) & (g < 40) & (r < 40)).sum()
    both = ((r > 90) & (g < 40) & (b > 90)).sum()
    yellows, cyans = (((g > 90) & (x > 90) & (y < 40)).sum() for x, y in ((r, b), (b, r)))
    if view == "3d":
        assert min(reds, blues) > 300
        assert min(yellows, cyans) > 300, "the picture from the file"
    else:
        assert max(reds, blues, yellows, cyans) < 20 < 700 < both
    assert ((g > 1.5 * r) & (g > 1.5 * b) & (g > 60)).sum() > 700, "the hedge"
    assert ((b > r + 8) & (r < 80) & (g < 80) & (abs(r - g) < 8)).sum() > 30_000, "the floor"
