"""Policies: trained networks that play, in one file each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import jax
import jax.numpy as jnp
import numpy as np
from flax import serialization

from maax_mjx.common.checks import described, suggestion
from maax_mjx.common.recorded import short
from maax_mjx.common.whole import whole
from maax_mjx.core.env import Environment
from maax_mjx.core.identity import about_game
from maax_mjx.core.state import State
from maax_mjx.tasks.config import with_tuples
from maax_mjx.training.actions import Head, mode, sample
from maax_mjx.training.config import NetConfig
from maax_mjx.training.network import Network, Weights
from maax_mjx.training.openai import OpenAIPolicy
from maax_mjx.training.shipped import file_of, policies
from maax_mjx.training.spec import Kind, Part, Spec
from maax_mjx.training.trained import TrainedPolicy

MAGIC, FORMAT = "maax_mjx policy", 1


@dataclass(frozen=True)
class Play:
    """A network as a policy of one world, `(state, key, memory, weights) -> (action, memory)`; equal ones compile once.

    Attributes:
        network: the network.
        deterministic: whether it takes the most likely action instead of drawing one.
    """

    network: Network
    deterministic: bool = False

    def __call__(self, state: State, key: jax.Array, memory: jax.Array, weights: Weights) -> tuple[Any, jax.Array]:
        features = jax.tree.map(lambda x: x[None, None], self.network.spec.features(state.obs))
        out, after = self.network.actor(weights, features, memory[None], jnp.zeros((1, 1), bool))
        out = jax.tree.map(lambda x: x[0, 0], out)
        choose = mode if self.deterministic else partial(sample, key=key)
        return choose(self.network.heads, out), after[0]


class Policy(TrainedPolicy):
    """A trained policy: its network, its weights and the game that it learnt.

    It plays wherever policies are taken, `worlds.rollout(states, policy, 80)`, `maax.record(...)`; its memory is looked
    after.

    Args:
        network: the network.
        weights: its weights; without those of a critic it plays, but does not learn on.
        game: name and config of the game, as `Checkpoints.about` has them; None if `maax.make` did not make it.
        steps: env steps that it learnt from.
        deterministic: whether it takes the most likely action instead of drawing one.
    """

    play: Play

    def __init__(
        self,
        network: Network,
        weights: Weights,
        game: Mapping[str, Any] | None = None,
        steps: int = 0,
        deterministic: bool = False,
    ):
        self.network, self.params, self.steps = network, weights, steps
        self.game = dict(game) if game else None
        self.play = Play(network, deterministic)

    def __repr__(self) -> str:
        game = self.game["game"] if self.game else "a game of one's own"
        return f"<Policy of {game} after {self.steps:,} steps: {self.network.net.encoder}, {self.network.net.core}>"

    def memory(self, n_worlds: int) -> np.ndarray:
        """Returns what it remembers at the beginning of episodes, (n_worlds, n_agents, m)."""
        shape = jax.eval_shape(lambda: self.network.memory(n_worlds).actor)
        return np.zeros(shape.shape, shape.dtype)

    def greedy(self) -> Policy:
        """Returns the policy that takes the most likely actions."""
        return Policy(self.network, self.params, self.game, self.steps, deterministic=True)

    def on(self, env: Environment) -> Policy:
        """Returns the policy as it plays another environment, with the same columns and actions.

        It reads numbers in the scales that it learnt.

        Raises:
            ValueError: an environment with other columns, actions or teams; the message names the first that differs.
        """
        other = Network.of(env, self.network.net)
        other = replace(other, spec=other.spec.in_scales_of(self.network.spec))
        if other == self.network:
            return self
        try:
            check_fits(self.network, other)
        except ValueError as error:
            if self.game is None:
                raise
            made, learnt = env.made_from, self.game["game"]
            here = f" plays {made.name}" if made and made.name != learnt else ""
            raise ValueError(
                f"policy: got one that learnt {learnt}, and env{here or ' observes or acts otherwise'}: "
                f"{str(error).removeprefix('policy: ')}; policy.make_env() makes its own"
            ) from None
        return Policy(other, self.params, self.game, self.steps, self.play.deterministic)

    def save(self, path: str | Path, small: bool = False) -> None:
        """Writes it to one file, completely or not at all.

        Args:
            path: the file, such as "quad.policy".
            small: whether to leave out the critic and to write numbers of 16 bits, in a quarter of the bytes: such a
                policy plays, and a run that begins with it draws a new critic.
        """
        header = {"magic": MAGIC, "format": FORMAT, "game": self.game, "steps": self.steps}
        header["network"] = asdict(self.network)
        host = jax.tree.map(np.asarray, self.params)
        if small:
            # Moments stay as they are: variances are small differences of them.
            half = jax.tree.map(lambda x: x.astype(np.float16), host.actor)
            host = host.replace(actor=half, critic={})
        data: dict[str, Any] = {"header": json.dumps(header), "weights": serialization.to_state_dict(host)}
        data["sum"] = _sum(data)
        with whole(Path(path)) as part:
            part.write_bytes(serialization.msgpack_serialize(data))

    @staticmethod
    def from_openai(path: str | Path) -> OpenAIPolicy:
        """Reads a policy that Baker et al. published; it plays hide and seek or a transfer task, and does not learn on.

        Args:
            path: file of weights, such as "hide_and_seek_full.npz"; nothing in it is unpickled.

        Raises:
            ValueError: another file, or one without a network of the published games and tasks.
        """
        return OpenAIPolicy.read(path)

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Reads a file that `save` wrote, the newest policy of a run's folder, or one that comes with the package.

        Args:
            path: the file, the folder of a run, or one of `training.policies()`.

        Raises:
            ValueError: no such file, another one, or a damaged one.
        """
        if not isinstance(path, str | Path):
            raise ValueError(f"path: got {described(path)}; {_takes()}")
        path = file_of(Path(path))
        if path.is_dir() and not (path / "policy").exists():
            raise ValueError(f"path: got {str(path)!r}, a folder without a policy; {_takes()}")
        path = path / "policy" if path.is_dir() else path
        try:
            data = serialization.msgpack_restore(path.read_bytes())
            header = json.loads(data["header"])
            if header["magic"] != MAGIC:
                raise ValueError("another kind of file")
            # Files of before there were sums have none.
            if data.get("sum", _sum(data)) != _sum(data):
                raise ValueError("its bytes are not those that were written")
            network = _network_of(header["network"])
            weights = _restored(network, data["weights"])
        except FileNotFoundError:
            past = "" if "@" not in str(path) else ", and past policies are for evaluate, or files in the run's past/"
            meant = suggestion(path, policies())
            raise ValueError(f"path: got {str(path)!r}, which is not there{past}{meant}; {_takes()}") from None
        # Damaged bytes make msgpack and JSON raise errors of many kinds.
        except Exception as error:
            raise ValueError(
                f"path: got {path}, which is no policy, or damaged ({short(str(error))}); {_takes()}"
            ) from None
        if header["format"] != FORMAT:
            raise ValueError(f"path: got {path} of format {header['format']}; takes format {FORMAT}")
        return cls(network, weights, header["game"], header["steps"])


