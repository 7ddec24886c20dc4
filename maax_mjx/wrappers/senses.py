"""The agents' senses: line of sight and lidar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import Bounds, check_value
from maax_mjx.common.arrays import null_rows
from maax_mjx.common.checks import check_bool, check_choice, check_positive
from maax_mjx.common.observed import AGENT, Column, Observed
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities, Sites
from maax_mjx.modules.from_model import from_model
from maax_mjx.physics.rays import NO_BODY, Rays
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.wrapper import ObservationWrapper, StateWrapper

CONE = 3 * np.pi / 4
"""Radians of the full cone of sight, 135 degrees."""
BETWEEN = ("centres", "corners")
FRAMES = ("world", "agent")
Cone = Annotated[float, Bounds(0, 2 * np.pi, above=True, takes="an angle in radians, up to 2 pi")]
RayCount = Annotated[int, Bounds(1, 10_000)]


class _Senses(StateWrapper):
    precedes = (PreparationPhase,)

    @from_model
    def _rays(self) -> Rays:
        return Rays(self.base.model, self.base.overlay)

    def _eyes(self, state: State) -> tuple[jax.Array, jax.Array]:
        """Returns (n_agents, 3) metres, the agents' eyes, and (n_agents,) radians, their headings."""
        agents = self.base.agents
        return state.data.xpos[agents.body_ids], agents.headings(state.data)


class LineOfSight(_Senses):
    """Adds `sees_agent` (n_agents, n_agents), `sees_box` (n_agents, n_boxes), ... bool: what every agent sees.

    An agent sees what is in the cone ahead of it, seen from above, and is the first thing that a ray from centre to
    centre meets; of marks without a body, such as food, those that a ray gets to (Baker et al.). Agents see themselves;
    absent agents see nothing and are not seen.

    Args:
        env: environment to wrap.
        cone: full angle of the cone in radians; 135 degrees by default.
        objects: names of the modules that agents can see in addition to agents: of objects, or of marks on the floor;
            None is boxes and ramps, if there are any.
        between: "centres", or "corners" for a cone that is measured between the lower corners of things as they stand
            unturned, as in the published code, whose positions are these; rays then go to the middle of a ramp's wedge,
            where MuJoCo has its mesh, instead of the middle of its box.

    Raises:
        ValueError: an angle that is not in (0, 2 pi], an unknown module, or an unknown `between`.
    """

    name = "line_of_sight"

    def __init__(
        self,
        env: Environment,
        cone: float = CONE,
        objects: Sequence[str] | None = None,
        between: str = "centres",
    ):
        super().__init__(env)
        self.between = check_choice("between", between, BETWEEN)
        self.half_cone = check_value("cone", cone, Cone) / 2
        modules: list[Entities | Sites] = [self.base.agents, *self.base.objects_and_sites(objects)]
        self.modules = [module for module in modules if module.n_max]

    @property
    def senses(self) -> tuple[str, ...]:
        return tuple(f"sees_{m.kind}" for m in self.modules)

    def seen(self, state: State, names: Sequence[str]) -> jax.Array:
        """Returns some of its `senses` in a state after a step, joined: (n_agents, n) bool."""
        return jnp.concatenate([state.mechanics[self.name][name] for name in names], axis=1)

    def check_sees(self, modules: Sequence[Entities]) -> None:
        """Refuses modules whose objects it does not look for.

        Raises:
            ValueError: such a module; the message names it.
        """
        for module in modules:
            if module not in self.modules:
                raise ValueError(
                    f"in_vision_only: LineOfSight does not see {module.name!r}; takes what it sees, "
                    f"{[m.name for m in self.modules]}: LineOfSight(env, objects=[...])"
                )

    def blind(self, state: State, who: jax.Array) -> State:
        return self.remember(super().blind(state, who), null_rows(state.mechanics[self.name], who))

    def observe(self, state: State) -> State:
        bodies, model = np.concatenate([_bodies(m) for m in self.modules]), self.base.model
        eyes, heading = self._eyes(state)
        corners = self.between == "corners"
        to = jnp.concatenate([_centres(m, state, of_geoms=corners) for m in self.modules]) - eyes[:, None]
        away = jnp.linalg.norm(to, axis=-1)
        aside = self._between_corners(state, eyes) if corners else to
        turn = jnp.arctan2(aside[..., 1], aside[..., 0]) - heading[:, None]
        turn = jnp.mod(turn + jnp.pi, 2 * jnp.pi) - jnp.pi
        direction = to / jnp.maximum(away, 1e-6)[..., None]
        free, geom = self._rays.cast(state.world.fields, state.data, eyes, direction, self.base.agents.body_ids)
        met = jnp.where(geom < 0, NO_BODY, jnp.asarray(model.body_rootid[model.geom_bodyid])[geom])
        reached = jnp.where(bodies == NO_BODY, free >= away, met == bodies)
        there = jnp.concatenate([state.world.active[m.kind] for m in self.modules])
        itself = bodies == self.base.agents.body_ids[:, None]
        seen = ((jnp.abs(turn) <= self.half_cone) & reached) | itself
        seen &= there & self.playing(state)[:, None]
        parts = jnp.split(seen, np.cumsum([m.n_max for m in self.modules])[:-1], axis=1)
        masks = dict(zip(self.senses, parts, strict=True))
        return self.remember(state, masks).replace(obs=state.obs | masks)

    def _between_corners(self, state: State, eyes: jax.Array) -> jax.Array:
        """From agents' lower corners to those of what can be seen: (n_agents, n, 3) metres; marks have none."""
        half = [
            jnp.zeros((m.n_max, 3)) if isinstance(m, Sites) else m.extents_of(state.world) / 2 for m in self.modules
        ]
        corners = jnp.concatenate([_centres(m, state) for m in self.modules]) - jnp.concatenate(half)
        return corners - (eyes - jnp.asarray(self.base.agents.extent) / 2)[:, None]

    def declared(self) -> dict[str, Observed]:
        sees = {f"sees_{m.kind}": Observed((AGENT, m.kind)) for m in self.modules}
        return self.env.declared() | sees


