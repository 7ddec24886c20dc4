"""Settings of training, as frozen dataclasses whose fields are overridden by dotted names, and presets of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import gcd
from typing import Annotated, Any

from maax_mjx.common.annotated import Bounds, Fraction, OneOf, Positive, PositiveCount
from maax_mjx.common.checks import check_choice, described
from maax_mjx.tasks.config import Config, override

Discount = Annotated[float, Bounds(0, 1)]


@dataclass(frozen=True)
class PPOConfig(Config):
    """Proximal policy optimisation (Schulman et al. 2017), with chunks of episodes for networks with a memory.

    Attributes:
        unroll: env steps of every world in one iteration.
        chunk: steps through which gradients flow back in time; divides `unroll`.
        epochs: times that every step is used.
        minibatches: parts of an iteration's steps, each one update of the parameters.
        microbatches: parts of a minibatch whose gradients are added up; they bound the memory, and change nothing else.
        lr: learning rate of Adam.
        gamma: discount per env step.
        lam: lambda of generalised advantage estimation.
        clip: how far the probability of an action may move from 1 times that with which it was taken.
        entropy: weight of the policy's entropy, summed over the parts of an action.
        value: weight of the critic's squared error, in the scale of its targets.
        max_grad: greatest norm of the gradient.
        advantage: whether advantages are standardised per "team" or over "all" agents.
        stop_kl: approximate KL divergence of a minibatch beyond which an iteration makes no more updates; None never
            stops.
        waiting: whether the policy learns from steps in which an agent cannot act, such as those of seekers in the
            preparation; its critic always does.
        bootstrap: "end" if the horizon is the end of the game, "horizon" if it only cuts the episode off, which an
            endless game does not take.
    """

    unroll: PositiveCount = 40
    chunk: PositiveCount = 20
    epochs: PositiveCount = 2
    minibatches: PositiveCount = 16
    microbatches: PositiveCount = 1
    lr: Positive = 3e-4
    gamma: Discount = 0.998
    lam: Fraction = 0.95
    clip: Positive = 0.2
    entropy: Annotated[float, Bounds(0)] = 0.01
    value: Positive = 0.5
    max_grad: Positive = 5.0
    advantage: Annotated[str, OneOf(("team", "all"))] = "team"
    stop_kl: Positive | None = 0.05
    waiting: bool = False
    bootstrap: Annotated[str, OneOf(("end", "horizon"))] = "end"


@dataclass(frozen=True)
class NetConfig(Config):
    """The networks: an actor and a critic of the same form, with parameters of their own.

    Attributes:
        encoder: "flat" joins all arrays; "pool" embeds every entity and takes the mean and the greatest over those that
            are seen; "attend" lets them attend to each other first, as in Baker et al.
        core: "none", "gru" or "lstm", what remembers.
        width: numbers per embedded entity.
        heads: of attention; a divisor of `width`.
        hidden: numbers of the layers after the entities, and of the memory.
        share: "all" agents have one set of parameters, or every "team" has its own.
        norm: "scales" divides observations by the scales of their columns; "running" also by their running moments.
        compute: type of the layers after the first ones.
    """

    encoder: Annotated[str, OneOf(("flat", "pool", "attend"))] = "pool"
    core: Annotated[str, OneOf(("none", "gru", "lstm"))] = "lstm"
    width: PositiveCount = 128
    heads: PositiveCount = 4
    hidden: PositiveCount = 256
    share: Annotated[str, OneOf(("all", "team"))] = "all"
    norm: Annotated[str, OneOf(("scales", "running"))] = "scales"
    compute: Annotated[str, OneOf(("float32", "bfloat16"))] = "float32"


@dataclass(frozen=True)
class LeagueConfig(Config):
    """Past opponents: some worlds in which one team is played by an earlier policy of the run.

    Attributes:
        share: share of the worlds, in whole worlds of each device and policy; 0 is Baker et al.'s self-play.
        groups: earlier policies at once; fewer where the share has fewer worlds on a device.
        every: iterations between those that are kept.
        keep: number that is kept.
    """

    share: Fraction = 0.0
    groups: PositiveCount = 4
    every: PositiveCount = 50
    keep: PositiveCount = 16

    def at_once(self, n_worlds: int) -> int:
        """Returns how many earlier policies play at once in the worlds of a device."""
        return min(self.groups, round(self.share * n_worlds))


@dataclass(frozen=True)
class VisitedConfig(Config):
    """Visited states as beginnings: some episodes begin in the middle of earlier ones, where the critic was wrong.

    Attributes:
        share: share of the episodes that begin so; 0 is without. Metrics of episodes are those of the others.
        size: states that are kept, on all devices together.
        stay: iterations for which a state is kept; `size / stay` new ones come with every iteration.
    """

    share: Annotated[float, Bounds(0, 0.9)] = 0.0
    size: PositiveCount = 8192
    stay: PositiveCount = 16


@dataclass(frozen=True)
class TrainConfig(Config):
    """All settings of a run but its game.

    Attributes:
        worlds: number of worlds on all devices together.
        save_minutes: minutes between saves.
        save_worlds: whether saves have the worlds as well, so that the run goes on bit for bit; the
            state of a world and its next episode take some 13 kB in `hide_and_seek_quadrant`.
        tensorboard: whether metrics are written for TensorBoard as well, with the extra "tensorboard".
        ppo: see there.
        net: see there.
        league: see there.
        visited: see there.
        env: fields of the game's config that the preset sets, where the game has them.
    """

    worlds: PositiveCount = 16_384
    save_minutes: Positive = 5.0
    save_worlds: bool = True
    tensorboard: bool = False
    ppo: PPOConfig = PPOConfig()
    net: NetConfig = NetConfig()
    league: LeagueConfig = LeagueConfig()
    visited: VisitedConfig = VisitedConfig()
    env: Mapping[str, Any] = field(default_factory=dict)


GROUPS = tuple(part.name for part in fields(TrainConfig) if isinstance(part.default, Config))
"""Names of the groups of settings, which are set as in --ppo.lr 3e-4."""

EGO = {"observations": "ego", "observe": "all", "boxsize_obs": True}
PRESETS: dict[str, TrainConfig] = {
    # However many samples an iteration has, clipping seems to let the policy move only so far in it: so they are short.
    # On the quadrant these settings together learnt from about half of the samples of those before (docs/emergence.md).
    "gpu": TrainConfig(
        worlds=65_536,
        ppo=PPOConfig(unroll=8, chunk=8, minibatches=16, lr=5e-4, gamma=0.98, entropy=0.003),
        net=NetConfig(compute="bfloat16"),
        env=EGO,
    ),
    "laptop": TrainConfig(
        worlds=32,
        save_minutes=1.0,
        # On the quadrant, in five minutes, a short horizon and little entropy did more than a memory. Parameters per
        # team and past opponents keep seekers from learning to find their trained hiders alone.
        ppo=PPOConfig(unroll=40, chunk=20, epochs=2, minibatches=4, lr=1e-3, gamma=0.95, lam=0.9, entropy=0.003),
        net=NetConfig(core="none", share="team", width=32, hidden=64),
        league=LeagueConfig(share=0.25, every=25),
        visited=VisitedConfig(size=256),
        env=EGO | {"impl": "c"},
    ),
    "baker": TrainConfig(
        ppo=PPOConfig(unroll=160, chunk=10, epochs=1, minibatches=4, advantage="all", stop_kl=None),
        net=NetConfig(encoder="attend", norm="running"),
        env={"observations": "split", "observe": "all", "boxsize_obs": True},
    ),
}
"""Settings by name: for a GPU, for a laptop, and those of Baker et al."""


def preset(name: str, overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Returns the settings of a preset, with some changed.

    Args:
        name: "gpu", "laptop", or "baker", the published network and settings.
        overrides: values by dotted name, such as {"ppo.lr": 1e-4}.

    Raises:
        ValueError: an unknown name, or a value that a field does not allow.
    """
    if overrides is not None and not isinstance(overrides, Mapping):
        raise ValueError(f"overrides: got {described(overrides)}; takes values by dotted name, {{'ppo.lr': 1e-4}}")
    return override(PRESETS[check_choice("preset", name, PRESETS)], dict(overrides or {}), f"preset {name}")