def _sum(data: Mapping[str, Any]) -> int:
    """Returns the checksum of what a file has."""
    return crc32(serialization.msgpack_serialize({name: data[name] for name in ("header", "weights")}))


def _takes() -> str:
    return f"takes a file that Policy.save wrote, the folder of a run, or one of {list(policies())}"


def check_fits(mine: Network, other: Network) -> None:
    """Refuses networks whose parameters do not fit each other's environments.

    Raises:
        ValueError: other columns, actions or teams.
    """
    here, there = mine.spec.columns(), other.spec.columns()
    for name in sorted({*here, *there}):
        if here.get(name) != there.get(name):
            raise ValueError(
                f"policy: it reads {_columns(here.get(name))} of {name!r}, and env has {_columns(there.get(name))}; "
                "takes an environment with the same columns"
            )
    for kind, new in zip(mine.spec.kinds, other.spec.kinds, strict=True):
        if kind.n != new.n and mine.net.encoder == "flat":
            raise ValueError(
                f"policy: its encoder is 'flat' and reads {kind.n} entities of {kind.name!r}, and env has {new.n}; "
                "takes as many, or a policy that pools or attends"
            )
    if mine.spec.n_rays != other.spec.n_rays:
        raise ValueError(
            f"policy: it reads {mine.spec.n_rays} rays, and env has {other.spec.n_rays}; takes as many, lidar.n_rays"
        )
    for name in sorted({head.name for head in (*mine.heads, *other.heads)}):
        ours, theirs = (next((h for h in of.heads if h.name == name), None) for of in (mine, other))
        if ours is None or theirs is None or not _alike(ours, theirs):
            raise ValueError(
                f"policy: it decides {_choices(ours)} of {name!r}, and env has {_choices(theirs)}; takes an "
                "environment with the same actions"
            )
    if [name for name, _ in mine.groups] != [name for name, _ in other.groups]:
        raise ValueError(
            f"policy: it has parameters for {[name for name, _ in mine.groups]}, and env has the teams "
            f"{[name for name, _ in other.teams]}; takes an environment with the same teams"
        )


