"""`check_env`, which checks the contract of any environment, including your own."""

from __future__ import annotations

import dataclasses
import os
import random
import re
import traceback
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.spaces import check_space
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State

TOLERANCE = 1e-4
"""Largest difference between runs that should be equal, absolute and relative."""


def check_env(env: Environment, *, n_worlds: int = 3, n_steps: int = 4, seed: int = 0) -> None:
    """Checks that an environment keeps its contract; returns nothing.

    Observations are declared as they are; spaces contain them and the actions; vmap equals a loop, to 1e-4; reset and
    step are traced once; the same key gives the same world and run, whose numbers are JAX's; everything is finite; a
    step keeps the tree, shapes and dtypes of the State; there is a reward for every agent.

    Args:
        env: the environment.
        n_worlds: number of worlds in the vmapped check.
        n_steps: number of steps of every run.
        seed: seed of the worlds and actions.

    Raises:
        AssertionError: a check fails; the message says which and where.
        ValueError: no environment.
    """
    if not isinstance(env, Environment):
        raise ValueError(f"env: got {env!r}; takes an environment, such as maax.make('tag')")
    _check_declared(env)
    keys = jax.random.split(jax.random.key(seed), n_worlds)
    sample = jax.jit(jax.vmap(env.sample_action))
    actions = [jax.device_get(sample(jax.random.split(jax.random.key(seed + 1 + t), n_worlds))) for t in range(n_steps)]
    traces = {"reset": 0, "step": 0}

    def reset(key: jax.Array) -> State:
        traces["reset"] += 1
        return env.reset(key)

    def step(state: State, action: Any) -> State:
        traces["step"] += 1
        return env.step(state, action)

    jit_reset, jit_step = jax.jit(reset), jax.jit(step)
    loop, drawn = [], _generators()
    for i, key in enumerate(keys):
        loop.append(_run(jit_reset, jit_step, key, [_row(a, i) for a in actions], f"world {i}"))
    if _generators() != drawn:
        raise AssertionError(
            "reset or step draws from the generator of NumPy or Python, once, while it is traced: all worlds and steps "
            "would have the same number; it must come from jax.random with the state's key"
        )
    for i, states in enumerate(loop):
        _check_states(env, states, f"world {i}")
    for action in actions:
        if not env.action_space.contains(_row(action, 0)):
            raise AssertionError(f"action_space does not contain what sample_action gives: {sorted(action)}")
    if traces != {"reset": 1, "step": 1}:
        raise AssertionError(f"reset and step were traced {traces} times for {n_worlds} worlds; each must be once")
    again = _run(jit_reset, jit_step, keys[0], [_row(a, 0) for a in actions])
    _same(loop[0], again, "two runs from the same key", exact=True)
    # Places, doors, and what mechanics drew: a game may always look alike and differ in what then happens.
    first, second = (jax.tree.leaves((s.data.qpos, s.world.plan.doors, s.mechanics)) for s in (loop[0][0], loop[1][0]))
    if all(np.array_equal(a, b) for a, b in zip(first, second, strict=True)):
        raise AssertionError("reset gave two different keys the same world")

    batch = [_host(s) for s in _run(jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step)), keys, actions)]
    for i, states in enumerate(loop):
        rows = [_row(state, i) for state in batch]
        _same(states, rows, f"vmap and loop, world {i}")


def _check_declared(env: Environment) -> None:
    """Agents can share the actions; observations are declared with their columns, and all declared are there."""
    # Imported late: wrappers are made of environments.
    from maax_mjx.wrappers.split import declared_table

    try:
        check_space(env.action_space)
        table = declared_table(env, "check_env", masks=())
    except ValueError as error:
        raise AssertionError(str(error)) from error
    if unseen := sorted(set(env.observed) - set(table)):
        raise AssertionError(f"{unseen} are declared and not observed: `observation` must give them")


def _host(tree: Any) -> Any:
    """The tree on the host, with keys as their numbers: slices of it are not compiled, one program each."""

    def numbers(x: Any) -> Any:
        return jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x

    return jax.device_get(jax.tree.map(numbers, tree))


def _row(tree: Any, i: int) -> Any:
    return jax.tree.map(lambda x: x[i], tree)


def _run(reset: Any, step: Any, key: jax.Array, actions: list[Any], where: str = "") -> list[State]:
    """Returns the states of a run, each of which has the tree, shapes and dtypes of the first."""
    states = [_called(where, reset, key)]
    structure: Any = jax.tree.structure(states[0])
    for t, action in enumerate(actions, start=1):
        states.append(_called(f"{where}, step {t}", step, states[-1], action))
        if jax.tree.structure(states[-1]) != structure:
            raise AssertionError(f"{where}, step {t}: step changed the tree of the State, so that it cannot be scanned")
        if _shapes(states[-1]) != _shapes(states[0]):
            raise AssertionError(
                f"{where}, step {t}: step changed a shape or dtype of the State, so that it cannot be scanned: "
                f"state{_changed(states[0], states[-1])}"
            )
    return states