def check_divides(config: TrainConfig, n_devices: int) -> int:
    """Returns how many groups of worlds are shuffled apart, so that minibatches are alike on any number of devices.

    Raises:
        ValueError: numbers that do not divide what they must: chunks, heads, and worlds that do not fall into equal
            minibatches on all devices; a share of past opponents that rounds to no world of a device; and
            visited states of which no equal number comes with every iteration on every device, or more than there are
            worlds.
    """
    ppo, net, visited = config.ppo, config.net, config.visited
    if visited.share and (visited.size % (n_devices * visited.stay) or visited.size // visited.stay > config.worlds):
        raise ValueError(
            f"visited.size: got {visited.size} with visited.stay {visited.stay} and {config.worlds} worlds on "
            f"{n_devices} devices; takes a multiple of stay and devices, at most stay times the worlds"
        )
    if ppo.unroll % ppo.chunk:
        raise ValueError(f"ppo.chunk: got {ppo.chunk}; takes a divisor of ppo.unroll, {ppo.unroll}")
    if net.width % net.heads:
        raise ValueError(f"net.heads: got {net.heads}; takes a divisor of net.width, {net.width}")
    rows = config.worlds * (ppo.unroll // ppo.chunk)
    parts = ppo.minibatches * ppo.microbatches
    each = n_devices * parts
    if config.worlds % n_devices:
        raise ValueError(f"worlds: got {config.worlds}; takes a multiple of the number of devices, {n_devices}")
    if rows % each:
        raise ValueError(
            f"worlds: got {config.worlds} with ppo.minibatches={ppo.minibatches}, ppo.microbatches={ppo.microbatches} "
            f"and devices={n_devices}, into which the {rows} chunks of an iteration do not go; takes a multiple of "
            f"{each // gcd(each, ppo.unroll // ppo.chunk)}, or another ppo.minibatches"
        )
    per_device = config.worlds // n_devices
    if config.league.share and not config.league.at_once(per_device):
        raise ValueError(
            f"league.share: got {config.league.share}, which of {per_device} worlds on each device is none; takes 0, a "
            "greater share, or more worlds"
        )
    return n_devices * gcd(64 // gcd(64, n_devices), rows // each, config.worlds // n_devices)