def _alike(a: Head, b: Head) -> bool:
    """Whether two parts of an action are decided by the same parameters; those about entities by any number."""
    return a.bins == b.bins and bool(a.kinds) == bool(b.kinds) and (a.n == b.n or bool(a.kinds))


def _columns(names: tuple[str, ...] | None) -> str:
    if names is None:
        return "nothing"
    return f"{len(names)} {'column' if len(names) == 1 else 'columns'} ({', '.join(names)})"


def _choices(head: Head | None) -> str:
    if head is None:
        return "nothing"
    return f"{head.n} choices of {head.bins}" if head.bins else f"{head.n} numbers"


def game_of(env: Environment) -> dict[str, Any] | None:
    """Returns an environment's game, as `about_game` has it; None if it was not made by name."""
    return None if env.made is None else about_game(env.made)


def _network_of(fields: dict[str, Any]) -> Network:
    spec = fields["spec"]
    kinds = tuple(Kind(**{**kind, "parts": _parts(kind["parts"])}) for kind in spec["kinds"])
    read = Spec(_parts(spec["own"]), _parts(spec["rays"]), _parts(spec["critic"]), kinds, spec["n_rays"])
    heads = tuple(_made(Head, head) for head in fields["heads"])
    teams = tuple((name, tuple(slots)) for name, slots in fields["teams"])
    return Network(read, heads, NetConfig(**fields["net"]), teams)


def _parts(parts: list[dict[str, Any]]) -> tuple[Part, ...]:
    return tuple(_made(Part, part) for part in parts)


def _made(kind: type, fields: dict[str, Any]) -> Any:
    return kind(**{name: with_tuples(value) for name, value in fields.items()})


def _restored(network: Network, saved: dict[str, Any]) -> Weights:
    """Returns weights of the network's shapes.

    Raises:
        ValueError: other shapes.
    """
    template = jax.eval_shape(network.draw, jax.random.key(0))
    if not saved["critic"]:
        template = template.replace(critic={})
    weights = serialization.from_state_dict(template, saved)
    for (path, x), wanted in zip(jax.tree.leaves_with_path(weights), jax.tree.leaves(template), strict=True):
        if np.shape(x) != wanted.shape:
            raise ValueError(f"{jax.tree_util.keystr(path)} has shape {np.shape(x)}, not {wanted.shape}")
    return jax.tree.map(lambda x, wanted: np.asarray(x, wanted.dtype), weights, template)


def policy_of(given: Any, argument: str) -> Policy:
    """Returns a policy that can learn on, from its file or name if that is given.

    Raises:
        ValueError: something else.
    """
    policy = check_trained(load_any(given, argument) if isinstance(given, str | Path) else given, argument)
    if not isinstance(policy, Policy):
        raise ValueError(
            f"{argument}: got {policy!r}, which plays and does not learn on; takes a training.Policy, such as "
            "Policy.load(path)"
        )
    return policy


def check_trained(policy: Any, argument: str = "policy") -> TrainedPolicy:
    """Refuses what is no trained policy.

    Raises:
        ValueError: something else.
    """
    if not isinstance(policy, TrainedPolicy):
        raise ValueError(f"{argument}: got {described(policy)}; takes a training.Policy, such as Policy.load(path)")
    return policy


def load_any(path: str | Path, argument: str) -> TrainedPolicy:
    """Reads a policy that plays: what `Policy.load` takes, or a published file .npz.

    Raises:
        ValueError: no policy; the message begins with the name of the argument.
    """
    try:
        return Policy.from_openai(path) if Path(path).suffix == ".npz" else Policy.load(path)
    except ValueError as error:
        raise ValueError(f"{argument}{str(error).removeprefix('path')}") from None