def _called(where: str, function: Any, *args: Any) -> Any:
    """Calls reset or step, which refuse states and rewards of a wrong form themselves."""
    try:
        return function(*args)
    except jax.errors.ConcretizationTypeError as error:
        raise AssertionError(
            f"{where}: a rule turns an array into a Python number or asks it in an `if` ({_line_of(error)}), and what "
            "it is is known only when the step runs; takes jnp.where, and arrays as they are"
        ) from error
    except TypeError as error:
        wrong = re.search(r"State.__init__\(\) got an unexpected keyword argument '(\w+)'", str(error))
        if wrong is None:
            raise
        names = [f.name for f in dataclasses.fields(State)]
        raise AssertionError(f"{where}: replace: got {wrong[1]!r} ({_line_of(error)}); takes of {names}") from error
    except ValueError as error:
        raise AssertionError(f"{where}: {error}" if where else str(error)) from error


def _line_of(error: BaseException) -> str:
    """The innermost line of the error's traceback that is neither JAX's nor this package's, or the last one."""
    lines = traceback.extract_tb(error.__traceback__)
    inside = f"{Path(__file__).parent}{os.sep}", f"{Path(jax.__file__).parent}{os.sep}"
    own = [line for line in lines if not line.filename.startswith(inside)] or lines
    return f"{Path(own[-1].filename).name}, line {own[-1].lineno}: {own[-1].line}"


def _generators() -> tuple[bytes, Any]:
    """The states of the generators that do not belong to JAX."""
    _, keys, position, *_ = np.random.get_state()  # noqa: NPY002 (it is only looked at)
    return np.asarray(keys).tobytes() + bytes(str(position), "ascii"), random.getstate()


def _shapes(state: State) -> list[tuple[Any, ...]]:
    leaves = jax.tree.leaves(state)
    return [(jnp.shape(x), jnp.asarray(x).dtype, getattr(x, "weak_type", False)) for x in leaves]


def _changed(before: State, after: State) -> str:
    """Returns where the first array is that changed, and how."""
    named = [jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path(before)]
    both = zip(named, _shapes(before), _shapes(after), strict=True)
    at, was, now = next((at, was, now) for at, was, now in both if was != now)
    return f"{at} was {_words(*was)} and is {_words(*now)}"


def _words(shape: tuple[int, ...], dtype: Any, weak: bool) -> str:
    return f"{'weak ' if weak else ''}{dtype}{list(shape)}"


def _check_states(env: Environment, states: list[State], where: str) -> None:
    for t, state in enumerate(states):
        here = f"{where}, step {t}"
        obs = jax.device_get(state.obs)
        if not env.observation_space.contains(obs):
            bad = [k for k in {*obs, *env.observation_space} if k not in obs or k not in env.observation_space.spaces
                   or not env.observation_space[k].contains(obs[k])]  # fmt: skip
            raise AssertionError(f"{here}: observation_space does not contain the observations {sorted(bad)}")
        if state.reward.shape != (env.base.n_agents,):
            raise AssertionError(f"{here}: reward has shape {state.reward.shape}; it must be ({env.base.n_agents},)")
        for path, leaf in jax.tree.leaves_with_path(state):
            if jnp.issubdtype(leaf.dtype, jnp.floating) and not np.isfinite(leaf).all():
                raise AssertionError(f"{here}: {jax.tree_util.keystr(path)} is not finite")
        if int(state.step) != t:
            raise AssertionError(f"{here}: state.step is {int(state.step)}")


def _same(left: list[State], right: list[State], what: str, exact: bool = False) -> None:
    for t, (a, b) in enumerate(zip(left, right, strict=True)):
        # An engine's own data is not compared, nor where its solver starts, since that is not where it ends.
        if not exact:
            a, b = (s.replace(data=s.data.replace(engine=(), qacc_warmstart=())) for s in (a, b))
        a, b = _host(a), _host(b)
        for (path, x), y in zip(jax.tree.leaves_with_path(a), jax.tree.leaves(b), strict=True):
            close = np.array_equal(x, y) if exact or x.dtype.kind != "f" else np.allclose(x, y, TOLERANCE, TOLERANCE)
            if not close:
                raise AssertionError(f"{what} differ at step {t} in {jax.tree_util.keystr(path)}")
