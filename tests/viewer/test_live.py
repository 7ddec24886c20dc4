"""Worlds to play in: keys, what they do, and a page with a person at it."""

from __future__ import annotations

import subprocess
import sys
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from helpers.browser import browser, needs_browser

import maax_mjx as maax
from maax_mjx.training.opponents import SCRIPTED
from maax_mjx.viewer import live as live_module
from maax_mjx.viewer.keyboard import BEGIN, Keyboard
from maax_mjx.viewer.live import Play
from maax_mjx.viewer.steering import Steering, steered

CODES = ("KeyW", "KeyG", "Space")
STEER = ("KeyW", "KeyS", "KeyA", "KeyD", "KeyQ", "KeyE")


@pytest.fixture(scope="module")
def env():
    few = {"scenario": "empty", "p_door_dropout": 0.0, "box_placement": "uniform", "n_boxes": 1, "n_ramps": 1}
    return maax.make("hide_and_seek_quadrant", impl="c", n_frames=2, horizon=300, **few)


@pytest.fixture(scope="module")
def game(env):
    return Play(env, (SCRIPTED["still"], SCRIPTED["still"]), seed=0)


class Server:
    """What a keyboard asks of a server, and nothing else."""

    def __init__(self):
        self.gui = self
        self.field = SimpleNamespace(value="", on_update=lambda function: None)

    def add_text(self, label, value):
        return self.field

    def add_html(self, content):
        self.html = content

    def on_client_disconnect(self, function):
        self.gone = function


def test_a_keyboard_knows_what_is_held_and_what_was_pressed():
    server = Server()
    keyboard = Keyboard(server, CODES)
    keyboard.told(f"{BEGIN} KeyW KeyW:1")
    keyboard.told(f"{BEGIN} KeyW Space KeyZ KeyW:1 Space:1 KeyZ:1")
    assert keyboard.held == {"KeyW", "Space"}, "a key that nobody listens to is not held"
    assert keyboard.pressed() == ["KeyW", "Space"]
    # Texts in between were lost.
    keyboard.told(f"{BEGIN} KeyW:1 Space:4")
    assert keyboard.held == set()
    assert keyboard.pressed() == ["Space"] * 3
    assert keyboard.pressed() == []
    keyboard.told(f"{BEGIN} KeyG KeyG:1", page=1)
    keyboard.told(f"{BEGIN} KeyW KeyW:2 Space:4")
    assert keyboard.pressed() == ["KeyG", "KeyW"]
    assert keyboard.held == {"KeyG", "KeyW"}, "of all pages"
    server.gone(SimpleNamespace(client_id=1))
    assert keyboard.held == {"KeyW"}
    keyboard.told("something that a person typed")
    assert (keyboard.pressed(), server.field.value) == ([], BEGIN)


@pytest.mark.parametrize(
    ("held", "yaw", "forces"),
    [
        ((), 1.0, (0, 0, 0)),
        (("KeyW",), 0.0, (1, 0, 0)),
        (("KeyW",), np.pi / 2, (0, 1, 0)),
        (("KeyA",), 0.0, (0, 1, 0)),
        (("KeyD", "KeyE"), 0.0, (0, -1, -1)),
        (("KeyW", "KeyS"), 0.3, (0, 0, 0)),
        (("KeyW", "KeyA"), 0.0, (np.sqrt(0.5), np.sqrt(0.5), 0)),
        (("KeyW", "KeyG"), np.pi, (-1, 0, 0)),
    ],
)
def test_forces_are_from_where_the_agent_looks(env, held, yaw, forces):
    np.testing.assert_allclose(Steering(env).forces(held, yaw), forces, atol=1e-6)


