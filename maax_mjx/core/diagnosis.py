"""What happens inside of one env step, physics step by physics step: where and why a world goes astray."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from maax_mjx.common.spaces import check_action
from maax_mjx.core.env import Base, Environment
from maax_mjx.core.faults import AGENT_CEILING, MARGIN, astray
from maax_mjx.core.state import State, check_state
from maax_mjx.physics import Data, Fields, overlaid_model

DEEP = 0.005
"""Metres of penetration from which a contact is worth a line: resting ones are a tenth as deep."""
LOOSE = 0.01
"""Metres or radians by which an equality is missed that is worth a line."""
SHOWN = 3
"""Contacts and equalities named at a time."""


class Moment(NamedTuple):
    """A world before or after a physics step.

    Attributes:
        position: metres, (3,) by the name of what can move and is in play.
        speed: m/s, by name.
        deep: the deepest contacts: two names and metres of penetration, the deepest first.
        loose: equalities that are missed most: a name and metres or radians, the worst first.
        astray: names of what is where nothing may be, or is no number.
    """

    position: dict[str, np.ndarray]
    speed: dict[str, float]
    deep: list[tuple[str, str, float]]
    loose: list[tuple[str, float]]
    astray: list[str]


class Diagnosis(NamedTuple):
    """An env step, physics step by physics step; print it.

    Attributes:
        moments: before the first physics step, and after each.
        fault: whether the step was a physics fault.
        engine: the engine that made the step.
        floor_size: metres, the floor's edge.
    """

    moments: list[Moment]
    fault: bool
    engine: str
    floor_size: float

    @property
    def first(self) -> int | None:
        """The physics step after which something was astray, from 1; None without."""
        return next((i for i, moment in enumerate(self.moments) if moment.astray), None)

    def __str__(self) -> str:
        n, first = len(self.moments) - 1, self.first
        if first is None:
            lines = [f"nothing went astray in {n} physics steps on {self.engine}"]
            lines += ["yet it was a fault: something in the action or the speeds is no number"] if self.fault else []
            first = n
        else:
            lines = [f"on {self.engine}, after physics step {first} of {n}:"]
            lines += [f"  {name} {self._where(self.moments[first], name)}" for name in self.moments[first].astray]
        before = self.moments[max(first - 1, 0)]
        fastest = max(before.speed, key=lambda name: before.speed[name])
        lines.append(f"one physics step before, {fastest} was the fastest, with {before.speed[fastest]:.3g} m/s")
        for title, moment in (("as the step began", self.moments[0]), ("one physics step before", before)):
            lines += [f"{title}, {a} was {depth * 1e3:.1f} mm deep in {b}" for a, b, depth in moment.deep]
            lines += [f"{title}, {name} was missed by {miss:.3g} (metres or radians)" for name, miss in moment.loose]
        return "\n".join(dict.fromkeys(lines))

    def _where(self, moment: Moment, name: str) -> str:
        x, y, z = moment.position[name]
        at = f"at ({x:.3g}, {y:.3g}, {z:.3g}) m"
        if not np.isfinite([x, y, z]).all():
            return "is nowhere: its position is no number"
        if z < -MARGIN:
            return f"is below the floor, {at}"
        beyond = max(-x, -y, x - self.floor_size, y - self.floor_size)
        if beyond > MARGIN:
            return f"is {beyond:.3g} m outside of the arena, {at}"
        return f"is higher than {AGENT_CEILING:g} m, {at}"


def diagnose(env: Environment, state: State, action: Any) -> Diagnosis:
    """Makes an env step again, and looks at every physics step of it.

    Args:
        env: the environment.
        state: the state of one world.
        action: what was done in it.

    Raises:
        ValueError: what is no state of one world of the environment, or an action of other names, shapes or types.
    """
    seen: list[tuple[Fields, Data]] = []
    twin = copy.deepcopy(env)
    twin.base.watch = lambda fields, data: seen.append(jax.tree.map(np.asarray, (fields, data)))
    # Shapes and types alone: an action that led astray may hold NaN.
    check_state(state, env.state_shape)
    jax.eval_shape(lambda given: check_action(env.action_space, given), action)
    after = jax.block_until_ready(jax.jit(twin.advance)(state, action))
    moments = [_moment(twin.base, state, fields, data) for fields, data in seen]
    floor_size = float(np.asarray(state.world.plan.floor_size))
    return Diagnosis(moments, bool(after.metrics["physics_fault"]), twin.base.engine.impl, floor_size)


def _moment(base: Base, state: State, fields: Fields, data: Data) -> Moment:
    names, active = _names(base, state)
    position = np.asarray(data.qpos)[base.position_ids]
    speed = np.linalg.norm(np.asarray(data.qvel)[base.velocity_ids], axis=1)
    wrong = np.asarray(astray(state.world.plan, position, base.is_agent)) | ~np.isfinite(position).all(axis=1)
    playing = np.flatnonzero(active).tolist()
    deep, loose = _constraints(base, fields, data) if np.isfinite(data.qpos).all() else ([], [])
    return Moment(
        position={names[i]: position[i] for i in playing},
        speed={names[i]: float(speed[i]) for i in playing},
        deep=deep,
        loose=loose,
        astray=[names[i] for i in playing if wrong[i]],
    )


def _names(base: Base, state: State) -> tuple[list[str], np.ndarray]:
    """Names of all that moves, in the order of `movables`, and which of it is in play."""
    names = [name for m in base.movables for name in (base.agent_names if m is base.agents else m.names)]
    return names, np.concatenate([np.asarray(state.world.active[m.kind]) for m in base.movables])


def _constraints(
    base: Base, fields: Fields, data: Data
) -> tuple[list[tuple[str, str, float]], list[tuple[str, float]]]:
    """The deepest contacts and the worst equalities of a world, as plain MuJoCo finds them."""
    model = overlaid_model(base.model, base.overlay, fields)
    d = mujoco.MjData(model)
    exact = base.engine.exact(data)
    for name in ("qpos", "qvel"):
        getattr(d, name)[:] = exact[name]
    d.eq_active[:] = data.eq_active
    mujoco.mj_forward(model, d)
    named = dict(zip(base.agents.names, base.agent_names, strict=True))

    def name_of(geom: int) -> str:
        body = model.body_rootid[model.geom_bodyid[geom]]
        name = model.body(body).name if body else model.geom(geom).name
        return named.get(name, name)

    deep = sorted((float(c.dist), name_of(c.geom1), name_of(c.geom2)) for c in d.contact if c.dist < -DEEP)
    rows = d.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    missed: dict[str, float] = {}
    for i, miss in zip(d.efc_id[rows].tolist(), np.abs(d.efc_pos[rows]).tolist(), strict=True):
        missed[model.eq(i).name] = max(miss, missed.get(model.eq(i).name, LOOSE))
    loose = sorted(((name, x) for name, x in missed.items() if x > LOOSE), key=lambda pair: -pair[1])
    return [(a, b, -dist) for dist, a, b in deep[:SHOWN]], loose[:SHOWN]