def _bodies(module: Entities | Sites) -> np.ndarray:
    """Ids (n,) of the bodies of a module's objects; marks on the floor have none."""
    return np.full(module.n_max, NO_BODY) if isinstance(module, Sites) else module.body_ids


def _centres(module: Entities | Sites, state: State, of_geoms: bool = False) -> jax.Array:
    """Centres (n, 3) of a module's objects, or of their geoms, in metres."""
    if isinstance(module, Sites):
        return state.world.sites[module.kind]
    return state.data.geom_xpos[module.geom_ids] if of_geoms else state.data.xpos[module.body_ids]


class Lidar(_Senses, ObservationWrapper):
    """Adds `lidar` (n_agents, n_rays, 1): distances in metres to the first thing along each ray, at the agent's height.

    Rays are spread evenly over the full circle. Where there is nothing, a ray reads `range`.

    Args:
        env: environment to wrap.
        n_rays: number of rays per agent.
        range: greatest distance in metres, and what a ray reads that meets nothing.
        capped: whether a ray ends at `range`; otherwise one that meets something reads how far that is, as in the
            published code.
        frame: "world": the first ray points along x, whatever the agent's heading (OpenAI's); "agent": it points ahead.
        compress: a scale in metres, or None: gives distances as `scale * tanh(distance / scale)`.

    Raises:
        ValueError: fewer than one ray, an unknown frame, a range or a scale that is not positive.
    """

    name = "lidar"

    def __init__(
        self,
        env: Environment,
        n_rays: int = 30,
        range: float = 6.0,
        frame: str = "world",
        compress: float | None = None,
        capped: bool = True,
    ):
        super().__init__(env)
        self.capped = check_bool("capped", capped)
        self.n_rays = int(check_value("n_rays", n_rays, RayCount))
        self.range = check_positive("range", range)
        self.frame = check_choice("frame", frame, FRAMES)
        self.compress = None if compress is None else check_positive("compress", compress)

    @property
    def senses(self) -> tuple[str, ...]:
        return ("lidar",)

    def rays(self, state: State) -> tuple[jax.Array, jax.Array]:
        """Returns world-frame directions (n_agents, n_rays, 3), and metres (n_agents, n_rays)."""
        eyes, heading = self._eyes(state)
        angle = jnp.arange(self.n_rays) * (2 * jnp.pi / self.n_rays)
        angle = angle + heading[:, None] * (self.frame == "agent")
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)], axis=-1)
        direction = jnp.broadcast_to(direction, (len(eyes), self.n_rays, 3))
        distance, _ = self._rays.cast(state.world.fields, state.data, eyes, direction, self.base.agents.body_ids)
        if self.capped:
            return direction, jnp.minimum(distance, self.range)
        return direction, jnp.where(jnp.isfinite(distance), distance, self.range)

    def observation(self, state: State) -> dict[str, jax.Array]:
        distance = self.rays(state)[1][..., None]
        if self.compress is not None:
            distance = self.compress * jnp.tanh(distance / self.compress)
        active = self.playing(state)[:, None, None]
        return state.obs | {"lidar": jnp.where(active, distance, 0.0)}

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {
            "lidar": Observed((AGENT, "ray"), (Column("distance", "m", max(3.0, self.range / 5)),))
        }