def test_a_person_plays_one_agent_and_others_the_rest(env):
    steering = Steering(env)
    steering.press("KeyG")
    assert steering.on == {"grab": True, "lock": False}
    drawn = env.sample_action(jax.random.key(0))
    policy = steered(env, steering, lambda state, key, memory, params: (drawn, memory + 1))
    on = {name: jnp.asarray(x) for name, x in steering.on.items()}
    for slot in (-1, 0, 3):
        action, memory = policy(None, None, 1, None, jnp.asarray(slot), jnp.asarray([1.0, 0.0, -1.0]), on)
        assert memory == 2
        assert env.action_space.contains(jax.tree.map(np.asarray, action))
        for name, mine in {"move": [10, 5, 0], "grab": 1, "lock": 0}.items():
            want = np.array(drawn[name])
            if slot >= 0:
                want[slot] = mine
            np.testing.assert_array_equal(action[name], want)
    steering.press("KeyG")
    assert steering.on["grab"] is False


class Turbo(maax.ActionWrapper):
    """Adds two parts of one's own, one of which no key can set."""

    @property
    def action_space(self):
        n = self.n_agents
        own = {"gear": spaces.MultiDiscrete(np.full((n, 2), 5)), "lasso": spaces.MultiBinary((n,))}
        return spaces.Dict({**self.env.action_space.spaces, **own})

    def action(self, state, action):
        return {name: part for name, part in action.items() if name in self.env.action_space.spaces}


def test_a_part_of_ones_own_has_a_key(env):
    steering = Steering(Turbo(env))
    assert steering.switches == {"KeyG": "grab", "KeyL": "lock", "KeyO": "lasso"}, "L, A and S have others"
    assert "**O** lasso on or off" in steering.help
    steering.press("KeyO")
    on = {name: jnp.asarray(x) for name, x in steering.on.items()}
    action = steering.action(jnp.zeros(3), on)
    np.testing.assert_array_equal(action["lasso"], np.ones(env.n_agents))
    np.testing.assert_array_equal(action["gear"], 0)
    assert Turbo(env).action_space.contains(jax.tree.map(np.asarray, action))


@pytest.mark.slow
def test_a_key_moves_one_agent_where_it_looks(env, game):
    def places():
        return np.asarray(game.state.data.xpos)[env.base.agents.body_ids, :2].copy()

    def heading():
        """Where the eyes are: at yaw 0 agents face -y."""
        return float(game.state.data.qpos[env.base.agents.qpos_ids[0, 3]]) - np.pi / 2

    before, ahead = places(), heading()
    for _ in range(4):
        game.step(0, frozenset({"KeyW"}))
    moved = places() - before
    assert moved[0] @ [np.cos(ahead), np.sin(ahead)] > 0.95 * np.linalg.norm(moved[0]) > 0.05
    np.testing.assert_allclose(moved[1:], 0, atol=1e-3)
    game.step(0, frozenset({"KeyQ"}))
    assert heading() - ahead > 0.01
    first = places()
    game.begin(env.default_params)
    assert np.abs(places() - first).max() > 0.1
    assert not game.ended
    steps = 0
    while not game.ended:
        game.step(-1, frozenset())
        steps += game._n_steps
    assert env.base.horizon <= steps < env.base.horizon + game._n_steps
    hiders, seekers = (game.returns[list(team.slots)].mean() for team in env.teams.values())
    assert hiders == -seekers != 0
    assert game.score() == f"hiders {hiders:+.4g}, seekers {seekers:+.4g}"


