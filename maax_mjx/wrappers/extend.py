"""Environments with more modules and layers put in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from typing import Any

from maax_mjx.common.annotated import check_value
from maax_mjx.common.checks import check_choice, described
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.modules import Module
from maax_mjx.wrappers.wrapper import Wrapper

LayerFn = Callable[[Any], Environment]
"""What puts a layer around an environment: a wrapper's class, or a function of an environment."""
Layers = Mapping[str, LayerFn | Sequence[LayerFn]]
"""Layers by the layer that they are put next to."""


def extended(
    env: Environment, modules: Sequence[Module] = (), inside: Layers | None = None, outside: Layers | None = None
) -> Environment:
    """Makes an environment like another, with more modules and layers.

    All layers are made again, each around the one below it, so that each knows what was put in; their order is checked
    as always. The given environment and modules stay as they are.

    Example:
        ```python
        env = maax.extended(env, [Door()], inside={"HideAndSeekReward": Flashlight})
        ```

    Args:
        env: the environment.
        modules: copies of these are added after its own.
        inside: by the name of a layer in `env.layers`, its class's or its own such as "locks", the layers to put right
            inside of it, the innermost first.
        outside: the same, right outside of it.

    Raises:
        ValueError: an argument of another type, a name of no layer or of several, or what modules and wrappers refuse.
    """
    check_environment(env)
    chain = _chain(env)
    puts = {side: _by_layer(side, given or {}, chain) for side, given in (("inside", inside), ("outside", outside))}
    base = deepcopy(chain[0].given if chain else env)
    for module in check_value("modules", modules, Sequence[Module]):
        base.base.add_module(deepcopy(module))
    new: Environment = base
    for layer in chain:
        for put in puts["inside"].get(layer, []):
            new = _put("inside", put, new)
        args, kwargs = layer.made_with.map(partial(_instead, new))
        new = type(layer)(*args, **kwargs)
        for put in puts["outside"].get(layer, []):
            new = _put("outside", put, new)
    if modules:
        # Undeclared observations of a name that another module has are refused here, not at the first reset.
        _ = new.state_shape
    return new


def _chain(env: Environment) -> list[Wrapper]:
    """Returns the layers as they were given, before wrappers copied what they wrap; the innermost first."""
    chain: list[Wrapper] = []
    while isinstance(env, Wrapper):
        if not any(isinstance(x, Environment) for x in env.made_with.values):
            mine = type(env).__name__
            raise ValueError(f"env: got {mine}, which makes what it wraps; takes wrappers that get it: {mine}(env)")
        chain.insert(0, env)
        env = env.given
    return chain


def _by_layer(argument: str, layers: Layers, chain: Sequence[Wrapper]) -> dict[Wrapper, list[LayerFn]]:
    """Returns what to put next to each layer."""
    check_value(argument, layers, Layers)
    named = [name for layer in chain for name in {type(layer).__name__, layer.name} if name]
    found = {}
    for name, puts in layers.items():
        check_choice(argument, name, set(named))
        if named.count(name) > 1:
            own = sorted(layer.name for layer in chain if type(layer).__name__ == name)
            raise ValueError(f"{argument}: got {name!r}, of which there are {named.count(name)}; takes one of {own}")
        layer = next(layer for layer in chain if name in (type(layer).__name__, layer.name))
        found[layer] = [puts] if callable(puts) else list(puts)
    return found


def _instead(new: Environment, argument: Any) -> Any:
    return new if isinstance(argument, Environment) else argument


def _put(argument: str, put: LayerFn, env: Environment) -> Environment:
    new = put(env)
    if not isinstance(new, Environment):
        raise ValueError(f"{argument}: got {described(new)} from {put!r}; takes a function that returns an environment")
    return new
