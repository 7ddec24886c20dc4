"""A world to play in: a page in which a person steers an agent, against policies or beside them, in real time."""

from __future__ import annotations

import atexit
import ipaddress
import socket
import time
from threading import Event, Thread
from typing import Annotated, Any, Self

import jax
import numpy as np

from maax_mjx.common.annotated import Bounds, check_value
from maax_mjx.common.checks import LONG, check_bool, check_choice
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.export import world_of
from maax_mjx.core.state import State
from maax_mjx.parallel import Worlds, WorldsState
from maax_mjx.training.evaluate import Versus, player_of, seated
from maax_mjx.viewer.between import between
from maax_mjx.viewer.camera import place_camera
from maax_mjx.viewer.nodes import HERE, Nodes, open_server, stop_server
from maax_mjx.viewer.panel import NOBODY, Panel
from maax_mjx.viewer.stage import Stage
from maax_mjx.viewer.steering import WAYS, Steering, steered

FPS = 30
HEIGHT = 600
SHAPE_OF_PAGE = (11, 10)
"""Without the controls on its right."""
IDLE = 0.03
"""Seconds between looks at the controls while the world stands still."""
REST = 1.5
"""Seconds for which the end of an episode is shown."""
SENSES = ("vision", "lidar")
ORIGIN = np.zeros(3)


def play(
    env: Environment,
    policy: Any = "random",
    opponents: Any = None,
    *,
    agent: str | None = None,
    seed: int = 0,
    vision: bool = False,
    lidar: bool = False,
    host: str = HERE,
    port: int = 0,
) -> Live:
    """Opens a page in which a person steers an agent by keyboard, in real time.

    W, A, S and D move the agent from where it looks, Q and E turn it, G and L turn grabbing and locking on and off;
    Space pauses, the full stop makes one step, N goes to the next world. Beside the world are the same as buttons, who
    is steered, what is shown, and the ranges that worlds are drawn from.

    Example:
        ```python
        live = maax.play(maax.make("hide_and_seek_quadrant", impl="c"), policy="chase")
        print(live.url)  # in a notebook the last line `live` shows the page
        ```

    Args:
        env: the environment; the engine `c` is the quickest for one world.
        policy: who plays the other agents: a `training.Policy`, a file, the folder of a run, the name of one that
            comes with the package, or a scripted one such as "random", "still" and "chase".
        opponents: who plays the other teams; None is `policy`.
        agent: who is steered first, such as "seeker_0", or "nobody"; None is the first one.
        seed: of the worlds and of the others' actions.
        vision: whether to show who sees where and whom, at first; only of games with `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, at first; likewise.
        host: the address that the page is served at; the default is for this machine alone. With "0.0.0.0" whoever
            reaches this machine can watch and steer, without a password.
        port: of the page, or the next one that is free; 0 takes any free one.

    Raises:
        ValueError: an argument out of its range, an address that is not of this machine, or a policy that does not fit.
        MissingLibraryError: viser is not installed.
    """
    check_environment(env)
    names = [*env.agent_names, NOBODY]
    agent = names[0] if agent is None else check_choice("agent", agent, names)
    seed = check_value("seed", seed, Annotated[int, Bounds(0, LONG)])
    port = check_value("port", port, Annotated[int, Bounds(0, 65535)])
    shown = {"vision": check_bool("vision", vision), "lidar": check_bool("lidar", lidar)}
    for name in [name for name, on in shown.items() if on]:
        Stage(env, **{name: True})
    mine = player_of("policy", policy)
    theirs = mine if opponents is None else player_of("opponents", opponents)
    if opponents is not None and len(env.teams) < 2:
        raise ValueError(f"opponents: got {opponents!r}, and the game has one team, {[*env.teams]}; takes None there")
    check_host(host)
    server = open_server("play", host, port)
    try:
        return Live(Play(env, (mine, theirs), seed), agent, shown, server)
    except BaseException:
        stop_server(server)
        raise