@pytest.mark.slow
@needs_browser
def test_a_person_plays_with_real_keys(env, tmp_path, game, monkeypatch):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    monkeypatch.setattr(live_module, "Play", lambda *_: game)
    game.begin(env.default_params)

    def place():
        return np.asarray(game.state.data.xpos)[env.base.agents.body_ids[0], :2].copy()

    def until(true, seconds=60.0):
        end = time.perf_counter() + seconds
        while not true():
            assert time.perf_counter() < end
            time.sleep(0.05)

    with maax.play(env, "still", vision=True) as live, browser(tmp_path) as driver:
        panel = live._panel
        driver.set_window_size(600, 700)
        driver.get(live.url)
        until(lambda: driver.find_elements(By.TAG_NAME, "canvas") and panel._words.content == "playing")
        until(lambda: any(one.get_attribute("value") == BEGIN for one in driver.find_elements(By.TAG_NAME, "input")))
        # The page's handlers are there once the image has failed.
        time.sleep(1)
        ActionChains(driver).send_keys(" ").perform()
        until(lambda: panel.paused)
        stands = int(game.state.step)
        time.sleep(0.3)
        assert int(game.state.step) == stands
        ActionChains(driver).send_keys(".").perform()
        until(lambda: int(game.state.step) > stands)
        ActionChains(driver).send_keys("n").perform()
        until(lambda: int(game.state.step) == 0)
        ActionChains(driver).send_keys("g").perform()
        until(lambda: game.steering.on["grab"])
        # While the world stands: hands let go where an episode ends.
        until(lambda: "grab is on" in driver.find_element(By.TAG_NAME, "body").text)
        camera = next(iter(live._server.get_clients().values())).camera
        before, looked_from = place(), np.array(camera.position)
        ActionChains(driver).send_keys(" ").key_down("w").perform()
        until(lambda: "KeyW" in panel.keyboard.held)
        until(lambda: np.abs(place() - before).max() > 0.1)
        ActionChains(driver).key_up("w").perform()
        until(lambda: not panel.keyboard.held)
        np.testing.assert_array_equal(camera.position, looked_from, "W moves viser's camera, but for our keys")
        words = driver.find_element(By.TAG_NAME, "body").text
        assert {"Show vision", "Show lidar", "Next world"} <= set(words.split("\n"))
        assert "Keys that are held" not in words
        # A click on a box leaves the keys as they are, and so does what is written where nobody sees it.
        row = "let x = arguments[0]; while (!x.textContent.includes('Show')) x = x.parentElement; return x.textContent"
        boxes = driver.find_elements(By.CSS_SELECTOR, "input[type=checkbox]")
        (box,) = [one for one in boxes if driver.execute_script(row, one) == "Show lidar"]
        driver.execute_script("arguments[0].focus(); arguments[0].click()", box)
        until(lambda: panel.shows("lidar"))
        panel.keyboard.told("something else")
        ActionChains(driver).key_down("w").perform()
        until(lambda: "KeyW" in panel.keyboard.held)
        driver.refresh()
        until(lambda: not panel.keyboard.held)
        until(
            lambda: (
                "n_boxes" not in driver.find_element(By.TAG_NAME, "body").text and "Next world" in driver.page_source
            )
        )
        assert not panel.changed
        driver.find_element(By.XPATH, "//*[contains(text(), 'Worlds, from')]").click()
        until(lambda: "n_boxes" in driver.find_element(By.TAG_NAME, "body").text)
    assert not live._thread.is_alive()


@pytest.mark.slow
def test_a_script_may_end_without_an_end():
    """Python would crash while the thread is in compiled code."""
    code = """
import time
import maax_mjx as maax
live = maax.play(maax.make("tag", impl="c", n_boxes=0, n_ramps=0, scenario="empty"), "still")
time.sleep(0.5)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")


@pytest.mark.parametrize(
    ("host", "url", "opened"),
    [
        ("127.0.0.1", "http://127.0.0.1:80", False),
        ("127.0.0.2", "http://127.0.0.2:80", False),
        ("localhost", "http://127.0.0.1:80", False),
        ("::1", "http://[::1]:80", False),
        ("0.0.0.0", "http://127.0.0.1:80", True),
    ],
)
def test_addresses(host, url, opened):
    assert (live_module.url_of(host, 80).replace("[::1]", "[::1]"), live_module.is_open(host)) == (url, opened)


def test_what_is_refused(env):
    for argument, value in (
        ("agent", "hider_9"), ("policy", "nobody"), ("opponents", 3), ("opponents", ""), ("seed", -1),
        ("vision", "yes"), ("port", 70000), ("host", "nonsense.invalid"), ("host", 3), ("host", ""),
        ("host", "192.0.2.1"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"{argument}: got"):
            maax.play(env, **{argument: value})
    with pytest.raises(ValueError, match=r"opponents: got 'random', and the game has one team, \['hiders'\]"):
        maax.play(maax.make("lock_all", impl="c"), opponents="random")
    with pytest.raises(ValueError, match="vision: got True, and env has no LineOfSight"):
        maax.play(maax.make("standard", impl="c"), vision=True)
