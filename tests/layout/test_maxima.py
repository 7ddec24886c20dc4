"""What there is in a world does not depend on how much more of anything there could be."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.modules import StaticCylinders

N = 200
OUTER_WALLS = 4


def build(more):
    """Everything at once; with `more`, every maximum is higher by that much."""
    env = maax.Base(5 + 3 * more, impl="c", floor_size=(14.0, 16.0 + more))
    any_yaw = {"random_yaw": True}
    for module in (
        maax.WallScenarios(
            ("quad", "tri", "random"),
            p_door_dropout=0.5,
            n_rooms=(2, 4 + 2 * more),
            prob_outside_walls=0.5,
            friction=(0.1, 0.8 + more),
        ),
        maax.Agents(
            {"hiders": (1, 2 + 2 * more), "seekers": (1, 3 + more)},
            friction=(0.1, 0.8 + more),
            damping=(5, 15 + more),
            gear=(50, 150 + more),
            **any_yaw,
        ),
        maax.Boxes(
            (1, 4 + 2 * more),
            n_elongated_boxes=(0, 3 + 3 * more),
            box_size=(0.3, 0.5 + 0.1 * more),
            box_mass=(0.5, 3.0 + more),
            box_friction=(0.1, 0.8 + more),
            **any_yaw,
        ),
        maax.Ramps((1, 2 + 2 * more), ramp_friction=(0.1, 0.8 + more), **any_yaw),
        maax.Cylinders((1, 2 + more), (0.3, 0.5 + 0.1 * more), (0.2, 0.5 + more), friction=(0.1, 0.8 + more)),
        StaticCylinders((1, 2 + more), (0.3, 0.5 + 0.1 * more), (0.2, 0.5 + more), friction=(0.1, 0.8 + more)),
        maax.Food((1, 3 + more)),
        maax.ConstructionSites((1, 3 + more), n_elongated_sites=(0, 2 + 2 * more)),
    ):
        env.add_module(module)
    return env


def values(env, states, name, ids):
    """(N, len(ids), ...) rows of a model field, which worlds differ in."""
    rows = list(env.overlay[name])
    return np.asarray(states.world.fields[name])[:, [rows.index(i) for i in ids]]


def things(env, states):
    """By name, what is true of every slot of a kind, (N, n, ...), and (N, n) which of the slots are in play."""
    world, data, modules = states.world, states.data, env.modules
    of_wall = np.arange(OUTER_WALLS + 2 * world.plan.door_mask.shape[1])
    walls = modules["walls"]
    found = {
        "outer_wall": ({"rect": world.plan.walls[:, :OUTER_WALLS]}, world.plan.wall_mask[:, :OUTER_WALLS]),
        "wall": (
            {
                "rect": world.plan.walls[:, OUTER_WALLS:],
                "height": world.plan.wall_heights[:, OUTER_WALLS:],
                "friction": values(env, states, "geom_friction", walls.geom_ids[of_wall])[:, OUTER_WALLS:],
            },
            world.plan.wall_mask[:, OUTER_WALLS:],
        ),
        "door": ({"opening": world.plan.doors}, world.plan.door_mask),
        "room": ({"cells": world.plan.rooms}, world.plan.room_mask),
        "world": (
            {name: np.asarray(getattr(world.plan, name))[:, None] for name in ("scenario", "quadrant", "closed")}
            | {"floor_size": np.asarray(world.plan.floor_size)[:, None]},
            np.ones((N, 1), bool),
        ),
    }
    for name in ("agent", "box", "ramp", "cylinder"):
        module = modules[name]
        of = {
            "pose": np.asarray(data.qpos)[:, module.qpos_ids],
            "friction": values(env, states, "geom_friction", module.geom_ids),
        }
        if name in ("box", "cylinder"):
            of["size"] = values(env, states, "geom_size", module.geom_ids)
            of["mass"] = values(env, states, "body_mass", module.body_ids)
            of["inertia"] = values(env, states, "body_inertia", module.body_ids)
        if name == "agent":
            of["damping"] = values(env, states, "dof_damping", module.qvel_ids[:, 0])
            of["gear"] = values(env, states, "actuator_gear", module.ctrl_ids[:, 0])
        found[name] = of, world.active[module.kind]
    fixed = modules["static_cylinder"]
    found["static_cylinder"] = (
        {
            "position": np.asarray(data.geom_xpos)[:, fixed.geom_ids],
            "friction": values(env, states, "geom_friction", fixed.geom_ids),
            "size": values(env, states, "geom_size", fixed.geom_ids),
        },
        world.active[fixed.kind],
    )
    for kind, module in env.sites.items():
        of = {"position": world.sites[kind]}
        if module.sizes_vary:
            of["size"] = world.extents[kind]
        found[kind] = of, world.active[kind]
    agents, there = found.pop("agent")
    for team in range(2):
        own = modules["agent"].team_index == team
        found[f"team {team}"] = {k: np.asarray(x)[:, own] for k, x in agents.items()}, np.asarray(there)[:, own]
    return found


@pytest.fixture(scope="module")
def drawn():
    few, many = build(0), build(1)
    keys = jax.random.split(seeds.key(0), N)
    params = many.default_params.replace(**few.default_params)
    return [
        things(env, jax.device_get(jax.jit(jax.vmap(env.reset, (0, None)))(keys, p)))
        for env, p in ((few, few.default_params), (many, params))
    ]


KINDS = (
    "world", "outer_wall", "wall", "door", "room", "team 0", "team 1", "box", "ramp", "cylinder",
    "static_cylinder", "food", "construction_site",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_higher_maxima_move_nothing(drawn, kind):
    (few, there), (many, there_too) = drawn[0][kind], drawn[1][kind]
    there, there_too = np.asarray(there), np.asarray(there_too)
    n = there.shape[1]
    assert kind in ("world", "outer_wall") or there_too.shape[1] > n, "the maximum is no higher"
    assert there.any(axis=0).all(), "a slot that is never in play"
    np.testing.assert_array_equal(there_too[:, :n], there)
    assert not there_too[:, n:].any()
    for name, x in few.items():
        got, want = np.asarray(many[name])[:, :n][there], np.asarray(x)[there]
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-6, err_msg=f"{name} of {kind}")


@pytest.mark.slow
def test_every_kind_is_compared(drawn):
    assert set(drawn[0]) == set(KINDS)