def check_host(host: Any) -> str:
    """Returns an address if this machine can listen at it.

    Raises:
        ValueError: no text, or another machine's.
    """
    takes = f"takes an address of this machine, such as {HERE}, or 0.0.0.0 for all of them"
    if not isinstance(host, str) or not host:
        raise ValueError(f"host: got {host!r}; {takes}")
    try:
        kind, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(kind, socket.SOCK_STREAM) as probe:
            probe.bind(address)
    except OSError as error:
        raise ValueError(f"host: got {host!r}, where nothing can be served ({error}); {takes}") from None
    return host


def is_open(host: str) -> bool:
    """Whether others than this machine can reach an address of it."""
    return not _address(host).is_loopback


def url_of(host: str, port: int) -> str:
    """The page's address on this machine."""
    found = _address(host)
    # What listens at all addresses is reached at this machine's own.
    where = HERE if found.is_unspecified else str(found)
    return f"http://[{where}]:{port}" if ":" in where else f"http://{where}:{port}"


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The number of an address of this machine."""
    return ipaddress.ip_address(socket.getaddrinfo(host, 0)[0][4][0])


class Play:
    """A world that a person plays in, without its page.

    Args:
        env: the environment.
        others: who plays the person's team, and who the others.
        seed: of the worlds and of the others' actions.

    Attributes:
        env: the environment.
        steering: what keys do.
        seconds: of the world in a `step`, in which a picture lasts.
        state: the world of now, on the host.
        ended: whether the last step ended an episode.
        returns: (n_agents,) of the episode so far, or of the one that has ended.
    """

    def __init__(self, env: Environment, others: tuple[Any, Any], seed: int):
        self.env, self.steering = env, Steering(env)
        mine, theirs = (seated(one, env) for one in others)
        self._policy = steered(env, self.steering, Versus(mine.play, theirs.play))
        self._params = mine.params, theirs.params
        self._worlds = Worlds(env, 1)
        self._forgotten = lambda: self._worlds.shards.put((mine.memory(1), theirs.memory(1)))
        self._n_steps = max(1, round(1 / (FPS * env.base.dt)))
        self.seconds = self._n_steps * env.base.dt
        self._key, self._count = jax.random.key(seed), 0
        self._teams = np.zeros(env.n_agents, int)
        for i, team in enumerate(env.teams.values()):
            self._teams[list(team.slots)] = i
        self.begin(env.default_params)
        # Compiles it all, before there is a page to wait in front of.
        self.step(-1, frozenset())
        self.begin(env.default_params)

    def begin(self, params: Any) -> None:
        """Goes to the next world."""
        self._states = self._worlds.reset(self._next_key(), params)
        self._memory = self._forgotten()
        self._look(self._states)
        self.steering.release()

    def step(self, slot: int, held: frozenset[str]) -> None:
        """Lets time pass, as long as a picture lasts.

        Args:
            slot: of the person's agent; -1 is nobody.
            held: the keys that are held.
        """
        heading = float(self.env.base.agents.headings(self.state.data)[slot])
        on = {name: np.asarray(x) for name, x in self.steering.on.items()}
        mine = self._teams == self._teams[slot]
        person = np.asarray(slot), self.steering.forces(held, heading), on
        states, kept = self._worlds.rollout(
            self._states,
            self._policy,
            self._n_steps,
            (*self._params, mine),
            *person,
            key=self._next_key(),
            keep=("terminated", "truncated", "episode_return"),
            memory=self._memory,
        )
        self._states, self._memory = states, kept["memory"]
        ended = np.asarray(kept["terminated"] | kept["truncated"])[:, 0]
        self._look(states)
        if ended.any():
            self.ended, self.returns = True, np.asarray(kept["episode_return"])[ended.argmax(), 0]

    def score(self) -> str:
        """What every team has got, as the mean of its agents."""
        return ", ".join(
            f"{name} {self.returns[list(team.slots)].mean():+.4g}" for name, team in self.env.teams.items()
        )

    def _look(self, states: WorldsState) -> None:
        self.state: State = world_of(states, 0)
        self.ended, self.returns = False, np.asarray(states.episode_return)[0]

    def _next_key(self) -> jax.Array:
        self._count += 1
        return jax.random.fold_in(self._key, self._count)


class Live:
    """A page that is played in; `stop()` ends it, `wait()` waits until it is ended.

    Attributes:
        game: the world.
        url: where the page is, on this machine.
        port: its port.
    """

    def __init__(self, game: Play, agent: str, shown: dict[str, bool], server: Any):
        env = game.env
        self.game, self._server = game, server
        self.port = server.get_port()
        self.url = url_of(server.get_host(), self.port)
        self._stages: dict[tuple[str, ...], Stage] = {(): Stage(env)}
        self._panel = Panel(
            server,
            env.agent_names,
            agent,
            env.base.parameters.values(),
            env.default_params,
            {name: on for name, on in shown.items() if self._stage((name,)) is not None},
            [*WAYS, *game.steering.switches],
            game.steering.help,
        )
        edge = env.base.floor_size
        camera = place_camera("default", np.array([edge, edge]), SHAPE_OF_PAGE)
        self._nodes = Nodes(server, self._stages[()], camera, shadows=True)
        self._stopped = Event()
        self._error: Exception | None = None
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()
        # Python must not end while the thread is in compiled code.
        atexit.register(self.stop)

    def _stage(self, senses: tuple[str, ...]) -> Stage | None:
        """A stage that shows senses; None if the environment has not got them."""
        if senses not in self._stages:
            try:
                self._stages[senses] = Stage(self.game.env, **dict.fromkeys(senses, True))
            except ValueError:
                return None
        return self._stages[senses]

    def _run(self) -> None:
        try:
            while not self._stopped.is_set():
                self._turn()
        except Exception as error:  # told by `wait`, in the thread that asks
            self._error = error
            self._panel.say(f"Stopped: {error}")
            self._stopped.set()

    def _turn(self) -> None:
        """Looks at the controls, lets time pass if it is to, and shows the world."""
        game, panel = self.game, self._panel
        for key in panel.keyboard.pressed():
            game.steering.press(key)
            panel.press(key)
        if panel.next_world() or (game.ended and panel.changed):
            self._nodes.clear()
            game.begin(panel.params())
        begun = time.perf_counter()
        if not panel.steps():
            self._show(game.state)
            self._stopped.wait(IDLE)
            return
        before = game.state
        game.step(panel.slot, panel.keyboard.held)
        if game.ended:
            game.steering.release()
            panel.say(f"**The episode is over**: an agent of {game.score()}")
            self._stopped.wait(REST)
            self._nodes.clear()
            return
        # A picture is a step behind, so that what moves does so smoothly.
        pictures = max(1, round(game.seconds * FPS))
        for i in range(1, pictures + 1):
            self._show(between(before, game.state, i / pictures))
            self._stopped.wait(max(begun + game.seconds * i / pictures - time.perf_counter(), 0.0))

    def _show(self, state: State) -> None:
        panel, on = self._panel, self.game.steering.on
        stage = self._stage(tuple(name for name in SENSES if panel.shows(name)))
        assert stage is not None
        frame = stage.frame(state, self.game.returns)
        if panel.slot >= 0:
            name = self.game.env.agent_names[panel.slot]
            labels = [x._replace(text=f"{name}, you") if x.text == name else x for x in frame.labels]
            frame = frame._replace(labels=labels)
        self._nodes.show(0, frame, ORIGIN)
        self._nodes.next()
        said = [f"**{name} is on**" for name, is_on in on.items() if is_on] + ["paused"] * panel.paused
        if panel.slot >= 0 and not state.active[panel.slot]:
            said = [f"{self.game.env.agent_names[panel.slot]} is not in this world", *said]
        panel.say(", ".join(said) or "playing")

    def wait(self, seconds: float | None = None) -> None:
        """Waits until the page is ended, for so long at most.

        Raises:
            Exception: what ended it, if it was no call of `stop`.
        """
        self._stopped.wait(seconds)
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Ends the page."""
        atexit.unregister(self.stop)
        self._stopped.set()
        self._thread.join()
        stop_server(self._server)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _repr_html_(self) -> str:
        if self._stopped.is_set():
            return "stopped"
        return f'<iframe src="{self.url}" width="100%" height="{HEIGHT}" style="border: 1px solid #ddd"></iframe>'

    def __repr__(self) -> str:
        return f"Live({self.url}; {'stopped' if self._stopped.is_set() else '.stop() ends it'})"
